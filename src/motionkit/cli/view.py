"""`motionkit view`: shows BVH and GLB files as a web page, a contact sheet, a GIF or a video."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from motionkit.cli.common import (
    EXISTING_FILE,
    PLACE,
    Stages,
    animation_option,
    clip_options,
    gathered,
    json_option,
    option,
    print_json,
    remark,
    say,
)
from motionkit.cli.folders import folders
from motionkit.cli.outputs import body_option, default_output, describe_input, input_lines
from motionkit.cli.rig_options import RIG_FILE, RigChoice, open_rig
from motionkit.cli.showing import open_in_browser
from motionkit.errors import naming
from motionkit.names import counted, visible

if TYPE_CHECKING:
    from motionkit.export.clip import Clip
    from motionkit.rig.rig import Rig
    from motionkit.view.figure_data import MotionView

ENDINGS = (".html", ".png", ".gif", ".mp4")


def _ending(context: click.Context, parameter: click.Parameter, value: Path | None) -> Path | None:
    if value is not None and value.suffix.lower() not in ENDINGS:
        known = ", ".join(ENDINGS)
        raise click.BadParameter(f"expected a file name that ends in {known}, found {str(value)!r}")
    return value


@click.command("view")
@click.argument("clips", nargs=-1, required=True, type=PLACE)
@click.option(
    "-o",
    "--output",
    type=PLACE,
    help="File to write; its ending chooses the format: .html (default, a web page that plays the motions), .png "
    "(a contact sheet), .gif or .mp4. A folder if CLIPS is one.",
)
@click.option(
    "--rig",
    "rig_path",
    type=RIG_FILE,
    help="Show the clips on the rig of this file (.bvh, .glb, .vrm) or @NAME. A page shows the character of a .glb or "
    ".vrm with its meshes; pictures show its joints.",
)
@click.option(
    "--path",
    "path_file",
    type=EXISTING_FILE,
    help="Path file (JSON or CSV) to draw on the ground of the page.",
)
@click.option("--open/--no-open", "opens", default=True, help="Open the page in the browser; on by default.")
@option("--poses", type=click.IntRange(1, 480), default=12, help="Contact sheet: number of poses per clip.")
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
@body_option("pages, GIFs and videos")
@animation_option
@clip_options
@json_option
@folders(
    "clips",
    "output",
    tuple(ending[1:] for ending in ENDINGS),
    _ending,
    refuse=lambda place, _: _check_options(place),
)
@gathered("choice", open_rig)
def command(
    clips: tuple[Path, ...],
    output: Path | None,
    path_file: Path | None,
    opens: bool,
    body: str | None,
    as_json: bool,
    choice: RigChoice,
    **sizes: Any,
) -> None:
    """Show CLIPS (.bvh, .amc, .npz, .glb, .vrm, .fbx) of any rig, unit and frame rate.

    Without -o the command writes a web page, named after the first clip, to the current folder and opens it
    in the browser. The page is one self-contained HTML file, with the character of a GLB or VRM in it. A folder is
    shown clip by clip, in files of --format.
    """
    from motionkit.files import check_outputs
    from motionkit.view.write import write_views

    target = output or default_output(clips[0].stem, ".html")
    _check_options(target)
    check_outputs([target], [*clips, path_file, *choice.files])
    path = None
    if path_file is not None:
        from motionkit.control.path import read_path

        path = read_path(path_file).points
    read = [
        _read_view(clip, visible(name), choice.rig, body)
        for clip, name in zip(clips, _names(clips), strict=True)
    ]
    views = [replace(one, path=path) for one, _ in read]
    replaced = target.exists()
    with Stages() as show, choice.as_written():
        write_views(target, views, progress=lambda done, total: show("drawing", done, total), **sizes)
    if replaced:
        remark(f"replaced {target}")
    read_as = [words for _, words in read]
    if target.suffix.lower() == ".html" and opens and not as_json:
        open_in_browser(target.resolve().as_uri())
    if as_json:
        facts = [
            {
                "file": clip,
                "frames": len(one.motion),
                "seconds": one.motion.seconds,
                "fps": one.motion.fps,
                "taken": words,
            }
            for clip, one, words in zip(clips, views, read_as, strict=True)
        ]
        print_json({"output": target, "clips": facts})
    else:
        for line in (f"wrote {target}: {counted(len(clips), 'clip')}", *input_lines(clips, read_as)):
            say(line)


def _view(name: str, clip: Clip) -> MotionView:
    """A clip to show, on the character into whose file it would be written, else on a body."""
    from motionkit.view.figure_data import MotionView

    return MotionView(name, clip.motion, character=clip.host, body=clip.new_body)


def _read_view(path: Path, name: str, rig: Rig | None, body: str | None) -> tuple[MotionView, str]:
    """The motion of a file of any kind, on the rig if there is one; and how the file was read.

    body is one of BODIES, also in place of a body that motionkit made; None for that, or the first.
    """
    from motionkit.export.clip import Clip
    from motionkit.export.formats import read_clip
    from motionkit.finish.on_rig import on_rig
    from motionkit.motion.bvh import bvh_to_motion
    from motionkit.rig.on_rig import canonical_for
    from motionkit.rig.read_file import read_file
    from motionkit.view.body import check_bones

    if rig is not None:
        bvh = read_file(path)
        with naming(path):
            made = on_rig(canonical_for(bvh, rig)[0], rig)
        return _view(name, Clip(made, character=rig.character, body=body)), describe_input(bvh_to_motion(bvh))
    clip = replace(read_clip(path), body=body)
    view = _view(name, clip)
    if view.skinned_character is None:
        with naming(path):
            check_bones(clip.motion)
    return view, describe_input(clip.in_file())


def _names(clips: Sequence[Path]) -> list[str]:
    """A title for each clip, prefixed with its folder's name if two clips share a name."""
    stems = [clip.stem for clip in clips]
    return [
        f"{clip.absolute().parent.name}/{clip.stem}" if stems.count(clip.stem) > 1 else clip.stem
        for clip in clips
    ]


def _check_options(target: Path) -> None:
    """Raise UsageError for options that do not apply to this kind of file."""
    context = click.get_current_context()
    kind = target.suffix.lower()
    for flag, name, kinds in (
        ("poses", "poses", (".png",)),
        ("every", "every", (".png",)),
        ("width", "width", (".png", ".gif", ".mp4")),
        ("path", "path_file", (".html",)),
        ("body", "body", (".html", ".gif", ".mp4")),
    ):
        typed = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if typed and kind not in kinds:
            raise click.UsageError(f"--{flag} applies to {', '.join(kinds)} files, found {target.name}")
