"""Writes FBX files through the user's Blender, from the .glb of the same motion."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from motionkit.export.clip import Clip
from motionkit.export.glb import write_glb
from motionkit.files import atomic_write
from motionkit.rig.fbx import fbx_of_glb


def write_fbx(path: str | Path, clip: Clip) -> None:
    """Write a motion of any rig as FBX, in metres, atomically; raises MotionkitError without Blender."""
    with tempfile.TemporaryDirectory() as folder:
        glb, made = Path(folder) / "made.glb", Path(folder) / "made.fbx"
        write_glb(glb, clip)
        fbx_of_glb(path, glb, made, clip.motion.fps)
        with made.open("rb") as source, atomic_write(path, "wb") as file:
            shutil.copyfileobj(source, file)
