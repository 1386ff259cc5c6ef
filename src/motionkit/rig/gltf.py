"""Writes and reads binary glTF 2.0 files: a JSON document and one buffer."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.files import atomic_write, parse_json, read_bytes

MAGIC, JSON_CHUNK, BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125
VERTICES, INDICES = 34962, 34963  # targets of buffer views
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
MAX_BYTES = 2**30


def _version() -> str:
    try:
        return version("motionkit")
    except PackageNotFoundError:
        return "source"


@dataclass
class GltfDocument:
    """A document to write: its JSON, and the bytes of its buffer."""

    json: dict[str, Any] = field(
        default_factory=lambda: {"asset": {"version": "2.0", "generator": f"motionkit {_version()}"}}
    )
    data: bytearray = field(default_factory=bytearray)

    def add(self, kind: str, value: dict[str, Any]) -> int:
        """Append to one of the lists, such as "nodes"; returns the index."""
        values = self.json.setdefault(kind, [])
        values.append(value)
        return len(values) - 1

    def accessor(self, values: Array, kind: str, target: int | None = None, bounds: bool = False) -> int:
        """Append an array (N, ...) to the buffer; returns the index of its accessor.

        Args:
            values: float32, uint16 or uint32.
            kind: "SCALAR", "VEC3", "VEC4" or "MAT4".
            target: VERTICES or INDICES for arrays of a mesh.
            bounds: write the smallest and largest values, which positions and times need.
        """
        component = {"f": FLOAT, "u2": UNSIGNED_SHORT, "u4": UNSIGNED_INT}[
            "f" if values.dtype.kind == "f" else f"u{values.dtype.itemsize}"
        ]
        array = np.ascontiguousarray(values, _COMPONENTS[component])
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.data += array.tobytes()
        entry: dict[str, Any] = {
            "bufferView": self.add("bufferViews", view | ({"target": target} if target else {})),
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if bounds:
            flat = array.reshape(len(array), -1)
            entry |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        return self.add("accessors", entry)

    def write(self, path: str | Path) -> None:
        """Write the document as a binary file, atomically."""
        self.data += b"\0" * (-len(self.data) % 4)
        if self.data:
            self.json["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + (8 + len(self.data) if self.data else 0)
        with atomic_write(path, "wb") as file:
            file.write(struct.pack("<III", MAGIC, 2, size))
            file.write(struct.pack("<II", len(text), JSON_CHUNK) + text)
            if self.data:
                file.write(struct.pack("<II", len(self.data), BIN_CHUNK))
                file.write(self.data)


class GltfFile:
    """A binary glTF file: its JSON and its arrays."""

    def __init__(self, path: str | Path) -> None:
        """Read a file; raises MotionkitError, naming it, if it is not a binary glTF 2.0 file."""
        self.path = path
        data = read_bytes(path, MAX_BYTES, "a binary glTF file")
        if len(data) < 20 or struct.unpack_from("<I", data)[0] != MAGIC:
            raise self.fault("is no binary glTF file (.glb)")
        if struct.unpack_from("<I", data, 4)[0] != 2:
            raise self.fault(f"is glTF {struct.unpack_from('<I', data, 4)[0]}, expected 2")
        chunks: dict[int, bytes] = {}
        place = 12
        while place + 8 <= len(data):
            size, kind = struct.unpack_from("<II", data, place)
            if place + 8 + size > len(data):
                raise self.fault("ends in the middle of a chunk")
            chunks.setdefault(kind, data[place + 8 : place + 8 + size])
            place += 8 + size
        if JSON_CHUNK not in chunks:
            raise self.fault("has no JSON chunk")
        try:
            text = chunks[JSON_CHUNK].decode()
        except UnicodeDecodeError:
            raise self.fault("its JSON chunk is not UTF-8 text") from None
        self.json: dict[str, Any] = parse_json(text, path)
        if not isinstance(self.json, dict):
            raise self.fault("its JSON chunk is no object")
        self.data = chunks.get(BIN_CHUNK, b"")

    def fault(self, message: str) -> MotionkitError:
        """An error about this file."""
        return MotionkitError(f"{self.path}: {message}")

    def items(self, kind: str) -> list[dict[str, Any]]:
        """One of the lists of objects of the JSON, such as "nodes"; empty if absent."""
        found = self.json.get(kind, [])
        if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
            raise self.fault(f"{kind} is no list of objects")
        return found

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """An object of a list by index."""
        found = self.items(kind)
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(found):
            raise self.fault(f"refers to {kind}[{index}], which it does not have")
        return found[index]

    def array(self, index: Any, width: int) -> Array:
        """The numbers (N, width) of an accessor of floats.

        Raises:
            MotionkitError: the accessor has another shape or type, or lies outside the buffer.
        """
        accessor = self.item("accessors", index)
        where = f"accessors[{index}]"
        if "sparse" in accessor or accessor.get("componentType") != FLOAT:
            raise self.fault(f"{where} is sparse or compressed, expected floats")
        if _COUNTS.get(str(accessor.get("type"))) != width:
            raise self.fault(f"{where} has the type {accessor.get('type')}, expected {width} numbers")
        view = self.item("bufferViews", accessor.get("bufferView"))
        if view.get("buffer") != 0 or self.item("buffers", 0).get("uri") is not None:
            raise self.fault(f"{where} is not in the file's own buffer")
        count, first = self._whole(accessor, "count", 0), self._whole(accessor, "byteOffset", 0)
        start, stride = self._whole(view, "byteOffset", 0) + first, self._whole(view, "byteStride", 4 * width)
        if stride < 4 * width or count == 0 or start + (count - 1) * stride + 4 * width > len(self.data):
            raise self.fault(f"{where} is empty or reaches beyond the buffer")
        shape, strides = (count, width), (stride, 4)
        values = np.ndarray(shape, "<f4", self.data, start, strides).astype(np.float32)
        if not bool(np.isfinite(values).all()):
            raise self.fault(f"{where} holds a number that is not finite")
        return values

    def _whole(self, item: dict[str, Any], name: str, default: int) -> int:
        value = item.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_BYTES:
            raise self.fault(f"{name} is {str(value)[:20]}, expected a whole number up to {MAX_BYTES}")
        return value
