"""Roots that were taken away come back by the feet that stand."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.editing.fix import Repairs, fix_motion
from motionkit.editing.root_from_feet import root_from_feet
from motionkit.export.formats import read_motion
from motionkit.motion.motion import Motion, resample
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.upright import Upright

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"
ONLY = Repairs(glitches=False, trembling=False, floor=False, sliding=False, root_from_feet=True)


def without_root(motion: Motion, how: str) -> Motion:
    """The motion with its root pinned, drifting or shaken."""
    roots, time = motion.root_positions.copy(), np.arange(len(motion), dtype=np.float32)[:, None] / motion.fps
    if how == "pinned":
        roots[:] = roots[0]
    elif how == "drifting":
        roots += time * np.array([20.0, -8.0, -35.0], np.float32)
    else:
        roots += np.sin(time * np.array([3.0, 2.0, 1.0], np.float32)) * 30.0
    return replace(motion, root_positions=roots.astype(np.float32))


def track(motion: Motion) -> np.ndarray:
    return motion.root_positions[:, ::2].astype(np.float64)


@pytest.mark.parametrize("how", ["pinned", "drifting", "shaken"])
@pytest.mark.parametrize(
    ("name", "worst"), [("16_26", 0.04), ("35_01", 0.04), ("16_45", 0.04), ("49_06", 0.06)]
)
def test_recorded_ways_come_back(name: str, worst: float, how: str) -> None:
    clip = Upright.of(resample(read_motion(DATA / f"{name}.bvh"), 60.0)).canonical
    assert clip is not None
    made = root_from_feet(without_root(clip, how))
    true, found = track(clip), track(made)
    length = np.linalg.norm(np.diff(true[::6], axis=0), axis=1).sum()
    assert np.linalg.norm(np.diff(found[::6], axis=0), axis=1).sum() == pytest.approx(length, rel=0.15)
    apart = (found - found.mean(0)) - (true - true.mean(0))
    assert np.linalg.norm(apart, axis=1).mean() < worst * length
    heights = made.root_positions[:, 1] - clip.root_positions[:, 1]
    assert np.abs(heights - np.median(heights)).max() < 12.0


def test_who_jumps_flies() -> None:
    clip = Upright.of(resample(read_motion(DATA / "16_05.bvh"), 60.0)).canonical
    assert clip is not None
    made = root_from_feet(without_root(clip, "pinned"))
    up, found = (float(np.ptp(each.root_positions[:, 1])) for each in (clip, made))
    assert found == pytest.approx(up, abs=8.0) and up > 30.0


def test_fix_moves_the_root_of_any_rig_only_if_told() -> None:
    clip = read_motion(DATA / "35_01.bvh").cut(0, 300)
    pinned = without_root(clip, "pinned")
    told = fix_motion(pinned, ONLY)
    assert np.ptp(track(told.motion), axis=0).max() == pytest.approx(
        np.ptp(track(clip), axis=0).max(), rel=0.15
    )
    (note,) = told.notes
    ways = [
        np.linalg.norm(np.diff(track(Upright.of(each).canonical), axis=0), axis=1).sum() / 100.0
        for each in (told.motion, pinned)
    ]
    said = [float(word) for word in re.findall(r"([\d.]+) m", note)]
    assert note.startswith("root from feet: it goes ") and said == pytest.approx(ways, abs=0.02)
    assert np.ptp(track(fix_motion(pinned).motion), axis=0).max() < 5.0
    again = fix_motion(told.motion, ONLY).motion
    assert np.abs(track(again) - track(told.motion)).max() < 1.0
    snake = Motion(
        Skeleton(("a", "b"), (-1, 0), np.ones((2, 3), np.float32)), clip.local_rotations[:, :2],
        clip.root_positions, 60.0,
    )  # fmt: skip
    assert "its root was left as it is" in " ".join(fix_motion(snake, ONLY).notes)
