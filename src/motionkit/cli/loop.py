"""`motionkit loop`: cuts the best cycle out of a clip and closes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from motionkit.cli.common import PLACE, animation_option, clip_options, gathered, json_option, remark
from motionkit.cli.finite import FiniteRange
from motionkit.cli.folders import folders
from motionkit.cli.outputs import (
    OutputOptions,
    animation_options,
    clip_output_option,
    display_name,
    view_option,
)
from motionkit.cli.rig_options import RootMotion, root_options
from motionkit.errors import MotionkitError, naming


@click.command("loop")
@click.argument("clip", type=PLACE)
@clip_output_option("loop")
@click.option(
    "--seconds",
    type=FiniteRange(0.1, 3600),
    help="Length in seconds; takes the cycle nearest to it. By default the shortest good cycle.",
)
@click.option(
    "--at-origin",
    is_flag=True,
    help="Begin at the origin and face +Z; by default the cycle keeps the place and the heading of CLIP.",
)
@clip_options
@root_options
@animation_option
@animation_options
@view_option
@json_option
@folders("clip", "output")
@gathered("root_motion", RootMotion)
@gathered("output_options", OutputOptions)
def command(
    clip: Path, seconds: float | None, at_origin: bool, root_motion: RootMotion, output_options: OutputOptions
) -> None:
    """Cut the best cycle out of CLIP, a motion of any rig, and close it: its last frame meets its first.

    A cycle begins and ends at frames with similar poses, velocities and contacts; the rest of the difference is spread
    over it. The command prints the differences at the seam, beside those of consecutive frames of the cycle.
    """
    from motionkit.editing.loop import make_loop
    from motionkit.export.formats import read_clip
    from motionkit.view.figure_data import MotionView

    output_options.check()
    outputs = output_options.files(f"{clip.stem}-loop", [clip])
    source = read_clip(clip)
    with naming(clip, MotionkitError):
        loop = make_loop(source.motion, seconds, from_origin=at_origin)
    with naming(clip):
        made = root_motion.applied(loop.motion, cyclic=True)
        types = source.cut_types(loop.start / source.motion.fps, loop.end / source.motion.fps)
        outputs.write(replace(source.with_motion(made), types=types * loop.times))
    outputs.show(lambda: [MotionView(outputs.file.stem, made, character=source.character)])
    if note := loop.note(seconds):
        remark(note)
    cut = {"start": loop.start, "end": loop.end, "seconds": loop.seconds, "difference_cm": loop.difference}
    cut |= {"times": loop.times}
    lines = [f"wrote {display_name(outputs.file)}: {loop.sentence(clip.name)}", f"  {loop.seam.sentence()}"]
    outputs.report({"output": outputs.file, **cut, **loop.seam.as_dict()}, lines, (clip, source.in_file()))
