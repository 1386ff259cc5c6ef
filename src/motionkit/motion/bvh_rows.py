"""The numbers of a BVH file: its motion block, and what is repaired in it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motionkit.errors import BvhError
from motionkit.motion.rotations import quat_continuous, quat_normalize
from motionkit.names import counted
from motionkit.reading import strictly

# Limit of offsets, positions (10 km in millimetres) and angles (28,000 turns in degrees). No real file reaches it in
# any unit, and results stay far within the range of float32.
MAX_NUMBER = 1e7
MOST_UNKNOWN = 0.5  # share of all values that may be no numbers
SCALED = 0.01  # deviation from 1 above which scale channels that are left out are reported
_AT_ONCE = 1000  # rows whose words are counted at a time, which takes 20 times the memory of their text
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
# As C libraries write values that are no numbers: nan, -nan(ind), -1.#IND00, 1.#QNAN.
_NO_NUMBER = re.compile(r"[-+]?(?:nan(?:\(\w*\))?|1[.,]#(?:ind|qnan|snan|inf)\d*)", re.IGNORECASE)


class Notes:
    """What was repaired in a file; reading strictly raises the fault instead."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        self.strict = strictly()
        self._counts: dict[tuple[str, str], int] = {}

    def repaired(self, noun: str, done: str, fault: str, line: int, count: int = 1) -> None:
        """Note what was done to how many things, or raise BvhError with the fault."""
        if self.strict:
            raise BvhError(self.path, fault, line)
        self._counts[noun, done] = self._counts.get((noun, done), 0) + count

    @property
    def lines(self) -> tuple[str, ...]:
        """The notes, such as "2 comment lines left out"."""
        return tuple(f"{counted(count, noun)} {done}" for (noun, done), count in self._counts.items())


def floats(words: list[str], line: int, what: str, notes: Notes, unknown: bool = False) -> list[float]:
    """The numbers of a line; words that are no numbers become NaN if unknown, else they raise BvhError."""
    numbers = []
    for word in words:
        try:
            number = float(word.replace("_", "?"))  # Python would read 1_0 as 10
        except ValueError:
            fault = f"expected numbers for {what}, found {word[:40]!r}"
            if unknown and not notes.strict and _NO_NUMBER.fullmatch(word):
                number = float("nan")
            elif _DECIMAL_COMMA.fullmatch(word):
                notes.repaired("number", "with a decimal comma", fault, line)
                number = float(word.replace(",", "."))
            else:
                raise BvhError(notes.path, fault, line) from None
        if not abs(number) <= MAX_NUMBER and not (unknown and not np.isfinite(number)):
            fault = f"expected finite numbers up to {MAX_NUMBER:,.0f} for {what}, found {word[:40]!r}"
            raise BvhError(notes.path, fault, line)
        numbers.append(number)
    return numbers


def read_rows(
    lines: list[str], first: int, frames: int, channels: list[str], notes: Notes
) -> NDArray[np.float64]:
    """The motion block (T, C), finite; T is 0 only for a file that declares no frames and has none.

    The lines are those of the file, `first` the index of the one after the frame time. Raises BvhError for a row or a
    value that cannot be read.
    """
    rows = [i for i in range(first, len(lines)) if lines[i].strip()]
    if not rows and frames == 0:
        if first < len(lines):
            notes.repaired("frame", "of the rest pose, because the file has no motion", "", first)
        return np.zeros((0, len(channels)))
    rows, wrapped = _whole_rows(lines, rows, first, frames, len(channels), notes)
    if wrapped:
        words = [(word, i + 1) for i in rows for word in lines[i].split()]
        numbers = [floats([word], line, "the motion", notes, unknown=True)[0] for word, line in words]
        values = np.array(numbers).reshape(-1, len(channels))
        places = [words[row * len(channels)][1] for row in range(len(values))]
    else:
        values = _parse_values(lines, rows, notes)
        places = [i + 1 for i in rows]
    if not notes.strict:
        values = filled(values, channels, notes)
    found = implausible_value(values)
    if found:
        raise BvhError(notes.path, found[1], places[found[0]])
    scales = values[:, [name.endswith("scale") for name in channels]]
    if scales.size and np.abs(scales - 1.0).max() > SCALED:
        far = int((np.abs(scales - 1.0) > SCALED).any(axis=1).sum())
        notes.repaired("frame", "whose scale is not 1 left unscaled", "", first, far)
    return values


