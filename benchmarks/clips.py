"""How well clips are repaired, looped and joined: figures before and after, for BVH and for the same clips as GLB.

    python benchmarks/clips.py [PATH ...] [--most 30] [--pairs 40] [--seed 0]

Every file, or --most of them spread over each folder, is repaired and looped; --pairs random stretches of four seconds
are joined. The baseline of a repair is the source, that of a loop the largest step between its frames, that of a join
the rest of its frames.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from common import SAMPLE_FOLDER, print_table

import motionkit as mk
from motionkit.editing.join import BLEND, Joined
from motionkit.errors import MotionkitError
from motionkit.files import files_below
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion

STRETCH = 4.0  # s of a clip that is joined to another
BESIDE = 0.1  # s before a join that count as the join


def clips(paths: Iterable[Path], most: int) -> dict[str, Motion]:
    """Return the motions that can be read, by name; a file that cannot is one line."""
    found = {}
    for path in paths:
        files = [path] if path.is_file() else files_below(path, ".bvh")
        for file in files[:: max(1, -(-len(files) // most))]:
            try:
                found[file.name] = mk.read(file)
            except MotionkitError as error:
                print(f"refused: {error}")
    return found


def as_glb(motions: dict[str, Motion]) -> dict[str, Motion]:
    """Return the motions as they are read from a GLB file of each."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, motion in motions.items():
            path = Path(folder, "clip.glb")
            mk.write(path, motion)
            found[name] = mk.read(path)
    return found


def repairs(motions: dict[str, Motion]) -> list[list[str]]:
    """Repair all; return a row for each measured quantity."""
    made = [mk.fix_motion(motion) for motion in motions.values()]
    rows = []
    for name in [each.name for each in max(made, key=lambda one: len(one.table)).table]:
        here = [each for one in made for each in one.table if each.name == name]
        known = [(each.before, each.after) for each in here if None not in (each.before, each.after)]
        before, after = np.array(known, float).T
        worse = "" if "height" in name else str(int((after > 1.02 * before + 1e-3).sum()))
        figures = [f"{value:.3g}" for value in (before.mean(), after.mean(), before.max(), after.max())]
        rows.append([f"{name}, {here[0].unit}".rstrip(", "), str(len(known)), *figures, worse])
    return rows


def loops(motions: dict[str, Motion]) -> list[list[str]]:
    """Close all; return the row of the table."""
    made = []
    for motion in motions.values():
        try:
            made.append(mk.make_loop(motion))
        except MotionkitError:
            continue
    if not made:
        return []
    seams = np.array([(one.seam.distance, one.seam.frame_distance, one.seconds) for one in made])
    (gap, _, seconds), (worst, *_) = np.median(seams, axis=0), seams.max(axis=0)
    larger = int((seams[:, 0] > seams[:, 1]).sum())
    counts = [str(len(motions)), str(len(motions) - len(made))]
    return [[*counts, f"{seconds:.2f}", f"{gap:.3f}", f"{worst:.3f}", str(larger)]]


def joins(motions: Sequence[Motion], pairs: int, seed: int) -> list[list[str]]:
    """Join random stretches; return the row of the table."""
    random = np.random.default_rng(seed)
    long = [motion for motion in motions if len(motion) > STRETCH * motion.fps]
    made, jerks, refused = [], [], 0
    for _ in range(pairs if long else 0):
        both = [long[number] for number in random.integers(len(long), size=2)]
        starts = [int(random.integers(len(each) - round(STRETCH * each.fps))) for each in both]
        cut = [each.cut(a, a + round(STRETCH * each.fps)) for each, a in zip(both, starts, strict=True)]
        try:
            one = mk.join(cut)
        except MotionkitError:
            refused += 1
            continue
        made.append(one)
        jerks.append(jerk_beside(one))
    if not made:
        return []
    slides = np.array([one.seams[0].sliding for one in made if one.seams[0].sliding])
    middle, high = np.quantile(jerks, [0.5, 0.9])
    apart = np.median([one.seams[0].apart for one in made])
    before, held = np.median(slides, axis=0) if len(slides) else (np.nan, np.nan)
    row = [
        str(pairs),
        str(refused),
        f"{apart:.1f}",
        f"{middle:.2f}",
        f"{high:.2f}",
        f"{before:.0f}",
        f"{held:.0f}",
    ]
    return [row]


def jerk_beside(joined: Joined) -> float:
    """Return the mean jerk around a join as a share of that of the other frames."""
    motion, frame = joined.motion, joined.seams[0].frame
    third = np.linalg.norm(np.diff(motion_kinematics(motion)[1], 3, axis=0), axis=-1).mean(axis=1)
    first, end = (frame + round(seconds * motion.fps) for seconds in (-BESIDE, BLEND))
    rest = np.concatenate([third[: max(first, 0)], third[end:]])
    return float(third[max(first, 0) : end].mean() / rest.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, default=[SAMPLE_FOLDER])
    parser.add_argument("--most", type=int, default=30, help="files of each folder")
    parser.add_argument("--pairs", type=int, default=40, help="joins")
    parser.add_argument("--seed", type=int, default=0, help="of the pairs")
    arguments = parser.parse_args()
    read = clips(arguments.paths, arguments.most)
    for form, motions in (("BVH", read), ("GLB", as_glb(read))):
        heads = ["", "clips", "before", "after", "worst before", "worst after", "worse"]
        print_table(f"{form}: repairs", heads, repairs(motions))
        heads = ["clips", "refused", "seconds", "seam, cm", "worst", "above a step"]
        print_table(f"{form}: loops", heads, loops(motions))
        heads = ["pairs", "refused", "apart, cm", "jerk beside", "worst tenth", "sliding, cm/s", "held"]
        print_table(f"{form}: joins", heads, joins(list(motions.values()), arguments.pairs, arguments.seed))


if __name__ == "__main__":
    main()
