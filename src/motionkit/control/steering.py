"""Steering: the trajectory of the coming second for a wished velocity and facing, and the gait that suits them.

steering_kernel.c does it, for Python and for web pages; here are its settings, and the usual gaits of a model.
"""

from __future__ import annotations

import math
from ctypes import Structure, addressof, byref, c_double, c_float, c_int32, c_int64, c_void_p
from dataclasses import astuple, dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.script import TypePart
from motionkit.control.steering_kernel import doubles, steering_library
from motionkit.features.control import TRAJECTORY_COUNT
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import RUN_SPEED, MotionKind

Pair = tuple[float, float]
STANDS_BELOW = 15.0  # cm/s; below this speed the character stands; chosen
GOES_FROM = 25.0  # cm/s; from this speed on only gaits are chosen, if the model has one; chosen
WALK_SPEED = 130.0  # cm/s of a usual walk; measured on CMU motion
FORWARDS = math.pi / 4  # largest angle between facing and direction of a forward gait; chosen
NEUTRAL_SECONDS = 0.5  # duration of the neutral type before a command; chosen


@dataclass(frozen=True)
class GaitChoice:
    """How a gait is chosen for a wished velocity and facing, and how far aside it goes.

    Beyond the largest angles between the wished facing and the usual one of the gait, walks hardly lift their feet and
    runs slide; they are measured on roll-outs, the other numbers are chosen.
    """

    stands_below: float = STANDS_BELOW
    goes_from: float = GOES_FROM
    run_speed: float = RUN_SPEED
    turn_cost: float = 3.0  # cost per radian between wished and usual facing, in square roots of cm/s
    backwards_share: float = 0.2  # extra cost per radian of the usual facing; prefers forward gaits
    most_aside: float = math.pi / 4
    most_aside_running: float = math.pi / 6


@dataclass(frozen=True)
class SpeedControl:
    """Integral controller for speed; all numbers are chosen, by live roll-outs."""

    seconds: float = 1.0  # time in which the integral grows by the present error
    wait: float = 0.5  # s after a change of wish, while the body accelerates, without integration
    same_wish: float = 0.1  # change of velocity, as a share of the speed, up to which the wish is the same
    overshoot: float = 0.3  # overshoot of the requested speed at first, as a share of the change
    overshoot_seconds: float = 0.35  # duration of the overshoot
    least: float = 0.75  # limits of the requested speed, as shares of the wish
    most: float = 1.35


@dataclass(frozen=True)
class SteeringOptions:
    """How a wished velocity and facing turn into the coming second; all numbers are chosen.

    Attributes:
        halflife: seconds in which the velocity makes half of a change.
        turn_halflife: the same for the facing.
        anchor_halflife: the same for the return to where a standing body stopped.
        measured_share: share by which each frame moves the spring towards the measured movement. With 0 the spring
            ignores the body. With 1 it starts from the present velocity, and a slow body stays slow.
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
    measured_share: float = 0.02
    smoothing: float = 0.2
    settled_within: float = 0.03
    leave_anchor: float = 60.0
    turn_speed: float = 6.0
    turn_share: float = 0.5
    turn_aside: float = math.pi / 4


GAIT_CHOICE, SPEED_CONTROL = GaitChoice(), SpeedControl()


class _Type(Structure):
    _fields_ = (*((name, c_double) for name in "speed facing slowest fastest".split()), ("kind", c_int64))


class _Steering(Structure):
    _fields_ = (
        ("fps", c_double), ("choice", doubles(GaitChoice)), ("springs", doubles(SteeringOptions)),
        ("speed_control", doubles(SpeedControl)),
        ("count", c_int64), ("types", c_void_p), ("shares", c_void_p),
        *((name, c_double * 3) for name in "before anchor".split()),
        *((name, c_double * 2) for name in "velocity acceleration measured".split()),
        *((name, c_double) for name in "facing turning".split()),
        ("wish", c_double * 2), ("overshoot", c_double),
        *((name, c_int32) for name in "seen anchored gait since".split()),
        ("trajectory", c_float * TRAJECTORY_COUNT),
    )  # fmt: skip


class Steering:
    """The steering of one character: gaits, speed controller and springs, and the anchor where it stopped."""

    def __init__(self, model: MotionModel, options: SteeringOptions | None = None) -> None:
        self.model = model
        self.types = (_Type * len(model.types))(*(_known(model, name) for name in model.types))
        self.shares = np.ones(len(model.types))
        settings = astuple(GAIT_CHOICE), astuple(options or SteeringOptions()), astuple(SPEED_CONTROL)
        arrays = len(self.types), addressof(self.types), self.shares.ctypes.data
        self.words = _Steering(model.fps, *settings, *arrays, gait=-1)

    @property
    def speed(self) -> float:
        """The speed of the spring in cm/s."""
        return float(steering_library().spring_speed(byref(self.words)))

    def observe(self, x: float, z: float, heading: float, free: bool) -> None:
        """Measure the movement of the body; call this once per frame, before trajectory.

        Args:
            free: whether nobody steers; the springs then follow the body.
        """
        steering_library().observe(byref(self.words), x, z, heading, free)

    def type(self, velocity: Pair, facing: float | None) -> str:
        """Choose a type for a wished velocity and facing; steered_type says how."""
        number = steering_library().steered_type(byref(self.words), *velocity, or_nan(facing))
        return self.model.type_names[number]

    def trajectory(self, kind: str, velocity: Pair, facing: float | None) -> tuple[Array, Array]:
        """The trajectory (1, 24) of a type for a wish, and the factor (1,) on the root-slip correction.

        Args:
            velocity: wished velocity, x and z in cm/s; below STANDS_BELOW the character stands where it stopped.
            facing: wished heading in radians; None takes the usual facing of the gait. A standing body keeps that at
                which it stopped.
        """
        number = self.model.type_id(kind)
        settled = steering_library().steer(byref(self.words), number, *velocity, or_nan(facing))
        return np.array([self.words.trajectory], np.float32), np.array([settled], np.float32)


def _known(model: MotionModel, name: str) -> _Type:
    kind, gait = model.types[name].kind, model.types[name].gait
    pace = (math.nan, math.nan) if gait is None else (gait.speed, gait.facing)
    return _Type(*pace, *(model.speed_range(name) or (0.0, math.inf)), list(MotionKind).index(kind))


def or_nan(number: float | None) -> float:
    """A number for the kernel, in which NaN is none."""
    return math.nan if number is None else number


def steered_type(model: MotionModel, velocity: Pair, facing: float | None) -> str:
    """Choose the steered type for a wished velocity (x, z in cm/s) and facing (radians, None for any).

    The choice minimises the difference in speed and in facing. A model without steered types chooses among the types
    without a phase.
    """
    return Steering(model).type(velocity, facing)


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
    turned = {
        name: abs(math.remainder(gait.facing, math.tau)) for name, gait in found.items() if name not in stands
    }
    ahead = [name for name, turn in turned.items() if turn < FORWARDS]
    back = [name for name, turn in turned.items() if turn > math.pi - FORWARDS]
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
