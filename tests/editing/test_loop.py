"""Cycles of made and recorded motion: found, closed, and refused where there is none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.editing.loop import Loop, _refined, make_loop, seam
from motionkit.editing.root_motion import in_place
from motionkit.errors import MotionkitError
from motionkit.export.formats import read_motion, write_motion
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_angle, quat_from_yaw, quat_multiply, quat_rotate, rotate_ground
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.upright import Upright
from synthetic_motions import make_walk

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"


def turned(motion: Motion, yaw: float) -> Motion:
    """The motion turned about the vertical as a whole."""
    turn = quat_from_yaw(np.full(len(motion), yaw, np.float32))
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    return replace(motion, local_rotations=rotations, root_positions=quat_rotate(turn, motion.root_positions))


def joined(first: Motion, second: Motion) -> Motion:
    """One motion after the other, which begins where the first ends."""
    move = first.root_positions[-1] - second.root_positions[0]
    move[1] = 0.0
    return replace(
        first,
        local_rotations=np.concatenate([first.local_rotations, second.local_rotations]),
        root_positions=np.concatenate([first.root_positions, second.root_positions + move]),
    )


def test_a_walk_loops_after_one_cycle() -> None:
    walk = make_walk(300, turn=0.1)
    loop = make_loop(walk)
    assert loop.difference < 0.5
    # The same cycle from anywhere: its length does not depend on heading or place.
    other = make_loop(turned(walk, 2.0))
    assert other.end - other.start == loop.end - loop.start == 60
    again = make_loop(walk, seconds=2.0 * (len(loop.motion) - 1) / 60)
    assert abs(len(again.motion) - 1 - 2 * (len(loop.motion) - 1)) <= 2


@pytest.mark.parametrize("name", ["06_06", "16_26", "16_45", "35_01", "35_30"])
def test_recorded_gaits_close_without_a_seam(name: str) -> None:
    clip = read_motion(DATA / f"{name}.bvh")
    loop = make_loop(clip)
    assert 0.5 < (len(loop.motion) - 1) / 120 < 1.6
    seam = loop.seam
    assert seam.distance < 0.01 and seam.speed <= seam.frame_speed / 2
    assert loop.motion.skeleton.same_hierarchy(clip.skeleton)
    first, last = loop.motion.local_rotations[0], loop.motion.local_rotations[-1]
    assert float(quat_angle(first, last).max()) < 1e-3
    assert loop.motion.root_positions[0, 1] == pytest.approx(loop.motion.root_positions[-1, 1])
    # What was changed is small: half of what the ends differed by, at most.
    before = Upright.of(clip.cut(loop.start, loop.end + 1)).facing_positions
    after = Upright.of(loop.motion).facing_positions
    assert np.linalg.norm(after - before, axis=-1).mean(axis=1).max() < loop.difference


def test_a_cycle_stays_in_its_place_unless_asked_to_the_origin() -> None:
    walk = turned(make_walk(300), 2.0)
    walk = replace(walk, root_positions=walk.root_positions + np.array([300.0, 0.0, -200.0], np.float32))
    loop, moved = make_loop(walk), make_loop(walk, from_origin=True)
    assert np.abs(loop.motion.root_positions[0] - walk.root_positions[loop.start]).max() < 2.0
    assert np.abs(moved.motion.root_positions[0, [0, 2]]).max() < 4.0
    assert moved.motion.root_positions[-1, 2] > 80.0 > 20.0 > abs(moved.motion.root_positions[-1, 0])
    assert moved.seam.distance < 0.01 and moved.seam.speed == pytest.approx(loop.seam.speed, abs=0.5)


@pytest.mark.parametrize(
    ("wish", "found"), [(0.1, 1.0), (1.05, 1.0), (1.4, 1.0), (1.6, 2.0), (2.2, 2.0), (3.2, 3.0), (30.0, 30.0)]
)
def test_the_cycle_nearest_to_a_wish_is_taken(wish: float, found: float) -> None:
    loop = make_loop(make_walk(260, turn=0.05), seconds=wish)
    assert (len(loop.motion) - 1) / 60 == pytest.approx(found, abs=0.05)
    assert loop.difference < 3.0


def test_a_repeated_cycle_goes_on_from_where_it_ended() -> None:
    once, often = (make_loop(make_walk(260, turn=0.05), seconds=wish).motion for wish in (1.0, 30.0))
    steps = len(once) - 1
    assert (len(often) - 1) % steps == 0
    ways = [np.diff(each.root_positions, axis=0) for each in (once, often)]
    assert np.abs(ways[1] - np.tile(ways[0], ((len(often) - 1) // steps, 1))).max() < 1e-3
    assert (
        seam(often).distance < 0.01
        and quat_angle(often.local_rotations[-1], once.local_rotations[-1]).max() < 1e-3
    )


@pytest.mark.parametrize("fps", [12.0, 24.0])
def test_a_clip_that_is_closed_is_accepted_whole(fps: float) -> None:
    """At low rates velocities at the ends differ, because they are known from one side only."""
    cycle = resample(make_loop(make_walk(260, speed=300.0, turn=0.0, cadence=1.5)).motion, fps)
    loop = make_loop(cycle)
    assert (loop.start, loop.end) == (0, len(cycle) - 1)


def test_a_first_search_by_strides_meets_a_wish(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motionkit.editing.loop.COARSE", 100)
    loop = make_loop(make_walk(300, turn=0.05), seconds=2.0)
    assert len(loop.motion) - 1 == pytest.approx(120, abs=6)


@pytest.mark.parametrize(("ends", "near"), [
    ((7, 47), True), ((13, 53), True), ((13, 50), True), ((6, 47), False), ((14, 53), False), ((7, 46), False),
    ((13, 54), False), ((13, 49), False), ((7, 51), False),
])  # fmt: skip
def test_a_second_search_looks_one_stride_around_the_first(ends: tuple[int, int], near: bool) -> None:
    rows = np.random.default_rng(0).normal(size=(80, 9))
    rows[ends[1]] = rows[ends[0]]
    assert (_refined(rows, 10, 50, 3, 3)[:2] == ends) == near


def test_played_twice_a_loop_moves_on_as_within(tmp_path: Path) -> None:
    """Speeds of joints over the seam, in a clip of two cycles, are no larger than elsewhere."""
    loop = make_loop(read_motion(DATA / "16_45.bvh")).motion
    cycle = (loop.root_positions[-1] - loop.root_positions[0]) * np.array([1, 0, 1], np.float32)
    rotations = np.concatenate([loop.local_rotations, loop.local_rotations[1:]])
    roots = np.concatenate([loop.root_positions, loop.root_positions[1:] + cycle])
    _, at = motion_kinematics(replace(loop, local_rotations=rotations, root_positions=roots))
    bends = np.linalg.norm(np.diff(at, n=2, axis=0), axis=-1)
    seam = len(loop) - 2
    assert bends[seam - 1 : seam + 2].max() <= bends[5 : seam - 5].max()


def test_a_dance_in_place_ends_where_it_began() -> None:
    """A body that sways, with a slow drift that a loop takes out."""
    walk = make_walk(300, speed=0.0)
    roots = walk.root_positions.copy()
    roots[:, [0, 2]] = 0.05 * np.arange(300)[:, None]
    loop = make_loop(replace(walk, root_positions=roots.astype(np.float32)))
    way = loop.motion.root_positions[-1] - loop.motion.root_positions[0]
    assert np.abs(way).max() < 1e-3


def test_the_usual_pace_of_a_clip_decides() -> None:
    slow, fast = make_walk(400, speed=100.0, turn=0.0), make_walk(160, speed=200.0, turn=0.0, cadence=1.5)
    both = joined(fast, slow)
    loop = make_loop(both)
    way = loop.motion.root_positions[-1, [0, 2]] - loop.motion.root_positions[0, [0, 2]]
    speed = float(np.linalg.norm(way)) / ((len(loop.motion) - 1) / 60)
    assert speed == pytest.approx(100.0, rel=0.1) and loop.start >= len(fast) - 1
    assert make_loop(fast).end - make_loop(fast).start < loop.end - loop.start, (
        "the fast cycle is the shorter one"
    )


def test_the_usual_direction_of_a_clip_decides() -> None:
    """A body that goes straight ahead for long, and at the same speed aside for a short while."""
    ahead, aside = make_walk(400, speed=100.0, turn=0.0), make_walk(160, speed=100.0, turn=0.0, cadence=1.5)
    roots = aside.root_positions.copy()
    ground = roots[:, [0, 2]].astype(np.float64)
    roots[:, [0, 2]] = rotate_ground(np.full(len(ground), np.deg2rad(40.0)), ground)
    loop = make_loop(joined(replace(aside, root_positions=roots), ahead), from_origin=True)
    x, _, z = loop.motion.root_positions[-1]
    assert abs(np.degrees(np.arctan2(x, z))) < 5.0 and loop.at_pace


@pytest.mark.parametrize("minutes", [1.9, 6.0, 12.0])
def test_a_long_clip_has_the_cycle_of_a_short_one(minutes: float) -> None:
    """Of a standing start, a fast stretch and a walk, whose steps a long stride would always meet at the same pose."""
    walk = make_walk(round(minutes * 1800), fps=30.0, turn=0.05)
    stand = replace(
        walk.cut(0, 2),
        local_rotations=walk.local_rotations[[0] * 900],
        root_positions=walk.root_positions[[0] * 900],
    )
    clip = joined(stand, joined(make_walk(900, fps=30.0, speed=250.0, cadence=1.5), walk))
    loop = make_loop(clip)
    assert loop.end - loop.start == 30 and loop.start >= 1799 and loop.difference < 0.5
    assert make_loop(walk, seconds=3.0).seconds == pytest.approx(3.0, abs=0.1)


def test_a_body_that_stands_sways_for_seconds() -> None:
    stance = make_walk(1, speed=0.0)
    idle = replace(
        make_walk(900, speed=0.0, turn=0.0, swing=0.02, cadence=0.4),
        root_positions=np.repeat(stance.root_positions, 900, axis=0),
    )
    loop = make_loop(idle)
    assert 2.0 <= (loop.end - loop.start) / 60 < 3.0, "half a second is as good, but still"
    again = make_loop(loop.motion)
    assert (again.start, again.end) == (0, len(loop.motion) - 1), "what was made as a loop is not cut"


def test_a_clip_that_does_not_move_is_refused() -> None:
    still = make_walk(1)
    still = replace(
        still,
        local_rotations=np.repeat(still.local_rotations, 200, axis=0),
        root_positions=np.repeat(still.root_positions, 200, axis=0),
    )
    with pytest.raises(MotionkitError, match="does not move"):
        make_loop(still)


def under_a_still_root(motion: Motion, group: bool = False, target: bool = False) -> Motion:
    """The motion below another joint, which stays at the origin: the hips carry the way, as in some rigs.

    There may be a group between both, and a joint below the root that stays where it is, such as a target of the feet.
    """
    if group:
        motion = under_a_still_root(motion)
    skeleton = motion.skeleton
    frames = len(motion)
    places = np.pad(motion.translations(), ((0, 0), (1, 0), (0, 0)))
    still = np.broadcast_to(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (frames, 1, 4))
    made = Motion(
        Skeleton(
            ("Group" if "joint_Root" in skeleton.names else "joint_Root", *skeleton.names),
            (-1, *(parent + 1 for parent in skeleton.parents)),
            np.concatenate([np.zeros((2, 3), np.float32), skeleton.offsets[1:]]),
            {joint + 1: end for joint, end in skeleton.end_sites.items()},
        ),
        np.concatenate([still, motion.local_rotations], axis=1),
        np.zeros((frames, 3), np.float32),
        motion.fps,
        places.astype(np.float32),
    )
    if not target:
        return made
    more = Skeleton(
        (*made.skeleton.names, "ik_foot_root"),
        (*made.skeleton.parents, 0),
        np.concatenate([made.skeleton.offsets, np.zeros((1, 3), np.float32)]),
        made.skeleton.end_sites,
    )
    assert made.local_positions is not None
    return replace(
        made,
        skeleton=more,
        local_rotations=np.concatenate([made.local_rotations, still], axis=1),
        local_positions=np.pad(made.local_positions, ((0, 0), (0, 1), (0, 0))),
    )


@pytest.mark.parametrize(("group", "target"), [(False, False), (True, False), (False, True)])
def test_a_rig_whose_root_stands_still_goes_on(group: bool, target: bool) -> None:
    walk = make_walk(300, turn=0.0)
    made, wanted = make_loop(under_a_still_root(walk, group, target)), make_loop(walk)
    assert made.end - made.start == wanted.end - wanted.start
    # The strides of this walk are alike, so either may be taken; the hips go on as far.
    names = made.motion.skeleton.names
    hips = motion_kinematics(made.motion)[1][:, names.index("Hips")]
    others = motion_kinematics(wanted.motion)[1][:, 0]
    assert np.linalg.norm(hips[-1] - hips[0]) == pytest.approx(
        np.linalg.norm(others[-1] - others[0]), rel=0.01
    )
    assert np.abs(in_place(under_a_still_root(walk)).root_positions[:, [0, 2]]).max() < 10.0


def test_what_never_repeats_is_refused() -> None:
    walk = make_walk(120)
    fall = walk.local_rotations.copy()
    lean = np.linspace(0.0, 1.5, 120, dtype=np.float32)
    fall[:, 0] = quat_multiply(
        np.stack([np.cos(lean / 2), np.sin(lean / 2), 0 * lean, 0 * lean], axis=-1), fall[:, 0]
    )
    with pytest.raises(MotionkitError, match=r"never repeats: .* too different to loop: \w+ \d+ cm apart"):
        make_loop(replace(walk, local_rotations=fall))
    with pytest.raises(MotionkitError, match=r"lasts 0.33 s"):
        make_loop(walk.cut(0, 20))


def test_rigs_that_are_not_human_loop_too() -> None:
    angles = np.linspace(0.0, 6 * np.pi, 181)
    half = 0.3 * np.sin(angles)
    rotations = np.zeros((181, 3, 4), np.float32)
    rotations[..., 0] = 1.0
    rotations[:, 1] = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], axis=-1)
    offsets = np.array([[0, 0, 0], [0, 50, 0], [0, 30, 0]], np.float32)
    pole = Skeleton(("Pole", "Arm", "Tip"), (-1, 0, 1), offsets)
    loop = make_loop(Motion(pole, rotations, np.zeros((181, 3), np.float32), 60.0))
    assert len(loop.motion) - 1 == pytest.approx(60, abs=2)


def test_the_command(motionkit, tmp_path: Path) -> None:
    write_motion(tmp_path / "walk.bvh", make_walk(200))
    said = motionkit("loop", "walk.bvh", "--root", "ground", "--in-place", "-o", "a.glb")
    assert said.code == 0 and said.out.startswith("wrote a.glb: frames ") and "seam 0.00 cm" in said.out
    made = read_motion(tmp_path / "a.glb")
    assert made.skeleton.names[:2] == ("Root", "Hips")
    assert np.abs(made.root_positions).max() < 0.5
    value = json.loads(motionkit("loop", "walk.bvh", "--json", "--seconds", 1).out)
    assert value["output"] == "walk-loop.bvh" and value["seam_cm"] <= value["frame_cm"]
    assert not motionkit("loop", "walk.bvh", "--seconds", 1.05).err
    said = motionkit("loop", "walk.bvh", "--seconds", 30)
    assert said.code == 0 and ", 30 times: 30.00 s" in said.out and not said.err
    write_motion(tmp_path / "short.bvh", make_walk(10))
    assert motionkit("loop", "short.bvh").failed_with("short.bvh: the clip lasts 0.17 s")
    assert not (tmp_path / "short-loop.bvh").exists()


def test_what_does_not_repeat_at_once_is_synthesized_for_longer(
    motionkit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def found(motion: Motion, seconds: float | None = None, from_origin: bool = False) -> Loop:
        asked.append(len(motion))
        if len(asked) < 3:
            raise MotionkitError("the clip never repeats: said by a test")
        return make_loop(motion, seconds, from_origin)

    monkeypatch.setattr("motionkit.editing.loop.make_loop", found)
    said = motionkit("synthesize", "--types", "walking", "--loop", "-o", "long.bvh")
    assert said.code == 0, said.err
    assert asked == [480, 960, 1920]

    def aside(motion: Motion, seconds: float | None = None, from_origin: bool = False) -> Loop:
        asked.append(len(motion))
        return replace(make_loop(motion, seconds, from_origin), at_pace=len(asked) == 2)

    asked[:] = []
    monkeypatch.setattr("motionkit.editing.loop.make_loop", aside)
    said = motionkit("synthesize", "--types", "walking", "--loop", "-o", "aside.bvh")
    assert said.code == 0 and asked == [480, 960], "a cycle at another velocity is not taken at once"
    monkeypatch.setattr("motionkit.editing.loop.make_loop", found)
    asked[:] = [-3]
    monkeypatch.setattr("motionkit.editing.loop.LOOP_TRIES", ())
    said = motionkit("synthesize", "--types", "walking", "--loop", "-o", "never.bvh")
    assert said.code == 1 and "never repeats" in said.err and not (tmp_path / "never.bvh").exists()


def test_synthesized_loops(motionkit, tmp_path: Path) -> None:
    said = motionkit("synthesize", "--types", "walking", "--loop", "--seconds", 1, "--json", "-o", "w.bvh")
    (made,) = json.loads(said.out)["motions"]
    assert made["seam_cm"] <= made["frame_cm"] and made["seam_cm_s"] <= made["frame_cm_s"]
    assert 50 < len(read_motion(tmp_path / "w.bvh")) < 90
    for kinds in ("walking,running", "walking,running:2"):
        said = motionkit("synthesize", "--types", kinds, "--loop")
        assert said.failed_with("a loop takes one motion type")
    said = motionkit("synthesize", "--types", "punching", "--loop", "--json", "-o", "p.csv")
    assert [kind for kind, _ in json.loads(said.out)["motions"][0]["types"]] == ["punching"]
    said = motionkit("synthesize", "--types", "walking:1", "--types", "running:2", "--loop")
    assert said.failed_with("expected one length in seconds for all loops, found 1, 2")
    said = motionkit("synthesize", "--types", "walking:1", "--loop", "-o", "a.bvh")
    assert said.code == 0 and (tmp_path / "a.bvh").read_bytes() == (tmp_path / "w.bvh").read_bytes()


@pytest.mark.parametrize("kind", ["dance-salsa", "balance"])
def test_loops_on_a_rig_are_closed(motionkit, tmp_path: Path, kind: str) -> None:
    """Feet are locked by their neighbouring frames, those beyond the ends too."""
    words = "synthesize", "--types", kind, "--seed", 1, "--loop", "--rig", "@mixamo", "-o", "a.bvh", "--json"
    said = motionkit(*words)
    (made,) = json.loads(said.out)["motions"]
    written = seam(Upright.of(read_motion(tmp_path / "a.bvh")).motion)
    assert made["seam_cm"] == pytest.approx(written.distance, abs=0.01) and written.distance < 0.01
    assert written.speed <= written.frame_speed
    again = make_loop(read_motion(tmp_path / "a.bvh"))
    assert again.end - again.start == made["frames"] - 1 and again.times == 1


def test_a_loop_begins_with_its_clip_on_the_rig(motionkit, tmp_path: Path) -> None:
    """Joints that motionkit does not know move as in the clip, from its beginning, in a closed cycle."""
    rig = motionkit("synthesize", "--types", "walking:2", "--rig", "@mixamo", "-o", "clip.bvh")
    assert rig.code == 0
    clip = read_motion(tmp_path / "clip.bvh")
    finger = next(i for i, name in enumerate(clip.skeleton.names) if name.endswith("RightHandIndex1"))
    turns = clip.local_rotations.copy()
    angles = 0.5 * np.sin(np.arange(len(clip)) / 9.0)
    turns[:, finger] = np.stack([np.cos(angles), np.sin(angles), 0 * angles, 0 * angles], axis=-1)
    write_motion(tmp_path / "clip.bvh", replace(clip, local_rotations=turns))
    words = (
        "synthesize",
        "--types",
        "walking",
        "--loop",
        "--rig",
        "clip.bvh",
        "--from",
        "clip.bvh",
        "-o",
        "a.bvh",
    )
    for more in ((), ("--no-ik",)):
        assert motionkit(*words, "--replace", *more).code == 0
        made = read_motion(tmp_path / "a.bvh").local_rotations[:, finger]
        fade = 16  # frames in which velocities of both ends meet, and its end leads back to the first frame
        apart = np.rad2deg(quat_angle(made, turns[np.minimum(np.arange(len(made)), len(turns) - 1), finger]))
        assert apart[fade:-fade].max() < 0.2 and apart[:fade].max() < 10.0
        assert np.rad2deg(quat_angle(made[-1], made[0])) < 0.1
        assert np.rad2deg(quat_angle(made[1:], made[:-1])).max() < 20.0


def test_the_seam_is_that_of_the_cycle_after_a_frame_at_rest(motionkit) -> None:
    said = motionkit("synthesize", "--types", "walking", "--loop", "--rest-frame", "--json", "-o", "a.bvh")
    (made,) = json.loads(said.out)["motions"]
    assert made["seam_cm"] < 0.1 and made["frame_cm"] < 15.0
