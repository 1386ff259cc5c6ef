"""Two-bone IK for legs, root corrections by standing feet, and the settings of foot locking.

finish/feet.py decides where the feet of whole motions go, and moves them with move_feet. inference/foot_kernel.c does
both for live characters, frame by frame, with the same settings; tests/oracle has its numpy form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, cross, length, normalized
from motionkit.motion.rotations import quat_about, quat_between, quat_inverse, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS


@dataclass(frozen=True)
class LockSettings:
    """When feet are locked, and how legs reach them; lengths in cm of the canonical body.

    Attributes:
        contact_on, contact_off: a contact begins above the first probability and ends below the second.
        ease_frames: frames over which a lock fades out (and in, in whole motions).
        brake_frames: frames until a foot in contact stands still, for live characters.
        max_slide: a foot predicted further than this from its lock takes a step to a new place.
        max_wait: distance, as a multiple of max_slide, up to which a foot waits for the other foot's step.
        step_frames, step_height: length of a step, and rise of its toe if it is max_slide long or longer.
        max_reach: longest distance from hip to ankle, as a share of the straight leg.
        hip_return: share of the hips' descent that is left after a frame.
        max_drop: largest descent of the hips.
        least_change: smaller shifts are ignored.
    """

    contact_on: float = 0.3
    contact_off: float = 0.2
    ease_frames: int = 12
    brake_frames: int = 4
    max_slide: float = 20.0
    max_wait: float = 1.6
    step_frames: float = 16.0
    step_height: float = 6.0
    max_reach: float = 0.999
    hip_return: float = 0.85
    max_drop: float = 12.0
    least_change: float = 1e-4


@dataclass(frozen=True)
class ToeSettings:
    """Heights of toes; lengths in cm of the canonical body.

    Attributes:
        standing, slack: a toe in contact is within slack of the standing height.
        lowest: least height of a free toe that does not move.
        swing: least height of a free toe that moves at `fast` or faster. The limit is linear in between, and 8 % of the
            recorded toes are lower.
        fast: speed over the ground in cm per frame; see swing.
        rise, fall: share of the gap by which a toe rises or falls per frame.
        max_pitch: largest turn of a foot in radians for its toe's height; the ankle moves for the rest.
    """

    standing: float = STANDING_HEIGHTS[1]
    slack: float = 0.7
    lowest: float = 2.0
    swing: float = 6.2
    fast: float = 3.0
    rise: float = 0.5
    fall: float = 0.2
    max_pitch: float = 0.2


@dataclass(frozen=True)
class HoldSettings:
    """How the sliding of feet in contact corrects the root; lengths in cm of the canonical body.

    Attributes:
        unsure, sure: the weight of a foot joint rises from 0 at the first contact probability to 1 at the second.
        ankle_share: weight of ankles against toes; lower, because ankles move while a foot rolls.
        ease: movement (cm per frame) at which the weight of a joint halves.
        enough: sum of weights at which the correction is full.
        limit: sliding (cm per frame) at which the correction halves; a larger movement is a step.
        pace: share of the gap by which the correction follows the feet per frame, because predicted feet tremble.
    """

    unsure: float = 0.3
    sure: float = 0.7
    ankle_share: float = 0.5
    ease: float = 0.3
    enough: float = 0.5
    limit: float = 2.0
    pace: float = 0.25


LOCK, TOE, HOLD = LockSettings(), ToeSettings(), HoldSettings()

# Weights of ankles and toes, in the order of FOOT_JOINTS.
FOOT_SHARES = (HOLD.ankle_share, 1.0, HOLD.ankle_share, 1.0)

# Joint indices (4, 2) of hips, knees, ankles and toes, left and right.
LEG_JOINTS = np.array(
    [[JOINT_NAMES.index(side + n) for side in ("Left", "Right")] for n in ("UpLeg", "Leg", "Foot", "ToeBase")]
)
HIPS, KNEES, ANKLES, TOES = LEG_JOINTS

# A knee bent by less than BENT (sine of the angle) takes part of its axis from the thigh; THIGH_SHARE weighs that part.
BENT, THIGH_SHARE = 0.3, 0.2
# Cosine between the bending axis of a knee and the thigh's side; above it the axis counts fully as the knee's hinge.
ALIKE = 0.3
# A knee that is bent backwards is stretched, and bends forwards as its leg shortens: this many times as fast as a knee
# that is bent forwards already.
STRAIGHTENING = 1.5
BACKWARDS = 0.002  # sine of the angle above which a knee counts as bent backwards
SOLE_PACE = (
    0.3  # share of the gap by which a live sole in contact comes to the floor per frame, and toes bend back
)
STEEP = 0.5  # horizontal share of a foot's length below which the foot pitches less
# The side of the thigh (-x in its own frame), about which a knee bends.
_SIDE = np.array([-1.0, 0.0, 0.0], np.float32)


def lowest_free(steps: Array, scale: Array | float = 1.0) -> Array:
    """Least heights (...) in cm of free toes, by their speed over the ground (...) in cm per frame.

    Recorded toes that move are higher than standing ones. A low foot that moves looks like a sliding foot. scale is the
    size of each body relative to the canonical one.
    """
    share = np.minimum(steps / (TOE.fast * scale), 1.0)
    return (TOE.lowest + (TOE.swing - TOE.lowest) * share) * scale


def pitched_feet(positions: Array, shifts: Array) -> tuple[Array, Array]:
    """Find the pitch of feet and the shift of ankles that move toes; a foot pitches by at most TOE.max_pitch.

    Args:
        positions: (N, 23, 3) joint positions in cm.
        shifts: (N, 2, 3) shift of each toe in cm.

    Returns:
        World rotations (N, 2, 4) of the feet, and shifts (N, 2, 3) of the ankles.
    """
    foot = positions[:, TOES] - positions[:, ANKLES]
    size = np.maximum(length(foot), 1e-6)
    flat = np.sqrt(foot[..., 0] * foot[..., 0] + foot[..., 2] * foot[..., 2])
    now = np.arcsin(np.clip(foot[..., 1] / size, -1.0, 1.0))
    then = np.arcsin(np.clip((foot[..., 1] + shifts[..., 1]) / size, -1.0, 1.0))
    angle = np.clip(then - now, -TOE.max_pitch, TOE.max_pitch) * np.clip(flat / (STEEP * size), 0.0, 1.0)
    axis = np.zeros_like(foot)  # horizontal, at right angles to the foot
    axis[..., 0], axis[..., 2] = -foot[..., 2], foot[..., 0]
    pitch = quat_about(axis / np.maximum(flat, 1e-6)[..., None], angle)
    return pitch, shifts + foot - quat_rotate(pitch, foot)


def move_feet(rotations: Array, positions: Array, world: Array, pitch: Array, shifts: Array) -> None:
    """Move feet by turning thighs, shins and feet of N bodies (or frames); legs without a shift stay as they are.

    Args:
        rotations: (N, 23, 4) local quaternions, changed in place.
        positions: (N, 23, 3) joint positions in cm, changed in place.
        world: (N, 23, 3, 3) world rotations of the joints before the change.
        pitch: (N, 2, 4) world rotations of the feet.
        shifts: (N, 2, 3) shift of each ankle in cm.
    """
    hips, knees, ankles, toes = (positions[:, joints] for joints in LEG_JOINTS)
    targets = ankles + shifts
    side = np.matmul(world[:, HIPS], _SIDE)
    swing, opened = leg_turns(hips, knees, ankles, side, targets)
    still = (length(targets - ankles) < 1e-3) & ~_backwards(hips, knees, ankles, side)
    swing[still] = opened[still] = (1.0, 0.0, 0.0, 0.0)
    shin = quat_multiply(swing, opened)
    bent = quat_rotate(opened, ankles - knees) + knees - hips
    moved = hips + quat_rotate(swing, bent)
    into = np.swapaxes(world, -1, -2)
    # World rotations of thigh, shin and foot, each in the frame of its parent.
    changes = np.stack(
        [
            _inside(into[:, :1], swing),
            _inside(into[:, HIPS], opened),
            _inside(into[:, KNEES], quat_multiply(quat_inverse(shin), pitch)),
        ],
        axis=1,
    )
    joints = LEG_JOINTS[:3]
    rotations[:, joints] = quat_multiply(changes, rotations[:, joints])
    positions[:, KNEES] = hips + quat_rotate(swing, knees - hips)
    positions[:, ANKLES] = moved
    positions[:, TOES] = moved + quat_rotate(pitch, toes - ankles)


def knees_backwards(positions: Array, thighs: Array) -> Array:
    """Whether each knee (N, 2) is bent backwards; move_feet stretches such legs.

    positions (N, 23, 3) are those of joints in cm, thighs (N, 2, 3, 3) world rotations of the joints HIPS.
    """
    hips, knees, ankles, _ = (positions[:, joints] for joints in LEG_JOINTS)
    return _backwards(hips, knees, ankles, np.matmul(thighs, _SIDE))


def foot_weights(holds: Array, moved: Array, scale: Array | float = 1.0) -> tuple[Array, Array]:
    """Weigh foot joints for a correction of the root: a joint that moves less counts more.

    Args:
        holds: (N, 4) contact weight of each joint, 0 to its share of FOOT_SHARES.
        moved: (N, 4) movement over the ground since the frame before, in cm.
        scale: scalar or (N, 1), size of each body relative to the canonical one.

    Returns:
        Weights (N, 4) whose sum is 1, or 0 if no joint stands; and the strength (N,) of the correction, 0 to 1.
    """
    weights = holds / (moved + HOLD.ease * scale)
    weights = weights / (weights.sum(axis=1, keepdims=True) + 1e-9)
    return weights, np.minimum(holds.sum(axis=1) / HOLD.enough, 1.0)


def root_slip(before: Array, feet: Array, contacts: Array, scale: Array | float = 1.0) -> Array:
    """Sliding (N, 2) of feet in contact since the frame before, to subtract from the root's position on the ground.

    Args:
        before, feet: (N, 4, 3) joints in the order of FOOT_JOINTS, in cm, of the frame before and of this one.
        contacts: (N, 4) probabilities.
        scale: (N,) size of each body relative to the canonical one.
    """
    size = np.broadcast_to(np.asarray(scale, feet.dtype), feet.shape[:1])[:, None]
    moved = (feet - before)[..., ::2]
    certain = np.clip((contacts - HOLD.unsure) / (HOLD.sure - HOLD.unsure), 0.0, 1.0)
    weights, strength = foot_weights(np.array(FOOT_SHARES, feet.dtype) * certain, length(moved), size)
    mean = (weights[..., None] * moved).sum(axis=1)
    far = length(mean)[:, None] / (HOLD.limit * size)
    return (strength[:, None] * mean / (1.0 + far * far)).astype(feet.dtype)


def leg_turns(hips: Array, knees: Array, ankles: Array, side: Array, targets: Array) -> tuple[Array, Array]:
    """World rotations of a thigh and its shin that bring the ankle to a target.

    The knee keeps its bending plane. A nearly straight leg takes that plane from the thigh, so that knees always bend
    forwards, and continuously in time. The leg points towards a target out of reach. A leg whose knee is bent backwards
    is stretched, past its target until that is much nearer.

    Args:
        hips, knees, ankles, targets: (..., 3) in cm.
        side: (..., 3) side of the thigh: the unit axis about which a turn of the shin stretches the leg.

    Returns:
        swing (..., 4) of thigh and shin, and opened (..., 4) of the shin, which comes first.
    """
    thigh, shin = knees - hips, ankles - knees
    thigh_length, shin_length = length(thigh), length(shin)
    axis = _knee_axis(thigh / thigh_length[..., None], shin / shin_length[..., None], side)
    leg, shift = ankles - hips, targets - ankles
    now, wish = length(leg), length(targets - hips)
    shortest = np.abs(thigh_length - shin_length) + 0.5
    longest = np.maximum(LOCK.max_reach * (thigh_length + shin_length), now)
    reach = np.clip(wish, shortest, longest)
    # By how much the squared distance changes. A nearly straight leg makes much of an angle of its last bits, so it
    # comes from the shift, which is exact where the ankle stays.
    change = np.where(reach == wish, (shift * (2.0 * leg + shift)).sum(-1), (reach - now) * (reach + now))
    # With the shin at angle p about the axis, it is 2 (b cos p + c sin p) and a constant.
    turned = cross(axis, shin)
    on_axis = (thigh * axis).sum(-1) * (shin * axis).sum(-1)
    b, c = (thigh * shin).sum(-1) - on_axis, (thigh * turned).sum(-1)
    flexed = np.arctan2(c, b)  # negative for a knee bent backwards
    size = np.maximum(np.sqrt(b * b + c * c), 1e-9)
    half = np.sin(0.5 * flexed) ** 2 - change / (4.0 * size)
    target = 2.0 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0)))
    eased = np.clip(flexed + STRAIGHTENING * (target + flexed), 0.0, target)
    opened = quat_about(axis, flexed - np.where(flexed < 0.0, eased, target))
    bent = thigh + quat_rotate(opened, shin)
    return quat_between(bent, targets - hips), opened


def _backwards(hips: Array, knees: Array, ankles: Array, side: Array) -> Array:
    """Whether knees (...) are bent backwards, from positions and thigh sides (..., 3)."""
    thigh, shin = knees - hips, ankles - knees
    return (cross(shin, thigh) * side).sum(-1) < -BACKWARDS * length(thigh) * length(shin)


def _knee_axis(thigh: Array, shin: Array, side: Array) -> Array:
    """Unit axes (..., 3) about which knees stretch, from unit vectors (..., 3) of thighs, shins and thigh sides."""
    axis = cross(shin, thigh)
    alike = (axis * side).sum(-1) / np.maximum(length(axis), 1e-9)
    axis = np.clip(alike / ALIKE, -1.0, 1.0)[..., None] * axis  # reversed for a knee bent backwards
    share = THIGH_SHARE * np.clip(1.0 - length(axis) / BENT, 0.0, 1.0)
    return normalized(axis + share[..., None] * side)


def _inside(into: Array, quat: Array) -> Array:
    """World rotations (..., 4) expressed in frames with the given transposed matrices (..., 3, 3)."""
    out = quat.copy()
    out[..., 1:] = np.matmul(into, quat[..., 1:, None])[..., 0]
    return out
