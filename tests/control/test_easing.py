"""Whole motions brake, push off and turn their joints no harder than recorded bodies do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import length
from motionkit.control.easing import TURN, USUAL, acceleration_limit, eased_turns, eased_way
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.metrics.leaps import fastest_turn
from motionkit.metrics.pace import ground_acceleration
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_multiply
from motionkit.motion.skeleton import FOOT_JOINTS
from synthetic_motions import make_walk

FOOT = FOOT_JOINTS[0]


def braking(seconds: float, frames: int = 180) -> Motion:
    """A body that glides at 3 m/s and comes to rest within some seconds in the middle."""
    walk = make_walk(frames)
    share = np.clip((np.arange(frames) - frames / 2) / (60.0 * seconds), 0.0, 1.0)
    way = np.cumsum(5.0 * (1.0 - share))
    roots = np.stack([0.6 * way, np.full(frames, 95.0), 0.8 * way], axis=1).astype(np.float32)
    return replace(walk, root_positions=roots)


def hardest(motion: Motion) -> float:
    return float(ground_acceleration(motion.root_positions, motion.fps).max())


def test_who_brakes_too_hard_begins_earlier_and_ends_in_the_same_place() -> None:
    before = braking(0.3)
    assert hardest(before) > 9.0
    after = eased_way(before, 6.0)
    assert hardest(after) == pytest.approx(6.0, rel=0.01)
    moved = after.root_positions - before.root_positions
    assert 1.0 < np.abs(moved).max() < 5.0 and not moved[:, 1].any()
    assert np.abs(moved[:40]).max() < 0.01 and np.abs(moved[-40:]).max() < 0.01
    assert np.array_equal(after.local_rotations, before.local_rotations)
    jerk = [length(np.diff(m.root_positions.astype(np.float64), 3, axis=0)).max() for m in (before, after)]
    assert jerk[1] <= 1.01 * jerk[0], "no corner where the way begins to differ"


@pytest.mark.parametrize("frames", [20, 180])
def test_what_is_slow_or_short_or_has_no_recordings_stays(frames: int) -> None:
    motion = braking(0.3, frames)
    assert eased_way(motion, None) is motion
    assert eased_way(motion, 50.0) is motion


def test_a_motion_that_begins_hard_begins_in_the_same_place() -> None:
    late = braking(0.3)
    motion = late.cut(80, len(late))
    after = eased_way(motion, 4.0)
    assert np.array_equal(after.root_positions[0], motion.root_positions[0])
    assert hardest(after) < 0.7 * hardest(motion)


def test_the_limit_is_that_of_the_recordings(tiny_model: MotionModel) -> None:
    kinds = tiny_model.type_names
    limits = [acceleration_limit(tiny_model, [kind]) for kind in kinds]
    assert all(limit is not None and limit >= USUAL for limit in limits)
    both = acceleration_limit(tiny_model, kinds)
    assert both is not None and both <= max(limit or 0.0 for limit in limits)
    assert acceleration_limit(tiny_model.with_reference("none"), kinds) is None


def spinning(step: float, frames: int = 90) -> Motion:
    """A walk one of whose feet turns by half a turn in the middle, by up to `step` degrees a frame."""
    walk = make_walk(frames)
    ramp = np.deg2rad(np.clip((np.arange(frames) - 45.0) * step, 0.0, 180.0))
    spin = expmap_to_quat(ramp[:, None] * np.array([0.6, 0.0, 0.8]))
    turns = walk.local_rotations.copy()
    turns[:, FOOT] = quat_multiply(turns[:, FOOT], spin)
    return replace(walk, local_rotations=turns)


def test_a_joint_that_spins_too_fast_turns_over_more_frames() -> None:
    before = spinning(45.0)
    assert (fastest_turn(before.local_rotations).value or 0.0) > 2600.0
    after = eased_turns(before)
    assert (fastest_turn(after.local_rotations).value or 0.0) == pytest.approx(TURN, rel=0.005)
    others = np.delete(np.arange(before.local_rotations.shape[1]), FOOT)
    assert np.array_equal(after.local_rotations[:, others], before.local_rotations[:, others])
    apart = np.abs(after.local_rotations[:, FOOT] - before.local_rotations[:, FOOT]).max(axis=1)
    assert apart[:35].max() < 1e-3 and apart[58:].max() < 1e-3, "only near the spin"


def test_recorded_turns_stay() -> None:
    motion = spinning(20.0)
    assert eased_turns(motion) is motion


def test_what_is_written_keeps_to_the_limits_and_the_raw_motion_does_not() -> None:
    model = load_bundled_model()
    parts = [TypePart("walking", 1.5), TypePart("side-somersault", 2.2), TypePart("walking", 1.0)]
    made = synthesize(model, parts, SynthesisOptions(2, 3, raw=True))
    limit = acceleration_limit(model, [part.type for part in parts])
    assert limit is not None
    for each in made.motions:
        assert each.raw is not None
        assert hardest(each.motion) < 1.02 * limit < hardest(each.raw)
        fastest, raw_fastest = (fastest_turn(m.local_rotations).value or 0.0 for m in (each.motion, each.raw))
        assert fastest < 1.03 * TURN < raw_fastest
