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
from motionkit.errors import MotionkitError
from motionkit.features.control import TRAJECTORY_COUNT, TRAJECTORY_OFFSETS, skeleton_signal
from motionkit.features.guide import GUIDE_COUNT, GUIDE_OFFSETS
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, column_names, feature_layout
from motionkit.files import atomic_write
from motionkit.models.checkpoint import MotionModel
from motionkit.models.step import NetworkStep
from motionkit.models.step_weights import NORM_EPS, ModuleWeights, StepWeights, pack
from motionkit.motion.skeleton import JOINT_COUNT, canonical_skeleton, leg_length
from motionkit.synthesis.character import model_first_type
from motionkit.synthesis.outline_player import last_poses
from motionkit.synthesis.plan import TypePart, plan_signals
from motionkit.synthesis.pose import FROM_CONSTANT, FROM_MATRIX, LEFT, TO_MATRIX, BodyKinematics, PoseDecoder
from motionkit.synthesis.rollout import FrameControls, Noise, RolloutState
from motionkit.synthesis.start import seed_start

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto, TensorProto

OPSET = 17
FORMAT = "motionkit-onnx-2"
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


def _onnx() -> Any:
    try:
        import onnx
    except ImportError:
        raise MotionkitError("ONNX export needs the onnx package: pip install 'motionkit[onnx]'") from None
    return onnx


class _Graph:
    """Nodes and constants in the order in which they are made."""

    def __init__(self) -> None:
        self.onnx = _onnx()
        self.nodes: list[NodeProto] = []
        self.constants: dict[str, TensorProto] = {}

    def constant(self, values: Any, dtype: Any = np.float32) -> str:
        """The name of a constant; equal ones are kept once."""
        array = np.ascontiguousarray(values, dtype)
        name = f"c{len(self.constants)}"
        for known, tensor in self.constants.items():
            if array.size < 64 and tensor.raw_data == array.tobytes() and tuple(tensor.dims) == array.shape:
                if tensor.data_type == self.onnx.helper.np_dtype_to_tensor_dtype(array.dtype):
                    return known
        self.constants[name] = self.onnx.numpy_helper.from_array(array, name)
        return name

    def add(self, kind: str, *inputs: str | Any, out: str | None = None, **attributes: Any) -> str:
        """A node with one output, whose name it answers; arrays and numbers become constants."""
        return self.split(kind, *inputs, outs=[out or f"n{len(self.nodes)}"], **attributes)[0]

    def split(self, kind: str, *inputs: str | Any, outs: list[str], **attributes: Any) -> list[str]:
        """A node with named outputs."""
        names = [i if isinstance(i, str) else self.constant(i) for i in inputs]
        self.nodes.append(self.onnx.helper.make_node(kind, names, outs, **attributes))
        return outs

    def reshape(self, value: str, *shape: int) -> str:
        """The same numbers in another shape."""
        return self.add("Reshape", value, self.constant(shape, np.int64))

    def columns(self, value: str, first: int, last: int) -> str:
        """Columns first to last (exclusive) of the last axis."""
        bounds = (self.constant([n], np.int64) for n in (first, last, -1))
        return self.add("Slice", value, *bounds)


