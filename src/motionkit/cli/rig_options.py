"""Options of the commands that write motion on a user's rig."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.motion_options import HIPS, RootMotion

if TYPE_CHECKING:
    from motionkit.export.clip import Clip
    from motionkit.motion.motion import Motion
    from motionkit.rig.rig import Rig

_FILE: Any = click.Path(exists=True, dir_okay=False, path_type=Path)

rig_option = click.option(
    "--rig",
    "rig_path",
    type=_FILE,
    help="Write the motion on the rig of this file (.bvh, .glb, .vrm): same joints, names, rest pose, channels, unit "
    "and axes; by default on the 23 canonical joints.",
)
map_option = click.option(
    "--map",
    "map_path",
    type=_FILE,
    help="Bone map of the --rig file (JSON, from `motionkit retarget --save-map`); found by names and shape by "
    "default.",
)
clip_option = click.option(
    "--from",
    "clip_path",
    type=_FILE,
    help="BVH file of the --rig: its joints that motionkit does not know (fingers, props) move as they do there; in "
    "their rest pose by default.",
)


@dataclass(frozen=True)
class RigChoice:
    """The rig that --rig, --map and --from ask for; without --rig, motion stays on the canonical joints.

    Attributes:
        rig: the rig, or None.
        clip: its motion from --from, or None.
        files: the files that were read.
    """

    rig: Rig | None
    clip: Motion | None
    files: tuple[Path, ...]

    def put(self, motion: Motion, ik: bool, way: RootMotion = HIPS, cyclic: bool = False) -> Motion:
        """What to write for a motion on the canonical joints: itself, or the motion on the rig.

        Args:
            motion: on the canonical joints.
            ik: hold the feet of the rig.
            way: how the way over the ground is written.
            cyclic: the last frame of the motion is its first.
        """
        return way.applied(self._on_rig(motion, ik, way), cyclic)

    def put_and_measure(
        self, motion: Motion, ik: bool, way: RootMotion, cyclic: bool = False
    ) -> tuple[Motion, Motion]:
        """What to write, as put gives it, and the motion that metrics measure: the same on the canonical joints."""
        made = self._on_rig(motion, ik, way)
        if self.rig is None:
            return way.applied(made, cyclic), motion
        from motionkit.rig.on_rig import from_rig

        return way.applied(made, cyclic), from_rig(made, self.rig)

    def _on_rig(self, motion: Motion, ik: bool, way: RootMotion) -> Motion:
        if self.rig is None:
            return motion
        from motionkit.finish.on_rig import on_rig

        if way.root == "ground":
            raise click.UsageError("--root ground adds a joint; --rig keeps the joints of its file")
        return on_rig(motion, self.rig, ik, self.clip)

    def clip_of(self, motion: Motion, name: str, types: Sequence[tuple[str, float]]) -> Clip:
        """What writers take for a motion from put; a BVH file gets the hierarchy and channels of the rig."""
        from motionkit.export.clip import Clip

        if self.rig is None:
            return Clip(motion, name, types)
        return Clip(motion, name, types, self.rig.channels, self.rig.hierarchy)


NO_RIG = RigChoice(None, None, ())


def open_rig(rig_path: Path | None, map_path: Path | None, clip_path: Path | None) -> RigChoice:
    """Read what the options name; raises UsageError for --map or --from without --rig."""
    for name, path in (("--map", map_path), ("--from", clip_path)):
        if path is not None and rig_path is None:
            raise click.UsageError(f"{name} needs --rig, the file of the rig")
    if rig_path is None:
        return NO_RIG
    from motionkit.rig.on_rig import read_clip, read_rig

    rig = read_rig(rig_path, map_path)
    clip = None if clip_path is None else read_clip(clip_path, rig)
    return RigChoice(rig, clip, tuple(path for path in (rig_path, map_path, clip_path) if path is not None))


def rig_options(function: Callable) -> Callable:
    """The options --rig, --map and --from; the command gets what they name as `choice`."""

    @functools.wraps(function)
    def with_rig(
        *arguments: Any, rig_path: Path | None, map_path: Path | None, clip_path: Path | None, **options: Any
    ) -> Any:
        return function(*arguments, choice=open_rig(rig_path, map_path, clip_path), **options)

    return rig_option(map_option(clip_option(with_rig)))
