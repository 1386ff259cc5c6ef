"""Keys: poses, places and facings that a character must meet at given times, read from JSON (docs/keys.md).

Inside, lengths are cm and angles radians; files are in metres and degrees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import BvhError, ControlError, MotionkitError, naming
from motionkit.features.encode import EncodedMotion, encode_motion
from motionkit.files import check_fields, read_json
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import (
    quat_from_yaw,
    quat_inverse,
    quat_multiply,
    quat_rotate,
    quat_to_expmap,
    wrap_angle,
)
from motionkit.motion.skeleton import JOINT_NAMES, leg_length

METRE = 100.0
ORIGIN: Array = np.zeros(2)  # where a body begins without a clip
EARLIEST = 0.2  # s; earliest time of a key
NEAREST = 0.2  # s; least time between two keys
FASTEST = 900.0  # cm/s between two keys, the speed of a sprint
HIGHEST = 300.0  # cm; largest height of a joint's point
MOST_KEYS = 1000
_FIELDS = ("time", "pose", "position", "facing", "joints")


@dataclass(frozen=True, eq=False)
class KeyPose:
    """A pose to take.

    Attributes:
        rotations: (23, 4) local rotations, the root's relative to the heading.
        height: height of the root above the ground, as a share of the leg length.
        embedding: (24,) pose embedding (features/reference.py).
        turns: (23, 3) angular velocity of each joint in radians per frame, in parent space; the root's relative to the
            heading.
        step: (3,) velocity of the root per frame, relative to the heading, as a share of the leg length.
    """

    rotations: Array
    height: float
    embedding: Array
    turns: Array
    step: Array


@dataclass(frozen=True, eq=False)
class Key:
    """What the character must meet at a time; None and {} leave something free.

    Attributes:
        seconds: time from the beginning of the motion.
        pose: the pose to take.
        position: (2,) x and z of the hips, cm.
        facing: heading in radians, 0 facing +Z.
        joints: joint index to its point (3,) in the world, cm.
    """

    seconds: float
    pose: KeyPose | None = None
    position: Array | None = None
    facing: float | None = None
    joints: dict[int, Array] = field(default_factory=dict)

    def scaled(self, factor: float) -> Key:
        """The same key with place and points times a factor."""
        position = None if self.position is None else np.asarray(self.position) * factor
        joints = {joint: factor * np.asarray(place) for joint, place in self.joints.items()}
        return replace(self, position=position, joints=joints)

    @property
    def goal(self) -> Array | None:
        """Approximate place (2,) of the hips in cm; None for anywhere."""
        if self.position is not None or not self.joints:
            return None if self.position is None else np.asarray(self.position, np.float64)
        points = np.mean(list(self.joints.values()), axis=0)
        return np.asarray(points)[[0, 2]]


def clip_pose(
    model: MotionModel, motion: Motion, frame: int, encoded: EncodedMotion | None = None
) -> tuple[KeyPose, Array]:
    """Pose and place (3,), x, z, heading, of a frame of a canonical motion in cm at the model's rate.

    encoded: the motion's features; computed if None.
    """
    encoded = encoded or encode_motion(motion, model.reference_rotations, model.config.layout)
    x, z, heading = encoded.ground[frame].tolist()
    back = quat_from_yaw(np.array(-heading, np.float32))
    rotations = motion.local_rotations[frame].copy()
    rotations[0] = quat_multiply(back, rotations[0])
    # Central differences: the mean of the steps before and after.
    before, after = max(frame - 1, 0), min(frame + 1, len(motion) - 1)
    apart = max(after - before, 1)
    change = quat_multiply(motion.local_rotations[after], quat_inverse(motion.local_rotations[before]))
    turns = quat_to_expmap(change) / apart
    turns[0] = quat_rotate(back, turns[0])
    step = quat_rotate(back, motion.root_positions[after] - motion.root_positions[before]) / apart
    legs = leg_length(motion.skeleton)
    embedding = model.pose_embedding.of(encoded.features[frame])
    height = float(motion.root_positions[frame, 1]) / legs
    return KeyPose(rotations, height, embedding, turns, step / legs), np.array([x, z, heading])


def read_keys(path: str | Path, model: MotionModel, start: Array | None = ORIGIN) -> tuple[Key, ...]:
    """Read the keys of a JSON file, in order of time; start as in check_keys.

    Raises:
        ControlError: the file does not have the form of docs/keys.md, or its keys contradict each other.
        MotionkitError: a file that it names cannot be read.
    """
    value = read_json(path, "a JSON file with keys", ControlError)
    entries = value.get("keys") if isinstance(value, dict) else None
    if not isinstance(entries, list) or not 0 < len(entries) <= MOST_KEYS:
        raise ControlError(f'{path}: expected {{"keys": [...]}} with 1 to {MOST_KEYS} keys')
    check_fields(value, ("keys",), path, ControlError)
    files = _Files(Path(path).parent, model)
    by_file = sorted(enumerate(entries, 1), key=lambda numbered: _file_of(numbered[1]))
    keys = [_key(f"{path}: key {number}", entry, files) for number, entry in by_file]
    with naming(path, ControlError):
        return check_keys(keys, start)


def key_files(path: str | Path) -> tuple[Path, ...]:
    """The clips that a valid JSON file with keys names."""
    entries = read_json(path, "a JSON file with keys", ControlError)["keys"]
    return tuple(Path(path).parent / name for name in sorted(set(map(_file_of, entries)) - {""}))


def check_keys(
    keys: Sequence[Key], start: Array | None = ORIGIN, earliest: float = EARLIEST
) -> tuple[Key, ...]:
    """Return the keys in order of time; raises ControlError if they contradict each other.

    start is the place (2,) in cm of the body before the first frame; None if it is not known yet. earliest is the
    earliest time in seconds.
    """
    if isinstance(keys, Key):
        raise ControlError("expected a list of keys, found one Key")
    for key in keys:
        _check_numbers(key)
        if key.seconds < earliest:
            raise ControlError(f"a key at {key.seconds:g} s; expected {earliest:g} s or later")
    ordered = tuple(sorted(keys, key=lambda key: key.seconds))
    before = Key(0.0, position=start)
    for number, key in enumerate(ordered):
        if number and key.seconds - ordered[number - 1].seconds < NEAREST - 1e-6:
            raise ControlError(
                f"keys at {ordered[number - 1].seconds:g} and {key.seconds:g} s; expected {NEAREST:g} s between keys"
            )
        goal, last = key.goal, before.goal
        if goal is None:
            continue
        if last is not None:
            away, time = float(np.linalg.norm(goal - last)), key.seconds - before.seconds
            # A goal by a joint is where the joint is to be, up to a metre from the hips.
            slack = METRE if key.position is None or before.position is None else 0.0
            if away > FASTEST * time + slack:
                raise ControlError(
                    f"the key at {key.seconds:g} s is {away / METRE:.1f} m from the one before, "
                    f"{away / METRE / time:.1f} m/s; expected at most {FASTEST / METRE:g} m/s"
                )
        before = key
    return ordered


def _check_numbers(key: Key) -> None:
    """Raise ControlError for what is no key, or has a number that is not finite."""
    if not isinstance(key, Key):
        raise ControlError(f"expected a Key, found {str(key)[:40]}")
    for joint in key.joints:
        if isinstance(joint, bool) or not isinstance(joint, Integral) or not 0 <= joint < len(JOINT_NAMES):
            raise ControlError(
                f"the key at {key.seconds} s: joints: expected indices of canonical joints, 0 to "
                f"{len(JOINT_NAMES) - 1}, found {str(joint)[:40]}"
            )
    values = [("time", key.seconds, ()), ("position", key.position, (2,)), ("facing", key.facing, ())]
    values += [(JOINT_NAMES[joint], place, (3,)) for joint, place in key.joints.items()]
    for name, value, shape in values:
        if value is not None and (np.shape(value) != shape or not np.isfinite(value).all()):
            count = "a number" if not shape else f"{shape[0]} numbers"
            raise ControlError(
                f"the key at {key.seconds} s: {name}: expected {count}, found {str(value)[:40]}"
            )


def check_length(keys: Sequence[Key], seconds: float) -> None:
    """Raise ControlError for a key after the end of a motion."""
    if keys and keys[-1].seconds > seconds + 1e-6:
        raise ControlError(
            f"a key at {keys[-1].seconds:g} s, but the motion lasts {seconds:g} s; give a longer --seconds"
        )


def _key(where: str, entry: Any, files: _Files) -> Key:
    if not isinstance(entry, dict):
        raise ControlError(f"{where}: expected an object, found {str(entry)[:40]}")
    check_fields(entry, _FIELDS, where, ControlError)
    if "time" not in entry:
        raise ControlError(f"{where}: expected its time in seconds, found none")
    seconds = _numbers(where, "time", [entry.get("time")], 1, EARLIEST, 3600.0)[0]
    position, facing = entry.get("position"), entry.get("facing")
    joints = entry.get("joints", {})
    if not isinstance(joints, dict):
        raise ControlError(f"{where}: joints: expected an object of joint names and points")
    key = Key(
        float(seconds),
        position=None if position is None else METRE * _numbers(where, "position", position, 2),
        facing=None
        if facing is None
        else float(wrap_angle(np.deg2rad(_numbers(where, "facing", [facing], 1)))[0]),
        joints={
            _joint(where, name): METRE * _numbers(where, name, place, 3) for name, place in joints.items()
        },
    )
    for joint, place in key.joints.items():
        if not -0.05 * METRE <= place[1] <= HIGHEST:
            raise ControlError(
                f"{where}: {JOINT_NAMES[joint]} at a height of {place[1] / METRE:g} m is out of reach"
            )
    if "pose" in entry:
        return replace(key, pose=_pose(where, entry["pose"], files))
    if key.position is None and key.facing is None and not key.joints:
        raise ControlError(f"{where}: nothing to meet; give pose, position, facing or joints")
    return key


def _file_of(entry: Any) -> str:
    """The file that a key's pose names, to take the keys of a file one after another."""
    pose = entry.get("pose") if isinstance(entry, dict) else None
    return str(pose.get("file", "")) if isinstance(pose, dict) else ""


