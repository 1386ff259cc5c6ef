"""Steering: the trajectory of the coming second for a wished velocity and facing, and the gait that suits them.

A wish gives only a velocity, and no future places as a path does. So velocity and facing approach the wish like
critically damped springs: quickly at first and without overshoot. The code uses plain floats, because it runs for every
character in every frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from motionkit.control.script import TypePart
from motionkit.features.control import TRAJECTORY_OFFSETS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import RUN_SPEED, MotionKind

Pair = tuple[float, float]
STANDS_BELOW = 15.0  # cm/s; below this speed the character stands; chosen
GOES_FROM = 25.0  # cm/s; from this speed on only gaits are chosen, if the model has one; chosen
WALK_SPEED = 130.0  # cm/s of a usual walk; measured on CMU motion
NEUTRAL_SECONDS = 0.5  # duration of the neutral type before a command; chosen


@dataclass(frozen=True)
class GaitChoice:
    """How a gait is chosen for a wished velocity and facing; all numbers are chosen."""

    turn_cost: float = 3.0  # cost per radian between wished and usual facing, in square roots of cm/s
    backwards_share: float = 0.2  # extra cost per radian of the usual facing; prefers forward gaits
    forwards: float = math.pi / 4  # largest angle between facing and direction of a forward gait


@dataclass(frozen=True)
class SteeringOptions:
    """How a wished velocity and facing turn into the coming second; all numbers are chosen.

    Attributes:
        halflife: seconds in which the velocity makes half of a change.
        turn_halflife: the same for the facing.
        anchor_halflife: the same for the return to where a standing body stopped.
        own_share: share by which each frame moves the spring towards the measured movement. With 0 the spring ignores
            the body. With 1 it starts from the present velocity, and a slow body stays slow.
        smoothing: share of each frame in the measured velocity, because hips sway with every step.
        settled_within: lack of speed, as a share of the wish, at which the root-slip correction fades to 0.
        leave_anchor: cm; a standing body that is moved further stays there instead of returning.
        turn_speed: radians/s that the facing turns at most; faster bodies leave the ground with both feet.
        turn_share: least share of the speed of a body that turns back.
        turn_aside: largest angle in radians between velocity and facing while a walk turns; a run goes where it faces.
    """

    halflife: float = 0.1
    turn_halflife: float = 0.14
    anchor_halflife: float = 0.5
    own_share: float = 0.02
    smoothing: float = 0.2
    settled_within: float = 0.03
    leave_anchor: float = 60.0
    turn_speed: float = 6.0
    turn_share: float = 0.5
    turn_aside: float = math.pi / 4


GAIT_CHOICE = GaitChoice()


def spring_rate(halflife: float) -> float:
    """The rate y (1/s) of a critically damped spring that covers half of its distance in halflife seconds.

    The remaining share is (1 + y t) exp(-y t), which is a half at y t = 1.678.
    """
    return 1.678347 / max(halflife, 1e-3)


def spring(away: float, velocity: float, y: float, t: float) -> Pair:
    """Distance from the goal, and velocity, of a critically damped spring of rate y after t seconds."""
    push = velocity + away * y
    fade = math.exp(-y * t)
    return fade * (away + push * t), fade * (velocity - y * push * t)


def spring_travel(away: float, velocity: float, y: float, t: float) -> float:
    """The integral over t seconds of such a spring's distance from the goal."""
    push = velocity + away * y
    fade = math.exp(-y * t)
    return (away * (1.0 - fade) + push * ((1.0 - fade) / y - t * fade)) / y


