"""Response of the metrics to one degradation at a time: the table in docs/metrics.md.

python benchmarks/metric_response.py [CLIP.bvh]
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.metrics.report import evaluate_motion
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import expmap_to_quat, quat_multiply, quat_slerp
from motionkit.rig.canonical import load_canonical

WALK = Path(__file__).resolve().parents[1] / "examples" / "data" / "35_01.bvh"
COLUMNS = (
    ("bm-euler", ".1f"), ("afs", ".3f"), ("skate-ratio", ".2f"), ("jerk", ".0f"), ("ssim-channel", ".3f"),
    ("ssim-window", ".3f"), ("mpjpe", ".1f"), ("path-mean", ".1f"), ("path-coverage", ".2f"),
)  # fmt: skip


def harmed(motion: Motion) -> dict[str, Motion]:
    """Return the motion and its degraded versions."""
    turns, places, frames = motion.local_rotations, motion.root_positions, len(motion)
    first = np.broadcast_to(turns[:1], turns.shape)
    shakes = 0.02 * np.random.default_rng(0).standard_normal((frames, turns.shape[1], 3), np.float32)
    fast, aside = places.copy(), places.copy()
    fast[:, ::2] += 0.2 * (places[:, ::2] - places[0, ::2])
    ahead = places[-1, ::2] - places[0, ::2]
    across = np.stack([-ahead[1], ahead[0]]) / np.linalg.norm(ahead)
    aside[:, ::2] += across * np.linspace(0.0, 40.0, frames, dtype=np.float32)[:, None]
    return {
        "itself": motion,
        "all joints tremble (0.02 rad)": replace(
            motion, local_rotations=quat_multiply(turns, expmap_to_quat(shakes))
        ),
        "pose frozen, root moves on": replace(motion, local_rotations=first.copy()),
        "halfway to its first pose": replace(
            motion, local_rotations=quat_slerp(turns, first, np.array(0.5, np.float32))
        ),
        "root 20 % too fast": replace(motion, root_positions=fast),
        "drifts 40 cm sideways": replace(motion, root_positions=aside),
        "five frames late": replace(motion, local_rotations=np.concatenate([first[:5], turns[:-5]])),
    }


def main() -> None:
    """Print the table."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else WALK
    motion = resample(load_canonical(path)[0], 60.0)
    print(f"{path.name}, {len(motion)} frames at 60 fps, against versions with one degradation each\n")
    print("| |", " | ".join(name for name, _ in COLUMNS), "|")
    print("|" + "---|" * (len(COLUMNS) + 1))
    for name, harm in harmed(motion).items():
        values = {row.id: row.motion.value for row in evaluate_motion(harm, motion).rows}
        print(f"| {name} |", " | ".join(format(values[key], form) for key, form in COLUMNS), "|")


if __name__ == "__main__":
    main()
