"""Feet held still while they touch, frame by frame: only the past is known, N characters at once.

motion.foot_ik does the same to a finished motion, where a lock can begin before its contact. Here a
foot is caught where it is shown when its contact begins, braked over a few frames, held, and let go
over a few frames; the knee bends to let it, and the hips come down where the leg is too short.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Floats, cross
from motionkit.inference.pose import quat_product
from motionkit.motion.foot_ik import (
    CLEARANCE,
    CONTACT_OFF,
    CONTACT_ON,
    EASE_FRAMES,
    LEGS,
    MAX_CLEARANCE,
    MAX_REACH,
    TOE_HEIGHT,
)

# cm; less than in a finished motion, whose locks lie in the middle of the slide.
MAX_SLIDE = 12.0
BRAKE_FRAMES = 4  # until a foot that has touched stands still
LIFT_RISE, LIFT_FALL = 0.5, 0.2  # share of the way to its height that a lifted foot goes in a frame
HIP_RETURN = 0.85  # share of a lowering of the hips that is left a frame later
MAX_DROP = 12.0  # cm the hips come down at most
LEAST_DROP = 1e-4  # cm; what is lowered or lifted less is where it was

_HIPS, _KNEES, _ANKLES, _TOES = (
    np.array([getattr(leg, joint) for leg in LEGS]) for joint in ("hip", "knee", "ankle", "toe")
)
_LEG_JOINTS = np.concatenate([_HIPS, _KNEES, _ANKLES])
_SIDEWAYS = np.array([-1.0, 0.0, 0.0], np.float32)


class FootLock:
    """The state of the feet of N characters."""

    def __init__(self, count: int) -> None:
        self.locked = np.zeros((count, 2), bool)
        # Frames since the foot was caught or let go; below zero before the first frame.
        self.age = np.full((count, 2), -1.0, np.float32)
        self.anchor = np.zeros((count, 2, 2), np.float32)  # x, z of a caught toe
        self.shift = np.zeros((count, 2, 2), np.float32)  # from the predicted to the shown toe
        self.released = np.zeros((count, 2, 2), np.float32)  # that shift when the foot was let go
        self.toes = np.zeros((count, 2, 2), np.float32)  # predicted x, z of the last frame
        self.lift = np.zeros((count, 2), np.float32)
        self.drop = np.zeros(count, np.float32)

    def reset(self, index: int) -> None:
        """Forget one character's past."""
        self.locked[index] = False
        self.age[index] = -1.0
        self.shift[index] = self.released[index] = self.lift[index] = 0.0
        self.drop[index] = 0.0

    def apply(
        self, rotations: Floats, root_positions: Floats, world: Floats, contacts: Floats, scale: Floats
    ) -> Floats:
        """Lock the feet of a frame: changes rotations and root_positions in place, answers positions (N, 23, 3).

        Args:
            rotations: (N, 23, 4) local.
            root_positions: (N, 3).
            world: (N, 23, 4, 4) their world transforms.
            contacts: (N, 4) probabilities: left foot, left toe, right foot, right toe.
            scale: (N,) size of each character against the canonical body.
        """
        positions = world[..., :3, 3].copy()
        toes = positions[:, _TOES]
        shift = self._shifts(toes, contacts, scale)
        still = ~shift.any(axis=(1, 2)) & (self.drop <= LEAST_DROP)
        self.drop[still] = 0.0
        if still.all():
            return positions
        hips, knees, ankles = positions[:, _HIPS], positions[:, _KNEES], positions[:, _ANKLES]
        targets = ankles + shift
        thigh, shin = _length(knees - hips), _length(ankles - knees)
        self._lower(hips, ankles, targets, thigh + shin, scale)
        for part in (positions[..., 1], hips[..., 1], knees[..., 1], ankles[..., 1], toes[..., 1]):
            part -= self.drop[:, None]
        root_positions[:, 1] -= self.drop
        _bend(rotations, positions, world, (hips, knees, ankles, toes), targets, thigh, shin)
        return positions

    def _shifts(self, toes: Floats, contacts: Floats, scale: Floats) -> Floats:
        """How far (N, 2, 3) each foot has to move."""
        place = toes[..., ::2]
        level = contacts.reshape(-1, 2, 2).max(axis=-1)
        first = self.age < 0.0
        slid = self.locked & (_length(self.anchor - place) > MAX_SLIDE * scale[:, None])
        free = ~self.locked & ((self.age >= EASE_FRAMES) | (self.released == 0.0).all(axis=-1))
        caught = ~self.locked & (level > CONTACT_ON) & free
        let_go = self.locked & ((level < CONTACT_OFF) | slid)
        self.age += 1.0
        self.age[caught | let_go] = 0.0
        self.locked = (self.locked | caught) & ~let_go
        # A caught toe goes on with what is left of its speed while it is braked.
        speed = np.clip(1.0 - self.age / BRAKE_FRAMES, 0.0, 1.0)[..., None]
        shown, before = place + self.shift, self.toes + self.shift
        self.anchor = np.where(caught[..., None], shown, self.anchor + speed * (place - self.toes))
        self.released = np.where(let_go[..., None], self.shift, self.released)
        rest = np.clip(1.0 - (self.age + 1.0) / EASE_FRAMES, 0.0, 1.0)[..., None]
        share = rest * rest * (3.0 - 2.0 * rest)
        self.shift = np.where(self.locked[..., None], self.anchor - place, self.released * share)
        way = np.where(first, 0.0, _length(place + self.shift - before))
        self._lift(toes[..., 1], way, scale[:, None])
        self.toes = place
        out = np.empty_like(toes)
        out[..., ::2] = self.shift
        out[..., 1] = self.lift
        return out

    def _lift(self, height: Floats, way: Floats, scale: Floats) -> None:
        """Raise the toes (N, 2) that are too low for their way along the ground in this frame."""
        clear = np.minimum(CLEARANCE * way, MAX_CLEARANCE * scale)
        missing = np.maximum(TOE_HEIGHT * scale + clear - height, 0.0)
        pace = np.where(missing > self.lift, LIFT_RISE, LIFT_FALL)
        self.lift = (self.lift + pace * (missing - self.lift)).astype(np.float32)
        self.lift[self.lift <= LEAST_DROP] = 0.0

    def _lower(self, hips: Floats, ankles: Floats, targets: Floats, leg: Floats, scale: Floats) -> None:
        """Bring the hips down, straight, as far as the leg that misses most needs it."""
        reach = targets - hips
        # A leg that was straight before stays so; only what the lock adds is taken from the hips.
        allowed = np.maximum(MAX_REACH * leg, _length(ankles - hips))
        aside = (reach[..., ::2] ** 2).sum(axis=-1)
        below = np.sqrt(np.maximum(allowed * allowed - aside, 0.0))
        need = np.clip(-reach[..., 1] - below, 0.0, MAX_DROP * scale[:, None]).max(axis=-1)
        self.drop = np.maximum(need, HIP_RETURN * self.drop)


