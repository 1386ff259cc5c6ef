"""Speeds along a path: the requested ones, within the range that recordings of the type show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.path import METRE, SPACING, Path2D
from motionkit.control.steering import WALK_SPEED, steered_type
from motionkit.errors import ControlError
from motionkit.metrics.pace import PACE_SECONDS, ground_acceleration
from motionkit.models.model import MotionModel


@dataclass(frozen=True)
class ProfileSettings:
    """Speeds along a path. All numbers but the acceleration are chosen."""

    default: float = WALK_SPEED  # cm/s, for a type without a known speed
    slowest: float = 20.0  # cm/s; least speed of a part
    creep: float = 10.0  # cm/s at a stop
    acceleration: float = 220.0  # cm/s^2; 98 % of the frames of recorded runs brake less
    beside_turn: int = 8  # points of the path to both sides between which a turn is measured
    lateral: float = 150.0  # cm/s^2 towards the inside of a curve, for a type without recordings
    lateral_share: float = 0.98  # quantile of recorded lateral accelerations; frames above it are outliers
    stride: float = 0.5  # s over which their velocities are measured, because hips sway with every step
    too_slow: float = 0.99  # share of the slowest recorded speed of a run, below which a body walks
    short: float = 0.5  # share of a performance's duration below which a part may be too short for it


PROFILE = ProfileSettings()
# Quantile of recorded acceleration that limits a motion; frames above it are outliers and peaks from locked feet.
RECORDED_SHARE = 0.997
USUAL = 3.5  # m/s^2; least limit, because any body accelerates this hard when it changes its movement


def asked_speeds(model: MotionModel, path: Path2D) -> Array:
    """Requested speed (N,) in cm/s of each part, or the usual speed of its type."""
    speeds = []
    for part in path.parts:
        gait = model.types[part.type].gait if part.type in model.types else None
        usual = PROFILE.default if gait is None else gait.speed
        speeds.append(usual if part.speed is None else part.speed)
    return np.maximum(np.array(speeds, np.float32), PROFILE.slowest)


def part_speeds(model: MotionModel, path: Path2D) -> Array:
    """Speed (N,) in cm/s of each part; the requested speed of a gait is limited to its recorded range.

    Outside this range a body glides: its feet hardly leave the ground, or hardly touch it.
    """
    speeds = asked_speeds(model, path)
    for number, part in enumerate(path.parts):
        span = model.speed_range(part.type)
        if span is not None and part.speed is not None:
            speeds[number] = np.clip(speeds[number], *span)
    return speeds


def other_speeds(model: MotionModel, path: Path2D) -> list[str]:
    """A line for each part whose speed differs from the requested one."""
    return [
        f"part {number}: {kind} goes at {gone / METRE:.2f} m/s instead of {asked / METRE:g}: {_recorded(model, kind)}"
        for number, kind, asked, gone in _changed(model, path)
    ]


def short_performances(model: MotionModel, path: Path2D) -> list[str]:
    """A line for each part that takes less than half the time of its flip, jump or strike."""
    lines = []
    speeds, lengths = part_speeds(model, path), np.bincount(path.part, minlength=len(path.parts)) * SPACING
    for number, (part, speed, length) in enumerate(zip(path.parts, speeds, lengths, strict=True), 1):
        seconds = model.phase_seconds(part.type)
        if float(length / speed) < PROFILE.short * seconds:
            lines.append(
                f"part {number}: {part.type} takes some {seconds * float(speed) / METRE:.1f} m, found "
                f"{float(length) / METRE:.1f} m, in which it may not be shown"
            )
    return lines


def check_speeds(model: MotionModel, path: Path2D) -> None:
    """Raise ControlError for the first part whose requested speed is outside its recorded range."""
    for number, kind, asked, _ in _changed(model, path):
        raise ControlError(
            f"part {number}: expected a speed at which {kind} looks right, {_recorded(model, kind)}, "
            f"found {asked / METRE:g} m/s"
        )


def _changed(model: MotionModel, path: Path2D) -> Iterator[tuple[int, str, float, float]]:
    """Number, type, requested and actual speed (cm/s) of each part where the two differ."""
    speeds = asked_speeds(model, path).tolist(), part_speeds(model, path).tolist()
    for number, (part, asked, gone) in enumerate(zip(path.parts, *speeds, strict=True), 1):
        if asked != gone:
            yield number, part.type, asked, gone


def _recorded(model: MotionModel, kind: str) -> str:
    span = model.speed_range(kind)
    assert span is not None, "only types with recorded speeds have limits"
    return f"{span[0] / METRE:.2f} to {span[1] / METRE:.2f} m/s by its recordings"


def speed_profile(model: MotionModel, path: Path2D) -> Array:
    """Speed (N,) in cm/s at each point of the path; it changes by at most PROFILE.acceleration at stops and turns.

    The path begins at full speed, because start poses are in motion.
    """
    speeds = part_speeds(model, path)[path.part].astype(np.float64)
    speeds = np.minimum(speeds, _turn_speeds(model, path))
    for place, _ in path.stops:
        speeds[path.nearest(place)] = PROFILE.creep
    # At constant acceleration the square of the speed is linear in arc length, so its slope is limited both ways.
    slope = 2.0 * PROFILE.acceleration * SPACING * np.arange(len(speeds))
    squares = np.minimum.accumulate(speeds * speeds - slope) + slope
    squares = np.minimum.accumulate((squares + slope)[::-1])[::-1] - slope
    return np.sqrt(squares).astype(np.float32)


def shown_types(model: MotionModel, path: Path2D, speeds: Array) -> Array:
    """The type id (N,) at each point: a run becomes a walk where the path is slower than any recorded run.

    Args:
        speeds: (N,) from speed_profile.
    """
    shown = np.array([model.type_id(part.type) for part in path.parts])[path.part]
    walk = steered_type(model, (0.0, WALK_SPEED), 0.0)
    slower = model.speed_range(walk)
    for number, part in enumerate(path.parts):
        gait, span = model.types[part.type].gait, model.speed_range(part.type)
        if gait and span and slower and gait.runs and slower[0] < span[0]:
            shown[(path.part == number) & (speeds < PROFILE.too_slow * span[0])] = model.type_id(walk)
    return shown


def _turn_speeds(model: MotionModel, path: Path2D) -> Array:
    """The speed (N,) in cm/s at which a body leans into the turn at each point as far as recorded ones."""
    beside, most = PROFILE.beside_turn, len(path.points) - 1
    places = np.arange(most + 1)
    first, last = np.maximum(places - beside, 0), np.minimum(places + beside, most)
    turns = np.arccos(np.clip((path.tangents[first] * path.tangents[last]).sum(axis=-1), -1.0, 1.0))
    radii = (last - first) * SPACING / np.maximum(turns, 1e-6)
    lateral = np.array([lateral_limit(model, part.type) for part in path.parts])[path.part]
    return np.sqrt(lateral * radii)


def lateral_limit(model: MotionModel, kind: str) -> float:
    """Acceleration in cm/s^2 towards the inside of a curve that recordings of a type show, at least PROFILE.lateral.

    Raises ControlError for an unknown type.
    """
    model.type_id(kind)
    span = round(PROFILE.stride * model.fps)
    found = [np.zeros(1)]
    for clip in model.types[kind].reference_clips:
        velocity = (clip.ground[span:, :2] - clip.ground[:-span, :2]) * (model.fps / span)
        bend = np.abs(np.diff(np.unwrap(np.arctan2(velocity[:, 0], velocity[:, 1])))) * model.fps
        found.append(bend * np.linalg.norm(velocity[1:], axis=-1))
    return max(float(np.quantile(np.concatenate(found), PROFILE.lateral_share)), PROFILE.lateral)


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
