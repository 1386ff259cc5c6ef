"""What both ways of foot locking share: two-bone IK for legs, how feet hold the root, and the settings.

motion/foot_ik.py (whole motions) and inference/foot_lock.py (frame by frame) decide where feet go; both move them with
move_feet. inference/foot_kernel.c does the same for single characters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, cross, length, normalized
from motionkit.motion.rotations import quat_between, quat_inverse, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS


@dataclass(frozen=True)
class LockSettings:
    """When feet are held, and how legs reach them; lengths in cm of the canonical body.

    Attributes:
        contact_on, contact_off: a contact begins above the first probability and ends below the second.
        ease_frames: frames in which a held foot joins the predicted one again.
        brake_frames: frames until a foot that has touched stands still, frame by frame.
        max_slide: a foot that is predicted to slide further from where it is held takes a new place by a step.
        max_wait: times max_slide up to which it waits for the other foot's step.
        step_frames, step_height: frames of a step, and how far its toe rises if it is max_slide long or longer.
        max_reach: share of the length of the straight leg.
        hip_return: share of a lowering of the hips that is left a frame later.
        max_drop: how far the hips come down at most.
        least_change: smaller changes are left out.
    """

    contact_on: float = 0.3
    contact_off: float = 0.2
    ease_frames: int = 8
    brake_frames: int = 4
    max_slide: float = 12.0
    max_wait: float = 2.0
    step_frames: float = 16.0
    step_height: float = 6.0
    max_reach: float = 0.999
    hip_return: float = 0.85
    max_drop: float = 12.0
    least_change: float = 1e-4


@dataclass(frozen=True)
class ToeSettings:
    """At what height toes are held; lengths in cm of the canonical body.

    Attributes:
        standing, slack: heights of a toe in contact lie within slack of standing.
        lowest: height under which no toe goes that stands still, free of contact.
        swing: height under which none goes that moves over the ground as fast as fast, in cm per frame, or faster;
            lines between follow the 5 % of recorded toes that are lowest.
        rise, fall: shares of the way to its height that a toe goes up or down in a frame.
        max_pitch: radians that a foot is turned for its toe's height; the ankle does the rest.
    """

    standing: float = STANDING_HEIGHTS[1]
    slack: float = 1.0
    lowest: float = 2.0
    swing: float = 5.4
    fast: float = 3.5
    rise: float = 0.5
    fall: float = 0.2
    max_pitch: float = 0.2


@dataclass(frozen=True)
class HoldSettings:
    """How feet in contact hold the root; lengths in cm of the canonical body.

    Attributes:
        unsure, sure: a foot joint holds not at all below the first contact probability, fully above the second.
        ankle_share: weight of ankles, which a foot rolls under, against toes.
        ease: the less a joint moves in a frame beside this, the more it counts.
        enough: sum of weights that holds fully.
        limit: movement in a frame of which only half is taken out, and ever less of more: what is so far off is a step.
        pace: share of the way to what feet say that the hold on the root goes in a frame, frame by frame: feet tremble.
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

# Hips, knees, ankles and toes, left and right.
LEG_JOINTS = np.array(
    [[JOINT_NAMES.index(side + n) for side in ("Left", "Right")] for n in ("UpLeg", "Leg", "Foot", "ToeBase")]
)
HIPS, KNEES, ANKLES, TOES = LEG_JOINTS

# Knees bent less than this (sine of the angle) take their axis more and more from the thigh.
BENT, THIGH_SHARE = 0.3, 0.2
# Cosine between the axis a knee is bent about and the thigh's side from which on it counts as that of its hinge.
ALIKE = 0.3
# A knee that is bent backwards is stretched, and goes over to bending forwards while its leg shortens; so many times as
# fast as a leg would that is bent forwards already.
STRAIGHTENING = 1.5
# Sine of the angle from which on a knee counts as bent backwards.
BACKWARDS = 0.002
# Feet whose horizontal part is below this share of their length are turned less.
STEEP = 0.5
# The thigh's own side (-x in its frame), about which a knee bends.
_SIDE = np.array([-1.0, 0.0, 0.0], np.float32)


