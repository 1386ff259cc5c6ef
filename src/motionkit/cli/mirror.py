"""`motionkit mirror`: swaps left and right in a clip or a folder of them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from motionkit.cli.common import EXISTING, PLACE, animation_option, clip_options, json_option
from motionkit.cli.folders import folders
from motionkit.cli.outputs import OutputOptions, display_name
from motionkit.errors import naming


def _one_target(function: Callable) -> Callable:
    """Take the place to write to as TARGET or from -o."""

    @functools.wraps(function)
    def with_target(target: Path | None, output: Path | None = None, **values: Any) -> Any:
        if target is not None and output is not None:
            raise click.UsageError("give one place to write to, as TARGET or with -o")
        return function(target=target or output, **values)

    return with_target


@click.command("mirror")
@click.argument("source", type=EXISTING)
@click.argument("target", required=False, type=PLACE)
@click.option("-o", "--output", type=PLACE, help="The same as TARGET, as in other commands.")
@animation_option
@clip_options
@json_option
@_one_target
@folders("source", "target")
def command(source: Path, target: Path | None, as_json: bool) -> None:
    """Write the mirror image of SOURCE, a clip of any rig, to TARGET: left and right swapped.

    From .bvh to .bvh, the hierarchy, the channels and the digits stay. From a .glb or .vrm to such a file, the mirror
    image is added to its animations. Without TARGET the file is SOURCE-mirrored.bvh in the current folder.
    """
    from motionkit.data.labels import mirrored_type
    from motionkit.export.formats import read_clip
    from motionkit.motion.bvh import bvh_to_motion
    from motionkit.rig.mirror import mirror_file, mirror_motion
    from motionkit.rig.read_file import is_bvh

    output_options = OutputOptions(target, False, as_json)
    output_options.check()
    outputs = output_options.files(f"{source.stem}-mirrored", [source])
    if is_bvh(source) and outputs.file.suffix.lower() == ".bvh":
        motion = bvh_to_motion(mirror_file(source, outputs.file))
    else:
        clip = read_clip(source)
        motion = clip.in_file()
        with naming(source):
            mirrored = clip.with_motion(mirror_motion(clip.motion))
        types = tuple((mirrored_type(kind), seconds) for kind, seconds in clip.types)
        outputs.write(replace(mirrored, name=f"{clip.name}-mirrored", types=types))
    line = f"wrote {display_name(outputs.file)}: the mirror image of {source}"
    outputs.report({"file": source, "output": outputs.file}, [line], (source, motion))
