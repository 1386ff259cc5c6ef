"""Joined clips: one goes on where the other ends, feet stand, and all else stays as it was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.editing.join import MOST_APART, join_motions
from motionkit.editing.root_motion import with_ground_root
from motionkit.errors import MotionkitError
from motionkit.export.formats import read_clip, read_motion, write_motion
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_continuous
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.rig.up_axis import turned_world, up_turn
from motionkit.rig.upright import Upright
from synthetic_motions import make_cartwheel, make_steps, make_walk, placed
from synthetic_rigs import FAMILIES, renamed

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"
BLEND = 30  # frames at 60 fps


def places(motion: Motion) -> np.ndarray:
    return Upright.of(motion).positions.astype(np.float64)


@pytest.mark.parametrize("yaw", [0.0, 2.5])
def test_a_clip_goes_on_where_and_how_the_one_before_it_ends(yaw: float) -> None:
    first, second = make_steps(150, turn=0.1), make_steps(150, turn=0.1, phase=1.0)
    joined = join_motions([first, placed(second, yaw, (400.0, -50.0))])
    seam = joined.seams[0]
    steps = np.linalg.norm(np.diff(places(joined.motion), axis=0), axis=-1)
    own = np.linalg.norm(np.diff(places(first), axis=0), axis=-1)
    assert seam.apart < 1.0 and steps.max() < 1.05 * own.max()
    bends, of_first = (
        np.linalg.norm(np.diff(places(each), n=2, axis=0), axis=-1).max() for each in (joined.motion, first)
    )
    assert bends < 1.1 * of_first
    assert seam.sliding is not None and seam.sliding[1] < 2.0
    assert len(joined.motion) == seam.frame + len(second) - 1 - round(seam.enter * 60)
    still = seam.frame - 40
    assert np.array_equal(joined.motion.local_rotations[:still], first.local_rotations[:still])
    after = round(seam.enter * 60) + 1 + 2 * BLEND + 20
    end = joined.motion.cut(len(joined.motion) - len(second) + after, len(joined.motion))
    same = np.abs((end.local_rotations[:, 1:] * second.local_rotations[after:, 1:]).sum(-1))
    assert same.min() > 1 - 1e-5


def test_a_join_costs_what_its_clips_do_however_many_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at = list[int]()

    def looking(rotations: np.ndarray) -> np.ndarray:
        looked_at.append(len(rotations))
        return quat_continuous(rotations)

    monkeypatch.setattr("motionkit.editing.join.quat_continuous", looking)
    joined = join_motions([make_walk(60)] * 9, at=[(0.9, 0.1)] * 8)
    assert sum(looked_at) < 1.2 * len(joined.motion) and len(joined.motion) > 350
    assert np.array_equal(joined.motion.local_rotations, quat_continuous(joined.motion.local_rotations))


def test_recorded_feet_are_held_at_the_joins() -> None:
    clips = [read_motion(DATA / f"{name}.bvh").cut(0, 360) for name in ("16_26", "35_01", "16_45")]
    joined = join_motions(clips)
    assert len(joined.seams) == 2 and joined.motion.skeleton is clips[0].skeleton
    for seam in joined.seams:
        assert seam.sliding is not None and seam.sliding[1] <= seam.sliding[0] + 0.1 and seam.apart < 15


@pytest.mark.parametrize("other", ["up", "unit", "rate", "rig", "root bone", "frames that move"])
def test_other_rigs_and_units_go_on_the_first_one(other: str) -> None:
    first, second = make_walk(150), make_walk(150, phase=1.0)
    at = [(2.0, 0.5)]
    wanted = join_motions([first, second], at=at)
    change = {
        "up": lambda m: turned_world(m, up_turn(np.array([0, 0, -1.0], np.float32))),
        "unit": lambda m: m.scaled(0.01),
        "rate": lambda m: resample(m, 120.0),
        "rig": lambda m: renamed(m, FAMILIES["mixamo"]),
        "root bone": with_ground_root,
        "frames that move": lambda m: replace(
            m, local_positions=np.repeat(m.skeleton.offsets[None], len(m), axis=0)
        ),
    }[other]
    joined = join_motions([first, change(second)], at=at)
    made = joined.motion
    assert made.skeleton.names == JOINT_NAMES and made.fps == 60 and len(made) == len(wanted.motion)
    apart = np.linalg.norm(places(made) - places(wanted.motion), axis=-1)
    assert apart.max() < (4.0 if other in ("rig", "root bone") else 0.1)
    assert not np.isnan(motion_kinematics(made)[1]).any()


@pytest.mark.parametrize("at", [None, [(2.0, 0.5)]])
def test_a_clip_that_is_no_human_is_joined_by_the_joints_of_the_rig(
    monkeypatch: pytest.MonkeyPatch, at: list[tuple[float, float]] | None
) -> None:
    """As a clip of a human rig may be whose feet point backwards at its rate."""
    read = Upright.canonical.func  # type: ignore[attr-defined]
    monkeypatch.setattr(
        Upright, "canonical", property(lambda self: read(self) if len(self.motion) > 100 else None)
    )
    joined = join_motions([make_walk(150), make_walk(90)], at=at)
    assert joined.motion.skeleton.names == JOINT_NAMES and not np.isnan(places(joined.motion)).any()


@pytest.mark.parametrize("rig", [with_ground_root, lambda motion: renamed(motion, FAMILIES["mixamo"])])
def test_the_joint_that_is_furthest_apart_has_the_same_name_on_every_rig(rig) -> None:
    clips = make_walk(150), make_walk(150, phase=1.0)
    wanted, found = (
        join_motions([to(each) for each in clips], at=[(1.9, 0.4)]).seams[0].farthest
        for to in (lambda motion: motion, rig)
    )
    assert found == (wanted[0], pytest.approx(wanted[1], abs=0.5))


def test_told_times_are_taken_whatever_the_poses() -> None:
    first, second = make_walk(150), make_cartwheel(180)
    joined = join_motions([first, second], at=[(2.0, 1.5)])
    assert joined.seams[0].leave == 2.0 and joined.seams[0].enter == 1.5 and joined.seams[0].frame == 121
    assert joined.seams[0].apart > MOST_APART


@pytest.mark.parametrize(
    ("clips", "how", "words"),
    [
        (1, {}, "at least 2 clips"),
        (2, {"window": 9.0}, "expected at least the window of 9 s"),
        (2, {"at": [(99.0, 0.0)]}, "asked to join at 99 s"),
        (2, {"at": [(0.5, 0.97)]}, r"asked to join at 0\.97 s, expected 0\.00 to 0\.95 s"),
        (2, {"at": [(1.0, 0.0), (1.0, 0.0)]}, "2 clips have 1 joins"),
        ("different", {}, "too different to join: "),
        ("short", {}, "expected at least 4 frames"),
    ],
)
def test_what_cannot_be_joined_is_said(clips: object, how: dict, words: str) -> None:
    walk = make_walk(60)
    second = {"different": make_cartwheel(180).cut(80, 100), "short": walk.cut(0, 3)}.get(str(clips), walk)
    with pytest.raises(MotionkitError, match=words):
        join_motions([walk, second][: clips if isinstance(clips, int) else 2], **how)


def test_the_command_says_where_it_joined(motionkit, tmp_path: Path) -> None:
    for name in "ab":
        write_motion(tmp_path / f"{name}.bvh", make_walk(120, phase=float(name == "b")))
    said = motionkit(
        "join", "a.bvh", "b.bvh", "a.bvh", "-o", "out.glb", "--at", "100f:0.2", "--at", "1.5:10f"
    )
    assert said.code == 0 and "a.bvh to 1.67 s, b.bvh from 0.20 s: poses " in said.out
    seams = json.loads(motionkit("join", "a.bvh", "b.bvh", "--json").out)["seams"]
    assert len(seams) == 1 and seams[0]["sliding_held_cm_s"] <= seams[0]["sliding_cm_s"] + 0.1
    assert motionkit("join", "a.bvh").failed_with("at least 2 clips")
    assert motionkit("join", "a.bvh", "b.bvh", "--at", "1", "--at", "2").code == 2
    # Of a character two animations are joined, and a third is added to it.
    said = motionkit("join", "out.glb", "out.glb", "--clip", "a-joined", "-o", "two.glb")
    assert said.code == 0 and read_clip(tmp_path / "two.glb", "a-joined-joined").motion.seconds > 3
    assert read_clip(tmp_path / "two.glb", "a-joined").motion.seconds < 6


def test_a_folder_stands_for_its_clips_in_the_order_of_their_names(motionkit, tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    (tmp_path / "none").mkdir()
    for name in ("b", "clips/2", "clips/1"):
        write_motion(tmp_path / f"{name}.bvh", make_walk(120))
    said = motionkit("join", "clips", "b.bvh")
    assert said.code == 0 and "wrote clips-joined.bvh" in said.out
    assert said.out.index("1.bvh to") < said.out.index("2.bvh to") < said.out.index("b.bvh from")
    assert motionkit("join", "none", "b.bvh").failed_with("none: no .bvh")
