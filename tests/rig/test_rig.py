"""Motion on a user's rig: round trips over many rigs, exact hierarchies, other joints, feet that hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.finish.on_rig import on_rig
from motionkit.motion.bvh import BvhFile, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_angle,
    quat_identity,
    quat_multiply,
    quat_normalize,
    quat_rotate,
)
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton, canonical_skeleton
from motionkit.rig.names import map_rig, user_map
from motionkit.rig.on_rig import read_clip, read_rig
from motionkit.rig.pose import up_turn
from motionkit.rig.retarget import retarget
from motionkit.rig.rig import Rig, make_rig
from motionkit.rig.to_rig import on_body, rig_bvh, to_rig
from synthetic_motions import make_walk
from synthetic_rigs import FAMILIES, renamed, turned_rest, walk

TURNS = ("Zrotation", "Xrotation", "Yrotation")
MOVES = ("Xposition", "Yposition", "Zposition")


def same_turn(expmap: tuple[float, float, float]) -> Array:
    """The same change of axes for every joint."""
    return np.broadcast_to(expmap_to_quat(np.array(expmap, np.float32)), (len(JOINT_NAMES), 4))


def arms_down() -> Array:
    """Changes of axes that make hanging arms the rest pose."""
    changes = quat_identity((len(JOINT_NAMES),))
    for joint, name in enumerate(JOINT_NAMES):
        if name.endswith(("Arm", "Hand")):
            angle = (-1.0 if name.startswith("Left") else 1.0) * math.radians(80)
            changes[joint] = expmap_to_quat(np.array([0.0, 0.0, angle], np.float32))
    return changes


def z_up() -> Motion:
    """A walk in a world whose up axis is Z."""
    tilt = expmap_to_quat(np.array([math.pi / 2, 0.0, 0.0], np.float32))
    source = turned_rest(walk(), same_turn((math.pi / 2, 0.0, 0.0)))
    turns = source.local_rotations.copy()
    turns[:, 0] = quat_multiply(np.broadcast_to(tilt, turns[:, 0].shape), turns[:, 0])
    return replace(source, local_rotations=turns, root_positions=quat_rotate(tilt, source.root_positions))


def odd_axes() -> Motion:
    """A walk on a rig whose joints all have axes of their own, so that its rest pose is no human pose."""
    changes = np.random.default_rng(3).standard_normal((len(JOINT_NAMES), 4), np.float32)
    return turned_rest(walk(120), quat_normalize(changes))


def furnished() -> Motion:
    """A walk on a rig with a root above the hips, a twist joint, fingers and a sword."""
    source = walk()
    names, parents, offsets = ["World"], [-1], [np.zeros(3)]
    place = {-1: 0}
    for joint, name in enumerate(JOINT_NAMES):
        above, way = place[source.skeleton.parents[joint]], source.skeleton.offsets[joint]
        if name == "LeftHand":
            names.append("LeftForeArmTwist")
            parents.append(above)
            offsets.append(0.4 * way)
            above, way = len(names) - 1, 0.6 * way
        place[joint] = len(names)
        names.append(name)
        parents.append(above)
        offsets.append(way)
    for name, hand, way in (("Thumb", "RightHand", (-2, 0, 3)), ("Sword", "RightHand", (0, 5, 90.0))):
        names.append(name)
        parents.append(place[JOINT_NAMES.index(hand)])
        offsets.append(np.array(way))
    turns = quat_identity((len(source), len(names)))
    for joint, index in place.items():
        if joint >= 0:
            turns[:, index] = source.local_rotations[:, joint]
    places = np.broadcast_to(np.stack(offsets), (len(source), len(names), 3)).astype(np.float32).copy()
    places[:, 1] = source.root_positions
    skeleton = Skeleton(tuple(names), tuple(parents), np.stack(offsets).astype(np.float32))
    return Motion(skeleton, turns, np.zeros((len(source), 3), np.float32), source.fps, places)


def german() -> dict[str, str]:
    """Names that no list of words has."""
    sides = {"Left": "L", "Right": "R"}
    words = dict(
        UpLeg="Oberschenkel", Leg="Unterschenkel", Foot="Sprunggelenk", ToeBase="Ballen",
        Shoulder="Schulter", Arm="Oberarm", ForeArm="Unterarm", Hand="Faust",
    )  # fmt: skip
    names = {f"{side}{part}": f"{word}_{s}" for part, word in words.items() for side, s in sides.items()}
    torso = dict(
        Hips="Becken",
        LowerBack="Lende",
        Spine="Bauch",
        Spine1="Brust",
        Neck="Hals",
        Neck1="Nacken",
        Head="Kopf",
    )
    return names | torso


def split() -> Motion:
    """A walk on a rig whose spine hangs beside its hips, both below a centre that the whole body turns with."""
    source = walk()
    names = ("Center", *JOINT_NAMES)
    spine = JOINT_NAMES.index("LowerBack")
    parents = (-1, *(0 if joint in (0, spine) else PARENTS[joint] + 1 for joint in range(len(JOINT_NAMES))))
    offsets = np.concatenate([np.zeros((1, 3), np.float32), source.skeleton.offsets])
    offsets[1], offsets[1 + spine] = (0.0, -4.0, 1.0), (0.0, 5.0, -1.0)
    turns = np.concatenate([source.local_rotations[:, :1], source.local_rotations], axis=1)
    turns[:, 1] = quat_identity((len(source),))
    return Motion(Skeleton(names, parents, offsets), turns, source.root_positions, source.fps)


RIGS = {
    "split": split(),
    **{family: renamed(walk(), names) for family, names in FAMILIES.items()},
    "german": renamed(walk(), german()),
    "nameless": renamed(walk(), {name: f"bone{j}" for j, name in enumerate(JOINT_NAMES)}),
    "metres": walk().scaled(0.01),
    "inches": walk().scaled(1 / 2.54),
    "giant": walk().scaled(40.0),
    "z-up": z_up(),
    "faces +X": turned_rest(walk(), same_turn((0.0, math.pi / 2, 0.0))),
    "faces -Z": turned_rest(walk(), same_turn((0.0, math.pi, 0.0))),
    "arms down": turned_rest(walk(), arms_down()),
    "odd axes": odd_axes(),
    "furnished": furnished(),
}


def rig_of(motion: Motion, folder: Path) -> Rig:
    """The rig of a file of this motion."""
    write_bvh(folder / "my.bvh", motion)
    return read_rig(folder / "my.bvh")


def reread(bvh: BvhFile, folder: Path) -> BvhFile:
    """What a file of this holds."""
    write_bvh(folder / "out.bvh", bvh)
    return read_bvh(folder / "out.bvh")


def worst_turn(one: Motion, other: Motion, joints: list[str]) -> float:
    """The largest angle in degrees between global rotations of canonical joints."""
    index = [JOINT_NAMES.index(name) for name in joints]
    a, b = (motion_kinematics(motion)[0][:, index] for motion in (one, other))
    return float(np.rad2deg(quat_angle(a, b)).max())


@pytest.mark.parametrize("key", RIGS)
def test_there_and_back(key: str, tmp_path: Path) -> None:
    """Canonical to rig, to a file, and back: every joint that the rig has, within 0.5 degree (here 0.01)."""
    rig, source = rig_of(RIGS[key], tmp_path), make_walk(40)
    made = reread(rig_bvh(to_rig(source, rig), rig), tmp_path)
    back, _ = retarget(made, rig=rig)
    assert worst_turn(source, back, list(rig.joints.places)) < 0.01
    assert np.abs(back.root_positions - source.root_positions).max() < 0.01
    if key != "odd axes":  # its rest pose is known from recorded poses only
        again, _ = retarget(made)
        assert worst_turn(source, again, list(rig.joints.places)) < 0.01


@pytest.mark.parametrize("key", RIGS)
def test_the_body_is_where_the_rig_is(key: str, tmp_path: Path) -> None:
    """The body on which feet are held has every mapped joint where the rig has it."""
    rig, source = rig_of(RIGS[key], tmp_path), make_walk(20)
    body = motion_kinematics(on_body(source, rig))[1]
    theirs = quat_rotate(up_turn(rig.up), motion_kinematics(to_rig(source, rig))[1]) * rig.scale
    for name, joint in rig.joints.places.items():
        assert np.abs(body[:, JOINT_NAMES.index(name)] - theirs[:, joint]).max() < 0.01, name


MESSY = """HIERARCHY
ROOT Bip01
{{
  OFFSET 0.0 0 0
  CHANNELS 6 Xposition Zposition Yposition Yrotation Xrotation Zrotation
{body}
}}
MOTION
Frames: 1
Frame Time: .04
{row}
"""


def messy_file(path: Path) -> None:
    """A file in a style of its own: names with spaces, odd indents, channels in another order."""
    skeleton = canonical_skeleton()
    names = {name: FAMILIES["biped"].get(name, f"Bip01 {name}").replace("_", " ") for name in JOINT_NAMES}

    def joint(index: int) -> list[str]:
        lines = (
            []
            if not index
            else [
                f" JOINT {names[JOINT_NAMES[index]]} {{",
                f"   OFFSET\t{' '.join(f'{v:.3f}' for v in skeleton.offsets[index])}",
                "   CHANNELS 3 Yrotation Xrotation Zrotation",
            ]
        )
        for child in skeleton.children(index):
            lines += joint(child)
        if not skeleton.children(index):
            lines += [
                "   End Site",
                "   {",
                f"  OFFSET {' '.join(f'{v:.2f}' for v in skeleton.end_sites[index])}",
                "   }",
            ]
        return [*lines, " }"] if index else lines

    row = " ".join(["0", "0", "97.5"] + ["0"] * 69)
    path.write_text(MESSY.format(body="\n".join(joint(0)), row=row), "utf-8")


def test_the_hierarchy_is_the_files_own(tmp_path: Path) -> None:
    messy_file(tmp_path / "my rig.bvh")
    rig = read_rig(tmp_path / "my rig.bvh")
    write_bvh(tmp_path / "out.bvh", rig_bvh(on_rig(make_walk(30), rig), rig))
    before, after = (
        path.read_text().split("MOTION")[0] for path in (tmp_path / "my rig.bvh", tmp_path / "out.bvh")
    )
    assert before == after and "Bip01 L Thigh" in after
    out, own = read_bvh(tmp_path / "out.bvh"), read_bvh(tmp_path / "my rig.bvh")
    assert out.channels == own.channels and out.fps == 60.0
    assert read_bvh(tmp_path / "out.bvh").hierarchy == read_bvh(tmp_path / "my rig.bvh").hierarchy


def test_other_joints_stay_at_rest_or_move_as_in_a_clip(tmp_path: Path) -> None:
    rig_motion = furnished()
    rig = rig_of(rig_motion, tmp_path)
    names = rig.skeleton.names
    others = [names.index(name) for name in ("Thumb", "Sword", "LeftForeArmTwist")]
    out = on_rig(make_walk(60), rig)
    assert np.abs(out.local_rotations[:, others, 1:]).max() < 1e-6
    turns = rig_motion.local_rotations.copy()
    about = np.array([0.02, 0.0, 0.0], np.float32)
    for joint in others:
        turns[:, joint] = expmap_to_quat(np.arange(len(turns))[:, None] * about)
    write_bvh(tmp_path / "clip.bvh", replace(rig_motion, local_rotations=turns))
    clip = read_clip(tmp_path / "clip.bvh", rig)
    source = make_walk(90, fps=30.0)
    out = on_rig(source, rig, ik=False, clip=clip)
    at = np.minimum(np.arange(90), len(clip) - 1)
    assert np.rad2deg(quat_angle(out.local_rotations[:, others], turns[at][:, others])).max() < 0.01
    back, _ = retarget(motion_to_bvh(out), rig=rig)
    assert worst_turn(source, back, list(rig.joints.places)) < 0.01  # the twist does not turn the hand


@pytest.mark.parametrize("make", [furnished, split, odd_axes, z_up])
def test_a_clip_at_rest_is_as_none(make: Callable[[], Motion], tmp_path: Path) -> None:
    rig = rig_of(make(), tmp_path)
    still = quat_identity((1, len(rig.skeleton)))
    rest = Motion(rig.skeleton, still, rig.skeleton.offsets[:1], 60.0)
    motion = make_walk(20)
    one, other = to_rig(motion, rig), to_rig(motion, rig, clip=rest)
    assert float(quat_angle(one.local_rotations, other.local_rotations).max()) < 1e-3
    assert np.allclose(one.root_positions, other.root_positions, atol=1e-4)


def test_a_clip_of_another_rig_is_refused(tmp_path: Path) -> None:
    write_bvh(tmp_path / "clip.bvh", walk())
    with pytest.raises(SkeletonError, match=r"clip\.bvh: has other joints than the rig my\.bvh"):
        read_clip(tmp_path / "clip.bvh", rig_of(furnished(), tmp_path))


def stocky() -> Motion:
    """A standing body with short thighs, wide hips and large feet, its toes 3 cm above its floor."""
    factors = {"UpLeg": (1.9, 1.0, 1.0), "Leg": (0.7,) * 3, "Foot": (0.9,) * 3, "ToeBase": (1.0, 2.2, 1.4)}
    skeleton = canonical_skeleton()
    offsets = skeleton.offsets.copy()
    for joint, name in enumerate(JOINT_NAMES):
        factor = factors.get(name.removeprefix("Left").removeprefix("Right"))
        if factor:
            offsets[joint] *= factor
    rest = Skeleton(JOINT_NAMES, skeleton.parents, offsets, skeleton.end_sites)
    lowest = float(rest.rest_positions()[:, 1].min())
    turns = quat_identity((2, len(JOINT_NAMES)))
    return Motion(rest, turns, np.tile(np.array([[0.0, 3.0 - lowest, 0.0]], np.float32), (2, 1)), 60.0)


def sliding(feet: Array, touching: Array) -> float:
    """Mean movement over the ground per frame of feet (T, 2, 3) that touch (T, 2) it."""
    way = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1)
    return float(way[(touching[1:] > 0.5) & (touching[:-1] > 0.5)].mean())


def test_feet_of_another_body_hold_and_stand_on_the_floor(tmp_path: Path) -> None:
    rig = rig_of(stocky(), tmp_path)
    toes = [JOINT_NAMES.index(name) for name in ("LeftToeBase", "RightToeBase")]
    slides = []
    for seed in (3, 4, 5):
        source = mk.synthesize("walking:4", seed=seed).motion
        places = motion_kinematics(source)[1][:, toes]
        touching = foot_contacts(motion_kinematics(source)[1], source.fps)[:, [1, 3]]
        assert touching.sum() > 50
        raw, held = (
            motion_kinematics(on_rig(source, rig, ik))[1][:, toes] * rig.scale for ik in (False, True)
        )
        slides.append([sliding(feet, touching) for feet in (places, raw, held)])
    own, raw_slide, held_slide = np.mean(slides, axis=0)
    assert raw_slide > 2.0 * own and held_slide <= own + 0.002  # cm a frame
    heights = held[..., 1][touching > 0.5]
    assert rig.stance == pytest.approx(3.0 * rig.scale, abs=0.01)
    assert abs(float(np.quantile(heights, 0.25)) - rig.stance) < 0.1
    assert float(held[..., 1].min()) > rig.stance - 2.5


def test_feet_without_ik_come_as_they_are(tmp_path: Path) -> None:
    rig, source = rig_of(stocky(), tmp_path), make_walk(60)
    back, _ = retarget(rig_bvh(on_rig(source, rig, ik=False), rig), rig=rig)
    assert worst_turn(source, back, list(JOINT_NAMES)) < 0.01


def test_a_rest_pose_that_is_none_needs_a_standing_frame(tmp_path: Path) -> None:
    lying = odd_axes()
    turns = quat_identity((2, len(JOINT_NAMES)))
    rest = Motion(lying.skeleton, turns, np.zeros((2, 3), np.float32), 30.0)
    with pytest.raises(SkeletonError, match="no frame shows one"):
        rig_of(rest, tmp_path)


@pytest.mark.parametrize(
    ("joint", "channels", "found"),
    [
        ("LeftLeg", ("Xrotation",), r"LeftLeg \(LeftLeg\) has 1 rotation channels, expected 3"),
        ("LeftArm", (), r"LeftArm \(LeftArm\) has 0 rotation channels"),
        ("Hips", TURNS, "no joint from Hips to Hips has three position channels"),
    ],
)
def test_channels_that_cannot_hold_a_motion(joint: str, channels: tuple[str, ...], found: str) -> None:
    all_channels = tuple(
        channels if name == joint else (MOVES + TURNS if name == "Hips" else TURNS) for name in JOINT_NAMES
    )
    width = sum(map(len, all_channels))
    bvh = BvhFile(canonical_skeleton(), all_channels, np.zeros((1, width)), 0.01)
    with pytest.raises(SkeletonError, match=found):
        make_rig(bvh, "my.bvh")


def test_a_toe_without_channels_keeps_its_rest_pose() -> None:
    channels = tuple(
        () if name.endswith("ToeBase") else (MOVES + TURNS if name == "Hips" else TURNS)
        for name in JOINT_NAMES
    )
    bvh = BvhFile(canonical_skeleton(), channels, np.zeros((1, sum(map(len, channels)))), 0.01)
    rig = make_rig(bvh, "my.bvh")
    source = make_walk(30)
    back, _ = retarget(rig_bvh(to_rig(source, rig), rig), rig=rig)
    assert worst_turn(source, back, [name for name in JOINT_NAMES if not name.endswith("ToeBase")]) < 0.01


def test_four_hundred_joints_take_no_time_worth_mentioning(tmp_path: Path) -> None:
    """Hair, skirts and meshes in any number: only the body moves."""
    source = walk(2)
    skeleton = source.skeleton
    names, parents, offsets = list(skeleton.names), list(skeleton.parents), list(skeleton.offsets)
    for strand in range(29):
        above = JOINT_NAMES.index("Head" if strand % 2 else "Hips")
        for link in range(13):
            names.append(f"strand{strand}_{link}")
            parents.append(above)
            offsets.append(np.array([math.sin(strand), -2.0, math.cos(strand)]))
            above = len(names) - 1
    turns = quat_identity((2, len(names)))
    turns[:, : len(JOINT_NAMES)] = source.local_rotations
    big = Skeleton(tuple(names), tuple(parents), np.stack(offsets).astype(np.float32), skeleton.end_sites)
    rig = rig_of(Motion(big, turns, source.root_positions, 30.0), tmp_path)
    assert len(rig.skeleton) == 400 and rig.joints.missing() == ()
    made = rig_bvh(on_rig(make_walk(30), rig), rig)
    assert set(made.skeleton.names) == set(big.names) and made.values.shape == (30, 3 + 3 * 400)


@pytest.mark.parametrize("sides", [("Left",), ("Left", "Right")])
def test_legs_that_end_in_the_shin_stand_on_the_ends_of_their_shins(sides: tuple[str, ...]) -> None:
    """A rig without feet walks with its ankles where a body with feet has them, in its own unit."""
    source, whole = walk(), canonical_skeleton()
    cut = [f"{side}{part}" for side in sides for part in ("Foot", "ToeBase")]
    bare = renamed(source, {name: name for name in JOINT_NAMES if name not in cut})
    shins = {side: bare.skeleton.names.index(f"{side}Leg") for side in sides}
    ankles = {side: JOINT_NAMES.index(f"{side}Foot") for side in sides}
    ends = {shins[side]: tuple(map(float, whole.offsets[ankles[side]])) for side in sides}
    bare = replace(bare, skeleton=replace(bare.skeleton, end_sites=ends))
    result, report = retarget(motion_to_bvh(bare))
    assert {"LeftFoot", "LeftToeBase"} <= set(report.missing) and report.scale == pytest.approx(1.0)
    for before, after in zip(motion_kinematics(source), motion_kinematics(result), strict=True):
        legs = [JOINT_NAMES.index(f"{side}{part}") for side in sides for part in ("UpLeg", "Leg")]
        assert np.abs(before[:, legs] - after[:, legs]).max() < 0.05
    rig = make_rig(motion_to_bvh(bare), "bare")
    made = on_rig(source, rig)
    turns, places = motion_kinematics(made)
    for side in sides:
        end = np.broadcast_to(np.float32(ends[shins[side]]), (len(made), 3))
        ankle = places[:, shins[side]] + quat_rotate(turns[:, shins[side]], end)
        assert np.abs(ankle - motion_kinematics(source)[1][:, ankles[side]]).max() < 5.0


def test_what_is_made_for_a_mapped_rig_keeps_the_map(tmp_path: Path) -> None:
    """Nothing else could find the limbs: no name tells them, and the legs are too short for a human shape."""
    source = walk()
    opaque = renamed(source, {name: f"q{joint}" for joint, name in enumerate(JOINT_NAMES)})
    offsets = opaque.skeleton.offsets.copy()
    offsets[
        [JOINT_NAMES.index(f"{side}{part}") for side in ("Left", "Right") for part in ("Leg", "Foot")]
    ] *= 0.2
    opaque = replace(opaque, skeleton=replace(opaque.skeleton, offsets=offsets))
    with pytest.raises(SkeletonError):
        map_rig(opaque.skeleton)
    places = {name: joint for joint, name in enumerate(JOINT_NAMES)}
    rig = make_rig(motion_to_bvh(opaque), "opaque", user_map(opaque.skeleton, places))
    made = on_rig(source, rig)
    for motion in (made, mk.make_loop(made).motion, mk.mirror(made)):
        assert map_rig(motion.skeleton).places == places
    mk.write(tmp_path / "made.vrma", made)
    assert (tmp_path / "made.vrma").exists()
