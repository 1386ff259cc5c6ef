"""The body that is shown: alike on both sides, fitted to rigs of any proportions, bending with their joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from motionkit.cli import outputs
from motionkit.cli.main import cli
from motionkit.errors import SkeletonError
from motionkit.export.formats import write_motion
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_from_yaw, quat_rotate, quat_to_matrix
from motionkit.rig.built_in import BUILT_IN, rig_file
from motionkit.rig.upright import in_metres
from motionkit.view.asset import BODIES, load_asset
from motionkit.view.body import BodyPose, make_body
from motionkit.view.surface import REGIONS, Surface
from synthetic_motions import make_cartwheel, make_walk


def built_in(name: str) -> Motion:
    """The rest pose of a built-in rig, in metres."""
    return in_metres(bvh_to_motion(read_bvh(rig_file(f"@{name}")))).motion


def region(surface: Surface, *names: str) -> np.ndarray:
    """Which points belong to some regions."""
    return np.isin(surface.regions, [REGIONS.index(name) for name in names])


@pytest.fixture(scope="module", params=BODIES)
def body(request: pytest.FixtureRequest) -> tuple[Surface, BodyPose]:
    """Each body on the canonical skeleton."""
    return make_body(in_metres(make_walk(2)).motion, body=request.param)


def test_an_asset_is_small_and_whole(body: tuple[Surface, BodyPose]) -> None:
    surface, pose = body
    assert 10_000 < len(surface.triangles) < 13_000
    assert set(surface.regions.tolist()) == set(range(len(REGIONS)))
    assert (surface.regions[surface.triangles] == surface.regions[surface.triangles[:, :1]]).all()
    assert surface.joints.shape == surface.weights.shape == (len(surface.points), 4)
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1.0, atol=1e-9)
    assert surface.weights.min() >= 0.0 and surface.joints.max() < len(pose.places)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-6)


def test_weights_pass_smoothly_from_joint_to_joint(body: tuple[Surface, BodyPose]) -> None:
    surface, pose = body
    whole = np.zeros((len(surface.points), len(pose.places)))
    for joints, weights in zip(surface.joints.T, surface.weights.T, strict=True):
        whole[np.arange(len(whole)), joints] += weights
    steps = np.abs(whole[surface.triangles[:, 0]] - whole[surface.triangles[:, 1]]).sum(axis=1)
    assert np.percentile(steps, 99) < 0.9


def test_both_sides_are_alike(body: tuple[Surface, BodyPose]) -> None:
    points = body[0].points
    middle = body[1].places[0, 0]
    for low, high in ((0.0, 0.3), (0.5, 0.8), (1.0, 1.3), (1.4, 1.8)):
        x = points[(points[:, 1] > low) & (points[:, 1] < high), 0] - middle
        assert x.max() == pytest.approx(-x.min(), abs=4e-3)


def test_the_pose_it_is_made_in_gives_it_back(body: tuple[Surface, BodyPose]) -> None:
    surface, pose = body
    same = surface.posed(pose.matrices_from(pose.rotations, pose.places))
    np.testing.assert_allclose(same, surface.points, atol=1e-9)
    assert surface.points[:, 1].min() == pytest.approx(0.0, abs=1e-9), "it stands on the floor"


def test_a_cartwheel_keeps_the_skin_near_its_bones(body: tuple[Surface, BodyPose]) -> None:
    surface, pose = body
    rotations, places = motion_kinematics(in_metres(make_cartwheel(40)).motion)
    matrices = quat_to_matrix(rotations).astype(np.float64)
    for turned, at in zip(matrices[::8], places[::8].astype(np.float64), strict=True):
        points = surface.posed(pose.matrices_from(turned, at))
        away = np.linalg.norm(points[:, None] - at[None], axis=-1).min(axis=1)
        assert away.max() < 0.36
        edges = np.concatenate([surface.triangles[:, [n, (n + 1) % 3]] for n in range(3)])
        now, made = (
            np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1) for p in (points, surface.points)
        )
        assert np.percentile(now - made, 99.9) < 0.04, "nothing tears"


@pytest.mark.parametrize("scale", [0.6, 1.0, 1.3])
@pytest.mark.parametrize("name", BUILT_IN)
def test_rigs_of_any_proportions_are_filled(name: str, scale: float) -> None:
    """Limbs reach the rig's joints, whatever their lengths; head and hands keep the size of the whole."""
    rig = built_in(name)
    offsets = rig.skeleton.offsets.copy()
    longer = [j for j, joint in enumerate(rig.skeleton.names) if "arm" in joint.lower()]
    offsets[longer] *= scale
    rig = replace(rig, skeleton=replace(rig.skeleton, offsets=offsets))
    surface, pose = make_body(rig)
    plain, _ = make_body(built_in(name))
    for end in ("Hand", "hand_l", "LeftHand", "leftHand", "mixamorig:LeftHand", "foot_l", "LeftFoot"):
        if end in rig.skeleton.names:
            place = pose.places[rig.skeleton.names.index(end)]
            assert np.linalg.norm(surface.points - place, axis=1).min() < 0.06
    skin = region(surface, "Hair")
    assert np.ptp(surface.points[skin], axis=0) == pytest.approx(np.ptp(plain.points[skin], axis=0), rel=0.05)
    head = surface.points[region(surface, "Hair", "Eyes")]
    assert head[:, 1].max() > surface.points[region(surface, "Shirt"), 1].max() + 0.1


