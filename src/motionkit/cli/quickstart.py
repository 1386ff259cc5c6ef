"""`motionkit quickstart`: trains a model on a folder of clips, shows its types and judges them."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING_FOLDER,
    FOLDER,
    STOPPED,
    Stages,
    gathered,
    json_option,
    option,
    print_json,
    remark,
    say,
    seed_option,
    switch,
)
from motionkit.cli.finite import FiniteRange
from motionkit.errors import OverwriteError
from motionkit.first_model import QuickstartOptions

if TYPE_CHECKING:
    from motionkit.first_model import QuickstartResult
    from motionkit.training.options import TrainOptions


@click.command("quickstart")
@click.argument("data", type=EXISTING_FOLDER)
@click.option(
    "-o",
    "--output",
    type=FOLDER,
    help="Output folder; by default DATA with -model added to its name.",
)
@click.option("--minutes", type=FiniteRange(min=0.01), help="Training time in minutes; 5 by default.")
@click.option(
    "--steps",
    type=click.IntRange(min=1),
    help="Number of training steps; with --minutes, whichever ends first.",
)
@click.option("--add", is_flag=True, help="Also keep the types of the bundled model.")
@switch(
    "--mirror/--no-mirror",
    "Also learn from the mirror image of each clip; --no-mirror keeps kicks of one leg to that leg.",
)
@click.option("--force", is_flag=True, help="Start again, and replace what is in the output folder.")
@click.option(
    "--resume",
    is_flag=True,
    help="Continue where an earlier quickstart stopped, with the dataset, checkpoint or model it has made.",
)
@option("--device", default="auto", help="Device to train on: auto, cpu, cuda ...")
@seed_option
@json_option
@gathered("options", QuickstartOptions)
def command(data: Path, output: Path | None, options: QuickstartOptions, as_json: bool) -> None:
    """Train a model on the clips in the folder DATA, and say whether each of its types works.

    Runs doctor, preprocess, train, synthesize, view and evaluate --quick in turn. The output folder then holds
    the dataset, model.safetensors, motions.html (a page that plays every type), motions.png (the same as a
    sheet, with Pillow) and verdict.md. Types are folder and file names, or those of a labels.csv. After
    Ctrl-C, the same command with --resume continues at any stage.
    """
    from motionkit import first_model
    from motionkit.cli.main import print_stopped
    from motionkit.cli.training_monitor import TrainingMonitor

    if options.force and options.resume:
        raise click.UsageError("--resume cannot be combined with --force")
    begun = first_model.begun(output or first_model.output_folder(data))
    again = partial(_again, data, output, options, as_json)
    if begun is not None and not (options.force or options.resume):
        raise OverwriteError(
            f"{begun}: exists; go on with: {again('--resume')}, or overwrite it with --force"
        )
    with Stages() as show:

        def tell(line: str) -> None:
            show.close()
            remark(line)

        def training(training_options: TrainOptions, samples: Path) -> TrainingMonitor:
            show.close()
            return TrainingMonitor(as_json, training_options, None, samples, losses=False)

        watcher = first_model.Watcher(tell, show, training)
        try:
            result = first_model.quickstart(data, output, options, watcher)
        except first_model.QuickstartStopped as stop:
            if not stop.reported:
                print_stopped()
            remark(f"go on with: {again('--resume' if stop.resumes else '--force')}")
            sys.exit(STOPPED)
    _tell(result, as_json)


def _again(data: Path, output: Path | None, options: QuickstartOptions, as_json: bool, flag: str) -> str:
    """The command that continues the run."""
    device = None if options.device == "auto" else options.device
    typed: dict[str, Any] = {"-o": output, "--minutes": options.minutes, "--steps": options.steps}
    typed |= {"--seed": options.seed or None, "--device": device}
    flags = {"--add": options.add, "--no-mirror": not options.mirror, "--json": as_json}
    words = ["motionkit", "quickstart", str(data)]
    words += [word for name, value in typed.items() if value is not None for word in (name, str(value))]
    return shlex.join([*words, *(name for name, chosen in flags.items() if chosen), flag])


def _tell(result: QuickstartResult, as_json: bool) -> None:
    """Print the verdicts, the files written, and what to try next."""
    from motionkit.first_model import VERDICT

    verdicts = result.verdicts
    if as_json:
        facts = [asdict(verdict) | {"works": verdict.works} for verdict in verdicts]
        print_json(
            {
                "model": result.model,
                "pictures": result.pictures,
                "training": result.training,
                "verdicts": facts,
            }
        )
        return
    for verdict in verdicts:
        say(verdict.sentence())
    say(result.training)
    good = sum(verdict.works for verdict in verdicts)
    made = ", ".join(path.name for path in result.pictures)
    say(f"{good} of {len(verdicts)} types work; wrote {result.model}, {made}, {VERDICT}")
    names = [v.type for v in verdicts if v.works] or [v.type for v in verdicts if v.rollouts]
    if names:
        arguments = ["--model", str(result.model), "--types", ",".join(names[:2]), "--view"]
        say(f"try: {shlex.join(['motionkit', 'synthesize', *arguments])}")
