"""Writes the memory of the C kernels for WebAssembly: arrays, and structs with 32-bit pointers.

A web page loads this image, fills in the arrays of a frame and calls the kernels. The image has two segments: constants
that all characters share, at a fixed address, and the state of one character. The page copies the state for each
character and adds the address of the copy to the pointers listed in `moved`.
"""

from __future__ import annotations

import ctypes
from ctypes import Array as CArray
from ctypes import Structure, c_uint32, c_void_p
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Protocol

from numpy.typing import NDArray

from motionkit.inference.character import CharacterStream
from motionkit.inference.frame_kernel import draw_words
from motionkit.inference.noise import Noise
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import LINE, StepProgram
from motionkit.inference.step_weights import pack
from motionkit.models.model import MotionModel
from motionkit.rig.soles import MOST_POINTS

# Where the shared part begins; below it are the stack and the constants of the compiled module.
BASE = 1 << 20


@dataclass(frozen=True, eq=False)
class _Segment:
    """Memory that starts at an address, and the places in it of this process's arrays."""

    base: int
    data: bytearray = field(default_factory=bytearray)
    placed: list[tuple[int, int, int]] = field(
        default_factory=list
    )  # address here, bytes, address in the image

    def put(self, data: bytes, align: int = LINE) -> int:
        """Append bytes; returns their address."""
        self.data.extend(bytes(-len(self.data) % align))
        at = self.base + len(self.data)
        self.data.extend(data)
        return at


@dataclass(frozen=True, eq=False)
class KernelImage:
    """The memory of the kernels for any number of characters of a model.

    Attributes:
        shared: constants of all characters, at BASE.
        character: state of one character after the frames of a start pose; its addresses count from 0.
        moved: offsets in own of the pointers into own.
        addresses: address of the program, and offsets in own of the structs and arrays that a page reads and writes.
        fields: offsets in their structs of the numbers that a page reads or writes, position_bytes of one ring slot,
            and how many sole_points a part of a sole has room for; of a path's struct all, and its size.
        slot: ring slot of the last frame of the start pose.
    """

    shared: bytes
    character: bytes
    moved: tuple[int, ...]
    addresses: dict[str, int]
    fields: dict[str, Any]
    slot: int


class Steered(Protocol):
    """A character's struct of steering, and what it points to: the types of the model, and an array of its own."""

    words: Any
    types: Any
    shares: NDArray[Any]


def kernel_image(model: MotionModel, noise: Noise, steering: Steered, path: Structure) -> KernelImage:
    """Return the memory for characters with the default body and weights in 16 bits.

    Args:
        path: the struct of a character on a path, without its arrays.

    Raises:
        ModelError: for a network that the kernels cannot run.
    """
    program = StepProgram(pack(model.network), small=True)
    stream = CharacterStream(model, 1, noise)
    network, body, poser = stream.state.network, stream.body, stream.poser
    assert isinstance(network, NetworkStep) and body.feet is not None
    drawn = stream.state.drawing.arrays(network)
    draw, frame = draw_words(drawn, noise), drawn.frame
    pose = poser.words(frame.features, frame.contacts, frame.ground)
    arrays, presets = network.arrays, drawn.presets
    step = program.frame_words(arrays)
    state: dict[str, NDArray[Any]] = {
        "recent": arrays.recent, "keys": arrays.keys, "values": arrays.values, "filled": arrays.filled,
        "controls": arrays.controls, "out": arrays.out, "logits": arrays.contacts_out,
        "fresh": drawn.noise.fresh, "noise": drawn.noise.first, "smooth": drawn.noise.second,
        "velocity_blend": presets.velocity_blend, "slip_correction": presets.slip_correction,
        "before": frame.before, "last": network.before, "x": frame.x, "contacts": frame.contacts,
        "features": frame.features, "ground": frame.ground,
        **dict(zip(("rotations", "root", "positions"), poser.posed, strict=True)),
    }  # fmt: skip
    state |= {f"feet_{name}": array for name, array in body.feet.arrays.items()} | {"rise": body.rise}
    state |= {f"soles_{name}": array for name, array in vars(body.soles).items()} | {"offsets": body.offsets}
    state["shares"] = steering.shares
    writer = _Writer()
    writer.share(*program.kept, program.position, drawn.space.mean, drawn.space.std, drawn.space.blended)
    writer.share(poser.references, body.scale)
    addresses = {name: writer.keep(array) for name, array in state.items()}
    addresses["position"] = writer.address_of(program.position.ctypes.data)[0]
    writer.struct(program.maps, shared=True)
    writer.struct(steering.types, shared=True)
    addresses |= {n: writer.struct(w, shared=True) for n, w in (("path", path), ("program", program.words))}
    writer.struct(pose.feet.contents)  # type: ignore[attr-defined]
    writer.struct(pose.soles.contents)  # type: ignore[attr-defined]
    addresses |= {
        name: writer.struct(words)
        for name, words in (("frame", step), ("draw", draw), ("pose", pose), ("steering", steering.words))
    }
    fields = {
        "slot": _narrow(type(step)).slot.offset,
        "position": _narrow(type(step)).position.offset,
        "position_bytes": program.position[0].nbytes,
        "temperature": _narrow(type(draw)).temperature.offset,
        "sole_points": MOST_POINTS,
        "trajectory": _narrow(steering.words.__class__).trajectory.offset,
        "path": _offsets(_narrow(path.__class__)),
    }
    segments = bytes(writer.shared.data), bytes(writer.character.data)
    return KernelImage(*segments, tuple(writer.moved), addresses, fields, network.slot)


