from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.metrics.prediction import mean_position_error
from motionkit.metrics.similarity import joint_expmaps, structural_similarity
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_to_expmap

from .conftest import placed, swaying


def naive_ssim(x: np.ndarray, y: np.ndarray, by_channel: bool) -> float:
    """The definition, written with loops; x generated, y ground truth."""
    low, spread = y.min(), y.max() - y.min()
    x, y = x - low, y - low
    c1, c2 = (0.01 * spread) ** 2, (0.03 * spread) ** 2
    scores = []
    for start in range(len(x) - 10):
        a, b = x[start : start + 11], y[start : start + 11]
        pairs = [(a[:, c], b[:, c]) for c in range(a.shape[1])] if by_channel else [(a.ravel(), b.ravel())]
        for u, v in pairs:
            mu, mv = u.mean(), v.mean()
            cov = ((u - mu) * (v - mv)).mean()
            scores.append(
                (2 * mu * mv + c1) * (2 * cov + c2) / ((mu**2 + mv**2 + c1) * (u.var() + v.var() + c2))
            )
    return float(np.mean(scores))


@pytest.mark.parametrize("kind", ["window", "channel"])
def test_equal_sequences_give_one(motion: Motion, kind: str) -> None:
    maps = joint_expmaps(motion)
    assert structural_similarity(maps, maps, kind).value == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("kind", ["window", "channel"])
@pytest.mark.parametrize("block", [500, 7])
def test_matches_the_definition_written_with_loops(
    kind: str, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether windows are compared all at once or by blocks."""
    monkeypatch.setattr("motionkit.metrics.similarity._BLOCK", block)
    draw = np.random.default_rng(1)
    a, b = draw.standard_normal((2, 30, 5), np.float64)
    expected = naive_ssim(a, b, kind == "channel")
    assert structural_similarity(a, b, kind).value == pytest.approx(expected, abs=1e-12)


def test_falls_as_motions_part(motion: Motion) -> None:
    maps = joint_expmaps(motion)
    noise = np.random.default_rng(0).standard_normal(maps.shape, np.float64)
    for kind in ("window", "channel"):
        scores = [structural_similarity(maps + s * noise, maps, kind).value for s in (0.0, 0.02, 0.1, 0.5)]
        assert scores == sorted(scores, reverse=True) and scores[-1] < 0.8


def test_place_and_heading_do_not_matter(motion: Motion) -> None:
    turned = placed(motion, yaw=2.5, move=(300.0, 0.0, 10.0))
    assert joint_expmaps(turned) == pytest.approx(joint_expmaps(motion), abs=1e-6)


def test_every_joint_has_its_columns(motion: Motion) -> None:
    below = quat_to_expmap(motion.local_rotations[:, 1:].astype(np.float64)).reshape(len(motion), -1)
    assert joint_expmaps(motion)[:, 3:] == pytest.approx(below, abs=1e-12)


def test_twelve_frames_are_enough_and_eleven_are_refused(motion: Motion) -> None:
    maps = joint_expmaps(motion)
    assert structural_similarity(maps[:12], maps[:12]).value == pytest.approx(1.0)
    with pytest.raises(MotionkitError, match="at least 12 frames, found 11"):
        structural_similarity(maps[:11], maps[:11])


def test_ssim_refusals() -> None:
    a = np.zeros((20, 3), np.float32)
    with pytest.raises(MotionkitError, match="is constant"):
        structural_similarity(a, a)
    with pytest.raises(MotionkitError, match="equal shapes"):
        structural_similarity(a, np.zeros((21, 3), np.float32))
    with pytest.raises(MotionkitError, match="unknown kind"):
        structural_similarity(a, a, "image")


def test_mpjpe_ignores_the_root_and_keeps_the_heading(motion: Motion) -> None:
    here = motion_kinematics(motion)[1]
    moved = motion_kinematics(placed(motion, move=(50.0, -3.0, 20.0)))[1]
    turned = motion_kinematics(placed(motion, yaw=math.pi))[1]
    assert mean_position_error(here, here).value == 0.0
    assert mean_position_error(moved, here).value == pytest.approx(0.0, abs=1e-4)
    assert mean_position_error(turned, here).value > 10.0


def test_mpjpe_of_one_joint_off(motion: Motion) -> None:
    here = motion_kinematics(motion)[1]
    other = here.copy()
    other[:, 7] += np.array([3.0, 0.0, 4.0], np.float32)
    assert mean_position_error(other, here).value == pytest.approx(5.0 / 23)


def test_mpjpe_refusals() -> None:
    for a, b in (
        (np.zeros((3, 23, 3), np.float32), np.zeros((4, 23, 3), np.float32)),
        (np.zeros((0, 23, 3), np.float32), np.zeros((0, 23, 3), np.float32)),
    ):
        with pytest.raises(MotionkitError):
            mean_position_error(a, b)


def test_both_turned_together_give_the_same_mpjpe() -> None:
    a, b = swaying(seed=1), swaying(seed=2)
    errors = [
        mean_position_error(*(motion_kinematics(replace(placed(m, yaw=yaw)))[1] for m in (a, b))).value
        for yaw in (0.0, 1.3)
    ]
    assert errors[0] == pytest.approx(errors[1], abs=1e-4)
