"""Feet held still while they touch, frame by frame: only the past is known, N characters at once.

motion/foot_ik.py does the same to a finished motion, where a lock can begin before its contact. Here a foot is caught
where it is shown when its contact begins, braked over a few frames, held, and let go over a few frames; the knee bends
to let it, and the hips come down where the leg is too short. foot_kernel.c does this for single characters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats, length
from motionkit.motion import skeleton
from motionkit.motion.leg_ik import (
    ANKLES,
    HIPS,
    HOLD,
    KNEES,
    LOCK,
    TOE,
    TOES,
    knees_backwards,
    lowest_free,
    move_feet,
    pitched_feet,
    root_slip,
)

FOOT_JOINTS = np.array(skeleton.FOOT_JOINTS)


class FootLock:
    """The state of the feet of N characters.

    Attributes:
        hold: (N,) share of the sliding of feet in contact that is taken out of the root's way over the ground; may be
            changed between frames.
        carry: (N, 2) how far the root has been moved by that, x and z in cm.
    """

    def __init__(self, count: int) -> None:
        self.hold = np.ones(count, np.float32)
        self.carry = np.zeros((count, 2), np.float32)
        self.slip = np.zeros((count, 2), np.float32)  # how far it was moved back in the last frame
        self.feet = np.zeros(
            (count, 4, 3), np.float32
        )  # foot joints of the last frame before they were moved
        self.moving = np.zeros(count, bool)  # whether there was a last frame
        self.locked = np.zeros((count, 2), bool)
        self.age = np.zeros((count, 2), np.float32)  # frames since the foot was caught or let go
        self.step = np.zeros((count, 2), np.float32)  # how high the toe of a foot that steps rises, else 0
        self.anchor = np.zeros((count, 2, 2), np.float32)  # x, z of a caught toe
        self.shift = np.zeros((count, 2, 2), np.float32)  # from the predicted to the shown toe
        self.released = np.zeros((count, 2, 2), np.float32)  # that shift when the foot was let go
        self.toes = np.zeros((count, 2, 2), np.float32)  # predicted x, z of the last frame
        self.stands = np.zeros((count, 2), bool)  # whether the toe is in contact
        self.lift = np.zeros((count, 2), np.float32)
        self.drop = np.zeros(count, np.float32)

    def reset(self, index: int) -> None:
        """Forget one character's past."""
        self.locked[index] = self.stands[index] = False
        self.moving[index] = False
        for values in (
            self.slip,
            self.carry,
            self.age,
            self.step,
            self.shift,
            self.released,
            self.lift,
            self.drop,
        ):
            values[index] = 0.0

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
        known = self.moving.copy()
        self._carry(positions[:, FOOT_JOINTS], contacts, scale)
        positions[..., ::2] += self.carry[:, None]
        root_positions[:, ::2] += self.carry
        shifts = self._shifts(positions[:, TOES], contacts, scale, known)
        backwards = knees_backwards(positions, world[:, HIPS, :3, :3]).any(axis=1)
        still = ~shifts.any(axis=(1, 2)) & (self.drop <= LOCK.least_change) & ~backwards
        self.drop[still] = 0.0
        if still.all():
            return positions
        pitch, shifts = pitched_feet(positions, shifts)
        self._lower(positions, shifts, scale)
        positions[..., 1] -= self.drop[:, None]
        root_positions[:, 1] -= self.drop
        shifts[..., 1] += self.drop[:, None]
        move_feet(rotations, positions, world[..., :3, :3], pitch, shifts)
        return positions

    def _carry(self, feet: Floats, contacts: Floats, scale: Floats) -> None:
        """Move the root over the ground, so that feet in contact stay where they are."""
        slip = root_slip(self.feet, feet, contacts, scale)
        held = np.where(self.moving, self.hold, np.float32(0.0))[:, None] * slip
        self.slip += np.float32(HOLD.pace) * (held - self.slip)
        self.carry -= self.slip
        self.feet, self.moving[:] = feet, True

    def _shifts(self, toes: Floats, contacts: Floats, scale: Floats, known: NDArray[np.bool_]) -> Floats:
        """How far (N, 2, 3) each foot has to move; known (N,) says whose frame before is known."""
        place = toes[..., ::2]
        level = contacts.reshape(-1, 2, 2).max(axis=-1)
        caught, let_go = np.zeros_like(self.locked), np.zeros_like(self.locked)
        for foot in range(2):
            caught[:, foot], let_go[:, foot] = self._changes(foot, place[:, foot], level[:, foot], scale)
        # A caught toe goes on with what is left of its speed while it is braked.
        speed = np.clip(1.0 - self.age / LOCK.brake_frames, 0.0, 1.0)[..., None]
        shown = place + self.shift
        self.anchor = np.where(caught[..., None], shown, self.anchor + speed * (place - self.toes))
        self.released = np.where(let_go[..., None], self.shift, self.released)
        rest = np.clip(1.0 - (self.age + 1.0) / _release_frames(self.step), 0.0, 1.0)[..., None]
        share = rest * rest * (3.0 - 2.0 * rest)
        self.shift = np.where(self.locked[..., None], self.anchor - place, self.released * share)
        steps = np.where(known[:, None], length(place - self.toes), np.float32(0.0))
        self._lift(toes[..., 1], steps, contacts[:, 1::2], scale[:, None])
        self.toes = place
        out = np.empty_like(toes)
        out[..., ::2] = self.shift
        wave = np.sin(np.float32(np.pi) * rest[..., 0])
        out[..., 1] = self.lift + self.step * wave * wave
        return out

    def _changes(
        self, foot: int, place: Floats, level: Floats, scale: Floats
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether left (0) or right (1) feet, with toes at places (N, 2), are caught and let go in this frame."""
        locked, age, step = self.locked[:, foot], self.age[:, foot], self.step[:, foot]
        eased = (age >= _release_frames(step)) | (self.released[:, foot] == 0.0).all(axis=-1)
        far, limit = length(self.anchor[:, foot] - place), LOCK.max_slide * scale
        waits = (self.step[:, 1 - foot] > 0.0) & (far <= LOCK.max_wait * limit)
        slid = locked & (far > limit) & ~waits
        caught = ~locked & (level > LOCK.contact_on) & eased
        let_go = locked & ((level < LOCK.contact_off) | slid)
        step[caught | let_go | eased] = 0.0
        step[slid] = (LOCK.step_height * scale * np.minimum(length(self.shift[:, foot]) / limit, 1.0))[slid]
        age += 1.0
        age[caught | let_go] = 0.0
        self.locked[:, foot] = (locked | caught) & ~let_go
        return caught, let_go

    def _lift(self, height: Floats, steps: Floats, contacts: Floats, scale: Floats) -> None:
        """Move toes (N, 2) towards the height of standing ones in contact, else up to where free ones go at least."""
        self.stands = np.where(contacts > LOCK.contact_on, True, self.stands & (contacts >= LOCK.contact_off))
        stand, slack = TOE.standing * scale, TOE.slack * scale
        standing = np.clip(height, stand - slack, stand + slack) - height
        missing = np.where(self.stands, standing, np.maximum(lowest_free(steps, scale) - height, 0.0))
        pace = np.where(missing > self.lift, np.float32(TOE.rise), np.float32(TOE.fall))
        self.lift = (self.lift + pace * (missing - self.lift)).astype(np.float32)
        self.lift[np.abs(self.lift) <= LOCK.least_change] = 0.0

    def _lower(self, positions: Floats, shifts: Floats, scale: Floats) -> None:
        """Bring the hips down, straight, as far as the leg that misses most needs it."""
        hips, knees, ankles = (positions[:, joints] for joints in (HIPS, KNEES, ANKLES))
        whole = length(knees - hips) + length(ankles - knees)
        reach = ankles + shifts - hips
        # A leg that was straight before stays so; only what the lock adds is taken from the hips.
        allowed = np.maximum(LOCK.max_reach * whole, length(ankles - hips))
        aside = (reach[..., ::2] ** 2).sum(axis=-1)
        below = np.sqrt(np.maximum(allowed * allowed - aside, 0.0))
        need = np.clip(-reach[..., 1] - below, 0.0, LOCK.max_drop * scale[:, None]).max(axis=-1)
        self.drop = np.maximum(need, LOCK.hip_return * self.drop)


def _release_frames(step: Floats) -> Floats:
    """Frames in which feet that were let go join the predicted ones again, by how high their steps rise, 0 for none."""
    return np.where(step > 0.0, np.float32(LOCK.step_frames), np.float32(LOCK.ease_frames))
