"""Follow your own path: walk a spiral, then run along a straight line.

python examples/04_follow_path.py -o spiral.bvh
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import motionkit as mk


def spiral(turns: float, radius: float) -> np.ndarray:
    """Return points (N, 2) x, z in cm from the origin outwards."""
    share = np.linspace(0.15, 1.0, int(120 * turns) + 2, dtype=np.float32)
    angle = 2 * np.pi * turns * share
    points = radius * share[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    return points - points[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=float, default=1.5)
    parser.add_argument("--radius", type=float, default=4.0, help="radius of the spiral in metres")
    parser.add_argument("--run", type=float, default=6.0, help="length of the run in metres")
    parser.add_argument("--model", type=Path, help="a model file; the bundled model by default")
    parser.add_argument("-o", "--output", type=Path, default=Path("spiral.bvh"))
    arguments = parser.parse_args()

    # In Python lengths are centimetres; files and options of the command are in metres.
    walk = spiral(arguments.turns, 100.0 * arguments.radius)
    direction = (walk[-1] - walk[-2]) / np.linalg.norm(walk[-1] - walk[-2])
    run = walk[-1] + 100.0 * arguments.run * direction
    parts = [mk.PathPart(walk, "walking", speed=130.0), mk.PathPart(run[None], "running", speed=300.0)]
    path = mk.make_path(parts)

    result = mk.follow_path(path, model=mk.load_model(arguments.model))
    mk.write_bvh(arguments.output, result.motion)
    end = "reached the end" if result.finished else "did not reach the end"
    print(f"wrote {arguments.output}: {result.motion.seconds:.1f} s along {path.length / 100:.1f} m, {end}")
    print(
        f"the root was {result.distance.mean:.2f} cm from the path on average, {result.distance.max:.1f} at most"
    )


if __name__ == "__main__":
    main()
