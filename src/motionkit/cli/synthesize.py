"""`motionkit synthesize`: motion types to BVH."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import default_output, print_json, progress_bar, remark, stdout_console
from motionkit.cli.finite import FiniteRange
from motionkit.cli.motion_options import RootMotion, length_note, seam_json, seam_words
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
from motionkit.errors import MotionkitError

if TYPE_CHECKING:
    from motionkit.cli.rig_options import RigChoice
    from motionkit.control.keys import Key
    from motionkit.control.script import TypePart
    from motionkit.control.synthesize import SynthesisResult
    from motionkit.editing.loop import Loop
    from motionkit.motion.motion import Motion

LOOP_SECONDS = 8.0  # synthesized by default to find a cycle in
LOOP_TRIES = (2, 4, 8)  # so many times as long, where nothing repeats


@click.command("synthesize")
@click.option(
    "--types",
    multiple=True,
    help="Motion types in order, such as running,cartwheel or running:4,cartwheel:3 (seconds). "
    "Repeat it to give the characters of --count different types, in turn.",
)
@click.option("--list-types", is_flag=True, help="List the model's motion types and characters.")
@output_option("File to write; a BVH file named after the types by default")
@click.option(
    "--seconds",
    type=FiniteRange(0.1, 3600),
    help="Total length in seconds; by default 4 s per type, or one performance of types such as flips.",
)
@click.option(
    "--count",
    default=1,
    show_default=True,
    type=click.IntRange(1, 4096),
    help="Number of motions, made together, each with the next seed; the files are numbered.",
)
@click.option(
    "--loop",
    "loops",
    is_flag=True,
    help="Write one closed cycle of a gait or dance, of about --seconds, from the origin, facing +Z.",
)
@click.option(
    "--keys",
    "keys_file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="JSON file of poses, places and joints to meet at given times (docs/keys.md).",
)
@synthesis_options
def command(
    types: tuple[str, ...],
    list_types: bool,
    output: Path | None,
    seconds: float | None,
    count: int,
    loops: bool,
    keys_file: Path | None,
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
    """Synthesize motion types in sequence and write BVH or another format.

    By default the command uses the bundled model and writes to the current folder. The same seed gives the
    same file; --count N --seed S gives the files of seeds S to S+N-1.
    """
    from motionkit.files import check_outputs
    from motionkit.models.bundled import open_model

    if list_types:
        _list(open_model(model_path), as_json)
        return
    if not types:
        raise click.UsageError(
            "give --types, such as --types running,cartwheel; --list-types lists the model's types"
        )
    if view:
        from motionkit.view.viewer import MAX_MOTIONS

        if count > MAX_MOTIONS:
            raise click.UsageError(f"--view shows up to {MAX_MOTIONS} motions, found --count {count}")
    from motionkit.control.keys import check_length, read_keys
    from motionkit.control.plan import plan_types
    from motionkit.control.script import parse_types
    from motionkit.control.synthesize import SynthesisOptions, synthesize

    if loops and keys_file is not None:
        raise click.UsageError("--loop and --keys cannot be combined")
    if keys_file is not None and root_motion.in_place:
        raise click.UsageError("--keys says where to be on the ground, which --in-place leaves out")
    count = max(count, len(types))
    check_stdout(output, {"--view": view, "--json": as_json, f"--count {count}": count > 1})
    model = open_model(model_path, reference)
    length = loop_seconds(seconds) if loops else seconds
    plans = [parse_types(text, length, model.phase_seconds) for text in types]
    if loops and any(len(plan) > 1 for plan in plans):
        raise click.UsageError("--loop takes one motion type, such as --types walking --loop")
    for part in (part for plan in plans for part in plan):
        model.type_id(part.type)

    def clip_files(base: Path) -> list[Path]:
        return [base] if count == 1 else [_numbered(base, number, count) for number in range(1, count + 1)]

    def all_files(base: Path) -> list[Path]:
        return clip_files(base) + ([base.with_suffix(".html")] if view else [])

    name = "-".join(part.type for plan in plans for part in plan)[:80]
    base = output or default_output(name, files=all_files)
    files = clip_files(base)
    check_outputs([] if base == STDOUT else all_files(base), (model_path, init, keys_file, *choice.files))
    keys = read_keys(keys_file, model) if keys_file is not None else ()
    check_length(keys, min(sum(part.seconds for part in plan) for plan in plans))
    drawn = make_noise(noise, temperature, model)
    options = SynthesisOptions(count, seed, drawn, character, init, ik, fps, keys=keys)
    lengths = [len(plan_types(model, plan).track) for plan in plans]
    if min(lengths) < 2:
        raise MotionkitError(f"expected at least 2 frames, {2.0 / model.fps:.2g} s, found 1")
    frames = max(lengths)
    announce(frames / model.fps, model.fps, options)
    with progress_bar() as bar:

        def rolled(plans: list[list[TypePart]], frames: int) -> SynthesisResult:
            task = bar.add_task("synthesizing", total=frames)
            return synthesize(model, plans, options, lambda done: bar.update(task, completed=done))

        result = rolled(plans, frames)
        if loops:
            result, cycles = _looped(
                result, seconds, lambda times: rolled(_longer(plans, times), times * frames)
            )
    made: list[dict[str, Any]] = []
    written: list[Motion] = []
    with progress_bar() as bar:
        for path, synthesis in zip(bar.track(files, description="writing"), result.motions, strict=True):
            parts = [(part.type, part.seconds) for part in synthesis.types]
            put, measured = choice.put_and_measure(synthesis.motion, ik, root_motion, cyclic=loops)
            written.append(put)
            write_motion(path, written[-1], parts, choice)
            made.append(
                {
                    "file": str(path),
                    "frames": len(synthesis.motion),
                    "fps": synthesis.motion.fps,
                    "types": [list(part) for part in parts],
                    "metrics": motion_metrics(measured),
                    **(seam_json(cycles[len(made)]) if loops else {}),
                    **({"keys": [_arrival(measured, key) for key in keys]} if keys else {}),
                }
            )
    for cycle in cycles if loops else ():
        if note := length_note((len(cycle.motion) - 1) / cycle.motion.fps, seconds):
            remark(note)
    page = _view(base, made, result, written, as_json) if view else None
    rate = result.frames / max(result.seconds, 1e-9)
    if as_json:
        shown = {"roll_out_seconds": result.seconds, "frames_per_second": rate, "seed": seed}
        print_json({"motions": made, **shown, **({"view": str(page)} if page else {})})
        return
    out = words_console(output)
    on = "" if choice.rig is None else f" on {choice.rig.name}"
    for entry in made:
        kinds = ", ".join(f"{kind} {round(time, 2):g} s" for kind, time in entry["types"])
        out.print(
            f"wrote {shown_name(entry['file'])}: {kinds}; {entry['frames']} frames at {entry['fps']:g} fps{on}",
        )
        out.print(f"  {metrics_line(entry['metrics'])}")
        if loops:
            out.print(f"  {seam_words(cycles[made.index(entry)])}")
        for key in entry.get("keys", ()):
            out.print(
                f"  key at {key['seconds']:g} s: {key['cm']:.2f} cm and {key['degrees']:.1f} degrees away"
            )
    out.print(f"roll-out {result.seconds:.2f} s, {rate:.0f} frames per second")
    if page:
        out.print(f"wrote {page}")


def loop_seconds(wish: float | None) -> float:
    """How long to synthesize for a loop: long enough for several cycles to choose from."""
    return LOOP_SECONDS if wish is None else max(LOOP_SECONDS, 2.0 * wish + 2.0)


def _looped(
    result: SynthesisResult, seconds: float | None, longer: Callable[[int], SynthesisResult]
) -> tuple[SynthesisResult, list[Loop]]:
    """The best cycle of each motion, closed; of motions so many times as long where nothing repeats."""
    from motionkit.control.script import TypePart
    from motionkit.editing.loop import make_loop

    for times in (*LOOP_TRIES, None):
        try:
            cycles = [make_loop(one.motion, seconds, from_origin=True) for one in result.motions]
            break
        except MotionkitError as error:
            if times is None:
                raise MotionkitError(
                    f"{str(error).replace('the clip', 'the motion', 1)}; try another --seed, or --seconds"
                ) from None
            result = longer(times)
    motions = tuple(
        replace(
            one,
            motion=cycle.motion,
            types=(TypePart(one.types[0].type, (len(cycle.motion) - 1) / cycle.motion.fps),),
        )
        for one, cycle in zip(result.motions, cycles, strict=True)
    )
    return replace(result, motions=motions), cycles


def _longer(plans: list[list[TypePart]], times: int) -> list[list[TypePart]]:
    return [[replace(part, seconds=times * part.seconds) for part in plan] for plan in plans]


def _arrival(motion: Motion, key: Key) -> dict[str, float]:
    """How far a motion is from a key at its time."""
    from motionkit.control.meet import arrival

    distance, angle = arrival(motion, key)
    return {"seconds": key.seconds, "cm": distance, "degrees": angle}


def _numbered(base: Path, number: int, count: int) -> Path:
    return base.with_name(f"{base.stem}-{number:0{len(str(count))}}{base.suffix}")


def _view(
    base: Path, made: list[dict[str, Any]], result: SynthesisResult, motions: list[Motion], quiet: bool
) -> Path:
    """Write a viewer page of all motions beside the BVH files."""
    from motionkit.view.figure_data import Shown

    shown = [
        Shown(Path(entry["file"]).stem, motion, [(part.type, part.seconds) for part in one.types])
        for entry, one, motion in zip(made, result.motions, motions, strict=True)
    ]
    return write_and_open(base.with_suffix(".html"), shown, quiet)


def _list(model: Any, as_json: bool) -> None:
    if as_json:
        print_json({"types": list(model.types), "characters": list(model.characters), "fps": model.fps})
        return
    out = stdout_console()
    out.print("types: " + ", ".join(model.types))
    out.print("characters: " + ", ".join(model.characters))
