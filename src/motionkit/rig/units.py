"""The table of length units, and detection of a file's unit by the size of its body."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_NAMES, LEG_TO_STATURE, Skeleton
from motionkit.reading import user_cm
from motionkit.rig.names import map_rig


class Unit(NamedTuple):
    """A unit of length: its name, its symbol, and cm per unit."""

    name: str
    symbol: str
    cm: float


# The CMU unit is an inch divided by 0.45.
UNITS = (
    Unit("centimetres", "cm", 1.0),
    Unit("metres", "m", 100.0),
    Unit("millimetres", "mm", 0.1),
    Unit("inches", "inches", 2.54),
    Unit("CMU units", "CMU units", 2.54 / 0.45),
    Unit("decimetres", "dm", 10.0),
)
# Standing height in cm: plausible range and most likely height.
SHORTEST, TALLEST, TYPICAL = 130.0, 215.0, 172.0
PLAUSIBLE_LEG = (40.0, 140.0)  # cm, thigh plus shin of the smallest and the tallest people
# Range of leg lengths in file units; kilometres and micrometres are outside. Division by less would overflow.
SHORTEST_LEG, LONGEST_LEG = 1e-3, 1e6
# cm; legs of figures, from dolls to giants, of whose file the format's unit is believed.
SMALLEST_LEG, LARGEST_LEG = 10.0, 250.0
BY_USER = "given"
METRES_UP_TO = 3.0  # largest size, in file units, of a non-human rig in metres
CHAINS_TO_STATURE = 1.17  # twice the longest chain of joints from the root, relative to the standing height


def likely_unit(height: float) -> Unit | None:
    """The unit in which a standing height is most likely that of a human; None if no unit fits."""
    fitting = [unit for unit in UNITS if SHORTEST <= height * unit.cm <= TALLEST]
    return min(fitting, key=lambda unit: abs(height * unit.cm - TYPICAL)) if fitting else None


def unit_of(cm: float) -> Unit:
    """The unit of so many cm; one that is not in the table is named by its length."""
    other = f"units of {cm:.3g} cm"
    return next((unit for unit in UNITS if abs(unit.cm - cm) < 1e-6 * cm), Unit(other, other, cm))


def named_unit(text: str) -> float:
    """The cm of a unit, given by its name, its symbol or its length in cm; raises ValueError for other text."""
    for unit in UNITS:
        if text.lower() in (unit.name.lower(), unit.symbol.lower()):
            return unit.cm
    cm = float(text)
    if not 1e-4 <= cm <= 1e4:
        raise ValueError(text)
    return cm


def guess_scale(leg: float, stated: float | None = None) -> tuple[float, str]:
    """Detect cm per unit from a leg length in file units, and say how; without a unit, by a typical stature.

    stated are the cm per unit that the file's format says (Skeleton.cm).

    Raises SkeletonError for a leg length that is out of range.
    """
    check_leg(leg)
    cm = user_cm()
    if cm is not None:
        return cm, BY_USER
    if stated is not None and SMALLEST_LEG <= leg * stated <= LARGEST_LEG:
        return _as_stated(stated)
    unit = likely_unit(leg / LEG_TO_STATURE)
    if unit is not None:
        return unit.cm, f"detected from leg length: {unit.name}"
    scale = TYPICAL / (leg / LEG_TO_STATURE)
    return scale, f"no known unit fits a leg of {leg:.4g}, scaled to a stature of {TYPICAL:.0f} cm"


def _as_stated(cm: float) -> tuple[float, str]:
    return cm, f"{unit_of(cm).name}, as the format says"


def check_leg(leg: float) -> None:
    """Raise SkeletonError for a leg length in file units that is out of range."""
    if not SHORTEST_LEG <= leg <= LONGEST_LEG:
        raise SkeletonError(
            f"expected a leg length of {SHORTEST_LEG:g} to {LONGEST_LEG:,.0f} file units, found {leg:.3g}"
        )


def motion_unit(motion: Motion) -> tuple[float, str]:
    """Detect cm per unit of a motion of any rig; also returns how it was determined.

    The canonical joints are in cm if their legs have a plausible length. A non-human rig is in metres if it is small,
    else in cm.
    """
    cm = user_cm()
    if cm is not None:
        return cm, BY_USER
    leg, stated = rig_leg(usual_skeleton(motion)), motion.skeleton.cm
    if leg > 0.0:
        return rig_unit(motion.skeleton, leg)
    if stated is not None:
        return _as_stated(stated)
    if _chain_stature(motion) <= METRES_UP_TO:
        return 100.0, "no human rig; taken as metres"
    return 1.0, "no human rig; taken as centimetres"


def rig_unit(skeleton: Skeleton, leg: float) -> tuple[float, str]:
    """Detect cm per unit of a human rig by its leg in that unit; also returns how it was determined.

    A rig with the canonical joints is in cm if its legs have a plausible length.
    """
    canonical = set(skeleton.names) == set(JOINT_NAMES)
    if skeleton.cm is None and canonical and PLAUSIBLE_LEG[0] <= leg <= PLAUSIBLE_LEG[1]:
        return 1.0, "centimetres"
    return guess_scale(min(max(leg, SHORTEST_LEG), LONGEST_LEG), skeleton.cm)


def usual_skeleton(motion: Motion) -> Skeleton:
    """The skeleton of a motion with each joint that translates at its median position; files may hold other offsets."""
    if motion.local_positions is None:
        return motion.skeleton
    offsets = np.median(motion.local_positions, axis=0).astype(np.float32)
    offsets[0] = motion.skeleton.offsets[0]
    return replace(motion.skeleton, offsets=offsets)


def rig_places(skeleton: Skeleton) -> dict[str, int]:
    """The joints of the canonical joints of a human rig; none for other rigs."""
    try:
        return map_rig(skeleton).places
    except SkeletonError:
        return {}


def rig_leg(skeleton: Skeleton) -> float:
    """Thigh plus shin of a human rig in its unit, the mean of its whole legs; 0 for other rigs.

    A shin without a foot ends at its end site.
    """
    places = rig_places(skeleton)
    rest, chains = skeleton.rest_positions(), []
    for side in ("Left", "Right") if places else ():
        hip, knee = (rest[places[f"{side}{part}"]] for part in ("UpLeg", "Leg"))
        foot, end = places.get(f"{side}Foot"), skeleton.end_sites.get(places[f"{side}Leg"])
        if foot is not None or end is not None:
            chains.append(np.stack([hip, knee, rest[foot] if foot is not None else knee + np.array(end)]))
    return float(np.mean([_path(chain) for chain in chains])) if chains else 0.0


def stature(motion: Motion) -> float:
    """The standing height of a body in its unit, by its legs, or by its longest chain of joints if not human."""
    leg = rig_leg(usual_skeleton(motion))
    return leg / LEG_TO_STATURE if leg else _chain_stature(motion)


def _chain_stature(motion: Motion) -> float:
    """The standing height of a body by its longest chain of joints, in the middle frame."""
    parents = motion.skeleton.parents
    middle = motion_kinematics(motion.cut(len(motion) // 2, len(motion) // 2 + 1))[1][0].astype(np.float64)
    reach = np.zeros(len(parents))
    for joint, parent in enumerate(parents):
        if parent > 0 or (parent == 0 and parents.count(0) > 1):
            reach[joint] = reach[parent] + np.linalg.norm(middle[joint] - middle[parent])
    return max(float(2.0 * reach.max() / CHAINS_TO_STATURE), 1e-6)


def _path(points: Array) -> float:
    """The length of the path through points (N, 3)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=-1).sum())
