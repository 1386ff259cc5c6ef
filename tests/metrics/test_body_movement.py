from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.body_movement import body_movement, euler_movement, geodesic_movement
from motionkit.motion.rotations import euler_to_quat, quat_identity

from .conftest import placed, swaying


def turning(axis: int, degrees_per_frame: float, frames: int = 50) -> Array:
    """One of three joints turns about one axis; (T, 3, 4)."""
    euler = np.zeros((frames, 3), np.float64)
    euler[:, "ZYX".index("XYZ"[axis])] = np.deg2rad(np.arange(frames, dtype=np.float64) * degrees_per_frame)
    rotations = quat_identity((frames, 3), np.float64)
    rotations[:, 1] = euler_to_quat(euler, "ZYX")
    return rotations


@pytest.mark.parametrize("kind", ["euler", "geodesic"])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_steady_turn_gives_its_rate_even_through_180_degrees(kind: str, axis: int) -> None:
    result = body_movement(turning(axis, 7.0), kind)
    assert result.value == pytest.approx(7.0, abs=1e-6)
    assert (result.id, result.unit) == (f"bm-{kind}", "deg/frame")


def test_the_middle_euler_angle_folds_at_90_degrees_and_the_geodesic_does_not() -> None:
    through_the_pole = turning(1, 7.0)
    assert geodesic_movement(through_the_pole).sum(-1) == pytest.approx(
        np.full((49,), 7.0, np.float32), abs=1e-6
    )
    # When y passes 90 degrees, both outer angles jump by 180.
    assert float(euler_movement(through_the_pole).max()) > 300.0


def test_joints_add_up_and_stillness_is_zero() -> None:
    two = turning(0, 3.0)
    two[:, 2] = turning(2, 4.0)[:, 1]
    assert body_movement(two).value == pytest.approx(7.0, abs=1e-6)
    assert body_movement(quat_identity((9, 23))).value == 0.0


def test_the_sign_of_a_quaternion_does_not_matter() -> None:
    rotations = swaying().local_rotations
    flipped = rotations * np.where(np.arange(len(rotations)) % 2 == 0, 1.0, -1.0)[:, None, None]
    for kind in ("euler", "geodesic"):
        assert body_movement(flipped, kind).value == pytest.approx(body_movement(rotations, kind).value)


def test_place_and_heading_do_not_matter_but_for_the_euler_angles_of_the_root() -> None:
    motion = swaying()
    turned = placed(motion, yaw=0.5 * math.pi, move=(100.0, 3.0, -40.0))
    moved = placed(motion, move=(100.0, 3.0, -40.0))
    before, after = (
        body_movement(motion.local_rotations, "geodesic"),
        body_movement(turned.local_rotations, "geodesic"),
    )
    assert after.value == pytest.approx(before.value, abs=1e-6)
    assert body_movement(moved.local_rotations).value == body_movement(motion.local_rotations).value
    rest = [euler_movement(each.local_rotations)[:, 1:] for each in (motion, turned)]
    assert np.array_equal(*rest)
    # Documented: facing +X, the root's middle angle stands at the pole.
    roots = [float(euler_movement(each.local_rotations)[:, 0].mean()) for each in (motion, turned)]
    assert roots[1] > 1.5 * roots[0]


def test_refusals() -> None:
    with pytest.raises(MotionkitError, match="at least 2 frames, found 1"):
        body_movement(quat_identity((1, 23)))
    with pytest.raises(MotionkitError, match="unknown kind"):
        body_movement(quat_identity((5, 23)), "matrix")