def _bend(
    rotations: Floats,
    positions: Floats,
    world: Floats,
    joints: tuple[Floats, Floats, Floats, Floats],
    targets: Floats,
    thigh: Floats,
    shin: Floats,
) -> None:
    """Turn thighs and shins so that the ankles come to targets (N, 2, 3); feet keep their orientation."""
    hips, knees, ankles, toes = joints
    now, then = _length(ankles - hips), _length(targets - hips)
    then = np.minimum(np.maximum(then, np.abs(thigh - shin) + 0.5), (thigh + shin) * MAX_REACH)
    down = ankles - knees
    axis = cross(hips - knees, down)
    size = _length(axis)
    # A straight leg has no plane; its knee bends about the thigh's own sideways axis.
    flat = (size < 1e-2 * thigh * shin)[..., None]
    if flat.any():
        sideways = world[:, _HIPS, :3, :3] @ _SIDEWAYS
        along = down / shin[..., None]
        sideways -= (sideways * along).sum(axis=-1, keepdims=True) * along
        axis = np.where(flat, sideways, axis)
        size = _length(axis)
    axis /= np.maximum(size, 1e-9)[..., None]
    opening = _interior_angle(thigh, shin, then) - _interior_angle(thigh, shin, now)
    # A leg that is longer than MAX_REACH and stays where it is must not be bent by the limit.
    opened = _about(axis, np.where(_length(targets - ankles) < 1e-3, 0.0, opening))
    bent = knees + _turn(opened, down) - hips
    swing = _between(bent, targets - hips)
    turned = quat_product(swing, opened)
    frames = np.swapaxes(world[:, _LEG_JOINTS, :3, :3], -1, -2).reshape(-1, 3, 2, 3, 3)
    parent = np.swapaxes(world[:, :1, :3, :3], -1, -2)
    changes = np.stack(
        [_inside(parent, swing), _inside(frames[:, 0], opened), _inside(frames[:, 1], _inverse(turned))],
        axis=1,
    ).reshape(-1, 6, 4)
    rotations[:, _LEG_JOINTS] = quat_product(changes, rotations[:, _LEG_JOINTS])
    moved = _turn(swing, bent) + hips
    positions[:, _KNEES] = hips + _turn(swing, knees - hips)
    positions[:, _ANKLES] = moved
    positions[:, _TOES] = toes + moved - ankles


def _length(vectors: Floats) -> Floats:
    return np.sqrt((vectors * vectors).sum(axis=-1))


def _interior_angle(a: Floats, b: Floats, opposite: Floats) -> Floats:
    """The angle between sides a and b of triangles."""
    return np.arccos(np.clip((a * a + b * b - opposite * opposite) / (2.0 * a * b), -1.0, 1.0))


def _about(axis: Floats, angle: Floats) -> Floats:
    """Rotations (..., 4) by angle about unit axes."""
    half = 0.5 * angle[..., None]
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1)


def _between(source: Floats, target: Floats) -> Floats:
    """The smallest rotation (..., 4) that turns source onto target, which are never opposite here."""
    lengths = _length(source) * _length(target)
    quat = np.empty((*source.shape[:-1], 4), np.float32)
    quat[..., 0] = lengths + (source * target).sum(axis=-1)
    quat[..., 1:] = cross(source, target)
    quat /= np.maximum(np.sqrt((quat * quat).sum(axis=-1, keepdims=True)), 1e-9)
    return quat


def _turn(quat: Floats, vectors: Floats) -> Floats:
    """Vectors (..., 3) turned by unit quaternions (..., 4)."""
    twice = np.float32(2.0) * cross(quat[..., 1:], vectors)
    return vectors + quat[..., :1] * twice + cross(quat[..., 1:], twice)


def _inside(to_frame: Floats, quat: Floats) -> Floats:
    """World rotations (..., 4) as seen from frames whose transposed matrices (..., 3, 3) are given."""
    out = quat.copy()
    out[..., 1:] = np.matmul(to_frame, quat[..., 1:, None])[..., 0]
    return out


def _inverse(quat: Floats) -> Floats:
    return quat * np.array([1.0, -1.0, -1.0, -1.0], np.float32)
