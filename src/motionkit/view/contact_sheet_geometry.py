"""Geometry of a contact sheet: positions with axis 1 up, camera, floor and feet."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import normalized
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_rotate
from motionkit.rig.sides import joint_sides
from motionkit.rig.units import motion_unit, rig_places, stature, unit_of
from motionkit.rig.up_axis import up_axis, up_turn

Array = NDArray[np.float64]

# A foot slides if it is lower than LOW_SHARE of the stature and faster along the floor than SLIDE_SHARE statures per
# second: 4 cm and 0.5 m/s for a person of 1.75 m.
LOW_SHARE = 0.025
SLIDE_SHARE = 0.28
FOOT_SHARE = 0.06  # of the stature; toes alone are shorter than this, feet longer
BALL = 0.65  # from the ankle to the end of a foot
# Share of the stature. A joint whose distance to its parent varies by more has no bone, such as hips below a root that
# stays on the floor.
LOOSE_SHARE = 0.2
HEAD_RADIUS, TALLEST_HEAD = 0.055, 0.2  # shares of the stature
UPWARD = 0.5  # cosine between neck and skull; the ends of some heads point sideways


@dataclass(frozen=True, eq=False)
class Figure:
    """A motion as world points and bones.

    Attributes:
        positions: (T, N, 3) joints, then end sites, balls of feet and, if there is a head, its middle; axis 1 is up.
            Joints that are no part of the body of a human rig are at the hips.
        bones: pairs of point indices, parent first.
        sides: "left", "right" or "" for each point.
        hips: index of the point that is drawn as the root.
        head: index of the head's joint, or None.
        feet: side -> index of the foot's point: its toes, or the ball of a foot without toes.
        floor: height of the ground line.
        floor_is_zero: whether the floor is at zero; else it is at the lowest point of the body.
        facing: (T,) heading in the ground plane in radians, atan2 of axis 2 and axis 0.
        stature: estimated standing height, in the motion's unit.
        cm: cm per unit.
        fps: frames per second.
    """

    positions: Array
    bones: tuple[tuple[int, int], ...]
    sides: tuple[str, ...]
    hips: int
    head: int | None
    feet: dict[str, int]
    floor: float
    floor_is_zero: bool
    facing: Array
    stature: float
    cm: float
    fps: float

    @property
    def root(self) -> Array:
        """Positions (T, 3) of the root; of the hips if the root stays on the floor."""
        return self.positions[:, self.hips]

    @property
    def skull(self) -> int | None:
        """Index of the middle of the head; the joint lies there, or where the neck ends."""
        return None if self.head is None else self.positions.shape[1] - 1

    def unit(self) -> tuple[str, float]:
        """The motion's unit: its symbol and its length in cm."""
        return unit_of(self.cm).symbol, self.cm


def motion_figure(motion: Motion) -> Figure:
    """The points and bones of a motion, turned so that axis 1 is up."""
    skeleton = motion.skeleton
    rotations, positions = motion_kinematics(motion)
    ends = sorted(skeleton.end_sites)
    tips = [
        positions[:, j] + quat_rotate(rotations[:, j], np.array(skeleton.end_sites[j], np.float32))
        for j in ends
    ]
    points = np.stack([*np.moveaxis(positions, 1, 0), *tips], axis=1).astype(np.float64)
    points = quat_rotate(up_turn(up_axis(positions, skeleton)), points)
    count = len(skeleton)
    bones = [(parent, joint) for joint, parent in enumerate(skeleton.parents) if parent >= 0]
    bones += [(joint, count + n) for n, joint in enumerate(ends)]
    size, places = stature(motion), rig_places(skeleton)
    sides = joint_sides(skeleton.names)
    points_sides = sides + tuple(sides[joint] for joint in ends)
    feet = _feet(places, skeleton.names, sides, points)
    for side, ball in _balls(places, ends, points, size).items():
        feet[side], points_sides = points.shape[1], (*points_sides, side)
        points = np.concatenate([points, ball[:, None]], axis=1)
    head = _head(places, skeleton.names)
    if head is not None:
        below = [end for start, end in bones if start == head]
        neck = max(skeleton.parents[head], 0)
        points = np.concatenate([points, _skull(points, neck, head, below, size)[:, None]], axis=1)
        points_sides = (*points_sides, "")
    own = _of_body(places, skeleton.parents)
    outside = [number for number, joint in enumerate([*range(count), *ends]) if not own[joint]]
    floor, floor_is_zero = _floor(np.delete(points, outside, axis=1), size)
    hips = _hips(points, skeleton.parents, places.get("Hips", 0), floor, size)
    base = _chain(hips, skeleton.parents)  # bones from the floor to the hips do not belong to the body
    points[:, outside] = points[:, [hips]]
    return Figure(
        points,
        tuple(
            bone
            for bone in bones
            if not _is_loose(points, bone, size) and bone[1] not in base and bone[1] not in outside
        ),
        points_sides,
        hips,
        head,
        feet,
        floor,
        floor_is_zero,
        _facing(points, sides),
        size,
        motion_unit(motion)[0],
        motion.fps,
    )


