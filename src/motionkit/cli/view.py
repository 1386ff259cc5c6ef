"""`motionkit view`: BVH and GLB files as a web page that plays them, a contact sheet, a GIF or a video."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import default_output, json_option, print_json, progress_bar, say
from motionkit.cli.motion_options import naming
from motionkit.cli.showing import open_in_browser
from motionkit.names import counted, visible

if TYPE_CHECKING:
    from motionkit.motion.motion import Motion
    from motionkit.view.figure_data import Shown

ENDINGS = (".html", ".png", ".gif", ".mp4")


def _ending(context: click.Context, parameter: click.Parameter, value: Path | None) -> Path | None:
    if value is not None and value.suffix.lower() not in ENDINGS:
        known = ", ".join(ENDINGS)
        raise click.BadParameter(f"expected a file name that ends in {known}, found {str(value)!r}")
    return value


@click.command("view")
@click.argument("clips", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    callback=_ending,
    help="File to write; its ending chooses the format: .html (default, a web page that plays the motions), .png "
    "(a contact sheet), .gif or .mp4.",
)
@click.option(
    "--path",
    "path_file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Path file (JSON or CSV) to draw on the ground of the page.",
)
@click.option("--open/--no-open", "opens", default=True, help="Open the page in the browser; on by default.")
@click.option(
    "--poses",
    type=click.IntRange(1, 480),
    default=12,
    show_default=True,
    help="Contact sheet: number of poses per clip.",
)
@click.option(
    "--every",
    type=click.IntRange(min=1),
    help="Contact sheet: one pose every this many frames, instead of --poses.",
)
@click.option(
    "--width",
    type=click.IntRange(160, 8000),
    help="Width in pixels: contact sheet 600 to 8000 (default 1800), GIF (480) or video (960) 160 to 3840.",
)
@json_option
@click.pass_context
def command(
    context: click.Context,
    clips: tuple[Path, ...],
    output: Path | None,
    path_file: Path | None,
    opens: bool,
    poses: int,
    every: int | None,
    width: int | None,
    as_json: bool,
) -> None:
    """Show BVH and skinned GLB files (CLIPS) of any rig, unit and frame rate.

    Without -o the command writes a web page, named after the first clip, to the current folder and opens it
    in the browser. The page is one self-contained HTML file.
    """
    from motionkit.files import check_outputs
    from motionkit.view.body import check_bones
    from motionkit.view.figure_data import Shown

    target = output or default_output(clips[0].stem, ".html")
    _check_options(context, target)
    check_outputs([target], [*clips, path_file])
    path = None
    if path_file is not None:
        from motionkit.control.path import read_path

        path = read_path(path_file).points
    shown = [
        Shown(visible(name), _read(clip), path=path) for name, clip in zip(_names(clips), clips, strict=True)
    ]
    for clip, one in zip(clips, shown, strict=True):
        with naming(clip):
            check_bones(one.motion)
    _write(target, shown, poses, every, width)
    if target.suffix.lower() == ".html" and opens and not as_json:
        open_in_browser(target.resolve().as_uri())
    facts = [
        {"file": str(clip), "frames": len(s.motion), "seconds": s.motion.seconds, "fps": s.motion.fps}
        for clip, s in zip(clips, shown, strict=True)
    ]
    if as_json:
        print_json({"output": str(target), "clips": facts})
    else:
        say(f"{target}: {counted(len(clips), 'clip')}")


def _read(clip: Path) -> Motion:
    """The motion of a .glb file, or of a BVH file of any name."""
    if clip.suffix.lower() == ".glb":
        from motionkit.export.formats import read_motion

        return read_motion(clip)
    from motionkit.motion.bvh import bvh_to_motion, read_bvh

    return bvh_to_motion(read_bvh(clip))


def _names(clips: Sequence[Path]) -> list[str]:
    """The name of each clip, with its folder's name in front where two clips share one."""
    stems = [clip.stem for clip in clips]
    return [
        f"{clip.absolute().parent.name}/{clip.stem}" if stems.count(clip.stem) > 1 else clip.stem
        for clip in clips
    ]


def _check_options(context: click.Context, target: Path) -> None:
    """Raise UsageError for options that do not apply to this kind of file."""
    given = {
        name: context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        for name in ("poses", "every", "width", "path_file")
    }
    kind = target.suffix.lower()
    for name, kinds in (
        ("poses", (".png",)),
        ("every", (".png",)),
        ("width", (".png", ".gif", ".mp4")),
        ("path_file", (".html",)),
    ):
        if given[name] and kind not in kinds:
            option = {"path_file": "path"}.get(name, name)
            raise click.UsageError(f"--{option} applies to {', '.join(kinds)} files, found {target.name}")


def _write(target: Path, shown: Sequence[Shown], poses: int, every: int | None, width: int | None) -> None:
    kind = target.suffix.lower()
    if kind == ".html":
        from motionkit.view.viewer import write_viewer

        write_viewer(target, shown)
    elif kind == ".png":
        from motionkit.view.contact_sheet import write_contact_sheet

        write_contact_sheet(target, [(s.name, s.motion) for s in shown], poses, width or 1800, every)
    else:
        from motionkit.view.film import write_film

        with progress_bar() as bar:
            task = bar.add_task("drawing", total=None)
            write_film(
                target, shown, width, lambda done, count: bar.update(task, completed=done, total=count)
            )
