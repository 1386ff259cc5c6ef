"""All metrics of a motion, alone or against its ground truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.errors import MotionkitError, SkeletonError, naming
from motionkit.features.heading import heading_angles
from motionkit.free_memory import BYTES_BESIDE, check_memory
from motionkit.metrics.body_movement import body_movement
from motionkit.metrics.ground import (
    FLOOR_HEIGHT,
    average_foot_sliding,
    foot_skate_ratio,
    penetration,
    sliding_over_ground,
)
from motionkit.metrics.leaps import fastest_turn, leaps
from motionkit.metrics.prediction import (
    mean_position_error,
    position_distance,
    power_spectrum_similarity,
    rotation_distance,
)
from motionkit.metrics.similarity import expmap_pair, structural_similarity
from motionkit.metrics.smoothness import jerk_extremes, mean_jerk
from motionkit.metrics.touch import (
    GROUPS,
    flight_acceleration,
    hover_share,
    lowest_points,
    planted_share,
)
from motionkit.metrics.trajectory import ground_track, location_errors, trajectory_distance
from motionkit.metrics.value import FRAME_RATE, MetricSettings, MetricValue, measured
from motionkit.motion.bvh import bvh_to_motion
from motionkit.motion.floor import floor_height, foot_positions
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_from_yaw, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, leg_length
from motionkit.reading import reading
from motionkit.rig.canonical import canonical_motion, canonical_with_notes
from motionkit.rig.read_file import read_file
from motionkit.rig.upright import describe_motion

# Unit of each metric that needs a pair, and its value for the ground truth against itself.
PAIR_METRICS: dict[str, tuple[str, float]] = {
    "ssim-channel": ("", 1.0),
    "ssim-window": ("", 1.0),
    "mpjpe": ("cm", 0.0),
    "path-mean": ("cm", 0.0),
    "path-max": ("cm", 0.0),
    "path-coverage": ("", 1.0),
    "location-mean": ("cm", 0.0),
    "location-20": ("", 0.0),
    "location-50": ("", 0.0),
    "trajectory-20": ("", 0.0),
    "trajectory-50": ("", 0.0),
    "l2p": ("cm", 0.0),
    "l2q": ("", 0.0),
    "npss": ("", 0.0),
}
_LOCATIONS = ("location-mean", "location-20", "location-50", "trajectory-20", "trajectory-50")
# Metrics whose ratio to the ground truth means nothing: heights, and an acceleration that has one right value.
_WITHOUT_RATIO = frozenset(
    {"floor-height", "lowest-feet", "lowest-hands", "lowest-head", "lowest-body", "flight-acceleration"}
)
SLIDING = "feet on the floor slide {:.0f} % of the time"  # skate-ratio in words
APART = 3.0  # cm; a larger difference between the floors of a pair gets a note


@dataclass(frozen=True)
class MetricRow:
    """One metric of a motion, and of its ground truth if there is one."""

    motion: MetricValue
    ground_truth: MetricValue | None = None

    @property
    def id(self) -> str:
        """The id of the metric."""
        return self.motion.id

    @property
    def ratio(self) -> float | None:
        """The motion's value divided by the ground truth's; None where that is meaningless."""
        base = None if self.ground_truth is None else self.ground_truth.value
        if self.motion.value is None or not base or self.id in _WITHOUT_RATIO:
            return None
        return self.motion.value / base

    def reasons(self) -> list[str]:
        """Why values of the motion and of its ground truth are missing, each reason once."""
        values = (self.motion, self.ground_truth)
        return list(dict.fromkeys(value.reason for value in values if value is not None and value.reason))

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        out: dict[str, Any] = {"id": self.id, "unit": self.motion.unit, "value": self.motion.value}
        out["parameters"] = self.motion.parameters
        if self.motion.reason:
            out["reason"] = self.motion.reason
        if self.ground_truth is not None:
            out["ground_truth"] = self.ground_truth.value
            out["ground_truth_parameters"] = self.ground_truth.parameters
            out["ratio"] = self.ratio
            if self.ground_truth.reason:
                out["ground_truth_reason"] = self.ground_truth.reason
        return out


@dataclass(frozen=True)
class MetricReport:
    """Every metric of one evaluation.

    Attributes:
        rows: the metrics, in the order in which they are printed.
        frames: number of frames compared, at fps.
        notes: how the motions were made comparable, and what that does to the values.
        read_as: how each file was read, in words.
    """

    rows: tuple[MetricRow, ...]
    frames: int
    fps: float = FRAME_RATE
    notes: tuple[str, ...] = ()
    read_as: tuple[str, ...] = ()

    def value(self, metric_id: str) -> float | None:
        """The motion's value of a metric; raises MotionkitError if the id is not in the report."""
        for row in self.rows:
            if row.id == metric_id:
                return row.motion.value
        raise MotionkitError(
            f"unknown metric {metric_id!r}, expected one of {', '.join(row.id for row in self.rows)}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "frames": self.frames,
            "fps": self.fps,
            "metrics": [row.as_dict() for row in self.rows],
            "notes": list(self.notes),
            **(
                {"taken": self.read_as[0] if len(self.read_as) == 1 else self.read_as} if self.read_as else {}
            ),
        }

    def remarks(self) -> list[str]:
        """The notes, and the reasons why metrics could not be measured."""
        return list(dict.fromkeys([*self.notes, *self.reasons()]))

    def reasons(self) -> list[str]:
        """Why metrics could not be measured, each with its id."""
        return [f"{row.id}: {reason}" for row in self.rows for reason in row.reasons()]

    def thresholds(self) -> list[str]:
        """One line per metric with thresholds, without the floor, which is a metric of its own."""
        lines = []
        for row in self.rows:
            words = [
                f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
                for key, value in row.motion.parameters.items()
                if key != "floor_cm"
            ]
            if words:
                lines.append(f"{row.id}: {', '.join(words)}")
        return lines


