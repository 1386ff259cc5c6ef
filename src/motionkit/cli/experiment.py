"""`motionkit experiment`: the paper's experiments, their tables, figures and user study."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from motionkit.cli.common import (
    STOPPED,
    counted,
    json_option,
    model_option,
    print_json,
    progress_bar,
    remark,
    seed_option,
    stdout_console,
)
from motionkit.errors import MotionkitError
from motionkit.training.budgets import BUDGETS

if TYPE_CHECKING:
    from motionkit.experiments.runs import Plan
    from motionkit.experiments.variants import Variant

RESULTS = Path("experiments/results")
SCENES = Path("experiments/scenes")
LONG = Path("experiments/long")
BODIES = Path("experiments/bodies")
# Columns of their tables that a narrow terminal can do without, the first first.
LONG_SPARE, BODIES_SPARE = (8, 1, 7, 5, 3), (6, 5, 4, 3)
SETS = ["D_L", "all", "no-dances", "locomotion"]


def _data_option(function: Callable) -> Callable:
    return click.option(
        "--data",
        default="datasets/paper",
        show_default=True,
        type=click.Path(path_type=Path, file_okay=False),
        help="Dataset folder, made by preprocess --layout expmap-root-1 --own-bodies --raw.",
    )(function)


_set_option = click.option(
    "--set",
    "selection",
    default="D_L",
    show_default=True,
    type=click.Choice(SETS),
    help="Data set (motionkit/experiments/datasets.py).",
)


def _plan_options(function: Callable) -> Callable:
    """The options that say which data set, how much training, and where results go."""
    options: list[Callable] = [
        _data_option,
        _set_option,
        click.option(
            "--budget",
            default="cpu",
            show_default=True,
            type=click.Choice(tuple(BUDGETS)),
            help="Training of every network: steps, batch, window and rate for a CPU, for a GPU, or the paper's own.",
        ),
        click.option("--steps", type=click.IntRange(min=1), help="Training steps; the budget's by default."),
        click.option(
            "--frames",
            default=240,
            show_default=True,
            type=click.IntRange(30, 10_000),
            help="Largest number of frames to make of a test sequence.",
        ),
        _results_option,
    ]
    for option in reversed(options):
        function = option(function)
    return function


def _output_option(default: str, folder: bool) -> Callable:
    """-o: the folder, or else the page, to write."""
    return click.option(
        "-o",
        "--output",
        default=default,
        show_default=True,
        type=click.Path(path_type=Path, file_okay=not folder, dir_okay=folder),
        help="Folder to write to." if folder else "Page to write.",
    )


def _results_option(function: Callable) -> Callable:
    option: Callable = click.option(
        "--results",
        default=str(RESULTS),
        show_default=True,
        type=click.Path(path_type=Path, file_okay=False),
        help="Folder of results; checkpoints go beside it.",
    )
    return option(function)


def _print_fitting(header: Sequence[str], rows: Sequence[Sequence[str]], spare: Sequence[int]) -> None:
    """Print a table without breaking a word or a figure; what does not fit the terminal is left out.

    Args:
        spare: columns to leave out where there is no room, the first first.
    """
    from rich.cells import cell_len
    from rich.table import Table

    console, kept = stdout_console(), list(range(len(header)))
    texts = [[name, *(row[i] for row in rows)] for i, name in enumerate(header)]
    least = [max(cell_len(word) for text in column for word in text.split()) for column in texts]
    room = console.width - 2 * len(header)  # two spaces behind each column
    for number in spare:
        if sum(least[i] for i in kept) > room:
            kept.remove(number)
            room += 2
    widths = {i: least[i] for i in kept}
    whole = {i: max(map(cell_len, texts[i])) for i in kept}
    for _ in range(room - sum(widths.values())):  # one more for the column that lacks most
        narrowest = max(kept, key=lambda i: whole[i] - widths[i])
        widths[narrowest] += whole[narrowest] > widths[narrowest]
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for i in kept:
        table.add_column(header[i], width=widths[i], justify="right" if i else "left", vertical="bottom")
    for row in rows:
        table.add_row(*(row[i] for i in kept))
    console.print(table)
    if len(kept) < len(header):
        left_out = ", ".join(name for i, name in enumerate(header) if i not in kept)
        remark(f"left out in a terminal of {console.width} columns: {left_out}")


def _needs_torch() -> None:
    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise MotionkitError("experiments need torch: pip install 'motionkit[train]'")


@click.group("experiment")
def command() -> None:
    """The paper's experiments: train every variant alike, test it, and write the paper's tables.

    Names are those of the paper's tables (TPTN, EBTN, w/o-FFL ...); groups are tptn, parts, fusion, memory, losses,
    baselines and floors; all is everything.
    """


@command.command("list")
@_plan_options
@json_option
def list_command(
    data: Path,
    selection: str,
    budget: str,
    steps: int | None,
    frames: int,
    results: Path,
    as_json: bool,
) -> None:
    """List what can be run: group, parameters in millions beside the paper's, and finished runs."""
    _needs_torch()
    from motionkit.experiments.datasets import select
    from motionkit.experiments.model_results import made_from
    from motionkit.experiments.runs import Plan
    from motionkit.experiments.variants import VARIANTS, parameters

    plan = Plan(data, selection, budget, steps, results, results.parent / "checkpoints", frames)
    asked = click.get_current_context().get_parameter_source("data") is not ParameterSource.DEFAULT
    made_of = made_from(select(data, selection)) if asked or data.exists() else None
    minutes, faults = _usual_minutes(plan), list[str]()
    rows = [
        {
            "name": v.name,
            "group": v.group,
            "text": v.text,
            "parameters": parameters(v),
            "paper_parameters": v.paper_parameters,
            "seeds": v.seeds,
            "done": sum(_counts(plan, v, seed, made_of, faults) for seed in range(v.seeds)),
            "minutes": minutes.get(v.name),
        }
        for v in VARIANTS
    ]
    if faults:
        others = f" (and {counted(len(faults) - 1, 'other')})" if faults[1:] else ""
        remark(f"not counted: {faults[0]}{others}")
    if as_json:
        print_json(rows)
        return
    from rich.table import Table
    from rich.text import Text

    table = Table(caption="M: millions of parameters, paper: the paper's; min: minutes that a run took here")
    for name in ("name", "M", "paper", "min", "done", "what it is"):
        right = name in ("M", "paper", "min")
        table.add_column(name, justify="right" if right else "left", no_wrap=name != "what it is")
    for number, (v, row) in enumerate(zip(VARIANTS, rows, strict=True)):
        if number == 0 or v.group != VARIANTS[number - 1].group:
            table.add_section()
            table.add_row(Text(v.group, style="bold"))
        count = f"{parameters(v) / 1e6:.2f}" if v.preset else ""
        paper = f"{v.paper_parameters:g}" if v.paper_parameters else ""
        spent = f"{minutes[v.name]:.0f}" if v.name in minutes else ""
        table.add_row(v.name, count, paper, spent, f"{row['done']} of {v.seeds}", v.text)
    stdout_console().print(table)


