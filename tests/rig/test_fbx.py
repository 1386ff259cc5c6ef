"""FBX through a program that the user has: found and said, its faults in one line.

Programs here are made up; tests/export/test_readers.py has Blender.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.export.formats import read_motion, write_motion
from motionkit.motion.kinematics import motion_kinematics
from motionkit.reading import reading
from motionkit.rig import fbx
from motionkit.rig.on_rig import read_rig
from synthetic_motions import make_walk

# A program that copies its source, after what a test puts before that.
FAKE = """#!{python}
import pathlib, sys, time
source, target = [word for word in sys.argv[1:] if word.endswith((".fbx", ".glb"))]
{before}
pathlib.Path(target).write_bytes(pathlib.Path(source).read_bytes())
"""


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder as the PATH, and no bpy."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    fbx._converted.cache_clear()
    return folder


def put(folder: Path, name: str, before: str = "") -> None:
    (folder / name).write_text(FAKE.format(python=sys.executable, before=before))
    (folder / name).chmod(0o755)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """A .glb under the name of an FBX file."""
    write_motion(tmp_path / "walk.glb", make_walk(30))
    return (tmp_path / "walk.glb").rename(tmp_path / "walk.fbx")


@pytest.mark.parametrize(("name", "said"), [("FBX2glTF", "FBX2glTF"), ("blender", "Blender")])
def test_read_once_by_what_is_there(programs: Path, clip: Path, name: str, said: str) -> None:
    """As a clip and as a rig, whose character then is a .glb; the program runs once for both."""
    put(programs, name)
    told: list[str] = []
    with reading(on_note=told.append):
        motion, rig = read_motion(clip), read_rig(clip)
    assert told == [f"walk.fbx: read with {said}"]
    assert np.abs(motion_kinematics(motion)[1] - motion_kinematics(make_walk(30))[1]).max() < 0.01
    assert rig.character is not None and rig.joints.missing() == ()


def test_the_next_one_if_one_fails(programs: Path, clip: Path) -> None:
    put(programs, "FBX2glTF", "sys.exit('no licence')")
    with pytest.raises(MotionkitError, match=r"walk.fbx: FBX2glTF made nothing of it \(no licence\)"):
        read_motion(clip)
    put(programs, "blender")
    told: list[str] = []
    with reading(on_note=told.append):
        assert len(read_motion(clip)) == 30 and told == ["walk.fbx: read with Blender"]


@pytest.mark.parametrize(
    ("before", "said"),
    [
        (None, "needs FBX2glTF on the PATH (`npm install fbx2gltf` brings it), Blender on the PATH, or"),
        ("sys.exit()", "FBX2glTF made nothing of it (exit code 0)"),
        ("print('a\\nb\\x1b[31m'); sys.exit(3)", "FBX2glTF made nothing of it (b\\x1b[31m)"),
        ("time.sleep(60)", "FBX2glTF did not finish within 1 s"),
        ("pathlib.Path(target).write_text('x' * 30); sys.exit()", "is no binary glTF file"),
    ],
)
def test_faults_are_one_line(
    programs: Path, clip: Path, monkeypatch: pytest.MonkeyPatch, before: str | None, said: str
) -> None:
    monkeypatch.setattr(fbx, "SECONDS", 1.0 if before and "sleep" in before else 30.0)
    if before is not None:
        put(programs, "FBX2glTF", before)
    with reading(on_note=lambda note: None), pytest.raises(MotionkitError) as told:
        read_motion(clip)
    assert said in str(told.value) and str(told.value).startswith(f"{clip}: ") and "\n" not in str(told.value)


def test_written_by_blender_alone(programs: Path, tmp_path: Path) -> None:
    """From a .glb; without Blender nothing is left."""
    put(programs, "FBX2glTF")
    with pytest.raises(MotionkitError, match=r"a.fbx: an FBX file needs Blender on the PATH, or"):
        write_motion(tmp_path / "a.fbx", make_walk(5))
    assert not list(tmp_path.glob("*a.fbx*"))
    put(programs, "blender")
    write_motion(tmp_path / "a.fbx", make_walk(5))
    assert (tmp_path / "a.fbx").read_bytes()[:4] == b"glTF"
