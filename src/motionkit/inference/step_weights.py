"""Folds the network's weights once into a short program for one frame.

inference/step.py and export/onnx_export.py run the packed weights. These folds are exact:

- Every map into the residual stream has outputs without a mean. So a layer norm is a scaling by
  1 / sqrt(sum of squares + D eps); the maps after it contain the missing sqrt(D).
- The queries contain 1 / sqrt(E).
- One map of the embedded controls makes the control inputs of all layers of a module. Its first block also
  concatenates motion and controls.
- One map of all parts' shallow features does both fusion and the embedding of the deep module.
- The first layer of the Foot-MLP is part of the products that read its inputs.

Shape legend: P parts, L layers, D width, F hidden, C controls, H heads, W window, K kernel, N inputs of a part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Array, Doubles, Floats
from motionkit.errors import ModelError
from motionkit.features.layout import FEATURE_COUNT
from motionkit.models.config import ModelConfig, PredictorConfig
from motionkit.models.weights import NetworkWeights, embedding_mask, foot_parts, part_columns

NORM_EPS = 1e-5  # of torch's layer_norm


@dataclass(frozen=True, eq=False)
class ModuleWeights:
    """The shallow or the deep module of all parts; maps are (inputs, outputs).

    Attributes:
        embed: (P, K N, D) for the shallow module, (P, P D, D) from all parts' features for the deep one.
        embed_bias: (P, D).
        controls, controls_bias: (P, C, Dc), (P, Dc) embedding of the control vector.
        layer_controls: (P, Dc, L D) from the embedded controls to the input of each layer, or (P, Dc, D) if
            they enter only the first layer.
        qkv, qkv_bias: (L, P, D, 3 D), (L, P, 3 D) after a norm without its sqrt(D).
        out: (L, P, D, D).
        inner, inner_bias: (L, P, D, F), (L, P, F) after a norm without its sqrt(D).
        outer: (L, P, F, D).
        position: (L, P, H, W) bias per distance in frames.
    """

    embed: Floats
    embed_bias: Floats
    controls: Floats
    controls_bias: Floats
    layer_controls: Floats
    qkv: Floats
    qkv_bias: Floats
    out: Floats
    inner: Floats
    inner_bias: Floats
    outer: Floats
    position: Floats


@dataclass(frozen=True, eq=False)
class StepWeights:
    """The packed weights of a step.

    Attributes:
        columns: (P, N) columns of each part's inputs among features, contacts and one zero.
        shallow, deep: the modules.
        contact_shallow: (P D, M) from shallow features to the hidden layer of the Foot-MLP.
        head, head_bias: (P D, 552 + M), (552 + M,) from deep features to mean, log sigma and that hidden layer.
        contact, contact_bias: (M, 4), (4,) from the hidden layer to the contact logits.
        momentum: (276,) share of the input's last change that is added to the mean, or None.
    """

    config: ModelConfig
    columns: NDArray[np.int64]
    shallow: ModuleWeights
    deep: ModuleWeights
    contact_shallow: Floats
    head: Floats
    head_bias: Floats
    contact: Floats
    contact_bias: Floats
    momentum: Floats | None


def why_not_packable(config: PredictorConfig) -> str | None:
    """Return why a config cannot run on packed weights; None if it can."""
    if not isinstance(config, ModelConfig):
        return f"{config.architecture} is not a part transformer"
    if config.controls != "extended":
        return "controls='paper' needs the predicted trajectory"
    if config.variant.position != "bias":
        return "position='sinusoidal' changes with every frame, so the window has to be computed anew"
    if config.variant.norm != "pre":
        return "norm='post' is run by the layers themselves"
    return None


def pack(network: NetworkWeights) -> StepWeights:
    """Fold a network's weights into those of a step.

    Raises:
        ModelError: the config cannot be folded; the message gives the reason.
    """
    config = network.config
    reason = why_not_packable(config)
    if reason:
        raise ModelError(f"the network cannot be packed: {reason}")
    assert isinstance(config, ModelConfig)
    columns, _ = part_columns(config)
    P, D = len(columns), config.width
    root = math.sqrt(D)
    embed = (network["shallow.embed.weight"] * embedding_mask(config)).astype(np.float64)
    # Deep inputs are s_p + fusion(others): one map of all parts' features, which lack their sqrt(D).
    fused = np.eye(P * D).reshape(P * D, P, D).swapaxes(0, 1).copy()
    fusion, fusion_bias = network.get("fusion.weight"), network.get("fusion.bias")
    if fusion is not None:
        for p in range(P):
            others = [q for q in range(P) if q != p]
            rows = np.concatenate([np.arange(q * D, (q + 1) * D) for q in others])
            fused[p, rows] += fusion[p]
    deep_weight = network["deep.embed.weight"].astype(np.float64)
    deep_bias = network["deep.embed.bias"].astype(np.float64)
    if fusion_bias is not None:
        deep_bias = deep_bias + fusion_bias @ deep_weight
    inputs = 2 * FEATURE_COUNT
    hidden, feet = config.head.contact_hidden, foot_parts(config)
    first = network["contact_mlp.inner.weight"][0].astype(np.float64).reshape(len(feet), 2, D, hidden)
    from_shallow, from_deep = (np.zeros((P, D, hidden)) for _ in range(2))
    from_shallow[feet], from_deep[feet] = root * first[:, 0], root * first[:, 1]
    aggregate = network["aggregate.weight"][:inputs].astype(np.float64).T
    head = np.concatenate([root * aggregate, from_deep.reshape(P * D, hidden)], axis=1)
    head_bias = np.concatenate([network["aggregate.bias"][:inputs], network["contact_mlp.inner.bias"][0, 0]])
    momentum = network.get("momentum")
    return StepWeights(
        config,
        columns,
        _pack_module(network, "shallow", embed, network["shallow.embed.bias"].astype(np.float64)),
        _pack_module(network, "deep", root * (fused @ deep_weight), deep_bias),
        _floats(from_shallow.reshape(P * D, hidden)),
        _floats(head),
        _floats(head_bias),
        _floats(network["contact_mlp.outer.weight"][0]),
        _floats(network["contact_mlp.outer.bias"][0, 0]),
        None if momentum is None else _floats(momentum),
    )


def _pack_module(network: NetworkWeights, module: str, embed: Doubles, bias: Doubles) -> ModuleWeights:
    config = network.config
    assert isinstance(config, ModelConfig)
    D, Dc, E = config.width, config.embedding.control_embedding, config.width // config.heads
    beside_count = config.embedding.control_width
    P, root = embed.shape[0], math.sqrt(D)

    def layers(name: str) -> Doubles:
        """A parameter of all layers (L, ...)."""
        whole = [network[f"{module}.layers.{i}.{name}"] for i in range(config.layers)]
        return np.stack(whole).astype(np.float64)

    # The stream holds the motion and the first embedded controls; the first layer adds its control input.
    beside = np.zeros((P, Dc, D))
    beside[:, :beside_count, D - beside_count :] = np.eye(beside_count)
    controls = [beside]
    if config.embedding.layer_controls:
        added = layers("control.weight")
        controls = [beside + added[0], *added[1:]]
    wide = _centred(np.pad(np.concatenate([embed, bias], axis=1), ((0, 0), (0, 0), (0, beside_count))))
    query = np.ones(3 * D)
    query[:D] /= math.sqrt(E)
    return ModuleWeights(
        _floats(wide[:, :-1]),
        _floats(wide[:, -1]),
        _floats(network[f"{module}.embed_controls.weight"]),
        _floats(network[f"{module}.embed_controls.bias"][:, 0]),
        _floats(np.concatenate([_centred(c) for c in controls], axis=-1)),
        _floats(layers("attention.qkv.weight") * (root * query)),
        _floats(layers("attention.qkv.bias")[:, :, 0] * query),
        _floats(_centred(layers("attention.out.weight"))),
        _floats(root * layers("ffn.inner.weight")),
        _floats(layers("ffn.inner.bias")[:, :, 0]),
        _floats(_centred(layers("ffn.outer.weight"))),
        _floats(layers("attention.offset_bias")),
    )


def _centred(weight: Doubles) -> Doubles:
    """Remove the mean of a map's outputs."""
    return weight - weight.mean(axis=-1, keepdims=True)


def _floats(values: Array) -> Floats:
    return np.ascontiguousarray(values, dtype=np.float32)
