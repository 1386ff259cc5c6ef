"""The rigs that motionkit brings, by names such as @mixamo in place of a file. docs/make_rigs.py makes them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from motionkit.errors import SkeletonError
from motionkit.names import unknown_name

_FOLDER = Path(__file__).parents[1] / "assets/rigs"
_MARK = "@"


class BuiltIn(NamedTuple):
    """What a built-in rig is for, and the frame rate that its readers expect, if they expect one."""

    words: str
    fps: float | None = None


BUILT_IN = {
    "mixamo": BuiltIn("Mixamo characters, prefix mixamorig:, T-pose, fingers"),
    "unreal": BuiltIn("Unreal's mannequin, root bone on the ground, A-pose, fingers"),
    "vrm": BuiltIn("VRM's humanoid bones, T-pose, fingers"),
    "cmu": BuiltIn("BVH files of the CMU database, T-pose"),
    "lafan1": BuiltIn("LAFAN1, for robots' retargeters such as GMR; X along the bones, 30 fps", 30.0),
}


def rig_file(place: str | Path) -> Path:
    """The file of a rig: that of a built-in rig for @NAME, any other place as it is.

    Raises SkeletonError for an unknown name.
    """
    if not str(place).startswith(_MARK):
        return Path(place)
    name = str(place).removeprefix(_MARK).lower()
    if name not in BUILT_IN:
        raise SkeletonError(unknown_name("rig", str(place), tuple(_MARK + known for known in BUILT_IN)))
    return _FOLDER / f"{name}.bvh"


def rig_rate(path: Path) -> float | None:
    """The frame rate that readers of a built-in rig expect; None for other files."""
    return BUILT_IN[path.stem].fps if path.parent == _FOLDER else None


def rig_lines() -> list[str]:
    """A line for each built-in rig: its name, its number of joints, and what it is for."""
    lines = []
    for name, built in BUILT_IN.items():
        text = rig_file(_MARK + name).read_text("ascii")
        lines.append(f"{_MARK}{name:8} {text.count('CHANNELS')} joints  {built.words}")
    return lines