def state_shapes(weights: StepWeights) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the state that goes in as NAME and comes out as present NAME.

    Keys and values follow the convention past_key_values.N.key, heads of all parts side by side.
    """
    config, (P, _) = weights.config, weights.columns.shape
    ring = (1, P * config.heads, config.window - 1, config.width // config.heads)
    shapes: dict[str, tuple[int, ...]] = {
        "pose": (1, FEATURE_COUNT),
        "contacts": (1, CONTACT_COUNT),
        "ground": (1, 3),
        "past_frames": (1, max(config.kernel - 1, 1), FEATURE_COUNT + CONTACT_COUNT),
        "frames_seen": (1, 1),
    }
    for layer in range(2 * config.layers):
        shapes[f"past_key_values.{layer}.key"] = shapes[f"past_key_values.{layer}.value"] = ring
    return shapes


def present_name(name: str) -> str:
    """What a state is called where it comes out: present.0.key for past_key_values.0.key."""
    return (
        name.replace("past_key_values", "present") if "." in name else f"present_{name.removeprefix('past_')}"
    )


def build_graph(model: MotionModel, character: str = "default") -> ModelProto:
    """The graph of one step on a character's body, with its metadata.

    Raises:
        ModelError: if the model cannot run frame by frame on packed weights.
        ControlError: for an unknown character.
    """
    weights = pack(model.network)
    graph = _Graph()
    helper, kinds = graph.onnx.helper, graph.onnx.TensorProto
    inputs = {**state_shapes(weights), "type_weights": (1, len(model.types))}
    inputs |= {name: shape for name, (shape, _) in CONTROLS.items()}
    outputs = {present_name(name): shape for name, shape in state_shapes(weights).items()}
    outputs |= {name: shape for name, (shape, _) in OUTPUTS.items()}
    _write_step(graph, model, weights, character)

    def described(shapes: dict[str, tuple[int, ...]]) -> list:
        return [helper.make_tensor_value_info(name, kinds.FLOAT, shape) for name, shape in shapes.items()]

    made = helper.make_graph(
        graph.nodes, "motionkit", described(inputs), described(outputs), list(graph.constants.values())
    )
    proto = helper.make_model(
        made, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="motionkit", ir_version=8
    )
    proto.producer_version = __version__
    helper.set_model_props(proto, {"motionkit": json.dumps(metadata(model, character, starts=False))})
    graph.onnx.checker.check_model(proto)
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


# ---- the graph ----


def _write_step(g: _Graph, model: MotionModel, weights: StepWeights, character: str) -> None:
    config = weights.config
    controls = _control_vector(g, model)
    recent = _recent_frames(g, config.kernel)
    window = config.window
    # Rings are shifted, the newest last; places that no frame has reached yet do not count.
    seen = g.add("Add", "frames_seen", np.ones((1, 1)), out="present_frames_seen")
    distance = np.arange(window - 1, -1, -1, dtype=np.float32)[None]
    empty = g.add("Mul", g.add("Cast", g.add("GreaterOrEqual", distance, seen), to=1), np.full((1, 1), -1e9))
    position = np.concatenate([weights.shallow.position, weights.deep.position])
    position = position[..., ::-1].reshape(2 * config.layers, -1, 1, window)
    bias = g.add("Add", position, g.reshape(empty, 1, 1, 1, window))
    names = [f"bias{i}" for i in range(2 * config.layers)]
    biases = g.split("Split", bias, g.constant([1] * len(names), np.int64), outs=names, axis=0)
    P = len(weights.columns)
    place = weights.columns + (FEATURE_COUNT + CONTACT_COUNT + 1) * np.arange(config.kernel)[:, None, None]
    inputs = g.add("Gather", recent, g.constant(place.swapaxes(0, 1).reshape(P, 1, -1), np.int64), axis=0)
    shallow = _module(g, weights.shallow, weights, inputs, controls, biases, 0)
    deep = _module(g, weights.deep, weights, g.reshape(shallow, 1, 1, -1), controls, biases, config.layers)
    flat = g.reshape(deep, 1, -1)
    head = g.add("Add", g.add("MatMul", flat, weights.head), weights.head_bias)
    sizes = [FEATURE_COUNT, FEATURE_COUNT, config.contact_hidden]
    mean, sigma, hidden = g.split(
        "Split", head, g.constant(sizes, np.int64), outs=["head_mean", "head_sigma", "head_feet"], axis=1
    )
    hidden = g.add("Add", hidden, g.add("MatMul", g.reshape(shallow, 1, -1), weights.contact_shallow))
    logits = g.add("MatMul", g.add("Relu", hidden), weights.contact)
    g.add("Sigmoid", g.add("Add", logits, weights.contact_bias), out="present_contacts")
    mean = g.add("Add", mean, g.add("Mul", "pose", np.float32(config.head_leak)))
    if weights.momentum is not None:
        before = g.columns(
            g.reshape(g.add("Gather", "past_frames", g.constant(-1, np.int64), axis=1), 1, -1),
            0,
            FEATURE_COUNT,
        )
        first = g.add("Less", "frames_seen", np.full((1, 1), 0.5))
        before = g.add("Where", first, "pose", before)
        mean = g.add("Add", mean, g.add("Mul", g.add("Sub", "pose", before), weights.momentum))
    low, high = np.float32(config.log_sigma_min), np.float32(config.log_sigma_max)
    sigma = g.add("Exp", g.add("Clip", sigma, low, high))
    pose = g.add("Add", mean, g.add("Mul", "noise", sigma), out="present_pose")
    std, middle = model.scaling.std.numpy(), model.scaling.mean.numpy()
    features = g.add("Add", g.add("Mul", pose, std), middle, out="features")
    _write_body(g, model, features, character)


def _control_vector(g: _Graph, model: MotionModel) -> str:
    scaling = model.trajectory_scaling
    shown = g.add("Div", g.add("Sub", "trajectory", scaling.mean.numpy()), scaling.std.numpy())
    shown = g.add("Mul", shown, "given")
    angle = g.add("Mul", "progress", np.float32(2.0 * np.pi))
    has_phase = g.add("Cast", g.add("GreaterOrEqual", "progress", np.zeros((1, 1))), to=1)
    turns = [g.add("Mul", g.add(kind, angle), has_phase) for kind in ("Sin", "Cos")]
    skeleton = skeleton_signal(canonical_skeleton()).numpy()[None]
    guides = model.guide_map
    present = g.add("Add", g.add("MatMul", "pose", guides.matrix.numpy()), guides.constant.numpy())
    guide = g.add("Mul", g.add("Sub", g.add("Mul", "guide", guides.gains.numpy()), present), "guided")
    flag = g.add("Cast", g.add("Greater", "guided", np.zeros((1, 1))), to=1)
    return g.add("Concat", g.constant(skeleton), "type_weights", shown, "given", *turns, guide, flag, axis=1)


def _recent_frames(g: _Graph, kernel: int) -> str:
    """The last inputs one after another, each with a zero behind it, oldest first; writes present_frames."""
    now = g.add("Unsqueeze", g.add("Concat", "pose", "contacts", axis=1), g.constant([1], np.int64))
    if kernel > 1:
        frames = g.add("Concat", "past_frames", now, axis=1)
        bounds = (g.constant([n], np.int64) for n in (1, kernel, 1))
        g.add("Slice", frames, *bounds, out="present_frames")
    else:
        frames = g.add("Identity", now, out="present_frames")
    zeros = np.zeros((1, kernel, 1), np.float32)
    return g.reshape(g.add("Concat", frames, zeros, axis=2), -1)


def _module(
    g: _Graph,
    weights: ModuleWeights,
    step: StepWeights,
    inputs: str,
    controls: str,
    biases: list[str],
    first_layer: int,
) -> str:
    """Features (P, 1, D) without their sqrt(D) of one auto-regressive module from inputs (P or 1, 1, N)."""
    config, P = step.config, len(step.columns)
    D, H = config.width, config.heads
    E = D // H
    x = g.add("Add", g.add("MatMul", inputs, weights.embed), weights.embed_bias[:, None])
    embedded = g.add("MatMul", g.reshape(controls, 1, 1, -1), weights.controls)
    embedded = g.add("Add", embedded, weights.controls_bias[:, None])
    added = g.add("MatMul", embedded, weights.layer_controls)
    count = weights.layer_controls.shape[-1] // D
    names = [f"added{first_layer + i}" for i in range(count)]
    blocks = g.split("Split", added, g.constant([D] * count, np.int64), outs=names, axis=2)

    def norm(value: str) -> str:
        return g.add("LayerNormalization", value, np.full(D, D**-0.5), axis=-1, epsilon=NORM_EPS)

    for i in range(config.layers):
        layer = first_layer + i
        if i < count:
            x = g.add("Add", x, blocks[i])
        qkv = g.add("Add", g.add("MatMul", norm(x), weights.qkv[i]), weights.qkv_bias[i][:, None])
        outs = [f"{name}{layer}" for name in "qkv"]
        q, k, v = g.split("Split", qkv, g.constant([D] * 3, np.int64), outs=outs, axis=2)
        rings = []
        for name, new in (("key", k), ("value", v)):
            past = f"past_key_values.{layer}.{name}"
            ring = g.add("Concat", past, g.reshape(new, 1, P * H, 1, E), axis=2)
            bounds = (g.constant([n], np.int64) for n in (1, config.window, 2))
            g.add("Slice", ring, *bounds, out=present_name(past))
            rings.append(ring)
        scores = g.add("MatMul", rings[0], g.reshape(q, 1, P * H, E, 1))
        scores = g.add("Add", g.reshape(scores, 1, P * H, 1, config.window), biases[layer])
        mixed = g.add("MatMul", g.add("Softmax", scores, axis=-1), rings[1])
        x = g.add("Add", x, g.add("MatMul", g.reshape(mixed, P, 1, D), weights.out[i]))
        hidden = g.add("Add", g.add("MatMul", norm(x), weights.inner[i]), weights.inner_bias[i][:, None])
        x = g.add("Add", x, g.add("MatMul", g.add("Relu", hidden), weights.outer[i]))
    return norm(x)


def _write_body(g: _Graph, model: MotionModel, features: str, character: str) -> None:
    """Ground, rotations, root and joints of the frame, as synthesis/pose.py has them."""
    layout = feature_layout(model.config.layout)
    blocks, fps = layout.blocks, np.float32(model.fps)
    continuous = layout.version.startswith("sixd")
    skeleton = model.character(character)
    share = np.float32(leg_length(skeleton) / leg_length(model.character("default")))

    def block(name: str) -> str:
        return g.columns(features, blocks[name].start, blocks[name].stop)

    yaw = g.add("Add", g.columns("ground", 2, 3), g.add("Div", block("root_yaw_velocity"), fps))
    sine, cosine = g.add("Sin", yaw), g.add("Cos", yaw)
    velocity = g.reshape(g.add("Div", block("root_xz_velocity"), fps), 1, 2, 1)
    turn = g.reshape(g.add("Concat", cosine, sine, g.add("Neg", sine), cosine, axis=1), 1, 2, 2)
    moved = g.add("Add", g.columns("ground", 0, 2), g.reshape(g.add("MatMul", turn, velocity), 1, 2))
    g.add("Concat", moved, yaw, axis=1, out="present_ground")
    if continuous:
        facing = _matrix_to_quat(g, _sixd_to_matrix(g, block("root_rotation")))
    else:
        facing = g.reshape(_expmap_to_quat(g, g.reshape(block("root_rotation"), 1, 3)), 1, 1, 4)
    half = g.add("Mul", yaw, np.float32(0.5))
    zero = g.constant(np.zeros((1, 1)))
    heading = g.add("Concat", g.add("Cos", half), zero, g.add("Sin", half), zero, axis=1)
    left = g.reshape(g.add("MatMul", heading, LEFT), 1, 4, 4)
    root_turn = g.reshape(g.add("MatMul", facing, left), 1, 1, 4)
    joints = _expmap_to_quat(g, g.reshape(block("joint_rotations"), JOINT_COUNT - 1, 3))
    references = (model.references.numpy()[1:] @ LEFT).reshape(-1, 4, 4)
    joints = g.add("MatMul", g.reshape(joints, JOINT_COUNT - 1, 1, 4), references)
    rotations = g.add("Concat", root_turn, g.reshape(joints, 1, JOINT_COUNT - 1, 4), axis=1, out="rotations")
    height = blocks["joint_positions"].start + (0 if continuous else 1)
    at = g.columns(features, height, height + 1)
    root = g.add("Concat", g.columns(moved, 0, 1), at, g.columns(moved, 1, 2), axis=1)
    root = g.add("Mul", root, share, out="root_positions")
    # Local transforms (24, 4, 4), the last an identity, multiplied up the chains in three rounds.
    column, row = g.reshape(rotations, JOINT_COUNT, 4, 1), g.reshape(rotations, JOINT_COUNT, 1, 4)
    products = g.reshape(g.add("Mul", column, row), JOINT_COUNT, 16)
    matrices = g.reshape(g.add("MatMul", products, TO_MATRIX), JOINT_COUNT, 3, 3)
    offsets = g.constant(skeleton.offsets.numpy()[1:, :, None])
    places = g.add("Concat", g.reshape(root, 1, 3, 1), offsets, axis=0)
    local = g.add("Concat", matrices, places, axis=2)
    bottom = np.tile(np.array([[[0, 0, 0, 1]]], np.float32), (JOINT_COUNT, 1, 1))
    whole = g.add("Concat", g.add("Concat", local, bottom, axis=1), np.eye(4)[None], axis=0)
    for ancestors in BodyKinematics.ROUNDS:
        above = g.add("Gather", whole, g.constant(ancestors, np.int64), axis=0)
        whole = g.add("MatMul", above, whole)
    last = g.reshape(g.columns(whole, 3, 4), 1, JOINT_COUNT + 1, 4)
    bounds = (g.constant(n, np.int64) for n in ([0, 0], [JOINT_COUNT, 3], [1, 2]))
    g.add("Slice", last, *bounds, out="positions")


def _expmap_to_quat(g: _Graph, expmap: str) -> str:
    """Quaternions (N, 4) of exponential maps (N, 3)."""
    axes = g.constant([1], np.int64)
    squared = g.add("ReduceSum", g.add("Mul", expmap, expmap), axes, keepdims=1)
    half = g.add("Max", g.add("Mul", g.add("Sqrt", squared), np.float32(0.5)), np.float32(1e-12))
    scale = g.add("Div", g.add("Sin", half), g.add("Mul", half, np.float32(2.0)))
    return g.add("Concat", g.add("Cos", half), g.add("Mul", expmap, scale), axis=1)


def _sixd_to_matrix(g: _Graph, sixd: str) -> str:
    """A rotation matrix (1, 9), row by row, of its first two columns (1, 6)."""
    axes = g.constant([1], np.int64)

    def dot(a: str, b: str) -> str:
        return g.add("ReduceSum", g.add("Mul", a, b), axes, keepdims=1)

    def unit(a: str) -> str:
        return g.add("Div", a, g.add("Max", g.add("Sqrt", dot(a, a)), np.float32(1e-8)))

    def turned(a: str, order: list[int]) -> str:
        return g.add("Gather", a, g.constant(order, np.int64), axis=1)

    first = unit(g.columns(sixd, 0, 3))
    second = g.columns(sixd, 3, 6)
    second = unit(g.add("Sub", second, g.add("Mul", dot(first, second), first)))
    ahead = g.add("Mul", turned(first, [1, 2, 0]), turned(second, [2, 0, 1]))
    third = g.add("Sub", ahead, g.add("Mul", turned(first, [2, 0, 1]), turned(second, [1, 2, 0])))
    columns = [g.reshape(c, 1, 3, 1) for c in (first, second, third)]
    return g.reshape(g.add("Concat", *columns, axis=2), 1, 9)


def _matrix_to_quat(g: _Graph, matrix: str) -> str:
    """The quaternion (1, 1, 4) of a rotation matrix (1, 9)."""
    outer = g.add("Add", g.add("MatMul", matrix, FROM_MATRIX), FROM_CONSTANT)
    diagonal = g.add("Gather", outer, g.constant([0, 5, 10, 15], np.int64), axis=1)
    largest = g.add("ArgMax", diagonal, axis=1, keepdims=0)
    quat = g.add("Gather", g.reshape(outer, 4, 4), largest, axis=0)
    size = g.add("Sqrt", g.add("ReduceSum", g.add("Mul", quat, quat), g.constant([1], np.int64), keepdims=1))
    quat = g.add("Div", quat, size)
    positive = g.add("Cast", g.add("GreaterOrEqual", g.columns(quat, 0, 1), np.zeros((1, 1))), to=1)
    sign = g.add("Sub", g.add("Mul", positive, np.float32(2.0)), np.float32(1.0))
    return g.reshape(g.add("Mul", quat, sign), 1, 1, 4)


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
