"""Puts a motion on a user's rig with its feet on the floor, for --rig and `motionkit retarget`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.finish.finish import Finish, Unfinished, finish
from motionkit.finish.soles import sole_depth
from motionkit.free_memory import check_memory
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.motion import Motion, resample
from motionkit.rig.on_rig import canonical_places
from motionkit.rig.rig import Rig
from motionkit.rig.soles import read_soles
from motionkit.rig.to_rig import from_body, on_body, stance, standing_height


def on_rig(
    motion: Motion,
    rig: Rig,
    ik: bool = True,
    clip: Motion | None = None,
    drawn: Unfinished | None = None,
) -> Motion:
    """Return a motion on the skeleton of a rig, in its unit and axes; to_rig.rig_bvh makes a BVH file of it.

    Args:
        motion: on the canonical joints, in cm, the floor at height zero.
        rig: from read_rig.
        ik: finish the motion on the body of the rig, with feet locked during the contacts of the motion.
        clip: motion of the rig that moves its other joints (fingers, props); from read_clip.
        drawn: what a synthesized motion was finished from. It is finished on the body of the rig instead, so that feet
            are locked once, and has the rate of motion. By default the motion was recorded, and contacts are found by
            height and speed.

    Raises:
        MotionkitError: the motion on the rig does not fit into memory.
        SkeletonError: clip has other joints than the rig.
    """
    check_memory(len(motion), max(len(rig.skeleton), len(motion.skeleton)), motion.fps)
    if not ik:
        body = on_body(motion, rig)
    else:
        if drawn is None:
            contacts = foot_contacts(canonical_places(motion), motion.fps)
            drawn = Unfinished(motion, contacts, Finish(drawn=False))
        body = _finished(on_body(drawn.motion, rig), rig, drawn)
    made = from_body(body, rig, None if clip is None else resample(clip, body.fps))
    return resample(made, motion.fps)


def rig_sole_depth(motion: Motion, rig: Rig) -> float | None:
    """How far the soles of a rig's mesh are below the floor, in cm for canonical legs; None if its file has no soles.

    Args:
        motion: the motion on the rig (from on_rig) on the canonical joints again (from rig/on_rig.py).
        rig: the rig.
    """
    soles = read_soles(rig)
    return None if soles is None else sole_depth(on_body(motion, rig), soles)


def _finished(body: Motion, rig: Rig, drawn: Unfinished) -> Motion:
    """Finish a motion on the body of a rig, with the feet at the standing height of the rig."""
    contacts, settings = drawn.contacts, replace(drawn.settings, size=1.0, soles=read_soles(rig))
    usual = stance(drawn.motion, rig, contacts)
    if usual is None:  # nothing stands
        return finish(body, contacts, settings)
    body = finish(_standing(body, rig, contacts, usual), contacts, settings)
    if settings.soles is not None:
        return body
    return _standing(body, rig, contacts, standing_height(rig, usual))


def _standing(body: Motion, rig: Rig, contacts: Array, height: float) -> Motion:
    """Move the motion up or down so that its feet stand at a height in cm."""
    up = np.array([0.0, height - (stance(body, rig, contacts) or 0.0), 0.0], body.root_positions.dtype)
    return replace(body, root_positions=body.root_positions + up)
