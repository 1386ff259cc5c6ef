"""What pages get: packed numbers, metres with Y up, and a body for any rig."""

from __future__ import annotations

import base64
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_identity,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.upright import in_metres
from motionkit.view.body import make_body
from motionkit.view.figure_data import MotionView, figure_data, pack
from motionkit.view.surface import REGIONS, Surface
from synthetic_motions import make_walk

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"


def unpack(field: dict) -> np.ndarray:
    """The numbers back, as the page reads them."""
    kind = {"f4": "<f4", "i2": "<i2", "i1": "<i1", "u2": "<u2", "u1": "<u1"}[field["type"]]
    flat = np.frombuffer(zlib.decompress(base64.b64decode(field["data"])), kind).reshape(field["shape"])
    return flat if kind == "<f4" else np.cumsum(flat, axis=0, dtype=kind)


def body_of(motion: Motion) -> tuple[Surface, np.ndarray]:
    """The body of a motion in metres, and its points (T, V, 3) over time."""
    surface, pose = make_body(motion)
    turns, places = motion_kinematics(motion)
    matrices = quat_to_matrix(turns).astype(np.float64)
    moved = [
        surface.posed(pose.matrices_from(r, p))
        for r, p in zip(matrices, places.astype(np.float64), strict=True)
    ]
    return surface, np.array(moved)


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """The volume inside a closed surface, positive when it faces outward."""
    a, b, c = (points[triangles[:, n]] for n in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def dog(frames: int = 3) -> Motion:
    """A rig that is no human: a spine, four legs, a tail and a head."""
    names = [
        "root",
        "spine",
        "head",
        "tail",
        "legFL",
        "pawFL",
        "legFR",
        "pawFR",
        "legBL",
        "pawBL",
        "legBR",
        "pawBR",
    ]
    parents = (-1, 0, 1, 0, 1, 4, 1, 6, 0, 8, 0, 10)
    offsets = [(0, 0, 0), (0, 0, 50), (0, 20, 20), (0, 5, -30)]
    for x, z in ((8, 0), (-8, 0), (8, -5), (-8, -5)):
        offsets += [(x, -5, z), (0, -40, 0)]
    skeleton = Skeleton(tuple(names), parents, np.array(offsets, np.float32), {2: (0.0, 0.0, 12.0)})
    roots = np.broadcast_to(np.array([[0.0, 45.0, 0.0]], np.float32), (frames, 3))
    return Motion(skeleton, quat_identity((frames, len(names))), roots, 30.0)


@pytest.mark.parametrize("kind", ["i2", "i1", "u2", "u1", "f4"])
def test_packing_keeps_numbers(kind: str) -> None:
    top = {"i2": 32767, "i1": 127, "u2": 65535, "u1": 255, "f4": 9}[kind]
    low = -top if kind in ("i2", "i1", "f4") else 0
    values = np.random.default_rng(3).integers(low, top, size=(40, 3), endpoint=True)
    np.testing.assert_array_equal(unpack(pack(values, kind)), values)


def test_frames_survive_packing() -> None:
    motion = make_walk(90)
    data = figure_data(MotionView("walk", motion))
    rotations = unpack(data["rotations"]).astype(np.float64)
    rotations = rotations / np.linalg.norm(rotations, axis=-1, keepdims=True)
    kept = replace(
        motion,
        local_rotations=rotations,
        root_positions=unpack(data["roots"]).astype(np.float64) / data["scale"],
    )
    error = np.abs(motion_kinematics(kept)[1] - motion_kinematics(motion)[1]).max()
    assert float(error) < 0.1, f"{float(error):.3f} cm"


@pytest.mark.parametrize("factor", [1.0, 0.01, 10.0, 0.45 / 2.54])
def test_units_are_guessed(factor: float) -> None:
    motion = make_walk(30)
    names = [f"x:{name}" for name in motion.skeleton.names]  # not our own file, whose unit is known
    motion = replace(motion, skeleton=replace(motion.skeleton, names=tuple(names))).scaled(factor)
    made = in_metres(motion)
    metres, scale = made.motion, made.scale
    assert scale == pytest.approx(0.01 / factor, rel=1e-3)
    _, points = body_of(metres)
    assert 1.55 < np.ptp(points[0, :, 1]) < 1.9


def test_z_up_is_turned_upright() -> None:
    motion = make_walk(60)
    quarter = np.broadcast_to(expmap_to_quat(np.array([np.pi / 2, 0.0, 0.0], np.float32)), (60, 4))
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(quarter, rotations[:, 0])
    tilted = replace(
        motion, local_rotations=rotations, root_positions=quat_rotate(quarter, motion.root_positions)
    )
    for given, expected in zip(
        *(motion_kinematics(in_metres(m).motion)[1] for m in (tilted, motion)), strict=True
    ):
        np.testing.assert_allclose(given, expected, atol=1e-4, rtol=0)


def snake(length: float, up: int, height: float) -> Motion:
    """A rig of eight joints without sense in their names, along the last axis, at a height of another one."""
    offsets = np.zeros((8, 3), np.float32)
    offsets[1:, 2] = length / 7
    root = np.zeros((4, 3), np.float32)
    root[:, up] = height
    skeleton = Skeleton(tuple(f"j{i}" for i in range(8)), tuple(range(-1, 7)), offsets)
    return Motion(skeleton, quat_identity((4, 8)), root, 30.0)


def test_what_is_no_human_keeps_its_size_and_its_axes() -> None:
    for given, unit in ((snake(70.0, 1, 5.0), 0.01), (dog(), 0.01), (snake(0.7, 1, 0.05), 1.0)):
        made = in_metres(given)
        assert made.scale == unit and "no human rig" in made.note and "Z up" not in made.note
        expected = motion_kinematics(given)[1] * unit
        np.testing.assert_allclose(motion_kinematics(made.motion)[1], expected, atol=1e-5)
    assert in_metres(snake(70.0, 1, -35.0)).note.endswith("Z up"), (
        "it stands on the ground of Z, not far below that of Y"
    )


@pytest.mark.parametrize("source", ["walk", "16_05", "dog"])
def test_bodies_are_of_human_size(source: str) -> None:
    motion = {"walk": lambda: make_walk(60), "dog": dog}.get(
        source, lambda: bvh_to_motion(read_bvh(DATA / f"{source}.bvh")).cut(0, 60)
    )()
    metres = in_metres(motion).motion
    surface, points = body_of(metres)
    litres = 1000 * volume(points[0], surface.triangles)
    assert (40 < litres < 110) if source != "dog" else litres > 0
    assert np.isfinite(points).all()


def test_a_standing_body_touches_the_floor_and_has_all_its_parts() -> None:
    metres = in_metres(make_walk(60)).motion
    surface, points = body_of(metres)
    assert set(surface.regions.tolist()) == set(range(len(REGIONS)))
    lowest = points[..., 1].min(axis=1)
    assert np.abs(lowest).max() < 0.05, "soles near the floor in every frame of a walk"
    head = points[:, surface.regions == REGIONS.index("Hair"), 1].max(axis=1)
    assert (head == points[..., 1].max(axis=1)).all(), "the head is on top"


def test_a_rest_pose_without_sense_gives_the_same_body() -> None:
    """All bones along one axis at rest: the body is made in a frame that shows it."""
    motion = in_metres(make_walk(40)).motion
    turns, places = motion_kinematics(motion)
    lengths = np.linalg.norm(motion.skeleton.offsets, axis=-1)
    straight = np.stack([np.zeros(23, np.float32), lengths, np.zeros(23, np.float32)], axis=-1)
    rig = replace(motion.skeleton, offsets=straight, end_sites={})
    # The same places, frame by frame, by joints that translate.
    from motionkit.motion.rotations import quat_inverse

    parents = list(motion.skeleton.parents)
    local = np.zeros_like(places)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[:, joint] = quat_rotate(
                quat_inverse(turns[:, parent]), places[:, joint] - places[:, parent]
            )
    moved = replace(motion, skeleton=rig, local_positions=local)
    _, points = body_of(moved)
    assert 1.5 < np.ptp(points[0, :, 1]) < 1.9


def test_a_single_joint_is_drawn() -> None:
    lone = Skeleton(("box",), (-1,), np.zeros((1, 3), np.float32))
    motion = Motion(lone, quat_identity((4, 1)), np.zeros((4, 3), np.float32), 30.0)
    data = figure_data(MotionView("box", motion))
    assert data["body"]["points"]["shape"][0] > 0 and data["frames"] == 4
