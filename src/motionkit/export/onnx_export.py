"""One frame of a model as an ONNX graph for engines: controls and state in, global pose and next state out.

The graph is built node by node from the packed weights (inference/step_weights.py). It includes normalization, root
integration and forward kinematics, with static shapes and a batch of one. docs/onnx.md explains its use.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motionkit.arrays import Array
from motionkit.control.character_start import StartState, last_poses
from motionkit.control.plan import plan_types
from motionkit.control.planned_controls import plan_controls
from motionkit.control.script import TypePart
from motionkit.errors import ModelError, MotionkitError, OverwriteError
from motionkit.export.onnx_body import write_body
from motionkit.export.onnx_graph import Graph
from motionkit.export.onnx_network import present_name, state_shapes, write_network
from motionkit.features.control import TRAJECTORY_COUNT, TRAJECTORY_OFFSETS, Controls
from motionkit.features.layout import FEATURE_COUNT, column_names
from motionkit.features.reference import REFERENCE_COUNT, REFERENCE_OFFSETS
from motionkit.files import read_json, write_together
from motionkit.inference.character import model_first_type
from motionkit.inference.frame_arrays import BodyArrays
from motionkit.inference.frame_kernel import PoseKernel
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import RolloutState
from motionkit.inference.start import Start, on_body, type_start
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel
from motionkit.inference.step_weights import pack
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.skeleton import JOINT_COUNT
from motionkit.version import __version__

if TYPE_CHECKING:
    from onnx import ModelProto

FORMAT_NAME = "motionkit-onnx-"
FORMAT = f"{FORMAT_NAME}6"
TOLERANCE = 0.5  # cm, largest joint distance between graph and motionkit after ten seconds in closed loop
CHECK_FRAMES = 600  # length of the check before a graph is written
REFERENCE_SECONDS = 12.0  # least seconds of reference clips per type in the metadata; clips are kept whole


def _listed(numbers: tuple[int, ...]) -> str:
    return f"{', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"


# Inputs besides the state: shape and meaning.
CONTROLS: dict[str, tuple[tuple[int, ...], str]] = {
    "trajectory": (
        (1, TRAJECTORY_COUNT),
        f"requested root after {_listed(TRAJECTORY_OFFSETS)} frames, in the facing frame: x, z of each in cm, then "
        "facing x, z of each",
    ),
    "trajectory_mask": ((1, 1), "1 to follow the trajectory, 0 to ignore it"),
    "phase": ((1, 1), "0 to 1 over a performance of a type with a phase; -1 for other types"),
    "reference": (
        (1, REFERENCE_COUNT),
        f"pose embeddings of a reference clip {_listed(REFERENCE_OFFSETS)} frames ahead, one after another",
    ),
    "reference_gain": (
        (1, 1),
        "reference gain; 0 without reference poses",
    ),
    "slip_correction": (
        (1, 1),
        "factor on the type's root-slip correction: 1, or 0 on a path, where the trajectory matters more",
    ),
    "noise": (
        (1, FEATURE_COUNT),
        "standard normal numbers times the temperature and the type's noise_scale; zeros give the mean",
    ),
}
OUTPUTS: dict[str, tuple[tuple[int, ...], str]] = {
    "positions": ((1, JOINT_COUNT, 3), "global joint positions in cm"),
    "rotations": ((1, JOINT_COUNT, 4), "local rotations as quaternions w, x, y, z"),
    "root_positions": ((1, 3), "global position of the hips in cm"),
    "features": ((1, FEATURE_COUNT), "the 276 features, not normalised"),
}


def build_graph(model: MotionModel, character: str = "default") -> ModelProto:
    """The ONNX graph of one frame for a character's body, with its metadata.

    Raises:
        ModelError: the model's weights cannot be packed.
        ControlError: the character is unknown.
    """
    packed = pack(model.network)
    graph = Graph()
    inputs = {**state_shapes(packed), "type_weights": (1, len(model.types))}
    inputs |= {name: shape for name, (shape, _) in CONTROLS.items()}
    outputs = {present_name(name): shape for name, shape in state_shapes(packed).items()}
    outputs |= {name: shape for name, (shape, _) in OUTPUTS.items()}
    features = write_network(graph, model, packed, model.moved_skeleton(character))
    write_body(graph, model, features, character)
    described = json.dumps(metadata(model, character, starts=False))
    return graph.model(inputs, outputs, __version__, {"motionkit": described})


def metadata(model: MotionModel, character: str = "default", starts: bool = True) -> dict[str, Any]:
    """What an engine needs besides the graph; `starts` adds start poses and reference clips of each type."""
    skeleton = model.character(character)
    shapes = state_shapes(pack(model.network))
    described = {
        "format": FORMAT,
        "motionkit": __version__,
        "weights": "float32",
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
        "steered": [name for name in model.types if model.kind(name).steered],
        "trajectory_frames": list(TRAJECTORY_OFFSETS),
        "reference_frames": list(REFERENCE_OFFSETS),
        "uses_references": model.uses_references,
        "reference_gain": {name: kind.preset.reference_gain for name, kind in model.types.items()},
        "noise_scale": {name: kind.preset.noise_scale for name, kind in model.types.items()},
        "noise_alone": {
            name: kind.preset.without_references.noise_scale for name, kind in model.types.items()
        },
        "controls": {
            "type_weights": {
                "shape": [1, len(model.types)],
                "what": "weights of the types; they add up to 1",
            },
            **{name: {"shape": list(shape), "what": what} for name, (shape, what) in CONTROLS.items()},
        },
        "state": {name: {"shape": list(shape), "out": present_name(name)} for name, shape in shapes.items()},
        "outputs": {name: {"shape": list(shape), "what": what} for name, (shape, what) in OUTPUTS.items()},
        "contacts": ["left foot", "left toe", "right foot", "right toe"],
        "features": column_names(model.config.layout),
    }
    if starts:
        known = [name for name, kind in model.types.items() if kind.start_poses]
        described["starts"] = {name: _start(model, name, character) for name in known}
        described["reference_clips"] = {kind: _reference_clips(model, kind) for kind in model.types}
    return described


def _start(model: MotionModel, kind: str, character: str) -> dict[str, list]:
    """The first start pose of a type, on the character's body if the network is given that body."""
    start = on_body(model, type_start(model, kind), model.moved_skeleton(character))
    return {
        "pose": _rounded(model.scaling.normalize(start.features[0]), 4),
        "contacts": _rounded(start.contacts[0], 0),
    }


