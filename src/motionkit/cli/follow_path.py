"""`motionkit follow-path`: a path on the ground to BVH."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import default_output, print_json, progress_bar, remark
from motionkit.cli.finite import FINITE
from motionkit.cli.motion_options import RootMotion
from motionkit.cli.showing import write_and_open
from motionkit.cli.synthesis_options import (
    STDOUT,
    announce,
    check_stdout,
    make_noise,
    metrics_line,
    motion_metrics,
    output_option,
    shown_name,
    synthesis_options,
    words_console,
    write_motion,
)
from motionkit.names import nfc

if TYPE_CHECKING:
    from motionkit.cli.rig_options import RigChoice


@click.command("follow-path")
@click.argument("path")
@output_option("File to write; a BVH file named after the path by default")
@click.option(
    "--types",
    help="Named shapes: motion types along the path, in equal parts, such as running,cartwheel,running; "
    "walking by default, or the model's walk under its own name.",
)
@click.option("--size", type=FINITE, help="Named shapes: length, radius or side in metres.")
@click.option("--speed", type=FINITE, help="Named shapes: speed in m/s; each type's own by default.")
@click.option("--strict", is_flag=True, help="Refuse speeds at which a gait does not look right.")
@synthesis_options
def command(
    path: str,
    output: Path | None,
    types: str | None,
    size: float | None,
    speed: float | None,
    strict: bool,
    model_path: Path | None,
    seed: int,
    character: str,
    init: Path | None,
    noise: str | None,
    temperature: float | None,
    reference: str,
    ik: bool,
    fps: float | None,
    root_motion: RootMotion,
    choice: RigChoice,
    view: bool,
    as_json: bool,
) -> None:
    """Make a character follow PATH and write BVH or another format.

    PATH is a JSON or CSV file in metres, whose parts have points, a type and a speed (docs/paths.md), or a
    named shape: line, circle, figure-eight, square, pentagram, u-turn. The command prints the distance
    between the root's track and the path.

    A gait goes no slower and no faster than its recordings look right, and the command says so.
    """
    from motionkit.control.follow import follow_path
    from motionkit.control.path import read_path, shape_path
    from motionkit.control.plan import plan_path
    from motionkit.control.speeds import check_speeds, other_speeds, short_performances
    from motionkit.control.steering import walking_type
    from motionkit.control.synthesize import SynthesisOptions
    from motionkit.files import check_outputs
    from motionkit.models.bundled import open_model

    is_file = Path(path).suffix.lower() in (".json", ".csv") or Path(path).is_file()
    kinds = [nfc(word.strip()) for word in (types or "").split(",") if word.strip()]
    if types is not None and not kinds:
        raise click.UsageError("--types is empty; give motion types such as running,cartwheel")
    if is_file and (kinds or size is not None or speed is not None):
        raise click.UsageError("--types, --size and --speed are for named shapes; a path file holds its own")
    check_stdout(output, {"--view": view, "--json": as_json})
    model = None
    if not is_file and not kinds:
        model = open_model(model_path, reference)
        kinds = [walking_type(model)]
    target = read_path(path) if is_file else shape_path(path, size, kinds, speed)
    file = output or default_output(f"{Path(path).stem}-{target.parts[0].type}")
    page_file = file.with_suffix(".html")
    inputs = (path if is_file else None, model_path, init, *choice.files)
    check_outputs([file, page_file] if view else [] if file == STDOUT else [file], inputs)
    model = model or open_model(model_path, reference)
    if strict:
        check_speeds(model, target)
    options = SynthesisOptions(1, seed, make_noise(noise, temperature, model), character, init, ik, fps)
    announce(plan_path(model, target).seconds, model.fps, options)
    for line in other_speeds(model, target) + short_performances(model, target):
        remark(line)
    with progress_bar() as bar:
        task = bar.add_task("following", total=100)
        result = follow_path(model, target, options, lambda share: bar.update(task, completed=100 * share))
    times = [frames / model.fps for frames in result.part_frames]
    bands = [(part.type, time) for part, time in zip(target.parts, times, strict=True)]
    written, measured = choice.put_and_measure(result.motion, ik, root_motion)
    write_motion(file, written, bands, choice)
    metrics = motion_metrics(measured)
    parts = [
        {"type": part.type, "mean_cm": None if d is None else d[0], "max_cm": None if d is None else d[1]}
        for part, d in zip(target.parts, result.part_distances, strict=True)
    ]
    page = None
    if view:
        from motionkit.view.figure_data import Shown

        shown = Shown(file.stem, written, bands, target.points)
        page = write_and_open(page_file, [shown], as_json)
    if as_json:
        print_json(
            {
                "file": str(file),
                "frames": result.frames,
                "finished": result.finished,
                "path_cm": target.length,
                "trajectory_distance_cm": result.distance.mean,
                "largest_distance_cm": result.distance.max,
                "coverage": result.distance.coverage,
                "parts": parts,
                "metrics": metrics,
                "frames_per_second": result.frames / max(result.seconds, 1e-9),
                "seed": seed,
                **({"view": str(page)} if page else {}),
            }
        )
        return
    out = words_console(output)
    on = "" if choice.rig is None else f" on {choice.rig.name}"
    end = "reached the end" if result.finished else "did not reach the end"
    out.print(
        f"wrote {shown_name(file)}: {result.frames / model.fps:.1f} s along {target.length / 100:.1f} m{on}, {end}",
    )
    for number, part in enumerate(parts, 1):
        if part["mean_cm"] is None:
            out.print(f"  part {number} {part['type']}: not reached")
        else:
            out.print(
                f"  part {number} {part['type']}: {part['mean_cm']:.2f} cm per frame, at most {part['max_cm']:.1f} cm",
            )
    out.print(
        f"trajectory distance {result.distance.mean:.2f} cm per frame, at most {result.distance.max:.1f} cm",
    )
    out.print(f"  {metrics_line(metrics)}")
    if page:
        out.print(f"wrote {page}")
