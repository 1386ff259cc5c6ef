"""Spreads the twist of a limb over its twist joints, so that skin does not wring at one place.

A limb bone turns about its own axis at the joint above it, and its end turns about it too. A twist joint beside the
bone takes back, near the shoulder or hip, what the upper bone twists, and follows the hand or foot, near the wrist or
ankle. Twist joints along the bone take its twist from the joint above them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from motionkit.arrays import Doubles
from motionkit.motion.rotations import quat_about, quat_multiply, quat_normalize
from motionkit.rig.rest_pose import SIDES
from motionkit.rig.rig import Rig

_BONES = {"Arm": "ForeArm", "ForeArm": "Hand", "UpLeg": "Leg", "Leg": "Foot"}  # limb joints and their ends
_WORDS = ("twist", "roll")
_STRAIGHT = 0.005  # share of the bone; a joint further from its axis does not twist about it


def tables() -> dict[str, Any]:
    """What twist joints are, as JSON values for a page (see rig/names.py)."""
    return {"twistBones": _BONES, "twistWords": _WORDS, "twistStraight": _STRAIGHT}


@dataclass(frozen=True, eq=False)
class Twist:
    """The twist of a limb bone, and the joints over which it is spread.

    Attributes:
        source: the joint that twists about axis.
        axis: (3,) direction of the bone in the rest pose.
        shares: joints and their share of the twist.
        from_source: whether the twist is removed from the source.
    """

    source: int
    axis: Doubles
    shares: dict[int, float]
    from_source: bool


def spread_twist(rig: Rig, local: Doubles) -> None:
    """Turn the twist joints of a rig by their share; local rotations (T, J, 4) are changed in place."""
    for one in twists(rig):
        angle = twist(local[:, one.source], one.axis)
        if one.from_source:
            local[:, one.source] = quat_normalize(
                quat_multiply(local[:, one.source], quat_about(one.axis, -angle))
            )
        for joint, share in one.shares.items():
            local[:, joint] = quat_about(one.axis, share * angle)


def twists(rig: Rig) -> Iterator[Twist]:
    """The limb bones of a rig that have twist joints."""
    rest, places = rig.skeleton.rest_positions().astype(np.float64), rig.joints.places
    for side in SIDES:
        for part, below in _BONES.items():
            top, end = places.get(f"{side}{part}"), places.get(f"{side}{below}")
            if top is None or end is None or not rig.skeleton.descends(end, top):
                continue
            bone = rest[end] - rest[top]
            size = float(np.linalg.norm(bone))
            if size <= 0.0:
                continue
            axis = bone / size
            chain = rig.skeleton.between(top, end)[:-1]
            beside = _beside(rig, [top, *chain])
            if beside:
                upper = part in ("Arm", "UpLeg")
                far = np.clip((rest[beside] - rest[top]) @ axis / size, 0.0, 1.0) - float(upper)
                shares = dict(zip(beside, far.tolist(), strict=True))
                yield Twist(top if upper else end, axis, shares, from_source=False)
            elif chain and _straight(rest[chain] - rest[top], axis, size):
                yield Twist(top, axis, dict.fromkeys(chain, 1.0 / len(chain)), from_source=True)


def twist(rotations: Doubles, axis: Doubles) -> Doubles:
    """Angles (T,) in radians by which rotations (T, 4) turn about an axis (3,), continuous in time."""
    return np.unwrap(2.0 * np.arctan2(rotations[:, 1:] @ axis, rotations[:, 0]))


def _beside(rig: Rig, bone: list[int]) -> list[int]:
    """Twist joints that hang from a bone and carry no joint that is known."""
    skeleton, known = rig.skeleton, {*rig.joints.places.values(), *rig.joints.turns.values()}
    found = [
        joint
        for joint, name in enumerate(skeleton.names)
        if skeleton.parents[joint] in bone and any(word in name.lower() for word in _WORDS)
    ]
    return [joint for joint in found if not any(skeleton.descends(other, joint) for other in known)]


def _straight(offsets: Doubles, axis: Doubles, size: float) -> bool:
    """Whether joints that are away (N, 3) from the top of a bone lie on its axis."""
    off = offsets - (offsets @ axis)[:, None] * axis
    return bool(np.linalg.norm(off, axis=1).max() <= _STRAIGHT * size)
