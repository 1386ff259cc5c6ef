"""`motionkit experiment in-between`: the in-betweening protocol of LaFAN1 on a copy of its files."""

from __future__ import annotations

from pathlib import Path

import click
from click.core import ParameterSource

from motionkit.cli.common import (
    EXISTING_FILE,
    EXISTING_FOLDER,
    Stages,
    json_option,
    option,
    print_json,
    say,
)


@click.command("in-between")
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--model", "model_path", type=EXISTING_FILE, help="Model file that fills the gaps as well.")
@click.option("--bundled", is_flag=True, help="Fill the gaps with the bundled model as well.")
@option("--type", "kind", default="walking", help="Motion type that the model is asked for.")
@option(
    "--windows",
    default=0,
    type=click.IntRange(min=0),
    help="Number of windows to test, evenly spread; 0 tests all.",
)
@json_option
def in_between_command(
    folder: Path, model_path: Path | None, bundled: bool, kind: str, windows: int, as_json: bool
) -> None:
    """Fill gaps of 5 to 45 frames in FOLDER, the BVH files of LaFAN1, and print L2P, L2Q and NPSS.

    The protocol is that of Harvey et al. 2020: windows of the fifth performer, 10 frames before each gap and one after
    it, positions divided by their deviations in the windows of the other performers. Zero velocity and interpolation
    stand beside the published figures. A model works on the 23 joints and at 60 fps: what mapping costs is a row.
    """
    if bundled and model_path is not None:
        raise click.UsageError("--model and --bundled both name the model; give one of them")
    asked = click.get_current_context().get_parameter_source("kind") is not ParameterSource.DEFAULT
    if asked and not bundled and model_path is None:
        raise click.UsageError("--type is for a model; give --model or --bundled")

    from motionkit.cli.common import stdout_console
    from motionkit.cli.console import make_table
    from motionkit.lab.in_betweening import PUBLISHED, in_between
    from motionkit.metrics.in_betweening import GAPS
    from motionkit.models.bundled import open_model

    model = open_model(model_path) if bundled or model_path is not None else None
    if model is not None:
        kind = model.type_names[model.type_id(kind)]
    rows, facts = [], []
    with Stages() as stages:
        show = stages.count("filling", len(GAPS) * (2 if model is None else 4))
        for gap, method, count, values in in_between(folder, model, kind, windows):
            known = PUBLISHED.get(method, {}).get(gap, (None,) * len(values))
            cells = [
                f"{value.value:.4f}" + ("" if paper is None else f" ({paper:g})")
                for value, paper in zip(values, known, strict=True)
            ]
            rows.append((str(gap), method, str(count), *cells))
            facts.append({"gap": gap, "way": method, "windows": count} | {v.id: v.value for v in values})
            show(len(rows))
    if as_json:
        print_json({"rows": facts})
        return
    stdout_console().print(make_table(("gap", "filled by", "windows", "L2P", "L2Q", "NPSS"), rows, (0, 1)))
    say("in brackets: Harvey et al. 2020")


COMMANDS = (in_between_command,)
