"""The network as a program for one frame: weights folded together once, so that a step has little to do.

Everything that knows how PartTransformer is put together for streaming is here; models/step.py and
apps/onnx_export.py run what this file packs. What is folded, all of it exact:

- The mean is taken out of everything that is written into the residual stream, so that a layer norm is a
  scaling by 1 / sqrt(sum of squares + D eps); the sqrt(D) it lacks is in the maps that follow it.
- 1 / sqrt(E) is in the queries.
- The control inputs of all layers of a module are one map of the embedded controls; the first block of it
  is the concatenation of motion and controls.
- Fusion and the embedding of the deep module are one map of all parts' shallow features, and the first
  layer of the Foot-MLP goes along in the products that see its inputs.

Shape legend: P parts, L layers, D width, F hidden, C controls, H heads, W window, K kernel, N inputs of a part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from motionkit.errors import ModelError
from motionkit.features.layout import FEATURE_COUNT
from motionkit.models.config import ModelConfig
from motionkit.models.network import AttentionLayer, AutoRegressiveModule, PartTransformer

Floats = NDArray[np.float32]
NORM_EPS = 1e-5  # of torch's layer_norm


@dataclass(frozen=True, eq=False)
class ModuleWeights:
    """The shallow or the deep module of all parts; maps are (inputs, outputs).

    Attributes:
        embed: (P, K N, D) for the shallow module, (P, P D, D) from all parts' features for the deep one.
        embed_bias: (P, D).
        controls, controls_bias: (P, C, Dc), (P, Dc) embedding of the control vector.
        layer_controls: (P, Dc, L D) what the embedded controls add to the input of each layer, or
            (P, Dc, D) if they only enter at the first.
        qkv, qkv_bias: (L, P, D, 3 D), (L, P, 3 D) of a norm without its sqrt(D).
        out: (L, P, D, D).
        inner, inner_bias: (L, P, D, F), (L, P, F) of a norm without its sqrt(D).
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
    """All that a step needs.

    Attributes:
        columns: (P, N) where each part's inputs stand in features, contacts and one zero.
        shallow, deep: the modules.
        contact_shallow: (P D, M) the share of shallow features in the hidden layer of the Foot-MLP.
        head, head_bias: (P D, 552 + M), (552 + M,) mean, log sigma and that hidden layer from deep features.
        contact, contact_bias: (M, 4), (4,).
        momentum: (276,) share of the last step of the input that is added to the mean, or None.
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


def why_not_packable(config: ModelConfig) -> str | None:
    """What in a config keeps it from being run frame by frame on packed weights, None if nothing does."""
    if config.position != "bias":
        return "position='sinusoidal' changes with every frame, so the window has to be computed anew"
    if config.norm != "pre":
        return "norm='post' is run by the layers themselves"
    return None


@torch.no_grad()
def pack(network: PartTransformer) -> StepWeights:
    """Fold a network's weights into a step.

    Raises:
        ModelError: for a config that cannot be folded, with the reason.
    """
    config = network.config
    reason = why_not_packable(config)
    if reason:
        raise ModelError(f"the network cannot be packed: {reason}")
    P, D = len(network.body.parts), config.width
    root = math.sqrt(D)
    shallow = network.shallow
    embed = (shallow.embed.weight * shallow.embed_mask).double()
    # Deep inputs are s_p + fusion(others): one map of all parts' features, which come without their sqrt(D).
    fused = torch.eye(P * D, dtype=torch.float64).reshape(P * D, P, D).transpose(0, 1).clone()
    if network.fusion is not None:
        for p in range(P):
            others = [q for q in range(P) if q != p]
            rows = torch.cat([torch.arange(q * D, (q + 1) * D) for q in others])
            fused[p, rows] += network.fusion.weight[p].double()
    deep_embed = root * (fused @ network.deep.embed.weight.double())
    aggregate = network.aggregate
    shown = 2 * FEATURE_COUNT
    feet = network.contact_mlp
    hidden = config.contact_hidden
    first = feet.inner.weight[0].double().reshape(len(network.feet), 2, D, hidden)
    from_shallow, from_deep = (torch.zeros(P, D, hidden, dtype=torch.float64) for _ in range(2))
    from_shallow[network.feet], from_deep[network.feet] = root * first[:, 0], root * first[:, 1]
    head = torch.cat([root * aggregate.weight[:shown].double().T, from_deep.reshape(P * D, hidden)], dim=1)
    assert feet.inner.bias is not None and feet.outer.bias is not None
    head_bias = torch.cat([aggregate.bias[:shown], feet.inner.bias[0, 0]])
    return StepWeights(
        config,
        network.part_columns.numpy(),
        _pack_module(shallow, embed),
        _pack_module(network.deep, deep_embed),
        _floats(from_shallow.reshape(P * D, hidden)),
        _floats(head),
        _floats(head_bias),
        _floats(feet.outer.weight[0]),
        _floats(feet.outer.bias[0, 0]),
        None if network.momentum is None else _floats(network.momentum),
    )


def _pack_module(module: AutoRegressiveModule, embed: Tensor) -> ModuleWeights:
    config = module.config
    D, Dc, E = config.width, config.control_embedding, config.width // config.heads
    beside_count = config.control_width
    P, root = embed.shape[0], math.sqrt(D)
    layers = [layer for layer in module.layers if isinstance(layer, AttentionLayer)]
    assert module.embed.bias is not None and module.embed_controls.bias is not None
    # The stream is motion beside the first of the embedded controls; then what the first layer adds.
    beside = torch.zeros(P, Dc, D, dtype=torch.float64)
    beside[:, :beside_count, D - beside_count :] = torch.eye(beside_count, dtype=torch.float64)
    added = [layer.control.weight.double() for layer in layers if layer.control is not None]
    controls = [beside + added[0], *added[1:]] if added else [beside]
    wide = torch.nn.functional.pad(torch.cat([embed, module.embed.bias.double()], dim=1), (0, beside_count))
    wide = _centred(wide)
    query = torch.ones(3 * D, dtype=torch.float64)
    query[:D] /= math.sqrt(E)
    scale = root * query
    qkv = torch.stack([layer.attention.qkv.weight.double() * scale for layer in layers])
    inner = torch.stack([root * layer.ffn.inner.weight.double() for layer in layers])
    qkv_bias: list[Tensor] = []
    inner_bias: list[Tensor] = []
    position: list[Tensor] = []
    for layer in layers:
        assert layer.attention.qkv.bias is not None and layer.ffn.inner.bias is not None
        assert layer.attention.offset_bias is not None
        qkv_bias.append(layer.attention.qkv.bias[:, 0] * query)
        inner_bias.append(layer.ffn.inner.bias[:, 0])
        position.append(layer.attention.offset_bias)
    return ModuleWeights(
        _floats(wide[:, :-1]),
        _floats(wide[:, -1]),
        _floats(module.embed_controls.weight),
        _floats(module.embed_controls.bias[:, 0]),
        _floats(torch.cat([_centred(c) for c in controls], dim=-1)),
        _floats(qkv),
        _floats(torch.stack(qkv_bias)),
        _floats(torch.stack([_centred(layer.attention.out.weight.double()) for layer in layers])),
        _floats(inner),
        _floats(torch.stack(inner_bias)),
        _floats(torch.stack([_centred(layer.ffn.outer.weight.double()) for layer in layers])),
        _floats(torch.stack(position)),
    )


def _centred(weight: Tensor) -> Tensor:
    """A map whose outputs have no mean."""
    return weight - weight.mean(dim=-1, keepdim=True)


def _floats(values: Tensor) -> Floats:
    return np.ascontiguousarray(values.detach().cpu().numpy(), dtype=np.float32)