def evaluate_motion(
    motion: Motion,
    reference: Motion | None = None,
    settings: MetricSettings | None = None,
    skip: int = 0,
    align_start: bool = False,
    given: int = 0,
) -> MetricReport:
    """All metrics of a motion, alone or against its ground truth.

    Both motions are resampled to 60 fps and compared over their common frames, counted from the first. The report's
    notes say what this changed. Feet of both are measured from the floor of the ground truth.

    Args:
        motion: on the 23 canonical joints, in cm, at any rate.
        reference: ground truth, likewise.
        settings: thresholds; the documented definitions by default.
        skip: frames at 60 fps to leave out at the start of both.
        align_start: turn and move the motion along the ground so that the first compared frames agree.
        given: initial frames at 60 fps that the model was given, which only the ground truth contains.

    Raises:
        MotionkitError: fewer than two frames are left to compare, a value is not finite, skip or given is negative, or
            given or align_start comes without a ground truth.
        SkeletonError: a skeleton is not the canonical one.
    """
    _check_asked(skip, given, align_start, reference is not None)
    settings = settings or MetricSettings()
    motions = [motion] if reference is None else [motion, reference]
    for each, name in zip(motions, _names(motions), strict=True):
        _check(each, name)
    if reference is not None:
        check_memory(len(motion) + len(reference), len(JOINT_NAMES), motion.fps, BYTES_BESIDE)
    notes = _rate_notes(motions)
    whole = [resample(each, FRAME_RATE) for each in motions]
    starts = [skip, skip + given][: len(whole)]  # frames to leave out of each
    frames = _common_frames(whole, starts, skip, given)
    notes += _length_notes(whole, frames, skip, given)
    cut = [each.cut(start, start + frames) for each, start in zip(whole, starts, strict=True)]
    if reference is not None and align_start:
        cut[0] = placed_like(cut[0], cut[1])
        notes.append("generated motion turned and moved along the ground to start like the ground truth")
    rate = min([FRAME_RATE, *(each.fps for each in motions)])
    notes += _jerk_notes(rate)
    spans = [_same_time(each, start, start + frames) for each, start in zip(motions, starts, strict=True)]
    floors = [_floor(each, settings) for each in cut]
    # One floor for both; otherwise a motion that is too low would be measured from its own lower floor.
    common = spans[-1], rate, floors[-1], settings
    columns = [
        [*_single_metrics(each, span, *common, start), _floor_value(floor, settings)]
        for each, span, floor, start in zip(cut, spans, floors, starts, strict=True)
    ]
    if reference is None:
        rows = [MetricRow(value) for value in columns[0]]
    else:
        notes += _body_notes(motion, reference) + _floor_notes(floors)
        rows = [MetricRow(mine, theirs) for mine, theirs in zip(*columns, strict=True)]
        rows += _pair_metrics(cut[0], cut[1], settings)
    return MetricReport(tuple(rows), frames, FRAME_RATE, tuple(notes))