class _Writer:
    """Writes arrays and structs into both segments; a struct comes after all arrays that it points to."""

    def __init__(self) -> None:
        self.shared, self.character = _Segment(BASE), _Segment(0)
        self.moved: list[int] = []

    def share(self, *arrays: NDArray) -> None:
        """Write constants into the shared segment."""
        for array in arrays:
            self._put(self.shared, array)

    def keep(self, array: NDArray) -> int:
        """Write an array of a character's state; returns its address."""
        return self._put(self.character, array)

    def _put(self, segment: _Segment, array: NDArray) -> int:
        assert array.flags.c_contiguous
        at = segment.put(array.astype(array.dtype.newbyteorder("<")).tobytes())
        segment.placed.append((array.ctypes.data, array.nbytes, at))
        return at

    def address_of(self, ours: int) -> tuple[int, bool]:
        """Return the address in the image of an address here, and whether it is in the character's segment."""
        for segment in (self.shared, self.character):
            for start, size, at in segment.placed:
                if start <= ours < start + size:
                    return at + ours - start, segment is self.character
        raise AssertionError("a pointer to an array that was not put anywhere")

    def struct(self, words: Any, shared: bool = False) -> int:
        """Write a struct, or an array of structs, whose targets are written already; returns its address."""
        segment = self.shared if shared else self.character
        pointers: list[int] = []
        at = segment.put(bytes(self._copy(words, 0, pointers)))
        self.moved += [at + offset for offset in pointers]
        assert not (shared and pointers)
        segment.placed.append((ctypes.addressof(words), ctypes.sizeof(words), at))
        return at

    def _copy(self, value: Any, offset: int, pointers: list[int]) -> Any:
        """Copy a ctypes value with addresses of the image; collects the offsets of pointers into own."""
        kind: Any = _narrow(value.__class__)
        if isinstance(value, Structure):
            out = kind()
            for name, declared in type(value)._fields_:  # type: ignore[misc]
                found, at = getattr(value, name), offset + getattr(kind, name).offset
                copied = (
                    self._pointer(found, at, pointers)
                    if _points(declared)
                    else self._copy(found, at, pointers)
                )
                setattr(out, name, copied)
            return out
        if isinstance(value, CArray):
            size = ctypes.sizeof(kind._type_)
            return kind(*(self._copy(each, offset + i * size, pointers) for i, each in enumerate(value)))
        return value

    def _pointer(self, value: Any, offset: int, pointers: list[int]) -> int:
        ours = ctypes.cast(value, c_void_p).value
        if ours is None:
            return 0
        address, moves = self.address_of(ours)
        if moves:
            pointers.append(offset)
        return address


def _offsets(kind: Any) -> dict[str, int]:
    """Offsets of the fields of a struct, and its size."""
    return {name: getattr(kind, name).offset for name, _ in kind._fields_} | {"size": ctypes.sizeof(kind)}


def _points(kind: Any) -> bool:
    return kind is c_void_p or issubclass(kind, ctypes._Pointer)


@cache
def _narrow(kind: Any) -> Any:
    """A ctypes type with pointers of 32 bits."""
    if _points(kind):
        return c_uint32
    if issubclass(kind, Structure):
        return type(kind.__name__, (Structure,), {"_fields_": [(n, _narrow(k)) for n, k in kind._fields_]})
    return _narrow(kind._type_) * kind._length_ if issubclass(kind, CArray) else kind
