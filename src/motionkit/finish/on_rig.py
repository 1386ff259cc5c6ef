"""Any motion on a user's rig, its feet on the floor: what --rig and `motionkit retarget` write."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.finish.finish import Finish, Unfinished, finish
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.motion import Motion, resample
from motionkit.rig.on_rig import canonical_places
from motionkit.rig.rig import Rig
from motionkit.rig.to_rig import from_body, on_body, stance, standing_height


def on_rig(
    motion: Motion,
    rig: Rig,
    ik: bool = True,
    clip: Motion | None = None,
    drawn: Unfinished | None = None,
) -> Motion:
    """A motion on the skeleton of a rig, in its unit and axes; to_rig.rig_bvh makes a BVH file of it.

    Args:
        motion: on the canonical joints, in cm, the floor at height zero.
        rig: from read_rig.
        ik: finish the motion on the body of the rig; its feet are held while those of the motion touch the floor.
        clip: motion of the rig, whose other joints (fingers, props) move as they do there; from read_clip.
        drawn: the same motion with the contacts that a network predicted for it. By default it was recorded, and
            contacts are found by height and speed.

    Raises:
        SkeletonError: clip has other joints than the rig.
    """
    body = on_body(motion, rig)
    if ik:
        if drawn is None:
            contacts = foot_contacts(canonical_places(motion), motion.fps)
            drawn = Unfinished(motion, contacts, Finish(drawn=False))
        body = _finished(body, rig, drawn)
    return from_body(body, rig, None if clip is None else resample(clip, motion.fps))


def _finished(body: Motion, rig: Rig, drawn: Unfinished) -> Motion:
    """A motion of the body of a rig, finished, its feet as high as those of the rig stand."""
    contacts, told = drawn.contacts, replace(drawn.told, size=1.0)
    usual = stance(drawn.motion, rig, contacts)
    if usual is None:  # nothing stands
        return finish(body, contacts, told)
    body = _standing(body, rig, contacts, usual)
    return _standing(finish(body, contacts, told), rig, contacts, standing_height(rig, usual))


def _standing(body: Motion, rig: Rig, contacts: Array, height: float) -> Motion:
    """The motion moved up or down, so that its feet stand at a height in cm."""
    up = np.array([0.0, height - (stance(body, rig, contacts) or 0.0), 0.0], body.root_positions.dtype)
    return replace(body, root_positions=body.root_positions + up)
