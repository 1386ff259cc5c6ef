"""Finishing: corrects root motion, root height and feet, for types, paths, keys, rigs and repaired clips alike."""

from __future__ import annotations

from dataclasses import dataclass

from motionkit.arrays import Array
from motionkit.finish.feet import clear_toes, lock_feet
from motionkit.finish.hands import fingers_above
from motionkit.finish.root_height import above_ground, in_the_air
from motionkit.finish.root_path import corrected_path
from motionkit.finish.soles import plant_soles
from motionkit.motion.ankles import ankles_in_range
from motionkit.motion.motion import Motion
from motionkit.rig.soles import Sole


@dataclass(frozen=True, eq=False)
class Finish:
    """Settings of finishing for one motion.

    Attributes:
        drawn: whether a network drew the motion, at 60 fps. Flights of recorded clips stay as they are.
        hold: share (T,), or one for all frames, of foot sliding to subtract from the root's path; 0 keeps the path.
        most: limit of the root's acceleration over the ground in m/s^2; None for no limit.
        size: scale of the shown body relative to the body of the motion.
        soles: left and right sole of the body of the motion, to stand on; None to stand on its joints.
    """

    drawn: bool = True
    hold: Array | float = 0.0
    most: float | None = None
    size: float = 1.0
    soles: tuple[Sole, Sole] | None = None


@dataclass(frozen=True, eq=False)
class Unfinished:
    """A motion on the canonical joints before finishing, with its contacts (T, 4) and settings."""

    motion: Motion
    contacts: Array
    settings: Finish

    def finished(self) -> Motion:
        """The finished motion."""
        return finish(self.motion, self.contacts, self.settings)


def finish(motion: Motion, contacts: Array, settings: Finish) -> Motion:
    """Return the finished motion: each correction runs once, in this order (docs/rollout.md measures each).

    The body rises out of the ground before foot locking. Flights follow it, because the legs decide where a flight
    begins and ends; then come soles. Toes are raised after both, because both may lower the body. Wrists come last,
    because they move no other joint.

    Args:
        motion: T frames on the canonical joints, in cm, the ground at height zero.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe.
        settings: the settings.
    """
    if settings.drawn:
        motion = ankles_in_range(motion)
    motion = corrected_path(above_ground(motion), contacts, settings.hold, settings.most)
    motion = lock_feet(motion, contacts)
    if settings.drawn:
        motion = in_the_air(motion, settings.size)
    if settings.soles is None:
        motion = clear_toes(motion)
    else:
        motion = plant_soles(motion, settings.soles, contacts)
        motion = clear_toes(motion, [sole.toe_height for sole in settings.soles])
    return fingers_above(motion) if settings.drawn else motion
