"""`motionkit synthesize`: synthesizes motion types and writes the motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING_FILE,
    Stages,
    option,
    print_json,
    remark,
    stdout_console,
    strict_option,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.outputs import OutputOptions, Outputs, display_name, output_option
from motionkit.cli.synthesis_options import (
    Making,
    SynthesisCommand,
    announce,
    metrics_line,
    motion_metrics,
    synthesis_options,
)

if TYPE_CHECKING:
    from motionkit.control.keys import Key
    from motionkit.control.synthesize import SynthesisResult
    from motionkit.editing.loop import Loop
    from motionkit.view.figure_data import MotionView


@click.command("synthesize", cls=SynthesisCommand)
@click.option(
    "--types",
    multiple=True,
    help="Motion types in order, such as running,cartwheel or running:4,cartwheel:3 (seconds). Repeat it to give the "
    "characters of --count different types, in turn.",
)
@click.option("--list-types", is_flag=True, help="List the model's motion types and characters.")
@output_option("File to write; a BVH file named after the types by default")
@click.option(
    "--seconds",
    type=FiniteRange(0.1, 3600),
    help="Total length in seconds; by default 4 s per type, or one performance of types such as flips.",
)
@option(
    "--count",
    default=1,
    type=click.IntRange(1, 4096),
    help="Number of motions, made together, each with the next seed; the files are numbered.",
)
@click.option(
    "--loop",
    "loops",
    is_flag=True,
    help="Write one closed cycle of a gait or dance, about --seconds long, from the origin, facing +Z.",
)
@click.option(
    "--keys",
    "keys_file",
    type=EXISTING_FILE,
    help="JSON file of poses, places and joints to meet at given times (docs/keys.md).",
)
@strict_option
@synthesis_options
def command(
    types: tuple[str, ...],
    list_types: bool,
    seconds: float | None,
    count: int,
    loops: bool,
    keys_file: Path | None,
    making: Making,
    output_options: OutputOptions,
) -> None:
    """Synthesize motion types in sequence and write BVH or another format.

    By default the command uses the bundled model and writes to the current folder. The same seed gives the
    same file; --count N --seed S gives the files of seeds S to S+N-1.
    """
    if list_types:
        _list(making.model_path, output_options.as_json)
        return
    _check(types, count, loops, keys_file, making, output_options)
    from motionkit.control.keys import key_files
    from motionkit.editing.loop import loop_seconds
    from motionkit.requests import loop_wish, synthesis_request

    seconds = loop_wish(types, seconds) if loops else seconds
    length = loop_seconds(seconds) if loops else seconds
    request = synthesis_request(types, seconds=length, count=count, keys=keys_file or (), **making.words())
    inputs = (*making.inputs, *((keys_file, *key_files(keys_file)) if keys_file else ()))
    keys = request.options.keys  # in the world of the rig
    if keys:
        body = request.model.character(request.options.characters[0])
        request = request.on_rig(making.choice.size(body))
    ending = making.choice.ending
    outputs = output_options.files(request.name, inputs, request.options.count, ending=ending)
    announce(request.frames / request.model.fps, request.model.fps, request.options)
    for line in request.doubtful:
        remark(line)
    with Stages() as show:
        progress = show.count("synthesizing", None if loops else request.frames)
        result, cycles = request.loops(seconds, progress) if loops else (request.run(progress), [])
        made, views = _write(result, keys, cycles, outputs, making, show)
    for file, cycle in zip(outputs.files, cycles, strict=False):  # no cycles without --loop
        if note := cycle.note(seconds):
            remark(f"{display_name(file)}: {note}" if len(cycles) > 1 else note)
    outputs.show(lambda: views)
    rate = result.frames / max(result.seconds, 1e-9)
    facts = {"roll_out_seconds": result.seconds, "frames_per_second": rate, "seed": making.seed}
    lines = [line for entry in made for line in _lines(entry, making.choice.words)]
    lines.append(f"made in {result.seconds:.2f} s, {rate:.0f} frames per second")
    outputs.report({"motions": [entry["facts"] for entry in made], **facts}, lines)


def _check(
    types: Sequence[str],
    count: int,
    loops: bool,
    keys_file: Path | None,
    making: Making,
    output_options: OutputOptions,
) -> None:
    """Raise UsageError for contradictory options."""
    count = max(count, len(types), len(making.characters))
    if not types:
        raise click.UsageError(
            "give --types, such as --types running,cartwheel; --list-types lists the model's types"
        )
    if output_options.view:
        from motionkit.view.viewer import MAX_MOTIONS

        if count > MAX_MOTIONS:
            raise click.UsageError(f"--view shows up to {MAX_MOTIONS} motions, found {count}")
    if loops and keys_file is not None:
        raise click.UsageError("--loop and --keys cannot be combined")
    if keys_file is not None and making.choice.root_motion.in_place:
        raise click.UsageError("--keys says where to be on the ground, which --in-place leaves out")
    output_options.check(count)


def _write(
    result: SynthesisResult,
    keys: Sequence[Key],
    cycles: Sequence[Loop],
    outputs: Outputs,
    making: Making,
    show: Stages,
) -> tuple[list[dict[str, Any]], list[MotionView]]:
    """Write and measure the motions; returns their facts for --json, with seams, and the motions for --view."""
    from motionkit.control.meet import arrival
    from motionkit.editing.loop import motion_seam
    from motionkit.view.figure_data import MotionView

    made, views, bodies = [], [], making.characters
    progress = show.count("writing", len(result.motions))
    for number, one in enumerate(result.motions):
        progress(number)
        file, parts = outputs.files[number], [(part.type, part.seconds) for part in one.types]
        put, measured = making.choice.put(one.motion, making.ik, bool(cycles), one.unfinished)
        outputs.write(making.choice.clip_of(put, file.stem, parts), number)
        views.append(MotionView(file.stem, put, parts, character=making.choice.character))
        facts = {"file": file, "frames": len(put), "fps": one.motion.fps, "types": parts}
        facts |= {"seed": making.seed + number, "character": bodies[number % len(bodies)]}
        facts |= {"metrics": motion_metrics(measured, making.choice.rig)}
        cycle = put.cut(1, len(put)) if making.choice.root_motion.rest_frame else put
        seam = motion_seam(cycle) if cycles else None
        if seam:
            facts |= seam.as_dict()
        if keys:
            own = making.choice.own_body(cycle, measured)
            away = [(key.seconds, *arrival(own, key)) for key in keys]
            facts["keys"] = [dict(zip(("seconds", "cm", "degrees"), each, strict=True)) for each in away]
        made.append({"facts": facts, "seam": seam})
    return made, views


def _lines(entry: dict[str, Any], on: str) -> Iterator[str]:
    """The lines printed for one motion."""
    facts, seam = entry["facts"], entry["seam"]
    kinds = ", ".join(f"{kind} {round(time, 2):g} s" for kind, time in facts["types"])
    yield f"wrote {display_name(facts['file'])}: {kinds}; {facts['frames']} frames at {facts['fps']:g} fps{on}"
    yield metrics_line(facts["metrics"])
    if seam:
        yield f"  {seam.sentence()}"
    for key in facts.get("keys", ()):
        yield f"  key at {key['seconds']:g} s: {key['cm']:.2f} cm and {key['degrees']:.1f} degrees away"


def _list(model_path: Path | None, as_json: bool) -> None:
    from motionkit.models.bundled import open_model

    model = open_model(model_path)
    if as_json:
        print_json({"types": list(model.types), "characters": list(model.characters), "fps": model.fps})
        return
    out = stdout_console()
    out.print("types: " + ", ".join(model.types))
    out.print("characters: " + ", ".join(model.characters))