def _counts(plan: Plan, each: Variant, seed: int, made: dict[str, str] | None, faults: list[str]) -> bool:
    """Whether a run has a result that `experiment run` takes as done; why one does not count is added to faults."""
    from motionkit.experiments.runs import is_done

    try:
        return is_done(plan, each, seed, made)
    except MotionkitError as error:
        faults.append(str(error))
        return False


def _usual_minutes(plan: Plan) -> dict[str, float]:
    """Minutes that runs of this folder took here; files that are no results are left out."""
    from motionkit.experiments.runs import read_result

    minutes = {}
    for path in (plan.results / plan.folder).glob("*.json"):
        with suppress(MotionkitError):
            result = read_result(path)
            if "timing" in result:
                minutes[result["name"]] = result["timing"]["seconds"] / 60
    return minutes


@command.command("run")
@click.argument("names", nargs=-1, required=True)
@_plan_options
@click.option(
    "--seeds",
    default=1,
    show_default=True,
    type=click.IntRange(1, 100),
    help="Seeds of each network, up to the number that its table needs.",
)
@click.option("--every-seed", is_flag=True, help="Give every variant all of --seeds.")
@click.option(
    "--jobs",
    default=1,
    show_default=True,
    type=click.IntRange(1, 64),
    help="Runs at a time, each on one thread.",
)
@click.option(
    "--device", default="auto", show_default=True, help="Device to train on: auto, cpu, cuda, cuda:1 ..."
)
def run_command(
    names: tuple[str, ...],
    data: Path,
    selection: str,
    budget: str,
    steps: int | None,
    frames: int,
    results: Path,
    seeds: int,
    every_seed: bool,
    jobs: int,
    device: str,
) -> None:
    """Run NAMES: experiments, groups or all. Finished runs are skipped, stopped runs continue.

    Each run trains on the data set, rolls out its test sequences, and writes one JSON file to the folder of results.
    The first seed of everything comes first.
    """
    _needs_torch()
    from motionkit.experiments.datasets import select
    from motionkit.experiments.model_results import made_from
    from motionkit.experiments.runs import Plan, check_writable, is_done, run_all
    from motionkit.experiments.variants import chosen

    variants = [each for each in chosen(names) if each.runs_at(budget)]
    plan = Plan(data, selection, budget, steps, results, results.parent / "checkpoints", frames, device)
    tasks = [
        (variant, seed) for seed in range(seeds) for variant in variants
        if seed < (variant.seeds if variant.preset and not every_seed else seeds if variant.preset else 1)
    ]  # fmt: skip
    made_of = made_from(select(data, selection))
    left = [(v, seed) for v, seed in tasks if not is_done(plan, v, seed, made_of)]
    if left:
        check_writable(plan)
    remark(f"{counted(len(tasks), 'run')}, {len(tasks) - len(left)} of them done")
    with progress_bar() as bar:
        task = bar.add_task("running", total=100)
        try:
            # Closed at once on Ctrl-C, so that runs in processes of their own have stopped before the last line.
            with closing(
                run_all(plan, left, jobs, remark, lambda share: bar.update(task, completed=100 * share))
            ) as made:
                for count, path in enumerate(made, 1):
                    remark(f"{count} of {len(left)}: wrote {path}")
        except KeyboardInterrupt:
            remark("stopped; the same command continues")
            sys.exit(STOPPED)


