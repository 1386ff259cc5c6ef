"""The root's path: standing feet hold it, and it accelerates no harder than recorded bodies do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import length
from motionkit.control.script import TypePart
from motionkit.control.speeds import USUAL, acceleration_limit
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.finish.root_path import corrected_path
from motionkit.metrics.pace import ground_acceleration
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from synthetic_motions import feet_down, make_walk, sliding


def braking(seconds: float, frames: int = 180) -> Motion:
    """A body that glides at 3 m/s and comes to rest within some seconds in the middle."""
    walk = make_walk(frames)
    share = np.clip((np.arange(frames) - frames / 2) / (60.0 * seconds), 0.0, 1.0)
    way = np.cumsum(5.0 * (1.0 - share))
    roots = np.stack([0.6 * way, np.full(frames, 95.0), 0.8 * way], axis=1).astype(np.float32)
    return replace(walk, root_positions=roots)


def eased(motion: Motion, most: float | None) -> Motion:
    """The motion with its acceleration limited, no foot holding it."""
    return corrected_path(motion, np.zeros((len(motion), 4), np.float32), 0.0, most)


def hardest(motion: Motion) -> float:
    return float(ground_acceleration(motion.root_positions, motion.fps).max())


def test_who_brakes_too_hard_begins_earlier_and_ends_in_the_same_place() -> None:
    before = braking(0.3)
    assert hardest(before) > 9.0
    after = eased(before, 6.0)
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
    assert eased(motion, None) is motion
    assert eased(motion, 50.0) is motion


def test_a_motion_that_begins_hard_begins_in_the_same_place() -> None:
    late = braking(0.3)
    motion = late.cut(80, len(late))
    after = eased(motion, 4.0)
    assert np.array_equal(after.root_positions[0], motion.root_positions[0])
    assert hardest(after) < 0.7 * hardest(motion)


def test_the_limit_is_that_of_the_recordings(tiny_model: MotionModel) -> None:
    kinds = tiny_model.type_names
    limits = [acceleration_limit(tiny_model, [kind]) for kind in kinds]
    assert all(limit is not None and limit >= USUAL for limit in limits)
    both = acceleration_limit(tiny_model, kinds)
    assert both is not None and both <= max(limit or 0.0 for limit in limits)
    assert acceleration_limit(tiny_model.with_reference("none"), kinds) is None


def test_what_is_written_keeps_to_the_limits_and_the_raw_motion_does_not() -> None:
    model = load_bundled_model()
    parts = [TypePart("walking", 1.5), TypePart("side-somersault", 2.2), TypePart("walking", 1.0)]
    made = synthesize(model, parts, SynthesisOptions(2, 3, raw=True))
    limit = acceleration_limit(model, [part.type for part in parts])
    assert limit is not None
    for each in made.motions:
        assert each.raw is not None
        # Foot locking comes after the limit, and may shift the hips a little.
        assert hardest(each.motion) < 1.05 * limit < hardest(each.raw)


def test_feet_in_contact_decide_the_way_of_the_root() -> None:
    """A body that glides while both feet are down stays where it is, and goes on when they leave the floor."""
    motion = sliding(90, 12.0)
    contacts = feet_down(90, [(30, 60)], [(30, 60)])
    held, free = corrected_path(motion, contacts, 1.0, None), corrected_path(motion, contacts, 0.0, None)
    way = [float(m.root_positions[59, 2] - m.root_positions[31, 2]) for m in (motion, free, held)]
    assert way[0] > 5.0 and abs(way[1] - way[0]) < 0.1
    assert abs(way[2]) < 0.5 * way[0]
    assert np.allclose(
        np.diff(held.root_positions[70:], axis=0), np.diff(motion.root_positions[70:], axis=0), atol=1e-4
    )


def test_feet_hold_the_root_in_the_frames_that_say_so() -> None:
    motion = sliding(speed=20.0)
    contacts = np.ones((len(motion), 4), np.float32)
    whole, none = (corrected_path(motion, contacts, hold, None).root_positions for hold in (1.0, 0.0))
    assert np.array_equal(corrected_path(motion, contacts, np.ones(len(motion)), None).root_positions, whole)
    half = np.zeros(len(motion), np.float32)
    half[60:] = 1.0
    mixed = corrected_path(motion, contacts, half, None).root_positions[:, ::2]
    assert np.abs(mixed[:60] - none[:60, ::2]).max() < 0.5
    went = [np.linalg.norm(path[-1] - path[60]) for path in (mixed, whole[:, ::2], none[:, ::2])]
    assert went[0] == pytest.approx(went[1], rel=0.1) and went[0] < 0.5 * went[2]
