"""`motionkit fix`: a repaired clip, and what was measured before and after."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import default_output, json_option, print_json, say, stdout_console
from motionkit.cli.motion_options import clip_output_option, naming
from motionkit.cli.showing import write_and_open


@click.command("fix")
@click.argument("clip", type=click.Path(path_type=Path))
@clip_output_option("fixed")
@click.option(
    "--glitches/--no-glitches",
    default=True,
    show_default=True,
    help="Bridge joints that jump away and back, and limbs that flip.",
)
@click.option(
    "--trembling/--no-trembling", default=True, show_default=True, help="Filter the trembling of markers."
)
@click.option("--floor/--no-floor", default=True, show_default=True, help="Set the floor to height zero.")
@click.option(
    "--sliding/--no-sliding",
    default=True,
    show_default=True,
    help="Hold feet still while they touch the floor.",
)
@click.option("--view", is_flag=True, help="Also write a web page that plays both motions, and open it.")
@json_option
def command(
    clip: Path,
    output: Path | None,
    glitches: bool,
    trembling: bool,
    floor: bool,
    sliding: bool,
    view: bool,
    as_json: bool,
) -> None:
    """Repair CLIP, a motion of any rig; joints, bone lengths, unit and frames stay.

    The command prints what it measured before and after. Rigs that are not human keep their floor and feet.
    """
    from motionkit.editing.fix import Repairs, fix_motion
    from motionkit.errors import MotionkitError
    from motionkit.export.formats import read_clip, write_motion
    from motionkit.files import check_outputs

    target = output or default_output(f"{clip.stem}-fixed")
    page_file = target.with_suffix(".html")
    check_outputs([target, page_file] if view else [target], [clip])
    source = read_clip(clip)
    try:
        fixed = fix_motion(source.motion, Repairs(glitches, trembling, floor, sliding))
    except MotionkitError as error:
        raise MotionkitError(f"{clip}: {error}") from None
    with naming(clip):
        write_motion(target, source.with_motion(fixed.motion))
    page = None
    if view:
        from motionkit.view.figure_data import Shown

        shown = [Shown(f"{clip.stem} before", source.motion), Shown(f"{clip.stem} after", fixed.motion)]
        page = write_and_open(page_file, shown, as_json)
    if as_json:
        rows = [
            {"name": row.name, "before": row.before, "after": row.after, "unit": row.unit}
            for row in fixed.table
        ]
        facts = {"glitches": [[frame, joint] for frame, joint in fixed.glitches], "notes": list(fixed.notes)}
        print_json({"output": str(target), "table": rows, **facts, **({"view": str(page)} if page else {})})
        return
    say(f"wrote {target}: {len(source.motion)} frames at {source.motion.fps:g} fps")
    _print_table([(row.name, row.before, row.after, row.unit) for row in fixed.table])
    for note in fixed.notes:
        say(f"  {note}")
    if page:
        say(f"wrote {page}")


def _print_table(rows: list[tuple[str, float | None, float | None, str]]) -> None:
    from rich.table import Table

    table = Table(box=None, padding=(0, 2))
    for title in ("", "before", "after", ""):
        table.add_column(title, justify="left" if not title else "right")
    for name, before, after, unit in rows:
        table.add_row(name, *("-" if value is None else f"{value:.3g}" for value in (before, after)), unit)
    stdout_console().print(table)