def _reference_clips(model: MotionModel, kind: str) -> list[dict[str, list]]:
    """Pose embeddings of a type's reference clips; performances also get their ground track."""
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
    return np.round(values.astype(np.float64), digits).tolist()


# ---- export and check ----


@dataclass(frozen=True)
class ExportCheck:
    """Largest differences between the graph and motionkit when each runs in closed loop.

    Attributes:
        frames: number of compared frames.
        positions: largest distance of a joint in cm.
        features: largest difference of a normalised feature.
        frames_per_second: speed of the graph in ONNX Runtime on one core.
    """

    frames: int
    positions: float
    features: float
    frames_per_second: float


def metadata_path(path: str | Path) -> Path:
    """The path of a graph's metadata: the same name with .json.

    Raises:
        OverwriteError: that path is the graph itself.
        MotionkitError: the name is empty, or the path is a file that export did not write.
    """
    path = Path(path)
    if not path.name:
        raise MotionkitError("--onnx: expected a file name for the graph, found an empty name")
    if path.name.lower().endswith(".json"):
        raise OverwriteError(
            f"{path}: the metadata are written to this file; give the graph another ending, such as .onnx"
        )
    beside = path.with_suffix(".json")
    if beside.is_file() and not _is_metadata(beside):
        raise MotionkitError(
            f"{beside}: exists and was not written by export; move it or choose another name for the graph"
        )
    return beside


