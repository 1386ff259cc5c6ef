"""The network of one frame as ONNX nodes, written from the packed weights (models/step_weights.py).

What costs time in a graph of one frame is to read the weights, and then every node, however small. So what
can be folded into constants is folded, parts and heads go side by side through single nodes, and rings are
written in place instead of being shifted: the next frame goes into the slot of the oldest.

Shape legend: P parts, L layers, D width, H heads, E head width, F hidden, W window, C controls.
"""

from __future__ import annotations

import numpy as np

from motionkit.apps.onnx_graph import Graph
from motionkit.features.control import SKELETON_COUNT, skeleton_signal
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.models.checkpoint import MotionModel
from motionkit.models.step_weights import NORM_EPS, Floats, ModuleWeights, StepWeights
from motionkit.motion.skeleton import canonical_skeleton

INPUT_COUNT = FEATURE_COUNT + CONTACT_COUNT


def state_shapes(weights: StepWeights) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the state that goes in as NAME and comes out as present NAME.

    Keys and values follow the convention past_key_values.N.key, the parts as a batch.
    """
    config, P = weights.config, len(weights.columns)
    ring = (P, config.heads, config.window, config.width // config.heads)
    shapes: dict[str, tuple[int, ...]] = {
        "pose": (1, FEATURE_COUNT),
        "contacts": (1, CONTACT_COUNT),
        "ground": (1, 3),
        "past_frames": (1, max(config.kernel - 1, 1), INPUT_COUNT),
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


def write_network(g: Graph, model: MotionModel, weights: StepWeights) -> str:
    """Nodes from controls and state to all state but the ground; answers the unnormalised features (1, 276)."""
    config, P, D = weights.config, len(weights.columns), weights.config.width
    step = _Step(g, weights)
    recent = _recent_frames(g, config.kernel)
    blocks = _control_blocks(g, model, weights)
    shallow = step.module(0, step.embed_frames(recent), blocks[0])
    flat = g.reshape(shallow, 1, P * D)
    # What the deep module and the feet take of the shallow features, in one product.
    deep_embed = weights.deep.embed.transpose(1, 0, 2).reshape(P * D, P * D)
    hidden = config.contact_hidden
    taken = g.add(
        "Gemm",
        flat,
        np.concatenate([deep_embed, weights.contact_shallow], axis=1),
        np.concatenate([weights.deep.embed_bias.reshape(-1), np.zeros(hidden, np.float32)]),
    )
    deep_input, feet = g.split(taken, [P * D, hidden], axis=1)
    deep = step.module(1, g.reshape(deep_input, P, 1, D), blocks[1])
    head = g.add("Gemm", g.reshape(deep, 1, P * D), weights.head, weights.head_bias)
    mean, sigma, feet_too = g.split(head, [FEATURE_COUNT, FEATURE_COUNT, hidden], axis=1)
    feet = g.add("Relu", g.add("Add", feet, feet_too))
    g.add("Sigmoid", g.add("Gemm", feet, weights.contact, weights.contact_bias), out="present_contacts")
    low, high = np.float32(config.log_sigma_min), np.float32(config.log_sigma_max)
    drawn = g.add("Mul", "noise", g.add("Exp", g.add("Clip", sigma, low, high)))
    terms = [mean, drawn, g.add("Mul", "pose", np.float32(config.head_leak))]
    if weights.momentum is not None:
        # Nothing has moved yet at the first frame.
        share = g.add("Mul", g.add("Min", "frames_seen", np.float32(1.0)), weights.momentum)
        last = max(config.kernel - 1, 1) - 1
        before = g.reshape(g.slice("past_frames", [last, 0], [last + 1, FEATURE_COUNT], [1, 2]), 1, FEATURE_COUNT)
        terms.append(g.add("Mul", g.add("Sub", "pose", before), share))
    pose = g.add("Sum", *terms, out="present_pose")
    std, middle = model.scaling.std.numpy(), model.scaling.mean.numpy()
    return g.add("Add", g.add("Mul", pose, std), middle, out="features")


def _recent_frames(g: Graph, kernel: int) -> str:
    """The last inputs (1, K 280) one after another, oldest first; writes present_frames."""
    now = g.reshape(g.add("Concat", "pose", "contacts", axis=1), 1, 1, INPUT_COUNT)
    if kernel == 1:
        return g.reshape(g.add("Identity", now, out="present_frames"), 1, INPUT_COUNT)
    frames = g.add("Concat", "past_frames", now, axis=1)
    g.slice(frames, [1], [kernel], [1], out="present_frames")
    return g.reshape(frames, 1, kernel * INPUT_COUNT)


def _control_blocks(g: Graph, model: MotionModel, weights: StepWeights) -> list[list[str]]:
    """What the controls add to the input of each layer (P, 1, D), of both modules.

    The skeleton is always the same one, and scales and offsets of the other signals are in the map behind
    them: a signal (s - m) / d that counts where g is 1 is s g on a map divided by d, and g on the rest.
    """
    layout, scaling, guides = model.controls, model.trajectory_scaling, model.guide_map
    P, modules = len(weights.columns), (weights.shallow, weights.deep)
    embed = np.concatenate([m.controls for m in modules]).transpose(1, 0, 2).astype(np.float64)
    embed = embed.reshape(embed.shape[0], -1)  # (C, 2 P Dc)
    bias = np.concatenate([m.controls_bias for m in modules]).reshape(-1).astype(np.float64)
    bias += skeleton_signal(canonical_skeleton()).double().numpy() @ embed[layout.skeleton]
    trajectory = embed[layout.trajectory] / scaling.std.double().numpy()[:, None]
    given = embed[layout.flag] - scaling.mean.double().numpy() @ trajectory
    guide = embed[layout.guide]
    seen = g.add("MatMul", "pose", (guides.matrix / guides.gains).numpy())
    differences = g.add("Mul", g.add("Sub", "guide", seen), "guided")
    turns = g.add("Add", g.add("Mul", "progress", np.float32(2.0 * np.pi)), [[0.0, 0.5 * np.pi]])
    has_phase = g.add("GreaterOrEqual", "progress", np.float32(0.0))
    turns = g.add("Where", has_phase, g.add("Sin", turns), np.float32(0.0))
    shown = g.add(
        "Concat",
        "type_weights",
        g.add("Mul", "trajectory", "given"),
        "given",
        turns,
        differences,
        "guided",
        g.add("Sign", "guided"),
        axis=1,
    )
    rows = [
        embed[layout.type],
        trajectory,
        given[None],
        embed[layout.phase],
        guides.gains.double().numpy()[:, None] * guide,
        -(guides.constant.double().numpy() @ guide)[None],
        embed[layout.guided][None],
    ]
    assert layout.skeleton.stop == SKELETON_COUNT
    embedded = g.add("Gemm", shown, np.concatenate(rows).astype(np.float32), bias.astype(np.float32))
    maps = np.concatenate([m.layer_controls for m in modules])
    added = g.add("MatMul", g.reshape(embedded, 2 * P, 1, maps.shape[1]), maps)
    D = weights.config.width
    count = maps.shape[2] // D
    return [
        g.split(part, [D] * count, axis=2) if count > 1 else [part] for part in g.split(added, [P, P], axis=0)
    ]


class _Step:
    """The modules of one frame."""

    def __init__(self, g: Graph, weights: StepWeights) -> None:
        self.g, self.weights, self.config = g, weights, weights.config
        config, P, W = self.config, len(weights.columns), weights.config.window
        # Frames are counted up to 2 W - 2 and then from W - 1 again: while places in the rings are empty, and
        # then which slot is the oldest.
        counts = np.arange(2 * W - 1)
        count = g.reshape(g.add("Cast", "frames_seen", to=g.onnx.TensorProto.INT64), 1)
        following = np.append(counts[1:], W - 1).astype(np.float32)
        g.reshape(g.gather(following, count, axis=0), 1, 1, out="present_frames_seen")
        slot = np.stack(np.broadcast_arrays(*np.ogrid[:P, : config.heads, : 2 * W - 1]), axis=-1)
        slot[..., 2] %= W
        self.slot = g.gather(g.constant(slot, np.int64), count, axis=2)  # (P, H, 1, 3)
        distance = (counts[:, None] - np.arange(W)) % W
        position = np.concatenate([weights.shallow.position, weights.deep.position])  # (2 L, P, H, W)
        bias = np.where(distance <= counts[:, None], position[..., distance], np.float32(-1e9))
        bias = bias.reshape(-1, config.heads, 2 * W - 1, W)
        self.biases = g.split(g.gather(bias, count, axis=2), [P] * (2 * config.layers), axis=0)

    def embed_frames(self, recent: str) -> str:
        """The first convolution: (P, 1, D) without its bias from the last frames (1, K 280)."""
        columns, config = self.weights.columns, self.config
        P, N = columns.shape
        # Short parts are filled up with any column, on weights of zero.
        used = columns < INPUT_COUNT
        place = np.where(used, columns, 0)[:, None] + INPUT_COUNT * np.arange(config.kernel)[:, None]
        embed = self.weights.shallow.embed.reshape(P, config.kernel, N, -1) * used[:, None, :, None]
        inputs = self.g.gather(recent, place.reshape(P, -1), axis=1)
        inputs = self.g.reshape(inputs, P, 1, config.kernel * N)
        return self.g.add("MatMul", inputs, embed.reshape(P, config.kernel * N, -1))

    def module(self, index: int, motion: str, controls: list[str]) -> str:
        """Features (P, 1, D) without their sqrt(D) of a module from its embedded input (P, 1, D)."""
        g, config = self.g, self.config
        weights = (self.weights.shallow, self.weights.deep)[index]
        P, D, H = len(self.weights.columns), config.width, config.heads
        terms = [motion, controls[0]]
        if index == 0:
            terms.append(g.constant(weights.embed_bias[:, None]))
        x = g.add("Sum", *terms)
        for i in range(config.layers):
            layer = index * config.layers + i
            qkv = self._of_norm(x, weights.qkv[i], weights.qkv_bias[i])
            heads = g.split(g.reshape(qkv, P, 3 * H, 1, D // H), [H, H, H], axis=1)
            mixed = g.reshape(self._attend(layer, *heads), P, 1, D)
            x = g.add("Add", x, g.add("MatMul", mixed, weights.out[i]))
            hidden = g.add("Relu", self._of_norm(x, weights.inner[i], weights.inner_bias[i]))
            terms = [x, g.add("MatMul", hidden, weights.outer[i])]
            if i + 1 < len(controls):
                terms.append(controls[i + 1])
            x = g.add("Sum", *terms)
        return self._norm(x, 0.0)

    def _attend(self, layer: int, query: str, key: str, value: str) -> str:
        """Attention (P, H, 1, E) over the ring of a layer, into which key and value go."""
        past = f"past_key_values.{layer}"
        keys, values = (
            self.g.add("ScatterND", f"{past}.{name}", self.slot, new, out=present_name(f"{past}.{name}"))
            for name, new in (("key", key), ("value", value))
        )
        scores = self.g.add("MatMul", query, self.g.add("Transpose", keys, perm=[0, 1, 3, 2]))
        scores = self.g.add("Add", scores, self.biases[layer])
        return self.g.add("MatMul", self.g.add("Softmax", scores, axis=-1), values)

    def _of_norm(self, x: str, weight: Floats, bias: Floats) -> str:
        """A linear map (P, D, N) with its bias (P, N) of normalised rows.

        A norm's output has no mean, so a number added to all of it can carry the bias of the map behind it.
        """
        D = self.config.width
        level = D**-0.5
        wide = weight.astype(np.float64)
        carried = wide + (bias[:, None] - level * wide.sum(axis=1, keepdims=True)) / (D * level)
        return self.g.add("MatMul", self._norm(x, level), carried.astype(np.float32))

    def _norm(self, x: str, level: float) -> str:
        D = self.config.width
        inputs = (x, np.full(D, D**-0.5), np.full(D, level))
        return self.g.add("LayerNormalization", *inputs, axis=-1, epsilon=NORM_EPS)
