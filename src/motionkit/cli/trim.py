"""`motionkit trim`: cuts a stretch out of a clip, and changes its rate or its speed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from motionkit.cli.common import PLACE, animation_option, clip_options, fps_option, gathered, json_option
from motionkit.cli.finite import FiniteRange
from motionkit.cli.folders import folders
from motionkit.cli.outputs import (
    OutputOptions,
    animation_options,
    clip_output_option,
    display_name,
    view_option,
)
from motionkit.cli.times import Moment, Time
from motionkit.errors import MotionkitError, naming


@click.command("trim")
@click.argument("clip", type=PLACE)
@clip_output_option("trimmed")
@click.option(
    "--from", "start", type=Time(), default="0", help="First frame to keep: seconds, or a frame such as 90f."
)
@click.option("--to", "end", type=Time(), help="End, exclusive: seconds or a frame; that of CLIP by default.")
@click.option("--moving", is_flag=True, help="Also cut off still frames at both ends.")
@click.option("--speed", type=FiniteRange(0.05, 20), help="Factor on the pace; the frame rate stays.")
@fps_option("Frame rate to write; that of CLIP by default.")
@animation_option
@animation_options
@clip_options
@view_option
@json_option
@folders("clip", "output")
@gathered("output_options", OutputOptions)
def command(
    clip: Path,
    start: Moment,
    end: Moment | None,
    moving: bool,
    speed: float | None,
    fps: float | None,
    output_options: OutputOptions,
) -> None:
    """Cut a stretch out of CLIP, a motion of any rig; joints, unit and axes stay."""
    from motionkit.editing.loop import at_rate
    from motionkit.editing.trim import moving_frames
    from motionkit.export.formats import read_clip
    from motionkit.view.figure_data import MotionView

    output_options.check()
    outputs = output_options.files(f"{clip.stem}-trimmed", [clip])
    source = read_clip(clip)
    motion = source.motion
    first, last = (
        len(motion) if at is None else round(at.seconds(motion.fps) * motion.fps) for at in (start, end)
    )
    if last <= first < len(motion):
        raise MotionkitError(f"{clip}: --to is frame {last}, expected one after --from, frame {first}")
    if first >= len(motion):
        raise MotionkitError(
            f"{clip}: --from is frame {first}, but the clip has {len(motion)}, {motion.seconds:.2f} s"
        )
    last = min(last, len(motion))
    if moving:
        with naming(clip, MotionkitError):
            begin, finish = moving_frames(motion.cut(first, last))
        first, last = first + begin, first + finish
    made = motion.cut(first, last)
    rate = fps or made.fps
    made = replace(at_rate(replace(made, fps=made.fps * (speed or 1.0)), rate), fps=rate)
    with naming(clip):
        types = source.cut_types(first / motion.fps, last / motion.fps, speed or 1.0)
        outputs.write(replace(source.with_motion(made), types=types))
    outputs.show(lambda: [MotionView(outputs.file.stem, made, character=source.character)])
    facts = {"output": outputs.file, "start": first, "end": last, "frames": len(made), "fps": made.fps}
    kept = f"frames {first} to {last - 1} of {clip.name}, {made.seconds:.2f} s at {made.fps:g} fps"
    outputs.report(facts, [f"wrote {display_name(outputs.file)}: {kept}"], (clip, source.in_file()))
