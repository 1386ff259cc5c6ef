"""Variety: how far seeds are apart, how much of the recordings is shown, and whether a motion repeats itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.script import TypePart
from motionkit.evaluation.body import Body
from motionkit.evaluation.real import mirrored_poses
from motionkit.evaluation.report import Cell, Section, Table
from motionkit.evaluation.rolling import Plan, Progress
from motionkit.evaluation.trial import Trial
from motionkit.evaluation.visible import share_of_types
from motionkit.metrics.variety import (
    LOOP_SECONDS,
    POSE_RATE,
    WINDOW,
    RecordingWindows,
    drawn_share,
    loop_seconds,
    mean_pose_gap,
)

DRAWN = 0.8  # target share of a type's recordings, by length
APART = 0.5  # target distance of two seeds relative to that of two recordings
FROM_RECORDINGS = 1.0  # target distance from the nearest recording relative to that of another recording
LONG_SECONDS = 60.0  # of recordings, from which on a type must not repeat itself within as long
MOST_RECORDINGS = 16  # of a type, the longest, that are held against the others


@dataclass(frozen=True, eq=False)
class Recorded:
    """Recordings of a type as poses: each with its mirror image, and the windows of all."""

    poses: list[Array]
    lengths: Array
    windows: RecordingWindows


def poses_of(body: Body) -> Array:
    """Return the poses (T, 69) of a body at POSE_RATE."""
    return body.poses(max(1, round(body.fps / POSE_RATE)))


def recorded_poses(bodies: list[Body]) -> Recorded | None:
    """Return the recordings of a type that are at least a window long; None without any."""
    poses = [poses for poses in map(poses_of, bodies) if len(poses) >= WINDOW]
    if not poses:
        return None
    windows = RecordingWindows([[each, mirrored_poses(each)] for each in poses])
    return Recorded(poses, np.array([len(each) for each in poses]), windows)


def variety_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: many seeds of each type alone, and one long roll-out."""
    takes = trial.alone(lambda share: progress(0.4 * share))
    kinds = tuple(takes)
    plans = [Plan((TypePart(kind, LONG_SECONDS),), trial.settings.first_seed) for kind in kinds]
    long = trial.roll(plans, lambda share: progress(0.4 + 0.3 * share))
    rows: list[tuple[Cell, ...]] = []
    measured: dict[str, list[str]] = {"apart": [], "drawn": [], "loop": [], "far": []}
    failing: dict[str, list[str]] = {"apart": [], "drawn": [], "loop": [], "far": []}

    def judge(what: str, kind: str, reached: bool) -> None:
        measured[what].append(kind)
        if not reached:
            failing[what].append(kind)

    for number, kind in enumerate(kinds):
        stretches = trial.real.of_type(kind)
        recorded = recorded_poses([stretch.body for stretch in stretches])
        if recorded is None:
            continue
        mine = [poses_of(take.default) for take in takes[kind]]
        places = [recorded.windows.places(poses) for poses in mine]
        gap, real_gap = mean_pose_gap(mine), mean_pose_gap(recorded.poses)
        drawn = drawn_share(places, recorded.lengths)
        learnt = recorded_poses([stretch.body for stretch in stretches if stretch.split == "train"])
        drawn_learnt = None if learnt is None else drawn_share(
            [learnt.windows.places(poses) for poses in mine], learnt.lengths
        )  # fmt: skip
        near = float(np.concatenate([place.distances for place in places]).mean())
        stretch = max(place.longest_stretch() for place in places)
        take_apart, take_stretch = _against_others(recorded)
        loop = loop_seconds(poses_of(long[number].default)).value
        real_loop = _recorded_loop(recorded)
        seconds = sum(stretch.body.seconds for stretch in stretches)
        rows.append((
            kind, gap, real_gap, drawn_learnt, drawn, len(recorded.poses), near, take_apart, stretch, take_stretch,
            loop, real_loop,
        ))  # fmt: skip
        if gap is not None and real_gap is not None:
            judge("apart", kind, gap >= APART * real_gap)
        if drawn_learnt is not None:
            judge("drawn", kind, drawn_learnt >= DRAWN)
        if take_apart is not None:
            judge("far", kind, near >= FROM_RECORDINGS * take_apart)
        if seconds >= LONG_SECONDS and real_loop is None and not trial.model.kind(kind).steered:
            judge("loop", kind, loop is None)
        progress(0.7 + 0.3 * (number + 1) / len(kinds))
    columns = (
        "type", "seeds apart, cm", "recordings apart, cm", "training recordings drawn on", "of all", "recordings",
        "nearest recording, cm", "recordings to the nearest other, cm", "along one recording, s",
        "recordings along another, s", "loop, s", "recorded loop, s",
    )  # fmt: skip
    names = {
        "apart": f"seeds at least {APART:g} times as far apart as recordings: share of types",
        "drawn": f"{trial.settings.seeds} seeds draw on {DRAWN:.0%} of the training recordings: share of types",
        "far": "as far from the nearest recording as another take of it: share of types",
        "loop": f"no loop within {LONG_SECONDS:g} s where that much is recorded: share of types",
    }
    goals = [share_of_types(name, measured[what], failing[what]) for what, name in names.items()]
    notes = [
        f"{trial.settings.seeds} roll-outs of {trial.settings.accuracy_seconds:g} s per type, and one of "
        f"{LONG_SECONDS:g} s, as synthesize makes them by default; poses at {POSE_RATE:g} Hz, relative to the ground "
        "below the root and to the heading, in cm per joint",
        "apart: mean distance of the poses of two seeds, or of two recordings, at equal times from their beginnings",
        "drawn on: share of the recordings, by length, that half a second of some roll-out is nearest to, mirror "
        "images included: of those to learn from, and of all, held-out ones too; nearest recording: mean distance of "
        "these half seconds; beside it, that of a recording to "
        "the others",
        "along one recording: longest time for which the nearest place goes on at its own pace",
        f"loop: shortest time from {LOOP_SECONDS:g} s on after which the long roll-out repeats itself; gaits repeat by "
        "nature and have no target",
    ]
    return Section("variety", "Variety", [Table("Seeds and recordings", columns, rows)], goals, notes)


def _against_others(recorded: Recorded) -> tuple[float | None, float | None]:
    """Return how far recordings are from the nearest other one in cm, and how long they go along it in seconds."""
    if len(recorded.poses) < 2:
        return None, None
    longest = np.argsort(-recorded.lengths, kind="stable")[:MOST_RECORDINGS].tolist()
    places = [recorded.windows.places(recorded.poses[i], i) for i in longest]
    stretch = max(place.longest_stretch() for place in places)
    return float(np.concatenate([place.distances for place in places]).mean()), stretch


def _recorded_loop(recorded: Recorded) -> float | None:
    """Return the loop of the longest recording in seconds; None if it does not repeat itself or is too short."""
    longest = max(recorded.poses, key=len)
    if len(longest) < 4 * LOOP_SECONDS * POSE_RATE:
        return None
    return loop_seconds(longest).value