@command.command("shipped")
@_data_option
@_set_option
@click.option(
    "--frames",
    default=240,
    show_default=True,
    type=click.IntRange(30, 10_000),
    help="Frames that are made of a test sequence at most; those of the runs to compare with.",
)
@click.option("--seeds", default=3, show_default=True, type=click.IntRange(1, 100), help="Runs.")
@_results_option
def shipped_command(data: Path, selection: str, frames: int, seeds: int, results: Path) -> None:
    """Measure the bundled model as shipped on the test sequences, for the second table.

    Reference poses, sampling presets, corrections and foot locks are on; it is measured with --reference none too.
    Test sequences that are mirror images of training clips are left out, since the model has seen them. Results of
    before are written over, also those of another number of --frames.
    """
    from motionkit.experiments.datasets import select
    from motionkit.experiments.shipped import run_shipped
    from motionkit.models.bundled import BUNDLED, open_model

    dataset = select(data, selection)
    models = {
        name: open_model(BUNDLED, reference)
        for name, reference in (("shipped", "auto"), ("shipped without references", "none"))
    }
    with progress_bar() as bar:
        task = bar.add_task("measuring", total=100)
        files = run_shipped(
            models,
            dataset,
            selection,
            seeds,
            frames,
            results,
            lambda share: bar.update(task, completed=100 * share),
        )
    for file in files:
        stdout_console().print(f"wrote {file}")


