"""The sections of the scoreboard, measured on a model that hardly moves."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from motionkit.control.drive import Driver, Wish
from motionkit.control.path import shape_path
from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError
from motionkit.features.encode import identity_reference_rotations
from motionkit.features.layout import feature_layout
from motionkit.features.reference import REFERENCE_OFFSETS
from motionkit.lab.held_out import in_references
from motionkit.lab.scoreboard.board import evaluate
from motionkit.lab.scoreboard.classes import classes_section
from motionkit.lab.scoreboard.limits import acceleration_limit, turn_limit
from motionkit.lab.scoreboard.paths import leaning, path_trials, paths_section, speed_trials, steered_types
from motionkit.lab.scoreboard.reconstruction import held_out_clips, reconstruction_section
from motionkit.lab.scoreboard.response import commands, response_seconds
from motionkit.lab.scoreboard.stability import (
    DRIFT_LIMIT,
    foot_height,
    frozen_seconds,
    height_drift,
    random_plan,
    stability_section,
)
from motionkit.lab.scoreboard.trial import Trial
from motionkit.lab.scoreboard.variety import DRAWN, variety_section
from motionkit.lab.scoreboard.visible import visible_section
from motionkit.metrics.body import body_of
from motionkit.metrics.leaps import fastest_turn
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import ReferenceClip
from motionkit.motion.motion import Motion
from motionkit.training.verdict.real import RealMotion
from motionkit.training.verdict.rolling import Driven
from synthetic_motions import make_idle, make_walk

from .conftest import TINY

pytestmark = pytest.mark.thorough


def quiet(share: float) -> None:
    """Ignore progress."""


def test_paths_are_as_long_as_they_say() -> None:
    trials = {
        trial.name: trial.path
        for trial in path_trials("walking", "running", "wheel", ("jumping-l", "jumping-r"))
    }
    assert trials["circle r = 3 m, walking"].length == pytest.approx(2 * math.pi * 300.0, rel=0.01)
    assert trials["circle r = 6 m, running"].length == pytest.approx(2 * math.pi * 600.0, rel=0.01)
    corner = trials["pentagram corner (144°), running"]
    cosine = float((corner.tangents[10] * corner.tangents[-10]).sum())
    assert math.degrees(math.acos(cosine)) == pytest.approx(144.0, abs=1.0)
    zigzag = trials["zigzag (135°), running"]
    assert zigzag.length == pytest.approx(2000.0, abs=3.0)
    assert float(zigzag.tangents[10] @ zigzag.tangents[300]) == pytest.approx(
        math.cos(math.radians(135.0)), abs=0.01
    )
    mixed = next(path for name, path in trials.items() if name.startswith("jumping-r"))
    assert [part.type for part in mixed.parts][:3] == ["jumping-r", "jumping-l", "running"]
    assert "running → wheel → running" in trials
    names = [trial.name for trial in path_trials("Gehen", "Gehen", None, ("Hops",))]
    assert names[-1] == "Hops → Gehen → Hops" and not any("None" in name for name in names)


def test_every_path_of_known_types_is_measured(make_trial, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = path_trials("walking", "running", "cartwheel")
    wanted = [trial for trial in usual if trial.name.startswith(("line", "running"))]
    asked = [t for t in speed_trials("walking", "running", "idle") if "0.7" in t.name or "→" in t.name]
    monkeypatch.setattr("motionkit.lab.scoreboard.paths.path_trials", lambda *kinds: wanted)
    monkeypatch.setattr("motionkit.lab.scoreboard.paths.speed_trials", lambda *kinds: asked)
    monkeypatch.setattr("motionkit.control.follow.PATIENCE", -0.2)  # leaves less than 3 s
    section = paths_section(make_trial(), quiet)
    first, second = section.tables
    assert [row[0] for row in first.rows] == [trial.name for trial in wanted]
    for row, goal in zip(first.rows, section.goals, strict=False):
        _, mean, largest, _, finished, *_ = row
        assert goal.value == mean and 0.0 < mean <= largest  # the model hardly moves, but not along the path
        assert finished == "0 of 1" and goal.note == "finished 0 of 1"
    end = next(goal for goal in section.goals if "to the end" in goal.what)
    assert end.value == 0.0 and not end.reached
    assert [row[0] for row in second.rows] == [trial.name for trial in asked]
    off = next(goal for goal in section.goals if "speed off by" in goal.what)
    assert off.value is not None and not off.reached  # it hardly moves


def test_motion_matching_plays_recorded_frames_where_they_are_asked_for(make_trial) -> None:
    matched = make_trial().matched
    assert matched.knows("walking") and not matched.knows("walking", "unknown")

    def steer(frame: int, driver: Driver) -> None:
        driver.set_wish(Wish((0.0, 100.0)))

    for body in (
        matched.along(shape_path("line", 2.0, ["walking"], None)),
        matched.live(Driven("walking", steer), 60),
    ):
        library = matched.matching.library
        recorded = library.features[:, library.poses][:, 1:].reshape(-1, 22, 3)[:, 9:, 1]
        apart = np.abs(recorded - body.positions[len(body) // 2, 10:, 1])
        assert (
            len(body) > 30 and apart.max(axis=1).min() < 0.5
        )  # cm; trunk and arms, which locked feet leave alone
        assert body.positions[-1, 0, 2] > body.positions[0, 0, 2] + 20.0


def test_gaits_to_follow_paths_with_need_no_names(tiny_model: MotionModel) -> None:
    assert steered_types(tiny_model) in (None, ("walking", "running"), ("walking", "walking"))
    gait = tiny_model.types["walking"].gait
    assert gait is not None
    slow, fast = replace(gait, speed=90.0, facing=0.0), replace(gait, speed=320.0, facing=0.0)
    base = replace(tiny_model.types["walking"], steered=True)
    own = replace(
        tiny_model,
        types={
            "stroll": replace(base, gait=slow),
            "sprint": replace(base, gait=fast),
            "kick": replace(base, steered=False),
        },
    )
    assert steered_types(own) == ("stroll", "sprint")
    assert steered_types(replace(own, types={"kick": own.types["kick"]})) is None


def test_speed_trials_ask_for_their_speeds() -> None:
    for trial in speed_trials("walking", "running", "idle"):
        asked = [part.speed for part in trial.path.parts][: len(trial.speeds)]
        assert asked == pytest.approx([speed * 100.0 for speed in trial.speeds]), trial.name
        assert sum(part.stop for part in trial.path.parts) == trial.stop_seconds, trial.name


def test_a_body_that_leans_into_a_curve_is_seen() -> None:
    upright = make_walk(240, turn=0.8, speed=200.0)
    lean, needed = leaning(body_of(upright))
    assert abs(lean) < 4.0 and needed == pytest.approx(math.degrees(math.atan2(0.8 * 2.0, 9.81)), abs=0.5)
    assert leaning(body_of(make_walk(240, turn=0.0))) == (0.0, 0.0)
    body = body_of(upright)
    sine, cosine = np.sin(body.heading), np.cos(body.heading)  # the curve goes to the left, +X at heading 0
    left = np.stack([cosine, np.zeros_like(sine), -sine], axis=-1)[:, None]
    above = body.positions[..., 1:2] * math.tan(math.radians(10.0))
    tilted = replace(body, positions=(body.positions + left * above).astype(np.float32))
    assert leaning(tilted)[0] == pytest.approx(lean + 10.0, abs=2.0)


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


def test_stability_measures_every_type_and_random_changes(make_trial, tiny_model: MotionModel) -> None:
    section = stability_section(make_trial(), quiet)
    assert [table.title.rpartition(": ")[2] for table in section.tables[1:]] == ["raw", "without references"]
    rows, columns = section.tables[0].rows, section.tables[0].columns
    heights = [row[columns.index("foot height − real, cm")] for row in rows]
    assert None not in heights[:-1]
    assert [row[0] for row in rows] == [*tiny_model.types, "random type changes"]
    drifts = [row[columns.index("foot height drift, cm")] for row in rows[:-1]]
    goal = next(goal for goal in section.goals if "foot height drift" in goal.what)
    assert goal.value == np.mean([abs(drift) <= DRIFT_LIMIT for drift in drifts])
    assert [goal.value for goal in section.goals if "finite" in goal.what] == [1.0]


def test_types_of_one_recording_have_no_distance(make_trial, monkeypatch: pytest.MonkeyPatch) -> None:
    """No pose of another recording is there to measure it from: the cell stays empty, without a warning."""
    monkeypatch.setattr(
        "motionkit.lab.scoreboard.stability.real_measures", lambda real, kind: (float("nan"), 500.0)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = stability_section(make_trial(), quiet).tables[0]
    cells = [(row["pose distance / real"], row["jerk / real"]) for row in table.as_dict()["rows"]]
    assert all(distance is None and jerk > 0.0 for distance, jerk in cells)


def test_reconstruction_scores_ground_truth_baselines_and_model(
    make_trial, tiny_model: MotionModel, dataset: Dataset
) -> None:
    section = reconstruction_section(make_trial(), quiet)
    rows = {(row[0], row[1]): row[2:] for row in section.tables[0].rows}
    truth, still = rows["all", "ground truth"], rows["all", "last frame"]
    # Equal to itself: SSIM 1, no joint error, no distance from its path.
    assert truth[3:] == (1.0, 1.0, 0.0, 0.0)
    assert still[0] == pytest.approx(0.0, abs=1e-3) and truth[0] > 1.0
    late, later = rows["all", "3 frames late"], rows["all", "20 frames late"]
    assert 1.0 > late[4] > later[4] and 0.0 < late[5] < later[5]
    for variant in ("nearest clip", "model", "raw network", "without references"):
        assert rows["all", variant][5] > 0.0 and rows["all", variant][6] > 0.0
    against = {goal.what: goal for goal in section.goals if "nearest clip" in goal.what}
    mpjpe = against["mpjpe against the nearest clip"]
    assert mpjpe.highest == rows["all", "nearest clip"][5] and mpjpe.value == rows["all", "model"][5]
    assert against["ssim-window against the nearest clip"].lowest == rows["all", "nearest clip"][4]
    assert len(held_out_clips(tiny_model, dataset, 0.6)) == 1


def test_held_out_recordings_among_the_references_are_named(
    make_trial, dataset: Dataset, tiny_model: MotionModel
) -> None:
    """A network that is shown where its own recording goes continues it too well."""
    clip = replace(dataset.select("test")[0], mirrored=True)
    data = dataset.read(clip)
    kind = dataset.types[int(data.types[0])]
    poses = dataset.pose_embedding.of(data.features)
    shown = ReferenceClip(poses, data.ground[: -REFERENCE_OFFSETS[-1]], data.phases[: -REFERENCE_OFFSETS[-1]])
    types = {name: replace(each, reference_clips=()) for name, each in tiny_model.types.items()}
    assert in_references(replace(tiny_model, types=types), dataset, dataset.select("test")) == []
    model = replace(tiny_model, types=types | {kind: replace(types[kind], reference_clips=(shown,))})
    assert in_references(model, dataset, dataset.select("test")) == [clip.name]
    section = reconstruction_section(replace(make_trial(), model=model), quiet)
    assert section.notes[0].endswith(f"as references: {clip.name}")


def test_reconstruction_without_clips_says_why(
    make_trial, dataset: Dataset, tiny_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def note() -> str:
        section = reconstruction_section(make_trial(), quiet)
        assert not section.tables and not section.goals
        return section.notes[0]

    held_out = [clip for clip in dataset.clips if clip.split == "test"]
    for module in ("held_out", "scoreboard.reconstruction"):
        monkeypatch.setattr(f"motionkit.lab.{module}.LEAST_REST", 10_000)
    assert "none of the 1 test clips has 10087 frames" in note()
    monkeypatch.undo()
    kinds = {name: kind for name, kind in tiny_model.types.items() if name != "walking"}
    few = Trial(replace(tiny_model, types=kinds), dataset, make_trial().judge, TINY)
    assert "types that the model does not have: walking" in reconstruction_section(few, quiet).notes[0]
    assert (
        held_out
        and "has no validation clips"
        in (reconstruction_section(make_trial(replace(TINY, split="validation")), quiet).notes[0])
    )


def test_visible_faults_are_found_in_the_default_output(make_trial, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = make_trial()
    takes = trial.alone(quiet)
    assert trial.alone(quiet) is takes, "roll-outs are made once"
    clean = visible_section(trial, quiet)
    goals = {goal.what: goal for goal in clean.goals}
    assert goals["roll-outs whose body flips in one frame"].value == 0.0
    columns = clean.tables[0].columns
    before = {row[0]: row for row in clean.tables[0].rows}["walking"]
    takes["walking"][0].default.positions[30:, 2] += np.array([0.0, 0.0, 25.0], np.float32)
    turned = takes["running"][1].default.rotations
    turned[40:, 0] = turned[40:, 0][:, [2, 3, 0, 1]]  # by half a turn
    broken = visible_section(trial, quiet)
    goals = {goal.what: goal for goal in broken.goals}
    assert goals["roll-outs whose body flips in one frame"].value == 1.0
    rate = columns.index("leaps a minute")
    assert not goals["leaps of knees and elbows a minute, worst type"].reached
    rows = {row[0]: row for row in broken.tables[0].rows}
    assert rows["walking"][rate] == pytest.approx(before[rate] + 1 / (2 * 1.3 / 60.0), rel=0.01)
    assert rows["walking"][columns.index("raw")] == before[columns.index("raw")]
    assert rows["running"][columns.index("flipped")] == 1


def test_variety_finds_seeds_that_do_the_same(make_trial, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a model with one start pose a type and without references, whose seeds differ by noise alone."""
    monkeypatch.setattr("motionkit.lab.scoreboard.variety.LONG_SECONDS", 0.6)
    trial = make_trial()
    same_start = {name: {"start_poses": kind.start_poses[:1]} for name, kind in trial.model.types.items()}
    trial.model = replace(trial.model.with_types(same_start), uses_references=False)
    section = variety_section(trial, quiet)
    columns, rows = section.tables[0].columns, {row[0]: row for row in section.tables[0].rows}
    apart = columns.index("seeds apart, cm")
    assert 0.0 < rows["walking"][apart] < 0.5 * rows["walking"][columns.index("recordings apart, cm")]
    goal = next(goal for goal in section.goals if "times as far apart" in goal.what)
    assert not goal.reached and "walking" in goal.note
    assert rows["cartwheel"][columns.index("recordings to the nearest other, cm")] is None, (
        "it has one recording"
    )
    learnt, of_all = columns.index("training recordings drawn on"), columns.index("of all")
    assert all(0.0 < row[learnt] <= 1.0 and 0.0 < row[of_all] <= 1.0 for row in rows.values())
    assert rows["running"][learnt] == rows["running"][of_all], "none is held out"
    goal = next(goal for goal in section.goals if "of the training recordings" in goal.what)
    reached = [row[learnt] >= DRAWN for row in rows.values()]
    assert goal.value == pytest.approx(sum(reached) / len(reached))


