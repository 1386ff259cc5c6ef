"""Torch bindings of attention_kernel.c: attention over a short window on a CPU, with its gradients."""

from __future__ import annotations

import ctypes
import math
from ctypes import Structure, byref, c_float, c_int64, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from motionkit.native import load_library, workers

VERSION = 1  # of attention_kernel.c
HEADS = 8  # heads, which lie side by side in a vector
MOST_PLACES = 64  # longest window in frames
FORMATS = (torch.float32, torch.bfloat16)


class _Attention(Structure):
    _fields_ = (
        *((name, c_int64) for name in ("parts", "batch", "frames", "channels", "window", "bfloat16")),
        ("scale", c_float),
        *((name, c_void_p) for name in ("qkv", "bias", "position", "shares", "out")),
        *((name, c_void_p) for name in ("qkv_gradient", "bias_gradient", "position_gradient")),
    )


@cache
def attention_library() -> ctypes.CDLL:
    """Return the shared library. Raises MotionkitError if this installation has none of this version."""
    path = Path(__file__).resolve().parent / "_attention_kernel"
    library = load_library(path, "attention_kernel_version", VERSION)
    for call in (library.attention_forward, library.attention_backward):
        call.argtypes = [ctypes.POINTER(_Attention), c_int64, c_int64]
        call.restype = c_int64
    return library


def can_attend(x: Tensor, heads: int, window: int) -> bool:
    """Whether the library can attend to frames x: on a CPU, in its formats, with eight heads."""
    return x.device.type == "cpu" and x.dtype in FORMATS and heads == HEADS and window <= MOST_PLACES


def attend(qkv: Tensor, bias: Tensor, position: Tensor) -> Tensor:
    """Return the attention (P, B, T, E, 8) of each frame to itself and the W - 1 frames before.

    Args:
        qkv: (P, B, T, 3, E, 8) queries, keys and values without bias, heads last; float32 or bfloat16.
        bias: (P, 3, E, 8) to add to qkv.
        position: (P, W, 8) to add to the scores, by distance in frames.
    """
    return _Attend.apply(qkv, bias, position)


class _Attend(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, qkv: Tensor, bias: Tensor, position: Tensor) -> Tensor:
        qkv, bias, position = qkv.contiguous(), bias.contiguous(), position.contiguous()
        P, B, T, _, E, H = qkv.shape
        shares = torch.empty(P, B, T, position.shape[1], H)
        out = torch.empty(P, B, T, E, H, dtype=qkv.dtype)
        _call("attention_forward", (qkv, bias, position), shares, out)
        ctx.save_for_backward(qkv, bias, position, shares)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        qkv, bias, position, shares = ctx.saved_tensors
        P, B, _, _, E, H = qkv.shape
        outputs_gradient = gradient.to(qkv.dtype).contiguous()
        to_qkv = torch.empty_like(qkv)
        to_bias, to_position = torch.empty(P, B, 3, E, H), torch.empty(P, B, position.shape[1], H)
        _call(
            "attention_backward",
            (qkv, bias, position),
            shares,
            outputs_gradient,
            to_qkv,
            to_bias,
            to_position,
        )
        return to_qkv, to_bias.sum(1), to_position.sum(1)


def _call(
    name: str, inputs: tuple[Tensor, Tensor, Tensor], shares: Tensor, out: Tensor, *made: Tensor
) -> None:
    """Call the library for all sequences, in as many threads as torch uses."""
    library = attention_library()
    qkv, _, position = inputs
    assert qkv.dtype in FORMATS
    P, B, T, _, E, _ = qkv.shape
    sizes = (P, B, T, E, position.shape[1], qkv.dtype == torch.bfloat16, 1.0 / math.sqrt(E))
    places = [tensor.data_ptr() for tensor in (*inputs, shares, out, *made)]
    attention = byref(_Attention(*sizes, *places))
    call = getattr(library, name)
    threads = min(torch.get_num_threads(), P * B)
    ends = [P * B * i // threads for i in range(threads + 1)]
    if threads == 1:
        faults = [call(attention, 0, P * B)]
    else:
        faults = list(workers(threads).map(lambda i: call(attention, ends[i], ends[i + 1]), range(threads)))
    if any(faults):
        raise MemoryError("attention: not enough memory")
