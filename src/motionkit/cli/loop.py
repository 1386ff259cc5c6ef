"""`motionkit loop`: the best cycle of a clip, closed."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import default_output, json_option, print_json, remark, say
from motionkit.cli.finite import FiniteRange
from motionkit.cli.motion_options import (
    RootMotion,
    clip_output_option,
    length_note,
    naming,
    root_options,
    seam_json,
    seam_words,
)
from motionkit.cli.showing import view_option, write_and_open


@click.command("loop")
@click.argument("clip", type=click.Path(path_type=Path))
@clip_output_option("loop")
@click.option(
    "--seconds",
    type=FiniteRange(0.1, 3600),
    help="Length in seconds; the cycle of the nearest length is taken. By default the shortest good cycle.",
)
@click.option(
    "--at-origin",
    is_flag=True,
    help="Begin at the origin and face +Z; by default the cycle keeps the place and the heading of CLIP.",
)
@root_options
@view_option
@json_option
def command(
    clip: Path,
    output: Path | None,
    seconds: float | None,
    at_origin: bool,
    root_motion: RootMotion,
    view: bool,
    as_json: bool,
) -> None:
    """Cut the best cycle out of CLIP, a motion of any rig, and close it: its last frame meets its first.

    A cycle begins and ends at frames with similar poses, velocities and contacts; the rest of the difference is spread
    over it. The command prints the differences at the seam, beside those of consecutive frames of the cycle.
    """
    from motionkit.editing.loop import make_loop
    from motionkit.errors import MotionkitError
    from motionkit.export.formats import read_clip, write_motion
    from motionkit.files import check_outputs

    target = output or default_output(f"{clip.stem}-loop")
    page_file = target.with_suffix(".html")
    check_outputs([target, page_file] if view else [target], [clip])
    source = read_clip(clip)
    try:
        loop = make_loop(source.motion, seconds, from_origin=at_origin)
    except MotionkitError as error:
        raise MotionkitError(f"{clip}: {error}") from None
    made = root_motion.applied(loop.motion, cyclic=True)
    with naming(clip):
        write_motion(target, source.with_motion(made))
    page = None
    if view:
        from motionkit.view.figure_data import Shown

        page = write_and_open(page_file, [Shown(target.stem, made)], as_json)
    length = (len(made) - 1) / made.fps
    if note := length_note(length, seconds):
        remark(note)
    if as_json:
        cut = {"start": loop.start, "end": loop.end, "seconds": length, "difference_cm": loop.difference}
        print_json({"output": str(target), **cut, **seam_json(loop), **({"view": str(page)} if page else {})})
        return
    say(f"wrote {target}: frames {loop.start} to {loop.end} of {clip.name}, {length:.2f} s")
    say(f"  {seam_words(loop)}")
    if page:
        say(f"wrote {page}")
