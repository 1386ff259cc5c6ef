"""`motionkit fix`: repairs a clip and prints measurements before and after."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    PLACE,
    animation_option,
    clip_options,
    gathered,
    json_option,
    option,
    switch,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.folders import folders
from motionkit.cli.outputs import OutputOptions, animation_options, clip_output_option, display_name
from motionkit.errors import MotionkitError, naming
from motionkit.names import counted

if TYPE_CHECKING:
    from rich.table import Table

    from motionkit.editing.fix import Fixed


@click.command("fix")
@click.argument("clip", type=PLACE)
@clip_output_option("fixed")
@switch("--glitches/--no-glitches", "Bridge joints that jump away and back, and limbs that flip.")
@switch("--trembling/--no-trembling", "Filter out marker jitter.")
@switch("--floor/--no-floor", "Set the floor to height zero.")
@switch("--sliding/--no-sliding", "Lock feet while they touch the floor.")
@click.option(
    "--root-from-feet",
    is_flag=True,
    help="Compute the root's path from the planted feet, for captures whose root is pinned or drifts (video, Kinect).",
)
@animation_option
@animation_options
@clip_options
@option(
    "--strength",
    default=1.0,
    type=FiniteRange(0.2, 10),
    help="Width of the jitter filter: 1 is 0.15 s.",
)
@click.option("--view", is_flag=True, help="Also write a web page that plays both motions, and open it.")
@json_option
@folders("clip", "output")
@gathered("output_options", OutputOptions)
def command(clip: Path, output_options: OutputOptions, **repairs: Any) -> None:
    """Repair CLIP, a motion of any rig; joints, bone lengths, unit and frames stay.

    The command prints measures before and after. It undoes a step that makes them worse, and says so.
    Floor and feet of rigs that are not human stay as they are.
    """
    from motionkit.editing.fix import Repairs, fix_motion
    from motionkit.export.formats import read_clip
    from motionkit.view.figure_data import MotionView

    output_options.check()
    outputs = output_options.files(f"{clip.stem}-fixed", [clip])
    source = read_clip(clip)
    with naming(clip, MotionkitError):
        fixed = fix_motion(source.motion, Repairs(**repairs))
    with naming(clip):
        outputs.write(source.with_motion(fixed.motion))
    both = (("before", source.motion), ("after", fixed.motion))
    outputs.show(
        lambda: [MotionView(f"{clip.stem} {word}", m, character=source.character) for word, m in both]
    )
    rows = [asdict(row) for row in fixed.table]
    facts = {"output": outputs.file, "table": rows, "glitches": fixed.glitches, "notes": fixed.notes}
    wrote = f"wrote {display_name(outputs.file)}: {counted(len(source.motion), 'frame')} at {source.motion.fps:g} fps"
    lines = [wrote, _table(fixed), *(f"  {note}" for note in fixed.notes)]
    outputs.report(facts, lines, (clip, source.in_file()))


def _table(fixed: Fixed) -> Table:
    from motionkit.cli.console import make_table

    def cell(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    rows = [(row.name, cell(row.before), cell(row.after), row.unit) for row in fixed.table]
    return make_table(("", "before", "after", ""), rows, (0, 3), padding=(0, 2), pad_edge=True)
