"""Makes a character meet keys: controls lead to them, and a smooth offset closes the rest of the gap.

The paper names control of key joints as future work. Here the path to a key is the trajectory that the network sees,
and the key's pose is one of its reference poses. So the network nearly arrives by itself. The offset closes the gap on
the ground between the keys, and the gap in the pose within REACH_SECONDS of a key.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.control.character_start import CharacterStart
from motionkit.control.keys import Key, smoothed_step, travel_direction
from motionkit.control.plan import Plan
from motionkit.control.planned_controls import CrowdController
from motionkit.errors import ControlError
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls
from motionkit.features.heading import heading_angles
from motionkit.features.reference import EMBEDDING_COUNT, REFERENCE_OFFSETS, reference_signal
from motionkit.finish.finish import Finish, finish
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, MotionType
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.reach import reach
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_continuous,
    quat_from_yaw,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_to_expmap,
    rotate_ground,
    wrap_angle,
)
from motionkit.motion.skeleton import JOINT_NAMES, leg_length

KEY_POSE_SECONDS = 0.6  # time before and after a key in which its pose is a reference pose
AFTER = 70  # frames of a recording kept after a key: KEY_POSE_SECONDS, and the look-ahead of references
REACH_SECONDS = 0.6  # time before and after a key over which the offset of the pose fades
TURN_SECONDS = 1.0  # time before and after a key over which the heading turns to its facing
STANDING = 30.0  # cm/s; a slower path does not decide the heading
LONGEST_STRETCH = 4.0  # s; longest recorded stretch that leads to a key
# Errors in x, z (cm) and heading (radians) that cost as much as an embedding value that is off by 1.
TRAVEL_SCALES = np.array([15.0, 15.0, 0.3])
AHEAD = 35.0  # cm from the hips forward to a joint's point, if the key gives no position
SOLVED = 1.0  # cm; a joint that stays further from its point is out of reach


@dataclass(frozen=True, eq=False)
class Stretch:
    """Part of a recording that leads to a key, for the frames from first to end; -1 is the frame before the motion.

    Attributes:
        poses: (N + M, 24) pose embeddings of N frames, and of M after the key for the look-ahead of references.
        phases: (N,) phases of a performance, strike or jump.
        ground: (N, 3) recorded x, z in cm and heading in radians.
        gain: reference gain.
    """

    first: int
    end: int
    poses: Array
    phases: Array
    ground: Array
    gain: float


def matched_stretches(
    model: MotionModel, keys: Sequence[Key], begin: CharacterStart, types: Array, path: Array | None
) -> list[Stretch]:
    """For each key with a pose, find the recorded stretch of its type that best leads there from the pose before.

    The pose before is the first pose of the motion or that of the previous key. A key that comes more than
    LONGEST_STRETCH after it gets no stretch.
    """
    out = []
    before: tuple[int, Array] | None = (-1, begin.start_state.poses[0])
    for key in keys:
        at = round(key.seconds * model.fps)
        if key.pose is not None and before is not None and 0 < at - before[0] <= LONGEST_STRETCH * model.fps:
            kind = model.types[model.type_names[int(types[min((before[0] + at) // 2, len(types) - 1)])]]
            travel = None
            if path is not None and key.position is not None:
                start = begin.start.ground[0] if before[0] < 0 else path[min(before[0], len(path) - 1)]
                travel = _travel(np.asarray(start, np.float64)[None], path[min(at, len(path) - 1)][None])[0]
            found = _stretch(kind, before[1], key.pose.embedding, at - before[0], travel)
            if found is not None:
                out.append(Stretch(before[0], at, *found, kind.preset.reference_gain))
        before = None if key.pose is None else (at, key.pose.embedding)
    for stretch, after in reversed(list(pairwise(out))):
        if after.first == stretch.end:
            stretch.poses[len(stretch.phases) :] = after.poses[
                1 : len(stretch.poses) - len(stretch.phases) + 1
            ]
    return out


def _travel(start: Array, end: Array) -> Array:
    """Displacements (N, 3) between places and headings (N, 3), in the heading frame of the first: cm and radians."""
    away = rotate_ground(-start[:, 2:3], (end - start)[:, None, :2])[:, 0]
    return np.concatenate([away, wrap_angle(end[:, 2:3] - start[:, 2:3])], axis=1)


def _stretch(
    kind: MotionType, start: Array, end: Array, frames: int, travel: Array | None
) -> tuple[Array, Array, Array] | None:
    """Find the recording of a type that best leads from one pose to another in `frames` frames.

    Args:
        travel: (3,) requested displacement in that time, cm and radians; None for any.

    Returns:
        Embeddings (frames + 1 + AFTER, 24), phases (frames + 1,) and ground (frames + 1, 3); None if no recording is
        long enough.
    """
    best, found = np.inf, None
    for clip in kind.reference_clips:
        last = len(clip) - frames - 1
        if last < 0:
            continue
        poses = clip.poses.astype(np.float64)
        cost = np.square(poses[: last + 1] - start).sum(-1) + np.square(poses[frames:][: last + 1] - end).sum(
            -1
        )
        if travel is not None:
            ground = clip.ground.astype(np.float64)
            off = (_travel(ground[: last + 1], ground[frames:][: last + 1]) - travel) / TRAVEL_SCALES
            cost += np.square(off).sum(-1)
        at = int(cost.argmin())
        if cost[at] < best:
            # The errors at both ends are spread over the stretch, and fade after it.
            share = np.minimum(np.arange(frames + 1 + AFTER) / frames, 1.0)[:, None]
            left = smoothed_step(1.0 - np.maximum(np.arange(-frames, AFTER + 1), 0) / AFTER)[:, None]
            gap = lerp(start - poses[at], end - poses[at + frames], share) * left
            blended = poses[np.minimum(at + np.arange(len(gap)), len(poses) - 1)] + gap
            rows = slice(at, at + frames + 1)
            best, found = float(cost[at]), (blended.astype(np.float32), clip.phases[rows], clip.ground[rows])
    return found


def recorded_path(path: Array, stretches: Sequence[Stretch], begin: Array) -> Array:
    """Replace the path (T, 3) by recorded paths where recordings lead to keys.

    A body that flips or rolls moves and faces as recorded, not along a curve. The error at the end of a recorded path
    is spread evenly over it.

    Args:
        begin: (3,) place before the first frame.
    """
    out = path.copy()
    for stretch in stretches:
        if stretch.end >= len(path):
            continue
        start = begin.astype(np.float64) if stretch.first < 0 else path[stretch.first]
        travelled = _travel(
            np.repeat(stretch.ground[:1].astype(np.float64), len(stretch.ground), axis=0), stretch.ground
        )
        made = start + np.concatenate([rotate_ground(start[2], travelled[:, :2]), travelled[:, 2:]], axis=1)
        gap = path[stretch.end] - made[-1]
        gap[2] = wrap_angle(gap[2:])[0]
        made += np.linspace(0.0, 1.0, len(made))[:, None] * gap
        out[max(stretch.first, 0) : stretch.end + 1] = made[max(-stretch.first, 0) :]
    return out


class KeyedController:
    """Adds the poses and places of keys to the controls of another controller; a Controller."""

    def __init__(
        self,
        model: MotionModel,
        base: CrowdController,
        plans: Sequence[Plan],
        begins: Sequence[CharacterStart],
        share: float,
    ) -> None:
        """Take a plan with keys and a start for each character; share as for KeyedControls."""
        self.base = base
        self.keyed = [
            KeyedControls(model, plan, begin, share) for plan, begin in zip(plans, begins, strict=True)
        ]

    def __call__(self, frame: int, ground: Array) -> Controls:
        left = np.array([keyed.path is not None and frame == len(keyed.path) for keyed in self.keyed])
        self.base.paths.anchor(frame, left, ground)
        controls = self.base(frame, ground)
        rows = [slice(i, i + 1) for i in range(len(self.keyed))]
        return Controls.concatenated([
            keyed(controls.at(row), frame, ground[row]) for keyed, row in zip(self.keyed, rows, strict=True)
        ])  # fmt: skip


class KeyedControls:
    """Adds the poses and places of keys to the controls of one character."""

    def __init__(self, model: MotionModel, plan: Plan, begin: CharacterStart, share: float) -> None:
        """Take a plan with keys; share is the leg length relative to that of the default body."""
        self.model, keys = model, plan.keys
        self.path = planned_path(keys, begin.start.ground[0], model.fps, share)
        self.stretches = matched_stretches(model, keys, begin, plan.track, self.path)
        if self.path is not None:
            self.path = recorded_path(self.path, self.stretches, begin.start.ground[0])
            kinds = [model.kind(model.type_names[int(number)]) for number in plan.track[len(self.path) :][:1]]
            if kinds == [MotionKind.STANCE]:  # who stands when the last key is met stays so
                held = np.repeat(self.path[-1:], round(TURN_SECONDS * model.fps), axis=0)
                self.path = np.concatenate([self.path, held])
        self.steered = np.array([known.kind.steered for known in model.types.values()], np.float32)
        met = {stretch.end for stretch in self.stretches}
        poses = [(round(key.seconds * model.fps), key.pose.embedding) for key in keys if key.pose is not None]
        self.poses = [pose for pose in poses if pose[0] not in met]

    def __call__(self, controls: Controls, frame: int, ground: Array) -> Controls:
        """Return controls (1, ...) with the keys added, for a body at ground (1, 3)."""
        if self.path is not None and frame < len(self.path):
            controls = self._on_path(controls, frame, ground)
        if not self.model.uses_references:
            return controls
        now = [stretch for stretch in self.stretches if stretch.first <= frame]
        return self._with_key_poses(self._recorded(controls, now[-1], frame) if now else controls, frame)

    def _recorded(self, controls: Controls, stretch: Stretch, frame: int) -> Controls:
        """Replace the reference by a stretch; after its key it fades out over KEY_POSE_SECONDS."""
        past = max(0, frame - stretch.end) / (KEY_POSE_SECONDS * self.model.fps)
        share = float(smoothed_step(np.array(1.0 - past)))
        if share <= 0.0:
            return controls
        reference = reference_signal(stretch.poses, np.array([frame - stretch.first]))
        known, gain = controls.reference_gain[:, None] > 0.0, controls.reference_gain
        controls = replace(
            controls,
            reference=lerp(np.where(known, controls.reference, reference), reference, share).astype(
                np.float32
            ),
            reference_gain=lerp(gain, np.full_like(gain, stretch.gain), share).astype(np.float32),
        )
        if frame >= stretch.end:
            return controls
        # The base controller plays another recording; its phase would slow the body down or hurry it.
        return replace(controls, phase=np.full_like(controls.phase, stretch.phases[frame - stretch.first]))

    def _on_path(self, controls: Controls, frame: int, ground: Array) -> Controls:
        """Replace the trajectory by the planned path; gaits follow it without reference poses."""
        assert self.path is not None
        ahead = self.path[np.minimum(frame + np.array(TRAJECTORY_OFFSETS), len(self.path) - 1)]
        heading = ground[:, 2:3]
        places = rotate_ground(-heading, ahead[None, :, :2] - ground[:, None, :2])
        facing = ahead[None, :, 2] - heading
        directions = np.stack([np.sin(facing), np.cos(facing)], axis=-1)
        count = len(ground)
        trajectory = np.concatenate([places.reshape(count, -1), directions.reshape(count, -1)], axis=-1)
        free = 1.0 - controls.type_weights @ self.steered
        return replace(
            controls,
            trajectory=trajectory.astype(np.float32),
            reference_gain=controls.reference_gain * free.astype(np.float32),
            slip_correction=np.zeros_like(controls.slip_correction),
        ).with_mask(1.0)

    def _with_key_poses(self, controls: Controls, frame: int) -> Controls:
        """Add the poses of keys without a stretch to the reference poses."""
        reference, gain = controls.reference.copy(), controls.reference_gain.copy()
        wide = KEY_POSE_SECONDS * self.model.fps
        preset = max(kind.preset.reference_gain for kind in self.model.types.values())
        for at, embedding in self.poses:
            for block, offset in enumerate(REFERENCE_OFFSETS):
                share = float(smoothed_step(np.array(1.0 - abs(frame + offset - at) / wide)))
                columns = slice(block * EMBEDDING_COUNT, (block + 1) * EMBEDDING_COUNT)
                known = np.where(gain[:, None] > 0.0, reference[:, columns], embedding)
                reference[:, columns] = lerp(known, embedding, share)
            nearest = float(smoothed_step(np.array(1.0 - (at - frame) / wide))) if frame <= at else 0.0
            gain = np.maximum(gain, np.float32(preset * nearest))
        return replace(controls, reference=reference, reference_gain=gain)


def planned_path(keys: Sequence[Key], start: Array, fps: float, share: float) -> Array | None:
    """Place and heading (T, 3) of every frame up to the last key with a place or facing; None without such a key.

    Args:
        start: (3,) x, z in cm and heading, before frame 0.
        share: leg length relative to the body that the network moves.
    """
    placed = [(key, goal / share) for key in keys if (goal := key.goal) is not None]
    if not placed and all(key.facing is None for key in keys):
        return None
    last = round(keys[-1].seconds * fps) if not placed else round(placed[-1][0].seconds * fps)
    last = max([last, *(round(key.seconds * fps) for key in keys if key.facing is not None)])
    times = np.array([-1.0, *(key.seconds * fps for key, _ in placed)])
    places = [start[:2]]
    for key, goal in placed:
        if key.position is None:  # a joint's point lies ahead of the hips
            ahead = goal - places[-1]
            goal = goal - ahead * min(1.0, AHEAD / share / max(float(np.linalg.norm(ahead)), 1e-6))
        places.append(goal)
    frames = np.arange(last + 1)
    path = np.empty((last + 1, 3))
    path[:, :2] = _curve(times, np.stack(places), frames)
    steps = np.gradient(path[:, :2], axis=0) * fps if last else np.zeros((1, 2))
    heading, now = np.empty(last + 1), float(start[2])
    for frame in range(last + 1):
        if float(np.linalg.norm(steps[frame])) > STANDING:
            towards = float(wrap_angle(np.array([travel_direction(steps[frame]) - now]))[0])
            now += float(np.clip(towards, -4.0 / fps, 4.0 / fps))
        heading[frame] = now
    # A body turns to a facing before the key, and while it moves on back to the way that it goes.
    moved = np.cumsum(np.linalg.norm(steps, axis=1) > STANDING)
    for key in keys:
        if key.facing is not None:
            at = min(round(key.seconds * fps), last)
            gap = float(wrap_angle(np.array([key.facing - heading[at]]))[0])
            away = np.where(frames < at, at - frames, moved - moved[at])
            heading = heading + gap * smoothed_step(1.0 - away / (TURN_SECONDS * fps))
    path[:, 2] = heading
    return path


def _curve(times: Array, places: Array, frames: Array) -> Array:
    """A cubic curve (T, 2) through places (N, 2) at times (N,); after the last time it stays at the last place."""
    if len(times) == 1:
        return np.repeat(places, len(frames), axis=0)
    speeds = np.diff(places, axis=0) / np.diff(times)[:, None]
    slopes = np.concatenate([speeds[:1], 0.5 * (speeds[1:] + speeds[:-1]), speeds[-1:]])
    after = np.clip(np.searchsorted(times, frames, side="right"), 1, len(times) - 1)
    before = after - 1
    span = (times[after] - times[before])[:, None]
    x = np.clip((frames[:, None] - times[before][:, None]) / span, 0.0, 1.0)
    return (
        (2 * x**3 - 3 * x**2 + 1) * places[before]
        + (x**3 - 2 * x**2 + x) * span * slopes[before]
        + (3 * x**2 - 2 * x**3) * places[after]
        + (x**3 - x**2) * span * slopes[after]
    )


def meet_keys(
    motion: Motion, contacts: Array, keys: Sequence[Key], ik: bool = True, before: Motion | None = None
) -> Motion:
    """Change a roll-out so that it meets every key exactly.

    Args:
        motion: on the canonical joints, in cm, before foot locking.
        contacts: (T, 4) predicted contacts.
        keys: in order of time, none after the end.
        ik: finish the motion, with foot locking.
        before: frames on the same body that the motion continues smoothly.

    Raises:
        ControlError: the body cannot reach a joint's point.
    """
    goals = [_reached(motion, key) for key in keys]
    moved = _over_the_ground(motion, keys, goals)
    if ik:
        moved = finish(moved, contacts, Finish())
    if before is not None and len(before) > 1:
        moved = _continued(moved, before, round(keys[0].seconds * motion.fps))
    for number, key in enumerate(keys):
        around = [keys[i].seconds for i in (number - 1, number + 1) if 0 <= i < len(keys)]
        moved = _posed(moved, key, [0.0, *around] if number == 0 else around)
    return moved


def _frame(motion: Motion, key: Key) -> int:
    return min(round(key.seconds * motion.fps), len(motion) - 1)


def _heading(motion: Motion, frame: int) -> float:
    """Heading of a frame in radians."""
    near = motion.cut(max(0, frame - 30), frame + 31)
    return float(heading_angles(motion_kinematics(near)[1], motion.fps)[frame - max(0, frame - 30)])


def _target(motion: Motion, key: Key) -> tuple[Array, Array]:
    """Local rotations (23, 4) and root (3,) of a key's frame before joints reach for their points."""
    frame = _frame(motion, key)
    rotations, root = motion.local_rotations[frame].copy(), motion.root_positions[frame].copy()
    heading = _heading(motion, frame)
    facing = heading if key.facing is None else key.facing
    if key.pose is not None:
        rotations = key.pose.rotations.copy()
        rotations[0] = quat_multiply(quat_from_yaw(np.array(facing, np.float32)), rotations[0])
        root[1] = key.pose.height * leg_length(motion.skeleton)
    else:
        turn = quat_from_yaw(np.array(facing - heading, np.float32))
        rotations[0] = quat_multiply(turn, rotations[0])
    if key.position is not None:
        root[[0, 2]] = key.position
    return rotations, root