def lowest_free(steps: Array, scale: Array | float = 1.0) -> Array:
    """Heights in cm under which free toes do not go, by how far they move over the ground in a frame.

    Recorded toes that move are higher than standing ones: a foot that glides over the floor looks like one that slides.

    Args:
        steps: (...) in cm per frame.
        scale: (...) size of each body against the canonical one.
    """
    share = np.minimum(steps / (TOE.fast * scale), 1.0)
    return (TOE.lowest + (TOE.swing - TOE.lowest) * share) * scale


def pitched_feet(positions: Array, shifts: Array) -> tuple[Array, Array]:
    """How feet turn and ankles move for toes to move: a foot pitches for its toe's height, within limits.

    Args:
        positions: (N, 23, 3) joint positions in cm.
        shifts: (N, 2, 3) how far each toe moves, in cm.

    Returns:
        World rotations (N, 2, 4) of the feet, and how far each ankle moves (N, 2, 3).
    """
    foot = positions[:, TOES] - positions[:, ANKLES]
    size = np.maximum(length(foot), 1e-6)
    flat = np.sqrt(foot[..., 0] * foot[..., 0] + foot[..., 2] * foot[..., 2])
    now = np.arcsin(np.clip(foot[..., 1] / size, -1.0, 1.0))
    then = np.arcsin(np.clip((foot[..., 1] + shifts[..., 1]) / size, -1.0, 1.0))
    angle = np.clip(then - now, -TOE.max_pitch, TOE.max_pitch) * np.clip(flat / (STEEP * size), 0.0, 1.0)
    axis = np.zeros_like(foot)  # horizontal, to the side of the foot
    axis[..., 0], axis[..., 2] = -foot[..., 2], foot[..., 0]
    pitch = _about(axis / np.maximum(flat, 1e-6)[..., None], angle)
    return pitch, shifts + foot - quat_rotate(pitch, foot)