def _whole_rows(
    lines: list[str], rows: list[int], first: int, frames: int, channels: int, notes: Notes
) -> tuple[list[int], bool]:
    """The rows to read, and whether frames are wrapped over several of them; raises BvhError for other rows."""
    has = f"declares {frames} frames but has {len(rows)}"
    counts = _words_per_line(lines, rows)
    wrong = np.flatnonzero(counts != channels)
    if wrong.size and counts.sum() == channels * frames and not notes.strict:
        notes.repaired("frame", f"put together from {len(rows)} lines", "", first, frames)
        return rows, True
    cut = len(rows) > 1 and wrong.tolist() == [len(rows) - 1] and counts[-1] < channels
    if len(rows) < frames and not (cut and len(rows) == frames):
        fault, last = f"{has}; the file is truncated", rows[-1] + 1 if rows else first
        if not rows:
            raise BvhError(notes.path, fault, last)
        notes.repaired("frame", f"instead of the declared {frames}", fault, last, len(rows) - cut)
    elif len(rows) > frames:
        notes.repaired("frame", f"instead of the declared {frames}", has, rows[frames] + 1, len(rows) - cut)
    if wrong.size:
        row = int(wrong[0])
        tail = "; the file is truncated" if row == frames - 1 and counts[row] < channels else ""
        fault = f"expected {channels} values in frame {row}, found {int(counts[row])}{tail}"
        if not cut:
            raise BvhError(notes.path, fault, rows[row] + 1)
        notes.repaired("cut frame", "at the end left out", fault, rows[row] + 1)
        rows = rows[:-1]
    return rows, False


def implausible_value(values: NDArray[np.float64]) -> tuple[int, str] | None:
    """The first frame of a motion block (T, C) with an implausible value, and a message; None if all are plausible."""
    if not values.size or (values.min() >= -MAX_NUMBER and values.max() <= MAX_NUMBER):  # False for NaN
        return None
    row = int(np.flatnonzero(~(np.abs(values) <= MAX_NUMBER).all(axis=1))[0])
    column = int(np.flatnonzero(~(np.abs(values[row]) <= MAX_NUMBER))[0])
    number = values[row, column]
    expected = f"a number up to {MAX_NUMBER:,.0f}" if np.isfinite(number) else "a finite number"
    return row, f"value {column + 1} of frame {row} is {number:g}, expected {expected}"


def filled(values: NDArray[np.float64], channels: list[str], notes: Notes) -> NDArray[np.float64]:
    """The motion block with values that are no numbers filled between their neighbours in time.

    Angles take the shorter way round. A channel without any number becomes zero. Too many such values stay.
    """
    known = np.isfinite(values)
    if known.all():
        return values
    if known.mean() < 1.0 - MOST_UNKNOWN:
        return values
    values, times = np.where(known, values, 0.0), np.arange(len(values))
    for column in np.flatnonzero(~known.all(axis=0)):
        here = known[:, column]
        if here.any():
            angle = channels[column].endswith("rotation")
            known_values = values[here, column]
            known_values = np.unwrap(known_values, period=360.0) if angle else known_values
            values[~here, column] = np.interp(times[~here], times[here], known_values)
    whole = ~known.any(axis=0)
    between = int((~known[:, ~whole]).sum())
    if between:
        notes.repaired("value", "without a number filled from neighbouring frames", "", 1, between)
    if whole.any():
        notes.repaired("channel", "without any number set to zero", "", 1, int(whole.sum()))
    return values


def filled_turns(turns: NDArray[np.float64], notes: Notes) -> NDArray[np.float64]:
    """Quaternions (T, J, 4) filled likewise, each as a whole, the shorter way; without any, unturned."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(turns).all(axis=-1))
    if known.all():
        return turns
    turns = np.where(known[..., None], turns, np.nan)
    for joint in np.flatnonzero(~known.all(axis=0)):
        here = known[:, joint]
        turns[here, joint] = quat_continuous(turns[here, joint]) if here.any() else turns[here, joint]
    turns = filled(turns.reshape(len(turns), -1), [""] * turns[0].size, notes).reshape(turns.shape)
    turns[:, ~known.any(axis=0), 0] = 1.0
    turns[~known] = quat_normalize(turns[~known])
    return turns


def _words_per_line(lines: list[str], rows: list[int]) -> NDArray[np.int64]:
    """Number of words in each row, counted in bytes, which is far faster than splitting every line."""
    counts = [np.zeros(0, np.int64)]
    for begin in range(0, len(rows), _AT_ONCE):
        some = rows[begin : begin + _AT_ONCE]
        block = "\n".join(lines[i] for i in some).encode("utf-8", "replace")
        data = np.frombuffer(b"\n" + block, dtype=np.uint8)
        space = data <= 32
        starts = space[:-1] & ~space[1:]
        line_of = np.cumsum(data[:-1] == 10) - 1
        counts.append(np.bincount(line_of[starts], minlength=len(some)))
    return np.concatenate(counts)


def _parse_values(lines: list[str], rows: list[int], notes: Notes) -> NDArray[np.float64]:
    try:
        return np.loadtxt((lines[i] for i in rows), dtype=np.float64, ndmin=2, comments=None)
    except ValueError:
        numbers = [
            floats(lines[i].split(), i + 1, f"frame {row}", notes, unknown=True) for row, i in enumerate(rows)
        ]
    if len({len(row) for row in numbers}) > 1:  # other spaces than those that were counted
        raise BvhError(notes.path, "the motion block is not numbers", rows[0] + 1)
    return np.array(numbers)
