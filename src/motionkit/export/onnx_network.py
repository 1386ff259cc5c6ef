"""The network of one frame as ONNX nodes, built from the packed weights (inference/step_weights.py).

A graph of one frame spends its time on reading weights and on the number of nodes. So constants are folded, and the
rings of keys and values are not shifted: the next frame overwrites the oldest slot.

One matrix product serves all parts. Their maps are placed side by side, (K, P N): each part's row is multiplied by
every map, and the results of other parts are dropped. Or the maps are stacked, (P K, N), and each part's row is zero
outside its own columns. The additional sums are free, because loading the weights takes longer than using them.
Runtimes are fastest at plain matrix products, and in 8 bits support no others.

Shape legend: P parts, L layers, D width, H heads, E head width, F hidden, W window, C controls.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Floats
from motionkit.export.onnx_graph import Graph
from motionkit.export.onnx_slip_correction import hold_ground
from motionkit.features.control import skeleton_signal
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.inference.frame_kernel import blended_columns
from motionkit.inference.step_weights import NORM_EPS, StepWeights
from motionkit.models.model import MotionModel
from motionkit.motion.skeleton import Skeleton

INPUT_COUNT = FEATURE_COUNT + CONTACT_COUNT


def state_shapes(weights: StepWeights) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the state's inputs; present_name gives those of its outputs.

    Keys and values follow the naming past_key_values.N.key; the batch axis holds the parts.
    """
    config, P = weights.config, len(weights.columns)
    ring = (P, config.heads, config.window, config.width // config.heads)
    shapes: dict[str, tuple[int, ...]] = {
        "pose": (1, FEATURE_COUNT),
        "contacts": (1, CONTACT_COUNT),
        "ground": (1, 3),
        "rise": (1, 1),
        "past_frames": (1, max(config.kernel - 1, 1) * INPUT_COUNT),
        "frames_seen": (1, 1),
    }
    for layer in range(2 * config.layers):
        shapes[f"past_key_values.{layer}.key"] = shapes[f"past_key_values.{layer}.value"] = ring
    return shapes


def present_name(name: str) -> str:
    """The output name of a state: present.0.key for past_key_values.0.key."""
    return (
        name.replace("past_key_values", "present") if "." in name else f"present_{name.removeprefix('past_')}"
    )


def write_network(g: Graph, model: MotionModel, weights: StepWeights, skeleton: Skeleton) -> str:
    """Write the nodes from controls and state to the next state, except ground and root-height correction.

    The network is given the skeleton. Returns the name of the unnormalised features (1, 276).
    """
    config, P, D = weights.config, len(weights.columns), weights.config.width
    hidden = config.head.contact_hidden
    step = _Step(g, weights)
    blocks = _control_blocks(step, model, skeleton)
    past = state_shapes(weights)["past_frames"][1]
    # Drop the oldest frame; `before` is the pose of the last one.
    stay = past - INPUT_COUNT
    older = [size for size in (INPUT_COUNT, stay - INPUT_COUNT) if size > 0] if stay else []
    pieces = g.split("past_frames", [*older, FEATURE_COUNT, CONTACT_COUNT], axis=1)
    before = pieces[-2]
    g.add("Concat", *(pieces[1:] if stay else []), "pose", "contacts", axis=1, out="present_frames")
    shallow = step.module(0, step.embed_frames(blocks[0][0]), blocks[0])
    # One product of the shallow features serves both the deep module and the contacts.
    products = g.add(
        "Gemm",
        shallow,
        np.concatenate([_beside(weights.deep.embed), weights.contact_shallow], axis=1),
        np.concatenate([weights.deep.embed_bias.reshape(-1), np.zeros(hidden, np.float32)]),
    )
    deep_input, feet = g.split(products, [P * D, hidden], axis=1)
    deep_input = g.add("Add", g.reshape(deep_input, P, D), blocks[1][0])
    deep = step.module(1, deep_input, blocks[1])
    mean = g.add("Gemm", deep, weights.head[:, :FEATURE_COUNT], weights.head_bias[:FEATURE_COUNT])
    rest = g.add("Gemm", deep, weights.head[:, FEATURE_COUNT:], weights.head_bias[FEATURE_COUNT:])
    sigma, feet_too = g.split(rest, [FEATURE_COUNT, hidden], axis=1)
    feet = g.add("Relu", g.add("Add", feet, feet_too))
    g.add("Sigmoid", g.add("Gemm", feet, weights.contact, weights.contact_bias), out="present_contacts")
    low, high = np.float32(config.head.log_sigma_min), np.float32(config.head.log_sigma_max)
    drawn = g.add("Mul", "noise", g.add("Exp", g.add("Clip", sigma, low, high)))
    terms = [mean, drawn, g.add("Mul", "pose", np.float32(config.head.head_leak))]
    # The first frame has no movement yet.
    moved = g.add("Mul", g.add("Sub", "pose", before), g.add("Min", "frames_seen", np.float32(1.0)))
    if weights.momentum is not None:
        terms.append(g.add("Mul", moved, weights.momentum))
    drawn = g.add("Sum", *terms)
    velocity_blends = model.presets("velocity_blend")[:, None] * blended_columns(config.layout)
    late = g.add("Sub", g.add("Add", "pose", moved), drawn)
    late = g.add("Mul", late, g.add("MatMul", "type_weights", velocity_blends))
    pose = g.add("Add", drawn, late)
    if feature_layout(config.layout).root_is_sixd:
        pose = _keep_rotation(g, model, pose)
    if model.presets("slip_correction").any():
        pose = hold_ground(g, model, pose)
    else:
        g.add("Identity", pose, out="present_pose")
    return g.add("Add", g.add("Mul", pose, model.scaling.std), model.scaling.mean, out="features")


def _keep_rotation(g: Graph, model: MotionModel, drawn: str) -> str:
    """Write a sampled pose (1, 276) with an orthonormal root rotation (two matrix columns), and return its name."""
    start = feature_layout(model.config.layout).blocks["root_rotation"].start
    before, first, second, rest = g.split(drawn, [start, 3, 3, FEATURE_COUNT - start - 6], axis=1)
    root = slice(start, start + 6)
    mean, std = model.scaling.mean[root].reshape(2, 3), model.scaling.std[root].reshape(2, 3)
    first, second = (
        g.add("Gemm", each, np.diag(s), m) for each, m, s in zip((first, second), mean, std, strict=True)
    )
    first = _unit(g, first)
    along = g.add("Gemm", second, first, transB=1)
    second = _unit(g, g.add("Sub", second, g.add("Mul", along, first)))
    columns = (
        g.add("Gemm", each, np.diag(1.0 / s), -m / s)
        for each, m, s in zip((first, second), mean, std, strict=True)
    )
    return g.add("Concat", before, *columns, rest, axis=1)


def _unit(g: Graph, vector: str) -> str:
    """Write a vector (1, 3) scaled to length 1, and return its name."""
    return g.add("Div", vector, g.add("ReduceL2", vector, axes=[1], keepdims=1))


def _control_blocks(step: _Step, model: MotionModel, skeleton: Skeleton) -> list[list[str]]:
    """Write the controls' addition to the input (P, D) of each layer of both modules, and return the names.

    The skeleton is constant. Scales and offsets of the other signals are folded into the map: for a signal (s - m) / d
    with mask g, the map divided by d takes g s, and the constant rest takes g.
    """
    g, weights = step.g, step.weights
    layout, scaling, references = model.controls, model.trajectory_scaling, model.reference_map
    P, modules = len(weights.columns), (weights.shallow, weights.deep)
    embed = np.concatenate([m.controls for m in modules]).transpose(1, 0, 2).astype(np.float64)
    embed = embed.reshape(embed.shape[0], -1)  # (C, 2 P Dc)
    bias = np.concatenate([m.controls_bias for m in modules]).reshape(-1).astype(np.float64)
    bias += skeleton_signal(skeleton).astype(np.float64) @ embed[layout.skeleton]
    trajectory = embed[layout.trajectory] / scaling.std.astype(np.float64)[:, None]
    offset = embed[layout.flag] - scaling.mean.astype(np.float64) @ trajectory
    reference = embed[layout.reference]
    seen = g.add("MatMul", "pose", references.matrix / references.gains)
    differences = g.add("Mul", g.add("Sub", "reference", seen), "reference_gain")
    # Sine and cosine (a quarter turn ahead).
    turns = g.add("Gemm", "phase", np.full((1, 2), 2.0 * np.pi), [0.0, 0.5 * np.pi])
    # 1 for phases of at least zero, else 0: a steep ramp is cheaper than a comparison.
    has_phase = g.add("Gemm", "phase", [[1e6]], [1.0])
    has_phase = g.add("Clip", has_phase, np.float32(0.0), np.float32(1.0))
    turns = g.add("Mul", g.add("Sin", turns), has_phase)
    inputs = g.add(
        "Concat",
        "type_weights",
        g.add("Mul", "trajectory", "trajectory_mask"),
        "trajectory_mask",
        turns,
        differences,
        "reference_gain",
        g.add("Sign", "reference_gain"),
        axis=1,
    )
    rows = [
        embed[layout.type],
        trajectory,
        offset[None],
        embed[layout.phase],
        references.gains.astype(np.float64)[:, None] * reference,
        -(references.constant.astype(np.float64) @ reference)[None],
        embed[layout.reference_gain][None],
    ]
    embedded = g.add("Gemm", inputs, np.concatenate(rows).astype(np.float32), bias.astype(np.float32))
    maps = np.concatenate([m.layer_controls for m in modules])
    added = g.add("MatMul", step.block_diagonal(embedded, 2 * P, maps.shape[1]), _below(maps))
    D = weights.config.width
    count = maps.shape[2] // D
    return [
        g.split(part, [D] * count, axis=1) if count > 1 else [part] for part in g.split(added, [P, P], axis=0)
    ]


class _Step:
    """The two modules for one frame."""

    def __init__(self, g: Graph, weights: StepWeights) -> None:
        self.g, self.weights, self.config = g, weights, weights.config
        config, P, W = self.config, len(weights.columns), weights.config.window
        # Frames are counted up to 2 W - 2, and from W - 1 again. The count tells which slots of the rings are empty,
        # and which is the oldest.
        counts = np.arange(2 * W - 1)
        count = g.add("Cast", "frames_seen", to=g.onnx.TensorProto.INT64)
        g.add("Gather", np.append(counts[1:], W - 1), count, axis=0, out="present_frames_seen")
        count = g.add("Squeeze", count)
        # For each count, the table is contiguous.
        part, head = np.ogrid[:P, : config.heads]
        slot = np.stack(np.broadcast_arrays(part, head, counts[:, None, None] % W), axis=-1)[:, :, :, None]
        self.slot = g.gather(g.constant(slot, np.int64), count, axis=0)  # (P, H, 1, 3)
        distance = (counts[:, None] - np.arange(W)) % W
        position = np.concatenate([weights.shallow.position, weights.deep.position])  # (2 L, P, H, W)
        bias = np.where(distance <= counts[:, None], position[..., distance], np.float32(-1e9))
        bias = bias.reshape(-1, config.heads, 2 * W - 1, W).transpose(2, 0, 1, 3)[:, :, :, None]
        self.biases = g.split(g.gather(bias, count, axis=0), [P] * (2 * config.layers), axis=0)

    def embed_frames(self, controls: str) -> str:
        """Write the first convolution over past and current frames, plus the controls: (P, D)."""
        g, columns, config = self.g, self.weights.columns, self.config
        # The state keeps at least two frames, even for a kernel of one. The final 1 multiplies the biases.
        frames = max(config.kernel, 2)
        recent = g.add("Concat", "past_frames", "pose", "contacts", g.constant([[1.0]]), axis=1)
        first = INPUT_COUNT * (frames - config.kernel + np.arange(config.kernel))
        places, maps = [], []
        for p, mine in enumerate(columns):
            used = mine < INPUT_COUNT  # shorter parts are padded
            places.append(np.append((first[:, None] + mine[used]).reshape(-1), INPUT_COUNT * frames))
            taps = self.weights.shallow.embed[p].reshape(config.kernel, len(mine), -1)[:, used]
            bias = self.weights.shallow.embed_bias[p][None]
            maps.append(np.concatenate([taps.reshape(-1, taps.shape[-1]), bias]))
        mask = _block_mask(len(places), [len(place) for place in places])
        seen = g.add("Mul", g.gather(recent, np.concatenate(places), axis=1), mask)
        return g.add("Gemm", seen, np.concatenate(maps), controls)

    def module(self, index: int, x: str, controls: list[str]) -> str:
        """Write a module: features (1, P D), without their factor sqrt(D), from its first layer's input (P, D)."""
        g, config = self.g, self.config
        weights = (self.weights.shallow, self.weights.deep)[index]
        P, D, H = len(self.weights.columns), config.width, config.heads
        for i in range(config.layers):
            layer = index * config.layers + i
            qkv = g.add("Gemm", self._norm(x), _beside(weights.qkv[i]), weights.qkv_bias[i].reshape(-1))
            heads = g.gather(g.reshape(qkv, P * P, 3 * H, 1, D // H), np.arange(P) * (P + 1), axis=0)
            mixed = self._attend(layer, *g.split(heads, [H, H, H], axis=1))
            x = self._add_product(x, self.block_diagonal(mixed, P, D), _below(weights.out[i]))
            hidden = self._hidden(self._norm(x), _beside(weights.inner[i]), weights.inner_bias[i])
            x = self._add_product(x, hidden, _below(weights.outer[i]), *controls[i + 1 : i + 2])
        return g.reshape(self._norm(x), 1, P * D)

    def _hidden(self, x: str, weight: Floats, bias: Floats) -> str:
        """Write the hidden layer with bias, (P, F), as rows (P, P F) that are zero outside their own columns."""
        P, F = bias.shape
        # A bias far below zero acts as a mask, because ReLU follows.
        biases = np.where(_block_mask(P, F) > 0.0, bias.reshape(1, -1), np.float32(-1e9))
        return self.g.add("Relu", self.g.add("Gemm", x, weight, biases))

    def block_diagonal(self, rows: str, count: int, width: int) -> str:
        """Reshape to rows (count, count width) that are zero outside their own columns."""
        return self.g.add("Mul", self.g.reshape(rows, 1, count * width), _block_mask(count, width))

    def _add_product(self, x: str, y: str, weight: Floats, *more: str) -> str:
        """Add the product of rows y with a matrix, and more, to x."""
        if not more:
            return self.g.add("Gemm", y, weight, x)
        return self.g.add("Sum", x, self.g.add("MatMul", y, weight), *more)

    def _attend(self, layer: int, query: str, key: str, value: str) -> str:
        """Write key and value into a layer's ring, and attention (P, H, 1, E) over the ring."""
        past = f"past_key_values.{layer}"
        keys, values = (
            self.g.add("ScatterND", f"{past}.{name}", self.slot, new, out=present_name(f"{past}.{name}"))
            for name, new in (("key", key), ("value", value))
        )
        scores = self.g.add("MatMul", query, self.g.add("Transpose", keys, perm=[0, 1, 3, 2]))
        scores = self.g.add("Add", scores, self.biases[layer])
        return self.g.add("MatMul", self.g.add("Softmax", scores, axis=-1), values)

    def _norm(self, x: str) -> str:
        D = self.config.width
        # Some importers require the shift, which is optional in ONNX.
        inputs = (x, np.full(D, D**-0.5), np.zeros(D))
        return self.g.add("LayerNormalization", *inputs, axis=-1, epsilon=NORM_EPS)


def _beside(maps: Floats) -> Floats:
    """Place maps (P, K, N) side by side: (K, P N)."""
    return maps.transpose(1, 0, 2).reshape(maps.shape[1], -1)


def _below(maps: Floats) -> Floats:
    """Stack maps (P, K, N): (P K, N)."""
    return maps.reshape(-1, maps.shape[-1])


def _block_mask(count: int, width: int | list[int]) -> Floats:
    """A mask (count, count width) with ones in each row's own columns; width may differ by row."""
    return np.repeat(np.eye(count, dtype=np.float32), width, axis=1)
