"""FBX files through a program that the user has, run as a process of its own: FBX2glTF, Blender, or its module bpy."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from motionkit.errors import MotionkitError
from motionkit.files import check_regular, read_bytes
from motionkit.names import visible
from motionkit.reading import report_notes

ENDING = ".fbx"
SECONDS = 300.0  # seconds after which a program is stopped
READ_NEEDS = (
    "needs FBX2glTF on the PATH (`npm install fbx2gltf` brings it), Blender on the PATH, or the Python module bpy "
    "(`pip install bpy`)"
)
WRITE_NEEDS = "needs Blender on the PATH, or the Python module bpy (`pip install bpy`)"
MAX_BYTES = 2**30
_BLENDER = Path(__file__).with_name("in_blender.py")
# Time modes of an FBX whose rate FBX2glTF can bake; others are baked at 60 frames a second.
_TIME_MODE = re.compile(rb"TimeMode.{0,40}?I(.)\x00\x00\x00", re.DOTALL)
_BAKED = {6: "bake30", 7: "bake30", 8: "bake30", 9: "bake30", 11: "bake24", 13: "bake24"}


class _Converter(NamedTuple):
    """A program by its name, and what it is called with."""

    name: str
    command: tuple[str, ...]


def glb_of_fbx(path: str | Path) -> bytes:
    """The .glb that the user's program makes of an FBX file; a note says which program that was.

    Raises:
        MotionkitError: the file cannot be read, there is no such program, or it made nothing of it.
    """
    check_regular(path, MAX_BYTES, "an FBX file")
    facts = Path(path).stat()
    return _converted(str(Path(path).resolve()), str(path), facts.st_mtime_ns, facts.st_size)


@lru_cache(maxsize=2)
def _converted(place: str, path: str, changed: int, size: int) -> bytes:
    data = read_bytes(place, MAX_BYTES, "an FBX file")
    mode = _TIME_MODE.search(data)
    bake = _BAKED.get(mode[1][0] if mode else 0, "bake60")
    found = shutil.which("FBX2glTF")
    converters = (
        [_Converter("FBX2glTF", (found, "--binary", "--anim-framerate", bake, "--input"))] if found else []
    )
    converters += _blenders()
    if not converters:
        raise MotionkitError(f"{path}: an FBX file {READ_NEEDS}")
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made.glb"
        for converter in converters:
            more = ("--output", str(made)) if converter.name == "FBX2glTF" else (str(made),)
            fault = _run(converter, (place, *more), made)
            if not fault:
                report_notes(path, (converter.name,))
                return read_bytes(made, MAX_BYTES, "a binary glTF file")
    raise MotionkitError(f"{path}: {fault}")


def fbx_of_glb(path: str | Path, glb: Path, made: Path, fps: float) -> None:
    """Let Blender make an FBX file of a .glb; path names it in errors.

    Raises:
        MotionkitError: there is no Blender, or it made nothing.
    """
    check_writes(path)
    fault = ""
    for converter in _blenders():
        fault = _run(converter, (str(glb), str(made), repr(fps)), made)
        if not fault:
            return
    raise MotionkitError(f"{path}: {fault}")


def check_writes(path: str | Path) -> None:
    """Raise MotionkitError, naming the file to write, if nothing that writes FBX is installed."""
    if next(_blenders(), None) is None:
        raise MotionkitError(f"{path}: an FBX file {WRITE_NEEDS}")


def _blenders() -> Iterator[_Converter]:
    found = shutil.which("blender")
    if found:
        yield _Converter(
            "Blender", (found, "--background", "--factory-startup", "--python", str(_BLENDER), "--")
        )
    if importlib.util.find_spec("bpy") is not None:
        yield _Converter("bpy", (sys.executable, str(_BLENDER), "--"))


def _run(converter: _Converter, more: tuple[str, ...], made: Path) -> str:
    """Run a program in the folder of the file that it makes; returns what went wrong, "" if nothing did."""
    try:
        done = subprocess.run(
            (*converter.command, *more),
            cwd=made.parent,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"{converter.name} did not finish within {SECONDS:g} s"
    except OSError as error:
        return f"{converter.name} cannot be started ({error.strerror})"
    if done.returncode == 0 and made.is_file() and made.stat().st_size:
        return ""
    lines = [line.strip() for line in done.stdout.decode("utf-8", "replace").splitlines() if line.strip()]
    last = visible(lines[-1])[:200] if lines else f"exit code {done.returncode}"
    return f"{converter.name} made nothing of it ({last})"