def evaluate_files(
    ground_truth: str | Path,
    generated: str | Path | None = None,
    settings: MetricSettings | None = None,
    skip: int = 0,
    align_start: bool = False,
    scales: tuple[float | None, float | None] = (None, None),
    rates: tuple[float | None, float | None] = (None, None),
    given: int = 0,
) -> MetricReport:
    """All metrics of BVH files of any rig, which are loaded on the 23 canonical joints.

    Args:
        ground_truth: file to measure, or to measure against.
        generated: file to measure against the ground truth.
        settings, skip, align_start, given: as in evaluate_motion.
        scales: cm per file unit of each file; detected by default.
        rates: frame rate of each file, if its header is wrong.

    Raises:
        BvhError: a file is invalid.
        SkeletonError: a rig cannot be retargeted.
        MotionkitError: as for evaluate_motion.
    """
    names = [Path(path).name for path in (ground_truth, generated) if path is not None]
    if len(set(names)) < len(names):  # notes could not be told apart
        names = ["ground truth", "generated motion"]
    first, notes, words = _loaded(ground_truth, names[0], scales[0], rates[0])
    if generated is None:
        with naming(ground_truth, MotionkitError):
            report = evaluate_motion(first, None, settings, skip)
    else:
        second, more, other = _loaded(generated, names[1], scales[1], rates[1])
        notes, words = notes + more, words + other
        with naming(f"{ground_truth} and {generated}", MotionkitError):
            report = evaluate_motion(second, first, settings, skip, align_start, given)
    return replace(report, notes=(*notes, *report.notes), read_as=tuple(words))


def _loaded(
    path: str | Path, name: str, scale: float | None, rate: float | None
) -> tuple[Motion, list[str], list[str]]:
    """A file on the canonical joints, notes that begin with `name`, and how it was read."""
    with reading(cm=scale), naming(path):
        bvh = read_file(path)
        motion, notes = canonical_with_notes(bvh, name, fps=rate)
        return motion, notes, [describe_motion(bvh_to_motion(bvh, fps=rate))]


def placed_like(motion: Motion, reference: Motion) -> Motion:
    """The motion, turned about Y and moved along the ground to start at the reference's place and heading."""
    yaws = [heading_angles(motion_kinematics(each)[1], each.fps)[0] for each in (motion, reference)]
    turn = quat_from_yaw(yaws[1] - yaws[0]).astype(motion.local_rotations.dtype)
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(np.broadcast_to(turn, rotations[:, 0].shape), rotations[:, 0])
    places = quat_rotate(turn, motion.root_positions - motion.root_positions[0])
    places[:, 1] += motion.root_positions[0, 1]
    places[:, [0, 2]] += reference.root_positions[0, [0, 2]].astype(places.dtype)
    return replace(motion, local_rotations=rotations, root_positions=places)


def _check(motion: Motion, name: str) -> None:
    if motion.skeleton.names != JOINT_NAMES:
        raise SkeletonError(
            f"metrics need the {len(JOINT_NAMES)} canonical joints; the {name} has {len(motion.skeleton)}"
        )
    if not motion.fps > 0 or not math.isfinite(motion.fps):
        raise MotionkitError(f"the {name} has {motion.fps} frames per second, expected more than 0")
    for values in (motion.local_rotations, motion.root_positions):
        if not bool(np.isfinite(values).all()):
            frame = int(np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))[0])
            raise MotionkitError(f"the {name} has a value that is not finite in frame {frame}")


