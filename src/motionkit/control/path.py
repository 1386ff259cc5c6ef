"""Paths on the ground (the paper's trajectory J): parts with points, a motion type and a speed.

Inside, lengths are cm and speeds cm per second. Files and named shapes use metres and metres per second.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from ctypes import byref
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array, length
from motionkit.control.steering_kernel import Part, steering_library
from motionkit.errors import ControlError, naming
from motionkit.files import check_fields, parse_json, read_text
from motionkit.names import nfc, unknown_name

METRE = 100.0
SPACING = 2.0  # cm between the points a path is resampled to, as steering_kernel.c has it
SHORTEST = 2 * SPACING  # cm, of a part
MAX_LENGTH = 10_000 * METRE
IN_METRES = "paths are in metres: divide by 100 if yours is in centimetres"
MAX_COORDINATE = 5000.0  # metres; places in float32 are exact to 0.03 cm there, and a body shakes further out
MAX_TYPE = 100  # letters
MAX_STOP = 600.0  # seconds


@dataclass(frozen=True, eq=False)
class PathPart:
    """A stretch of path.

    Attributes:
        points: (N, 2) x, z in cm.
        type: motion type on it.
        speed: cm/s; None for the usual speed of the type.
        stop: seconds to stand still at its end.
    """

    points: Array
    type: str
    speed: float | None = None
    stop: float = 0.0


@dataclass(frozen=True, eq=False)
class Path2D:
    """A path resampled evenly, with the part each point belongs to.

    Attributes:
        points: (N, 2) x, z in cm, SPACING apart.
        tangents: (N, 2) unit directions.
        part: (N,) index of each point's part.
        parts: the parts.
    """

    points: Array
    tangents: Array
    part: Array
    parts: tuple[PathPart, ...]

    @property
    def length(self) -> float:
        """Arc length in cm."""
        return (len(self.points) - 1) * SPACING

    def scaled(self, factor: float) -> Path2D:
        """The path with points and speeds times a factor; raises ControlError like make_path."""
        return make_path([
            replace(part, points=part.points * factor, speed=part.speed and part.speed * factor)
            for part in self.parts
        ])  # fmt: skip


def make_path(parts: list[PathPart]) -> Path2D:
    """Join parts end to end.

    Raises:
        ControlError: a part is shorter than 4 cm or has values out of range, or the path is too long.
    """
    if not parts:
        raise ControlError("the path has no parts")
    parts = [replace(part, points=_points(number, part)) for number, part in enumerate(parts, 1)]
    for number, part in enumerate(parts, 1):
        if not 0.0 <= part.stop < math.inf:
            raise ControlError(
                f"part {number} of the path ({part.type}): expected a stop of 0 s or more, found {part.stop}"
            )
        if part.speed is not None and not 0.0 < part.speed < math.inf:
            raise ControlError(
                f"part {number} of the path ({part.type}): expected a speed above 0, found {part.speed}"
            )
    corners = np.concatenate([part.points for part in parts])
    last = np.cumsum([len(part.points) for part in parts]) - 1
    arcs = np.pad(length(np.diff(corners, axis=0)).cumsum(), (1, 0))[np.maximum(last, 0)]
    for number, (part, size) in enumerate(zip(parts, np.diff(arcs, prepend=0.0), strict=True), 1):
        if size < SHORTEST:
            one = "has one point" if len(corners) == 1 else f"is {size:.1f} cm long"
            raise ControlError(
                f"part {number} of the path ({part.type}) {one}, expected at least {SHORTEST:g} cm"
            )
    if arcs[-1] > MAX_LENGTH:
        raise ControlError(
            f"the path is {arcs[-1] / METRE:,.0f} m long, expected at most {MAX_LENGTH / METRE:,.0f} m; {IN_METRES}"
        )
    library, words = steering_library(), (Part * len(parts))(*(Part(last=number) for number in last.tolist()))
    count = library.path_points(corners.ctypes.data, len(corners))
    points, tangents = np.zeros((2, count, 2))
    part_index = np.zeros(count, np.int32)
    made = (array.ctypes.data for array in (points, tangents, part_index))
    library.even_points(corners.ctypes.data, byref(words), len(parts), count, *made)
    return Path2D(points, tangents, part_index, tuple(parts))


def _points(number: int, part: PathPart) -> Array:
    """A copy of the points (N, 2) of a part; raises ControlError if they are none."""
    try:
        points = np.array(part.points, np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ControlError(f"part {number} of the path ({part.type}): expected points (N, 2) of numbers")
    return points


# ---- named shapes ----


def _arc(radius: float, start: float, sweep: float, centre: tuple[float, float]) -> Array:
    """Points along a circle; angles from +Z towards +X, positive sweep turns left."""
    count = max(8, int(abs(sweep) * radius / SPACING))
    angle = np.linspace(start, start + sweep, count, dtype=np.float64)
    return np.stack([centre[0] + radius * np.sin(angle), centre[1] + radius * np.cos(angle)], axis=-1)


def _line(size: float) -> Array:
    return np.array([[0.0, 0.0], [0.0, size]], np.float64)


def _circle(size: float) -> Array:
    # Starts at the origin facing +Z, the centre to the left (+X).
    return _arc(size, -math.pi / 2, 2 * math.pi, (size, 0.0))


def _figure_eight(size: float) -> Array:
    left = _arc(size, -math.pi / 2, 2 * math.pi, (size, 0.0))
    right = _arc(size, math.pi / 2, -2 * math.pi, (-size, 0.0))
    return np.concatenate([left, right[1:]])


def _polygon(size: float, corners: int, turn: float) -> Array:
    points, heading = [np.zeros(2, np.float64)], 0.0
    for _ in range(corners):
        step = np.array([math.sin(heading), math.cos(heading)], np.float64)
        points.append(points[-1] + size * step)
        heading += turn
    return np.stack(points)


def _square(size: float) -> Array:
    return _polygon(size, 4, math.pi / 2)


def _pentagram(size: float) -> Array:
    return _polygon(size, 5, math.radians(144.0))


def _u_turn(size: float) -> Array:
    # Straight out, a half circle to the left with a tenth of the length as radius, and straight back.
    radius = 0.1 * size
    out = np.array([[0.0, 0.0], [0.0, size]], np.float64)
    turn = _arc(radius, -math.pi / 2, math.pi, (radius, size))
    back = np.array([[2 * radius, 0.0]], np.float64)
    return np.concatenate([out, turn[1:], back])


# The size is the length of line and u-turn, the radius of circle and figure-eight, and the side of the others.
SHAPES: dict[str, Callable[[float], Array]] = {
    "line": _line,
    "circle": _circle,
    "figure-eight": _figure_eight,
    "square": _square,
    "pentagram": _pentagram,
    "u-turn": _u_turn,
}
DEFAULT_SIZES = {
    "line": 10.0,
    "circle": 3.0,
    "figure-eight": 3.0,
    "square": 5.0,
    "pentagram": 6.0,
    "u-turn": 6.0,
}


def shape_path(name: str, size: float | None, types: list[str], speed: float | None) -> Path2D:
    """A path of a named shape with a size in metres and a speed in m/s; the types share its length evenly.

    Raises ControlError for an unknown shape, or a size or speed that is not a positive number.
    """
    if name not in SHAPES:
        raise ControlError(unknown_name("path shape", name, tuple(SHAPES)))
    metres = DEFAULT_SIZES[name] if size is None else size
    _check_number(metres, "size", 0.2, 1000.0)
    if speed is not None:
        _check_number(speed, "speed", 0.05, 15.0)
    whole = make_path([PathPart(SHAPES[name](metres * METRE), types[0])])
    count = len(types)
    edges = [round(i * (len(whole.points) - 1) / count) for i in range(count + 1)]
    velocity = None if speed is None else speed * METRE
    return make_path(
        [PathPart(whole.points[edges[i] : edges[i + 1] + 1], kind, velocity) for i, kind in enumerate(types)]
    )


def _check_number(value: float, what: str, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ControlError(f"expected a {what} between {low:g} and {high:g}, found {value:g}")


def check_shape_options(types: Any, size: float | None, speed: float | None) -> None:
    """Raise ControlError if any option is given: only named shapes take them, other paths have their own."""
    if types or size is not None or speed is not None:
        raise ControlError("types, size and speed are for named shapes; a path file holds its own")


# ---- files ----


def read_path(file: str | Path) -> Path2D:
    """Read a path from JSON or CSV, in metres and metres per second.

    JSON: {"parts": [{"type": "walking", "speed": 1.4, "stop": 2, "points": [[x, z], ...]}, ...]}; speed and stop are
    optional. CSV: columns x, z, type and optionally speed and stop, between commas, semicolons or tabs; consecutive
    rows of one type make a part, and a stop ends one.

    Raises:
        ControlError: naming the file and the part or line that is wrong.
    """
    file = Path(file)
    from motionkit.rig.read_file import ENDINGS

    if file.suffix.lower() in ENDINGS and file.exists():
        raise ControlError(f"{file}: is a motion, expected a path: a JSON or CSV file, or a named shape")
    text = read_text(file, "a path", ControlError)
    if text.lstrip().startswith("<"):  # SVG and its like
        raise ControlError(f"{file}: expected a path as JSON or CSV, found XML")
    parts = _csv_parts(file, text) if _is_table(file, text) else _json_parts(file, text)
    with naming(file, ControlError):
        return make_path(parts)


def _is_table(file: Path, text: str) -> bool:
    ending = file.suffix.lower()
    return ending == ".csv" or (ending != ".json" and not text.lstrip().startswith(("{", "[")))


_FIELDS = ("type", "points", "speed", "stop")
_COLUMNS = ("x", "z", "type", "speed", "stop")


def _json_parts(file: Path, text: str) -> list[PathPart]:
    value = parse_json(text, file, ControlError)
    entries = value.get("parts") if isinstance(value, dict) else value
    if not isinstance(entries, list) or not entries:
        raise ControlError(f'{file}: expected {{"parts": [...]}} with at least one part')
    check_fields(value if isinstance(value, dict) else {}, ("parts",), file, ControlError)
    parts = []
    for number, entry in enumerate(entries, 1):
        where = f"{file}: part {number}"
        if not isinstance(entry, dict) or not isinstance(entry.get("type"), str):
            raise ControlError(f"{where}: expected an object with type and points")
        check_fields(entry, _FIELDS, where, ControlError)
        points = entry.get("points")
        if not isinstance(points, list) or not all(_is_point(p) for p in points) or not points:
            raise ControlError(
                f"{where}: expected points as a list of [x, z] numbers up to {MAX_COORDINATE:,.0f}; {IN_METRES}"
            )
        speed, stop = entry.get("speed"), entry.get("stop")
        for name, found in (("speed", speed), ("stop", stop)):
            if found is not None and not _is_number(found):
                raise ControlError(f"{where}: expected a number for {name}, found {str(found)[:40]!r}")
        parts.append(_part(where, points, entry["type"], speed, stop or 0.0))
    return parts


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= MAX_COORDINATE


def _is_point(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(_is_number(v) for v in value)


def _part(where: str, points: list, kind: str, speed: float | None, stop: float) -> PathPart:
    if len(kind) > MAX_TYPE or not kind.isprintable():
        raise ControlError(f"{where}: expected a motion type, found {kind[:40]!r}")
    for what, value, low, high, unit in (
        ("speed", speed, 0.05, 15.0, "m/s"),
        ("stop", stop, 0.0, MAX_STOP, "s"),
    ):
        try:
            if value is not None:
                _check_number(value, what, low, high)
        except ControlError as error:
            raise ControlError(f"{where}: {error} {unit}") from None
    return PathPart(
        np.array(points, np.float64) * METRE, nfc(kind), None if speed is None else speed * METRE, float(stop)
    )


def _csv_parts(file: Path, text: str) -> list[PathPart]:
    lines = text.splitlines()
    above = int(bool(lines) and lines[0].lower().startswith("sep="))  # a line for Excel, above the names
    lines = lines[above:]
    header = lines[0] if lines else ""
    # Spreadsheets write commas, tabs, or, where numbers have commas, semicolons.
    between = next((each for each in "\t;" if each in header), ",")
    reader = csv.DictReader(lines, delimiter=between)
    groups: list[tuple[str, float | None, list[list[float]]]] = []
    stops: list[float] = []
    try:
        found = [name.strip().lower() for name in reader.fieldnames or []]
        twice = [name for name in _COLUMNS if found.count(name) > 1]
        if twice:
            raise ControlError(
                f"{file}:{above + 1}: expected each column once, found {twice[0]} {found.count(twice[0])} times"
            )
        missing = [name for name in ("x", "z", "type") if name not in found]
        if missing:
            first = f"found {header[:40]!r}" if found else "found nothing"
            raise ControlError(
                f"{file}:{above + 1}: expected a first line that names the columns x, z and type, {first}; "
                f"it lacks {', '.join(missing)}"
            )
        for name in found:  # y, the height, is that of the ground
            if name not in (*_COLUMNS, "y", ""):
                raise ControlError(f"{file}:{above + 1}: {unknown_name('column', name, _COLUMNS)}")
        reader.fieldnames = found
        for row in reader:
            if not any(value and value.strip() for value in row.values() if isinstance(value, str)):
                continue  # spreadsheets end with empty rows
            kind, speed, stop, point = _csv_row(f"{file}:{reader.line_num + above}", row)
            if not groups or groups[-1][:2] != (kind, speed) or stops[-1]:
                groups.append((kind, speed, []))
                stops.append(0.0)
            groups[-1][2].append(point)
            stops[-1] = stop
    except csv.Error as error:
        raise ControlError(f"{file}:{reader.line_num + above + 1}: not a table row ({error})") from None
    return [
        _part(f"{file}: part {i}", points, kind, speed, stop)
        for i, ((kind, speed, points), stop) in enumerate(zip(groups, stops, strict=True), 1)
    ]


def _csv_number(text: str) -> float:
    return float(text.replace(",", "."))


def _csv_row(where: str, row: dict[str, str]) -> tuple[str, float | None, float, list[float]]:
    if None in row:  # where csv puts what has no column
        raise ControlError(
            f"{where}: has more values than columns; put semicolons between them if numbers have commas"
        )
    try:
        point = [_csv_number(row["x"]), _csv_number(row["z"])]
        speed, stop = (_csv_number(row[n]) if (row.get(n) or "").strip() else None for n in ("speed", "stop"))
    except (AttributeError, TypeError, ValueError):
        raise ControlError(f"{where}: expected numbers for x, z, speed and stop") from None
    if not all(abs(v) <= MAX_COORDINATE for v in (*point, speed or 0.0, stop or 0.0)):
        raise ControlError(f"{where}: expected finite numbers up to {MAX_COORDINATE:,.0f}; {IN_METRES}")
    kind = (row["type"] or "").strip()
    if not kind:
        raise ControlError(f"{where}: expected a motion type, found none")
    return kind, speed, stop or 0.0, point
