"""Options and output shared by synthesize and follow-path."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    json_option,
    model_option,
    remark,
    seed_option,
    stderr_console,
    stdout_console,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.motion_options import ENDINGS, checked_ending, root_options
from motionkit.cli.rig_options import NO_RIG, RigChoice, rig_options
from motionkit.cli.showing import view_option

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.control.synthesize import SynthesisOptions
    from motionkit.inference.noise import Noise
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion

SHOWN_METRICS = ("bm-geodesic", "afs", "skate-ratio", "jerk", "penetration-mean")


STDOUT = Path("-")
LONG_SECONDS = 900.0  # of motion; a command announces longer work before it begins


def noise_options(function: Callable) -> Callable:
    """The options --noise and --temperature."""
    temperature = click.option(
        "--temperature",
        type=FiniteRange(0, 2),
        help="Noise strength; 0.05 by default, 1 with --noise sample.",
    )
    kind = click.option(
        "--noise",
        type=click.Choice(["mean", "sample", "correlated"]),
        help="How to draw frames from the predicted distribution: the mean, independent samples, or samples "
        "correlated in time; correlated by default, sample for models of tptn-paper.",
    )
    return kind(temperature(function))


def reference_option(function: Callable) -> Callable:
    """The option --reference."""
    return click.option(
        "--reference",
        default="auto",
        show_default=True,
        type=click.Choice(["auto", "none"]),
        help="auto plays reference recordings to the network for types that have them; none runs it without.",
    )(function)


def synthesis_options(function: Callable) -> Callable:
    """Model, noise, body and output options."""
    options: list[Callable] = [
        model_option,
        seed_option(),
        click.option(
            "--character",
            default="default",
            show_default=True,
            help="Body to move; a crowd (synthesize --count) takes several names, separated by commas, in turn.",
        ),
        click.option(
            "--init",
            type=click.Path(exists=True, dir_okay=False, path_type=Path),
            help="Start from the first frames of this BVH file; from a pose in the model by default.",
        ),
        noise_options,
        reference_option,
        click.option(
            "--ik/--no-ik",
            default=True,
            show_default=True,
            help="Hold feet while they touch the floor; --no-ik writes the raw network output.",
        ),
        click.option(
            "--fps",
            type=FiniteRange(1, 480),
            help="Frame rate of the file; the model's 60 by default.",
        ),
        root_options,
        rig_options,
        view_option,
        json_option,
    ]
    for option in reversed(options):
        function = option(function)
    return function


def output_option(text: str) -> Callable:
    """The -o option of commands that write a motion to a file or as BVH to standard output."""
    kind: Any = click.Path(path_type=Path)
    text = f"{text}. The ending chooses the format: {ENDINGS}; - writes BVH to standard output."
    return click.option("-o", "--output", type=kind, callback=checked_ending, help=text)


def check_stdout(output: Path | None, others: dict[str, bool]) -> None:
    """Raise UsageError for options that cannot be combined with BVH on standard output."""
    for name, given in others.items():
        if output == STDOUT and given:
            raise click.UsageError(f"{name} cannot be combined with -o -, which writes one motion")


def write_motion(
    path: Path, motion: Motion, types: Sequence[tuple[str, float]] = (), choice: RigChoice = NO_RIG
) -> None:
    """Write a motion to a file or, for "-", as BVH to standard output; nothing is written if it is invalid."""
    from motionkit.export.formats import write_motion as write

    clip = choice.clip_of(motion, path.stem, types)
    if path != STDOUT:
        write(path, clip)
        return
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "motion.bvh"
        write(made, clip)
        with made.open("rb") as file:
            shutil.copyfileobj(file, sys.stdout.buffer)
    sys.stdout.buffer.flush()


def shown_name(path: str | Path) -> str:
    """The name of an output in messages."""
    return "standard output" if Path(path) == STDOUT else str(path)


def announce(seconds: float, model_fps: float, options: SynthesisOptions) -> None:
    """Announce long work before it begins; raises ControlError if it is too large."""
    from motionkit.control.synthesize import check_size

    check_size(seconds, model_fps, options)
    if seconds * options.count < LONG_SECONDS:
        return
    each = "" if options.count == 1 else f"{options.count} motions of "
    hours = f"{seconds:.0f} s" if seconds < 3600 else f"{seconds / 3600:.1f} hours"
    remark(f"making {each}{hours} of motion, which can take minutes; Ctrl-C stops")


def words_console(output: Path | None) -> PlainConsole:
    """The console for the report: stdout, or stderr if the motion goes to stdout."""
    return stderr_console() if output == STDOUT else stdout_console()


def make_noise(kind: str | None, temperature: float | None, model: MotionModel) -> Noise:
    """The Noise of --noise and --temperature for a model."""
    from motionkit.inference.noise import Noise, default_noise

    kind = kind or default_noise(model).kind
    usual = 1.0 if kind == "sample" else 0.05
    return Noise(kind, usual if temperature is None else temperature)


def motion_metrics(motion: Motion) -> dict[str, Any]:
    """Measure a synthesized motion: metric id to value and unit."""
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
