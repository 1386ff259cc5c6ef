"""The step of a model as an ONNX graph for engines: controls and state in, a posed body and the next state out.

The graph is written node by node from the packed weights (models/step_weights.py), with normalisation,
integration of the root and forward kinematics inside, static shapes, a batch of one. docs/engines.md tells
how to drive it.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from motionkit import __version__
from motionkit.apps.onnx_body import write_body
from motionkit.apps.onnx_graph import Graph
from motionkit.apps.onnx_network import present_name, state_shapes, write_network
from motionkit.features.control import TRAJECTORY_COUNT, TRAJECTORY_OFFSETS
from motionkit.features.guide import GUIDE_COUNT, GUIDE_OFFSETS
from motionkit.features.layout import FEATURE_COUNT, column_names
from motionkit.files import atomic_write
from motionkit.models.checkpoint import MotionModel
from motionkit.models.step import NetworkStep
from motionkit.models.step_weights import pack
from motionkit.motion.skeleton import JOINT_COUNT, leg_length
from motionkit.synthesis.character import model_first_type
from motionkit.synthesis.outline_player import last_poses
from motionkit.synthesis.plan import TypePart, plan_signals
from motionkit.synthesis.pose import BodyKinematics, PoseDecoder
from motionkit.synthesis.rollout import FrameControls, Noise, RolloutState
from motionkit.synthesis.start import seed_start

if TYPE_CHECKING:
    from onnx import ModelProto

FORMAT = "motionkit-onnx-3"
OUTLINE_SECONDS = 12.0  # of recordings of each type in the description, longer ones not cut
# What comes in beside the state, with shape and meaning.
CONTROLS: dict[str, tuple[tuple[int, ...], str]] = {
    "trajectory": (
        (1, TRAJECTORY_COUNT),
        "where the root is to be after 10, 20, ... 60 frames, in the heading frame: "
        "six x, z in cm, then six directions x, z",
    ),
    "given": ((1, 1), "1 where the trajectory counts, else 0"),
    "progress": ((1, 1), "0 to 1 through a performance of a type with a phase, -1 for other types"),
    "guide": ((1, GUIDE_COUNT), "outlines of a recording 5, 15 and 30 frames ahead, one after another"),
    "guided": ((1, 1), "how many times larger than it is the guide is shown, 0 where it does not count"),
    "noise": ((1, FEATURE_COUNT), "standard normal numbers times a temperature; zeros give the mean"),
}
OUTPUTS: dict[str, tuple[tuple[int, ...], str]] = {
    "positions": ((1, JOINT_COUNT, 3), "joints in the world, cm"),
    "rotations": ((1, JOINT_COUNT, 4), "quaternions w, x, y, z in the parent's space"),
    "root_positions": ((1, 3), "the hips in the world, cm"),
    "features": ((1, FEATURE_COUNT), "the 276 numbers, not normalised"),
}


def build_graph(model: MotionModel, character: str = "default") -> ModelProto:
    """The graph of one step on a character's body, with its metadata.

    Raises:
        ModelError: if the model cannot run frame by frame on packed weights.
        ControlError: for an unknown character.
    """
    weights = pack(model.network)
    graph = Graph()
    inputs = {**state_shapes(weights), "type_weights": (1, len(model.types))}
    inputs |= {name: shape for name, (shape, _) in CONTROLS.items()}
    outputs = {present_name(name): shape for name, shape in state_shapes(weights).items()}
    outputs |= {name: shape for name, (shape, _) in OUTPUTS.items()}
    write_body(graph, model, write_network(graph, model, weights), character)
    proto = graph.model(inputs, outputs, __version__)
    described = json.dumps(metadata(model, character, starts=False))
    graph.onnx.helper.set_model_props(proto, {"motionkit": described})
    return proto


def metadata(model: MotionModel, character: str = "default", starts: bool = True) -> dict[str, Any]:
    """What an engine has to know beside the graph, with frames to start each type from."""
    skeleton = model.character(character)
    shapes = state_shapes(pack(model.network))
    described = {
        "format": FORMAT,
        "motionkit": __version__,
        "fps": model.fps,
        "units": {"length": "cm", "angle": "radians", "time": "frames of 1 / fps seconds"},
        "axes": "right-handed, Y up; heading 0 faces +Z, positive turns to the left (+X)",
        "character": character,
        "joints": list(skeleton.names),
        "parents": list(skeleton.parents),
        "offsets": _rounded(skeleton.offsets, 4),
        "types": list(model.types),
        "phase_seconds": {kind: model.phase_seconds(kind) for kind in model.types},
        "gaits": {kind: {"speed": g.speed, "facing": g.facing} for kind, g in model.gaits.items()},
        "trajectory_frames": list(TRAJECTORY_OFFSETS),
        "guide_frames": list(GUIDE_OFFSETS),
        "guides": model.guides,
        "guidance": model.guidance,
        "noise": model.noise,
        "controls": {
            "type_weights": {
                "shape": [1, len(model.types)],
                "what": "weights of the types, which add up to 1",
            },
            **{name: {"shape": list(shape), "what": what} for name, (shape, what) in CONTROLS.items()},
        },
        "state": {name: {"shape": list(shape), "out": present_name(name)} for name, shape in shapes.items()},
        "outputs": {name: {"shape": list(shape), "what": what} for name, (shape, what) in OUTPUTS.items()},
        "contacts": ["left foot", "left toe", "right foot", "right toe"],
        "features": column_names(model.config.layout),
    }
    if starts:
        described["starts"] = {
            kind: {
                "pose": _rounded(model.scaling.normalize(seeds[0].features), 4),
                "contacts": _rounded(seeds[0].contacts, 0),
            }
            for kind, seeds in model.seeds.items()
            if seeds
        }
        described["outlines"] = {kind: _outlines(model, kind) for kind in model.types}
    return described


def _outlines(model: MotionModel, kind: str) -> list[dict[str, list]]:
    """Recordings of a type in outline, as guides are made of them; the way over the ground of performances."""
    out: list[dict[str, list]] = []
    frames = 0
    for outline in model.outlines.get(kind, []):
        if frames >= OUTLINE_SECONDS * model.fps:
            break
        frames += len(outline)
        each = {"poses": _rounded(outline.poses, 3)}
        if bool((outline.phases >= 0.0).any()):
            each["progress"] = [round(value, 4) for value in outline.phases.tolist()]
        if outline.performed:
            each["ground"] = _rounded(outline.ground, 3)
        out.append(each)
    return out


def _rounded(values: Tensor, digits: int) -> list:
    return [[round(number, digits) for number in row] for row in values.double().tolist()]


# ---- export and check ----


@dataclass(frozen=True)
class ExportCheck:
    """How far the graph and motionkit are apart after running side by side, each on its own output.

    Attributes:
        frames: how many.
        positions: largest distance of a joint in cm.
        features: largest difference of a normalised feature.
        frames_per_second: of the graph in ONNX Runtime on one core.
    """

    frames: int
    positions: float
    features: float
    frames_per_second: float


def export_onnx(model: MotionModel, path: str | Path, character: str = "default") -> ExportCheck | None:
    """Write graph and metadata (the same name with .json), then run both; None without onnxruntime."""
    path = Path(path)
    proto = build_graph(model, character)
    described = metadata(model, character)
    with atomic_write(path, "wb") as file:
        file.write(proto.SerializeToString())
    with atomic_write(path.with_suffix(".json")) as file:
        json.dump(described, file)
    try:
        import onnxruntime  # noqa: F401
    except ImportError:
        return None
    return check_export(model, path, character)


class OnnxStep:
    """The graph in ONNX Runtime, one character, its state kept between steps."""

    def __init__(self, path: str | Path, threads: int = 1) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
        self.outputs = [out.name for out in self.session.get_outputs()]
        shapes = {value.name: value.shape for value in self.session.get_inputs()}
        self.state = {n: s for n, s in shapes.items() if n not in CONTROLS and n != "type_weights"}
        self.values = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}

    def step(self) -> dict[str, np.ndarray]:
        """Run on values, which hold controls and state, and move the state on."""
        made = dict(zip(self.outputs, self.session.run(self.outputs, self.values), strict=True))
        for name in self.state:
            self.values[name] = made[present_name(name)]
        return made


def check_export(model: MotionModel, path: str | Path, character: str, frames: int = 600) -> ExportCheck:
    """Both from the same start with the same controls and noise, each going on from its own frames."""
    kind = model_first_type(model)
    start = seed_start(model, kind, 1)
    weights = torch.zeros(1, len(model.types))
    weights[0, model.type_id(kind)] = 1.0
    state = RolloutState(model, 1, Noise("mean"))
    state.network = NetworkStep(pack(model.network), 1)
    state.start(start.features, start.contacts, weights)
    graph = OnnxStep(path)
    values = graph.values
    values["type_weights"] = weights.numpy()
    values["progress"] = np.full((1, 1), -1.0, np.float32)
    x = model.scaling.normalize(start.features).numpy()
    for t in range(x.shape[1]):
        values["pose"], values["contacts"] = x[:, t], start.contacts[:, t].numpy()
        if t + 1 < x.shape[1]:
            graph.step()
    values["ground"] = np.zeros((1, 3), np.float32)
    decoder = PoseDecoder(model.config.layout, model.references.numpy())
    skeleton = model.character(character)
    share = leg_length(skeleton) / leg_length(model.character("default"))
    body = BodyKinematics(skeleton.offsets.numpy()[None])
    near = last_poses(model, start.features[0])
    played = plan_signals(model, [TypePart(kind, frames / model.fps)], near)
    way, given, none = torch.zeros(1, TRAJECTORY_COUNT), torch.zeros(1), torch.full((1,), -1.0)
    apart, features, seconds = 0.0, 0.0, 0.0
    for frame in range(frames):
        guide, guided = played.guide[frame : frame + 1], played.guided[frame : frame + 1]
        values["guide"], values["guided"] = guide.numpy(), guided[:, None].numpy()
        ours, _, ground = state.advance(FrameControls(weights, way, given, none, guide, guided))
        rotations, root = decoder.decode(ours, ground)
        positions = body.forward(rotations, np.float32(share) * root)[..., :3, 3]
        began = time.perf_counter()
        made = graph.step()
        seconds += time.perf_counter() - began
        apart = max(apart, float(np.linalg.norm(made["positions"] - positions, axis=-1).max()))
        features = max(features, float(np.abs(values["pose"] - state.normalised).max()))
    return ExportCheck(frames, apart, features, frames / seconds)
