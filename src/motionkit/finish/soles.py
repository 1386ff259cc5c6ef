"""Puts the soles of a mesh on the floor: they stand on it during contacts, and are never below it.

Foot locking knows joints, and gives a toe one standing height. Where the sole is depends on the tilt of the foot and
the bend of its toes, which are those of the motion: recorded toes often point into the floor. plant_soles of
inference/foot_kernel.c does the same for live characters, without frames to come.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, normalized, peak_smoothed, smoothed
from motionkit.finish.feet import FLOOR_FADE, faded, hip_drop, locked_spans
from motionkit.motion.contacts import CONTACT_HEIGHTS
from motionkit.motion.frame_rate import frames_at
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import ANKLES, LEG_JOINTS, TOES, move_feet
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_to_matrix,
)
from motionkit.motion.skeleton import STANDING_HEIGHTS
from motionkit.rig.soles import Sole

_UP = np.array([0.0, 1.0, 0.0], np.float32)
NEAR = CONTACT_HEIGHTS[1] - STANDING_HEIGHTS[1]  # cm above the floor up to which a contact counts fully

TIP = 0.5  # share of the toes' length beyond which their points rise as they bend
_EASE_FRAMES = 4  # over which ankles and toes follow the floor, before and after; at 60 fps


def plant_soles(body: Motion, soles: tuple[Sole, Sole], contacts: Array) -> Motion:
    """Return a motion of a rig's body whose soles are on the floor (height zero) in contacts, and nowhere below it.

    The body moves up or down as a whole, to where most of its contacts are; then ankles move up and down, and toes
    bend upwards.

    Args:
        body: T frames on the body of the rig, in cm.
        soles: left and right.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe.
    """
    turns, positions = motion_kinematics(body)
    joints = _anchors(soles)
    touching = contacts[:, 1::2] if joints is TOES else contacts[:, ::2]
    gaps = [
        _standing(sole, turns[:, ankle], turns[:, toe], _ahead(body, toe)) - positions[:, joint, 1]
        for sole, ankle, toe, joint in zip(soles, ANKLES, TOES, joints, strict=True)
    ]
    missing = np.stack(gaps, axis=1)
    standing = touching > 0.5
    if standing.any():
        whole = float(np.median(missing[standing]))
        missing -= whole
        positions[..., 1] += whole
        body = replace(body, root_positions=body.root_positions + whole * _UP)
    shifts = np.zeros((len(body), 2, 3), positions.dtype)
    shifts[..., 1] = np.stack(
        [_rises(missing[:, side], touching[:, side], body.fps) for side in range(2)], axis=1
    )
    return _toes_above(_moved(body, turns, positions, shifts), soles)


def sole_depth(body: Motion, soles: tuple[Sole, Sole]) -> float:
    """How far the lowest sole of a motion of a rig's body (T frames, in cm) is below the floor, in cm; 0 if none is."""
    turns, positions = motion_kinematics(body)
    joints = _anchors(soles)
    heights = [
        np.minimum(_lowest(sole.foot, turns[:, ankle]), _lowest(sole.toe, turns[:, toe]))
        + positions[:, joint, 1]
        for sole, ankle, toe, joint in zip(soles, ANKLES, TOES, joints, strict=True)
    ]
    return max(-float(np.min(heights)), 0.0)


def _anchors(soles: tuple[Sole, Sole]) -> Array:
    """The left and right joint that the points of soles are relative to."""
    return TOES if all(len(sole.toe) for sole in soles) else ANKLES


def _standing(sole: Sole, foot: Array, toe: Array, ahead: Array) -> Array:
    """The height (T,) of a sole's joint at which the foot stands, with rotations (T, 4) of foot and toe.

    The toes bend upwards where they would be below the rest of the foot, at most until they are level.
    """
    deep = -_lowest(sole.foot, foot)
    if not len(sole.toe):
        return deep
    axis, most = _hinge(toe, ahead)
    return np.maximum(deep, -np.maximum(_lowest(sole.toe, toe), _lowest(sole.toe, _bent(toe, axis, most))))


def _lowest(points: Array, turns: Array) -> Array:
    """The height (T,) of the lowest of some points (N, 3), turned by (T, 4), over their joint."""
    heights: Array = quat_to_matrix(turns)[:, 1] @ points.T
    return heights.min(axis=1, initial=np.inf)


