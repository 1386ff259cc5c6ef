"""The input of all motion writers: a motion and its metadata."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.rig.character import Character
from motionkit.rig.rig import Rig
from motionkit.view.asset import BODIES

_SAME_REST = 1e-5  # share of the leg by which the offsets of a rig whose rest pose was kept may differ
_AS_LONG = 0.1  # s; an edited motion whose length differs by less has the types of the clip
LARGEST = 1e7  # largest length in a file, in metres or centimetres


@dataclass(frozen=True, eq=False)
class Clip:
    """A motion to write.

    Attributes:
        motion: a motion of any rig, unit and up axis.
        name: its name in the file.
        types: motion types and their seconds in sequence; empty if unknown.
        channels: channels of each joint in the source BVH file, kept when writing BVH; None for the default.
        hierarchy: text of the source file's hierarchy section, likewise; None to make one from the skeleton.
        character: the .glb or .vrm file whose joints the motion is on; .glb and .vrm files are that file with the
            motion added, but for files of motionkit whose joints the motion does not fit, or if a body is asked for.
            None to show the motion on a body of motionkit.
        body: the one of BODIES that human rigs get then; None for the first, or that of the character.
        alone: leave out the animations that the character's file has.
        per_unit: lengths of the motion to one unit of the file it was read from.
    """

    motion: Motion
    name: str = "motion"
    types: Sequence[tuple[str, float]] = ()
    channels: tuple[tuple[str, ...], ...] | None = None
    hierarchy: str | None = None
    character: Character | None = None
    body: str | None = None
    alone: bool = False
    per_unit: float = 1.0

    @property
    def host(self) -> Character | None:
        """The character into whose file the motion is written; None to write a body of motionkit."""
        one = self.character
        if one is None or not one.tree.file.by_motionkit():
            return one
        return one if self.body is None and one.holds(self.motion) else None

    @property
    def new_body(self) -> str:
        """The one of BODIES that a human rig gets."""
        return self.body or BODIES[0]

    def in_file(self) -> Motion:
        """The motion in the unit of the file it was read from."""
        return self.motion if self.per_unit == 1.0 else self.motion.scaled(1.0 / self.per_unit)

    def with_motion(self, motion: Motion) -> Clip:
        """The clip with an edited motion; keeps what fits it: channels, hierarchy, types; and its character anyway."""
        kept = self._holds(motion)
        as_long = abs(motion.seconds - self.motion.seconds) < _AS_LONG
        same = kept and np.array_equal(motion.skeleton.offsets, self.motion.skeleton.offsets)
        return replace(
            self,
            motion=motion,
            channels=self.channels if kept else None,
            hierarchy=self.hierarchy if same else None,
            types=self.types if as_long else (),
        )

    def cut_types(self, start: float, end: float, speed: float = 1.0) -> tuple[tuple[str, float], ...]:
        """The types of a stretch, from and to a time in seconds, played at a factor on its pace."""
        out, at = [], 0.0
        for kind, seconds in self.types:
            inside = min(end, at + seconds) - max(start, at)
            out += [(kind, inside / speed)] if inside > 0.0 else []
            at += seconds
        return tuple(out)

    def _holds(self, motion: Motion) -> bool:
        """Whether the channels can hold a motion: three rotations per joint, and translations for joints that move."""
        if self.channels is None or motion.skeleton.names != self.motion.skeleton.names:
            return False
        moving = set(motion.moving_joints())
        kinds = [[name[1:] for name in names] for names in self.channels]
        turns = all(names.count("rotation") == 3 for names in kinds)
        return turns and all(names.count("position") == 3 for j, names in enumerate(kinds) if j in moving)


def rig_clip(motion: Motion, rig: Rig, name: str, types: Sequence[tuple[str, float]] = ()) -> Clip:
    """The clip of a motion on a rig; in a character's file its animation is called by the types, if they are known."""
    if rig.character is not None and types:
        name = "-".join(dict.fromkeys(kind for kind, _ in types))
    same = len(motion.skeleton) == len(rig.skeleton) and np.allclose(
        motion.skeleton.offsets, rig.skeleton.offsets, rtol=0.0, atol=_SAME_REST * rig.leg
    )
    return Clip(motion, name, types, rig.channels, rig.hierarchy if same else None, rig.character)


def check_numbers(path: object, motion: Motion) -> None:
    """Raise MotionkitError for numbers that a file cannot hold, before writing begins."""
    places = [motion.root_positions, motion.skeleton.offsets]
    places += [] if motion.local_positions is None else [motion.local_positions]
    places += map(np.array, motion.skeleton.end_sites.values())
    if len(motion) < 1:
        raise MotionkitError(f"{path}: not written: the motion has no frames")
    if not all(bool((np.abs(values) <= LARGEST).all()) for values in places):
        raise MotionkitError(f"{path}: not written: a position is not a number up to {LARGEST:,.0f}")
    lengths = np.linalg.norm(motion.local_rotations.astype(np.float64), axis=-1)
    if not bool((np.abs(lengths - 1.0) < 1e-2).all()):
        raise MotionkitError(f"{path}: not written: a rotation is not a unit quaternion")
    if not 0.0 < motion.fps < float("inf"):
        raise MotionkitError(f"{path}: not written: {motion.fps} frames per second")
