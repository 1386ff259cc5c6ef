"""Python bindings of step_kernel.c, and the network's weights in the order of the kernel."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, Structure, byref, c_float, c_int64, c_void_p
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.errors import ModelError
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.step_arrays import TILE, StepArrays
from motionkit.inference.step_weights import NORM_EPS, ModuleWeights, StepWeights
from motionkit.native import cores, load_library, workers

VERSION = 4  # of step_kernel.c
LINE = 64  # bytes of a cache line
# Characters that run through the network together. Their activations stay in the cache with ROWS. Large crowds, split
# over the cores, use up to MOST_ROWS, so that the weights are read less often.
ROWS, MOST_ROWS = 16, 48


class _Map(Structure):
    _fields_ = (
        ("tiles", c_void_p),
        ("scale", c_void_p),
        ("bias", c_void_p),
        ("inputs", c_int64),
        ("outputs", c_int64),
    )


_SIZES = (
    "parts layers width hidden heads window kernel part_inputs controls control_width "
    "control_blocks contact_hidden features contacts"
).split()


class _Program(Structure):
    _fields_ = (
        *((name, c_int64) for name in _SIZES),
        *((name, c_float) for name in ("head_leak", "log_sigma_min", "log_sigma_max", "eps")),
        ("maps", POINTER(_Map)),
        ("columns", c_void_p),
    )


class _Frame(Structure):
    _fields_ = (
        *((n, c_void_p) for n in ("recent", "keys", "values", "filled", "controls", "position")),
        *((n, c_void_p) for n in ("out", "contact_logits")),
        ("slot", c_int64),
    )


@cache
def kernel_library() -> ctypes.CDLL:
    """Return the shared library. Raises MotionkitError if this installation has none of this version."""
    library = load_library(Path(__file__).resolve().parent / "_step_kernel", "step_kernel_version", VERSION)
    library.scratch_size.argtypes = [POINTER(_Program), c_int64]
    library.scratch_size.restype = c_int64
    library.step.argtypes = [POINTER(_Program), POINTER(_Frame), c_int64, c_int64, c_void_p]
    library.step.restype = c_int64
    return library


class StepProgram:
    """A network's weights in the layout of the kernel, to run here or in WebAssembly (kernel_image.py).

    small stores them in 16 bits, as whole numbers times a scale per output. That halves the memory to read; the error
    is at most 1 / 65534 of the largest weight of the output.

    Attributes:
        words: the struct of the network.
        maps: the structs of its linear maps.
        position: (W, 2, P, L, W, H) attention bias of every ring slot, for each slot of the new frame.
        kept: the arrays that the structs point into.
    """

    def __init__(self, weights: StepWeights, small: bool = False) -> None:
        self._small = small
        self.kept: list[NDArray] = []
        config = weights.config
        P, N = weights.columns.shape
        maps = [
            *self._module_maps(weights.shallow, config.layers),
            *self._module_maps(weights.deep, config.layers),
            self._map(weights.head, weights.head_bias),
            self._map(weights.contact_shallow, None),
            self._map(weights.contact, weights.contact_bias),
        ]
        self.maps = (_Map * len(maps))(*(words for _, words in maps))
        self._line_up([tiles for tiles, _ in maps])
        distance = (np.arange(config.window)[:, None] - np.arange(config.window)) % config.window
        position = np.stack([m.position.swapaxes(0, 1) for m in (weights.shallow, weights.deep)])
        self.position = np.ascontiguousarray(np.moveaxis(position[..., distance], (3, 4, 5), (5, 0, 4)))
        sizes = (
            P, config.layers, config.width, config.ffn, config.heads, config.window, config.kernel, N,
            weights.shallow.controls.shape[1], config.embedding.control_embedding,
            weights.shallow.layer_controls.shape[-1] // config.width, config.head.contact_hidden,
            FEATURE_COUNT, CONTACT_COUNT,
        )  # fmt: skip
        self.words = _Program(
            *sizes,
            config.head.head_leak,
            config.head.log_sigma_min,
            config.head.log_sigma_max,
            NORM_EPS,
            self.maps,
            self._keep(weights.columns),
        )

    def frame_words(self, arrays: StepArrays) -> _Frame:
        """Return the struct of the arrays at slot 0; it does not keep the arrays alive."""
        kept: list[NDArray] = [arrays.recent, arrays.keys, arrays.values, arrays.filled, arrays.controls]
        kept += [self.position, arrays.out, arrays.contacts_out]
        assert all(array.flags.c_contiguous for array in kept)
        return _Frame(*(array.ctypes.data for array in kept), 0)

    def _module_maps(self, weights: ModuleWeights, layers: int) -> list[tuple[NDArray, _Map]]:
        """Return the linear maps in the order of the kernel: part by part, layer by layer."""
        maps = []
        heads, D = weights.position.shape[2], weights.out.shape[-1]
        turn = np.arange(D).reshape(heads, -1).T.ravel()  # puts the heads of a channel side by side
        three = np.concatenate([turn, D + turn, 2 * D + turn])
        for part in range(len(weights.embed)):
            maps.append(self._map(weights.embed[part], weights.embed_bias[part]))
            maps.append(self._map(weights.controls[part], weights.controls_bias[part]))
            maps.append(self._map(weights.layer_controls[part], None))
            for layer in range(layers):
                maps.append(
                    self._map(weights.qkv[layer, part][:, three], weights.qkv_bias[layer, part][three])
                )
                maps.append(self._map(weights.out[layer, part][turn], None))
                maps.append(self._map(weights.inner[layer, part], weights.inner_bias[layer, part]))
                maps.append(self._map(weights.outer[layer, part], None))
        return maps

    def _map(self, weight: Floats, bias: Floats | None) -> tuple[NDArray, _Map]:
        """Return the tiles of a linear map, and its struct without their address."""
        inputs, outputs = weight.shape
        weight = np.pad(weight, ((0, 0), (0, -outputs % TILE)))
        bias = None if bias is None else np.pad(bias, (0, -outputs % TILE))
        scale = None
        tiles: NDArray = weight.reshape(inputs, -1, TILE).swapaxes(0, 1)
        if self._small:
            largest = np.maximum(np.abs(weight).max(axis=0), 1e-12).reshape(-1, 1, TILE)
            tiles, scale = (
                _in_pairs(tiles * (32767.0 / largest)),
                (largest / (32767.0 * 65536.0)).astype(np.float32),
            )
        return np.ascontiguousarray(tiles), _Map(None, self._keep(scale), self._keep(bias), inputs, outputs)

    def _line_up(self, tiles: list[NDArray]) -> None:
        """Place the tiles one after another in reading order, aligned to cache lines, and set their addresses."""
        sizes = [array.nbytes for array in tiles]
        memory = np.zeros(sum(sizes) + LINE, np.uint8)
        memory = memory[-memory.ctypes.data % LINE :]
        self.kept.append(memory)
        place = 0
        for index, array in enumerate(tiles):
            memory[place : place + array.nbytes] = array.reshape(-1).view(np.uint8)
            self.maps[index].tiles = memory.ctypes.data + place
            place += array.nbytes

    def _keep(self, array: NDArray | None) -> int | None:
        """Keep a contiguous copy as long as this object, and return its address."""
        if array is None:
            return None
        array = np.ascontiguousarray(array)
        self.kept.append(array)
        return array.ctypes.data


class StepKernel(StepProgram):
    """A StepProgram with the library that runs it; any number of NetworkSteps may share it.

    Raises MotionkitError if the library is missing, and ModelError for a network that it cannot run.
    """

    def __init__(self, weights: StepWeights, small: bool = False) -> None:
        self.weights, self._library = weights, kernel_library()
        super().__init__(weights, small)
        if self._library.scratch_size(byref(self.words), 1) < 0:
            raise ModelError(f"the compiled step cannot run a network of these sizes: {weights.config}")

    def bind(self, arrays: StepArrays) -> Callable[[int], None]:
        """Return a function that runs a step of all characters at a ring slot."""
        frame, batch = self.frame_words(arrays), len(arrays.filled)
        places = [self.position[slot].ctypes.data for slot in range(len(self.position))]
        program, call = byref(self.words), self._library.step
        together = max(ROWS, min(MOST_ROWS, -(-batch // cores())))
        size = self._library.scratch_size(program, min(together, batch))
        shares = [
            (first, min(together, batch - first), np.empty(size, np.float32))
            for first in range(0, batch, together)
        ]
        calls = [(program, byref(frame), first, count, s.ctypes.data) for first, count, s in shares]

        def step(slot: int) -> None:
            frame.position, frame.slot = places[slot], slot
            if len(calls) == 1:
                refused = call(*calls[0])
            else:  # ctypes releases Python's lock, so threads run in parallel
                refused = any(list(workers(cores()).map(lambda words: call(*words), calls)))
            if refused:
                raise ModelError("the compiled step does not fit this network")

        step.keeps = (shares, arrays)  # type: ignore[attr-defined]
        return step


def _in_pairs(tiles: Floats) -> NDArray[np.int32]:
    """Pack tiles (..., 32) of numbers up to 32767 into (..., 16) pairs of 32 bits.

    The low 16 bits hold the first number of a pair. The kernel reads the second from all 32 bits without masking, so
    the second is rounded with those low bits in mind, and no precision is lost.
    """
    low = np.rint(tiles[..., : TILE // 2]).astype(np.int64) & 0xFFFF
    high = np.rint(tiles[..., TILE // 2 :] - low / 65536.0).astype(np.int64)
    return (high * 65536 + low).astype(np.int32)
