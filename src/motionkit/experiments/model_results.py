"""Reads the results that commands write for one model each: long roll-outs, bodies and scenes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.experiments.scenes import SCENES
from motionkit.files import read_json

Results = list[dict[str, Any]]


def read_long(folder: Path) -> Results:
    """Return the long roll-outs of all models in a folder. Raises MotionkitError for a file that holds none."""
    return _read(folder, "long roll-outs", lambda result: isinstance(result.get("rollouts"), list))


def read_bodies(folder: Path) -> Results:
    """Return what all models in a folder make of bodies. Raises MotionkitError for a file without."""
    return _read(folder, "bodies", lambda result: isinstance(result.get("performers"), list))


def read_scenes(folder: Path) -> Results:
    """Return the scenes of all models in a folder. Raises MotionkitError for a file that lacks some."""
    names = [scene.name for scene in SCENES]
    return _read(
        folder, "all scenes", lambda result: [s.get("name") for s in result.get("scenes", [])] == names
    )


def _read(folder: Path, what: str, complete: Callable[[dict[str, Any]], bool]) -> Results:
    """The JSON objects of a folder, the shipped model's first, once each is complete."""
    out = []
    for path in sorted(folder.glob("*.json"), key=lambda p: (p.stem != "shipped", p.stem)):
        result = read_json(path, f"the results of {what}", MotionkitError)
        if not isinstance(result, dict) or not complete(result):
            raise MotionkitError(f"{path}: not the results of {what}; make them again")
        out.append(result)
    return out
