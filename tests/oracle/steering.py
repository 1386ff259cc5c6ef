"""What steering_kernel.c does, in plain Python: choice of gaits, their limits, speed control and springs."""

from __future__ import annotations

import math

from motionkit.control.steering import (
    GAIT_CHOICE,
    GOES_FROM,
    SPEED_CONTROL,
    STANDS_BELOW,
    Pair,
    SteeringOptions,
)
from motionkit.features.control import TRAJECTORY_OFFSETS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import RUN_SPEED, MotionKind


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
        if speed < GOES_FROM:
            return abs(math.sqrt(speed) - math.sqrt(gait.speed))
        turn = abs(nearest_turn(wanted - gait.facing)) + GAIT_CHOICE.backwards_share * abs(gait.facing)
        return abs(math.sqrt(speed) - math.sqrt(gait.speed)) + GAIT_CHOICE.turn_cost * turn

    return min(names, key=cost)


def speed_limits(model: MotionModel, kind: str) -> Pair:
    """Slowest and fastest speed of a type in cm/s; 0 and infinity if its recordings show none."""
    return model.speed_range(kind) or (0.0, math.inf)


def within_limits(
    model: MotionModel, kind: str, velocity: Pair, facing: float | None
) -> tuple[Pair, float | None]:
    """Return the velocity and facing nearest to a wish at which a steered type takes proper steps.

    Standing gets no velocity. A gait keeps within its recorded speeds, and its facing within a limit of its direction.

    Args:
        kind: a type; the wish stays as it is for types that are not steered.
        velocity: x and z in cm/s.
        facing: radians, None for any.
    """
    known, speed = model.types[kind], math.hypot(*velocity)
    if known.kind is MotionKind.STANCE:
        return (0.0, 0.0), facing
    if speed < STANDS_BELOW or known.kind is not MotionKind.GAIT or known.gait is None:
        return velocity, facing
    slowest, fastest = speed_limits(model, kind)
    share = min(max(speed, slowest), fastest) / speed
    if facing is not None:
        own = math.atan2(*velocity) - known.gait.facing
        aside = nearest_turn(facing - own)
        most = GAIT_CHOICE.most_aside_running if known.gait.runs else GAIT_CHOICE.most_aside
        if abs(aside) > most:
            facing = own + math.copysign(most, aside)
    return (share * velocity[0], share * velocity[1]), facing


class SpeedController:
    """Integral controller for the speed of one character: a factor on the wished speed for each gait.

    A well trained network misses the speed of its trajectory by a tenth, one trained for two hours by a quarter, and
    foot locking slows the root further. On a path the trajectory runs ahead of a body that lags, which corrects the
    speed. A velocity wish has no such place, so the error is integrated while the wish stays the same. After a change
    of wish the requested speed overshoots for SPEED_CONTROL.overshoot_seconds, because a body changes its speed slowly.

    The factor of a gait stays during other gaits and after a change of speed: a body at 0.9 of one speed reaches about
    0.9 of another.
    """

    def __init__(self, model: MotionModel) -> None:
        self.model = model
        self.shares: dict[str, float] = {}
        self._kind = ""
        self._wish: Pair = (0.0, 0.0)
        self._overshoot = 0.0  # cm/s of overshoot after a change of wish
        self._since = 0  # frames since the last change of wish

    def __call__(self, kind: str, velocity: Pair, gone: Pair) -> Pair:
        """Return the velocity to request in this frame; types other than gaits get the wished one.

        Args:
            kind: the present type.
            velocity: wished velocity, x and z in cm/s.
            gone: measured velocity of the body, x and z in cm/s.
        """
        speed = math.hypot(*velocity)
        if speed < STANDS_BELOW or self.model.kind(kind) is not MotionKind.GAIT:
            self._kind = ""
            return velocity
        if kind != self._kind or math.dist(velocity, self._wish) > SPEED_CONTROL.same_wish * speed:
            change = speed - math.hypot(*self._wish) if kind == self._kind else 0.0
            self._overshoot = SPEED_CONTROL.overshoot * min(max(change, -speed), speed)
            self._kind, self._wish, self._since = kind, velocity, 0
        self._since += 1
        share = self.shares.get(kind, 1.0)
        found = self._since > SPEED_CONTROL.wait * self.model.fps
        if found:
            along = (gone[0] * velocity[0] + gone[1] * velocity[1]) / speed
            share += (1.0 - along / speed) / (SPEED_CONTROL.seconds * self.model.fps)
            share = min(max(share, SPEED_CONTROL.least), SPEED_CONTROL.most)
        overshoot = (
            self._overshoot if self._since <= SPEED_CONTROL.overshoot_seconds * self.model.fps else 0.0
        )
        share = self._within(kind, speed, share * speed + overshoot) / speed
        if found:
            self.shares[kind] = share
        return share * velocity[0], share * velocity[1]

    def _within(self, kind: str, wanted: float, asked: float) -> float:
        """Limit a requested speed to the recorded speeds, or to the wanted speed if that is outside them."""
        slowest, fastest = speed_limits(self.model, kind)
        return max(min(asked, max(fastest, wanted)), min(slowest, wanted))


class Springs:
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
        share = 1.0 if free else self.options.measured_share
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


class SteeringInPython:
    """Steers one character, as motionkit.control.steering.Steering does."""

    def __init__(self, model: MotionModel, options: SteeringOptions) -> None:
        self.model, self.control_speed, self.springs = (
            model,
            SpeedController(model),
            Springs(model.fps, options),
        )

    def trajectory(self, kind: str, velocity: Pair, facing: float | None) -> tuple[list[float], float]:
        """The trajectory (24,) of a type for a wish, and the factor on the root-slip correction."""
        if facing is None and math.hypot(*velocity) >= STANDS_BELOW:
            gait = self.model.types[kind].gait
            facing = math.atan2(*velocity) - (0.0 if gait is None else gait.facing)
        velocity, facing = within_limits(self.model, kind, velocity, facing)
        velocity = self.control_speed(kind, velocity, self.springs.measured)
        settled = self.springs.settled(velocity)
        return self.springs.trajectory(velocity, facing), settled
