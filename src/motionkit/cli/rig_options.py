"""Options for the rig and the root motion of written motions."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import EXISTING_FILE, eager_option, gathered, option, say, strict_option, together
from motionkit.errors import MotionkitError
from motionkit.reading import as_found, reading

if TYPE_CHECKING:
    from motionkit.export.clip import Clip
    from motionkit.finish.finish import Unfinished
    from motionkit.motion.motion import Motion
    from motionkit.motion.skeleton import Skeleton
    from motionkit.rig.character import Character
    from motionkit.rig.rig import Rig


class _RigFile(click.Path):
    """The file of a rig, or @NAME for a built-in one."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Any:
        from motionkit.rig.built_in import rig_file

        try:
            return super().convert(rig_file(value), parameter, context)
        except MotionkitError as error:
            self.fail(str(error), parameter, context)


def _list_rigs(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        from motionkit.rig.built_in import rig_lines

        for line in rig_lines():
            say(line)
        context.exit()


RIG_FILE: Any = _RigFile(exists=True, dir_okay=False, path_type=Path)
rig_option = together(
    click.option(
        "--rig",
        "rig_path",
        type=RIG_FILE,
        help="Write the motion on the rig of this file (.bvh, .glb, .vrm, .fbx, .asf): same joints, names, rest pose, "
        "channels, unit and axes; by default on the 23 canonical joints. A .glb, .vrm or .fbx written to one of these "
        "formats keeps the whole character. @NAME is a built-in rig, such as @mixamo.",
    ),
    eager_option("--list-rigs", is_flag=True, callback=_list_rigs, help="List the built-in rigs."),
)
map_option = click.option(
    "--map",
    "map_path",
    type=EXISTING_FILE,
    help="Bone map of the --rig file (JSON, from `motionkit retarget --save-map`); found by names and shape by "
    "default.",
)


class ClipFile(click.Path):
    """An existing file, or FILE#NAME with the name of one of its animations."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path as it is given; fails where its file does not exist."""
        file, name = animation_in(Path(value))
        super().convert(file, param, ctx)
        return file if name is None else Path(value)


def animation_in(path: Path) -> tuple[Path, str | None]:
    """The file and the animation of FILE#NAME; a path that exists is a file alone."""
    file, mark, name = str(path).partition("#")
    return (path, None) if path.exists() or not mark else (Path(file), name)


clip_option = click.option(
    "--from",
    "clip_path",
    type=ClipFile(exists=True, dir_okay=False, path_type=Path),
    help="Clip of the --rig that moves the joints motionkit does not know (fingers, props), or FILE#NAME for one of "
    "its animations; by default they keep their rest pose.",
)
rest_options = together(
    option(
        "--rest",
        type=click.Choice(["file", "tpose", "apose"]),
        default="file",
        help="Rest pose to write: that of the rig or clip, a T-pose, or an A-pose with arms 45 degrees down; the "
        "motion stays the same. Not for a .glb or .vrm that the motion is added to, which keeps its own.",
    ),
    click.option(
        "--rest-frame",
        is_flag=True,
        help="Begin with one frame of the rest pose, as Second Life and older importers expect.",
    ),
)
root_options = together(
    click.option("--in-place", is_flag=True, help="Remove root motion over the ground; sway and turns stay."),
    option(
        "--root",
        type=click.Choice(["hips", "ground"]),
        default="hips",
        help="Joint that carries the root motion: the hips, or a new root joint on the ground below them, as engines "
        "expect.",
    ),
    rest_options,
)


@dataclass(frozen=True)
class RootMotion:
    """Where root motion is written, in place or not, on the hips or on a ground bone; and the rest pose."""

    in_place: bool = False
    root: str = "hips"
    rest: str = "file"
    rest_frame: bool = False

    def applied(self, motion: Motion, cyclic: bool = False, rig: Rig | None = None) -> Motion:
        """The motion of a rig, found by default, as requested; cyclic: its last frame equals its first."""
        if self.in_place or self.root == "ground":
            from motionkit.editing.root_motion import in_place, with_ground_root

            # The ground bone comes first. It would take up the sway that is left of a motion in place.
            motion = with_ground_root(motion, cyclic) if self.root == "ground" else motion
            motion = in_place(motion, cyclic) if self.in_place else motion
        if self.rest_frame:
            from motionkit.editing.rest_frame import with_rest_frame

            motion = with_rest_frame(motion, rig, self.rest)
        if self.rest != "file":
            from motionkit.editing.rest_frame import with_rest_pose

            motion = with_rest_pose(motion, self.rest, rig)
        return motion


@dataclass(frozen=True)
class RigChoice:
    """The rig of --rig, --map and --from; without --rig, motion stays on the canonical joints.

    Attributes:
        rig: the rig, or None.
        clip: motion of the rig from --from, or None.
        files: the files that were read.
        root_motion: how root motion is written.
    """

    rig: Rig | None = None
    clip: Motion | None = None
    files: tuple[Path, ...] = ()
    root_motion: RootMotion = RootMotion()

    @property
    def fps(self) -> float | None:
        """Frame rate that readers of the rig expect, if they expect one."""
        return None if self.rig is None else self.rig.fps

    @property
    def words(self) -> str:
        """Text after a motion's name in messages: the rig it is on."""
        return "" if self.rig is None else f" on {self.rig.name}"

    def size(self, body: Skeleton) -> float:
        """The size of the rig relative to a body in cm (Rig.size); 1 without a rig."""
        return 1.0 if self.rig is None else self.rig.size(body)

    def own_body(self, written: Motion, measured: Motion) -> Motion:
        """A written motion on the canonical joints with the bones of the rig; `measured` without a rig."""
        if self.rig is None:
            return measured
        from motionkit.rig.upright import Upright

        with as_found():
            return Upright.of(written).canonical or measured

    @property
    def character(self) -> Character | None:
        """The .glb or .vrm file that the rig is from, or None."""
        return None if self.rig is None else self.rig.character

    @property
    def ending(self) -> str:
        """The usual ending of a file with the motion."""
        return ".bvh" if self.rig is None else self.rig.ending

    def as_written(self) -> AbstractContextManager[None]:
        """Read the written motion within the block: on a rig, without what the user says of clips."""
        return nullcontext() if self.rig is None else as_found()

    def on_rig(self, motion: Motion, ik: bool, drawn: Unfinished | None = None) -> Motion:
        """A canonical motion on the rig; ik holds the feet of the rig.

        drawn is the motion before finishing. It is finished on the rig's body instead, so that feet are locked once.
        """
        if self.rig is None:
            return motion
        from motionkit.finish.on_rig import on_rig

        return on_rig(motion, self.rig, ik, self.clip, drawn)

    def put(
        self, motion: Motion, ik: bool, cyclic: bool = False, drawn: Unfinished | None = None
    ) -> tuple[Motion, Motion]:
        """The motion to write, and the canonical motion for metrics.

        Args:
            motion: on the canonical joints.
            ik: hold the feet of the rig.
            cyclic: the last frame of the motion equals its first.
            drawn: the motion before finishing, if known.
        """
        if cyclic and self.rig is not None:
            from motionkit.editing.loop import cycle_on_rig

            made = cycle_on_rig(motion, self.rig, ik, self.clip)
        else:
            made = self.on_rig(motion, ik, drawn)
        if self.rig is None:
            return self.root_motion.applied(made, cyclic), motion
        from motionkit.rig.on_rig import from_rig

        return self.root_motion.applied(made, cyclic, self.rig), from_rig(made, self.rig)

    def clip_of(self, motion: Motion, name: str, types: Sequence[tuple[str, float]] = ()) -> Clip:
        """The clip to write for a motion from put; the file gets what the rig's file has besides motion."""
        from motionkit.export.clip import Clip, rig_clip

        return Clip(motion, name, types) if self.rig is None else rig_clip(motion, self.rig, name, types)


def open_rig(rig_path: Path | None, map_path: Path | None = None, clip_path: Path | None = None) -> RigChoice:
    """Read the rig of the options; raises UsageError for --map or --from without --rig."""
    for name, path in (("--map", map_path), ("--from", clip_path)):
        if path is not None and rig_path is None:
            raise click.UsageError(f"{name} needs --rig, the file of the rig")
    if rig_path is None:
        return RigChoice()
    from motionkit.rig.on_rig import read_clip, read_rig

    with as_found():
        rig = read_rig(rig_path, map_path)
        clip_file, animation = (None, None) if clip_path is None else animation_in(clip_path)
        with reading(animation=animation):
            clip = None if clip_file is None else read_clip(clip_file, rig)
    files = tuple(path for path in (rig_path, map_path, clip_file) if path is not None)
    return RigChoice(rig, clip, files)


def open_written(
    rig_path: Path | None,
    map_path: Path | None,
    clip_path: Path | None,
    in_place: bool,
    root: str,
    rest: str,
    rest_frame: bool,
) -> RigChoice:
    """Like open_rig, with root motion; raises UsageError for a ground joint on a rig without one."""
    choice = open_rig(rig_path, map_path, clip_path)
    if choice.rig is not None and root == "ground":
        from motionkit.editing.root_motion import root_bone

        if root_bone(choice.rig.skeleton) is None:
            raise click.UsageError(
                f"--root ground adds a joint, and --rig keeps those of its file; {choice.rig.name} has no root bone "
                "(root, reference) above its hips"
            )
    return replace(choice, root_motion=RootMotion(in_place, root, rest, rest_frame))


rig_options = together(rig_option, map_option, clip_option, strict_option, gathered("choice", open_rig))
written_options = together(root_options, rig_option, map_option, clip_option)