def _is_loose(points: Array, bone: tuple[int, int], stature: float) -> bool:
    lengths = np.linalg.norm(points[:, bone[1]] - points[:, bone[0]], axis=-1)
    return bool(np.ptp(lengths) > LOOSE_SHARE * stature)


def _floor(points: Array, stature: float) -> tuple[float, bool]:
    lowest = float(np.percentile(points[..., 1].min(axis=1), 5))
    near_zero = abs(lowest) < 0.3 * stature
    return (0.0, True) if near_zero else (lowest, False)


def _of_body(places: dict[str, int], parents: tuple[int, ...]) -> list[bool]:
    """Whether each joint is one of the bone map or hangs from one; helpers of a rig, such as ik_foot_l, do not."""
    mapped, own = set(places.values()), list[bool]()
    for joint, parent in enumerate(parents):
        own.append("Hips" not in places or joint in mapped or (parent >= 0 and own[parent]))
    return own


def _chain(joint: int, parents: tuple[int, ...]) -> set[int]:
    """The joints from the root to this one."""
    found = set()
    while joint >= 0:
        found.add(joint)
        joint = parents[joint]
    return found


def _hips(points: Array, parents: tuple[int, ...], hips: int, floor: float, stature: float) -> int:
    """The first joint above the floor, found by following single children from the root, or the hips of the map."""
    first = hips
    while points[:, hips, 1].mean() - floor < 0.2 * stature:
        below = [joint for joint, parent in enumerate(parents) if parent == hips]
        if len(below) != 1:
            return first
        hips = below[0]
    return hips


def _head(places: dict[str, int], names: tuple[str, ...]) -> int | None:
    """The head of the bone map; without one the last joint whose name says head, or neck."""
    if "Head" in places:
        return places["Head"]
    heads = [i for i, name in enumerate(names) if re.search(r"head(?!.*(end|nub|top))", name, re.IGNORECASE)]
    necks = [i for i, name in enumerate(names) if re.search(r"neck", name, re.IGNORECASE)]
    found = heads or necks
    return found[-1] if found else None


def _skull(points: Array, neck: int, head: int, below: list[int], stature: float) -> Array:
    """The middle (T, 3) of a head of HEAD_RADIUS whose top is the furthest end that goes on from the neck."""
    up, middle = normalized(points[:, head] - points[:, neck]), points[:, head]
    furthest = HEAD_RADIUS * stature
    for end in below:
        bone = points[:, end] - points[:, head]
        size = float(np.linalg.norm(bone[0]))
        if furthest < size < TALLEST_HEAD * stature and np.median((up * normalized(bone)).sum(-1)) > UPWARD:
            furthest, middle = size, points[:, head] + (1.0 - HEAD_RADIUS * stature / size) * bone
    return middle


