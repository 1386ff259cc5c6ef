"""Repairs of recorded clips that were damaged on purpose, one fault each."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import normalized
from motionkit.editing.fix import Fixed, Repairs, _limbs, _rig, fix_motion
from motionkit.errors import MotionkitError
from motionkit.export.formats import read_motion
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_angle, quat_multiply
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.built_in import rig_file
from motionkit.rig.names import map_rig
from motionkit.rig.on_rig import read_rig
from motionkit.rig.to_rig import to_rig
from motionkit.rig.upright import Upright
from synthetic_motions import make_walk

pytestmark = pytest.mark.thorough

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"
NONE = Repairs(glitches=False, trembling=False, floor=False, sliding=False)


@pytest.fixture(scope="module")
def clip() -> Motion:
    """A recorded walk in its own rig and unit, 120 fps."""
    return read_motion(DATA / "35_30.bvh")


def positions(motion: Motion) -> np.ndarray:
    """In cm, Y up."""
    return motion_kinematics(Upright.of(motion).motion)[1]


def row(fixed: Fixed, name: str) -> tuple[float, float]:
    """The values of a row of the table before and after."""
    (found,) = (row for row in fixed.table if name in row.name)
    assert found.before is not None and found.after is not None
    return found.before, found.after


def test_without_repairs_nothing_changes(clip: Motion) -> None:
    fixed = fix_motion(clip, NONE)
    assert np.abs(positions(fixed.motion) - positions(clip)).max() < 1e-3
    assert all(row.before == pytest.approx(row.after, rel=1e-3, abs=1e-3) for row in fixed.table)


def test_a_pop_is_bridged(clip: Motion) -> None:
    joint = clip.skeleton.names.index("LeftForeArm")
    rotations = clip.local_rotations.copy()
    rotations[100, joint] = quat_multiply(
        rotations[100, joint], expmap_to_quat(np.array([0.0, 1.2, 0.0], np.float32))
    )
    fixed = fix_motion(replace(clip, local_rotations=rotations), replace(NONE, glitches=True))
    assert (100, "LeftForeArm") in fixed.glitches
    before, after = row(fixed, "glitches")
    assert before > after == 0.0
    gaps = np.linalg.norm(positions(fixed.motion) - positions(clip), axis=-1)
    assert gaps.max() < 1.0


@pytest.mark.parametrize("frame", [0, -1])
def test_a_joint_that_leaps_at_an_end_is_held(clip: Motion, frame: int) -> None:
    rotations, joint = clip.local_rotations.copy(), clip.skeleton.names.index("LeftArm")
    away = expmap_to_quat(np.array([0.0, 0.0, 1.2], np.float32))
    rotations[frame, joint] = quat_multiply(away, rotations[frame, joint])
    fixed = fix_motion(replace(clip, local_rotations=rotations), replace(NONE, glitches=True))
    assert (frame % len(clip), "LeftArm") in fixed.glitches and row(fixed, "glitches") == (1, 0)
    near = clip.local_rotations[1 if frame == 0 else -2, joint]
    assert float(quat_angle(fixed.motion.local_rotations[frame, joint], near)) < 1e-3


def test_a_root_that_leaps_is_bridged(clip: Motion) -> None:
    """Spikes by a kilometre, and a lead-in elsewhere."""
    roots = clip.root_positions.copy()
    roots[:3] += 4000.0
    roots[50:53] -= 1e5
    fixed = fix_motion(replace(clip, root_positions=roots), replace(NONE, glitches=True))
    assert np.abs(positions(fixed.motion) - positions(clip)).max() < 30.0
    assert "the root leaps away in 6 frames: bridged" in fixed.notes
    again = fix_motion(fixed.motion, replace(NONE, glitches=True))
    assert np.abs(again.motion.root_positions - fixed.motion.root_positions).max() < 1e-3


@pytest.mark.parametrize("step", ["trembling", "sliding"])
def test_a_step_that_makes_it_worse_is_taken_back(
    clip: Motion, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """Both as far as they lower what they are for and as far as the body trembles after them."""
    arm = clip.skeleton.index("LeftArm")

    def shaken(motion: Motion) -> Motion:
        turns, noise = motion.local_rotations.copy(), np.random.default_rng(0).normal(size=(len(motion), 3))
        turns[:, arm] = quat_multiply(turns[:, arm], expmap_to_quat(0.05 * noise.astype(np.float32)))
        return replace(motion, local_rotations=turns)

    monkeypatch.setattr("motionkit.editing.fix._steadied", lambda motion, strength: shaken(motion))
    monkeypatch.setattr("motionkit.editing.fix._on_the_floor", lambda made, *_: (shaken(made.motion), ()))
    fixed = fix_motion(clip, replace(NONE, **{step: True}))
    assert np.abs(positions(fixed.motion) - positions(clip)).max() < 1e-3
    assert fixed.notes[0].startswith(f"{step}: taken back, because it made it worse (trembling (jerk) ")


def test_feet_that_are_held_stand_still_in_the_table(clip: Motion) -> None:
    """Not so by the share of low toes that are fast, which counts landings."""
    fixed = fix_motion(clip, replace(NONE, sliding=True))
    before, after = row(fixed, "speed of standing toes")
    assert before > 2.0 and after < 0.2 * before
    assert not fixed.notes


def test_trembling_is_filtered(clip: Motion) -> None:
    noise = 0.01 * np.random.default_rng(0).standard_normal((*clip.local_rotations.shape[:2], 3))
    shaken = quat_multiply(clip.local_rotations, expmap_to_quat(noise.astype(np.float32)))
    fixed = fix_motion(replace(clip, local_rotations=shaken), replace(NONE, trembling=True))
    before, after = row(fixed, "jerk")
    assert after < before / 3
    calm = fix_motion(clip, replace(NONE, trembling=True)).motion
    assert np.abs(positions(calm) - positions(clip)).max() < 3.0


def test_what_is_worse_in_the_end_is_said() -> None:
    """A wide filter moves the feet of a whole clip, a little in each pass."""
    clip = bvh_to_motion(read_bvh(Path(__file__).parents[2] / "examples/data/16_26.bvh"))
    fixed = fix_motion(clip, Repairs(strength=2.0))
    before, after = row(fixed, "sliding")
    assert after > 1.05 * before + 0.02
    (note,) = (note for note in fixed.notes if "is worse than before" in note)
    assert note.startswith(f"foot sliding (AFS) is worse than before ({before:.3g} to {after:.3g})")
    assert not any("is worse than before" in note for note in fix_motion(clip).notes)


def test_the_floor_comes_to_zero(clip: Motion) -> None:
    high = replace(clip, root_positions=clip.root_positions + np.array([0.0, 5.0, 0.0], np.float32))
    fixed = fix_motion(high, replace(NONE, floor=True))
    before, after = row(fixed, "height of standing feet")
    assert before > 20.0 and 2.0 < after < 6.0
    moved = positions(fixed.motion) - positions(high)
    assert np.ptp(moved[..., 1]) < 1e-2 and np.abs(moved[..., [0, 2]]).max() < 1e-2


@pytest.mark.parametrize("floor", [True, False])
def test_feet_are_held_on_the_rig_itself(clip: Motion, floor: bool) -> None:
    """A walk whose root drifts forward, so that standing feet slide."""
    drift = np.linspace(0.0, 4.0, len(clip), dtype=np.float32)[:, None] * np.array(
        [0.0, 0.0, 1.0], np.float32
    )
    slid = replace(clip, root_positions=clip.root_positions + drift)
    fixed = fix_motion(slid, replace(NONE, sliding=True, floor=floor))
    before, after = row(fixed, "AFS")
    assert after < 0.9 * before
    offsets = fixed.motion.skeleton.offsets
    assert (
        np.array_equal(offsets, clip.skeleton.offsets) and fixed.motion.skeleton.names == clip.skeleton.names
    )
    arms = clip.skeleton.names.index("LeftArm")
    assert np.abs(fixed.motion.local_rotations[:, arms] - clip.local_rotations[:, arms]).max() < 1e-5
    # The feet are the canonical ones: where they were held there, the rig's own ankles and toes are.
    for name in ("LeftFoot", "RightToeBase"):
        own = positions(fixed.motion)[:, clip.skeleton.names.index(name)]
        canonical = Upright.of(fixed.motion).canonical
        assert canonical is not None
        there = motion_kinematics(canonical)[1][:, canonical.skeleton.names.index(name)]
        assert np.linalg.norm(own - there, axis=-1).max() < 1.5


@pytest.mark.parametrize(("off", "moves"), [(5.0, False), (60.0, True)])
def test_the_floor_of_a_rig_without_toes_is_moved_only_if_it_is_far_off(off: float, moves: bool) -> None:
    walk = make_walk(120)
    toes = [j for j, name in enumerate(walk.skeleton.names) if "Toe" in name]
    keep = [j for j in range(len(walk.skeleton)) if j not in toes]
    new = {joint: number for number, joint in enumerate(keep)}
    skeleton = Skeleton(
        tuple(walk.skeleton.names[j] for j in keep),
        tuple(new.get(walk.skeleton.parents[j], -1) for j in keep),
        walk.skeleton.offsets[keep],
    )
    up = np.array([0.0, off, 0.0], np.float32)
    toeless = Motion(skeleton, walk.local_rotations[:, keep], walk.root_positions + up, walk.fps)
    fixed = fix_motion(toeless, replace(NONE, floor=True))
    moved = float((fixed.motion.root_positions - toeless.root_positions)[:, 1].mean())
    assert (abs(moved) > 0.5 * off) == moves and any("no toes" in note for note in fixed.notes) != moves


def test_a_rig_without_bones_is_refused(clip: Motion) -> None:
    point = replace(clip.skeleton, offsets=np.zeros_like(clip.skeleton.offsets))
    with pytest.raises(MotionkitError, match="zero length"):
        fix_motion(replace(clip, skeleton=point))


def test_rigs_that_are_not_human_keep_their_floor(make_motion: Callable[..., Motion]) -> None:
    offsets = np.array([[0, 0, 0], [0, 60, 0], [0, 80, 10]], np.float32)
    crane = make_motion(60, skeleton=Skeleton(("Base", "Boom", "Hook"), (-1, 0, 1), offsets))
    fixed = fix_motion(crane)
    assert any("not a known human" in note for note in fixed.notes)
    assert np.abs(positions(fixed.motion) - positions(crane)).max() < 1.0


@pytest.mark.parametrize("below", [None, "LeftHand", "RightForeArm", "LeftLeg", "RightFoot"])
def test_a_limb_is_three_joints_that_directly_follow_each_other(below: str | None) -> None:
    walk = make_walk(2)
    skeleton, turns = walk.skeleton, walk.local_rotations
    if below:
        joint = skeleton.names.index(below)
        parents = [parent + (parent >= joint) for parent in skeleton.parents]
        parents[joint : joint + 1] = [parents[joint], joint]
        names = (*skeleton.names[:joint], "Twist", *skeleton.names[joint:])
        skeleton = Skeleton(names, tuple(parents), np.insert(skeleton.offsets, joint, 0.0, axis=0))
        turns = np.insert(turns, joint, [1.0, 0.0, 0.0, 0.0], axis=1)
    motion = replace(walk, skeleton=skeleton, local_rotations=turns)
    ends = [skeleton.names[end] for _, _, end in _limbs(motion, _rig(motion))]
    wanted = ["LeftFoot", "LeftHand", "RightFoot", "RightHand"]
    limb = {"RightForeArm": "RightHand", "LeftLeg": "LeftFoot"}.get(str(below), below)
    assert ends == [end for end in wanted if end != limb]


def shaken(clip: Motion) -> Motion:
    turns = (
        np.random.default_rng(2).normal(0.0, 0.02, (*clip.local_rotations.shape[:2], 3)).astype(np.float32)
    )
    return replace(clip, local_rotations=quat_multiply(clip.local_rotations, expmap_to_quat(turns)))


def sunk(clip: Motion) -> Motion:
    return replace(clip, root_positions=clip.root_positions - np.array([0.0, 3.0, 0.0], np.float32))


def pinned(clip: Motion) -> Motion:
    return replace(clip, root_positions=np.broadcast_to(clip.root_positions[:1], (len(clip), 3)).copy())


@pytest.mark.parametrize("damage", [shaken, sunk, pinned, lambda clip: sunk(shaken(clip))])
def test_a_second_run_leaves_the_clip_as_it_is(damage: Callable[[Motion], Motion], clip: Motion) -> None:
    first = fix_motion(damage(clip))
    again = fix_motion(first.motion)
    ends = {"nothing to repair", "nothing was changed"}
    assert again.motion is first.motion and again.notes[-1] in ends
    assert not ends & {*first.notes} and not again.glitches


def test_clean_joints_keep_their_turns_beside_one_that_trembles() -> None:
    walk = make_walk(200)
    joint = walk.skeleton.names.index("LeftForeArm")
    turns = walk.local_rotations.copy()
    turns[:, joint] = shaken(walk).local_rotations[:, joint]
    mended = fix_motion(replace(walk, local_rotations=turns), replace(NONE, trembling=True)).motion
    off, left = (
        np.abs(each - walk.local_rotations).mean(axis=(0, 2)) for each in (turns, mended.local_rotations)
    )
    assert left[joint] < 0.6 * off[joint] and np.delete(left, joint).max() < 1e-4


def test_one_frame_is_refused(clip: Motion) -> None:
    with pytest.raises(MotionkitError, match="at least 2 frames"):
        fix_motion(clip.cut(0, 1))


def test_clips_too_short_to_measure_are_repaired(clip: Motion, make_motion: Callable[..., Motion]) -> None:
    offsets = np.array([[0, 0, 0], [0, 60, 0], [0, 80, 10]], np.float32)
    crane = make_motion(3, skeleton=Skeleton(("Base", "Boom", "Hook"), (-1, 0, 1), offsets))
    for short in (crane, clip.cut(0, 3), clip.cut(0, 2)):
        fixed = fix_motion(short)
        assert len(fixed.motion) == len(short)
        (jerk,) = (row for row in fixed.table if "jerk" in row.name)
        assert jerk.before is None and jerk.after is None


def test_the_command(motionkit, tmp_path: Path) -> None:
    source = DATA / "35_30.bvh"
    said = motionkit("fix", source, "--no-trembling", "--view", "-o", "a.bvh")
    assert said.code == 0 and "foot sliding (AFS)" in said.out and (tmp_path / "a.html").is_file()
    before, after = read_bvh(source), read_bvh(tmp_path / "a.bvh")
    assert before.channels == after.channels and before.skeleton.names == after.skeleton.names
    assert len(before.values) == len(after.values) and before.fps == after.fps
    value = json.loads(motionkit("fix", source, "--json").out)
    assert value["output"] == "35_30-fixed.bvh"
    assert {"name", "before", "after", "unit"} == set(value["table"][0])
    assert motionkit("fix", "none.bvh").failed_with("none.bvh: no such file")


@pytest.mark.parametrize("name", ["@mixamo", "@unreal", "@cmu"])
def test_a_foot_that_is_rolled_over_turns_back(name: str) -> None:
    walk = to_rig(make_walk(120), read_rig(rig_file(name)))
    places = map_rig(walk.skeleton).places
    ankle, toe = places["LeftFoot"], places["LeftToeBase"]
    turns = walk.local_rotations.astype(np.float64)
    half_turn = np.concatenate([[0.0], normalized(walk.skeleton.offsets[toe].astype(np.float64))])
    turns[50:, ankle] = quat_multiply(turns[50:, ankle], half_turn)
    fixed = fix_motion(
        replace(walk, local_rotations=turns), Repairs(trembling=False, floor=False, sliding=False)
    )
    assert [row.after for row in fixed.table if row.name == "glitches"] == [0]
    assert {frame for frame, joint in fixed.glitches if joint == walk.skeleton.names[ankle]} >= set(
        range(50, 120)
    )
    away = quat_angle(fixed.motion.local_rotations[:, ankle], walk.local_rotations[:, ankle])
    assert np.degrees(away).max() < 1.0
