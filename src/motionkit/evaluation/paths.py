"""Path following (paper 5.2): the distance of the root from each path, for several characters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.follow import PathFollower
from motionkit.control.path import METRE, SHAPES, SPACING, Path2D, PathPart, make_path, shape_path
from motionkit.evaluation.report import Goal, Section, Table
from motionkit.evaluation.rolling import Driven, Progress, roll_controlled
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.features.control import Controls
from motionkit.metrics.trajectory import trajectory_distance
from motionkit.models.model import MotionModel

PATIENCE = 1.6  # times the expected duration, after which a character gives up


@dataclass(frozen=True)
class PathTrial:
    """A path with its name and its target: the largest mean distance in cm."""

    name: str
    path: Path2D
    target: float


def path_trials() -> list[PathTrial]:
    """Return the paths of the scoreboard."""
    corner = SHAPES["pentagram"](6.0 * METRE)[:3]
    return [
        PathTrial("line 10 m, walking", shape_path("line", 10.0, ["walking"], None), 0.8),
        PathTrial("circle r = 3 m, walking", shape_path("circle", 3.0, ["walking"], None), 0.8),
        PathTrial("circle r = 6 m, running", shape_path("circle", 6.0, ["running"], None), 2.0),
        PathTrial("figure-eight r = 2 m, walking", shape_path("figure-eight", 2.0, ["walking"], None), 0.8),
        PathTrial("pentagram corner (144°), running", make_path([PathPart(corner, "running")]), 2.0),
        PathTrial("U-turn, walking", shape_path("u-turn", 6.0, ["walking"], None), 0.8),
        PathTrial(
            "running → cartwheel → running", _line(("running", 6), ("cartwheel", 3), ("running", 6)), 2.0
        ),
        PathTrial(
            "jumping-r → jumping-l → running → jumping-l → jumping-r",
            _line(("jumping-r", 4), ("jumping-l", 4), ("running", 6), ("jumping-l", 4), ("jumping-r", 4)),
            2.0,
        ),
    ]


def _line(*parts: tuple[str, float]) -> Path2D:
    """Return a straight path of stretches, each with a type and a length in metres."""
    out, at = [], 0.0
    for kind, metres in parts:
        ends = np.array([[0.0, at], [0.0, at + metres * METRE]], np.float32)
        out.append(PathPart(ends, kind))
        at += metres * METRE
    return make_path(out)


class _Walker:
    """A controller of one character on a path; it remembers when the end was reached."""

    def __init__(self, model: MotionModel, trial: PathTrial) -> None:
        self.follower = PathFollower(model, trial.path)
        self.limit = int((PATIENCE * self.follower.expected_seconds + 3.0) * model.fps)
        self.frames, self.finished = 0, False
        self._asked: Controls | None = None

    def __call__(self, frame: int, ground: Array) -> Controls:
        if self._asked is not None and self.over:  # waits for the other characters
            return self._asked
        self._asked = self.follower(frame, ground)
        self.frames = frame + 1
        self.finished = self.follower.arc >= self.follower.path.length - SPACING
        return self._asked

    @property
    def over(self) -> bool:
        """Whether the character reached the end or gave up."""
        return self.finished or self.frames >= self.limit


def paths_section(model: MotionModel, settings: EvaluationSettings, progress: Progress) -> Section:
    """Measure the section: mean and largest distance from each path, and how often its end was reached."""
    trials = [t for t in path_trials() if {p.type for p in t.path.parts} <= set(model.types)]
    table_columns = ("path", "mean distance, cm", "largest distance, cm", "finished", "seconds")
    if not trials:
        note = "not measured: every path needs a type the model does not have"
        return Section("paths", "Path following", [], [], [note])
    found = follow_trials(model, trials, settings, progress)
    rows, goals = [], []
    for trial, followed in zip(trials, found, strict=True):
        mean, finished = followed.mean, followed.finished
        ends = f"{finished} of {settings.repeats}"
        rows.append((trial.name, mean, followed.largest, ends, followed.seconds))
        note = "" if finished == settings.repeats else f"finished {ends}"
        goals.append(
            Goal(f"{trial.name}: mean distance, cm", mean, f"≤ {trial.target:g}", None, trial.target, note)
        )
    notes = [
        f"{settings.repeats} characters per path, each type at its usual speed; distance: from the root to the nearest "
        "point of the path (path-mean, path-max), over all frames until the end; mean over characters, and the largest",
        f"a character gives up after {PATIENCE:g} times the expected time plus 3 s",
    ]
    return Section(
        "paths", "Path following", [Table("Distance from the path", table_columns, rows)], goals, notes
    )


@dataclass(frozen=True)
class Followed:
    """How the characters of one trial did.

    Attributes:
        mean: mean distance from the path in cm, over characters.
        largest: the largest distance in cm.
        finished: characters that reached the end.
        seconds: mean time until the end, or until a character gave up.
    """

    mean: float
    largest: float
    finished: int
    seconds: float


def follow_trials(
    model: MotionModel, trials: list[PathTrial], settings: EvaluationSettings, progress: Progress
) -> list[Followed]:
    """Let settings.repeats characters follow each path, all at once."""
    walkers = [_Walker(model, trial) for trial in trials for _ in range(settings.repeats)]
    characters = [
        Driven(walker.follower.path.parts[0].type, walker, _start(walker.follower)) for walker in walkers
    ]
    performed = roll_controlled(
        model,
        characters,
        max(walker.limit for walker in walkers),
        settings.noise,
        settings.seed,
        progress,
        lambda: all(walker.over for walker in walkers),
    )
    out = []
    for number, trial in enumerate(trials):
        mine = range(number * settings.repeats, (number + 1) * settings.repeats)
        distances = [
            trajectory_distance(
                performed[i].body.positions[: walkers[i].frames, 0, [0, 2]], trial.path.points
            )
            for i in mine
        ]
        out.append(
            Followed(
                float(np.mean([distance.mean for distance in distances])),
                max(distance.max for distance in distances),
                sum(walkers[i].finished for i in mine),
                float(np.mean([walkers[i].frames / model.fps for i in mine])),
            )
        )
    return out


def _start(follower: PathFollower) -> Array:
    """Return root x, z and heading (3,) at the start of a path."""
    tangent = follower.path.tangents[0]
    heading = math.atan2(float(tangent[0]), float(tangent[1])) - float(follower.facings[0])
    return np.array([*follower.path.points[0], heading], np.float32)