def _feet(
    places: dict[str, int], names: tuple[str, ...], sides: tuple[str, ...], points: Array
) -> dict[str, int]:
    """For each side its toe or foot of the bone map; without one the lowest joint whose name says so, or of all."""
    mapped = {
        side.lower(): places.get(f"{side}ToeBase", places.get(f"{side}Foot")) for side in ("Left", "Right")
    }
    feet = {side: joint for side, joint in mapped.items() if joint is not None}
    if len(feet) == len(mapped):
        return feet
    feet = {}
    heights = points[:, : len(names), 1].mean(axis=0)
    for side in sorted(set(sides) - {""}) or [""]:
        on_side = [i for i, s in enumerate(sides) if s == side]
        for pattern in (r"toe(?!.*(end|nub))", r"foot|ankle|talus", r""):
            found = [i for i in on_side if re.search(pattern, names[i], re.IGNORECASE)]
            if found:
                feet[side] = min(found, key=lambda i: (round(float(heights[i]), 3), i))
                break
    return feet


def _balls(places: dict[str, int], ends: list[int], points: Array, stature: float) -> dict[str, Array]:
    """The balls (T, 3) of feet without toes, whose ankles move while the balls stand; only of bones as long as feet."""
    first, out = points.shape[1] - len(ends), {}
    for side in ("Left", "Right"):
        foot = places.get(f"{side}Foot")
        if foot not in ends or f"{side}ToeBase" in places:
            continue
        bone = points[:, first + ends.index(foot)] - points[:, foot]
        if np.linalg.norm(bone[0]) > FOOT_SHARE * stature:
            out[side.lower()] = points[:, foot] + BALL * bone
    return out


def _facing(points: Array, sides: tuple[str, ...]) -> Array:
    """The heading (T,) in radians: perpendicular to the line between left and right joints."""
    left = [i for i, side in enumerate(sides) if side == "left"]
    right = [i for i, side in enumerate(sides) if side == "right"]
    if not left:
        return np.zeros(len(points))
    across = points[:, left].mean(axis=1) - points[:, right].mean(axis=1)
    return np.arctan2(across[:, 0], -across[:, 2])


def camera_angle(figure: Figure) -> float:
    """Direction of the screen's x axis in the ground plane, in radians, for the best view of the body.

    A travelling body is seen from the side, a body in place at an angle from the front. Both are turned a little
    towards the viewer, so that left and right do not cover each other.
    """
    ground = figure.root[:, [0, 2]]
    steps = ground - ground.mean(axis=0)
    values, vectors = np.linalg.eigh(steps.T @ steps / max(len(steps), 1))
    travelled = 2.0 * np.sqrt(max(values[1], 0.0))
    front = np.array([np.cos(figure.facing).mean(), np.sin(figure.facing).mean()])
    if travelled > 0.25 * figure.stature and values[0] < 0.3 * values[1]:
        along = vectors[:, 1]
        if along @ (ground[-1] - ground[0]) < 0:
            along = -along
        return float(np.arctan2(along[1], along[0])) - np.radians(20.0)
    return float(np.arctan2(front[1], front[0])) - np.radians(50.0)


def screen_points(points: Array, angle: float) -> Array:
    """Points (..., 3) as right, up and depth towards the viewer (..., 3), for a level camera."""
    cosine, sine = np.cos(angle), np.sin(angle)
    right = points[..., 0] * cosine + points[..., 2] * sine
    towards = -points[..., 0] * sine + points[..., 2] * cosine
    return np.stack([right, points[..., 1], towards], axis=-1)


def low_frames(figure: Figure, foot: int) -> NDArray[np.bool_]:
    """Whether the foot is near its standing height, (T,)."""
    heights = figure.positions[:, foot, 1]
    standing = np.percentile(heights, 3)
    return heights < standing + LOW_SHARE * figure.stature


def sliding_frames(figure: Figure, foot: int) -> NDArray[np.bool_]:
    """Whether the foot moves along the floor while low, (T,).

    It must also be low for a twentieth of a second before and after, so that touch-down and push-off do not count.
    """
    track = figure.positions[:, foot]
    span = max(1, round(figure.fps / 20))
    frames = np.arange(len(track))
    behind, ahead = np.maximum(frames - span, 0), np.minimum(frames + span, len(track) - 1)
    steps = np.linalg.norm((track[ahead] - track[behind])[:, [0, 2]], axis=-1)
    speeds = steps * figure.fps / np.maximum(ahead - behind, 1)
    low = low_frames(figure, foot)
    return low & low[behind] & low[ahead] & (speeds > SLIDE_SHARE * figure.stature)
