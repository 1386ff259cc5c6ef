"""Finds kicks, punches and jumps by the movement of feet and hands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, spans
from motionkit.features.decode import joint_positions
from motionkit.features.layout import FeatureLayout
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_NAMES

KINDS = ("jump", "kick", "punch")
SIDED = ("kick", "punch")

# Heights in cm, speeds in cm/s, times in frames at 60 fps, on the canonical body.
KICK_HEIGHT = 0.75  # share of the median hip height that the ankle of a kick exceeds
FOOT_DOWN = 20.0  # ankle height below which a foot is down; a standing ankle is at about 10
PUNCH_SPEED = 220.0  # smallest peak speed of the hand away from its shoulder
PUNCH_REACH = 0.85  # smallest distance of the hand at the end of a punch, as a share of the arm's length
AIR = 4.0  # smallest height of toes and ankles in a flight, above their standing heights
AIR_FRAMES = 10  # shortest flight
# Distance between the feet along the facing direction; flights of a run have more, 46 to 72, jumps less, 2 to 26.
STRIDE = 40.0
LONGEST_LIFT = 60  # most frames from the ground to KICK_HEIGHT, and back
BEFORE = {"kick": 8, "punch": 18, "jump": 20}  # frames added before and after what is detected
AFTER = {"kick": 6, "punch": 18, "jump": 15}
_STANDING = np.array([10.0, 4.1, 10.0, 4.1])  # ankle and toe joints, left and right


@dataclass(frozen=True)
class Event:
    """Frames start to end (exclusive) of a kick, punch or jump.

    Attributes:
        right: whether the right side kicks or punches.
        stride: whether the feet are as far apart as in the flight of a run.
    """

    start: int
    end: int
    right: bool = False
    stride: bool = False


def find_events(features: Array, layout: FeatureLayout) -> dict[str, list[Event]]:
    """Events of each kind in unnormalised features (T, 276), sorted by time."""
    positions = joint_positions(features, layout.version)
    return {
        "kick": sorted(_kicks(positions), key=lambda event: event.start),
        "punch": sorted(_punches(positions), key=lambda event: event.start),
        "jump": _jumps(positions),
    }


def frames_in_the_air(features: Array, layout: FeatureLayout) -> int:
    """Number of frames of unnormalised features (T, 276) in which both feet are in the air."""
    return sum(end - start for start, end in _flights(joint_positions(features, layout.version)))


def _event(kind: str, start: int, end: int, frames: int, right: bool = False) -> Event:
    return Event(max(0, start - BEFORE[kind]), min(frames, end + AFTER[kind]), right)


def _kicks(positions: np.ndarray) -> list[Event]:
    out = []
    height = KICK_HEIGHT * np.median(positions[:, 0, 1])
    for right, ankle in ((False, FOOT_JOINTS[0]), (True, FOOT_JOINTS[2])):
        foot = positions[:, ankle, 1]
        for start, end in spans(foot > height):
            first, last = start, end
            while first > 0 and foot[first] > FOOT_DOWN and start - first < LONGEST_LIFT:
                first -= 1
            while last < len(foot) - 1 and foot[last] > FOOT_DOWN and last - end < LONGEST_LIFT:
                last += 1
            out.append(_event("kick", first, last, len(foot), right))
    return out


def _punches(positions: np.ndarray) -> list[Event]:
    out = []
    if len(positions) < 2:
        return []
    for right, side in ((False, "Left"), (True, "Right")):
        shoulder, elbow, hand = (
            positions[:, JOINT_NAMES.index(side + name)] for name in ("Arm", "ForeArm", "Hand")
        )
        reach = np.linalg.norm(hand - shoulder, axis=-1)
        length = np.linalg.norm(hand - elbow, axis=-1) + np.linalg.norm(elbow - shoulder, axis=-1)
        speed = np.gradient(reach) * 60.0
        for start, end in spans(speed > 0.6 * PUNCH_SPEED):
            there = min(len(reach) - 1, end + 2)
            if speed[start:end].max() > PUNCH_SPEED and reach[there] > PUNCH_REACH * length[there]:
                out.append(_event("punch", end, end, len(reach), right))
    return out


def _flights(positions: np.ndarray) -> list[tuple[int, int]]:
    clearance = positions[:, FOOT_JOINTS, 1] - _STANDING
    return [run for run in spans(clearance.min(axis=1) > AIR) if run[1] - run[0] >= AIR_FRAMES]


def _jumps(positions: np.ndarray) -> list[Event]:
    ahead = positions[:, FOOT_JOINTS, 2]
    apart = np.abs(ahead[:, 0] - ahead[:, 2])
    return [
        replace(_event("jump", start, end, len(positions)), stride=bool(apart[start:end].mean() > STRIDE))
        for start, end in _flights(positions)
    ]
