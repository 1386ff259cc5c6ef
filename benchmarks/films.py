"""Time to write GIFs and films of one to six figures, relative to the length of the motion.

    python benchmarks/films.py [--width 480] [--figures 1 3 6]

Everything runs on one core, ffmpeg too; reading the BVH files counts, starting Python does not.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import torch
from common import SAMPLE_FOLDER, print_table

from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.view.figure_data import MotionView
from motionkit.view.film import write_film

CLIPS = ("49_06", "49_07", "49_08", "16_45", "35_01", "16_05")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--figures", type=int, nargs="+", default=[1, 3, 6])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        write_film(Path(folder) / "warm.gif", shown_clips(1), 160)
        for ending in ("gif", "mp4"):
            for count in arguments.figures:
                began, used = time.perf_counter(), os.times()
                clips = shown_clips(count)
                write_film(Path(folder) / f"film.{ending}", clips, arguments.width)
                wall, now = time.perf_counter() - began, os.times()
                cpu = sum(now[:4]) - sum(used[:4])  # includes ffmpeg
                length = max(len(clip.motion) / clip.motion.fps for clip in clips)
                rows.append(
                    [
                        f".{ending}, {count} figure{'s' if count > 1 else ''}",
                        f"{length:.1f}",
                        f"{wall:.1f}",
                        f"{cpu:.1f}",
                        f"{wall / length:.2f}",
                        f"{cpu / length:.2f}",
                    ]
                )
    header = ["film", "length s", "wall s", "processor s", "wall / length", "processor / length"]
    print_table(f"films {arguments.width} pixels wide, on one core", header, rows)


def shown_clips(count: int) -> list[MotionView]:
    """Read the first sample clips again."""
    return [
        MotionView(name, bvh_to_motion(read_bvh(SAMPLE_FOLDER / f"{name}.bvh")))
        for name in (CLIPS[n % len(CLIPS)] for n in range(count))
    ]


if __name__ == "__main__":
    main()
