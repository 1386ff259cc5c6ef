"""The sections of the scoreboard, measured on a model that hardly moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.evaluation.body import body_of
from motionkit.evaluation.paths import path_trials, paths_section
from motionkit.evaluation.real import RealMotion
from motionkit.evaluation.reconstruction import held_out_clips, reconstruction_section
from motionkit.evaluation.response import commands, response_seconds
from motionkit.evaluation.settings import QUICK
from motionkit.evaluation.smoothness import fastest_turn, recorded_limit
from motionkit.evaluation.stability import (
    DRIFT_LIMIT,
    foot_height,
    frozen_seconds,
    height_drift,
    random_plan,
    stability_section,
)
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from synthetic_motions import make_idle, make_walk

TINY = replace(QUICK, seeds=1, stability_seconds=0.5, mixed_seconds=0.5, reconstruction_seconds=0.6)


def quiet(share: float) -> None:
    """Ignore progress."""


def test_paths_are_as_long_as_they_say() -> None:
    trials = {trial.name: trial.path for trial in path_trials()}
    assert trials["circle r = 3 m, walking"].length == pytest.approx(2 * math.pi * 300.0, rel=0.01)
    assert trials["circle r = 6 m, running"].length == pytest.approx(2 * math.pi * 600.0, rel=0.01)
    corner = trials["pentagram corner (144°), running"]
    cosine = float((corner.tangents[10] * corner.tangents[-10]).sum())
    assert math.degrees(math.acos(cosine)) == pytest.approx(144.0, abs=1.0)
    mixed = next(path for name, path in trials.items() if name.startswith("jumping-r"))
    assert [part.type for part in mixed.parts][:3] == ["jumping-r", "jumping-l", "running"]


def test_every_path_of_known_types_is_measured(
    tiny_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = [trial for trial in path_trials() if trial.name.startswith(("line", "running"))]
    monkeypatch.setattr("motionkit.evaluation.paths.path_trials", lambda: wanted)
    monkeypatch.setattr("motionkit.evaluation.paths.PATIENCE", -0.3)  # leaves less than 3 s
    section = paths_section(tiny_model, TINY, quiet)
    assert [row[0] for row in section.tables[0].rows] == [trial.name for trial in wanted]
    for row, goal in zip(section.tables[0].rows, section.goals, strict=True):
        _, mean, largest, finished, _ = row
        assert goal.value == mean and 0.0 < mean <= largest  # the model hardly moves, but not along the path
        assert finished == "0 of 1" and goal.note == "finished 0 of 1"


def test_a_response_must_hold() -> None:
    flags = np.zeros(120, bool)
    flags[10:20] = True
    assert response_seconds(flags, 60.0) is None
    flags[60:80] = True
    assert response_seconds(flags, 60.0) == pytest.approx(1.0)


def test_motion_that_does_what_a_command_says_meets_it(tiny_model: MotionModel) -> None:
    found = {command.name: command for command in commands(tiny_model)}
    walk = body_of(make_walk(120, turn=0.0, speed=120.0))
    assert bool(found["idle → walking"].answers(walk)[20:100].all())
    assert not bool(found["walking → idle"].answers(walk).any())
    assert not bool(found["walking, 90° left"].answers(walk)[20:100].any())
    assert found["walking → idle"].looks_ahead == pytest.approx(0.1)
    assert bool(found["walking → idle"].answers(body_of(make_idle(120)))[20:100].all())


def test_frozen_and_sinking_bodies_are_found() -> None:
    still = make_walk(600, speed=0.0, swing=0.0)
    assert frozen_seconds(body_of(still), 0.1) == pytest.approx(10.0)
    assert frozen_seconds(body_of(make_walk(600)), 0.1) == 0.0
    root = still.root_positions.copy()
    root[:, 1] -= np.linspace(0.0, 30.0, 600, dtype=np.float32)
    sinking = Motion(still.skeleton, still.local_rotations, root, 60.0)
    assert height_drift(body_of(sinking)) == pytest.approx(-20.0, abs=0.5)


def test_foot_height_finds_a_floating_body(real: RealMotion) -> None:
    bodies = [stretch.body for stretch in real.of_type("walking")]
    raised = [
        replace(body, positions=body.positions + np.array([0.0, 6.0, 0.0], np.float32)) for body in bodies
    ]
    assert foot_height(raised) == pytest.approx(foot_height(bodies) + 6.0, abs=1e-3)
    half = [body.cut(0, len(body) // 2) for body in raised]  # jumps do not hide the height of standing
    assert foot_height([*bodies, *half]) < foot_height(bodies) + 3.0


def test_random_plans_fill_the_time_and_repeat(tiny_model: MotionModel) -> None:
    kinds = list(tiny_model.types)
    plan = random_plan(tiny_model, kinds, 20.0, 3)
    assert sum(part.seconds for part in plan.parts) == pytest.approx(20.0)
    assert len({part.type for part in plan.parts}) > 1
    assert plan == random_plan(tiny_model, kinds, 20.0, 3) != random_plan(tiny_model, kinds, 20.0, 4)


def test_stability_measures_every_type_and_random_changes(tiny_model: MotionModel, real: RealMotion) -> None:
    section = stability_section(tiny_model, real, TINY, quiet)
    rows, columns = section.tables[0].rows, section.tables[0].columns
    heights = [row[columns.index("foot height − real, cm")] for row in rows]
    assert None not in heights[:-1]
    assert [row[0] for row in rows] == [*tiny_model.types, "random type changes"]
    drifts = [row[columns.index("foot height drift, cm")] for row in rows[:-1]]
    goal = next(goal for goal in section.goals if "foot height drift" in goal.what)
    assert goal.value == np.mean([abs(drift) <= DRIFT_LIMIT for drift in drifts])
    assert [goal.value for goal in section.goals if "finite" in goal.what] == [1.0]


def test_reconstruction_scores_ground_truth_baselines_and_model(
    tiny_model: MotionModel, dataset: Dataset, real: RealMotion
) -> None:
    section = reconstruction_section(tiny_model, dataset, real, TINY, quiet)
    rows = {(row[0], row[1]): row[2:] for row in section.tables[0].rows}
    truth, still = rows["all", "ground truth"], rows["all", "last frame"]
    # Equal to itself: SSIM 1, no joint error, no distance from its path.
    assert truth[2:] == (1.0, 1.0, 0.0, 0.0)
    assert still[0] == pytest.approx(0.0, abs=1e-3) and truth[0] > 1.0
    late, later = rows["all", "3 frames late"], rows["all", "20 frames late"]
    assert 1.0 > late[3] > later[3] and 0.0 < late[4] < later[4]
    for variant in ("nearest clip", "model"):
        assert rows["all", variant][4] > 0.0 and rows["all", variant][5] > 0.0
    assert len(held_out_clips(tiny_model, dataset, 0.6)) == 1


def test_reconstruction_without_held_out_clips_says_so(
    tiny_model: MotionModel, dataset: Dataset, real: RealMotion, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset, "clips", tuple(c for c in dataset.clips if c.split == "train"))
    section = reconstruction_section(tiny_model, dataset, real, TINY, quiet)
    assert not section.tables and not section.goals and "no held-out clips" in section.notes[0]


def test_the_fastest_joint_is_found(real: RealMotion) -> None:
    motion = make_idle(60)
    rotations = motion.local_rotations.copy()
    rotations[30, 4] = np.array([math.cos(0.5), math.sin(0.5), 0.0, 0.0], np.float32)
    speed, joint = fastest_turn(body_of(Motion(motion.skeleton, rotations, motion.root_positions, 60.0)))
    assert joint == "LeftToeBase" and speed == pytest.approx(math.degrees(1.0) * 60.0, rel=0.05)
    limit, largest = recorded_limit(real)
    assert 0.0 < limit <= largest
