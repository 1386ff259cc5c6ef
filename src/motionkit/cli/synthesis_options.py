"""The options synthesize and follow-path share, and what both print."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import json_option, seed_option
from motionkit.cli.showing import view_option

if TYPE_CHECKING:
    from motionkit.motion.motion import Motion
    from motionkit.synthesis.rollout import Noise

SHOWN_METRICS = ("bm-geodesic", "afs", "skate-ratio", "jerk", "penetration-mean")


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
            help="The body to move; of a crowd, several names with commas, taken in turn.",
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


def make_noise(kind: str, temperature: float | None) -> Noise:
    """The noise a user asks for."""
    from motionkit.synthesis.rollout import Noise

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
