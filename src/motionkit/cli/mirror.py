"""`motionkit mirror`: swaps left and right in a BVH file or a folder of them."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import (
    EXISTING,
    PLACE,
    Stages,
    animation_option,
    json_option,
    print_json,
    read_strictly,
    remark,
    say,
    taken_options,
)
from motionkit.cli.outputs import read_again, taken_facts, taken_lines
from motionkit.errors import MotionkitError


@click.command("mirror")
@click.argument("source", type=EXISTING)
@click.argument("target", required=False, type=PLACE)
@click.option("-o", "--output", type=PLACE, help="TARGET, as other commands have it.")
@click.option(
    "--strict",
    is_flag=True,
    callback=read_strictly,
    help="Settle no fault of a file; in folders, stop at the first.",
)
@animation_option
@taken_options
@json_option
def command(source: Path, target: Path | None, output: Path | None, strict: bool, as_json: bool) -> None:
    """Write the mirror image of a BVH file: same hierarchy and channels, left and right swapped.

    SOURCE and TARGET are two files or two folders. In folders, every .bvh file below SOURCE is mirrored to
    the same place below TARGET; links to folders are followed. From a .glb or .vrm to such a file, the mirror
    image is added to its animations. TARGET must be another file, or a folder outside SOURCE: the command never
    overwrites its input.
    """
    if (target is None) == (output is None):
        raise click.UsageError("give one place to write to, as TARGET or with -o")
    target = target or output
    assert target is not None
    if source.is_dir():
        _mirror_folder(source, target, strict, as_json)
        return
    from motionkit.rig.read_file import is_bvh

    if not is_bvh(source):
        _mirror_clip(source, target)
    else:
        from motionkit.rig.mirror import mirror_file

        mirror_file(source, target)
    read = read_again(source)
    if as_json:
        facts = {"file": str(source), "output": str(target), "taken": taken_facts(read)}
        print_json({"mirrored": [facts], "failed": []})
    else:
        for line in (f"wrote {target}: the mirror image of {source}", *taken_lines(read)):
            say(line)


def _mirror_clip(source: Path, target: Path) -> None:
    """Write the mirror image of a clip that is not BVH; of an animation of a .glb or .vrm into that file."""
    from dataclasses import replace

    from motionkit.cli.outputs import naming
    from motionkit.export.formats import check_ending, read_clip, write_motion
    from motionkit.files import check_outputs
    from motionkit.rig.mirror import mirror_motion

    check_ending(target)
    check_outputs([target], [source])
    clip = read_clip(source)
    with naming(source):
        mirrored = mirror_motion(clip.motion)
    write_motion(target, replace(clip.with_motion(mirrored), name=f"{clip.name}-mirrored"))


def _mirror_folder(source: Path, target: Path, strict: bool, as_json: bool) -> None:
    from motionkit.rig.mirror import mirror_folder

    with Stages() as show:
        found = list(mirror_folder(source, target, strict, show.count("mirroring")))
    mirrored = [
        {"file": path, "output": target / path.relative_to(source)} for path, error in found if not error
    ]
    failed = [{"file": path, "error": str(error)} for path, error in found if error]
    if as_json:
        print_json({"mirrored": mirrored, "failed": failed})
    else:
        say(f"{target}: {len(mirrored)} of {len(found)} files mirrored")
    for fault in failed:
        remark(f"skipped: {fault['error']}")
    if failed:
        raise MotionkitError(f"{len(failed)} of {len(found)} files could not be mirrored")
