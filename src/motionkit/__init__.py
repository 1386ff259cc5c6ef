"""motionkit: BVH recordings in, a controllable real-time motion model, BVH out.

`import motionkit as mk` imports nothing else: each name below imports its module on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from motionkit.version import __version__

if TYPE_CHECKING:
    from motionkit.api import (
        follow_path,
        loop,
        measure,
        preprocess,
        quickstart,
        read_bvh,
        read_canonical,
        read_rig,
        retarget,
        synthesize,
    )
    from motionkit.control.drive import Driver, Wish
    from motionkit.control.path import Path2D, PathPart, make_path, read_path, shape_path
    from motionkit.data.dataset import Dataset
    from motionkit.data.options import PreprocessOptions
    from motionkit.editing.fix import fix_motion
    from motionkit.editing.join import join_motions as join
    from motionkit.editing.loop import make_loop
    from motionkit.editing.root_motion import in_place, with_ground_root
    from motionkit.errors import MotionkitError
    from motionkit.export.formats import read_motion as read
    from motionkit.export.formats import write_motion as write
    from motionkit.export.onnx_export import export_onnx
    from motionkit.features.decode import decode_motion as decode
    from motionkit.features.encode import encode_motion as encode
    from motionkit.features.layout import column_names
    from motionkit.inference.character import CharacterStream
    from motionkit.inference.noise import Noise
    from motionkit.lab.scoreboard.board import evaluate
    from motionkit.models.bundled import open_model as load_model
    from motionkit.models.model import MotionModel
    from motionkit.motion.bvh import write_bvh
    from motionkit.motion.kinematics import motion_kinematics as kinematics
    from motionkit.motion.motion import Motion, resample
    from motionkit.motion.skeleton import Skeleton, canonical_skeleton
    from motionkit.rig.mirror import mirror_motion as mirror
    from motionkit.training.presets import fine_tune_options, train_options
    from motionkit.training.trainer import train
    from motionkit.view.notebook import show
    from motionkit.view.write import write_view

# Public name -> module that defines it, followed by its name there if that differs. No public name may equal a
# package's name: Python binds motionkit.metrics to the package as soon as anything imports it.
_HOMES = {
    "evaluate": "lab.scoreboard.board",
    "follow_path": "api",
    "loop": "api",
    "measure": "api",
    "preprocess": "api",
    "quickstart": "api",
    "read_bvh": "api",
    "read_canonical": "api",
    "read_rig": "api",
    "retarget": "api",
    "synthesize": "api",
    "Driver": "control.drive",
    "Wish": "control.drive",
    "Path2D": "control.path",
    "PathPart": "control.path",
    "make_path": "control.path",
    "read_path": "control.path",
    "shape_path": "control.path",
    "Dataset": "data.dataset",
    "PreprocessOptions": "data.options",
    "fix_motion": "editing.fix",
    "join": "editing.join:join_motions",
    "make_loop": "editing.loop",
    "in_place": "editing.root_motion",
    "with_ground_root": "editing.root_motion",
    "MotionkitError": "errors",
    "read": "export.formats:read_motion",
    "write": "export.formats:write_motion",
    "export_onnx": "export.onnx_export",
    "decode": "features.decode:decode_motion",
    "encode": "features.encode:encode_motion",
    "column_names": "features.layout",
    "CharacterStream": "inference.character",
    "Noise": "inference.noise",
    "load_model": "models.bundled:open_model",
    "MotionModel": "models.model",
    "write_bvh": "motion.bvh",
    "kinematics": "motion.kinematics:motion_kinematics",
    "mirror": "rig.mirror:mirror_motion",
    "Motion": "motion.motion",
    "resample": "motion.motion",
    "Skeleton": "motion.skeleton",
    "canonical_skeleton": "motion.skeleton",
    "fine_tune_options": "training.presets",
    "train_options": "training.presets",
    "train": "training.trainer",
    "show": "view.notebook",
    "write_view": "view.write",
}

__all__ = [
    "CharacterStream",
    "Dataset",
    "Driver",
    "Motion",
    "MotionModel",
    "MotionkitError",
    "Noise",
    "Path2D",
    "PathPart",
    "PreprocessOptions",
    "Skeleton",
    "Wish",
    "__version__",
    "canonical_skeleton",
    "column_names",
    "decode",
    "encode",
    "evaluate",
    "export_onnx",
    "fine_tune_options",
    "fix_motion",
    "follow_path",
    "in_place",
    "join",
    "kinematics",
    "load_model",
    "loop",
    "make_loop",
    "make_path",
    "measure",
    "mirror",
    "preprocess",
    "quickstart",
    "read",
    "read_bvh",
    "read_canonical",
    "read_path",
    "read_rig",
    "resample",
    "retarget",
    "shape_path",
    "show",
    "synthesize",
    "train",
    "train_options",
    "with_ground_root",
    "write",
    "write_bvh",
    "write_view",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'motionkit' has no attribute {name!r}")
    module, _, attribute = _HOMES[name].partition(":")
    try:
        value = getattr(import_module(f"motionkit.{module}"), attribute or name)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        from motionkit.errors import MotionkitError

        raise MotionkitError("training needs torch: pip install 'motionkit[train]'") from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
