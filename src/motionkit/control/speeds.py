"""Speeds along a path: the requested ones, within the range that recordings of the type show.

Paths and keys are those of the model's body. Where they are made for a rig, `size` is the rig's size relative to that
body, and speeds and lengths are told in metres of the rig's world.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from ctypes import byref
from dataclasses import astuple, dataclass
from itertools import pairwise

import numpy as np

from motionkit.arrays import Array
from motionkit.control.keys import ORIGIN, Key
from motionkit.control.path import METRE, SPACING, Path2D, PathPart
from motionkit.control.script import TypePart
from motionkit.control.steering import WALK_SPEED, Steering, or_nan
from motionkit.control.steering_kernel import doubles, steering_library
from motionkit.errors import ControlError
from motionkit.metrics.pace import PACE_SECONDS, ground_acceleration
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind


@dataclass(frozen=True)
class ProfileSettings:
    """Speeds along a path. All numbers but the acceleration are chosen."""

    usual: float = WALK_SPEED  # cm/s, for a type without a known speed
    slowest: float = 20.0  # cm/s; least speed of a part
    creep: float = 10.0  # cm/s at a stop
    acceleration: float = 220.0  # cm/s^2; 98 % of the frames of recorded runs brake less
    beside_turn: float = 8.0  # points of the path to both sides between which a turn is measured
    too_slow: float = 0.99  # share of the slowest recorded speed of a run, below which a body walks
    from_rest: float = 0.5  # share of the speed of a path at which a standing body begins it


PROFILE = ProfileSettings()
LATERAL = 150.0  # cm/s^2 towards the inside of a curve, for a type without recordings; chosen
LATERAL_SHARE = 0.98  # quantile of recorded lateral accelerations; frames above it are outliers; chosen
STRIDE = 0.5  # s over which their velocities are measured, because hips sway with every step; chosen
SOME = 0.1  # share above the fastest recorded speed from which a key asks for too much; chosen
SHORT = 0.5  # share of a performance's duration below which a part may be too short for it; chosen
# Quantile of recorded acceleration that limits a motion; frames above it are outliers and peaks from locked feet.
RECORDED_SHARE = 0.997
USUAL = 3.5  # m/s^2; least limit, because any body accelerates this hard when it changes its movement


def part_speeds(model: MotionModel, path: Path2D) -> Array:
    """Speed (N,) in cm/s of each part, by default that of its type; that of a gait is limited to its recorded range.

    Raises ControlError for an unknown type.
    """
    steering, profile = Steering(model), doubles(ProfileSettings)(*astuple(PROFILE))

    def speed(part: PathPart) -> float:
        given = byref(steering.words), byref(profile), model.type_id(part.type), or_nan(part.speed)
        return float(steering_library().part_speed(*given))

    return np.array([speed(part) for part in path.parts])


def other_speeds(model: MotionModel, path: Path2D, size: float = 1.0) -> list[str]:
    """A line for each part whose speed differs from the requested one."""
    return [
        f"part {number}: {kind} goes at {size * gone / METRE:.2f} m/s instead of {size * requested / METRE:g}: "
        + _recorded(model, kind, size)
        for number, kind, requested, gone in _changed(model, path)
    ]


def doubtful_parts(model: MotionModel, path: Path2D, size: float = 1.0) -> list[str]:
    """A line for each part that has less than half the time of its flip, jump or strike, or whose body stands."""
    lines = []
    speeds, lengths = part_speeds(model, path), np.bincount(path.part, minlength=len(path.parts)) * SPACING
    for number, (part, speed, length) in enumerate(zip(path.parts, speeds, lengths, strict=True), 1):
        seconds = model.phase_seconds(part.type)
        if model.kind(part.type) is MotionKind.STANCE:
            lines.append(f"part {number}: {part.type} stands; on a path its body is dragged along")
        if float(length / speed) < SHORT * seconds:
            lines.append(
                f"part {number}: {part.type} takes some {size * seconds * float(speed) / METRE:.1f} m, found "
                f"{size * float(length) / METRE:.1f} m, in which it may not be shown"
            )
    return lines


def hurried_keys(
    model: MotionModel,
    parts: Sequence[TypePart],
    keys: Sequence[Key],
    start: Array | None = ORIGIN,
    size: float = 1.0,
) -> list[str]:
    """A line for each key that asks the gait before it for more speed than its recordings have.

    start is the place (2,) in cm of the body before the first frame; None if it is not known.
    """
    ends = np.cumsum([part.seconds for part in parts])
    lines = []
    first = [] if start is None else [Key(0.0, position=start)]
    for before, key in pairwise([*first, *(key for key in keys if key.goal is not None)]):
        kind = parts[min(int(np.searchsorted(ends, key.seconds)), len(parts) - 1)].type
        span = model.speed_range(kind) if model.kind(kind) is MotionKind.GAIT else None
        assert key.goal is not None and before.goal is not None
        speed = float(np.linalg.norm(key.goal - before.goal)) / (key.seconds - before.seconds)
        if span is not None and speed > span[1] * (1.0 + SOME):
            asked = f"the key at {key.seconds:g} s asks {kind} for {size * speed / METRE:.2f} m/s"
            lines.append(f"{asked}: {_recorded(model, kind, size)}")
    return lines


def check_speeds(model: MotionModel, path: Path2D, size: float = 1.0) -> None:
    """Raise ControlError for the first part whose requested speed is outside its recorded range."""
    for number, kind, requested, _ in _changed(model, path):
        raise ControlError(
            f"part {number}: expected a speed at which {kind} looks right, {_recorded(model, kind, size)}, "
            f"found {size * requested / METRE:g} m/s"
        )


def _changed(model: MotionModel, path: Path2D) -> Iterator[tuple[int, str, float, float]]:
    """Number, type, requested and actual speed (cm/s) of each part where the two differ."""
    for number, (part, gone) in enumerate(zip(path.parts, part_speeds(model, path), strict=True), 1):
        requested = gone if part.speed is None else part.speed
        if requested != gone:
            yield number, part.type, requested, float(gone)


def _recorded(model: MotionModel, kind: str, size: float) -> str:
    span = model.speed_range(kind)
    if span is None:
        return f"at least {size * PROFILE.slowest / METRE:g} m/s on a path"
    return f"{size * span[0] / METRE:.2f} to {size * span[1] / METRE:.2f} m/s by its recordings"


def lateral_limit(model: MotionModel, kind: str) -> float:
    """Acceleration in cm/s^2 towards the inside of a curve that recordings of a type show, at least LATERAL.

    Raises ControlError for an unknown type.
    """
    model.type_id(kind)
    span = round(STRIDE * model.fps)
    found = [np.zeros(1)]
    for clip in model.types[kind].reference_clips:
        velocity = (clip.ground[span:, :2] - clip.ground[:-span, :2]) * (model.fps / span)
        bend = np.abs(np.diff(np.unwrap(np.arctan2(velocity[:, 0], velocity[:, 1])))) * model.fps
        found.append(bend * np.linalg.norm(velocity[1:], axis=-1))
    return max(float(np.quantile(np.concatenate(found), LATERAL_SHARE)), LATERAL)


def acceleration_limit(model: MotionModel, kinds: Iterable[str]) -> float | None:
    """Limit of the acceleration over the ground in m/s^2, from recordings of some types; None without recordings."""
    shortest = 2 * round(PACE_SECONDS * model.fps)
    clips = [clip for kind in dict.fromkeys(kinds) for clip in model.types[kind].reference_clips]
    found = [
        ground_acceleration(np.insert(clip.ground[:, :2], 1, 0.0, axis=1), model.fps)
        for clip in clips
        if len(clip) > shortest
    ]
    return max(float(np.quantile(np.concatenate(found), RECORDED_SHARE)), USUAL) if found else None
