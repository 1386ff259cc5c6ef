"""Writes and reads binary glTF 2.0 files: a JSON document and one buffer; adds to a file that stays as it is."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.files import atomic_write, parse_json, read_bytes
from motionkit.rig.fbx import ENDING as FBX
from motionkit.rig.fbx import glb_of_fbx

MAGIC, JSON_CHUNK, BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125
VERTICES, INDICES = 34962, 34963  # targets of buffer views
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_UNSIGNED = (5121, 5123, 5125)
_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_LARGEST = {
    5120: 127,
    5121: 255,
    5122: 32767,
    5123: 65535,
}  # integers that stand for 1 in normalized accessors
MAX_BYTES = 2**30


def _version() -> str:
    try:
        return version("motionkit")
    except PackageNotFoundError:
        return "source"


@dataclass
class GltfDocument:
    """A document to write: its JSON, and the bytes of its buffer.

    What is added to a file (GltfFile.addition) counts on from the file: `counts` has the lengths of its lists, `buffer`
    and `start` say which buffer the bytes continue, and where.
    """

    json: dict[str, Any] = field(
        default_factory=lambda: {"asset": {"version": "2.0", "generator": f"motionkit {_version()}"}}
    )
    data: bytearray = field(default_factory=bytearray)
    counts: dict[str, int] = field(default_factory=dict)
    buffer: int = 0
    start: int = 0

    def add(self, kind: str, value: dict[str, Any]) -> int:
        """Append to one of the lists, such as "nodes"; returns the index."""
        values = self.json.setdefault(kind, [])
        values.append(value)
        return self.counts.get(kind, 0) + len(values) - 1

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
        place = self.start + len(self.data)
        view = {"buffer": self.buffer, "byteOffset": place, "byteLength": array.nbytes}
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
        if self.data:
            self.json["buffers"] = [{"byteLength": len(self.data) + -len(self.data) % 4}]
        text = json.dumps(self.json, separators=(",", ":"), allow_nan=False)
        _write_chunks(path, text, [(BIN_CHUNK, bytes(self.data))] if self.data else [])


def _write_chunks(path: str | Path, text: str, chunks: Sequence[tuple[int, bytes]]) -> None:
    """Write a binary file of a JSON text and other chunks, atomically."""
    first = text.encode()
    parts = [(JSON_CHUNK, first + b" " * (-len(first) % 4))]
    parts += [(kind, data + b"\0" * (-len(data) % 4)) for kind, data in chunks]
    with atomic_write(path, "wb") as file:
        file.write(struct.pack("<III", MAGIC, 2, 12 + sum(8 + len(data) for _, data in parts)))
        for kind, data in parts:
            file.write(struct.pack("<II", len(data), kind) + data)


class GltfFile:
    """A binary glTF file: its JSON and its arrays."""

    def __init__(self, path: str | Path) -> None:
        """Read a file, or an FBX file as one; raises MotionkitError, naming it, if it is not a binary glTF 2.0 file."""
        self.path = path
        if Path(path).suffix.lower() == FBX:
            data = glb_of_fbx(path)
        else:
            data = read_bytes(path, MAX_BYTES, "a binary glTF file")
        if len(data) < 20 or struct.unpack_from("<I", data)[0] != MAGIC:
            raise self.fault("is no binary glTF file (.glb)")
        if struct.unpack_from("<I", data, 4)[0] != 2:
            raise self.fault(f"is glTF {struct.unpack_from('<I', data, 4)[0]}, expected 2")
        chunks: list[tuple[int, bytes]] = []
        place = 12
        while place + 8 <= len(data):
            size, kind = struct.unpack_from("<II", data, place)
            if place + 8 + size > len(data):
                raise self.fault("ends in the middle of a chunk")
            chunks.append((kind, data[place + 8 : place + 8 + size]))
            place += 8 + size
        if not chunks or chunks[0][0] != JSON_CHUNK:
            raise self.fault("has no JSON chunk")
        try:
            self.text = chunks[0][1].decode()
        except UnicodeDecodeError:
            raise self.fault("its JSON chunk is not UTF-8 text") from None
        self.json: dict[str, Any] = parse_json(self.text, path)
        if not isinstance(self.json, dict):
            raise self.fault("its JSON chunk is no object")
        self._checked: set[str] = set()
        self.chunks = chunks[1:]
        self.data = dict(reversed(self.chunks)).get(BIN_CHUNK, b"")

    def fault(self, message: str) -> MotionkitError:
        """An error about this file."""
        return MotionkitError(f"{self.path}: {message}")

    def by_motionkit(self) -> bool:
        """Whether motionkit made the file."""
        asset = self.json.get("asset")
        return isinstance(asset, dict) and str(asset.get("generator")).startswith("motionkit ")

    def items(self, kind: str) -> list[dict[str, Any]]:
        """One of the lists of objects of the JSON, such as "nodes"; empty if absent."""
        found = self.json.get(kind, [])
        if (
            kind not in self._checked
        ):  # each list once: files with fifty animations refer to thousands of accessors
            if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
                raise self.fault(f"{kind} is no list of objects")
            self._checked.add(kind)
        return found

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """An object of a list by index."""
        found = self.items(kind)
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(found):
            raise self.fault(f"refers to {kind}[{index}], which it does not have")
        return found[index]

    def array(self, index: Any, width: int, finite: bool = True) -> Array:
        """The numbers (N, width) of an accessor of floats or normalized integers, sparse or not; finite ones, if asked.

        Raises:
            MotionkitError: the accessor has another shape or type, is compressed, or lies outside the buffer.
        """
        accessor = self.item("accessors", index)
        where, kind = f"accessors[{index}]", accessor.get("componentType")
        if kind != FLOAT and not (
            type(kind) is int and kind in _LARGEST and accessor.get("normalized") is True
        ):
            raise self.fault(f"{where} has no floats or normalized integers")
        if _COUNTS.get(str(accessor.get("type"))) != width:
            raise self.fault(f"{where} has the type {accessor.get('type')}, expected {width} numbers")
        count, sparse = self._whole(accessor, "count", 0), accessor.get("sparse")
        if sparse is None or "bufferView" in accessor:
            values = self._elements(where, accessor, kind, count, width)
        else:
            values = np.zeros((self._bounded(where, count, width), width), np.float32)
        if sparse is not None:
            values = self._replaced(where, sparse, values, kind)
        values = values.astype(np.float32)
        if kind in _LARGEST:
            values = np.maximum(values / _LARGEST[kind], np.float32(-1.0))
        if finite and not bool(np.isfinite(values).all()):
            raise self.fault(f"{where} holds a number that is not finite")
        return values

    def whole_numbers(self, index: Any, width: int) -> Array:
        """The whole numbers (N, width) of an accessor; raises MotionkitError as array does."""
        accessor = self.item("accessors", index)
        where, kind = f"accessors[{index}]", accessor.get("componentType")
        if kind not in _UNSIGNED or _COUNTS.get(str(accessor.get("type"))) != width:
            raise self.fault(f"{where} has no {width} whole numbers each")
        return self._elements(where, accessor, kind, self._whole(accessor, "count", 0), width)

    def _replaced(self, where: str, sparse: Any, values: Array, kind: Any) -> Array:
        """Values (N, C) with those that a sparse accessor replaces."""
        indices, others = (
            sparse.get(name) if isinstance(sparse, dict) else None for name in ("indices", "values")
        )
        if not isinstance(indices, dict) or not isinstance(others, dict):
            raise self.fault(f"{where} is sparse without indices and values")
        if indices.get("componentType") not in _UNSIGNED:
            raise self.fault(f"{where} has sparse indices of an unknown type")
        count = self._whole(sparse, "count", 0)
        places = self._elements(where, indices, indices["componentType"], count, 1)[:, 0].astype(np.int64)
        if int(places.max()) >= len(values):
            raise self.fault(f"{where} replaces number {int(places.max())} of {len(values)}")
        out = values.copy()
        out[places] = self._elements(where, others, kind, count, values.shape[1])
        return out

    def _elements(self, where: str, item: dict[str, Any], kind: Any, count: int, width: int) -> Array:
        """Elements (count, width) of a buffer view, which may be interleaved with others."""
        view, form = self.item("bufferViews", item.get("bufferView")), np.dtype(_COMPONENTS[kind])
        if "EXT_meshopt_compression" in (view.get("extensions") or {}):
            raise self.fault(f"{where} is compressed; write the animation uncompressed (gltfpack without -c)")
        if view.get("buffer") != 0 or self.item("buffers", 0).get("uri") is not None:
            raise self.fault(f"{where} is not in the file's own buffer")
        size = form.itemsize * width
        start = self._whole(view, "byteOffset", 0) + self._whole(item, "byteOffset", 0)
        stride = self._whole(view, "byteStride", size)
        if stride < size or count == 0 or start + (count - 1) * stride + size > len(self.data):
            raise self.fault(f"{where} is empty or reaches beyond the buffer")
        return np.ndarray((count, width), form, self.data, start, (stride, form.itemsize))

    def _bounded(self, where: str, count: int, width: int) -> int:
        """The number of elements of an accessor without a buffer view."""
        if not 0 < count * width <= MAX_BYTES // 64:
            raise self.fault(f"{where} has {count:,} elements")
        return count

    def addition(self) -> GltfDocument:
        """An empty document for what will be added to this file by write_added.

        Raises:
            MotionkitError: the file's first buffer is another file, which would be missing beside the written file.
        """
        kinds = ("accessors", "animations", "buffers", "bufferViews")
        counts = {kind: len(self.items(kind)) for kind in kinds}
        for number, buffer in enumerate(self.items("buffers")):
            place = buffer.get("uri")
            if place is not None and not str(place).startswith("data:"):
                raise self.fault(
                    f"buffers[{number}] is another file, {str(place)[:80]!r}; expected one file with all"
                )
            size = self._whole(buffer, "byteLength", -1)
            if number == 0 and place is None and size > len(self.data):
                raise self.fault(f"its buffer has {len(self.data):,} bytes, expected {size:,}")
        embedded = not counts["buffers"] or self.items("buffers")[0].get("uri") is None
        if embedded:
            return GltfDocument({}, bytearray(-len(self.data) % 4), counts, 0, len(self.data))
        return GltfDocument({}, bytearray(), counts, counts["buffers"], 0)

    def write_added(
        self,
        path: str | Path,
        added: GltfDocument,
        instead: Sequence[str] = (),
        parts: Mapping[int, dict[str, Any]] | None = None,
    ) -> None:
        """Write this file with the lists and the bytes of an addition; all else stays byte for byte.

        Old entries of the lists `instead`, such as "animations", are left out. parts has translation, rotation and
        scale of nodes with a matrix, which may not be animated.
        """
        lists = {
            kind: [json.dumps(value, separators=(",", ":"), allow_nan=False) for value in values]
            for kind, values in added.json.items()
        }
        text, size = self.text, added.start + len(added.data)
        chunks = list(self.chunks)
        if added.buffer:
            uri = "data:application/octet-stream;base64," + base64.b64encode(added.data).decode()
            lists["buffers"] = [json.dumps({"byteLength": len(added.data), "uri": uri})]
        elif added.counts["buffers"]:
            text = _with_length(text, size)
        else:
            lists["buffers"] = [f'{{"byteLength":{size}}}']
        if not added.buffer:
            place = next((i for i, (kind, _) in enumerate(chunks) if kind == BIN_CHUNK), None)
            whole = (BIN_CHUNK, self.data + bytes(added.data))
            chunks[slice(0, 0) if place is None else slice(place, place + 1)] = [whole]
        text = _with_parts(text, parts or {})
        for kind, entries in lists.items():
            text = _with_entries(text, kind, entries, kind in instead)
        _write_chunks(path, text, chunks)

    def _whole(self, item: dict[str, Any], name: str, default: int) -> int:
        value = item.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_BYTES:
            raise self.fault(f"{name} is {str(value)[:20]}, expected a whole number up to {MAX_BYTES}")
        return value


def _members(text: str, start: int) -> dict[str, tuple[int, int]]:
    """Where the values of a valid JSON object that begins at a place lie in the text: first and end."""
    decode, found = json.JSONDecoder().raw_decode, {}
    place = _after_space(text, start + 1)
    while text[place] != "}":
        name, place = decode(text, place)
        first = _after_space(text, _after_space(text, place) + 1)  # beyond the colon
        _, end = decode(text, first)
        found[name] = (first, end)
        place = _after_space(text, end)
        place = _after_space(text, place + 1) if text[place] == "," else place
    return found


def _after_space(text: str, place: int) -> int:
    while text[place] in " \t\r\n":
        place += 1
    return place


def _with_entries(text: str, kind: str, entries: list[str], instead: bool) -> str:
    """The text of a document with entries at the end of one of its lists, or instead of what it has."""
    top = _after_space(text, 0)
    members = _members(text, top)
    more = ",".join(entries)
    if kind not in members:
        start, end = top + 1, top + 1
        put = f'"{kind}":[{more}]' + ("," if members else "")
    elif instead or text[_after_space(text, members[kind][0] + 1)] == "]":
        (start, end), put = members[kind], f"[{more}]"
    else:
        start = end = members[kind][1] - 1
        put = f",{more}"
    return text[:start] + put + text[end:]


def _with_length(text: str, size: int) -> str:
    """The text of a document with another length of its first buffer."""
    first = _after_space(text, _members(text, _after_space(text, 0))["buffers"][0] + 1)
    start, end = _members(text, first)["byteLength"]
    return f"{text[:start]}{size}{text[end:]}"


def _with_parts(text: str, parts: Mapping[int, dict[str, Any]]) -> str:
    """The text of a document with translation, rotation and scale in place of the matrix of some nodes."""
    if not parts:
        return text
    place, edits = _members(text, _after_space(text, 0))["nodes"][0], []
    for node in range(max(parts) + 1):
        place = _after_space(text, place + 1)  # beyond the bracket, or the comma
        if node in parts:
            start, end = _members(text, place)["matrix"]
            edits.append((text.rindex('"matrix"', place, start), end, json.dumps(parts[node])[1:-1]))
        place = _after_space(text, json.JSONDecoder().raw_decode(text, place)[1])
    for start, end, put in reversed(edits):
        text = text[:start] + put + text[end:]
    return text
