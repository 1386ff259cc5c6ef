"""The skin of a body: one piece, alike on both sides, that bends without leaving its joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.errors import SkeletonError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_to_matrix
from motionkit.rig.upright import in_metres
from motionkit.view.body import BodyPose, make_body
from motionkit.view.isosurface import isosurface
from motionkit.view.surface import Surface, point_normals
from synthetic_motions import make_cartwheel, make_walk


@pytest.fixture(scope="module")
def body() -> tuple[Surface, BodyPose]:
    """The body of the canonical skeleton."""
    return make_body(in_metres(make_walk(2)).motion)


def pieces(surface: Surface) -> int:
    """How many connected pieces a mesh has."""
    group = np.arange(len(surface.points))
    while True:
        least = group.copy()
        for a in range(3):
            np.minimum.at(least, surface.triangles[:, a], group[surface.triangles].min(axis=1))
        if (least == group).all():
            return len(np.unique(group))
        group = least


def test_a_body_is_one_piece(body: tuple[Surface, BodyPose]) -> None:
    assert pieces(body[0]) == 1


def test_four_weights_that_add_up(body: tuple[Surface, BodyPose]) -> None:
    surface, pose = body
    assert surface.joints.shape == surface.weights.shape == (len(surface.points), 4)
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1.0, atol=1e-12)
    assert surface.weights.min() >= 0.0 and surface.joints.max() < len(pose.places)
    np.testing.assert_allclose(surface.tints.sum(axis=1), 1.0, atol=1e-9)


def test_weights_pass_smoothly_from_joint_to_joint(body: tuple[Surface, BodyPose]) -> None:
    """Along no edge of the mesh, about a centimetre and a half long, do they change at once."""
    surface, pose = body
    whole = np.zeros((len(surface.points), len(pose.places)))
    np.put_along_axis(whole, surface.joints, surface.weights, axis=1)
    steps = np.abs(whole[surface.triangles[:, 0]] - whole[surface.triangles[:, 1]]).sum(axis=1)
    assert steps.max() < 0.9 and np.percentile(steps, 99) < 0.5


def test_a_coarse_body_has_the_same_shape(body: tuple[Surface, BodyPose]) -> None:
    fine = body[0].points
    coarse = make_body(in_metres(make_walk(2)).motion, step=0.02)[0].points
    assert len(coarse) < 0.6 * len(fine)
    np.testing.assert_allclose(np.ptp(coarse, axis=0), np.ptp(fine, axis=0), atol=0.02)


def test_both_sides_are_alike(body: tuple[Surface, BodyPose]) -> None:
    points = body[0].points
    for low, high in ((-0.6, -0.3), (0.1, 0.4), (0.5, 0.7)):
        heights = points[(points[:, 1] > low) & (points[:, 1] < high)]
        assert heights[:, 0].max() == pytest.approx(-heights[:, 0].min(), abs=2e-3)


def test_the_pose_it_is_made_in_gives_it_back(body: tuple[Surface, BodyPose]) -> None:
    surface, pose = body
    same = surface.posed(pose.matrices_from(pose.rotations, pose.places))
    np.testing.assert_allclose(same, surface.points, atol=1e-9)
    world = np.broadcast_to(np.eye(4), (len(pose.places), 4, 4)).copy()
    world[:, :3, :3], world[:, :3, 3] = pose.rotations, pose.places
    product = world @ pose.inverse_matrices()
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(4), product.shape), atol=1e-9)


def test_a_cartwheel_keeps_the_skin_near_its_bones(body: tuple[Surface, BodyPose]) -> None:
    surface, pose = body
    motion = in_metres(make_cartwheel(40)).motion
    rotations, places = motion_kinematics(motion)
    matrices = quat_to_matrix(rotations).astype(np.float64)
    for turned, at in zip(matrices[::8], places[::8].astype(np.float64), strict=True):
        points = surface.posed(pose.matrices_from(turned, at))
        away = np.linalg.norm(points[:, None] - at[None], axis=-1).min(axis=1)
        assert away.max() < 0.32
        normals = point_normals(points, surface.triangles)
        assert np.isfinite(normals).all() and (np.linalg.norm(normals, axis=1) > 0.5).all()


def test_a_ball_on_a_grid() -> None:
    axes = np.meshgrid(*(np.arange(24.0) - 11.6,) * 3, indexing="ij")
    points, triangles = isosurface(np.linalg.norm(np.stack(axes, axis=-1), axis=-1) - 8.0)
    assert np.abs(np.linalg.norm(points - 11.6, axis=1) - 8.0).max() < 0.15
    a, b, c = (points[triangles[:, n]] for n in range(3))
    volume = float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)
    assert volume == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.02)


def test_where_two_balls_touch_the_surface_stays_whole() -> None:
    values = np.ones((6, 6, 6))
    values[2, 2, 2] = values[3, 3, 2] = -1.0  # two corners that meet at an edge only
    _, triangles = isosurface(values)
    edges = np.concatenate([triangles[:, [n, (n + 1) % 3]] for n in range(3)])
    ways = {tuple(edge) for edge in edges.tolist()}
    assert len(ways) == len(edges) and all((b, a) in ways for a, b in ways)


def test_the_body_of_another_clip_is_made_once_and_of_another_rig_anew() -> None:
    motion = in_metres(make_walk(2)).motion
    first, pose = make_body(motion)
    assert make_body(in_metres(make_walk(5)).motion)[0] is first and not first.points.flags.writeable
    taller = make_body(motion.scaled(1.1))[0]
    assert taller is not first and taller.points[:, 1].max() > first.points[:, 1].max() + 0.05
    assert make_body(motion, step=0.03)[0] is not first
    assert np.array_equal(pose.places, make_body(motion)[1].places)


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