def nearest_turn(angle: float) -> float:
    """An angle wrapped to -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)


def steered_type(model: MotionModel, velocity: Pair, facing: float | None) -> str:
    """Choose the steered type for a wished velocity (x, z in cm/s) and facing (radians, None for any).

    The choice minimises the difference in speed and in facing. Speeds count as square roots, so that slow types have
    narrow bands. A model without steered types chooses among the types without a phase.
    """
    known = [name for name in model.types if model.kind(name).steered]
    if math.hypot(*velocity) >= GOES_FROM:
        # A standing body would glide at this speed.
        known = [name for name in known if model.kind(name) is MotionKind.GAIT] or known
    names = known or [name for name in model.types if not model.kind(name).phased] or list(model.types)
    speed, direction = math.hypot(*velocity), math.atan2(*velocity)

    def cost(kind: str) -> float:
        gait = model.types[kind].gait
        if gait is None:
            return math.inf
        wanted = 0.0 if facing is None else direction - facing
        if speed < STANDS_BELOW:
            return abs(math.sqrt(speed) - math.sqrt(gait.speed))
        turn = abs(nearest_turn(wanted - gait.facing)) + GAIT_CHOICE.backwards_share * abs(gait.facing)
        return abs(math.sqrt(speed) - math.sqrt(gait.speed)) + GAIT_CHOICE.turn_cost * turn

    return min(names, key=cost)


@dataclass(frozen=True)
class Gaits:
    """The usual types to stand, walk and run in a model, found from their motion; None where it has none.

    Attributes:
        stand: standing still.
        walk: walking forwards at about WALK_SPEED.
        run: the fastest run forwards.
        back: moving backwards.
    """

    stand: str | None
    walk: str | None
    run: str | None
    back: str | None


def usual_gaits(model: MotionModel) -> Gaits:
    """Find the types of a model that stand, walk, run and move backwards, whatever their names."""
    found = {name: known.gait for name, known in model.types.items() if known.kind.steered and known.gait}
    stands = [name for name in found if model.kind(name) is MotionKind.STANCE]
    turned = {name: abs(nearest_turn(gait.facing)) for name, gait in found.items() if name not in stands}
    ahead = [name for name, turn in turned.items() if turn < GAIT_CHOICE.forwards]
    back = [name for name, turn in turned.items() if turn > math.pi - GAIT_CHOICE.forwards]
    walks = [name for name in ahead if not found[name].runs]
    return Gaits(
        min(stands, key=lambda name: found[name].speed, default=None),
        min(walks, key=lambda name: abs(found[name].speed - WALK_SPEED), default=None),
        max((name for name in ahead if found[name].runs), key=lambda name: found[name].speed, default=None),
        max(back, key=lambda name: abs(found[name].facing), default=None),
    )


def walking_type(model: MotionModel) -> str:
    """The default type on a path: a walk, else the steered type for a velocity of WALK_SPEED."""
    return usual_gaits(model).walk or steered_type(model, (0.0, WALK_SPEED), 0.0)


def neutral_types(model: MotionModel) -> tuple[str, ...]:
    """The neutral types before a command: standing and walking."""
    return tuple(dict.fromkeys((steered_type(model, (0.0, 0.0), None), walking_type(model))))


def commanded(model: MotionModel, kind: str, seconds: float, seed: int) -> tuple[TypePart, TypePart]:
    """The parts of a roll-out that shows a type: a neutral type, alternating with the seed, then the type."""
    neutral = neutral_types(model)
    return TypePart(neutral[seed % len(neutral)], NEUTRAL_SECONDS), TypePart(kind, seconds)


class Steering:
    """The springs that make the trajectories of one character, and the anchor where it stopped."""

    def __init__(self, fps: float, options: SteeringOptions) -> None:
        self.fps, self.options = fps, options
        self.velocity: list[float] = [0.0, 0.0]
        self._acceleration: list[float] = [0.0, 0.0]
        self._measured: list[float] = [0.0, 0.0]
        self._facing: Pair | None = None  # heading and turning speed of the spring
        self._before: tuple[float, float, float] | None = None
        self._anchor: tuple[float, float, float] | None = None

    def observe(self, x: float, z: float, heading: float, free: bool) -> None:
        """Measure the movement of the body; call this once per frame, before trajectory.

        Args:
            free: whether nobody steers; the springs then follow the body.
        """
        before = self._before or (x, z, heading)
        self._before = (x, z, heading)
        steps = ((x - before[0]) * self.fps, (z - before[1]) * self.fps)
        share = 1.0 if free else self.options.own_share
        for axis, step in enumerate(steps):
            self._measured[axis] += self.options.smoothing * (step - self._measured[axis])
            self.velocity[axis] += share * (self._measured[axis] - self.velocity[axis])
            self._acceleration[axis] *= 1.0 - share
        facing, turning = self._facing or (heading, 0.0)
        off = nearest_turn(facing - heading) * (1.0 - share)
        self._facing = (heading + off, turning * (1.0 - share))
        if free:
            self._anchor = None

    @property
    def measured(self) -> Pair:
        """The velocity of the body, x and z in cm/s, smoothed over some frames."""
        return self._measured[0], self._measured[1]

    def trajectory(self, velocity: Pair, facing: float | None) -> list[float]:
        """The 24 trajectory numbers in the heading frame, after observe.

        Args:
            velocity: wished velocity, x and z in cm/s; below STANDS_BELOW the character stands where it stopped.
            facing: wished heading in radians; None keeps the heading at which it stopped, or the present one.
        """
        assert self._before is not None and self._facing is not None
        x, z, heading = self._before
        stands = math.hypot(*velocity) < STANDS_BELOW
        if facing is not None:
            velocity, facing = self._turning(velocity, facing)
        goal = (0.0, 0.0) if stands else velocity
        anchor = self._hold(x, z) if stands else None
        if not stands:
            self._anchor = None
        wanted = facing if facing is not None else (heading if anchor is None else anchor[2])
        places = [self._place(axis, goal[axis], anchor) for axis in (0, 1)]
        turns = self._turns(wanted, heading)
        self._advance(goal, wanted)
        sine, cosine = math.sin(heading), math.cos(heading)
        out: list[float] = []
        for ahead_x, ahead_z in zip(*places, strict=True):
            out += (cosine * ahead_x - sine * ahead_z, sine * ahead_x + cosine * ahead_z)
        for turn in turns:
            out += (math.sin(turn), math.cos(turn))
        return out

    def _turning(self, velocity: Pair, facing: float) -> tuple[Pair, float]:
        """The velocity and the facing to approach: a body turns about where it faces, and slows down to turn back."""
        assert self._facing is not None
        off = nearest_turn(facing - self._facing[0])
        # A spring whose goal stays at distance d ahead of it moves by d * rate / 2.
        most = 2.0 * self.options.turn_speed / spring_rate(self.options.turn_halflife)
        share = min(max(1.0 + math.cos(off), self.options.turn_share), 1.0)
        aside = 0.0 if math.hypot(*velocity) > RUN_SPEED else self.options.turn_aside
        back = -math.copysign(max(abs(off) - aside, 0.0), off)
        sine, cosine = math.sin(back), math.cos(back)
        ahead = cosine * velocity[0] + sine * velocity[1], cosine * velocity[1] - sine * velocity[0]
        return (share * ahead[0], share * ahead[1]), self._facing[0] + min(max(off, -most), most)

    def settled(self, velocity: Pair) -> float:
        """Factor on the root-slip correction, 0 to 1: small while the body lacks speed in the wished direction.

        Args:
            velocity: wished velocity, x and z in cm/s.
        """
        speed = math.hypot(*velocity)
        if speed < STANDS_BELOW:
            return 1.0
        along = (self.velocity[0] * velocity[0] + self.velocity[1] * velocity[1]) / speed
        return min(1.0, max(0.0, 1.0 - (1.0 - along / speed) / self.options.settled_within))

    def _hold(self, x: float, z: float) -> tuple[float, float, float] | None:
        """Place and heading to keep once the spring has nearly stopped; None before that."""
        assert self._facing is not None
        far = self._anchor is not None and math.dist(self._anchor[:2], (x, z)) > self.options.leave_anchor
        if self._anchor is None or far:
            if math.hypot(*self.velocity) > STANDS_BELOW:
                return None
            self._anchor = (x, z, self._facing[0])
        return self._anchor

    def _place(self, axis: int, goal: float, anchor: tuple[float, float, float] | None) -> list[float]:
        """Displacement along an axis at each of the six trajectory times."""
        assert self._before is not None
        times = [offset / self.fps for offset in TRAJECTORY_OFFSETS]
        if anchor is not None:
            y = spring_rate(self.options.anchor_halflife)
            away = self._before[axis] - anchor[axis]
            return [spring(away, self.velocity[axis], y, t)[0] - away for t in times]
        y = spring_rate(self.options.halflife)
        away = self.velocity[axis] - goal
        return [goal * t + spring_travel(away, self._acceleration[axis], y, t) for t in times]

    def _turns(self, wanted: float, heading: float) -> list[float]:
        """Turn from the present heading at each of the six trajectory times."""
        assert self._facing is not None
        y = spring_rate(self.options.turn_halflife)
        away = nearest_turn(self._facing[0] - wanted)
        begin = nearest_turn(self._facing[0] - heading) - away
        return [begin + spring(away, self._facing[1], y, t / self.fps)[0] for t in TRAJECTORY_OFFSETS]

    def _advance(self, goal: Pair, wanted: float) -> None:
        """Advance the springs by one frame."""
        assert self._facing is not None
        y, t = spring_rate(self.options.halflife), 1.0 / self.fps
        for axis in (0, 1):
            away, self._acceleration[axis] = spring(
                self.velocity[axis] - goal[axis], self._acceleration[axis], y, t
            )
            self.velocity[axis] = goal[axis] + away
        away = nearest_turn(self._facing[0] - wanted)
        off, turning = spring(away, self._facing[1], spring_rate(self.options.turn_halflife), t)
        self._facing = (self._facing[0] - away + off, turning)
