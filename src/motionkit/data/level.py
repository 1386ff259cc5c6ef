"""Finds and removes the tilt of a recorded floor, from the places where one performer's feet stand.

Optical capture volumes are calibrated by hand. If a calibration is off by one degree, the floor rises by 2 cm a metre,
and no single height shift fits the whole clip.
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
    """Constants of the fit of a floor. Measured on CMU subjects (docs/dataset.md) except where "chosen".

    Slopes are in cm per cm, distances and heights in cm.
    """

    # A slow toe this much above standing ones is held in the air and left out. With larger values it counts as floor.
    above_toe: float = 12.0
    cell: float = 30.0  # side of a floor cell, in which footfalls count once. Chosen: a foot's length
    usual: float = 0.01  # standard deviation of slopes around zero, the prior of the fit
    # Only slopes between these two are removed: feet are too uncertain for smaller ones, larger ones are real ramps.
    least: float = 0.003
    steepest: float = 0.04
    # Standard deviations by which a slope must differ from zero. With smaller values, a walk in one place tilts floors.
    certain: float = 3.0
    evener: float = 0.85  # share to which levelling must reduce the unevenness; more turns floors needlessly
    stray: float = 5.0  # largest distance from the floor that one footfall adds to the unevenness. Chosen
    # Smallest standard deviation of footfall heights, and the height off the plane beyond which they count linearly.
    # Chosen: toes of one performer stand within half a centimetre.
    noise: float = 0.5
    outlier: float = 1.0
    rounds: int = 20  # iterations of reweighted least squares; the weights have converged by then


TILT = TiltRule()


def performer(named: Iterable[str], body: Array) -> str:
    """A key for a clip's performer: the first name in the labels, else the body's offsets (23, 3) in cm."""
    return next(filter(None, named), "") or json.dumps(np.round(body, 3).tolist())


def footfalls(motion: Motion) -> tuple[Array, ...]:
    """Places (F, 3) in cm where each toe of a clip stands, one per cell of the floor; standing toes are at TOE_HEIGHT.

    The two toes are kept apart, because one may stand some millimetres higher than the other.
    """
    toes = motion_kinematics(motion)[1][:, list(TOES)].astype(np.float64)
    standing = standing_toes(toes, motion.fps) & (toes[..., 1] < TOE_HEIGHT + TILT.above_toe)
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
    """The tilt (2,) of each performer's floor, from the performer and the footfalls of each clip."""
    falls: dict[str, list[Array]] = defaultdict(list)
    for whose, each in standing:
        falls[whose].extend(each)
    return {whose: floor_tilt(groups) for whose, groups in falls.items()}


def floor_tilt(groups: Sequence[Array]) -> Array:
    """Slopes (2,) of the floor along x and z, in cm per cm, under the footfalls (F, 3) of each toe in each clip.

    Each toe and clip may have its own height. A least-squares fit in which outliers count linearly (Huber) and a prior
    keeps slopes near zero, so that a few steps in one place have no effect. A slope is zero along directions where it
    is uncertain, and everywhere if levelling hardly makes the floor more even.
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
    """Mean distance in cm of footfalls from a floor with this slope; each counts at most TILT.stray."""
    above = [each[:, 1] - each[:, [0, 2]] @ slope for each in groups]
    apart = np.concatenate([np.abs(each - np.median(each)) for each in above])
    return float(np.minimum(apart, TILT.stray).mean())


def levelled(motion: Motion, tilt: Array) -> Motion:
    """The motion turned so that a floor of tilt (2,) is level, and shifted so that toes stand at TOE_HEIGHT again."""
    if not tilt.any():
        return motion
    x, z = tilt
    up = np.array([-x, 1.0, -z]) / np.sqrt(1.0 + x * x + z * z)
    # The shortest rotation from the floor's normal to +Y.
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
