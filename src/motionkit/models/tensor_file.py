"""Reads safetensors files from untrusted sources: names, types and shapes first, tensors later."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from motionkit.arrays import Array
from motionkit.errors import ModelError
from motionkit.files import open_regular, parse_json
from motionkit.models.file_check import TensorFacts

MOST_HEADER = 8 * 2**20  # bytes of the largest header; that of the bundled model has 120,000


class TensorFile:
    """An open safetensors file: a JSON document, {} if there is none, and type and shape of every tensor by name."""

    def __init__(self, where: str, file: Any, key: str) -> None:
        self._file = file
        text = (file.metadata() or {}).get(key)
        self.metadata: Any = {} if text is None else parse_json(text, where, ModelError)
        self.found: dict[str, TensorFacts] = {}
        for name in file.keys():
            part = file.get_slice(name)
            self.found[name] = TensorFacts(str(part.get_dtype()), tuple(part.get_shape()))
        self._stored = {name: name for name in self.found}

    def rename(self, name_of: Callable[[str], str]) -> None:
        """Rename all tensors. Raises ModelError if two get the same name."""
        found: dict[str, TensorFacts] = {}
        stored: dict[str, str] = {}
        for name, facts in self.found.items():
            other = name_of(name)
            if other in found:
                raise ModelError(f"the tensors {stored[other]!a} and {name!a} are one and the same")
            found[other], stored[other] = facts, self._stored[name]
        self.found, self._stored = found, stored

    def read(self, name: str) -> Array:
        """Return a tensor of the file."""
        return self._file.get_tensor(self._stored[name])

    def read_all(self) -> dict[str, Array]:
        """Return all tensors by name."""
        return {name: self.read(name) for name in self.found}


@contextmanager
def open_tensors(path: str | Path, key: str, what: str, limit: int) -> Iterator[TensorFile]:
    """Open a safetensors file whose metadata holds a JSON document under a key.

    Args:
        what: the expected kind of file, for messages, such as "a motionkit model".

    Raises:
        ModelError: if it is not a safetensors file, is larger than limit, or is not a regular file.
    """
    path = Path(path)
    with open_regular(path, limit, what, ModelError) as raw:
        length = int.from_bytes(raw.read(8), "little")
    if length > MOST_HEADER:
        raise ModelError(
            f"{path}: not {what} (its header has {length} bytes, expected at most {MOST_HEADER})"
        )
    try:
        with safe_open(str(path), framework="numpy") as file:
            yield TensorFile(f"{path}: not {what}", file, key)
    except (SafetensorError, OSError) as error:
        raise ModelError(f"{path}: not {what} ({str(error).splitlines()[0]})") from None
