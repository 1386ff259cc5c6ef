"""Options and output that synthesize and follow-path share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING_FILE,
    fps_option,
    gathered,
    json_option,
    model_option,
    named_animation_option,
    option,
    remark,
    seed_option,
    switch,
    together,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.outputs import OutputOptions, animation_options, view_option
from motionkit.cli.rig_options import RigChoice, open_written, written_options
from motionkit.names import listed

if TYPE_CHECKING:
    from motionkit.control.synthesize import SynthesisOptions
    from motionkit.inference.noise import Noise
    from motionkit.models.model import MotionModel
    from motionkit.motion.motion import Motion
    from motionkit.rig.rig import Rig

UNSEEN_DEPTH = 1.0  # cm below the floor, or the height of standing feet, that nobody sees
PRINTED_METRICS = ("bm-geodesic", "afs", "skate-ratio", "jerk", "penetration-mean", "penetration-max")

LONG_SECONDS = 900.0  # seconds of motion; a command announces longer jobs before they begin


# Options by what they are about, in the order of use; both those of --help and of the command reference.
SECTIONS = {
    "Motion": ("types", "list_types", "seconds", "loops", "keys_file", "count", "size", "speed", "seed"),
    "File": ("output", "view", "fps", "as_json"),
    "Character": ("rig_path", "list_rigs", "character", "map_path", "clip_path", "name", "alone"),
    "Root and rest pose": ("in_place", "root", "rest", "rest_frame"),
    "Start and feet": ("init", "animation", "ik", "strict"),
    "Model": ("model_path", "noise", "temperature", "reference"),
}


class SynthesisCommand(click.Command):
    """A command whose options stand in SECTIONS."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        order = [name for names in SECTIONS.values() for name in names]
        self.params.sort(key=lambda each: order.index(each.name) if each.name in order else -1)

    def format_options(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of each section under its name."""
        options = [each for each in self.get_params(context) if isinstance(each, click.Option)]
        rest = {each.name: each.get_help_record(context) for each in options}
        for title, names in SECTIONS.items():
            if records := [record for name in names if (record := rest.pop(name, None))]:
                with formatter.section(title):
                    formatter.write_dl(records)
        if others := [record for record in rest.values() if record]:
            with formatter.section("Options"):
                formatter.write_dl(others)


noise_options = together(
    click.option(
        "--noise",
        type=click.Choice(["mean", "sample", "correlated"]),
        help="How to draw frames from the predicted distribution: the mean, independent samples, or samples "
        "correlated in time; correlated by default, sample for models of tptn-paper.",
    ),
    click.option(
        "--temperature",
        type=FiniteRange(0, 2),
        help="Noise strength; 0.05 by default, 1 with --noise sample.",
    ),
)
reference_option = option(
    "--reference",
    default="auto",
    type=click.Choice(["auto", "none"]),
    help="Reference recordings: auto follows them in types that have them; none runs the network without.",
)


def make_noise(kind: str | None, temperature: float | None, model: MotionModel) -> Noise:
    """The Noise for --noise and --temperature."""
    from motionkit.inference.noise import Noise, default_noise

    kind = kind or default_noise(model).kind
    usual = 1.0 if kind == "sample" else 0.05
    return Noise(kind, usual if temperature is None else temperature)


@dataclass(frozen=True)
class Making:
    """How to make and write a motion; choice holds the rig and the root motion."""

    model_path: Path | None
    seed: int
    character: str
    init: Path | None
    noise: str | None
    temperature: float | None
    reference: str
    ik: bool
    fps: float | None
    choice: RigChoice

    @property
    def inputs(self) -> tuple[Path | None, ...]:
        """The input files."""
        return (self.model_path, self.init, *self.choice.files)

    @property
    def characters(self) -> list[str]:
        """The names of --character."""
        return listed(self.character)

    def words(self) -> dict[str, Any]:
        """Keywords for mk.synthesize and mk.follow_path; opens the model."""
        from motionkit.models.bundled import open_model

        model = open_model(self.model_path, self.reference)
        noise = make_noise(self.noise, self.temperature, model)
        if self.choice.rig is not None and self.character != "default" and not model.shows_bodies:
            remark("--character is left out: the motion gets the body of --rig")
        words: dict[str, Any] = {"model": model, "noise": noise, "seed": self.seed, "init": self.init}
        return words | {"character": self.character, "ik": self.ik, "fps": self.fps or self.choice.fps}


synthesis_options: Callable = together(
    model_option,
    seed_option,
    option(
        "--character",
        default="default",
        help="Body to move; synthesize takes several names, separated by commas, in turn.",
    ),
    click.option(
        "--init",
        type=EXISTING_FILE,
        help="Continue from the first 87 frames of this clip; by default the motion starts from a pose in the model.",
    ),
    named_animation_option("Animation of the --init or --from file, if that is a .glb or .vrm with several."),
    noise_options,
    reference_option,
    switch("--ik/--no-ik", "Lock feet while they touch the floor; --no-ik writes the raw network output."),
    fps_option("Frame rate of the file; the model's 60 by default, and 30 with --rig @lafan1."),
    written_options,
    animation_options,
    view_option,
    json_option,
    gathered("choice", open_written),
    gathered("making", Making),
    gathered("output_options", OutputOptions),
)


def announce(seconds: float, model_fps: float, options: SynthesisOptions) -> None:
    """Announce a long job before it begins; raises ControlError if it is too large."""
    from motionkit.control.synthesize import check_size

    check_size(seconds, model_fps, options)
    if seconds * options.count < LONG_SECONDS:
        return
    each = "" if options.count == 1 else f"{options.count} motions of "
    hours = f"{seconds:.0f} s" if seconds < 3600 else f"{seconds / 3600:.1f} hours"
    remark(f"making {each}{hours} of motion, which can take minutes; Ctrl-C stops")


def motion_metrics(motion: Motion, rig: Rig | None) -> dict[str, Any]:
    """Metrics of a motion on the canonical joints: metric id to value and unit; the depth of a rig's soles too."""
    from motionkit.finish.on_rig import rig_sole_depth
    from motionkit.metrics.report import evaluate_motion

    report = evaluate_motion(motion)
    rows = {row.id: row.motion for row in report.rows}
    made = {i: {"value": rows[i].value, "unit": rows[i].unit} for i in PRINTED_METRICS if i in rows}
    depth = None if rig is None else rig_sole_depth(motion, rig)
    return made if depth is None else made | {"sole-depth": {"value": depth, "unit": "cm"}}


def metrics_line(metrics: dict[str, Any]) -> str:
    """What is seen of the metrics of one motion, in words; --json and `motionkit metrics` have all."""
    from motionkit.metrics.report import SLIDING

    words = []
    floor = "sole-depth" if "sole-depth" in metrics else "penetration-max"
    slides, deep = (metrics.get(name, {}).get("value") for name in ("skate-ratio", floor))
    if slides is not None:
        words.append(SLIDING.format(100 * slides))
    if deep is not None:
        words.append(
            f"feet at most {deep:.1f} cm too low" if deep > UNSEEN_DEPTH else "nothing below the floor"
        )
    return "  " + "; ".join(words or ["too short to measure"])
