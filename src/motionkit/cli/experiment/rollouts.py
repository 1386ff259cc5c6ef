"""`motionkit experiment scenes`, `long` and `bodies`: roll-outs of one model for the paper's figures."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import (
    EXISTING_FILE,
    Stages,
    json_option,
    model_option,
    option,
    print_json,
    remark,
    stdout_console,
)
from motionkit.cli.experiment.options import (
    BODIES,
    LONG,
    SCENES,
    data_option,
    needs_torch,
    output_option,
    seeds_option,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.fitting_table import print_fitting
from motionkit.files import write_json
from motionkit.names import counted

# Columns to omit on a narrow terminal, in this order.
LONG_SPARE, BODIES_SPARE = (8, 1, 7, 5, 3), (6, 5, 4, 3)


@click.command("scenes")
@click.argument("names", nargs=-1)
@model_option
@seeds_option(3, "Motions of each scene.")
@output_option(str(SCENES), folder=True)
@json_option
def scenes_command(
    names: tuple[str, ...], model_path: Path | None, seeds: int, output: Path, as_json: bool
) -> None:
    """Make what the paper's figures 1 and 5 to 9 show: NAMES of scenes or figure numbers, all by default.

    Each scene becomes a BVH file and a picture, both of the first seed. On paths the distance of the root's track is
    printed beside the paper's. Without NAMES, when all scenes are made, distances are also written to a file named
    after the model, from which `experiment tables` takes them. Feet are not held (--no-ik), as in the paper's figures.
    """
    from motionkit.cli.console import make_table
    from motionkit.lab.paper.scenes import chosen_scenes, make_scene, scene_facts
    from motionkit.models.bundled import open_model
    from motionkit.motion.bvh import write_bvh
    from motionkit.view.strobe import write_strobe

    scenes = chosen_scenes(names)
    model = open_model(model_path, "auto")
    name = "shipped" if model_path is None else model_path.stem
    folder = output / name
    facts = []
    with Stages() as show:
        progress = show.count("making", len(scenes))
        for number, scene in enumerate(scenes):
            progress(number)
            made = [make_scene(model, scene, seed) for seed in range(seeds)]
            stem = folder / f"{scene.figure}-{scene.name}"
            write_bvh(stem.with_suffix(".bvh"), made[0].view.motion)
            write_strobe(stem.with_suffix(".png"), made[0].view)
            facts.append(scene_facts(made))
    if not names:
        write_json(
            output / f"{name}.json", {"model": name, "steps": model.card.get("steps"), "scenes": facts}
        )
    if as_json:
        print_json({"folder": str(folder), "scenes": facts})
        return
    rows = []
    for row in facts:
        distances = row["distances"]
        mean = f"{sum(distances) / len(distances):.3f}" if distances else ""
        paper = "" if row["paper"] is None else f"{row['paper']:g}"
        ends = f"{row['finished']} of {seeds}" if distances else ""
        rows.append((row["figure"], row["text"], mean, paper, ends))
    columns = ("figure", "what it shows", "cm/frame", "paper", "end reached")
    stdout_console().print(make_table(columns, rows, (1,), title=None))
    stdout_console().print(f"wrote {counted(len(facts), 'scene')} to {folder}")


@click.command("long")
@click.argument("model_path", metavar="MODEL", type=EXISTING_FILE)
@data_option
@click.option(
    "--type",
    "requested",
    multiple=True,
    help="Motion type, may be repeated. By default walking, running and a dance.",
)
@option("--seconds", default=20.0, type=FiniteRange(1, 600), help="Length of a roll-out.")
@seeds_option(1, "Roll-outs of each type.")
@output_option(str(LONG), folder=True)
def long_command(
    model_path: Path, data: Path, requested: tuple[str, ...], seconds: float, seeds: int, output: Path
) -> None:
    """Roll out motion types for a long time from 30 initial frames, with a MODEL of tptn-paper.

    The first frames are those of test clips; the types are given and the trajectory is the network's own. Each part of
    a roll-out is compared with the recordings. Writes BVH files, a contact sheet, and a results file for `experiment
    tables`.
    """
    needs_torch()
    from motionkit.data.dataset import Dataset
    from motionkit.lab.paper.long_rollouts import (
        LONG_HEADER,
        check_layout,
        long_rollout,
        long_row,
        long_types,
        types_known,
    )
    from motionkit.models.checkpoint import load_model
    from motionkit.motion.bvh import write_bvh
    from motionkit.view.contact_sheet import write_contact_sheet

    model, dataset = load_model(model_path), Dataset(data)
    check_layout(dataset, model)
    name, usual = model_path.stem, long_types(dataset, requested)
    kinds = types_known(model, usual, bool(requested))
    for kind in usual:
        if kind not in kinds:
            remark(f"{name} does not know {kind}, which is left out")
    tasks = [(kind, seed) for seed in range(seeds) for kind in kinds]
    made = []
    with Stages() as show:
        count = show.count("rolling out", len(tasks))
        for number, (kind, seed) in enumerate(tasks):

            def progress(share: float, done: int = number) -> None:
                count(done + share)

            made.append(long_rollout(model, dataset, kind, seconds, seed, progress))
    for each in made[: len(kinds)]:
        write_bvh(output / name / f"{each.type}.bvh", each.motion)
    sheet = output / name / "sheet.png"
    write_contact_sheet(sheet, [(each.type, each.motion) for each in made[: len(kinds)]], 20)
    facts = {"model": name, "steps": model.card.get("steps"), "rollouts": [each.facts for each in made]}
    write_json(output / f"{name}.json", facts)
    print_fitting(LONG_HEADER, [long_row(each.facts) for each in made], LONG_SPARE)
    stdout_console().print(f"wrote {sheet}")


@click.command("bodies")
@click.argument("model_path", metavar="MODEL", type=EXISTING_FILE)
@data_option
@option("--type", "kind", default="walking", help="Motion type.")
@seeds_option(3, "Roll-outs of each performer.")
@output_option(str(BODIES), folder=True)
def bodies_command(model_path: Path, data: Path, kind: str, seeds: int, output: Path) -> None:
    """Test how a MODEL responds to the skeleton control signal of five performers, from short to long legs.

    One recording is rolled out with the body of each in the network's input and all else alike. Limbs, height of the
    hips and steps that come out are written beside those of the performer's own recordings, for `experiment tables`.
    """
    needs_torch()
    from motionkit.data.dataset import Dataset
    from motionkit.lab.paper.bodies import BODIES_HEADER, bodies_row, show_bodies
    from motionkit.models.checkpoint import load_model

    model, dataset = load_model(model_path), Dataset(data)
    with Stages() as show:
        performers = show_bodies(model, dataset, kind, seeds, show.share("rolling out"))
    facts = {
        "model": model_path.stem,
        "steps": model.card.get("steps"),
        "type": kind,
        "seeds": seeds,
        "performers": performers,
    }
    file = output / f"{model_path.stem}.json"
    write_json(file, facts)
    print_fitting(BODIES_HEADER, [bodies_row(each) for each in performers], BODIES_SPARE)
    stdout_console().print(f"wrote {file}")


COMMANDS = (scenes_command, long_command, bodies_command)