def _reached(motion: Motion, key: Key) -> tuple[Array, Array]:
    """Local rotations (23, 4) and root (3,) of a key's frame.

    Raises:
        ControlError: a joint is out of reach.
    """
    rotations, root = _target(motion, key)
    if not key.joints:
        return rotations, root
    if key.position is None:  # move the root to within reach of the points
        points = np.mean(list(key.joints.values()), axis=0)
        away = (points - root)[[0, 2]]
        length = float(np.linalg.norm(away))
        root[[0, 2]] += away * max(0.0, 1.0 - AHEAD / max(length, 1e-6))
    rotations, root, left = reach(rotations, root, motion.skeleton, key.joints, key.position is None)
    if left > SOLVED:
        names = ", ".join(JOINT_NAMES[joint] for joint in key.joints)
        raise ControlError(
            f"the key at {key.seconds:g} s is out of reach: {names} stays {left:.0f} cm away from its point"
        )
    return rotations, root


def _over_the_ground(motion: Motion, keys: Sequence[Key], goals: Sequence[tuple[Array, Array]]) -> Motion:
    """Move and turn the whole motion smoothly so that the root has each key's place and facing."""
    shifts, turns = [(0.0, np.zeros(2))], [(0.0, np.zeros(1))]
    for key, (rotations, root) in zip(keys, goals, strict=True):
        frame = _frame(motion, key)
        if key.goal is not None:
            shifts.append((float(frame), (root - motion.root_positions[frame])[[0, 2]].astype(np.float64)))
        if key.facing is not None:
            gap = _yaw(quat_multiply(rotations[0], quat_inverse(motion.local_rotations[frame, 0])))
            turns.append((float(frame), np.array([gap])))
    frames = np.arange(len(motion))
    shift, turn = _spread(shifts, frames), _spread(turns, frames)[:, 0]
    local, roots = motion.local_rotations.copy(), motion.root_positions.copy()
    local[:, 0] = quat_multiply(quat_from_yaw(turn.astype(np.float32)), local[:, 0])
    roots[:, [0, 2]] += shift.astype(np.float32)
    return replace(motion, local_rotations=local, root_positions=roots)