def _joint(where: str, name: str) -> int:
    if name not in JOINT_NAMES:
        raise ControlError(f"{where}: unknown joint {name!r}, expected one of {', '.join(JOINT_NAMES)}")
    return JOINT_NAMES.index(name)


def _numbers(where: str, name: str, values: Any, count: int, least: float = -1e5, most: float = 1e5) -> Array:
    numbers = isinstance(values, list) and len(values) == count
    if not numbers or not all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
        found = values[0] if count == 1 and isinstance(values, list) else values
        raise ControlError(
            f"{where}: {name}: expected {count} number{'s' * (count > 1)}, found {str(found)[:40]}"
        )
    if not all(least <= v <= most for v in values):
        raise ControlError(f"{where}: {name}: expected {least:g} to {most:g}, found {values}")
    return np.array(values, np.float64)


def _pose(where: str, entry: Any, files: _Files) -> KeyPose:
    known = ("file", "seconds", "clip")
    if not isinstance(entry, dict) or not isinstance(entry.get("file"), str) or set(entry) - set(known):
        raise ControlError(f'{where}: pose: expected {{"file": "a.bvh", "seconds": 1.5}}')
    seconds = _numbers(where, "pose: seconds", [entry.get("seconds", 0.0)], 1, 0.0, 1e5)[0]
    clip = entry.get("clip")
    if clip is not None and not isinstance(clip, str):
        raise ControlError(f"{where}: pose: clip: expected the name of an animation of {entry['file']}")
    try:
        return files.pose(entry["file"], float(seconds), clip)
    except ControlError as error:
        raise ControlError(f"{where}: pose: {error}") from None