def _floor(motion: Motion, settings: MetricSettings) -> float:
    """The floor height in cm from the settings, else from the motion."""
    if settings.floor is not None:
        return settings.floor
    return floor_height(foot_positions(motion_kinematics(motion)[1].astype(np.float64)))


def _floor_value(floor: float, settings: MetricSettings) -> MetricValue:
    return MetricValue("floor-height", floor, "cm", {"floor": "own" if settings.floor is None else "given"})


def sliding_words(motion: Motion) -> str:
    """How much the feet of a motion of any rig slide; "" if it is not known as a human one, or too short."""
    try:
        slides = evaluate_motion(canonical_motion(motion)).value("skate-ratio")
    except MotionkitError:
        return ""
    return "" if slides is None else SLIDING.format(100 * slides)


def _single_metrics(
    motion: Motion,
    native: Motion,
    usual: Motion,
    jerk_rate: float,
    floor: float,
    settings: MetricSettings,
    start: int,
) -> list[MetricValue]:
    """The metrics of one motion above a floor height.

    Args:
        motion: at 60 fps.
        native: the same span at the file's own rate, for jerk.
        usual: the ground truth at its own rate, whose jerk is usual.
        start: frame of the file, at 60 fps, at which the motion begins.
    """
    positions = motion_kinematics(motion)[1].astype(np.float64)
    feet, ground = foot_positions(positions), floor - FLOOR_HEIGHT
    native_positions, recorded = (motion_kinematics(each)[1].astype(np.float64) for each in (native, usual))
    rotations = motion.local_rotations
    measures: list[tuple[Callable[[], MetricValue | tuple[MetricValue, ...]], dict[str, str]]] = [
        (lambda: body_movement(rotations, "euler"), {"bm-euler": "deg/frame"}),
        (lambda: body_movement(rotations, "geodesic"), {"bm-geodesic": "deg/frame"}),
        (lambda: average_foot_sliding(feet, floor, settings), {"afs": "cm/frame"}),
        (lambda: sliding_over_ground(feet, settings), {"afs-ground": "cm/frame"}),
        (lambda: foot_skate_ratio(feet, floor, settings), {"skate-ratio": ""}),
        (lambda: mean_jerk(native_positions, native.fps, jerk_rate), {"jerk": "m/s^3"}),
        (
            lambda: jerk_extremes(native_positions, native.fps, recorded, usual.fps, jerk_rate),
            {"jerk-peak": "m/s^3", "jerk-area": "m/s^2"},
        ),
        (lambda: penetration(feet, floor), {"penetration-mean": "cm", "penetration-max": "cm"}),
        (lambda: leaps(positions, native.fps), {"leaps": "1/min"}),
        (lambda: fastest_turn(rotations, start=start), {"turn-max": "deg/s"}),
        (lambda: planted_share(positions, ground), {"planted-share": ""}),
        (lambda: hover_share(positions, ground), {"hover-share": ""}),
        (lambda: lowest_points(positions, ground), {f"lowest-{group}": "cm" for group in GROUPS}),
        (lambda: flight_acceleration(positions, ground, start), {"flight-acceleration": "m/s^2"}),
    ]
    return [value for measure, units in measures for value in measured(measure, units)]


def _pair_metrics(motion: Motion, reference: Motion, settings: MetricSettings) -> list[MetricRow]:
    mine, theirs = expmap_pair(motion, reference)
    places, true_places = motion_kinematics(motion)[1], motion_kinematics(reference)[1]
    track, path = ground_track(motion.root_positions), ground_track(reference.root_positions)
    values = [
        *measured(lambda: structural_similarity(mine, theirs, "channel", settings), _units("ssim-channel")),
        *measured(lambda: structural_similarity(mine, theirs, "window", settings), _units("ssim-window")),
        *measured(lambda: mean_position_error(places, true_places), _units("mpjpe")),
        *measured(
            lambda: trajectory_distance(track, path, settings.path_tolerance).values(),
            _units("path-mean", "path-max", "path-coverage"),
        ),
        *measured(lambda: location_errors(track, path), _units(*_LOCATIONS)),
        *measured(lambda: position_distance(motion, reference), _units("l2p")),
        *measured(lambda: rotation_distance(motion, reference), _units("l2q")),
        *measured(lambda: power_spectrum_similarity(motion, reference), _units("npss")),
    ]
    return [
        MetricRow(value, replace(value, value=PAIR_METRICS[value.id][1], reason=None)) for value in values
    ]


