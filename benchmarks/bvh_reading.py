"""Reading a BVH file into a Motion, against bvhio's own readers.

    python benchmarks/bvh_reading.py [file.bvh] [--frames 1000] [--repeats 5]

Without a file the largest sample clip is read, and without samples a generated one. --frames makes a
file of that many frames from it.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import bvhio
import numpy as np
from common import SAMPLE_FOLDER, print_table, time_in_turn

from motionkit.motion.bvh import BvhFile, bvh_to_motion, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat
from motionkit.motion.skeleton import canonical_skeleton


def generated_file(frames: int) -> BvhFile:
    """Return the motion of a canonical body whose joints swing."""
    skeleton = canonical_skeleton()
    time = np.arange(frames, dtype=np.float64)[:, None, None] / 60.0
    phase = np.arange(len(skeleton) * 3, dtype=np.float64).reshape(1, -1, 3)
    root = np.broadcast_to(np.array([0.0, 95.0, 0.0], np.float32), (frames, 3))
    return motion_to_bvh(
        Motion(skeleton, expmap_to_quat(0.4 * np.sin(time + phase)).astype(np.float32), root, 60.0)
    )


def with_frames(bvh: BvhFile, frames: int) -> BvhFile:
    """Repeat or cut the file's frames to a number of frames."""
    return replace(bvh, values=bvh.values[np.arange(frames) % len(bvh.values)])


def chosen_file(path: Path | None, frames: int | None, folder: Path) -> Path:
    """Return the file to read; a generated one is written to folder."""
    if path is None:
        path = max(SAMPLE_FOLDER.glob("*.bvh"), key=lambda p: p.stat().st_size, default=None)
    if path is not None and frames is None:
        return path
    bvh = generated_file(frames or 1000) if path is None else read_bvh(path)
    made = folder / "benchmark.bvh"
    write_bvh(made, bvh if frames is None else with_frames(bvh, frames))
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, help="the BVH file to read")
    parser.add_argument("--frames", type=int, help="repeat or cut the file to this many frames")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = chosen_file(arguments.file, arguments.frames, Path(folder))
        bvh = read_bvh(path)
        readers = {
            "bvhio readAsHierarchy": lambda: bvhio.readAsHierarchy(str(path)),
            "bvhio readAsBvh with key frames": lambda: bvhio.readAsBvh(str(path)),
            "motionkit read_bvh": lambda: read_bvh(path),
            "motionkit read_bvh + bvh_to_motion": lambda: bvh_to_motion(read_bvh(path)),
        }
        seconds = time_in_turn(list(readers.values()), arguments.repeats)
    slowest, mine = seconds[0], seconds[-1]
    rows = [[name, f"{1000 * s:.1f}", f"{slowest / s:.1f}"] for name, s in zip(readers, seconds, strict=True)]
    title = (
        f"{path.name}: {len(bvh.values)} frames, {len(bvh.skeleton)} joints, {bvh.values.shape[1]} channels"
    )
    print_table(title, ["reader", "ms (median)", "speed-up"], rows)
    print(
        f"ratio: {seconds[0] / mine:.1f} against readAsHierarchy, {seconds[1] / mine:.1f} against readAsBvh"
    )


if __name__ == "__main__":
    main()
