"""The step of a model as an ONNX graph for engines: controls and state in, a posed body and the next state out.

The graph is written node by node from the packed weights (inference/step_weights.py), with normalisation,
integration of the root and forward kinematics inside, static shapes, a batch of one. docs/engines.md tells
how to drive it.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from motionkit import __version__
from motionkit.arrays import Array
from motionkit.control.reference_player import last_poses
from motionkit.control.script import TypePart, plan_signals
from motionkit.errors import ModelError, MotionkitError, OverwriteError
from motionkit.export.onnx_body import write_body
from motionkit.export.onnx_graph import Graph
from motionkit.export.onnx_network import present_name, state_shapes, write_network
from motionkit.features.control import TRAJECTORY_COUNT, TRAJECTORY_OFFSETS
from motionkit.features.layout import FEATURE_COUNT, column_names
from motionkit.features.reference import REFERENCE_COUNT, REFERENCE_OFFSETS
from motionkit.files import atomic_write, read_json
from motionkit.inference.character import model_first_type
from motionkit.inference.height_correction import HeightCorrection
from motionkit.inference.pose import BodyKinematics, PoseDecoder
from motionkit.inference.rollout import FrameControls, Noise, RolloutState
from motionkit.inference.start import type_start
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_weights import pack
from motionkit.models.model import MotionModel
from motionkit.motion.skeleton import JOINT_COUNT, leg_length

if TYPE_CHECKING:
    from onnx import ModelProto

FORMAT_NAME = "motionkit-onnx-"
FORMAT = f"{FORMAT_NAME}5"
WEIGHTS = ("float32", "int8")
# How far joints of graph and motionkit may be apart in ten seconds, each on its own output, in cm. Small differences
# of 8 bits add up to another way over the ground.
TOLERANCES = {"float32": 0.5, "int8": 200.0}
REFERENCE_SECONDS = 12.0  # of recordings of each type in the description, longer ones not cut


def _listed(numbers: tuple[int, ...]) -> str:
    return f"{', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"


# What comes in beside the state, with shape and meaning.
CONTROLS: dict[str, tuple[tuple[int, ...], str]] = {
    "trajectory": (
        (1, TRAJECTORY_COUNT),
        f"where the root is to be after {_listed(TRAJECTORY_OFFSETS)} frames, in the heading frame: "
        "x, z of each in cm, then directions x, z of each",
    ),
    "trajectory_mask": ((1, 1), "1 where the trajectory counts, else 0"),
    "phase": ((1, 1), "0 to 1 through a performance of a type with a phase, -1 for other types"),
    "reference": (
        (1, REFERENCE_COUNT),
        f"pose embeddings of a recording {_listed(REFERENCE_OFFSETS)} frames ahead, one after another",
    ),
    "reference_gain": (
        (1, 1),
        "factor on the reference, 0 where there is none",
    ),
    "slip_correction": (
        (1, 1),
        "factor on the type's root-slip correction: 1, or 0 on a path, where the trajectory comes first",
    ),
    "noise": ((1, FEATURE_COUNT), "standard normal numbers times a temperature; zeros give the mean"),
}
OUTPUTS: dict[str, tuple[tuple[int, ...], str]] = {
    "positions": ((1, JOINT_COUNT, 3), "joints in the world, cm"),
    "rotations": ((1, JOINT_COUNT, 4), "quaternions w, x, y, z in the parent's space"),
    "root_positions": ((1, 3), "the hips in the world, cm"),
    "features": ((1, FEATURE_COUNT), "the 276 numbers, not normalised"),
}


def build_graph(model: MotionModel, character: str = "default", weights: str = "float32") -> ModelProto:
    """The graph of one step on a character's body, with its metadata; weights are one of WEIGHTS.

    Raises:
        ModelError: if the model cannot run frame by frame on packed weights, or for other weights.
        ControlError: for an unknown character.
    """
    if weights not in WEIGHTS:
        raise ModelError(f"weights {weights!r} are unknown, expected one of {', '.join(WEIGHTS)}")
    packed = pack(model.network)
    graph = Graph()
    inputs = {**state_shapes(packed), "type_weights": (1, len(model.types))}
    inputs |= {name: shape for name, (shape, _) in CONTROLS.items()}
    outputs = {present_name(name): shape for name, shape in state_shapes(packed).items()}
    outputs |= {name: shape for name, (shape, _) in OUTPUTS.items()}
    features = write_network(graph, model, packed, small=weights == "int8")
    write_body(graph, model, features, character)
    described = json.dumps(metadata(model, character, weights, starts=False))
    return graph.model(inputs, outputs, __version__, {"motionkit": described})


def metadata(
    model: MotionModel, character: str = "default", weights: str = "float32", starts: bool = True
) -> dict[str, Any]:
    """What an engine has to know beside the graph, with frames to start each type from."""
    skeleton = model.character(character)
    shapes = state_shapes(pack(model.network))
    described = {
        "format": FORMAT,
        "motionkit": __version__,
        "weights": weights,
        "fps": model.fps,
        "units": {"length": "cm", "angle": "radians", "time": "frames of 1 / fps seconds"},
        "axes": "right-handed, Y up; heading 0 faces +Z, positive turns to the left (+X)",
        "character": character,
        "joints": list(skeleton.names),
        "parents": list(skeleton.parents),
        "offsets": _rounded(skeleton.offsets, 4),
        "types": list(model.types),
        "phase_seconds": {kind: model.phase_seconds(kind) for kind in model.types},
        "gaits": {
            name: {"speed": kind.gait.speed, "facing": kind.gait.facing}
            for name, kind in model.types.items()
            if kind.gait is not None
        },
        "steered": [name for name, kind in model.types.items() if kind.steered],
        "trajectory_frames": list(TRAJECTORY_OFFSETS),
        "reference_frames": list(REFERENCE_OFFSETS),
        "uses_references": model.uses_references,
        "reference_gain": {name: kind.preset.reference_gain for name, kind in model.types.items()},
        "noise_scale": {name: kind.preset.noise_scale for name, kind in model.types.items()},
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
            name: {
                "pose": _rounded(model.scaling.normalize(kind.start_poses[0].features), 4),
                "contacts": _rounded(kind.start_poses[0].contacts, 0),
            }
            for name, kind in model.types.items()
            if kind.start_poses
        }
        described["reference_clips"] = {kind: _reference_clips(model, kind) for kind in model.types}
    return described


def _reference_clips(model: MotionModel, kind: str) -> list[dict[str, list]]:
    """Pose embeddings of a type's recordings, from which references are cut; the ground track of performances."""
    out: list[dict[str, list]] = []
    frames = 0
    for reference_clip in model.types[kind].reference_clips:
        if frames >= REFERENCE_SECONDS * model.fps:
            break
        frames += len(reference_clip)
        each = {"poses": _rounded(reference_clip.poses, 3)}
        if bool((reference_clip.phases >= 0.0).any()):
            each["phase"] = [round(value, 4) for value in reference_clip.phases.tolist()]
        if reference_clip.performed:
            each["ground"] = _rounded(reference_clip.ground, 3)
        out.append(each)
    return out