@command.command("tables")
@_results_option
@click.option("--set", "selection", type=click.Choice(SETS), help="Only this data set; all by default.")
@_output_option("docs/experiments.md", folder=False)
@click.option(
    "--latex", type=click.Path(path_type=Path, dir_okay=False), help="Also write all tables in LaTeX."
)
def tables_command(results: Path, selection: str | None, output: Path, latex: Path | None) -> None:
    """Write all tables from the results, the paper's figures beside ours. Nothing is trained."""
    _needs_torch()
    from motionkit.experiments.model_results import read_bodies, read_long, read_scenes
    from motionkit.experiments.page import Extras, write_page

    scenes, long = read_scenes(results.parent / SCENES.name), read_long(results.parent / LONG.name)
    bodies = read_bodies(results.parent / BODIES.name)
    found = [each for each in _read(results) if selection in (None, each["data"])]
    if not found:
        raise MotionkitError(f"{results}: no results of the data set {selection} yet")
    write_page(found, output, latex, Extras(tuple(scenes), tuple(long), tuple(bodies)))
    stdout_console().print(f"wrote {output}" + (f" and {latex}" if latex else ""))


@command.command("figures")
@_results_option
@_output_option("experiments/figures", folder=True)
def figures_command(results: Path, output: Path) -> None:
    """Draw PNGs from the results: training curves, BM against AFS, and inference speed against parts."""
    _needs_torch()
    from motionkit.experiments.figures import write_figures

    for path in write_figures(_read(results), output):
        stdout_console().print(f"wrote {path}")


@command.command("scenes")
@click.argument("names", nargs=-1)
@model_option
@click.option(
    "--seeds", default=3, show_default=True, type=click.IntRange(1, 100), help="Motions of each scene."
)
@_output_option(str(SCENES), folder=True)
@json_option
def scenes_command(
    names: tuple[str, ...], model_path: Path | None, seeds: int, output: Path, as_json: bool
) -> None:
    """Make what the paper's figures 1 and 5 to 9 show: NAMES of scenes or figure numbers, all by default.

    Each scene becomes a BVH file and a picture, both of the first seed. On paths the distance of the root's track is
    printed beside the paper's. Without NAMES, when all scenes are made, distances are also written to a file named
    after the model, from which `experiment tables` takes them. Feet are not held (--no-ik), as in the paper's figures.
    """
    from motionkit.experiments.scenes import chosen_scenes, make_scene, scene_facts
    from motionkit.files import atomic_write
    from motionkit.models.bundled import open_model
    from motionkit.motion.bvh import write_bvh
    from motionkit.view.strobe import write_strobe

    scenes = chosen_scenes(names)
    model = open_model(model_path, "auto")
    name = "shipped" if model_path is None else model_path.stem
    folder = output / name
    facts = []
    with progress_bar() as bar:
        for scene in bar.track(scenes, description="making"):
            made = [make_scene(model, scene, seed) for seed in range(seeds)]
            stem = folder / f"{scene.figure}-{scene.name}"
            write_bvh(stem.with_suffix(".bvh"), made[0].shown.motion)
            write_strobe(stem.with_suffix(".png"), made[0].shown)
            facts.append(scene_facts(made))
    if not names:
        with atomic_write(output / f"{name}.json", "w") as out:
            result = {"model": name, "steps": model.card.get("steps"), "scenes": facts}
            out.write(json.dumps(result, indent=1) + "\n")
    if as_json:
        print_json({"folder": str(folder), "scenes": facts})
        return
    from rich.table import Table

    table = Table()
    for heading in ("figure", "what it shows", "cm/frame", "paper", "end reached"):
        table.add_column(heading, justify="left" if heading == "what it shows" else "right")
    for row in facts:
        distances = row["distances"]
        mean = f"{sum(distances) / len(distances):.3f}" if distances else ""
        paper = "" if row["paper"] is None else f"{row['paper']:g}"
        table.add_row(
            row["figure"], row["text"], mean, paper, f"{row['finished']} of {seeds}" if distances else ""
        )
    stdout_console().print(table)
    stdout_console().print(f"wrote {counted(len(facts), 'scene')} to {folder}")