@pytest.mark.parametrize("name", ["mixamo", "unreal", "vrm"])
def test_fingers_follow_their_joints(name: str) -> None:
    rig = built_in(name)
    surface, _ = make_body(rig)
    fingers = [j for j, joint in enumerate(rig.skeleton.names) if "index" in joint.lower()]
    assert len(fingers) >= 6 and set(fingers) <= set(surface.joints[surface.weights > 0.5].tolist())


def test_a_rest_pose_with_z_up_gives_a_standing_body() -> None:
    rig = built_in("mixamo")
    laid = rig.skeleton.offsets[:, [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    other = replace(rig, skeleton=replace(rig.skeleton, offsets=laid, end_sites={}))
    standing = make_body(replace(rig, skeleton=replace(rig.skeleton, end_sites={})))[0]
    surface, _ = make_body(other)
    assert np.ptp(surface.points, axis=0) == pytest.approx(np.ptp(standing.points, axis=0), abs=2e-3)
    assert surface.points[:, 1].min() == pytest.approx(0.0, abs=1e-9)


def test_a_body_faces_where_the_rig_does() -> None:
    """A rest pose that is turned about the vertical gives the turned body."""
    rig, quarter = built_in("mixamo"), quat_from_yaw(np.array(np.pi / 2, np.float32))
    straight = replace(rig, skeleton=replace(rig.skeleton, end_sites={}))
    turned = quat_rotate(quarter, rig.skeleton.offsets)
    other = replace(straight, skeleton=replace(straight.skeleton, offsets=turned))
    first, second = (make_body(motion)[0] for motion in (straight, other))
    np.testing.assert_allclose(
        quat_rotate(quarter.astype(np.float64), first.points), second.points, atol=2e-3
    )


def test_loaded_bodies_are_shared_and_unknown_ones_are_not_read() -> None:
    assert load_asset(BODIES[0]) is load_asset(BODIES[0])
    heights = [load_asset(name).points[:, 1].max() for name in BODIES]
    assert all(1.6 < height < 1.9 for height in heights)


def test_legs_without_length_leave_bones_to_draw() -> None:
    walk = make_walk(2)
    legs = [
        walk.skeleton.names.index(f"{side}{part}")
        for side in ("Left", "Right")
        for part in ("Leg", "Foot", "ToeBase")
    ]
    offsets = walk.skeleton.offsets.copy()
    offsets[legs] = 0.0
    flat = replace(walk, skeleton=replace(walk.skeleton, offsets=offsets, end_sites={}))
    surface, _ = make_body(in_metres(flat).motion)
    assert len(surface.points) and np.isfinite(surface.points).all()


def test_bones_without_length_are_refused() -> None:
    walk = make_walk(2)
    with pytest.raises(SkeletonError, match="all bones have length zero"):
        make_body(replace(walk, skeleton=walk.skeleton.scaled(0.0)))


def test_the_command_line_offers_the_bodies_that_are_there() -> None:
    """Their names are there twice, as the module that reads bodies is slow to import."""
    assert outputs.BODIES == BODIES


@pytest.mark.parametrize("ending", [".glb", ".usda", ".html"])
def test_a_chosen_body_is_written(ending: str, tmp_path: Path) -> None:
    write_motion(tmp_path / "walk.bvh", make_walk(4))
    sizes = set()
    for name in BODIES:
        words = [str(tmp_path / "walk.bvh"), str(tmp_path / f"{name}{ending}"), "--body", name]
        words = (
            ["convert", *words] if ending != ".html" else ["view", "--no-open", words[0], "-o", *words[1:]]
        )
        result = CliRunner().invoke(cli, words)
        assert result.exit_code == 0, result.output
        sizes.add((tmp_path / f"{name}{ending}").stat().st_size)
    assert len(sizes) == len(BODIES)
