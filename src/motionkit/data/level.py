"""The tilt of a recorded floor, found from where the feet of one performer stand, and taken out.

Volumes of optical systems are calibrated by hand. Where one is off by a degree, the floor rises by 2 cm a metre, and
one shift of the height fits only the middle of a clip.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array
from motionkit.motion.floor import TOE_HEIGHT, TOES, floor_shift, standing_toes
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_multiply, quat_normalize, quat_rotate


@dataclass(frozen=True)
class TiltRule:
    """How the tilt of a floor is found. Measured on CMU subjects (docs/cleaning.md), if nothing else is said.

    Slopes are in cm per cm, distances and heights in cm.
    """

    held_up: float = (
        12.0  # a toe so much higher than standing ones is held in the air; with more, it counts as floor
    )
    cell: float = 30.0  # size of the cells of the floor of which each counts once. Chosen: about a foot
    # Slopes are sought around zero with this deviation, and those between the two others are taken out: a steeper one
    # is a ramp and no error of the recording, a smaller one is within what feet tell.
    usual: float = 0.01
    least: float = 0.003
    steepest: float = 0.04
    certain: float = (
        3.0  # deviations by which a slope must differ from none; with less, walks in one place tilt floors
    )
    evener: float = 0.85  # share of the unevenness that may be left; with more, floors are turned for nothing
    stray: float = 5.0  # distance from a floor that counts as the most in its unevenness. Chosen
    # Deviation of the heights of footfalls, at least, and the height off the plane beyond which they count linearly.
    # Chosen: toes of one performer stand within half a centimetre.
    noise: float = 0.5
    outlier: float = 1.0
    rounds: int = 20  # of least squares; the weights have settled


TILT = TiltRule()


def performer(named: Iterable[str], body: Array) -> str:
    """Whose clip it is: the first performer that labels name, or else the body (23, 3) to within 0.01 mm."""
    return next(filter(None, named), "") or json.dumps(np.round(body, 3).tolist())


def footfalls(motion: Motion) -> tuple[Array, ...]:
    """Places (F, 3) in cm where each toe stands: one for each cell of the floor, however often it stands there.

    Toes of one performer may be some millimetres higher than the other's, so each is by itself.

    Args:
        motion: its standing toes are at TOE_HEIGHT in the middle of the clip.
    """
    toes = motion_kinematics(motion)[1][:, list(TOES)].astype(np.float64)
    standing = standing_toes(toes, motion.fps) & (toes[..., 1] < TOE_HEIGHT + TILT.held_up)
    return tuple(_cells(toes[standing[:, side], side]) for side in range(len(TOES)))


def _cells(places: Array) -> Array:
    """Mean (F, 3) of the places (N, 3) in each cell of the floor."""
    _, cell, counts = np.unique(
        np.floor(places[:, [0, 2]] / TILT.cell), axis=0, return_inverse=True, return_counts=True
    )
    sums = np.zeros((len(counts), 3))
    np.add.at(sums, cell.reshape(-1), places)
    return sums / counts[:, None]


def floor_tilts(standing: Iterable[tuple[str, Sequence[Array]]]) -> dict[str, Array]:
    """The tilt (2,) of the floor under each performer, from all of the performer's clips.

    Args:
        standing: performer and footfalls of each clip.
    """
    falls: dict[str, list[Array]] = defaultdict(list)
    for whose, each in standing:
        falls[whose].extend(each)
    return {whose: floor_tilt(groups) for whose, groups in falls.items()}


def floor_tilt(groups: Sequence[Array]) -> Array:
    """Slopes (2,) of the floor along x and z, in cm per cm, shared by toes and clips whose heights may differ.

    Least squares with outliers counted linearly and slopes drawn towards none, so that a few steps in one place say
    nothing. A direction in which the slope is not certain gets none, and so does a floor that becomes little evener.

    Args:
        groups: footfalls (F, 3) of each toe in each clip.
    """
    rows = [each for each in groups if len(each) > 1]
    if not rows:
        return np.zeros(2)
    falls = np.concatenate(rows)
    group = np.repeat(np.arange(len(rows)), [len(each) for each in rows])
    weights: Array = np.ones(len(falls))
    slope: Array = np.zeros(2)
    for _ in range(TILT.rounds):
        total = np.bincount(group, weights)
        means = np.stack([np.bincount(group, weights * falls[:, k]) / total for k in range(3)], axis=1)
        apart = falls - means[group]
        ground, height = apart[:, [0, 2]], apart[:, 1]
        left = height - ground @ slope
        noise = max(TILT.noise, float(np.sqrt((weights * left**2).sum() / weights.sum())))
        precision = (ground * weights[:, None]).T @ ground / noise**2 + np.eye(2) / TILT.usual**2
        slope = np.linalg.solve(precision, (ground * weights[:, None]).T @ height / noise**2)
        weights = np.minimum(1.0, TILT.outlier / np.maximum(np.abs(height - ground @ slope), 1e-9))
    sizes, axes = np.linalg.eigh(precision)
    along = axes.T @ slope
    slope = axes @ np.where(np.abs(along) * np.sqrt(sizes) >= TILT.certain, along, 0.0)
    if not TILT.least <= float(np.linalg.norm(slope)) <= TILT.steepest:
        return np.zeros(2)
    return slope if _unevenness(rows, slope) <= TILT.evener * _unevenness(rows, np.zeros(2)) else np.zeros(2)


def _unevenness(groups: Sequence[Array], slope: Array) -> float:
    """Mean distance in cm of footfalls from a floor of some slope, far ones counted as TILT.stray."""
    above = [each[:, 1] - each[:, [0, 2]] @ slope for each in groups]
    apart = np.concatenate([np.abs(each - np.median(each)) for each in above])
    return float(np.minimum(apart, TILT.stray).mean())


def levelled(motion: Motion, tilt: Array) -> Motion:
    """The motion turned so that a floor of some tilt is level, with its standing toes at TOE_HEIGHT again.

    Args:
        tilt: (2,) from floor_tilt.
    """
    if not tilt.any():
        return motion
    x, z = tilt
    up = np.array([-x, 1.0, -z]) / np.sqrt(1.0 + x * x + z * z)
    # The shortest turn from the floor's own up to +Y.
    turn = quat_normalize(np.array([1.0 + up[1], -up[2], 0.0, up[0]])).astype(motion.local_rotations.dtype)
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(np.broadcast_to(turn, rotations[:, 0].shape), rotations[:, 0])
    middle = motion.root_positions.mean(axis=0)
    roots = quat_rotate(np.broadcast_to(turn, (len(motion), 4)), motion.root_positions - middle) + middle
    turned = replace(
        motion, local_rotations=rotations, root_positions=roots.astype(motion.root_positions.dtype)
    )
    lift = np.array([0.0, floor_shift(turned)[0], 0.0], motion.root_positions.dtype)
    return replace(turned, root_positions=turned.root_positions + lift)
