"""Parses client requests: JSON text to checked values. Invalid text always raises ProtocolError."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from motionkit.control.drive import DEFAULT_SECONDS, LONGEST
from motionkit.control.path import MAX_STOP
from motionkit.errors import MotionkitError
from motionkit.files import is_number, parse_json
from motionkit.inference.noise import NOISE_KINDS
from motionkit.names import nfc
from motionkit.play.limits import Limits
from motionkit.play.recording import FORMATS

MAX_SPEED = 1000.0  # cm/s
ROUND_OFF = 0.01  # cm/s, excess allowed for rounding, as when a client turns a velocity of MAX_SPEED
MAX_PLACE = 1e6  # cm from the origin
MAX_COUNT = 2**32 - 1  # largest whole number; 32 bits in binary frames
MAX_NAME = 100  # letters in the name of a type or body
MAX_TEMPERATURE = 2.0  # standard deviations
MAX_STOPS = 100  # stops on a path


class ProtocolError(MotionkitError):
    """An invalid request."""


@dataclass(frozen=True)
class Request:
    """A checked request: `do` is its name, `fields` holds all of its fields."""

    do: str
    fields: dict[str, Any]


Check = Callable[[Any], Any]


def _number(low: float, high: float) -> Check:
    def check(value: Any) -> float:
        if not is_number(value, low, high):
            raise ValueError(f"a number from {low:g} to {high:g}")
        return float(value)

    return check


def _count(value: Any) -> int:
    if not is_number(value, 0, MAX_COUNT, whole=True):
        raise ValueError(f"a whole number from 0 to {MAX_COUNT}")
    return int(value)


def _name(value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_NAME:
        raise ValueError(f"a name of at most {MAX_NAME} characters")
    return nfc(value)


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value


def _one_of(known: tuple[str, ...]) -> Check:
    def check(value: Any) -> str:
        if value not in known:
            raise ValueError(f"one of {', '.join(known)}")
        return str(value)

    return check


def _pair(limit: float) -> Check:
    number = _number(-limit, limit)

    def check(value: Any) -> tuple[float, float]:
        if not isinstance(value, list) or len(value) != 2:
            raise ValueError("two numbers [x, z]")
        return number(value[0]), number(value[1])

    return check


def _velocity(value: Any) -> tuple[float, float]:
    x, z = _pair(MAX_SPEED)(value)
    if math.hypot(x, z) > MAX_SPEED + ROUND_OFF:
        raise ValueError(f"a velocity of at most {MAX_SPEED:g} cm/s")
    return x, z


def _points(value: Any) -> list[tuple[float, float]]:
    most = Limits().path_points
    if not isinstance(value, list) or not 2 <= len(value) <= most:
        raise ValueError(f"2 to {most} points [x, z]")
    point = _pair(MAX_PLACE)
    return [point(each) for each in value]


def _stops(value: Any) -> list[tuple[int, float]]:
    seconds = _number(0.1, MAX_STOP)
    pairs = isinstance(value, list) and all(isinstance(each, list) and len(each) == 2 for each in value)
    if not pairs or len(value) > MAX_STOPS:
        raise ValueError(f"at most {MAX_STOPS} stops [number of a point, seconds]")
    stops = [(_count(number), seconds(stay)) for number, stay in value]
    if any(after <= before for before, after in pairwise([0, *(number for number, _ in stops)])):
        raise ValueError("numbers of points that rise, after that of the first point, 0")
    return stops


def _or_null(check: Check) -> Check:
    return lambda value: None if value is None else check(value)


_REQUIRED = object()
_CHARACTER: dict[str, tuple[Check, Any]] = {"character": (_or_null(_count), None)}
_SEQ: dict[str, tuple[Check, Any]] = {"seq": (_count, 0)}
# Fields of each request: name -> check function and default.
REQUESTS: dict[str, dict[str, tuple[Check, Any]]] = {
    "wish": {
        **_CHARACTER,
        "velocity": (_or_null(_velocity), (0.0, 0.0)),
        "facing": (_or_null(_number(-1e3, 1e3)), None),
        "type": (_or_null(_name), None),
        **_SEQ,
    },
    "perform": {
        **_CHARACTER,
        "type": (_name, _REQUIRED),
        "seconds": (_number(0.1, LONGEST), DEFAULT_SECONDS),
        **_SEQ,
    },
    "path": {
        **_CHARACTER,
        "points": (_points, _REQUIRED),
        "type": (_or_null(_name), None),
        "speed": (_or_null(_number(5.0, MAX_SPEED)), None),
        "stops": (_stops, ()),
        **_SEQ,
    },
    "add": {"body": (_or_null(_name), None)},
    "remove": {**_CHARACTER},
    "body": {**_CHARACTER, "body": (_name, _REQUIRED)},
    "reset": {**_CHARACTER},
    "noise": {
        **_CHARACTER,
        "kind": (_one_of(NOISE_KINDS), "correlated"),
        "temperature": (_number(0.0, MAX_TEMPERATURE), 0.05),
    },
    "record": {**_CHARACTER, "on": (_flag, _REQUIRED), "format": (_or_null(_one_of(FORMATS)), None)},
    "ping": {"stamp": (_number(-1e300, 1e300), 0.0)},
}


def parse_request(text: str) -> Request:
    """Parse and check a message.

    Raises:
        ProtocolError: the text is not JSON, the request or a field is unknown, or a field is missing or wrong.
    """
    try:
        value = parse_json(text, "message", ProtocolError)
    except ProtocolError as error:
        raise ProtocolError(
            f"expected a JSON object, found {_value_text(text)} ({_first_line(error)})"
        ) from None
    if not isinstance(value, dict):
        raise ProtocolError(f"expected a JSON object, found {_value_text(text)}")
    do = value.pop("do", None)
    fields = REQUESTS.get(do) if isinstance(do, str) else None
    if fields is None:
        raise ProtocolError(f'expected "do" to be one of {", ".join(REQUESTS)}, found {_value_text(do)}')
    unknown = sorted(value.keys() - fields.keys())
    if unknown:
        raise ProtocolError(
            f"{do}: unknown field {_value_text(unknown[0])}, expected {', '.join(fields) or 'none'}"
        )
    out = {}
    for name, (check, default) in fields.items():
        if name not in value and default is _REQUIRED:
            raise ProtocolError(f"{do}: {name} is missing")
        try:
            out[name] = check(value[name]) if name in value else default
        except ValueError as error:
            raise ProtocolError(f"{do}: {name}: expected {error}, found {_value_text(value[name])}") from None
    return Request(do, out)


def _value_text(value: Any) -> str:
    """A value for an error message, shortened."""
    try:
        text = repr(value)
    except ValueError:  # an integer with too many digits to print
        return "a number that is too long"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:80]