def _yaw(quat: Array) -> float:
    """The part of a rotation (4,) that turns about the vertical, radians."""
    return float(wrap_angle(np.array([2.0 * math.atan2(float(quat[2]), float(quat[0]))]))[0])


def _spread(knots: Sequence[tuple[float, Array]], frames: Array) -> Array:
    """Values (T, C) that pass through knots (frame, values) with zero velocity; constant after the last knot."""
    out = np.repeat(knots[0][1][None], len(frames), axis=0)
    for (before, low), (after, high) in pairwise(knots):
        share = smoothed_step((frames - before) / max(after - before, 1.0))[:, None]
        out = out + share * (high - low)
    return out


def _posed(motion: Motion, key: Key, around: Sequence[float]) -> Motion:
    """Set a key's pose at its frame, with an offset that fades out before the neighbouring keys (times in `around`)."""
    frame = _frame(motion, key)
    rotations, root = _reached(motion, key)
    wide = REACH_SECONDS * motion.fps
    before = min([wide, *(frame - round(s * motion.fps) for s in around if s < key.seconds)])
    after = min([wide, *(round(s * motion.fps) - frame for s in around if s > key.seconds)])
    away = np.arange(len(motion)) - frame
    share = smoothed_step(1.0 - np.where(away < 0, -away / max(before, 1.0), away / max(after, 1.0)))
    gap = quat_to_expmap(quat_multiply(rotations, quat_inverse(motion.local_rotations[frame])))
    made = _offset(motion, share[:, None, None] * gap, share[:, None] * (root - motion.root_positions[frame]))
    if key.pose is None or key.joints:
        return made
    # The body passes the pose at its recorded velocity: a second offset adds the missing velocity.
    facing = key.facing if key.facing is not None else _heading(motion, frame)
    turn = quat_from_yaw(np.array(facing, np.float32))
    turns = key.pose.turns.copy()
    turns[0] = quat_rotate(turn, turns[0])
    step = quat_rotate(turn, key.pose.step) * leg_length(motion.skeleton)
    made_turns, made_step = _speeds(made, frame)
    slope = (away * share)[:, None]
    return _offset(made, slope[..., None] * (turns - made_turns), slope * (step - made_step))


