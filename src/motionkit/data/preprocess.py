"""Turns folders of BVH files into a dataset folder, in two passes of constant memory.

The first pass reads, retargets, cleans and resamples each file, and computes the mean rotation of every joint. The
second pass encodes the files relative to these means and writes the arrays. Both run on several processes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motionkit.data.first_pass import FPS, NO_STRETCH, FileReport, Prepared, read_files
from motionkit.data.folder import MANIFEST, MOTIONS, may_replace, put_in_place, staging_folder
from motionkit.data.labels import find_sources
from motionkit.data.options import PreprocessOptions
from motionkit.data.second_pass import write_arrays
from motionkit.data.workers import processes_for, worker_processes
from motionkit.errors import DatasetError
from motionkit.files import MAX_TEXT_BYTES


@dataclass
class PreprocessReport:
    """The result of preprocess(); notes name leftovers of an interrupted run and of labels that look wrong."""

    folder: Path
    labels: Path | None
    files: list[FileReport]
    types: dict[str, dict[str, float]]
    clips: int
    seconds: float
    notes: tuple[str, ...] = ()


def preprocess(
    folders: Sequence[str | Path],
    output: str | Path,
    options: PreprocessOptions | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> PreprocessReport:
    """Write a dataset folder from BVH files, atomically; arguments as for motionkit.preprocess.

    Raises:
        DatasetError: no file is usable, a file is inside output, or, with strict, a file is unusable.
    """
    options = options or PreprocessOptions()
    output = Path(output)
    target = Path(os.path.realpath(output))  # a link stays; what it points to is replaced
    if not may_replace(target):
        raise DatasetError(f"{output}: exists and is not a dataset folder; choose another folder")
    sources, table = find_sources([Path(f) for f in folders], options.labels)
    for path in [*map(Path, folders), *(source.path for source in sources)]:
        if Path(os.path.realpath(path)).is_relative_to(target):
            raise DatasetError(f"{path}: is inside the output folder {output}; choose another output folder")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with staging_folder(target) as (staging, notes):
            with worker_processes(processes_for(len(sources), options.jobs)) as each:
                prepared = read_files(sources, staging, options, each, progress)
                manifest, types = write_arrays(prepared, staging, options, each, progress)
            _write_manifest(staging / MANIFEST, manifest)
            _drop_motions(prepared, staging)
            os.chmod(staging, 0o755)
            put_in_place(staging, target)
        files = [item.report for item in prepared]
        doubts = [f"warning: {file.name}: {file.labels}" for file in files if file.labels]
        usable = {file.name for file in files if not file.skipped}
        named = {part.type for each in sources if each.name in usable for part in each.segments}
        doubts += [f"warning: {kind}: left out, for {NO_STRETCH}" for kind in sorted(named - set(types))]
        seconds = sum(file.frames for file in files) / FPS
        clips = len(manifest["clips"])
        return PreprocessReport(output, table, files, types, clips, seconds, (*notes, *doubts))
    except OSError as error:
        raise DatasetError(f"{output}: cannot be written ({error.strerror or error})") from None
    except BrokenProcessPool:
        raise DatasetError(
            f"{output}: a worker process was killed (out of memory?); try fewer --jobs"
        ) from None


def _write_manifest(path: Path, manifest: dict[str, Any]) -> None:
    """Write the manifest; raises DatasetError if Dataset could not read it."""
    try:
        text = json.dumps(manifest, allow_nan=False)
    except ValueError:
        raise DatasetError(f"{path.name}: the data gives values that are not finite") from None
    if len(text) > MAX_TEXT_BYTES:
        raise DatasetError(
            f"{path.name}: larger than {MAX_TEXT_BYTES >> 20} MB; make several smaller datasets"
        )
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _drop_motions(prepared: list[Prepared], staging: Path) -> None:
    for item in prepared:
        Path(item.motion_file).unlink(missing_ok=True)
    (staging / MOTIONS).rmdir()
