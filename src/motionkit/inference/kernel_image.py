"""The memory that the C kernels work on, as WebAssembly sees it: structs with 32-bit pointers among arrays.

What Python binds the kernels to on this machine is written out with other addresses, so that a page of JavaScript has
only to load it, to fill in the arrays of a frame and to call. There are two parts: what all characters share, at a
fixed address, and what each has of its own, at an address of its own, by which the pointers listed in moved are raised.
"""

from __future__ import annotations

import ctypes
from ctypes import Array as CArray
from ctypes import Structure, c_uint32, c_void_p
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from numpy.typing import NDArray

from motionkit.inference.character import CharacterStream
from motionkit.inference.frame_kernel import draw_words
from motionkit.inference.noise import Noise
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import LINE, StepProgram
from motionkit.inference.step_weights import pack
from motionkit.models.model import MotionModel

# Where the shared part begins; below it are the stack and the constants of the compiled module.
BASE = 1 << 20


@dataclass(frozen=True, eq=False)
class _Segment:
    """Memory from an address on, and where in it which arrays of this process are."""

    base: int
    data: bytearray = field(default_factory=bytearray)
    placed: list[tuple[int, int, int]] = field(default_factory=list)  # our address, bytes, its address

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
        shared: what all characters share, at BASE.
        own: what a character has of its own, as it is before its start; addresses count from its beginning.
        moved: places in own of pointers into own.
        addresses: where the program is, and in own the structs and arrays that a page reads and writes.
        fields: where in its struct a number is that a page writes; and position_bytes of one slot of the rings.
    """

    shared: bytes
    own: bytes
    moved: tuple[int, ...]
    addresses: dict[str, int]
    fields: dict[str, int]


def kernel_image(model: MotionModel, noise: Noise) -> KernelImage:
    """The memory for characters with the default body, their weights in 16 bits.

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
    own: dict[str, NDArray[Any]] = {
        "recent": arrays.recent, "keys": arrays.keys, "values": arrays.values, "filled": arrays.filled,
        "controls": arrays.controls, "out": arrays.out, "logits": arrays.contacts_out,
        "fresh": drawn.noise.fresh, "noise": drawn.noise.first, "smooth": drawn.noise.second,
        "velocity_blend": presets.velocity_blend, "slip_correction": presets.slip_correction,
        "before": frame.before, "x": frame.x, "contacts": frame.contacts, "features": frame.features,
        "ground": frame.ground, **dict(zip(("rotations", "root", "positions"), poser.posed, strict=True)),
    }  # fmt: skip
    for array in own.values():
        array[:] = 0  # the stream has been started
    own |= {f"feet_{name}": array for name, array in body.feet.arrays.items()} | {"rise": body.rise}
    writer = _Writer()
    writer.share(*program.kept, program.position, drawn.space.mean, drawn.space.std, drawn.space.blended)
    writer.share(poser.references, body.offsets, body.scale)
    addresses = {name: writer.keep(array) for name, array in own.items()}
    addresses["position"] = writer.address_of(program.position.ctypes.data)[0]
    writer.struct(program.maps, shared=True)
    addresses["program"] = writer.struct(program.words, shared=True)
    writer.struct(pose.feet.contents)  # type: ignore[attr-defined]
    addresses |= {
        name: writer.struct(words) for name, words in (("frame", step), ("draw", draw), ("pose", pose))
    }
    fields = {
        "slot": _narrow(type(step)).slot.offset,
        "position": _narrow(type(step)).position.offset,
        "position_bytes": program.position[0].nbytes,
        "temperature": _narrow(type(draw)).temperature.offset,
    }
    return KernelImage(
        bytes(writer.shared.data), bytes(writer.own.data), tuple(writer.moved), addresses, fields
    )


class _Writer:
    """Puts arrays and structs into both parts; structs come after all arrays they point into."""

    def __init__(self) -> None:
        self.shared, self.own = _Segment(BASE), _Segment(0)
        self.moved: list[int] = []

    def share(self, *arrays: NDArray) -> None:
        """Put constants into the shared part."""
        for array in arrays:
            self._put(self.shared, array)

    def keep(self, array: NDArray) -> int:
        """Put an array of a character's state into its part."""
        return self._put(self.own, array)

    def _put(self, segment: _Segment, array: NDArray) -> int:
        assert array.flags.c_contiguous
        at = segment.put(array.astype(array.dtype.newbyteorder("<")).tobytes())
        segment.placed.append((array.ctypes.data, array.nbytes, at))
        return at

    def address_of(self, ours: int) -> tuple[int, bool]:
        """The address there of one in this process, and whether it is in a character's part."""
        for segment in (self.shared, self.own):
            for start, size, at in segment.placed:
                if start <= ours < start + size:
                    return at + ours - start, segment is self.own
        raise AssertionError("a pointer to an array that was not put anywhere")

    def struct(self, words: Any, shared: bool = False) -> int:
        """Put a struct, or an array of them; what it points to has been put before."""
        segment = self.shared if shared else self.own
        pointers: list[int] = []
        at = segment.put(bytes(self._copy(words, 0, pointers)))
        self.moved += [at + offset for offset in pointers]
        assert not (shared and pointers)
        segment.placed.append((ctypes.addressof(words), ctypes.sizeof(words), at))
        return at

    def _copy(self, value: Any, offset: int, pointers: list[int]) -> Any:
        """A value of ctypes with the addresses there; notes where pointers into a character's part are."""
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
