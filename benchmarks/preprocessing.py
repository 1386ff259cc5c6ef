"""Preprocessing with one process against all cores, in seconds per minute of motion.

    python benchmarks/preprocessing.py [folder ...] [--jobs N] [--copies 4]

Without folders the sample clips are taken, copied several times over into a temporary folder, whole
files, without their labels: a handful of clips would measure how long processes take to start.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path

from common import SAMPLE_FOLDER, print_table

from motionkit.data.preprocess import PreprocessOptions, PreprocessReport, preprocess


def copied_samples(folder: Path, copies: int) -> Path:
    """Copy the sample clips several times into separate folders."""
    clips = sorted(SAMPLE_FOLDER.glob("*.bvh"))
    if not clips:
        raise SystemExit(f"{SAMPLE_FOLDER}: no sample clips found; give a folder of BVH files")
    for number in range(copies):
        target = folder / f"motion-{number + 1}"
        target.mkdir(parents=True)
        for clip in clips:
            shutil.copy(clip, target / clip.name)
    return folder


def timed_run(folders: list[Path], output: Path, jobs: int) -> tuple[float, PreprocessReport]:
    """Return seconds and report of one run."""
    began = time.perf_counter()
    report = preprocess(folders, output, PreprocessOptions(jobs=jobs))
    return time.perf_counter() - began, report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="*", type=Path, help="folders of BVH files")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes of the second run")
    parser.add_argument("--copies", type=int, default=4, help="copies of the sample clips")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folders = arguments.folders or [copied_samples(Path(place) / "clips", arguments.copies)]
        # The first run warms the file cache and is not counted.
        timed_run(folders, Path(place) / "warm", 1)
        runs = {jobs: timed_run(folders, Path(place) / f"jobs-{jobs}", jobs) for jobs in (1, arguments.jobs)}
    rows = []
    for jobs, (seconds, report) in runs.items():
        share = seconds / (report.seconds / 60.0)
        rows.append([f"{jobs} job{'s' if jobs > 1 else ''}", f"{seconds:.1f}", f"{share:.2f}"])
    report = runs[1][1]
    title = f"{len(report.files)} files, {report.seconds / 60:.1f} minutes of motion at 60 fps"
    print_table(title, ["processes", "seconds", "seconds per minute of motion"], rows)
    print(f"ratio: {runs[1][0] / runs[arguments.jobs][0]:.2f} with {arguments.jobs} jobs against 1")


if __name__ == "__main__":
    main()