def _continued(motion: Motion, before: Motion, frames: int) -> Motion:
    """Change the first `frames` frames so that the motion continues the pose and velocity of the frames before."""
    rotations, roots = before.local_rotations[-2:], before.root_positions[-2:]
    change = quat_multiply(rotations[1], quat_inverse(rotations[0]))
    gap = quat_to_expmap(
        quat_multiply(quat_multiply(change, rotations[1]), quat_inverse(motion.local_rotations[0]))
    )
    shift = 2.0 * roots[1] - roots[0] - motion.root_positions[0]
    wide = max(min(REACH_SECONDS * motion.fps, frames), 2.0)
    away = np.arange(len(motion))
    share = smoothed_step(1.0 - away / wide)
    made = _offset(motion, share[:, None, None] * gap, share[:, None] * shift)
    turns = quat_to_expmap(quat_multiply(made.local_rotations[1], quat_inverse(made.local_rotations[0])))
    slope = (away * share)[:, None]
    steps = (roots[1] - roots[0]) - (made.root_positions[1] - made.root_positions[0])
    return _offset(made, slope[..., None] * (quat_to_expmap(change) - turns), slope * steps)


def _speeds(motion: Motion, frame: int) -> tuple[Array, Array]:
    """Velocities per frame: of joints (J, 3), in radians in parent space, and of the root (3,); central differences."""
    before, after = max(frame - 1, 0), min(frame + 1, len(motion) - 1)
    apart = max(after - before, 1)
    change = quat_multiply(motion.local_rotations[after], quat_inverse(motion.local_rotations[before]))
    return quat_to_expmap(change) / apart, (
        motion.root_positions[after] - motion.root_positions[before]
    ) / apart