def _is_metadata(path: Path) -> bool:
    try:
        described = read_json(path)
    except MotionkitError:
        return False
    return isinstance(described, dict) and str(described.get("format", "")).startswith(FORMAT_NAME)


def export_onnx(model: MotionModel, path: str | Path, character: str = "default") -> ExportCheck | None:
    """Check the graph against motionkit, then write the graph and its metadata (same name with .json).

    Returns:
        The result of the check; None without onnxruntime.

    Raises:
        ModelError: the model cannot be exported or does not move, or the graph differs from motionkit.
        ControlError: the character is unknown.
        MotionkitError: a file cannot be written, or another file is in the way. Existing files stay unchanged.
    """
    path = Path(path)
    beside = metadata_path(path)
    proto = build_graph(model, character).SerializeToString()
    check = _checked(model, proto, character)
    write_together({beside: json.dumps(metadata(model, character)).encode(), path: proto})
    return check


def _checked(model: MotionModel, graph: bytes, character: str) -> ExportCheck | None:
    """Run check_export; None without onnxruntime. Raises ModelError if joints differ by more than TOLERANCE."""
    try:
        import onnxruntime
    except ImportError:
        return None
    check = check_export(model, graph, character, CHECK_FRAMES)
    if not check.positions <= TOLERANCE:  # NaN fails as well
        raise ModelError(
            f"nothing written: in {check.frames} frames in ONNX Runtime {onnxruntime.__version__} joints of the graph "
            f"differ from motionkit's by {check.positions:.3g} cm, expected at most {TOLERANCE:g}"
        )
    return check


class OnnxStep:
    """The graph in ONNX Runtime for one character; keeps the state between frames.

    Arrays are bound to the graph once: new dictionaries of arrays in every frame would cost more time than parts of the
    network. The state has two buffers, which alternate between input and output.
    """

    def __init__(self, graph: str | Path | bytes) -> None:
        """graph is a file, or its bytes."""
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(
            graph if isinstance(graph, bytes) else str(graph), options, ["CPUExecutionProvider"]
        )
        inputs, made = (
            {value.name: np.zeros(value.shape, np.float32) for value in values}
            for values in (self.session.get_inputs(), self.session.get_outputs())
        )
        state = [name for name in inputs if present_name(name) in made]
        turned_in = inputs | {name: made[present_name(name)] for name in state}
        turned_out = made | {present_name(name): inputs[name] for name in state}
        self._turns = [(i, o, self._bound(i, o)) for i, o in ((inputs, made), (turned_in, turned_out))]

    def _bound(self, inputs: dict[str, np.ndarray], made: dict[str, np.ndarray]) -> Any:
        import onnxruntime

        binding = self.session.io_binding()
        for arrays, bind in ((inputs, binding.bind_ortvalue_input), (made, binding.bind_ortvalue_output)):
            for name, array in arrays.items():
                bind(name, onnxruntime.OrtValue.ortvalue_from_numpy(array))
        return binding

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Controls and state of the next frame; write into these arrays."""
        return self._turns[0][0]

    def step(self) -> dict[str, np.ndarray]:
        """Compute one frame from values and return its outputs. Later calls overwrite them."""
        _, made, binding = self._turns[0]
        self.session.run_with_iobinding(binding)
        self._turns.reverse()
        return made


def every_control(model: MotionModel, frames: int) -> list[Controls]:
    """Controls of one character in which every control changes, to compare implementations of a frame.

    Up to four types blend into each other: the first, one with a gait, a performance, and one with references. Their
    recordings give references and phases. Trajectories, references and the root-slip correction switch on and off.
    """
    first = model_first_type(model)
    others = {name: kind.kind for name, kind in model.types.items() if name != first}
    gaits = [name for name, kind in others.items() if kind.steered]
    performances = [name for name, kind in others.items() if kind is MotionKind.PERFORMANCE]
    recorded = [name for name in others if model.types[name].reference_clips]
    free = [name for name in recorded if name not in (*gaits, *performances)]
    kinds = list(dict.fromkeys([first, *gaits[:1], *performances[:1], *free[:1]]))
    parts = [TypePart(kind, frames / len(kinds) / model.fps) for kind in kinds]
    near = last_poses(model, type_start(model, first).features[0])
    played = plan_controls(model, plan_types(model, parts, StartState(near)))
    steps = np.array(TRAJECTORY_OFFSETS, np.float32) / model.fps
    out = []
    for frame in range(frames):
        row = min(frame, len(played.phase) - 1)
        now = played.at(slice(row, row + 1))
        # Performances without their own trajectory: alternate between none and a slow curve.
        angle = 0.5 * np.sin(frame / 40.0)
        forward = np.array([np.sin(angle), np.cos(angle)], np.float32)
        curve = np.concatenate([np.outer(100.0 * steps, forward).ravel(), np.tile(forward, len(steps))])[None]
        changed = {
            "trajectory_mask": np.maximum(now.trajectory_mask, np.float32(frame // 45 % 2)),
            "trajectory": np.where(
                now.trajectory_mask[:, None] > 0, now.trajectory, curve.astype(np.float32)
            ),
            "slip_correction": np.full(1, (1.0, 0.5, 0.0)[frame // 30 % 3], np.float32),
            "reference_gain": now.reference_gain * np.float32(frame % 100 < 80),
        }
        out.append(replace(now, **changed))
    return out


def set_controls(graph: OnnxStep, controls: Controls, noise: Array) -> None:
    """Set the controls of one character and noise (1, 276) as the graph's inputs."""
    for name, values in vars(controls).items():
        if values is not None:
            graph.values[name][:] = values
    graph.values["noise"][:] = noise


