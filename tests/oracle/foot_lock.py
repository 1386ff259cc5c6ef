"""Feet held still in numpy, in place of foot_kernel.c."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats, length
from motionkit.inference.foot_lock import FootLock
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


def lock_feet(
    feet: FootLock, rotations: Floats, root_positions: Floats, world: Floats, contacts: Floats, scale: Floats
) -> Floats:
    """Lock the feet of a frame, see _Lock.apply."""
    return _Lock(feet).apply(rotations, root_positions, world, contacts, scale)


class _Lock:
    def __init__(self, feet: FootLock) -> None:
        self.root, self.plants = feet.root, feet.plants

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
        known = self.root.moving.copy()
        self._carry(positions[:, FOOT_JOINTS], contacts, scale)
        positions[..., ::2] += self.root.carry[:, None]
        root_positions[:, ::2] += self.root.carry
        shifts = self._shifts(positions[:, TOES], contacts, scale, known)
        backwards = knees_backwards(positions, world[:, HIPS, :3, :3]).any(axis=1)
        still = ~shifts.any(axis=(1, 2)) & (self.root.drop <= LOCK.least_change) & ~backwards
        self.root.drop[still] = 0.0
        if still.all():
            return positions
        pitch, shifts = pitched_feet(positions, shifts)
        self._lower(positions, shifts, scale)
        positions[..., 1] -= self.root.drop[:, None]
        root_positions[:, 1] -= self.root.drop
        shifts[..., 1] += self.root.drop[:, None]
        move_feet(rotations, positions, world[..., :3, :3], pitch, shifts)
        return positions

    def _carry(self, feet: Floats, contacts: Floats, scale: Floats) -> None:
        """Move the root over the ground, so that feet in contact stay where they are."""
        slip = root_slip(self.root.feet, feet, contacts, scale)
        held = np.where(self.root.moving, self.root.hold, np.float32(0.0))[:, None] * slip
        self.root.slip[:] += np.float32(HOLD.pace) * (held - self.root.slip)
        self.root.carry[:] -= self.root.slip
        self.root.feet[:], self.root.moving[:] = feet, True

    def _shifts(self, toes: Floats, contacts: Floats, scale: Floats, known: NDArray[np.bool_]) -> Floats:
        """How far (N, 2, 3) each foot has to move; known (N,) says whose frame before is known."""
        plants, place = self.plants, toes[..., ::2]
        level = contacts.reshape(-1, 2, 2).max(axis=-1)
        caught, let_go = np.zeros_like(plants.locked), np.zeros_like(plants.locked)
        for foot in range(2):
            caught[:, foot], let_go[:, foot] = self._changes(foot, place[:, foot], level[:, foot], scale)
        # A caught toe goes on with what is left of its speed while it is braked.
        speed = np.clip(1.0 - plants.age / LOCK.brake_frames, 0.0, 1.0)[..., None]
        shown = place + plants.shift
        plants.anchor[:] = np.where(caught[..., None], shown, plants.anchor + speed * (place - plants.toes))
        plants.released[:] = np.where(let_go[..., None], plants.shift, plants.released)
        rest = np.clip(1.0 - (plants.age + 1.0) / _release_frames(plants.step), 0.0, 1.0)[..., None]
        share = rest * rest * (3.0 - 2.0 * rest)
        plants.shift[:] = np.where(plants.locked[..., None], plants.anchor - place, plants.released * share)
        steps = np.where(known[:, None], length(place - plants.toes), np.float32(0.0))
        self._lift(toes[..., 1], steps, contacts[:, 1::2], scale[:, None])
        plants.toes[:] = place
        out = np.empty_like(toes)
        out[..., ::2] = plants.shift
        wave = np.sin(np.float32(np.pi) * rest[..., 0])
        out[..., 1] = plants.lift + plants.step * wave
        return out

    def _changes(
        self, foot: int, place: Floats, level: Floats, scale: Floats
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether left (0) or right (1) feet, with toes at places (N, 2), are caught and let go in this frame."""
        plants = self.plants
        locked, age, step = plants.locked[:, foot], plants.age[:, foot], plants.step[:, foot]
        eased = (age >= _release_frames(step)) | (plants.released[:, foot] == 0.0).all(axis=-1)
        far, limit = length(plants.anchor[:, foot] - place), LOCK.max_slide * scale
        waits = (plants.step[:, 1 - foot] > 0.0) & (far <= LOCK.max_wait * limit)
        slid = locked & (far > limit) & ~waits
        caught = ~locked & (level > LOCK.contact_on) & eased
        let_go = locked & ((level < LOCK.contact_off) | slid)
        step[caught | let_go | eased] = 0.0
        step[slid] = (LOCK.step_height * scale * np.minimum(length(plants.shift[:, foot]) / limit, 1.0))[slid]
        age += 1.0
        age[caught | let_go] = 0.0
        plants.locked[:, foot] = (locked | caught) & ~let_go
        return caught, let_go

    def _lift(self, height: Floats, steps: Floats, contacts: Floats, scale: Floats) -> None:
        """Move toes (N, 2) towards the height of standing ones in contact, else up to where free ones go at least."""
        plants = self.plants
        plants.stands[:] = np.where(
            contacts > LOCK.contact_on, True, plants.stands & (contacts >= LOCK.contact_off)
        )
        stand, slack = TOE.standing * scale, TOE.slack * scale
        standing = np.clip(height, stand - slack, stand + slack) - height
        missing = np.where(plants.stands, standing, np.maximum(lowest_free(steps, scale) - height, 0.0))
        pace = np.where(missing > plants.lift, np.float32(TOE.rise), np.float32(TOE.fall))
        plants.lift[:] = (plants.lift + pace * (missing - plants.lift)).astype(np.float32)
        plants.lift[np.abs(plants.lift) <= LOCK.least_change] = 0.0

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
        self.root.drop[:] = np.maximum(need, LOCK.hip_return * self.root.drop)


def _release_frames(step: Floats) -> Floats:
    """Frames in which feet that were let go join the predicted ones again, by how high their steps rise, 0 for none."""
    return np.where(step > 0.0, np.float32(LOCK.step_frames), np.float32(LOCK.ease_frames))
