"""`motionkit join`: puts clips one after another, each where the one before it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import click

from motionkit.cli.common import (
    EXISTING,
    clip_options,
    fps_option,
    gathered,
    json_option,
    option,
    remark,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.outputs import OutputOptions, animation_options, display_name, output_option, view_option
from motionkit.cli.rig_options import RigChoice, clip_option, open_rig, rig_option
from motionkit.cli.times import Moment, TimePair
from motionkit.names import counted


@click.command("join")
@click.argument("clips", nargs=-1, required=True, type=EXISTING)
@output_option("File to write, FIRST-joined.bvh by default")
@click.option(
    "--window",
    type=FiniteRange(0.05, 10),
    help="Search the best frames to join in this many seconds at the end of a clip and at the start of the next; 1 by "
    "default, or half of a shorter clip.",
)
@click.option(
    "--at",
    type=TimePair(),
    multiple=True,
    metavar="LEAVE:ENTER",
    help="Join at these times instead: time in the first clip and time in the next, in seconds or frames, such as "
    "2.5:0.3 or 150f:20f. Repeat it for each join.",
)
@option(
    "--blend",
    default=0.5,
    type=FiniteRange(0.05, 3),
    help="Seconds over which the difference at a join decays.",
)
@fps_option("Frame rate to write; that of the first clip by default.")
@click.option(
    "--clip",
    "animations",
    multiple=True,
    help="Animation to read from a .glb or .vrm that has several; repeat it, in the order of these files.",
)
@rig_option
@clip_option
@gathered("choice", open_rig)  # without a map, for --map is that of all files
@animation_options
@clip_options
@view_option
@json_option
@gathered("output_options", OutputOptions)
def command(
    clips: tuple[Path, ...],
    window: float | None,
    at: tuple[tuple[Moment, Moment], ...],
    blend: float,
    fps: float | None,
    animations: tuple[str, ...],
    choice: RigChoice,
    output_options: OutputOptions,
) -> None:
    """Join CLIPS, two or more, into one motion on the rig of the first. A folder stands for its clips by name.

    Each clip continues at the place and heading of the one before it, from where their poses are most similar.
    The difference there decays while feet on the floor are held; other frames stay as they are. Clips of other
    human rigs are retargeted, other rates resampled. The command prints where it joined, how far the poses were
    apart, and how fast feet slide there before and after they are held.
    """
    from motionkit.editing.join import FAR, join_motions
    from motionkit.export.formats import read_clip
    from motionkit.rig.read_file import clips_of
    from motionkit.view.figure_data import MotionView

    output_options.check()
    files = [clip for place in clips for clip in clips_of(place)]
    title = clips[0].resolve().name if clips[0].is_dir() else clips[0].stem
    outputs = output_options.files(f"{title}-joined", [*files, *choice.files], ending=choice.ending)
    chosen = list(zip(files, _named(files, animations), strict=True))
    sources = [read_clip(clip, name) for clip, name in chosen]
    rates = [source.motion.fps for source in sources]
    times = [
        (leave.seconds(mine), enter.seconds(others))
        for (leave, enter), (mine, others) in zip(at, pairwise(rates), strict=False)
    ]
    if len(at) > len(times):
        raise click.UsageError(
            f"--at is given {counted(len(at), 'time')}, but {len(files)} clips have {counted(len(times), 'join')}"
        )
    names = [f"{clip} {name or ''}".strip() for clip, name in chosen]
    joined = join_motions(
        [source.motion for source in sources],
        at=times or None, window=window, blend=blend, rig=choice.rig, fps=fps or choice.fps, names=names,
    )  # fmt: skip
    made = joined.motion
    whole = sources[0].with_motion(made) if choice.rig is None else choice.clip_of(made, "")
    with choice.as_written():
        outputs.write(replace(whole, name=f"{sources[0].name}-joined"))
        outputs.show(lambda: [MotionView(outputs.file.stem, made)])
    for seam, (first, second) in zip(joined.seams, pairwise(names), strict=True):
        if seam.apart > FAR:
            remark(
                f"{first} and {second}: their poses are {seam.apart:.0f} cm apart; if the join shows, "
                "give better times with --at"
            )
    length = f"{len(made)} frames, {made.seconds:.2f} s at {made.fps:g} fps"
    lines = [f"wrote {display_name(outputs.file)}: {length}"]
    short = [f"{clip.name} {name or ''}".strip() for clip, name in chosen]
    lines += [f"  {seam.sentence(*two)}" for seam, two in zip(joined.seams, pairwise(short), strict=True)]
    facts = {"output": outputs.file, "frames": len(made), "fps": made.fps}
    read = [(clip, source.in_file()) for clip, source in zip(files, sources, strict=True)]
    outputs.report(facts | {"seams": [seam.as_dict() for seam in joined.seams]}, lines, *read)


def _named(clips: Sequence[Path], animations: tuple[str, ...]) -> list[str | None]:
    """The animation to read from each clip: those given, in the order of the files that can have several."""
    from motionkit.rig.read_file import is_gltf

    holders = [number for number, clip in enumerate(clips) if is_gltf(clip)]
    if len(animations) > len(holders):
        raise click.UsageError(
            f"--clip is given {len(animations)} times for {len(holders)} .glb or .vrm files"
        )
    if len(animations) == 1:
        animations = animations * len(holders)
    names: dict[int, str] = dict(zip(holders, animations, strict=False))
    return [names.get(number) for number in range(len(clips))]
