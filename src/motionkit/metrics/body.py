"""Kinematic measures of a body per frame, on which the detectors of motion types are based.

Speed over the ground is in m/s, as in gait studies. Heights are in cm, as elsewhere in motionkit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from motionkit.arrays import Array, spans
from motionkit.features.heading import heading_angles
from motionkit.metrics.body_movement import angular_speed, euler_movement
from motionkit.metrics.pace import PACE_SECONDS
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_from_yaw, quat_inverse, quat_multiply, quat_rotate, quat_to_expmap
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS, Skeleton

_AT = JOINT_NAMES.index
LEFT_FOOT, LEFT_TOE, RIGHT_FOOT, RIGHT_TOE = (
    _AT(n) for n in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase")
)
HEAD, HIPS = _AT("Head"), 0
ARMS = tuple((_AT(f"{s}Arm"), _AT(f"{s}ForeArm"), _AT(f"{s}Hand")) for s in ("Left", "Right"))
HANDS = tuple(hand for _, _, hand in ARMS)

STANDING_ANKLE, STANDING_TOE = STANDING_HEIGHTS[:2]
OFF_GROUND = 1.5  # cm above standing height; both feet are higher in a flight
# In the flight of a run, both feet are at least RUN_LIFT (cm) above the lowest tenth of the lower foot's heights and
# faster than RUN_FOOT_SPEED (cm/s). The clip itself is the level, because runs are short and their floor is uncertain.
RUN_LIFT, RUN_FOOT_SPEED = 2.0, 80.0


@dataclass(frozen=True, eq=False)
class Body:
    """T frames of the canonical joints in the world.

    Attributes:
        rotations: (T, 23, 4) local rotations.
        positions: (T, 23, 3) global joint positions in cm; the floor is at height zero.
        heading: (T,) radians.
    """

    rotations: Array
    positions: Array
    heading: Array
    fps: float

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def seconds(self) -> float:
        """Duration in seconds."""
        return len(self) / self.fps

    def cut(self, start: int, end: int) -> Body:
        """Return frames start to end (exclusive)."""
        part = slice(start, end)
        return Body(self.rotations[part], self.positions[part], self.heading[part], self.fps)

    def every(self, step: int) -> Body:
        """Return every step-th frame."""
        return Body(self.rotations[::step], self.positions[::step], self.heading[::step], self.fps / step)

    # ---- over the ground ----

    @cached_property
    def velocity(self) -> Array:
        """(T, 2) velocity of the root over the ground in m/s, to the left and ahead, measured over PACE_SECONDS."""
        if len(self) < 2:
            return np.zeros((len(self), 2), np.float32)
        span = min(max(1, round(PACE_SECONDS * self.fps)), len(self) - 1)
        ground = self.positions[:, HIPS, [0, 2]]
        steps = (ground[span:] - ground[:-span]) * (self.fps / span / 100.0)
        before = span // 2
        steps = np.pad(steps, ((before, span - before), (0, 0)), mode="edge")
        sine, cosine = np.sin(self.heading), np.cos(self.heading)
        x, z = np.moveaxis(steps, -1, 0)
        return np.stack([x * cosine - z * sine, x * sine + z * cosine], axis=-1)

    @cached_property
    def speed(self) -> Array:
        """(T,) speed of the root over the ground in m/s."""
        return np.linalg.norm(self.velocity, axis=-1)

    # ---- feet ----

    @cached_property
    def lifts(self) -> Array:
        """(T, 2) height of left and right foot above their standing height in cm, the lower of ankle and toe."""
        feet = self.positions[..., 1]
        left = np.minimum(feet[:, LEFT_FOOT] - STANDING_ANKLE, feet[:, LEFT_TOE] - STANDING_TOE)
        right = np.minimum(feet[:, RIGHT_FOOT] - STANDING_ANKLE, feet[:, RIGHT_TOE] - STANDING_TOE)
        return np.stack([left, right], axis=-1)

    @cached_property
    def flights(self) -> list[tuple[int, int]]:
        """Stretches (start, end) of frames in which both feet are off the ground."""
        return spans(self.lifts.min(axis=-1) > OFF_GROUND)

    def flight_seconds(self) -> float:
        """Return the length of the longest flight in seconds."""
        return max((end - start for start, end in self.flights), default=0) / self.fps

    def stride_flight_frames(self) -> int:
        """Return the longest stretch, in frames, in which both feet are in the air and swing, as in a run."""
        feet = self.positions[:, [LEFT_FOOT, LEFT_TOE, RIGHT_FOOT, RIGHT_TOE]][..., [0, 2]]
        speeds = np.linalg.norm(np.diff(feet, axis=0), axis=-1) * self.fps
        lower = self.lifts.min(axis=-1)
        raised = lower > np.quantile(lower, 0.1) + RUN_LIFT
        swinging = raised[1:] & (speeds.min(axis=-1) > RUN_FOOT_SPEED)
        return max((end - start for start, end in spans(swinging)), default=0)

    @cached_property
    def foot_ahead(self) -> Array:
        """(T,) distance of the left ankle ahead of the right one in cm."""
        difference = self.positions[:, LEFT_FOOT] - self.positions[:, RIGHT_FOOT]
        return difference[:, 0] * np.sin(self.heading) + difference[:, 2] * np.cos(self.heading)

    # ---- turning over ----

    @cached_property
    def turned(self) -> Array:
        """(T, 3) angles in radians by which the hips have turned: forwards, about the spine, to the right."""
        hips = self.rotations[:, HIPS]
        steps = quat_to_expmap(quat_multiply(quat_inverse(hips[:-1]), hips[1:]))
        return np.concatenate([np.zeros((1, 3), np.float32), np.cumsum(steps, axis=0)])

    @cached_property
    def head_height(self) -> Array:
        """(T,) height of the head above the hips in cm."""
        return self.positions[:, HEAD, 1] - self.positions[:, HIPS, 1]

    @cached_property
    def ankle_height(self) -> Array:
        """(T,) height of the higher ankle above the hips in cm."""
        ankles = self.positions[:, [LEFT_FOOT, RIGHT_FOOT], 1]
        return ankles.max(axis=-1) - self.positions[:, HIPS, 1]

    @cached_property
    def hand_heights(self) -> Array:
        """(T, 2) height of the hands above the floor in cm."""
        return self.positions[:, list(HANDS), 1]

    # ---- arms ----

    @cached_property
    def arm_extension(self) -> Array:
        """(T, 2) distance from each shoulder to its hand, divided by the length of the arm."""
        out = []
        for shoulder, elbow, hand in ARMS:
            joints = self.positions[:, [shoulder, elbow, hand]]
            straight = np.linalg.norm(np.diff(joints, axis=1), axis=-1).sum(axis=-1)
            out.append(np.linalg.norm(joints[:, 2] - joints[:, 0], axis=-1) / np.maximum(straight, 1e-6))
        return np.stack(out, axis=-1)

    @cached_property
    def arm_ahead(self) -> Array:
        """(T, 2) cosine of the angle between the facing direction and the direction from each shoulder to its hand."""
        facing = np.stack([np.sin(self.heading), np.cos(self.heading)], axis=-1)
        out = []
        for shoulder, _, hand in ARMS:
            reach = self.positions[:, hand] - self.positions[:, shoulder]
            out.append(
                (reach[:, [0, 2]] * facing).sum(axis=-1) / np.maximum(np.linalg.norm(reach, axis=-1), 1e-6)
            )
        return np.stack(out, axis=-1)

    @cached_property
    def arm_thrust(self) -> Array:
        """(T, 2) speed in cm/s at which each hand moves away from its shoulder."""
        reach = np.stack(
            [np.linalg.norm(self.positions[:, h] - self.positions[:, s], axis=-1) for s, _, h in ARMS],
            axis=-1,
        )
        steps = np.diff(reach, axis=0) * self.fps
        return np.concatenate([steps[:1], steps])

    # ---- the whole body ----

    def joint_speed(self) -> float:
        """Return the mean angular speed of all joints but the root in rad/s."""
        return angular_speed(self.rotations, range(1, self.rotations.shape[1]), self.fps)

    def body_movement(self) -> float:
        """Return body movement in degrees per frame (metric bm-euler), extreme frames included."""
        return float(euler_movement(self.rotations).sum(axis=-1).mean())

    def poses(self, every: int = 1) -> Array:
        """Return joint positions (T', 69) in cm in the heading frame, of one frame in `every`."""
        positions = self.positions[::every]
        root = positions[:, HIPS] * np.array([1.0, 0.0, 1.0], np.float32)
        turn = quat_from_yaw(-self.heading[::every])
        return quat_rotate(turn[:, None], positions - root[:, None]).reshape(len(positions), -1)


def body_of(motion: Motion) -> Body:
    """Return the body of a motion on the canonical joints."""
    return bodies(motion.local_rotations[None], motion.root_positions[None], motion.skeleton, motion.fps)[0]


def bodies(rotations: Array, root_positions: Array, skeleton: Skeleton, fps: float) -> list[Body]:
    """Return the bodies of B motions with local rotations (B, T, 23, 4) and root positions (B, T, 3) in cm."""
    _, positions = forward_kinematics(rotations, root_positions, skeleton.offsets, skeleton.parents)
    return [Body(r, p, heading_angles(p, fps), fps) for r, p in zip(rotations, positions, strict=True)]
