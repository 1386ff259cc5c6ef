"""`motionkit mirror`: left and right exchanged, for a BVH file or a folder of them."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import json_option, print_json, progress_bar, remark, say
from motionkit.errors import MotionkitError


@click.command("mirror")
@click.argument("source", type=click.Path(path_type=Path, exists=True))
@click.argument("target", type=click.Path(path_type=Path))
@click.option("--strict", is_flag=True, help="In a folder, stop at the first file that cannot be mirrored.")
@json_option
def command(source: Path, target: Path, strict: bool, as_json: bool) -> None:
    """Write the mirror image of a BVH file: same hierarchy, same channels, left and right exchanged.

    SOURCE and TARGET are two files, or two folders; then every .bvh file below SOURCE is mirrored into
    the same place below TARGET. Links to folders are followed. What is read is never overwritten: TARGET
    is another file, or a folder outside SOURCE.
    """
    if source.is_dir():
        _mirror_folder(source, target, strict, as_json)
        return
    from motionkit.motion.mirror import mirror_file

    mirror_file(source, target)
    if as_json:
        print_json({"mirrored": [{"file": str(source), "output": str(target)}], "failed": []})
    else:
        say(f"{target}: the mirror image of {source}")


def _mirror_folder(source: Path, target: Path, strict: bool, as_json: bool) -> None:
    from motionkit.motion.mirror import mirror_folder

    mirrored: list[dict[str, str]] = []
    failed: list[dict[str, str]] = []
    with progress_bar() as progress:
        task = progress.add_task("mirroring", total=None)

        def show(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        for path, error in mirror_folder(source, target, strict, show):
            if error is None:
                mirrored.append({"file": str(path), "output": str(target / path.relative_to(source))})
            else:
                failed.append({"file": str(path), "error": str(error)})
    if as_json:
        print_json({"mirrored": mirrored, "failed": failed})
    else:
        say(f"{target}: {len(mirrored)} of {len(mirrored) + len(failed)} files mirrored")
    for fault in failed:
        remark(f"skipped: {fault['error']}")
    if failed:
        raise MotionkitError(f"{len(failed)} of {len(mirrored) + len(failed)} files could not be mirrored")
