"""`motionkit view`: contact sheets of BVH files."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import json_option, print_json


def _png(context: click.Context, parameter: click.Parameter, value: Path) -> Path:
    if value.suffix.lower() != ".png":
        raise click.BadParameter(f"expected a file that ends with .png, found {str(value)!r}")
    return value


@click.command("view")
@click.argument("clips", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    callback=_png,
    help="The sheet, a .png file.",
)
@click.option(
    "--poses", type=click.IntRange(1, 480), default=12, show_default=True, help="Stick figures per clip."
)
@click.option("--every", type=click.IntRange(min=1), help="Show every so many frames instead.")
@click.option(
    "--width", type=click.IntRange(600, 8000), default=1800, show_default=True, help="Width in pixels."
)
@json_option
def command(
    clips: tuple[Path, ...], output: Path, poses: int, every: int | None, width: int, as_json: bool
) -> None:
    """Draw a contact sheet of BVH files (CLIPS): stick figures in time, the path from above, foot heights."""
    from motionkit.apps.contact_sheet import write_contact_sheet
    from motionkit.motion.bvh import bvh_to_motion, read_bvh

    motions = [(clip.stem, bvh_to_motion(read_bvh(clip))) for clip in clips]
    write_contact_sheet(output, motions, poses, width, every)
    shown = [
        {"file": str(clip), "frames": len(motion), "seconds": motion.seconds, "fps": motion.fps}
        for clip, (_, motion) in zip(clips, motions, strict=True)
    ]
    if as_json:
        print_json({"output": str(output), "clips": shown})
    else:
        click.echo(f"{output}: {len(clips)} {'clip' if len(clips) == 1 else 'clips'}")
