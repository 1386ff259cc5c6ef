"""Moves the root by what stands on the floor, for captures whose root is pinned or drifts (video, Kinect).

The pose alone says where the root goes: the lowest joint rests on the floor, and what is low stays in its place. In the
air the centre of mass goes on at its speed and falls freely. Its velocity over the ground is the smoothest one by which
low joints stand, by iteratively reweighted least squares: joints that disagree count less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, Doubles, length, spans
from motionkit.data.smoothing import WINDOW, smooth
from motionkit.metrics.flight import FREE_FALL, centre_of_mass
from motionkit.metrics.touch import TOUCH_HEIGHTS
from motionkit.motion.frame_rate import RATE
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_rotate
from motionkit.motion.skeleton import FOOT_JOINTS, STANDING_HEIGHTS

# Heights in cm at which joints rest on the floor; other joints than the feet lie lower than where they may touch it.
RESTS = 0.6 * TOUCH_HEIGHTS
RESTS[list(FOOT_JOINTS)] = STANDING_HEIGHTS
ANKLES, TOES = list(FOOT_JOINTS[::2]), list(FOOT_JOINTS[1::2])


@dataclass(frozen=True)
class FeetSettings:
    """How much a joint counts, and what a flight is; chosen on recorded clips whose root was taken away.

    Attributes:
        low: cm above the floor over which the weight of a joint falls to 1/e.
        slides: cm/s at which a joint that should stand counts half.
        pushes: usual acceleration of the centre of mass over the ground, in cm/s^2.
        rounds: rounds of reweighting.
        lifts: cm above where it would stand from which a body flies.
        gap: share of a flight in which neither its start nor its end shows it.
        longest: longest flight in s.
        leaps: least speed of a take-off and a landing, as a share of what the duration of the flight asks for.
    """

    low: float = 3.0
    slides: float = 10.0
    pushes: float = 600.0
    rounds: int = 12
    lifts: float = 0.3
    gap: float = 0.25
    longest: float = 0.8
    leaps: float = 0.4


FEET = FeetSettings()


def root_from_feet(motion: Motion) -> Motion:
    """The motion with its root where the feet say; the first frame keeps its place on the ground, the floor is at zero.

    Args:
        motion: T frames on the canonical joints, in cm with Y up; its root positions do not matter.
    """
    if len(motion) < 2:
        return motion
    whole = resample(motion, RATE)
    roots, times = _roots(whole), np.arange(len(whole)) * (motion.fps / RATE)
    at = np.arange(len(motion))
    found = np.stack([np.interp(at, times, roots[:, axis]) for axis in range(3)], axis=1)
    return replace(motion, root_positions=found.astype(motion.root_positions.dtype))


def _roots(motion: Motion) -> Doubles:
    """Root positions (T, 3) of a motion at RATE."""
    rotations, positions = motion_kinematics(motion)
    positions = positions.astype(np.float64)
    centre = centre_of_mass(positions)
    # A foot rolls over its tip when it leaves the floor.
    tips = positions[:, TOES] + _tips(motion, rotations)
    points = np.concatenate([positions, tips], axis=1) - centre[:, None]
    above = points[..., 1] - np.append(RESTS, RESTS[TOES])
    height = _flown(smooth(-above.min(axis=1), WINDOW), motion.fps)
    weights = np.exp(-np.maximum(above + height[:, None], 0.0) / FEET.low)
    weights[:, ANKLES] = 0.0  # an ankle moves on while its foot rolls
    moves = -np.diff(points[..., [0, 2]], axis=0) * motion.fps
    speeds = _smoothest(moves, np.minimum(weights[1:], weights[:-1]), motion.fps)
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(speeds, axis=0) / motion.fps])
    roots = motion.root_positions - centre + np.stack([path[:, 0], height, path[:, 1]], axis=1)
    roots[:, [0, 2]] += motion.root_positions[0, [0, 2]] - roots[0, [0, 2]]
    return np.asarray(roots, np.float64)


def _tips(motion: Motion, rotations: Array) -> Array:
    """From both toe joints to the tips of their feet (T, 2, 3)."""
    ends = [motion.skeleton.end_sites.get(toe, (0.0, 0.0, 0.0)) for toe in TOES]
    turns = rotations[:, TOES].astype(np.float64)
    return quat_rotate(turns, np.broadcast_to(np.array(ends, np.float64), (*turns.shape[:2], 3)))


def _flown(standing: Doubles, fps: float) -> Doubles:
    """Heights (T,) of the centre of mass, from those at which the lowest joint rests: arcs of free fall in flights.

    A flight begins where the floor throws the body up and ends where it would do so with time reversed. Its height
    follows from its duration.
    """
    fall = 100.0 * FREE_FALL / fps**2
    starts = spans(_thrown(standing, fall) > standing + FEET.lifts)
    ends = spans(_thrown(standing[::-1], fall)[::-1] > standing + FEET.lifts)
    out = standing.copy()
    for start, over in starts:
        resumed, end = next((each for each in ends if start <= each[0] and over <= each[1]), (over, len(out)))
        if end - start > FEET.longest * fps or resumed - over > FEET.gap * (end - start):
            continue
        frames = np.arange(start - 1, min(end + 1, len(out)))
        line = np.interp(frames, frames[[0, -1]], standing[frames[[0, -1]]])
        arc = line - 0.5 * fall * (frames - frames[0]) * (frames[-1] - frames)
        # A body that flies so long leaves the floor upwards and lands on it, about as fast as the arc.
        rises = standing[start - 1] - standing[max(start - 2, 0)]
        falls = standing[frames[-1]] - standing[min(frames[-1] + 1, len(out) - 1)]
        if min(rises, falls) > FEET.leaps * 0.5 * -fall * (end - start):
            out[frames] = np.maximum(out[frames], arc)
    return out


def _thrown(heights: Doubles, fall: float) -> Doubles:
    """Heights (T,) of a body that a floor at some heights pushes up but does not hold; fall is in cm per frame^2."""
    out = heights.tolist()
    for t in range(2, len(out)):
        out[t] = max(out[t], 2.0 * out[t - 1] - out[t - 2] + fall)
    return np.array(out)


def _smoothest(moves: Doubles, weights: Doubles, fps: float) -> Doubles:
    """Velocities (T, 2) of the centre of mass from those that let each joint stand (T, J, 2), with weights (T, J)."""
    stiff = (FEET.slides * fps / FEET.pushes) ** 2
    sure = weights
    for _ in range(FEET.rounds):
        speeds = _solved(sure.sum(axis=1), (sure[..., None] * moves).sum(axis=1), stiff)
        off = length(moves - speeds[:, None]) / FEET.slides
        sure = weights / (1.0 + off * off)
    return speeds


def _solved(weights: Doubles, values: Doubles, stiff: float) -> Doubles:
    """The x (T, 2) with the least sum of weights (T,) times x^2, less 2 x values (T, 2), plus stiff times its steps^2.

    The equations are tridiagonal: each row is eliminated by the one before it, then solved from the last one on.
    """
    pivots = weights + 2.0 * stiff + 1e-9
    pivots[[0, -1]] -= stiff
    diagonal, right = pivots.tolist(), (values[:, 0] + 1j * values[:, 1]).tolist()
    for t in range(1, len(right)):
        share = stiff / diagonal[t - 1]
        diagonal[t] -= share * stiff
        right[t] += share * right[t - 1]
    right[-1] /= diagonal[-1]
    for t in range(len(right) - 2, -1, -1):
        right[t] = (right[t] + stiff * right[t + 1]) / diagonal[t]
    both = np.array(right)
    return np.stack([both.real, both.imag], axis=1)
