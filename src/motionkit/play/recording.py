"""Records frames as sent, and converts them to motion files."""

from __future__ import annotations

import secrets
import tempfile
from collections import OrderedDict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motionkit.errors import MotionkitError
from motionkit.export.clip import Clip, rig_clip
from motionkit.export.formats import WRITERS, write_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_continuous
from motionkit.motion.skeleton import JOINT_COUNT, Skeleton
from motionkit.rig.rig import Rig

Floats = NDArray[np.float32]
# All but FBX, which another program writes in seconds.
FORMATS = tuple(ending.removeprefix(".") for ending in WRITERS if ending != ".fbx")
_GROWTH = 600  # frames, initial capacity of a recording


class Recorder:
    """Records the frames of one character."""

    def __init__(self, skeleton: Skeleton, fps: float, most_frames: int, format: str | None = None) -> None:
        """format is the requested file format, or None."""
        self.skeleton, self.fps, self.most_frames, self.format = skeleton, fps, most_frames, format
        self.frames = 0
        self._values = np.zeros((min(_GROWTH, most_frames), JOINT_COUNT * 4 + 3), np.float32)

    @property
    def full(self) -> bool:
        """Whether the recording has reached its maximum length."""
        return self.frames >= self.most_frames

    def append(self, rotations: Floats, root: Floats) -> None:
        """Append a frame: rotations (23, 4) and root (3,); does nothing once full."""
        if self.full:
            return
        if self.frames == len(self._values):
            room = min(2 * len(self._values), self.most_frames) - len(self._values)
            self._values = np.concatenate([self._values, np.zeros((room, self._values.shape[1]), np.float32)])
        self._values[self.frames, :-3] = rotations.reshape(-1)
        self._values[self.frames, -3:] = root
        self.frames += 1

    def motion(self) -> Motion:
        """The recorded motion."""
        values = self._values[: self.frames].copy()
        rotations = quat_continuous(values[:, :-3].reshape(-1, JOINT_COUNT, 4))
        return Motion(self.skeleton, rotations, values[:, -3:], self.fps)


def holds(format: str | None, rig: Rig | None) -> bool:
    """Whether recordings on a rig can have a format, None for the usual one: a .vrm is an avatar."""
    avatar = None if rig is None else rig.character
    return format != "vrm" or (avatar is not None and bool(avatar.skeleton.humanoid))


def file_bytes(
    motion: Motion, rig: Rig | None = None, clip: Motion | None = None, format: str = "bvh"
) -> bytes:
    """A motion as the contents of a file; takes about a second for minutes of motion.

    Args:
        motion: on the canonical joints.
        rig: rig of the file, with its feet held; by default the canonical joints.
        clip: motion of the rig that animates its other joints.
        format: one of FORMATS.

    Raises:
        MotionkitError: the format cannot hold the motion, such as VRMA for a rig with too few known joints.
    """
    made = Clip(motion, "recording")
    if rig is not None:
        made = rig_clip(on_rig(motion, rig, clip=clip), rig, "recording")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"recording.{format}"
        try:
            write_motion(file, made)
        except MotionkitError as error:
            raise MotionkitError(str(error).replace(str(file), file.name)) from None
        return file.read_bytes()


class Recordings:
    """Finished files in memory, under random names; the oldest are dropped when space runs out."""

    def __init__(self, most: int, most_bytes: int) -> None:
        self.most, self.most_bytes = most, most_bytes
        self._files: OrderedDict[str, bytes] = OrderedDict()

    def add(self, data: bytes, format: str = "bvh") -> str:
        """Store a file; returns its name: a token with the format's ending."""
        name = f"{secrets.token_urlsafe(18)}.{format}"
        self._files[name] = data
        while len(self._files) > 1 and (
            len(self._files) > self.most or sum(map(len, self._files.values())) > self.most_bytes
        ):
            self._files.popitem(last=False)
        return name

    def get(self, name: str) -> bytes | None:
        """The file with this name; None if unknown or dropped."""
        return self._files.get(name)
