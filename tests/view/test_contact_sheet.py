"""Contact sheets: what is measured for them, and that every kind of motion can be drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import LEG_TO_STATURE, Skeleton, canonical_skeleton, leg_length
from motionkit.view.contact_sheet import contact_sheet, pose_frames, write_contact_sheet
from motionkit.view.contact_sheet_geometry import (
    BALL,
    camera_angle,
    low_frames,
    motion_figure,
    screen_points,
    sliding_frames,
)
from motionkit.view.figure_data import MotionView, figure_data
from synthetic_motions import make_walk

pytest.importorskip("PIL")


def standing(frames: int = 40, travel: float = 0.0) -> Motion:
    """The rest pose on the floor, pushed along X by travel cm a frame."""
    skeleton = canonical_skeleton()
    height = -float(skeleton.rest_positions()[:, 1].min())
    root = np.zeros((frames, 3), np.float32)
    root[:, 0] = np.arange(frames) * travel
    root[:, 1] = height
    return Motion(skeleton, quat_identity((frames, len(skeleton))), root, 60.0)


def test_poses_are_spread_from_first_to_last() -> None:
    assert pose_frames(101, 5) == [0, 25, 50, 75, 100]
    assert pose_frames(3, 12) == [0, 1, 2]
    assert pose_frames(10, 12, every=4) == [0, 4, 8]
    with pytest.raises(MotionkitError, match="at most 480"):
        pose_frames(10_000, every=1)


def test_a_standing_body_is_measured() -> None:
    figure = motion_figure(standing())
    assert figure.unit() == ("cm", 1.0)
    assert 150 < figure.stature < 200
    assert figure.floor_is_zero
    assert set(figure.feet) == {"left", "right"}
    np.testing.assert_allclose(figure.facing, np.pi / 2, atol=1e-4)  # +Z
    assert not sliding_frames(figure, figure.feet["left"]).any()


def test_the_stature_is_that_of_the_legs() -> None:
    """Props and helper joints far from the body do not raise the height below which a moving foot slides."""
    bare = standing(travel=3.0)
    skeleton = bare.skeleton
    far = Skeleton(
        (*skeleton.names, "Sword", "Helper"),
        (*skeleton.parents, skeleton.index("RightHand"), 0),
        np.concatenate([skeleton.offsets, np.array([[0.0, 0.0, 150.0], [0.0, 200.0, 0.0]], np.float32)]),
        skeleton.end_sites,
    )
    armed = replace(bare, skeleton=far, local_rotations=quat_identity((len(bare), len(far))))
    assert motion_figure(armed).stature == pytest.approx(motion_figure(bare).stature)
    assert motion_figure(bare).stature == pytest.approx(leg_length(skeleton) / LEG_TO_STATURE)


def test_a_foot_without_toes_is_looked_at_where_they_would_be() -> None:
    """Its ankle moves while the heel rises and the ball of the foot stands."""
    body = standing()
    names, offsets = body.skeleton.names, body.skeleton.offsets
    bare = body.skeleton.picked([i for i, name in enumerate(names) if not name.endswith("ToeBase")])
    toes = {side: offsets[names.index(f"{side}ToeBase")] for side in ("Left", "Right")}
    ends = {bare.index(f"{side}Foot"): tuple((toe / BALL).tolist()) for side, toe in toes.items()}
    bare = replace(bare, end_sites=bare.end_sites | ends)
    cut = replace(body, skeleton=bare, local_rotations=quat_identity((len(body), len(bare))))
    whole, figure = motion_figure(body), motion_figure(cut)
    for side, foot in figure.feet.items():
        expected = whole.positions[:, whole.feet[side]]
        np.testing.assert_allclose(figure.positions[:, foot], expected, atol=1e-3)
    joints = [bare.names[foot["joint"]] for foot in figure_data(MotionView("cut", cut))["feet"]]
    assert joints == ["LeftFoot", "RightFoot"]


def test_helper_bones_are_no_part_of_the_figure() -> None:
    """A root that stays on the floor carries targets of feet and hands: the picture is that of the body alone."""
    walk = make_walk(60)
    own, helpers = walk.skeleton, ("root", "ik_foot_root", "ik_foot_l", "ik_foot_r", "ik_hand_gun")
    offsets = np.float32([[0, 0, 0], [0, 0, 0], [10, 8, 0], [-10, 8, 0], [-50, 110, 0], *own.offsets])
    parents = (-1, 0, 1, 1, 0, 0, *(parent + 5 for parent in own.parents[1:]))
    ends = {joint + 5: end for joint, end in own.end_sites.items()} | {4: (0.0, 0.0, 10.0)}
    rotations = np.concatenate([quat_identity((60, 5)), walk.local_rotations], axis=1)
    places = np.broadcast_to(offsets, (60, len(offsets), 3)).copy()
    places[:, 5] = walk.root_positions
    skeleton = Skeleton(helpers + own.names, parents, offsets, ends)
    found = motion_figure(Motion(skeleton, rotations, places[:, 0], 60.0, places))
    alone = motion_figure(walk)
    assert found.hips == 5 and np.allclose(found.root, alone.root, atol=1e-3)
    assert len(found.bones) == len(alone.bones) and found.floor == alone.floor
    assert np.allclose(found.positions.max(axis=1), alone.positions.max(axis=1), atol=1e-3)
    assert np.allclose(found.positions.min(axis=1), alone.positions.min(axis=1), atol=1e-3)


@pytest.mark.parametrize(
    ("end", "share"),
    [
        ((0.0, 22.0, 0.0), 0.575),
        ((0.0, 20.0, 9.0), 0.575),
        ((0.0, 8.0, 0.0), 0.0),
        ((18.0, -2.0, 0.0), 0.0),
        ((0.0, 60.0, 0.0), 0.0),
    ],
)
def test_a_head_reaches_its_top(end: tuple[float, float, float], share: float) -> None:
    """A skull below the top that continues the neck; around the joint if the top is near, sideways or a plume."""
    motion = standing()
    head = motion.skeleton.index("Head")
    ends = motion.skeleton.end_sites | {head: end}
    figure = motion_figure(replace(motion, skeleton=replace(motion.skeleton, end_sites=ends)))
    assert figure.skull is not None and figure.head == head
    middle = figure.positions[:, figure.skull] - figure.positions[:, head]
    assert np.allclose(middle, share * np.array(end), atol=0.2)


def test_pushed_feet_slide_and_lifted_feet_do_not() -> None:
    pushed = motion_figure(standing(travel=3.0))
    foot = pushed.feet["left"]
    assert sliding_frames(pushed, foot).all()
    lifted = standing(travel=3.0)
    up = np.where(np.arange(40) >= 20, 30.0, 0.0)
    root = lifted.root_positions + up[:, None] * np.array([0.0, 1.0, 0.0], np.float32)
    flying = motion_figure(replace(lifted, root_positions=root))
    assert not low_frames(flying, foot)[20:].any() and not sliding_frames(flying, foot)[20:].any()


def test_a_floating_body_keeps_the_floor_at_zero() -> None:
    motion = standing()
    floating = replace(motion, root_positions=motion.root_positions + np.array([0.0, 25.0, 0.0], np.float32))
    figure = motion_figure(floating)
    assert figure.floor == 0.0
    assert figure.positions[..., 1].min() > 20.0


def test_z_up_rigs_stand_up() -> None:
    motion = standing()
    turn = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0], np.float32)  # a quarter turn about X: Y becomes Z
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = turn
    root = motion.root_positions[:, [0, 2, 1]]
    figure = motion_figure(replace(motion, local_rotations=rotations, root_positions=root))
    np.testing.assert_allclose(figure.positions, motion_figure(motion).positions, atol=1e-3)


def test_a_walk_runs_from_left_to_right_on_the_screen() -> None:
    figure = motion_figure(standing(travel=-4.0))
    screen = screen_points(figure.root, camera_angle(figure))
    assert screen[-1, 0] - screen[0, 0] > 0.9 * 39 * 4.0


def test_sheets_have_the_width_asked_for_and_ink(tmp_path: Path) -> None:
    picture = contact_sheet([("a", standing(travel=2.0)), ("b", standing(frames=1))], poses=20, width=900)
    assert picture.width == 900
    assert np.asarray(picture).std() > 5
    write_contact_sheet(tmp_path / "sheet.png", [("a", standing())])
    assert [p.name for p in tmp_path.iterdir()] == ["sheet.png"]


def test_left_is_blue_and_right_is_orange() -> None:
    pixels = np.asarray(contact_sheet([("a", standing())], poses=1, width=800)).astype(int)
    figures = pixels[46:280]
    blue = (figures[..., 2] - figures[..., 0] > 100).sum()
    orange = (figures[..., 0] - figures[..., 2] > 100).sum()
    assert blue > 200 and orange > 200


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_any_rig_without_sides_names_or_size_can_be_drawn(scale: float) -> None:
    skeleton = Skeleton(
        ("a", "b", "c"), (-1, 0, 1), np.array([[0.0, 0, 0], [0, 1, 0], [0, 1, 1]], np.float32) * scale
    )
    motion = Motion(skeleton, quat_identity((5, 3)), np.zeros((5, 3), np.float32), 30.0)
    assert contact_sheet([("worm", motion)], width=700).height > 100


def test_a_single_joint_can_be_drawn() -> None:
    skeleton = Skeleton(("only",), (-1,), np.zeros((1, 3), np.float32))
    motion = Motion(skeleton, quat_identity((4, 1)), np.zeros((4, 3), np.float32), 30.0)
    assert contact_sheet([("point", motion)]).height > 100


def test_faults_are_told(tmp_path: Path) -> None:
    with pytest.raises(MotionkitError, match="at least one motion"):
        contact_sheet([])
    with pytest.raises(MotionkitError, match=r"\.png"):
        write_contact_sheet(tmp_path / "sheet.gif", [("a", standing())])
    with pytest.raises(MotionkitError, match="at least 600"):
        contact_sheet([("a", standing())], width=100)


def test_someone_who_stays_is_seen_from_the_front() -> None:
    figure = motion_figure(standing())
    screen = screen_points(figure.positions[0], camera_angle(figure))
    skeleton = canonical_skeleton()
    toe, ankle = skeleton.index("LeftToeBase"), skeleton.index("LeftFoot")
    assert screen[toe, 2] > screen[ankle, 2]
