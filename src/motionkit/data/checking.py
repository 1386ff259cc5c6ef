"""Checks shapes and ranges of a dataset's manifest and arrays when the dataset is opened."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.data.events import KINDS
from motionkit.data.labels import type_fault
from motionkit.errors import DatasetError
from motionkit.features.control import MOST_TYPES, TRAJECTORY_COUNT
from motionkit.features.layout import FEATURE_COUNT, LAYOUTS
from motionkit.files import check_regular, is_number
from motionkit.motion.skeleton import JOINT_COUNT
from motionkit.names import nfc

MAX_ROWS = 2**40
MAX_ARRAY_BYTES = 2**50
# Largest absolute value; what is computed from it still fits float32.
MAX_VALUE = 1e12
# Shape of a row, dtype, smallest and largest value of each array.
ARRAY_KINDS: dict[str, tuple[tuple[int, ...], type, float, float]] = {
    "features": ((FEATURE_COUNT,), np.float32, -MAX_VALUE, MAX_VALUE),
    "contacts": ((4,), np.uint8, 0, 1),
    "ground": ((3,), np.float32, -MAX_VALUE, MAX_VALUE),
    "types": ((), np.int16, 0, MOST_TYPES - 1),
    "phases": ((), np.float32, -1.0, 1.0),
}


def check_manifest(path: Path, manifest: Mapping[str, Any], clip_type: type) -> None:
    """Raise DatasetError, naming file and entry, if an entry of a manifest has a wrong type, shape or value."""

    def check(key: str, good: bool, expected: str) -> None:
        if not good:
            raise DatasetError(f"{path}: the manifest is damaged: expected {key} to be {expected}")

    types: Any = manifest.get("types")
    bodies: Any = manifest.get("bodies")
    check("types", isinstance(types, list) and all(isinstance(t, str) for t in types), "names")
    faults = [type_fault(t) for t in types if type_fault(t)]
    check("types", not faults, f"names of motion types, found {''.join(faults[:1])}")
    check("types", 0 < len(types) <= MOST_TYPES and len(set(map(nfc, types))) == len(types), "distinct names")
    check("fps", is_number(manifest.get("fps"), 1.0, 1000.0), "a number from 1 to 1000")
    check("layout", manifest.get("layout") in LAYOUTS, f"one of {', '.join(LAYOUTS)}")
    body = (JOINT_COUNT, 3)
    check(
        "bodies",
        isinstance(bodies, list) and bool(bodies) and all(_table(b, body) for b in bodies),
        _table_words(body),
    )
    characters: Any = manifest.get("characters")
    check(
        "characters",
        _mapping(characters) and all(_table(b, body) for b in characters.values()),
        _table_words(body),
    )
    reference_rotations: Any = manifest.get("references")
    unit = _table(reference_rotations, (JOINT_COUNT, 4)) and bool(
        (abs(np.linalg.norm(np.array(reference_rotations), axis=1) - 1.0) < 0.01).all()
    )
    check("references", unit, f"{JOINT_COUNT} unit quaternions")
    for key, count in (("feature_scaling", FEATURE_COUNT), ("trajectory_scaling", TRAJECTORY_COUNT)):
        scaling: Any = manifest.get(key)
        good = _mapping(scaling) and all(_table(scaling.get(name), (count,)) for name in ("mean", "std"))
        check(key, good and min(scaling["std"]) >= 1e-7, f"mean and std of {count} numbers, std above 0")
    seconds: Any = manifest.get("phase_seconds")
    events: Any = manifest.get("phase_events", {})
    good = (
        _mapping(seconds)
        and set(seconds) <= set(types)
        and all(is_number(s, 1e-3, 3600.0) for s in seconds.values())
    )
    check("phase_seconds", good, "seconds of some of the types")
    good = _mapping(events) and set(events) <= set(types) and all(e in ("", *KINDS) for e in events.values())
    check("phase_events", good, f"of some of the types one of {', '.join(KINDS)} or nothing")
    opposites: Any = manifest.get("mirrored_types", {})
    good = (
        _mapping(opposites)
        and set(opposites) <= set(types)
        and all(opposite in types for opposite in opposites.values())
    )
    check("mirrored_types", good, "types of some of the types")
    clips: Any = manifest.get("clips")
    check("clips", isinstance(clips, list), "a list")
    for number, clip in enumerate(clips):
        check(f"clip {number}", _is_clip(clip, clip_type, len(bodies)), "a clip of the arrays")


def _table_words(shape: tuple[int, int]) -> str:
    return f"tables of {shape[0]} times {shape[1]} numbers"


def _mapping(value: object) -> bool:
    return isinstance(value, dict)


def _table(value: object, shape: tuple[int, ...]) -> bool:
    """Whether nested lists of numbers have this shape."""
    if not shape:
        return is_number(value, -MAX_VALUE, MAX_VALUE)
    return (
        isinstance(value, list) and len(value) == shape[0] and all(_table(item, shape[1:]) for item in value)
    )


def _is_clip(value: object, clip_type: type, bodies: int) -> bool:
    names = {field.name for field in fields(clip_type)}
    return (
        isinstance(value, dict)
        and names - {"mirrored"} <= set(value) <= names
        and isinstance(value["name"], str)
        and isinstance(value["subject"], str)
        and is_number(value["start"], 0, MAX_ROWS, whole=True)
        and is_number(value["frames"], 1, MAX_ROWS, whole=True)
        and value["split"] in ("train", "validation", "test")
        and is_number(value["body"], 0, bodies - 1, whole=True)
        and isinstance(value.get("mirrored", False), bool)
    )


def open_array(path: Path, name: str, rows: int) -> np.ndarray:
    """Open an array of a dataset, memory-mapped; raises DatasetError for a wrong shape or dtype, or too few rows."""
    columns, dtype, _, _ = ARRAY_KINDS[name]
    check_regular(path, MAX_ARRAY_BYTES, "an array of the dataset", DatasetError)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy warns where it guesses a header
            array = np.lib.format.open_memmap(path, mode="r")
    except Exception as error:  # numpy evaluates headers as Python, which can raise many types
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise DatasetError(f"{path}: cannot be read ({reason})") from None
    if array.ndim != 1 + len(columns) or array.shape[1:] != columns or array.dtype != np.dtype(dtype):
        expected = ("N", *map(str, columns))
        raise DatasetError(
            f"{path}: expected ({', '.join(expected)}) of {np.dtype(dtype)}, found {array.shape} of {array.dtype}"
        )
    if len(array) < rows:
        raise DatasetError(f"{path}: expected {rows} rows, found {len(array)}")
    return array


def check_range(path: Path, name: str, values: np.ndarray, first: int = 0, most: float | None = None) -> None:
    """Raise DatasetError for a value outside the array's range, or above most; values are its rows from `first` on."""
    _, _, low, high = ARRAY_KINDS[name]
    high = high if most is None else most
    if values.size and not (values.min() >= low and values.max() <= high):  # True for NaN
        flat = values.reshape(len(values), -1)
        row = int(np.flatnonzero(~((flat >= low) & (flat <= high)).all(axis=1))[0])
        found = next(x for x in flat[row].tolist() if not low <= x <= high)
        raise DatasetError(f"{path}: row {first + row} has {found:g}, expected {low:g} to {high:g}")


def same_length(folder: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Raise DatasetError if arrays of a folder differ in their number of rows."""
    lengths: Iterable[str] = (f"{name} {len(array)}" for name, array in arrays.items())
    if len({len(array) for array in arrays.values()}) > 1:
        raise DatasetError(f"{folder}: the arrays have different numbers of rows: {', '.join(lengths)}")