def test_the_fastest_joint_is_found(real: RealMotion) -> None:
    motion = make_idle(60)
    rotations = motion.local_rotations.copy()
    rotations[30, 4] = np.array([math.cos(0.5), math.sin(0.5), 0.0, 0.0], np.float32)
    turn = fastest_turn(rotations)
    assert turn.parameters["joint"] == "LeftToeBase"
    assert turn.value == pytest.approx(math.degrees(1.0) * 60.0, rel=0.05)
    limit, stands = turn_limit(real, real.types), turn_limit(real, {"idle"})
    assert limit is not None and stands is not None and 0.0 < stands < limit
    assert turn_limit(real, {"unheard-of"}) is None


def test_the_limit_of_acceleration_is_that_of_the_types(real: RealMotion) -> None:
    walking, everything = acceleration_limit(real, {"walking"}), acceleration_limit(real, real.types)
    assert walking is not None and everything is not None and 0.0 < walking <= everything * 1.001
    assert acceleration_limit(real, {"unheard-of"}) is None


def test_types_are_judged_only_on_request(
    tiny_model: MotionModel, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.training.verdict.types.WALK_RADIUS", 0.5)
    monkeypatch.setattr("motionkit.training.verdict.types.RUN_RADIUS", 1.0)
    settings = replace(TINY, seeds=1, repeats=1, accuracy_seconds=2.0)
    board = evaluate(dataset, model=tiny_model, settings=settings, only=["types"])
    (section,) = board.sections
    assert section.name == "types" and len(section.goals) == len(section.tables[0].rows)


def test_a_dataset_that_is_encoded_otherwise_is_refused(tiny_model: MotionModel, dataset: Dataset) -> None:
    other = dataset.copy()
    other.layout = feature_layout("expmap-root-1")
    with pytest.raises(DatasetError, match="layout expmap-root-1, but the model needs sixd-root-1"):
        evaluate(other, model=tiny_model, settings=TINY, only=["types"])
    other = dataset.copy()
    other.reference_rotations = identity_reference_rotations()
    with pytest.raises(
        DatasetError, match="reference rotations differ from the model's; preprocess it again"
    ):
        evaluate(other, model=tiny_model, settings=TINY, only=["types"])


def test_the_section_has_a_row_for_each_type(make_trial) -> None:
    trial = make_trial()
    section = classes_section(trial, lambda share: None)
    rows = section.tables[0].rows
    assert [row[0] for row in rows] == ["all", *trial.recorded_types]
    assert all(0.0 <= row[1] <= 1.0 for row in rows if row[1] is not None)
    assert rows[0][3] > 0.0  # the tiny model does not move as the recordings do
