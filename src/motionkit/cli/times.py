"""Times in a clip, as options: in seconds or frames."""

from __future__ import annotations

import re
from typing import NamedTuple

import click

_TIME = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*s?|(\d+)\s*f")
LATEST = 1e9  # largest number of seconds or frames


class Moment(NamedTuple):
    """A time in a clip: seconds, or with in_frames a frame."""

    value: float
    in_frames: bool

    def seconds(self, fps: float) -> float:
        """The time in seconds of a clip at a rate."""
        return self.value / fps if self.in_frames else self.value


class Time(click.ParamType):
    """A time in a clip: seconds, such as 1.5 or 1.5s, or a frame, such as 90f."""

    name = "time"

    def convert(
        self, value: object, parameter: click.Parameter | None, context: click.Context | None
    ) -> Moment:
        """The number and its unit."""
        if isinstance(value, Moment):
            return value
        found = _TIME.fullmatch(str(value).strip())
        if found is None:
            self.fail(
                f"expected seconds such as 1.5, or a frame such as 90f, found {value!r}", parameter, context
            )
        moment = Moment(float(found[1] or found[2]), found[1] is None)
        if moment.value > LATEST:
            self.fail(f"expected at most {LATEST:,.0f}, found {str(value)[:40]!r}", parameter, context)
        return moment


class TimePair(click.ParamType):
    """Two times with a colon between them, such as 2.5:0.3; without a colon the second is 0."""

    name = "time:time"

    def convert(
        self, value: object, parameter: click.Parameter | None, context: click.Context | None
    ) -> tuple[Moment, Moment]:
        """Both times."""
        if isinstance(value, tuple):
            return value
        first, _, second = str(value).partition(":")
        one = Time()
        return one.convert(first, parameter, context), one.convert(second or "0", parameter, context)