def _rounded(values: Array, digits: int) -> list:
    return [[round(number, digits) for number in row] for row in values.astype(np.float64).tolist()]


# ---- export and check ----


@dataclass(frozen=True)
class ExportCheck:
    """How far the graph and motionkit are apart after running side by side, each on its own output.

    Attributes:
        frames: how many.
        positions: largest distance of a joint in cm.
        features: largest difference of a normalised feature.
        frames_per_second: of the graph by itself in ONNX Runtime on one core.
    """

    frames: int
    positions: float
    features: float
    frames_per_second: float


def metadata_path(path: str | Path) -> Path:
    """Where the metadata of a graph go; raises OverwriteError if that would be the graph, or a file of another kind."""
    path = Path(path)
    if not path.name:
        raise MotionkitError("expected a file to write the graph to, found an empty name")
    if path.name.lower().endswith(".json"):
        raise OverwriteError(
            f"{path}: the metadata go into a file of this name; give the graph another ending, such as .onnx"
        )
    beside = path.with_suffix(".json")
    if beside.is_file() and not _is_metadata(beside):
        raise MotionkitError(
            f"{beside}: is there already and not written by export; move it, or name the graph otherwise"
        )
    return beside


def _is_metadata(path: Path) -> bool:
    try:
        described = read_json(path)
    except MotionkitError:
        return False
    return isinstance(described, dict) and str(described.get("format", "")).startswith(FORMAT_NAME)


@contextmanager
def _both(graph: Path, beside: Path) -> Iterator[tuple[IO, IO]]:
    """Open two files for writing that appear together: what is there is a graph with its own metadata, or no graph."""
    placing = False
    try:
        # The last one opened is put in place first.
        with atomic_write(graph, "wb") as first, atomic_write(beside) as second:
            yield first, second
            for file in (first, second):  # so that a full disk is found before anything is changed
                file.flush()
                os.fsync(file.fileno())
            placing = True
            Path(os.path.realpath(graph)).unlink(missing_ok=True)
    except BaseException:
        if placing and not graph.exists():
            beside.unlink(missing_ok=True)
        raise


def export_onnx(
    model: MotionModel, path: str | Path, character: str = "default", weights: str = "float32"
) -> ExportCheck | None:
    """Write graph and metadata (the same name with .json) after a run side by side; None without onnxruntime.

    Raises:
        ModelError: if the model cannot be exported, does not move, or the graph does not do what motionkit does.
        ControlError: for an unknown character.
        MotionkitError: if a place cannot be written or holds what is no export. Both files are as before then.
    """
    path = Path(path)
    beside = metadata_path(path)
    proto = build_graph(model, character, weights).SerializeToString()
    check = _checked(model, proto, character, TOLERANCES[weights])
    with _both(path, beside) as (graph, text):
        graph.write(proto)
        json.dump(metadata(model, character, weights), text)
    return check