def move_feet(rotations: Array, positions: Array, world: Array, pitch: Array, shifts: Array) -> None:
    """Move feet by turning thighs, shins and feet of N bodies (or frames); legs of feet that stay are left as they are.

    Args:
        rotations: (N, 23, 4) local quaternions, changed in place.
        positions: (N, 23, 3) joint positions in cm, changed in place.
        world: (N, 23, 3, 3) world rotations of the joints before the change.
        pitch: (N, 2, 4) world rotations of the feet.
        shifts: (N, 2, 3) how far each ankle moves, in cm.
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
    # World rotations of thigh, shin and foot, each as seen from the frame that it is applied in.
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
    """Whether each knee (N, 2) is bent backwards, as no knee bends: move_feet stretches such legs.

    Args:
        positions: (N, 23, 3) joint positions in cm.
        thighs: (N, 2, 3, 3) world rotations of the joints HIPS.
    """
    hips, knees, ankles, _ = (positions[:, joints] for joints in LEG_JOINTS)
    return _backwards(hips, knees, ankles, np.matmul(thighs, _SIDE))


def foot_weights(holds: Array, moved: Array, scale: Array | float = 1.0) -> tuple[Array, Array]:
    """Weigh what foot joints say about the movement of the root: the less a joint moves, the more it counts.

    Args:
        holds: (N, 4) how firmly each joint stands, 0 to its share of FOOT_SHARES.
        moved: (N, 4) how far it has moved over the ground since the frame before, in cm.
        scale: one, or (N, 1), size of each body against the canonical one.

    Returns:
        Weights (N, 4) whose sum is 1, or 0 where no joint stands, and how firmly all hold together (N,), 0 to 1.
    """
    weights = holds / (moved + HOLD.ease * scale)
    weights = weights / (weights.sum(axis=1, keepdims=True) + 1e-9)
    return weights, np.minimum(holds.sum(axis=1) / HOLD.enough, 1.0)


def root_slip(before: Array, feet: Array, contacts: Array, scale: Array | float = 1.0) -> Array:
    """How far feet in contact carry the root along with them over the ground (N, 2) since the frame before.

    Args:
        before, feet: (N, 4, 3) joints in the order of FOOT_JOINTS, in cm, of the frame before and of this one.
        contacts: (N, 4) probabilities.
        scale: (N,) size of each body against the canonical one.
    """
    size = np.broadcast_to(np.asarray(scale, feet.dtype), feet.shape[:1])[:, None]
    moved = (feet - before)[..., ::2]
    certain = np.clip((contacts - HOLD.unsure) / (HOLD.sure - HOLD.unsure), 0.0, 1.0)
    weights, strength = foot_weights(np.array(FOOT_SHARES, feet.dtype) * certain, length(moved), size)
    mean = (weights[..., None] * moved).sum(axis=1)
    far = length(mean)[:, None] / (HOLD.limit * size)
    return (strength[:, None] * mean / (1.0 + far * far)).astype(feet.dtype)


def leg_turns(hips: Array, knees: Array, ankles: Array, side: Array, targets: Array) -> tuple[Array, Array]:
    """World rotations of a thigh and of its shin that bring the ankle to a target.

    The knee keeps the plane it is bent in; that of a nearly straight leg is the thigh's, so that knees always bend
    forwards, and continuously in time. Targets out of reach are reached for. A leg whose knee is bent backwards is
    stretched, past its target until that is much nearer.

    Args:
        hips, knees, ankles, targets: (..., 3) in cm.
        side: (..., 3) the thigh's own side: unit axis about which a turn of the shin stretches the leg.

    Returns:
        swing (..., 4) of thigh and shin, and opened (..., 4) of the shin, which is applied first.
    """
    thigh, shin = knees - hips, ankles - knees
    thigh_length, shin_length = length(thigh), length(shin)
    axis = _knee_axis(thigh / thigh_length[..., None], shin / shin_length[..., None], side)
    now = length(ankles - hips)
    whole = thigh_length + shin_length
    reach = np.maximum(length(targets - hips), np.abs(thigh_length - shin_length) + 0.5)
    reach = np.minimum(reach, np.maximum(LOCK.max_reach * whole, now))
    # Squared distance from hip to ankle over the angle p of the shin about the axis: along + 2 (b cos p + c sin p).
    turned = cross(axis, shin)
    on_axis = (thigh * axis).sum(-1) * (shin * axis).sum(-1)
    b, c = (thigh * shin).sum(-1) - on_axis, (thigh * turned).sum(-1)
    along = thigh_length * thigh_length + shin_length * shin_length + 2.0 * on_axis
    flexed = np.arctan2(c, b)  # negative for a knee bent backwards
    size = np.maximum(np.sqrt(b * b + c * c), 1e-9)
    wanted = np.arccos(np.clip((reach * reach - along) / (2.0 * size), -1.0, 1.0))
    eased = np.clip(flexed + STRAIGHTENING * (wanted + flexed), 0.0, wanted)
    opened = _about(axis, flexed - np.where(flexed < 0.0, eased, wanted))
    bent = thigh + quat_rotate(opened, shin)
    return quat_between(bent, targets - hips), opened


def _backwards(hips: Array, knees: Array, ankles: Array, side: Array) -> Array:
    """Whether knees (...) are bent backwards, from positions and sides (..., 3)."""
    thigh, shin = knees - hips, ankles - knees
    return (cross(shin, thigh) * side).sum(-1) < -BACKWARDS * length(thigh) * length(shin)


def _knee_axis(thigh: Array, shin: Array, side: Array) -> Array:
    """Unit axes (..., 3) about which knees stretch, from unit vectors (..., 3)."""
    axis = cross(shin, thigh)
    alike = (axis * side).sum(-1) / np.maximum(length(axis), 1e-9)
    axis = np.clip(alike / ALIKE, -1.0, 1.0)[..., None] * axis  # of a knee bent backwards the other way round
    share = THIGH_SHARE * np.clip(1.0 - length(axis) / BENT, 0.0, 1.0)
    return normalized(axis + share[..., None] * side)


def _about(axis: Array, angle: Array) -> Array:
    """Rotations (..., 4) by angles (...) in radians about unit axes (..., 3)."""
    half = 0.5 * angle[..., None]
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1)


def _inside(into: Array, quat: Array) -> Array:
    """World rotations (..., 4) as seen from frames whose transposed matrices (..., 3, 3) are given."""
    out = quat.copy()
    out[..., 1:] = np.matmul(into, quat[..., 1:, None])[..., 0]
    return out