@command.command("long")
@click.argument("model_path", metavar="MODEL", type=click.Path(exists=True, path_type=Path, dir_okay=False))
@_data_option
@click.option(
    "--type",
    "asked",
    multiple=True,
    help="Motion type, may be repeated. By default walking, running and a dance.",
)
@click.option(
    "--seconds", default=20.0, show_default=True, type=click.FloatRange(1, 600), help="Length of a roll-out."
)
@click.option(
    "--seeds", default=1, show_default=True, type=click.IntRange(1, 100), help="Roll-outs of each type."
)
@_output_option(str(LONG), folder=True)
def long_command(
    model_path: Path, data: Path, asked: tuple[str, ...], seconds: float, seeds: int, output: Path
) -> None:
    """Roll out motion types for a long time from 30 initial frames, with a MODEL of tptn-paper.

    The first frames are those of test clips; the types are given and the trajectory is the network's own. Each part of
    a roll-out is compared with the recordings. Writes BVH files, a contact sheet, and a results file for `experiment
    tables`.
    """
    _needs_torch()
    from motionkit.data.dataset import Dataset
    from motionkit.experiments.long_rollouts import (
        LONG_HEADER,
        check_layout,
        long_rollout,
        long_row,
        long_types,
        types_known,
    )
    from motionkit.files import atomic_write
    from motionkit.models.checkpoint import load_model
    from motionkit.motion.bvh import write_bvh
    from motionkit.view.contact_sheet import write_contact_sheet

    model, dataset = load_model(model_path), Dataset(data)
    check_layout(dataset, model)
    name, usual = model_path.stem, long_types(dataset, asked)
    kinds = types_known(model, usual, bool(asked))
    for kind in usual:
        if kind not in kinds:
            remark(f"{name} does not know {kind}, which is left out")
    tasks = [(kind, seed) for seed in range(seeds) for kind in kinds]
    made = []
    with progress_bar() as bar:
        task = bar.add_task("rolling out", total=len(tasks))
        for number, (kind, seed) in enumerate(tasks):

            def progress(share: float, done: int = number) -> None:
                bar.update(task, completed=done + share)

            made.append(long_rollout(model, dataset, kind, seconds, seed, progress))
    for each in made[: len(kinds)]:
        write_bvh(output / name / f"{each.type}.bvh", each.motion)
    sheet = output / name / "sheet.png"
    write_contact_sheet(sheet, [(each.type, each.motion) for each in made[: len(kinds)]], 20)
    facts = {"model": name, "steps": model.card.get("steps"), "rollouts": [each.facts for each in made]}
    with atomic_write(output / f"{name}.json", "w") as out:
        out.write(json.dumps(facts, indent=1) + "\n")
    _print_fitting(LONG_HEADER, [long_row(each.facts) for each in made], LONG_SPARE)
    stdout_console().print(f"wrote {sheet}")


@command.command("bodies")
@click.argument("model_path", metavar="MODEL", type=click.Path(exists=True, path_type=Path, dir_okay=False))
@_data_option
@click.option("--type", "kind", default="walking", show_default=True, help="Motion type.")
@click.option(
    "--seeds", default=3, show_default=True, type=click.IntRange(1, 100), help="Roll-outs of each performer."
)
@_output_option(str(BODIES), folder=True)
def bodies_command(model_path: Path, data: Path, kind: str, seeds: int, output: Path) -> None:
    """Show the skeleton control signal of a MODEL with five performers, from short to long legs.

    One recording is rolled out with the body of each in the network's input and all else alike. Limbs, height of the
    hips and steps that come out are written beside those of the performer's own recordings, for `experiment tables`.
    """
    _needs_torch()
    from motionkit.data.dataset import Dataset
    from motionkit.experiments.bodies import BODIES_HEADER, bodies_row, show_bodies
    from motionkit.files import atomic_write
    from motionkit.models.checkpoint import load_model

    model, dataset = load_model(model_path), Dataset(data)
    with progress_bar() as bar:
        task = bar.add_task("rolling out", total=100)
        shown = show_bodies(
            model, dataset, kind, seeds, lambda share: bar.update(task, completed=100 * share)
        )
    facts = {
        "model": model_path.stem,
        "steps": model.card.get("steps"),
        "type": kind,
        "seeds": seeds,
        "performers": shown,
    }
    file = output / f"{model_path.stem}.json"
    with atomic_write(file, "w") as out:
        out.write(json.dumps(facts, indent=1) + "\n")
    _print_fitting(BODIES_HEADER, [bodies_row(each) for each in shown], BODIES_SPARE)
    stdout_console().print(f"wrote {file}")


