"""Finishing: root height, the root's way and feet, for types, paths, keys, rigs and repaired clips alike."""

from __future__ import annotations

from dataclasses import dataclass

from motionkit.arrays import Array
from motionkit.finish.feet import lock_feet
from motionkit.finish.root_height import above_ground, in_the_air
from motionkit.finish.root_way import held_way
from motionkit.motion.motion import Motion


@dataclass(frozen=True, eq=False)
class Finish:
    """What finishing is told of a motion.

    Attributes:
        drawn: whether a network drew it, at 60 fps; of recorded clips flights and glides are left as they are.
        hold: share (T,), or one for all frames, of the sliding of feet in contact that is taken out of the root's way;
            0 where the way was given.
        most: acceleration over the ground in m/s^2 that recordings of its types keep below; None for no limit.
        size: of the body that is shown, against that of the motion.
    """

    drawn: bool = True
    hold: Array | float = 0.0
    most: float | None = None
    size: float = 1.0


@dataclass(frozen=True, eq=False)
class Unfinished:
    """A motion before it is finished: on the canonical joints, with its contacts (T, 4) and what is told of it."""

    motion: Motion
    contacts: Array
    told: Finish

    def finished(self) -> Motion:
        """The motion as it is written."""
        return finish(self.motion, self.contacts, self.told)


def finish(motion: Motion, contacts: Array, told: Finish) -> Motion:
    """A motion as it is written; each correction once, in this order (docs/rollout.md has what each brings).

    The body rises out of the ground before its feet are moved; flights are corrected after it, since legs decide where
    a flight begins and ends.

    Args:
        motion: T frames on the canonical joints, in cm, the ground at height zero.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe.
        told: what is known of the motion.
    """
    motion = held_way(above_ground(motion), contacts, told.hold, told.most)
    motion = lock_feet(motion, contacts)
    return in_the_air(motion, told.size) if told.drawn else motion
