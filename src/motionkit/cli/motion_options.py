"""Shared by the commands that write motions: the endings of -o, root motion, and looping."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from motionkit.editing.loop import Loop
    from motionkit.motion.motion import Motion

FORMATS = ("bvh", "glb", "vrma", "usda", "npz", "csv")  # those of export.formats, which takes long to import
_FAR_FROM_WISH = 0.1  # share of a wished length by which a cycle may differ without a word
ENDINGS = f"{', '.join(f'.{name}' for name in FORMATS[:-1])} or .{FORMATS[-1]}"


@dataclass(frozen=True)
class RootMotion:
    """How the way over the ground is written: in place or not, carried by the hips or by a bone on the ground."""

    in_place: bool = False
    root: str = "hips"

    def applied(self, motion: Motion, cyclic: bool = False) -> Motion:
        """The motion with its way as asked for; cyclic for one whose last frame is its first."""
        if not self.in_place and self.root == "hips":
            return motion
        from motionkit.editing.root_motion import in_place, with_ground_root

        if self.in_place:
            motion = in_place(motion, cyclic)
        return with_ground_root(motion, cyclic) if self.root == "ground" else motion


HIPS = RootMotion()  # the way as it is, carried by the hips


def root_options(function: Callable) -> Callable:
    """The options --in-place and --root, which arrive as one argument, root_motion."""

    def wrapped(*words: Any, in_place: bool, root: str, **named: Any) -> Any:
        return function(*words, root_motion=RootMotion(in_place, root), **named)

    wrapped.__doc__, wrapped.__name__ = function.__doc__, function.__name__
    wrapped.__click_params__ = getattr(function, "__click_params__", [])  # type: ignore[attr-defined]
    root = click.option(
        "--root",
        type=click.Choice(["hips", "ground"]),
        default="hips",
        show_default=True,
        help="Joint with the root motion: the hips, or a new root joint on the ground below them, as engines expect.",
    )
    place = click.option(
        "--in-place", is_flag=True, help="Remove root motion over the ground; sway and turns stay."
    )
    return place(root(wrapped))


def checked_ending(context: click.Context, parameter: click.Parameter, value: Path | None) -> Path | None:
    """Refuse an output whose ending no writer knows, before any work; "-" is standard output."""
    if value is None or str(value) == "-":
        return value
    from motionkit.errors import MotionkitError
    from motionkit.export.formats import check_ending

    try:
        check_ending(value)
    except MotionkitError as error:
        raise click.BadParameter(str(error)) from None
    return value


def clip_output_option(word: str) -> Callable[[Callable], Callable]:
    """The -o of a command that writes a changed clip, as CLIP-word.bvh in the current folder by default."""
    return click.option(
        "-o",
        "--output",
        type=click.Path(path_type=Path),
        callback=checked_ending,
        help=f"File to write: {ENDINGS}; CLIP-{word}.bvh by default.",
    )


def seam_words(loop: Loop) -> str:
    """What a loop shows where it begins again, in one line."""
    seam = loop.seam
    return (
        f"seam {seam.distance:.2f} cm and {seam.speed:.0f} cm/s; between two following frames up to "
        f"{seam.frame_distance:.1f} cm and {seam.frame_speed:.0f} cm/s"
    )


@contextmanager
def naming(clip: Path) -> Iterator[None]:
    """Name the file in a fault of its rig: writers know only the file to write."""
    from motionkit.errors import SkeletonError

    try:
        yield
    except SkeletonError as error:
        raise SkeletonError(f"{clip}: {error}") from None


def length_note(found: float, wish: float | None) -> str | None:
    """What to say of a cycle that lasts much longer or shorter than wished, in seconds."""
    if wish is None or abs(found - wish) <= _FAR_FROM_WISH * wish:
        return None
    return f"the cycle nearest to {wish:g} s lasts {found:.2f} s"


def seam_json(loop: Loop) -> dict[str, float]:
    """The seam of a loop for programs."""
    seam = loop.seam
    return {
        "seam_cm": seam.distance,
        "seam_cm_s": seam.speed,
        "frame_cm": seam.frame_distance,
        "frame_cm_s": seam.frame_speed,
    }
