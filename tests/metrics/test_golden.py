"""Every metric of two committed clips: if any of these values changes, a definition has changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from motionkit.metrics.report import evaluate_files

CLIPS = Path(__file__).resolve().parents[2] / "examples" / "data"

# Two runs of one CMU subject: metric, value of 127_08 (as generated), value of 127_07 (as its ground truth).
RUNS: dict[str, tuple[float | None, float | None]] = {
    "bm-euler": (100.1124, 92.7465),
    "bm-geodesic": (60.6284, 55.7048),
    "afs": (0.313304, 0.188757),
    "afs-ground": (0.112741, 0.0455968),
    "skate-ratio": (0.076923, 0.083333),
    "jerk": (553.535, 449.721),
    "jerk-peak": (6254.85, 5784.61),
    "jerk-area": (651.982, 683.930),
    "penetration-mean": (0.0, 0.0089338),
    "penetration-max": (0.0, 0.270329),
    "leaps": (0.0, 0.0),
    "turn-max": (1671.15, 1054.47),
    "planted-share": (0.285714, 0.3),
    "hover-share": (0.142857, 0.142857),
    "lowest-feet": (3.844761, 3.229674),
    "lowest-hands": (79.39826, 79.94621),
    "lowest-head": (127.81727, 128.71290),
    "lowest-body": (3.844761, 3.229674),
    "flight-acceleration": (None, None),
    "floor-height": (2.763537, 2.101078),
    "ssim-channel": (0.898063, 1.0),
    "ssim-window": (0.968946, 1.0),
    "mpjpe": (6.30459, 0.0),
    "path-mean": (5.56333, 0.0),
    "path-max": (22.78825, 0.0),
    "path-coverage": (1.0, 1.0),
    "location-mean": (10.11618, 0.0),
    "location-20": (0.0857143, 0.0),
    "location-50": (0.0, 0.0),
    "trajectory-20": (1.0, 0.0),
    "trajectory-50": (0.0, 0.0),
    "l2p": (72.2991, 0.0),
    "l2q": (0.760617, 0.0),
    "npss": (0.601961, 0.0),
}

# A cartwheel, alone.
CARTWHEEL: dict[str, float | None] = {
    "bm-euler": 45.79780,
    "bm-geodesic": 30.36268,
    "afs": 0.0689024,
    "afs-ground": 0.0488777,
    "skate-ratio": 0.0,
    "jerk": 1075.5246,
    "jerk-peak": 19653.32,
    "jerk-area": 7996.79,
    "penetration-mean": 0.0549252,
    "penetration-max": 1.1490798,
    "leaps": 0.0,
    "turn-max": 1182.899,
    "planted-share": 0.489627,
    "hover-share": 0.0,
    "lowest-feet": 2.350921,
    "lowest-hands": 7.878369,
    "lowest-head": 54.88961,
    "lowest-body": 2.350921,
    "flight-acceleration": None,
    "floor-height": 0.8450689,
}


def near(value: float | None) -> object:
    """Equal up to the order of float32 sums."""
    return None if value is None else pytest.approx(value, rel=2e-3, abs=2e-4)


def test_a_pair() -> None:
    report = evaluate_files(CLIPS / "127_07.bvh", CLIPS / "127_08.bvh")
    assert (report.frames, report.fps) == (70, 60.0)
    assert [row.id for row in report.rows] == list(RUNS)
    for row in report.rows:
        generated, truth = RUNS[row.id]
        assert row.motion.value == near(generated), row.id
        assert row.ground_truth is not None and row.ground_truth.value == near(truth), row.id


def test_one_clip() -> None:
    report = evaluate_files(CLIPS / "49_06.bvh")
    assert {row.id: row.motion.value for row in report.rows} == {i: near(v) for i, v in CARTWHEEL.items()}