def _checked(model: MotionModel, graph: bytes, character: str, tolerance: float) -> ExportCheck | None:
    """check_export, None without onnxruntime; raises ModelError for joints further apart than tolerance (cm)."""
    try:
        import onnxruntime
    except ImportError:
        return None
    check = check_export(model, graph, character)
    if not check.positions <= tolerance:  # NaN is not
        raise ModelError(
            f"nothing written: in {check.frames} frames of the graph in ONNX Runtime {onnxruntime.__version__} joints "
            f"differ from motionkit's by {check.positions:.3g} cm, expected at most {tolerance:g}"
        )
    return check


class OnnxStep:
    """The graph in ONNX Runtime, one character, its state kept between steps.

    Arrays are bound to the graph once; state has two places, which take turns in going in and coming out.
    Dictionaries of arrays for and from every run would take longer than some of the network.
    """

    def __init__(self, graph: str | Path | bytes, threads: int = 1) -> None:
        """graph is its file, or what is in it."""
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(
            graph if isinstance(graph, bytes) else str(graph), options, ["CPUExecutionProvider"]
        )
        given, made = (
            {value.name: np.zeros(value.shape, np.float32) for value in values}
            for values in (self.session.get_inputs(), self.session.get_outputs())
        )
        state = [name for name in given if present_name(name) in made]
        turned_in = given | {name: made[present_name(name)] for name in state}
        turned_out = made | {present_name(name): given[name] for name in state}
        self._turns = [(i, o, self._bound(i, o)) for i, o in ((given, made), (turned_in, turned_out))]

    def _bound(self, given: dict[str, np.ndarray], made: dict[str, np.ndarray]) -> Any:
        import onnxruntime

        binding = self.session.io_binding()
        for arrays, bind in ((given, binding.bind_ortvalue_input), (made, binding.bind_ortvalue_output)):
            for name, array in arrays.items():
                bind(name, onnxruntime.OrtValue.ortvalue_from_numpy(array))
        return binding

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Controls and state that the next step takes in, to be written into."""
        return self._turns[0][0]

    def step(self) -> dict[str, np.ndarray]:
        """Run on values and move the state on; what it answers is overwritten by the steps after."""
        _, made, binding = self._turns[0]
        self.session.run_with_iobinding(binding)
        self._turns.reverse()
        return made


def check_export(
    model: MotionModel, graph_file: str | Path | bytes, character: str, frames: int = 600
) -> ExportCheck:
    """Both from the same start with the same controls and noise, each going on from its own frames.

    Raises ModelError for a model that does not move in motionkit either.
    """
    kind = model_first_type(model)
    start = type_start(model, kind, 1)
    weights = np.zeros((1, len(model.types)), np.float32)
    weights[0, model.type_id(kind)] = 1.0
    state = RolloutState(model, 1, Noise("mean"))
    state.network = NetworkStep(pack(model.network), 1)
    state.start(start.features, start.contacts, weights)
    graph = OnnxStep(graph_file)
    graph.values["type_weights"][:] = weights
    graph.values["phase"][:], graph.values["slip_correction"][:] = -1.0, 1.0
    x = model.scaling.normalize(start.features)
    for t in range(x.shape[1]):
        graph.values["pose"][:], graph.values["contacts"][:] = x[:, t], start.contacts[:, t]
        if t + 1 < x.shape[1]:
            graph.step()
    graph.values["ground"][:] = graph.values["rise"][:] = 0.0
    decoder = PoseDecoder(model.config.layout, model.reference_rotations)
    skeleton = model.character(character)
    share = np.array([leg_length(skeleton) / leg_length(model.character("default"))], np.float32)
    body = BodyKinematics(skeleton.offsets[None])
    height_correction = HeightCorrection(model.config.layout, 1)
    near = last_poses(model, start.features[0])
    played = plan_signals(model, [TypePart(kind, frames / model.fps)], near)
    way, given = np.zeros((1, TRAJECTORY_COUNT), np.float32), np.zeros(1, np.float32)
    none = np.full(1, -1.0, np.float32)
    apart, features = np.zeros(frames), np.zeros(frames)
    for frame in range(frames):
        reference, reference_gain = (
            played.reference[frame : frame + 1],
            played.reference_gain[frame : frame + 1],
        )
        graph.values["reference"][:], graph.values["reference_gain"][:] = reference, reference_gain[:, None]
        ours, _, ground = state.step(FrameControls(weights, way, given, none, reference, reference_gain))
        rotations, root = decoder.decode(ours, ground)
        root *= share
        world = body.forward(rotations, root)
        height_correction.apply(ours, root, world, share)
        made = graph.step()
        apart[frame] = np.linalg.norm(made["positions"] - world[..., :3, 3], axis=-1).max()
        features[frame] = np.abs(made["present_pose"] - state.normalised).max()
    # Timed by itself: side by side each pushes the other's weights out of the cache.
    began = time.perf_counter()
    for _ in range(frames):
        graph.step()
    rate = frames / (time.perf_counter() - began)
    return ExportCheck(frames, float(apart.max()), float(features.max()), rate)  # NaN stays NaN