def _units(*ids: str) -> dict[str, str]:
    return {metric_id: PAIR_METRICS[metric_id][0] for metric_id in ids}


def _same_time(motion: Motion, start: int, end: int) -> Motion:
    """The frames at the motion's own rate within the time of frames start to end (exclusive) at 60 fps."""
    per_frame = motion.fps / FRAME_RATE
    return motion.cut(math.ceil(start * per_frame - 1e-6), math.floor((end - 1) * per_frame + 1e-6) + 1)


def _names(motions: list[Motion]) -> list[str]:
    return ["motion"] if len(motions) == 1 else ["generated motion", "ground truth"]


def _rate_notes(motions: list[Motion]) -> list[str]:
    return [
        f"{name}: {motion.fps:g} fps, resampled to {FRAME_RATE:g}"
        for name, motion in zip(_names(motions), motions, strict=True)
        if abs(motion.fps - FRAME_RATE) > 1e-6 * FRAME_RATE
    ]


def _jerk_notes(rate: float) -> list[str]:
    if rate >= FRAME_RATE:
        return []
    return [
        f"jerk is measured at {rate:g} fps, the lowest rate of the files; between frames of such a file joints are "
        "interpolated, so bm and turn-max read low and skate-ratio high"
    ]


def _check_asked(skip: int, given: int, align_start: bool, paired: bool) -> None:
    if min(skip, given) < 0:
        raise MotionkitError(f"expected 0 or more frames to skip and given frames, found {skip} and {given}")
    if not paired and (given or align_start):
        raise MotionkitError("given frames and align_start need a ground truth, found none")


def _common_frames(motions: list[Motion], starts: list[int], skip: int, given: int) -> int:
    """Number of frames to compare; raises MotionkitError for fewer than two."""
    frames = min(len(each) - start for each, start in zip(motions, starts, strict=True))
    if frames < 2:
        lengths = " and ".join(str(len(each)) for each in reversed(motions))
        left_out = " and ".join(f"the {n} {word}" for n, word in ((skip, "skipped"), (given, "given")) if n)
        raise MotionkitError(
            f"expected at least 2 frames at 60 fps to measure, found {lengths}{left_out and f', less {left_out}'}"
        )
    return frames


def _length_notes(motions: list[Motion], frames: int, skip: int, given: int) -> list[str]:
    notes = [f"the first {skip} frames are skipped"] if skip else []
    if given:
        notes.append(f"the first {given} frames of the ground truth were given to the model")
    mine, theirs = len(motions[0]), len(motions[-1]) - given
    if mine != theirs and len(motions) > 1:
        notes.append(
            f"ground truth has {theirs} frames, generated {mine}; compared over the first {frames + skip}"
        )
    return notes


def _floor_notes(floors: list[float]) -> list[str]:
    mine, theirs = floors
    if abs(mine - theirs) <= APART:
        return []
    return [
        f"standing toes of the generated motion are at {mine:.1f} cm, those of the ground truth at {theirs:.1f} cm; "
        "feet of both are measured from the latter"
    ]


def _body_notes(motion: Motion, reference: Motion) -> list[str]:
    difference = np.linalg.norm(motion.skeleton.offsets - reference.skeleton.offsets, axis=-1).mean()
    if motion.local_positions is not None or reference.local_positions is not None or difference < 0.1:
        return []
    legs = [leg_length(each.skeleton) for each in (reference, motion)]
    return [
        f"the bodies differ by {float(difference):.2g} cm per bone (legs {legs[0]:.1f} and {legs[1]:.1f} cm), "
        "which adds to mpjpe"
    ]
