"""`motionkit follow-path`: makes a character follow a path and writes the motion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import Stages, read_strictly, remark
from motionkit.cli.finite import FINITE
from motionkit.cli.outputs import OutputOptions, display_name, output_option
from motionkit.cli.synthesis_options import (
    Making,
    SynthesisCommand,
    announce,
    metrics_line,
    motion_metrics,
    synthesis_options,
)

if TYPE_CHECKING:
    from motionkit.control.follow import FollowResult
    from motionkit.control.path import Path2D


FAR = 30_000.0  # cm; a longer path may have been meant in other units


@click.command("follow-path", cls=SynthesisCommand)
@click.argument("path")
@output_option("File to write; a BVH file named after the path by default")
@click.option(
    "--types",
    help="Named shapes: motion types along the path, in equal parts, such as running,cartwheel,running; walking by "
    "default, or the model's walk under its own name.",
)
@click.option(
    "--size",
    type=FINITE,
    help="Named shapes: length of a line or u-turn, radius of a circle or figure-eight, side of the others, in metres.",
)
@click.option("--speed", type=FINITE, help="Named shapes: speed in m/s; each type's own by default.")
@click.option(
    "--strict",
    is_flag=True,
    is_eager=True,
    callback=read_strictly,
    help="Refuse speeds at which a gait does not look right, and clips with faults that are otherwise repaired.",
)
@synthesis_options
def command(
    path: str, types: str | None, strict: bool, making: Making, output_options: OutputOptions, **shape: Any
) -> None:
    """Make a character follow PATH and write BVH or another format.

    PATH is a JSON or CSV file in metres, whose parts have points, a type and a speed (docs/paths.md), or a
    named shape: line, circle, figure-eight, square, pentagram, u-turn. The command prints the distance
    between the root's track and the path.

    A gait goes no slower and no faster than its recordings look right, and the command says so.
    """
    from motionkit.control.path import IN_METRES
    from motionkit.requests import PATH_ENDINGS, is_path_file, path_request

    is_file = is_path_file(path)
    if types is not None and not types.strip(" ,"):
        raise click.UsageError("--types is empty; give motion types such as running,cartwheel")
    holds_types = Path(path).suffix.lower() in PATH_ENDINGS
    if holds_types and (types or shape["size"] is not None or shape["speed"] is not None):
        raise click.UsageError("--types, --size and --speed are for named shapes; a path file holds its own")
    output_options.check()
    request = path_request(path, types=types, **shape, **making.words())
    model, target = request.model, request.path
    name = f"{Path(path).stem}-{target.parts[0].type}"
    inputs = (path if is_file else None, *making.inputs)
    outputs = output_options.files(name, inputs, ending=making.choice.ending)
    if target.length > FAR:
        metres = target.length / 100.0
        remark(f"the path is {metres:.0f} m long; {IN_METRES}")
    request = request.on_rig(making.choice.size(model.character(making.character)), strict)
    announce(request.seconds, model.fps, request.options)
    for line in request.doubtful:
        remark(line)
    with Stages() as show:
        result = request.run(show.share("following"))
    bands = [(part.type, part.seconds) for part in result.types]
    written, measured = making.choice.put(result.motion, making.ik, drawn=result.unfinished)
    outputs.write(making.choice.clip_of(written, outputs.file.stem, bands))
    from motionkit.view.figure_data import MotionView

    character = making.choice.character
    outputs.show(lambda: [MotionView(outputs.file.stem, written, bands, target.points, character)])
    facts = {
        "file": outputs.file,
        "frames": len(written),
        "fps": written.fps,
        **_facts(target, result, request.size),
        "metrics": motion_metrics(measured, making.choice.rig),
    }
    facts["frames_per_second"] = result.frames / max(result.seconds, 1e-9)
    facts["seed"] = making.seed
    outputs.report(facts, _lines(facts, making.choice.words))


def _facts(path: Path2D, result: FollowResult, size: float) -> dict[str, Any]:
    """Facts about the result, for JSON; size is that of the written body relative to the one that was moved."""
    parts = [
        {"type": part.type, "mean_cm": d and size * d[0], "max_cm": d and size * d[1]}
        for part, d in zip(path.parts, result.part_distances, strict=True)
    ]
    return {
        "finished": result.finished,
        "path_cm": path.length,
        "trajectory_distance_cm": size * result.distance.mean,
        "largest_distance_cm": size * result.distance.max,
        "coverage": result.distance.coverage,
        "parts": parts,
    }


def _lines(facts: dict[str, Any], on: str) -> Iterator[str]:
    """The result in words."""
    end = "reached the end" if facts["finished"] else "did not reach the end"
    travelled = f"{facts['frames'] / facts['fps']:.1f} s along {facts['path_cm'] / 100:.1f} m"
    yield f"wrote {display_name(facts['file'])}: {travelled}{on}, {end}"
    for number, part in enumerate(facts["parts"], 1):
        mean, most = part["mean_cm"], part["max_cm"]
        words = "not reached" if mean is None else f"{mean:.2f} cm from the path, at most {most:.1f} cm"
        yield f"  part {number} {part['type']}: {words}"
    mean, most = facts["trajectory_distance_cm"], facts["largest_distance_cm"]
    yield f"trajectory distance {mean:.2f} cm on average, at most {most:.1f} cm"
    yield metrics_line(facts["metrics"])