def _rises(missing: Array, touching: Array, fps: float) -> Array:
    """How far an ankle rises (T,), from what its sole is too low (T,), and contacts (T,) of its foot."""
    near = np.clip(1.0 - (-missing - NEAR) / FLOOR_FADE, 0.0, 1.0)
    spans = locked_spans((touching * near)[:, None], fps)
    needed = [missing[start:end, None] for start, end in spans]
    rises = faded(needed, spans, (len(missing), 1), frames_at(_EASE_FRAMES, fps))
    rises = smoothed(
        rises, frames_at(_EASE_FRAMES, fps)
    )  # where a foot comes down fast, its lowest point jumps
    more = np.maximum(missing[:, None] - rises, 0.0)
    out: Array = (rises + peak_smoothed(more[:, 0], more, frames_at(_EASE_FRAMES, fps)))[:, 0]
    return out


def _moved(body: Motion, turns: Array, positions: Array, shifts: Array) -> Motion:
    """Move the ankles (T, 2, 3) of a body; feet keep their rotations, and the hips come down where a leg is short."""
    drop = hip_drop(body, positions, shifts)
    rotations, level = body.local_rotations.copy(), np.zeros((len(body), 2, 4), turns.dtype)
    level[..., 0] = 1.0
    move_feet(rotations, positions + drop[:, None], quat_to_matrix(turns), level, shifts - drop[:, None])
    legs = LEG_JOINTS[:3].ravel()
    rotations[:, legs] = quat_normalize(rotations[:, legs])
    return replace(body, local_rotations=rotations, root_positions=body.root_positions + drop)


def _toes_above(body: Motion, soles: tuple[Sole, Sole]) -> Motion:
    """Bend toes upwards, at most until they are level, where they are below the floor."""
    turns, positions = motion_kinematics(body)
    rotations = body.local_rotations.copy()
    for sole, ankle, toe in zip(soles, ANKLES, TOES, strict=True):
        ahead = _ahead(body, toe)
        along = sole.toe @ ahead
        tips = sole.toe[
            along > TIP * along.max(initial=0.0)
        ]  # bending does not lift what is nearer to the joint
        if not len(tips):
            continue
        axis, most = _hinge(turns[:, toe], ahead)
        points = np.einsum("tab,nb->tna", quat_to_matrix(turns[:, toe]), tips)
        # Bent by an angle, a point is still + size sin(angle + now) above the joint.
        still = (points * axis[:, None]).sum(axis=-1) * axis[:, None, 1]
        up, before = points[..., 1] - still, np.cross(axis[:, None], points)[..., 1]
        size, floor = np.maximum(np.hypot(up, before), 1e-6), -positions[:, toe, 1, None]
        angles = np.arcsin(np.clip((floor - still) / size, -1.0, 1.0)) - np.arctan2(up, before)
        needed = np.where(up + still < floor, angles, 0.0).max(axis=1, initial=0.0)
        eased = peak_smoothed(needed, needed[:, None], frames_at(_EASE_FRAMES, body.fps))[:, 0]
        bent = _bent(turns[:, toe], axis, np.minimum(eased, most))
        rotations[:, toe] = quat_normalize(quat_multiply(quat_inverse(turns[:, ankle]), bent))
    return replace(body, local_rotations=rotations)


def _ahead(body: Motion, toe: int) -> Array:
    """The direction (3,) of toes in their own axes."""
    return normalized(body.skeleton.offsets[toe] * np.array([1.0, 0.0, 1.0], np.float32))


def _hinge(toe: Array, ahead: Array) -> tuple[Array, Array]:
    """The axis (T, 3) about which toes of rotations (T, 4) bend upwards, and the angle (T,) to where they are level."""
    axis = quat_rotate(toe, np.broadcast_to(np.cross(ahead, _UP), (len(toe), 3)))
    direction = quat_rotate(toe, np.broadcast_to(ahead, (len(toe), 3)))
    return axis, np.maximum(-np.arctan2(direction[:, 1], np.cross(axis, direction)[:, 1]), 0.0)


def _bent(toe: Array, axis: Array, angles: Array) -> Array:
    """Rotations (T, 4) turned by angles (T,) about axes (T, 3)."""
    return quat_multiply(expmap_to_quat(axis * angles[:, None]), toe)