class _Files:
    """The motions that keys name. Only the last is kept, as a thousand long ones would fill the memory."""

    def __init__(self, folder: Path, model: MotionModel) -> None:
        self.folder, self.model = folder, model
        self._read: dict[tuple[str, str | None], tuple[Motion, EncodedMotion]] = {}

    def pose(self, name: str, seconds: float, animation: str | None = None) -> KeyPose:
        """The pose of a file at a time. Raises ControlError if the file is no motion, or shorter."""
        if (name, animation) not in self._read:
            self._read = {(name, animation): self._open(name, animation)}
        motion, encoded = self._read[name, animation]
        frame = round(seconds * self.model.fps)
        if frame >= len(motion):
            raise ControlError(f"{name} lasts {motion.seconds:.2f} s, found {seconds:g} s")
        return clip_pose(self.model, motion, frame, encoded)[0]

    def _open(self, name: str, animation: str | None) -> tuple[Motion, EncodedMotion]:
        from motionkit.rig.on_rig import file_on_floor

        try:
            clip = file_on_floor(self.folder / name, animation)
        except BvhError as error:
            if error.line is None:
                raise
            # Not what it found: keys from others could name a private file.
            raise ControlError(f"{name}: no BVH file that can be read, at line {error.line}") from None
        except MotionkitError as error:  # a key chooses an animation by a field
            raise MotionkitError(str(error).replace("with --clip", 'with "clip"')) from None
        motion = resample(clip, self.model.fps)
        if len(motion) == 1:  # a pose; it stands still
            turns, places = (
                np.repeat(each, 2, 0) for each in (motion.local_rotations, motion.root_positions)
            )
            motion = replace(motion, local_rotations=turns, root_positions=places)
        return motion, encode_motion(motion, self.model.reference_rotations, self.model.config.layout)


def smoothed_step(x: Array) -> Array:
    """A curve (...) that rises from 0 at 0 to 1 at 1, without velocity or acceleration at its ends."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * x * (x * (6.0 * x - 15.0) + 10.0)


def travel_direction(step: Array) -> float:
    """The heading in radians of a step (2,) over the ground."""
    return math.atan2(float(step[0]), float(step[1]))
