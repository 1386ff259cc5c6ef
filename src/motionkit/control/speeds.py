"""How fast a path is gone along: what is asked for, within what recordings of the type show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from motionkit.arrays import Array
from motionkit.control.path import METRE, SPACING, Path2D
from motionkit.errors import ControlError
from motionkit.metrics.pace import PACE_SECONDS, ground_acceleration
from motionkit.models.model import MotionModel

DEFAULT_SPEED = 130.0  # cm/s, for a type the model has no speed of
SLOWEST = 20.0  # cm/s, at least
# Of the recorded frames of a motion's types are below its limit; the others are outliers, and peaks that held feet add.
RECORDED_SHARE = 0.997
USUAL = 3.5  # m/s^2; any body accelerates so hard where it begins to do something else
SHORT = 0.5  # share of its time in which a performance may not be shown


def asked_speeds(model: MotionModel, path: Path2D) -> Array:
    """Speed (N,) in cm/s that is asked for on each part, else what is usual for its type."""
    known = [model.types.get(part.type) for part in path.parts]
    gaits = [None if kind is None else kind.gait for kind in known]
    typical = [DEFAULT_SPEED if gait is None else gait.speed for gait in gaits]
    wanted = [s if part.speed is None else part.speed for part, s in zip(path.parts, typical, strict=True)]
    return np.maximum(np.array(wanted, np.float32), SLOWEST)


def part_speeds(model: MotionModel, path: Path2D) -> Array:
    """Speed (N,) in cm/s with which each part is gone along: a gait's goes no further than its speed range.

    Beyond it a network glides: feet hardly leave the ground, or hardly touch it.
    """
    return _within_ranges(model, path, asked_speeds(model, path))


def _within_ranges(model: MotionModel, path: Path2D, asked: Array) -> Array:
    speeds = asked.copy()
    for number, part in enumerate(path.parts):
        span = model.speed_range(part.type)
        if span is not None and part.speed is not None:
            speeds[number] = np.clip(speeds[number], *span)
    return speeds


def other_speeds(model: MotionModel, path: Path2D) -> list[str]:
    """A line for each part that is gone along at another speed than asked for."""
    return [
        f"part {number}: {kind} goes at {gone / METRE:.2f} m/s instead of {asked / METRE:g}: {_recorded(model, kind)}"
        for number, kind, asked, gone in _changed(model, path)
    ]


def short_performances(model: MotionModel, path: Path2D) -> list[str]:
    """A line for each part that is gone along in less than half the time that a flip, jump or strike takes."""
    lines = []
    speeds, lengths = part_speeds(model, path), np.bincount(path.part, minlength=len(path.parts)) * SPACING
    for number, (part, speed, length) in enumerate(zip(path.parts, speeds, lengths, strict=True), 1):
        kind = model.types.get(part.type)
        seconds = 0.0 if kind is None or not kind.has_phase else model.phase_seconds(part.type)
        if float(length / speed) < SHORT * seconds:
            lines.append(
                f"part {number}: {part.type} takes some {seconds * float(speed) / METRE:.1f} m, found "
                f"{float(length) / METRE:.1f} m, in which it may not be shown"
            )
    return lines


def check_speeds(model: MotionModel, path: Path2D) -> None:
    """Refuse speeds that no recording comes near; raises ControlError for the first."""
    for number, kind, asked, _ in _changed(model, path):
        raise ControlError(
            f"part {number}: expected a speed at which {kind} looks right, {_recorded(model, kind)}, "
            f"found {asked / METRE:g} m/s"
        )


def _changed(model: MotionModel, path: Path2D) -> Iterator[tuple[int, str, float, float]]:
    """Number, type, asked speed and speed gone in cm/s of each part where these differ."""
    wanted = asked_speeds(model, path)
    speeds = wanted.tolist(), _within_ranges(model, path, wanted).tolist()
    for number, (part, asked, gone) in enumerate(zip(path.parts, *speeds, strict=True), 1):
        if asked != gone:
            yield number, part.type, asked, gone


def _recorded(model: MotionModel, kind: str) -> str:
    span = model.speed_range(kind)
    assert span is not None, "only types with recorded speeds have limits"
    return f"{span[0] / METRE:.2f} to {span[1] / METRE:.2f} m/s by its recordings"


def acceleration_limit(model: MotionModel, kinds: Iterable[str]) -> float | None:
    """Acceleration over the ground in m/s^2 that recordings of some types keep below; None without recordings."""
    shortest = 2 * round(PACE_SECONDS * model.fps)
    clips = [clip for kind in dict.fromkeys(kinds) for clip in model.types[kind].reference_clips]
    found = [
        ground_acceleration(np.insert(clip.ground[:, :2], 1, 0.0, axis=1), model.fps)
        for clip in clips
        if len(clip) > shortest
    ]
    return max(float(np.quantile(np.concatenate(found), RECORDED_SHARE)), USUAL) if found else None