def _start_graph(graph: OnnxStep, model: MotionModel, start: Start, type_weights: Array) -> None:
    """Fill the state with the frames of a start pose, like RolloutState.start."""
    graph.values["type_weights"][:], graph.values["phase"][:] = type_weights, -1.0
    x = model.scaling.normalize(start.features)
    for t in range(x.shape[1]):
        graph.values["pose"][:], graph.values["contacts"][:] = x[:, t], start.contacts[:, t]
        if t + 1 < x.shape[1]:
            graph.step()
    graph.values["ground"][:] = graph.values["rise"][:] = 0.0


def check_export(
    model: MotionModel, graph_file: str | Path | bytes, character: str, frames: int
) -> ExportCheck:
    """Run the graph and motionkit in closed loop, with the same start, noise and controls.

    Raises ModelError if the model does not move in motionkit.
    """
    kind = model_first_type(model)
    start = on_body(model, type_start(model, kind), model.moved_skeleton(character))
    script = every_control(model, frames)
    state = RolloutState(model, 1, Noise())
    state.network = NetworkStep(StepKernel(pack(model.network)), 1)  # float32, like the graph
    state.controls.set_skeletons([model.moved_skeleton(character)])
    state.start(start.features, start.contacts, script[0].type_weights)
    graph = OnnxStep(graph_file)
    _start_graph(graph, model, start, script[0].type_weights)
    body = BodyArrays.of(1, feet=False)
    body.put(0, model.character(character).offsets, model.body_scale(character))
    poser = PoseKernel(model.config.layout, model.reference_rotations, body)
    apart, features = np.zeros(frames), np.zeros(frames)
    for frame, controls in enumerate(script):
        _, _, positions = poser.pose(*state.step(controls))
        set_controls(graph, controls, state.drawing.drawn_noise)
        made = graph.step()
        apart[frame] = np.linalg.norm(made["positions"] - positions, axis=-1).max()
        features[frame] = np.abs(made["present_pose"] - state.frame.x).max()
    # Timed separately: side by side, each evicts the other's weights from the cache.
    began = time.perf_counter()
    for _ in range(frames):
        graph.step()
    rate = frames / (time.perf_counter() - began)
    return ExportCheck(frames, float(apart.max()), float(features.max()), rate)  # NaN stays NaN
