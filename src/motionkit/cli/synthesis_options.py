"""The options synthesize and follow-path share, and what both print."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import json_option, remark, seed_option, stderr_console, stdout_console
from motionkit.cli.showing import view_option

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.control.synthesize import SynthesisOptions
    from motionkit.inference.rollout import Noise
    from motionkit.motion.motion import Motion

SHOWN_METRICS = ("bm-geodesic", "afs", "skate-ratio", "jerk", "penetration-mean")


STDOUT = Path("-")
LONG_SECONDS = 900.0  # of motion, from which on a command says so before it begins


def noise_options(function: Callable) -> Callable:
    """How frames are drawn."""
    temperature = click.option(
        "--temperature",
        type=click.FloatRange(0, 2),
        help="Strength of the noise; 0.05 by default, 1 for sample.",
    )
    kind = click.option(
        "--noise",
        default="correlated",
        show_default=True,
        type=click.Choice(["mean", "sample", "correlated"]),
        help="How frames are drawn from the predicted distribution.",
    )
    return kind(temperature(function))


def synthesis_options(function: Callable) -> Callable:
    """Model, noise, body and output options."""
    options: list[Callable] = [
        click.option(
            "--model",
            "model_path",
            type=click.Path(exists=True, dir_okay=False, path_type=Path),
            help="A model file; the bundled model by default.",
        ),
        seed_option(),
        click.option(
            "--character",
            default="default",
            show_default=True,
            help="The body to move; for a crowd (synthesize --count) several names with commas, taken in turn.",
        ),
        click.option(
            "--init",
            type=click.Path(exists=True, dir_okay=False, path_type=Path),
            help="Start from the first frames of this BVH file.",
        ),
        noise_options,
        click.option(
            "--ik/--no-ik",
            default=True,
            show_default=True,
            help="Hold feet still while they touch the floor and lift them while they move; without, as the network "
            "drew them.",
        ),
        click.option(
            "--fps",
            type=click.FloatRange(1, 480),
            help="Rate of the written file; the model's 60 by default.",
        ),
        view_option,
        json_option,
    ]
    for option in reversed(options):
        function = option(function)
    return function


def output_option(text: str) -> Callable:
    """The -o of commands that write BVH, to a file or to standard output."""
    kind: Any = click.Path(path_type=Path)
    return click.option(
        "-o", "--output", type=kind, help=f"{text}; - writes to standard output, and messages to stderr."
    )


def check_stdout(output: Path | None, others: dict[str, bool]) -> None:
    """Raise UsageError where the BVH goes to standard output beside options that do not go with that."""
    for name, given in others.items():
        if output == STDOUT and given:
            raise click.UsageError(f"{name} does not go with -o -, one motion on standard output")


def write_motion(path: Path, motion: Motion) -> None:
    """Write BVH to a file or, for "-", to standard output, and there too nothing if it cannot be written."""
    from motionkit.motion.bvh import write_bvh

    if path != STDOUT:
        write_bvh(path, motion)
        return
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "motion.bvh"
        write_bvh(made, motion)
        with made.open("rb") as file:
            shutil.copyfileobj(file, sys.stdout.buffer)
    sys.stdout.buffer.flush()


def shown_name(path: str | Path) -> str:
    """The name of an output as a reader knows it."""
    return "standard output" if Path(path) == STDOUT else str(path)


def announce(seconds: float, model_fps: float, options: SynthesisOptions) -> None:
    """Say before long work how much it is; raises ControlError for more than can be made."""
    from motionkit.control.synthesize import check_size

    check_size(seconds, model_fps, options)
    if seconds * options.count < LONG_SECONDS:
        return
    each = "" if options.count == 1 else f"{options.count} motions of "
    hours = f"{seconds:.0f} s" if seconds < 3600 else f"{seconds / 3600:.1f} hours"
    remark(f"{each}{hours} of motion are to be made, which can take minutes; Ctrl-C stops")


def words_console(output: Path | None) -> PlainConsole:
    """Where a command tells what it made: on stdout, unless the motion goes there."""
    return stderr_console() if output == STDOUT else stdout_console()


def make_noise(kind: str, temperature: float | None) -> Noise:
    """The noise a user asks for."""
    from motionkit.inference.rollout import Noise

    usual = 1.0 if kind == "sample" else 0.05
    return Noise(kind, usual if temperature is None else temperature)


def motion_metrics(motion: Motion) -> dict[str, Any]:
    """What a synthesized motion is measured by: metric id to value and unit."""
    from motionkit.metrics.report import evaluate_motion

    report = evaluate_motion(motion)
    rows = {row.id: row.motion for row in report.rows}
    return {i: {"value": rows[i].value, "unit": rows[i].unit} for i in SHOWN_METRICS if i in rows}


def metrics_line(metrics: dict[str, Any]) -> str:
    """The metrics of one motion in one line."""
    words = [
        f"{i} {m['value']:.3g} {m['unit']}".strip() for i, m in metrics.items() if m["value"] is not None
    ]
    return ", ".join(words)
