"""Errors are one line that a terminal shows as it is, whatever they quote."""

from __future__ import annotations

import pytest

from motionkit.errors import LONGEST, BvhError, ControlError, MotionkitError


@pytest.mark.parametrize("quoted", ["a\nb", "\x1b[31m", "\x00", "\u2028", "\ud800", "x" * 10**6])
def test_what_an_error_quotes_stays_one_short_line(quoted: str) -> None:
    for error in (
        MotionkitError(f"a.bvh: found {quoted}, expected 1"), ControlError(f"a.bvh: {quoted}, expected 1"),
        BvhError("a.bvh", f"found {quoted}, expected 1", 3),
    ):  # fmt: skip
        message = str(error)
        assert message.isprintable() and len(message) <= LONGEST + 5
        assert message.startswith("a.bvh") and message.endswith(", expected 1")
