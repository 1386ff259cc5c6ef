"""Finishing: corrects root motion, root height and feet, for types, paths, keys, rigs and repaired clips alike."""

from __future__ import annotations

from dataclasses import dataclass

from motionkit.arrays import Array
from motionkit.finish.feet import lock_feet
from motionkit.finish.hands import fingers_above
from motionkit.finish.root_height import above_ground, in_the_air
from motionkit.finish.root_way import held_way
from motionkit.motion.motion import Motion


@dataclass(frozen=True, eq=False)
class Finish:
    """Settings of finishing for one motion.

    Attributes:
        drawn: whether a network drew the motion, at 60 fps. Flights and glides of recorded clips stay as they are.
        hold: share (T,), or one for all frames, of foot sliding to subtract from the root's path; 0 keeps the path.
        most: limit of the root's acceleration over the ground in m/s^2; None for no limit.
        size: scale of the shown body relative to the body of the motion.
    """

    drawn: bool = True
    hold: Array | float = 0.0
    most: float | None = None
    size: float = 1.0


@dataclass(frozen=True, eq=False)
class Unfinished:
    """A motion on the canonical joints before finishing, with its contacts (T, 4) and settings."""

    motion: Motion
    contacts: Array
    told: Finish

    def finished(self) -> Motion:
        """The finished motion."""
        return finish(self.motion, self.contacts, self.told)


def finish(motion: Motion, contacts: Array, told: Finish) -> Motion:
    """Return the finished motion: each correction runs once, in this order (docs/rollout.md measures each).

    The body rises out of the ground before foot locking. Flights come last, because the legs decide where a flight
    begins and ends. Wrists come last of all, because they move no other joint.

    Args:
        motion: T frames on the canonical joints, in cm, the ground at height zero.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe.
        told: the settings.
    """
    motion = held_way(above_ground(motion), contacts, told.hold, told.most)
    motion = lock_feet(motion, contacts)
    return fingers_above(in_the_air(motion, told.size)) if told.drawn else motion
