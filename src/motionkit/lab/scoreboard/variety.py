"""Variety: how far seeds are apart, how much of the recordings is shown, and whether a motion repeats itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.script import TypePart
from motionkit.lab.scoreboard.report import Section, all_of
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.body import Body
from motionkit.metrics.variety import (
    LOOP_SECONDS,
    POSE_RATE,
    REPLAY_SECONDS,
    WINDOW,
    RecordingWindows,
    drawn_share,
    loop_seconds,
    mean_pose_gap,
)
from motionkit.tables import Cell, Table
from motionkit.training.verdict.real import mirrored_poses
from motionkit.training.verdict.rolling import Plan, Progress, Take

DRAWN = 0.8  # target share of a type's recordings, by length
APART = 0.5  # target distance of two seeds relative to that of two recordings
REPLAYED = 0.1  # largest share of a long roll-out that repeats an earlier part
LONG_SECONDS = 60.0  # of recordings, from which on a type must not repeat itself within as long
MOST_RECORDINGS = 16  # longest recordings of a type that are compared with the others


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
    plans = [Plan((TypePart(kind, LONG_SECONDS),), trial.settings.first_seed) for kind in takes]
    long = trial.roll(plans, lambda share: progress(0.4 + 0.3 * share))
    rows: list[tuple[Cell, ...]] = []
    reached: dict[str, dict[str, bool]] = {}
    for number, kind in enumerate(takes):
        found = _measured(trial, kind, takes[kind], long[number])
        if found is not None:
            rows.append(found[0])
            reached[kind] = found[1]
        progress(0.7 + 0.3 * (number + 1) / len(takes))
    columns = (
        "type", "seeds apart, cm", "recordings apart, cm", "training recordings drawn on", "of all", "recordings",
        "nearest recording, cm", "recordings to the nearest other, cm", "along one recording, s",
        "recordings along another, s", "loop, s", "recorded loop, s", "replayed",
    )  # fmt: skip
    names = {
        "apart": f"seeds at least {APART:g} times as far apart as recordings: share of types",
        "drawn": f"{trial.settings.seeds} seeds draw on {DRAWN:.0%} of the training recordings: share of types",
        "replayed": f"at most {REPLAYED:.0%} replayed where {LONG_SECONDS:g} s are recorded: share of types",
        "loop": f"no loop within {LONG_SECONDS:g} s where that much is recorded: share of types",
    }
    goals = []
    for what, name in names.items():
        kinds = [kind for kind, of_kind in reached.items() if what in of_kind]
        goals.append(all_of(name, kinds, [kind for kind in kinds if not reached[kind][what]]))
    tables = [Table("Seeds and recordings", columns, rows)]
    return Section("variety", "Variety", tables, goals, _notes(trial.settings))


def _measured(
    trial: Trial, kind: str, takes: Sequence[Take], long: Take
) -> tuple[tuple[Cell, ...], dict[str, bool]] | None:
    """The row of a type, and which goals that can be measured it reaches; None without recordings to compare with."""
    stretches = trial.real.of_type(kind)
    recorded = recorded_poses([stretch.body for stretch in stretches])
    if recorded is None:
        return None
    learnt = recorded_poses([stretch.body for stretch in stretches if stretch.split == "train"])
    parts_of_takes = [[poses_of(part.default) for part in take.performed()] for take in takes]
    first = [parts[0] for parts in parts_of_takes]
    mine = [poses for parts in parts_of_takes for poses in parts if len(poses) >= WINDOW]
    if not mine:
        return None
    places = [recorded.windows.places(poses) for poses in mine]
    gap, real_gap = mean_pose_gap(first), mean_pose_gap(recorded.poses)
    drawn, drawn_learnt = drawn_share(places, recorded.lengths), None
    near = float(np.concatenate([place.distances for place in places]).mean())
    stretch = max(place.longest_stretch() for place in places)
    take_apart, take_stretch = _against_others(recorded)
    long_poses = poses_of(long.default)
    loop, real_loop = loop_seconds(long_poses).value, _recorded_loop(recorded)
    replayed = recorded.windows.places(long_poses).replayed()
    reached: dict[str, bool] = {}
    if gap is not None and real_gap is not None:
        reached["apart"] = gap >= APART * real_gap
    if learnt is not None:
        drawn_learnt = drawn_share([learnt.windows.places(poses) for poses in mine], learnt.lengths)
        reached["drawn"] = drawn_learnt >= DRAWN
    seconds = sum(stretch.body.seconds for stretch in stretches)
    if seconds >= LONG_SECONDS and real_loop is None and not trial.model.kind(kind).steered:
        reached["loop"], reached["replayed"] = loop is None, replayed <= REPLAYED
    row = (
        kind, gap, real_gap, drawn_learnt, drawn, len(recorded.poses), near, take_apart, stretch, take_stretch, loop,
        real_loop, replayed,
    )  # fmt: skip
    return row, reached


def _notes(settings: EvaluationSettings) -> list[str]:
    return [
        f"{settings.seeds} roll-outs of {settings.accuracy_seconds:g} s per type, and one of {LONG_SECONDS:g} s, as "
        f"synthesize makes them by default; poses at {POSE_RATE:g} Hz, relative to the ground below the root and to "
        "the heading, in cm per joint",
        "measured where the type is shown, without the stands and run-ups that synthesis adds",
        "apart: mean distance of the poses of two seeds, or of two recordings, at equal times from their beginnings",
        "drawn on: share of the recordings, by length, that half a second of some roll-out is nearest to, mirror "
        "images included: of those to learn from, and of all, held-out ones too; nearest recording: mean distance of "
        "these half seconds; beside it, that of a recording to the others",
        "along one recording: longest time for which the nearest place goes on at its own pace",
        f"loop: shortest time from {LOOP_SECONDS:g} s on after which the long roll-out repeats itself; gaits repeat by "
        "nature and have no target",
        f"replayed: share of the half seconds of the long roll-out nearest to a recorded place that was nearest "
        f"{REPLAY_SECONDS:g} s or more before, too",
    ]


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
