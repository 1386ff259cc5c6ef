"""Frames cut out of recordings and filled in again, by motionkit's keys and by interpolation, beside the recording.

python benchmarks/in_between.py [FOLDER with labels.csv] [--model FILE]
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

import motionkit as mk
from motionkit.arrays import Array
from motionkit.control.keys import Key, clip_pose
from motionkit.control.meet import arrival
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.inference.start import INIT_FRAMES
from motionkit.metrics.ground import average_foot_sliding
from motionkit.models.model import MotionModel
from motionkit.motion.floor import foot_positions
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_slerp

GAPS = (0.5, 1.0, 2.0, 3.0)  # s
BEFORE = 30  # frames of the recording before a gap, at least
STEP = 60  # frames between two gaps of a recording


def recordings(folder: Path, model: MotionModel) -> list[tuple[str, Motion]]:
    """Type and motion of the labelled clips of one type that the model knows."""
    out = []
    with (folder / "labels.csv").open() as file:
        for row in csv.DictReader(file):
            path = folder / (row["file"] if row["file"].endswith(".bvh") else f"{row['file']}.bvh")
            if row["type"] in model.types and path.is_file():
                motion = mk.read_canonical(path)
                end = int(row["end_frame"]) if row["end_frame"] else len(motion)
                out.append((row["type"], resample(motion.cut(int(row["start_frame"] or 0), end), model.fps)))
    return out


def filled(
    model: MotionModel, kind: str, clip: Motion, first: int, frames: int
) -> tuple[Motion, float, float]:
    """The frames of a gap and the one after it, made from the frames before and the pose after; and its arrival."""
    pose, place = clip_pose(model, clip, first + frames)
    key = Key(frames / model.fps, pose, position=place[:2], facing=float(place[2]))
    start = clip.cut(max(0, first - INIT_FRAMES), first)
    options = SynthesisOptions(noise=mk.Noise("mean", 0.0), init=start, keys=(key,))
    made = synthesize(model, [TypePart(kind, (frames + 1) / model.fps)], options).motion
    return made, *arrival(made, key)


def interpolated(clip: Motion, first: int, frames: int) -> Motion:
    """The same frames, rotations by slerp and the root along a line."""
    share = (np.arange(1, frames + 2) / (frames + 1)).astype(np.float32)
    before, after = clip.cut(first - 1, first), clip.cut(first + frames, first + frames + 1)
    joints = len(clip.skeleton)
    shape = (frames + 1, joints, 4)
    rotations = quat_slerp(
        np.broadcast_to(before.local_rotations, shape),
        np.broadcast_to(after.local_rotations, shape),
        np.broadcast_to(share[:, None], shape[:2]),
    )
    roots = before.root_positions + share[:, None] * (after.root_positions - before.root_positions)
    return Motion(clip.skeleton, rotations, roots, clip.fps)


def measured(motion: Motion, clip: Motion, first: int, frames: int) -> tuple[float, float, float]:
    """Mean distance of joints from the recording, foot sliding, largest acceleration over the gap and its ends."""
    truth = mk.kinematics(clip)[1].astype(np.float64)
    gap = mk.kinematics(motion)[1].astype(np.float64)[:frames]
    away = np.linalg.norm(gap - truth[first : first + frames], axis=-1).mean()
    whole = np.concatenate([truth[first - 2 : first], gap, truth[first + frames : first + frames + 2]])
    acceleration = np.linalg.norm(np.diff(whole, n=2, axis=0), axis=-1).max() * clip.fps**2 / 100.0
    sliding = average_foot_sliding(foot_positions(whole), 0.0).value
    assert sliding is not None
    return float(away), sliding, float(acceleration)


def gaps(clip: Motion, frames: int) -> list[int]:
    """First frames of the gaps that are cut out of a recording."""
    return list(range(max(BEFORE, 3), len(clip) - frames - 3, STEP))


def table(model: MotionModel, clips: list[tuple[str, Motion]]) -> list[str]:
    """The lines of the table."""
    lines = [
        "| gap, s | gaps | by | distance of joints, cm | foot sliding, cm/frame | largest acceleration, m/s² |",
        "|---|---|---|---|---|---|",
    ]
    worst = 0.0, 0.0
    peaks: dict[
        str, list[tuple[float, float]]
    ] = {}  # by type: largest accelerations of keys and of the recording
    for seconds in GAPS:
        frames = round(seconds * model.fps)
        rows: dict[str, list[tuple[float, float, float]]] = {"keys": [], "interpolation": [], "recording": []}
        for kind, clip in clips:
            for first in gaps(clip, frames):
                made, distance, angle = filled(model, kind, clip, first, frames)
                worst = max(worst[0], distance), max(worst[1], angle)
                rows["keys"].append(measured(made, clip, first, frames))
                rows["interpolation"].append(measured(interpolated(clip, first, frames), clip, first, frames))
                rows["recording"].append(measured(clip.cut(first, first + frames), clip, first, frames))
                peaks.setdefault(kind, []).append((rows["keys"][-1][2], rows["recording"][-1][2]))
        for name, values in rows.items():
            if values:
                mean: Array = np.mean(values, axis=0)
                words = f"{mean[0]:.1f} | {mean[1]:.2f} | {mean[2]:.0f}"
                lines.append(f"| {seconds:g} | {len(values)} | {name} | {words} |")
    for kind, pairs in peaks.items():
        keys, recorded = np.max(pairs, axis=0)
        lines.append(f"\nlargest of all, {kind}: keys {keys:.0f}, recording {recorded:.0f} m/s²")
    lines.append(f"\nat the keys: at most {worst[0]:.2f} cm and {worst[1]:.2f} degrees away")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("examples/data"))
    parser.add_argument("--model", type=Path)
    arguments = parser.parse_args()
    model = mk.load_model(arguments.model)
    print("\n".join(table(model, recordings(arguments.folder, model))))


if __name__ == "__main__":
    main()
