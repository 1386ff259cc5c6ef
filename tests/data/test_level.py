from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.data.dataset import Dataset
from motionkit.data.diagnosis import diagnose
from motionkit.data.level import TILT, floor_tilt, footfalls, levelled
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.motion.bvh import write_bvh
from motionkit.motion.floor import TOE_HEIGHT, TOES, standing_toes
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_multiply, quat_rotate
from synthetic_motions import make_walk, placed


def steps(slope: tuple[float, float], count: int = 12, height: float = 0.0, seed: int = 0) -> Array:
    """Footfalls (F, 3) over 5 m of a floor of some slope, each off by up to a centimetre."""
    draw = np.random.default_rng(seed)
    x, z = draw.uniform(-250.0, 250.0, (2, count))
    return np.stack([x, height + slope[0] * x + slope[1] * z + draw.uniform(-1.0, 1.0, count), z], axis=1)


def tilted(motion: Motion, degrees: float) -> Motion:
    """The motion on a floor that falls towards +Z by some degrees."""
    turn = np.array([math.cos(math.radians(degrees) / 2), math.sin(math.radians(degrees) / 2), 0.0, 0.0])
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(np.broadcast_to(turn, rotations[:, 0].shape), rotations[:, 0])
    roots = quat_rotate(np.broadcast_to(turn, (len(motion), 4)), motion.root_positions)
    return replace(motion, local_rotations=rotations, root_positions=roots)


def standing_heights(motion: Motion) -> Array:
    """Heights of toes that stand still."""
    toes = motion_kinematics(motion)[1][:, list(TOES)]
    return toes[..., 1][standing_toes(toes, motion.fps) & (toes[..., 1] < TOE_HEIGHT + 12.0)]


def spread(heights: Array) -> float:
    return float(np.quantile(heights, 0.9) - np.quantile(heights, 0.1))


def test_the_slope_of_a_floor_is_found_whatever_the_heights_of_clips_and_feet() -> None:
    groups = [steps((0.0, 0.02), height=height, seed=i) for i, height in enumerate((0.0, 3.0, -5.0))]
    assert floor_tilt(groups) == pytest.approx([0.0, 0.02], abs=0.003)


def test_feet_held_in_the_air_do_not_tilt_a_floor() -> None:
    groups = [steps((0.0, 0.02), seed=i) for i in range(4)]
    groups[0][:3, 1] += 10.0
    assert floor_tilt(groups) == pytest.approx([0.0, 0.02], abs=0.003)


@pytest.mark.parametrize(
    "groups",
    [
        [],
        [np.zeros((0, 3))],
        [steps((0.0, 0.0), seed=i) for i in range(4)],
        [0.05 * steps((0.0, 0.0), seed=i) for i in range(4)],  # all within 25 cm
        [steps((0.0, 1.5 * TILT.steepest), seed=i) for i in range(4)],  # a ramp
        [steps((0.001, 0.001), seed=i) for i in range(4)],
    ],
)
def test_a_level_floor_a_ramp_and_steps_in_one_place_are_left(groups: list[Array]) -> None:
    assert not floor_tilt(groups).any()


def test_a_walk_on_a_tilted_floor_is_levelled() -> None:
    walk = tilted(make_walk(frames=300, turn=0.0), 1.0)
    tilt = floor_tilt(footfalls(walk))
    assert math.hypot(*tilt) == pytest.approx(math.tan(math.radians(1.0)), rel=0.15)
    heights = standing_heights(levelled(walk, tilt))
    assert spread(standing_heights(walk)) > 3.0 * spread(heights)
    assert float(np.median(heights)) == pytest.approx(TOE_HEIGHT, abs=0.5)
    assert levelled(walk, np.zeros(2)) is walk


def test_preprocess_levels_the_floor_of_all_clips_of_a_performer(tmp_path: Path) -> None:
    (tmp_path / "clips" / "walking").mkdir(parents=True)
    for i, yaw in enumerate((0.0, 0.5, math.pi)):
        walk = tilted(placed(make_walk(frames=300, turn=0.0, phase=0.3 * i), yaw), 1.0)
        write_bvh(tmp_path / "clips" / "walking" / f"{i}.bvh", walk)
    uneven = {}
    for name, changes in {"level": {}, "tilted": {"level": False}, "raw": {"smooth": False}}.items():
        preprocess([tmp_path / "clips"], tmp_path / name, PreprocessOptions(jobs=1, mirror=False, **changes))
        data = Dataset(tmp_path / name)
        motions = [data.motion(clip, data.read(clip)) for clip in data.clips]
        uneven[name] = max(spread(standing_heights(motion)) for motion in motions)
        tilts = [file["cleaning"]["tilt"] for file in data.manifest["files"]]
        assert len(tilts) == 3 and all(any(tilt) == (name == "level") and tilt == tilts[0] for tilt in tilts)
    assert uneven["level"] < 0.4 * min(uneven["tilted"], uneven["raw"])


def test_doctor_says_how_much_a_floor_rises(tmp_path: Path) -> None:
    (tmp_path / "walking").mkdir()
    for i, yaw in enumerate((0.0, math.pi)):
        walk = placed(make_walk(frames=300, turn=0.0, phase=0.3 * i), yaw)
        write_bvh(tmp_path / "walking" / f"level-{i}.bvh", walk)
    assert not diagnose([tmp_path]).warnings
    for i, yaw in enumerate((0.0, math.pi)):
        walk = tilted(placed(make_walk(frames=300, turn=0.0, phase=0.3 * i), yaw), 1.0)
        (tmp_path / "walking" / f"level-{i}.bvh").unlink()
        write_bvh(tmp_path / "walking" / f"tilted-{i}.bvh", walk)
    (warning,) = diagnose([tmp_path]).warnings
    assert warning.startswith("the floor under walking/tilted-0.bvh, walking/tilted-1.bvh rises by up to 1.")
    assert warning.endswith(" cm a metre; preprocess levels it")
