"""Kinematic detectors of the motion types, in one table: does a motion show the requested type?

The thresholds are calibrated on recordings. `motionkit evaluate` reports how many recordings of its own and of other
types each detector accepts. A type gets its detector by its recordings, not by its name (judge.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import lower_median, spans
from motionkit.metrics.body import Body

HOLD = 0.8  # share of the windows in which a continuous type must be detected
STRIDE = 0.25  # distance between the starts of two windows, as a share of a window
LEAST_WINDOW = 0.5  # shortest recording that is judged, as a share of a window


@dataclass(frozen=True)
class Detector:
    """The detector of one type.

    Attributes:
        description: the condition in words, with its thresholds.
        shows: whether a stretch of motion shows the type.
        window: seconds of the windows in which a continuous type is judged; 0 for a type that is performed once,
            which is judged over the whole motion.
    """

    description: str
    shows: Callable[[Body], bool]
    window: float = 0.0


def detection_windows(body: Body, window: float) -> list[Body]:
    """Return the windows of a motion, or the whole motion if it is shorter than a window or if window is 0."""
    size = round(window * body.fps)
    if size <= 0 or len(body) <= size:
        return [body]
    starts = range(0, len(body) - size + 1, max(1, round(STRIDE * size)))
    return [body.cut(start, start + size) for start in starts]


# ---- standing and locomotion ----


def _steps(body: Body) -> bool:
    """Whether the legs swing alternately."""
    return float(body.foot_ahead.max() - body.foot_ahead.min()) > 25.0


def _idle(body: Body) -> bool:
    standing = float(lower_median(body.lifts.max(axis=-1))) < 10.0
    return float(body.speed.mean()) < 0.15 and standing and body.joint_speed() < 1.0


def _goes(body: Body, slowest: float, fastest: float, direction: float) -> bool:
    speed, ahead = float(body.speed.mean()), float(body.velocity[:, 1].mean())
    return slowest <= speed <= fastest and direction * ahead >= 0.5 * speed and _steps(body)


def _walking(body: Body) -> bool:
    return _goes(body, 0.4, 2.0, 1.0) and body.stride_flight_frames() < 0.05 * body.fps


def _backwards(body: Body) -> bool:
    return _goes(body, 0.3, 2.0, -1.0) and body.stride_flight_frames() < 0.05 * body.fps


def _running(body: Body) -> bool:
    return _goes(body, 1.4, 8.0, 1.0) and body.stride_flight_frames() >= 2


# ---- jumps ----

JUMP_SECONDS = 0.2  # shortest flight of a jump
TAKE_OFF_SECONDS = 0.15  # time before a flight in which the lower foot is the take-off foot
ONE_FOOT = 5.0  # cm; in a take-off from one foot the other foot is at least this much higher


def take_offs(body: Body) -> list[str]:
    """Return the take-off foot of each flight of at least JUMP_SECONDS: "l", "r" or "b" for both."""
    out = []
    before = round(TAKE_OFF_SECONDS * body.fps)
    for start, end in body.flights:
        if end - start < JUMP_SECONDS * body.fps - 0.5 or start == 0:
            continue
        left, right = body.lifts[max(0, start - before) : start].mean(axis=0).tolist()
        out.append("b" if abs(left - right) < ONE_FOOT else ("l" if left < right else "r"))
    return out


def _jumps(foot: str) -> Callable[[Body], bool]:
    def shows(body: Body) -> bool:
        found = take_offs(body)
        turns_over = float(body.head_height.min()) < 0.0
        return found.count(foot) >= max(1, len(found) / 2) and not turns_over

    return shows


# ---- strikes ----


def _kick_spans(body: Body) -> list[tuple[int, int]]:
    high = spans(body.ankle_height > 0.0)
    return [(a, b) for a, b in high if float(body.hand_heights[a:b].min()) > 40.0]


def _kicking(body: Body) -> bool:
    return any(float(body.head_height[a:b].min()) > 10.0 for a, b in _kick_spans(body))


def _whirl_kick(body: Body) -> bool:
    around = round(0.75 * body.fps)
    for start, end in _kick_spans(body):
        near = slice(max(0, start - around), end + around)
        spin = body.turned[near, 1]
        flies = body.cut(near.start, near.stop).flight_seconds() >= JUMP_SECONDS
        high = float(body.ankle_height[start:end].max()) > 30.0
        if flies and high and float(spin.max() - spin.min()) > 4.0:
            return True
    return False


def _punching(body: Body) -> bool:
    soon = round(0.5 * body.fps)
    high = body.hand_heights - body.positions[:, :1, 1] > 20.0
    straight = (body.arm_extension > 0.9) & (body.arm_ahead > 0.75) & high
    thrust = (body.arm_thrust > 65.0) & (body.arm_extension < 0.8)
    after = sliding_window_view(np.pad(straight, ((0, soon), (0, 0))), soon + 1, axis=0).any(axis=-1)
    return bool((thrust & after).any())


# ---- turning over ----

# cm above the floor: hands below HANDS_DOWN may bear weight; in a roll, hips go below UPRIGHT_HIPS.
HANDS_DOWN, UPRIGHT_HIPS = 25.0, 50.0


@dataclass(frozen=True)
class Turn:
    """One turn of the body with the head below the hips.

    Attributes:
        forwards, spin, sideways: angles in radians that the hips turn about their own axes, from 0.75 s before to
            0.75 s after the head is below them. Only forwards has a sign.
        hands: lowest height of a hand above the floor in cm while the head is below the hips.
        hips: lowest height of the hips above the floor in cm.
        ankles: largest height of an ankle above the hips in cm.
        flight: longest flight in seconds.
        seconds: time for which the head is below the hips.
        recovers: whether the head is up again within 1.5 s.
    """

    forwards: float
    spin: float
    sideways: float
    hands: float
    hips: float
    ankles: float
    flight: float
    seconds: float
    recovers: bool


def turns(body: Body) -> list[Turn]:
    """Return every turn of the body with the head below the hips; turns less than 0.2 s apart are one."""
    found: list[tuple[int, int]] = []
    for start, end in spans(body.head_height < 0.0):
        if found and start - found[-1][1] < 0.2 * body.fps:
            found[-1] = (found[-1][0], end)
        else:
            found.append((start, end))
    around, later = round(0.75 * body.fps), round(1.5 * body.fps)
    out = []
    for start, end in found:
        near = slice(max(0, start - around), min(len(body), end + around))
        turned = body.turned[near]
        reach = turned.max(axis=0) - turned.min(axis=0)
        forwards = turned[:, 0]
        # The sign of forwards is that of the larger deviation.
        ahead = float(forwards.max() - forwards[0]) > float(forwards[0] - forwards.min())
        out.append(
            Turn(
                float(reach[0]) * (1.0 if ahead else -1.0),
                float(reach[1]),
                float(reach[2]),
                float(body.hand_heights[start:end].min()),
                float(body.positions[near, 0, 1].min()),
                float(body.ankle_height[start:end].max()),
                body.cut(near.start, near.stop).flight_seconds(),
                (end - start) / body.fps,
                bool((body.head_height[end : end + later] > 25.0).any()),
            )
        )
    return out


def _turns_over(test: Callable[[Turn], bool]) -> Callable[[Body], bool]:
    return lambda body: any(turn.recovers and test(turn) for turn in turns(body))


def _duck(body: Body) -> bool:
    moving = float(body.speed.mean()) >= 1.0
    low = spans(body.head_height < 5.0)
    return moving and any(
        float(body.head_height[end : end + round(1.5 * body.fps)].max()) > 25.0
        and float(body.ankle_height[start:end].max()) < 10.0
        for start, end in low
        if end < len(body)
    )


DETECTORS: dict[str, Detector] = {
    "idle": Detector(
        "root below 0.15 m/s, joints below 1 rad/s, both feet mostly within 10 cm of the ground",
        _idle,
        2.0,
    ),
    "walking": Detector(
        "0.4 to 2 m/s, mostly in the facing direction, legs swing, no flight of 0.05 s", _walking, 2.0
    ),
    "b-walking": Detector("0.3 to 2 m/s, mostly backwards, legs swing, no flight of 0.05 s", _backwards, 2.0),
    "running": Detector(
        "1.4 to 8 m/s, mostly in the facing direction, legs swing, a flight of 2 frames", _running, 2.0
    ),
    "jumping-b": Detector("at least half of the flights of 0.2 s start from both feet", _jumps("b"), 3.0),
    "jumping-l": Detector("at least half of the flights of 0.2 s start from the left foot", _jumps("l"), 3.0),
    "jumping-r": Detector(
        "at least half of the flights of 0.2 s start from the right foot", _jumps("r"), 3.0
    ),
    "kicking": Detector("an ankle above the hips, head up, hands 40 cm off the ground", _kicking, 4.0),
    "punching": Detector(
        "a bent arm extends at 0.65 m/s to 90 % of its length within 0.5 s, forwards and 20 cm above the hips",
        _punching,
        6.0,
    ),
    "w-kicking": Detector(
        "an ankle 30 cm above the hips, with a flight of 0.2 s and a spin of 4 rad within 0.75 s", _whirl_kick
    ),
    "cartwheel": Detector(
        "head below hips and up again, hands within 25 cm of the ground, turned sideways by 3 rad, hips above 50 cm",
        _turns_over(
            lambda t: t.sideways > 3.0 and t.hands <= HANDS_DOWN and t.hips > UPRIGHT_HIPS and t.spin < 4.0
        ),
    ),
    "backflip": Detector(
        "head below hips and up again, hands free, turned backwards by 4 rad",
        _turns_over(lambda t: t.forwards < -4.0 and t.hands > HANDS_DOWN),
    ),
    "handspring": Detector(
        "head below hips and up again, hands within 25 cm of the ground, turned forwards by 3 rad, hips above 50 cm",
        _turns_over(
            lambda t: (
                t.forwards > 3.0
                and t.forwards > t.sideways
                and t.hands <= HANDS_DOWN
                and t.hips > UPRIGHT_HIPS
            )
        ),
    ),
    "side-somersault": Detector(
        "head below hips and up again, hands free, turned sideways by 3 rad",
        _turns_over(lambda t: t.sideways > 3.0 and t.hands > HANDS_DOWN and t.spin < 4.0),
    ),
    "dive-roll": Detector(
        "head below hips and up again, turned forwards by 2.5 rad, hips below 40 cm",
        _turns_over(lambda t: t.forwards > 2.5 and t.hips < 40.0),
    ),
    "twist": Detector(
        "head below hips and up again, a flight of 0.3 s, a spin of 4 rad about the spine",
        _turns_over(lambda t: t.spin > 4.0 and t.flight > 0.3),
    ),
    "duck": Detector("at least 1 m/s; head below 5 cm above the hips and up again, feet low", _duck),
}