def _offset(motion: Motion, turns: Array, shifts: Array) -> Motion:
    """Turn joints by (T, J, 3) in parent space and move the root by shifts (T, 3)."""
    rotations = quat_normalize(quat_multiply(expmap_to_quat(turns), motion.local_rotations))
    return replace(
        motion,
        local_rotations=quat_continuous(rotations).astype(np.float32),
        root_positions=(motion.root_positions + shifts).astype(np.float32),
    )


def arrival(motion: Motion, key: Key) -> tuple[float, float]:
    """Errors of a motion at a key: largest distance in cm and largest angle in degrees."""
    frame = _frame(motion, key)
    _, positions = motion_kinematics(motion.cut(frame, frame + 1))
    distances, angles = [0.0], [0.0]
    if key.position is not None:
        distances.append(float(np.linalg.norm(positions[0, 0, [0, 2]] - key.position)))
    distances += [float(np.linalg.norm(positions[0, joint] - place)) for joint, place in key.joints.items()]
    heading = _heading(motion, frame) if key.pose is None or key.facing is None else key.facing
    if key.facing is not None:
        angles.append(abs(float(np.rad2deg(wrap_angle(np.array([key.facing - heading]))[0]))))
    if key.pose is not None and not key.joints:
        current = motion.local_rotations[frame].copy()
        target = key.pose.rotations.copy()
        current[0] = quat_multiply(quat_from_yaw(np.array(-heading, np.float32)), current[0])
        gap = quat_to_expmap(quat_multiply(quat_inverse(target), current))
        angles.append(float(np.rad2deg(np.linalg.norm(gap, axis=-1)).max()))
    return max(distances), max(angles)