@command.command("study")
@click.argument("folder", type=click.Path(exists=True, path_type=Path, file_okay=False))
@_output_option("study.html", folder=False)
@seed_option()
def study_command(folder: Path, output: Path, seed: int) -> None:
    """Write the page of a user study (paper section 5.4): one HTML file that raters open.

    FOLDER has one folder for each group of motions: recording.bvh, and one BVH file per model, named after it. The
    page shows the models without their names and in random order beside the recording, asks for a rank in five aspects
    and for a score from 1 to 5, and saves the answers as answers-NAME.json, NAME being the rater's.
    """
    from motionkit.experiments.study import write_study

    groups = write_study(folder, output, seed)
    stdout_console().print(f"wrote {output}: {counted(groups, 'group')} of motions")


@command.command("ttest")
@click.argument(
    "answers", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path, dir_okay=False)
)
@click.option("--model", default="TPTN", show_default=True, help="Model that is compared with all others.")
@json_option
def ttest_command(answers: tuple[Path, ...], model: str, as_json: bool) -> None:
    """Print the paper's tables 4 and 5 from ANSWERS of a study, one file for each rater.

    A sample is the mean score of a group of motions over all raters. n is the number of samples of each model; with
    them stand mean, standard deviation, t, degrees of freedom and one-sided p.
    """
    from motionkit.experiments.ttest import NothingToTest, compare, read_answers, scores, unequal_samples

    read = read_answers(answers)
    found = scores(read)
    if model not in found:
        raise MotionkitError(f"no answers about {model!r}, expected one of {', '.join(sorted(found))}")
    if len(found) == 1:
        raise MotionkitError(f"no answers about models other than {model}: nothing to compare it with")
    rows = []
    for name, rival in sorted(found.items()):
        try:
            rows += [compare(found[model], rival)] if name != model else []
        except NothingToTest as error:
            remark(f"{name} is left out: {error}")
    if len(read) == 1:
        remark("one rater alone: the figures are that person's taste")
    if differing := unequal_samples(read):
        remark(differing)
    if not rows:
        raise MotionkitError(f"no model is left to compare {model} with")
    if as_json:
        facts = [
            {
                "model": r.rival.name,
                "n": len(r.rival.values),
                "mean": r.rival.mean,
                "std": r.rival.deviation,
                "t": r.t,
                "freedom": r.freedom,
                "p": r.p,
            }
            for r in rows
        ]
        mine = found[model]
        print_json(
            {
                "model": model,
                "n": len(mine.values),
                "mean": mine.mean,
                "std": mine.deviation,
                "raters": len(answers),
                "against": facts,
            }
        )
        return
    from rich.table import Table

    mine = found[model]
    table = Table(
        title=f"{model}: n {len(mine.values)}, mean {mine.mean:.3f}, std {mine.deviation:.3f}; "
        f"{counted(len(answers), 'rater')}"
    )
    for name in ("against", "n", "mean", "std", "t", "df", "p (one-sided)"):
        left = name == "against"
        table.add_column(name, justify="left" if left else "right", no_wrap=not left)
    for r in rows:
        figures = (
            f"{r.rival.mean:.3f}",
            f"{r.rival.deviation:.3f}",
            f"{r.t:.3f}",
            f"{r.freedom}",
            f"{r.p:.3e}",
        )
        table.add_row(r.rival.name, f"{len(r.rival.values)}", *figures)
    stdout_console().print(table)


def _read(results: Path) -> list[dict]:
    from motionkit.experiments.runs import read_results

    found = read_results(results) if results.exists() else []
    if not found:
        raise MotionkitError(f"{results}: no results yet; make some with motionkit experiment run")
    return found
