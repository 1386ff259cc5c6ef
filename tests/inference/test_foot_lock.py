"""Feet held still frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Floats
from motionkit.features.layout import DEFAULT_LAYOUT, FEATURE_COUNT, feature_layout
from motionkit.inference import height_correction
from motionkit.inference.frame_arrays import BodyArrays
from motionkit.inference.frame_kernel import PoseKernel
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.leg_ik import ANKLES, HIPS, HOLD, KNEES, LOCK, TOE, TOES
from motionkit.motion.rotations import expmap_to_quat, quat_identity, quat_to_sixd
from motionkit.motion.skeleton import PARENTS, canonical_skeleton

COLUMNS = feature_layout(DEFAULT_LAYOUT)


@pytest.fixture(autouse=True)
def feet_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bodies are not raised, only their feet are held."""
    monkeypatch.setattr(height_correction, "PACE", 0.0)
    monkeypatch.setattr(height_correction, "LIFT", 0.0)


def bent_pose(count: int, seed: int = 0) -> Floats:
    """Exponential maps (count, 23, 3) of people with bent knees."""
    turns = np.random.default_rng(seed).normal(0.0, 0.05, (count, 23, 3)).astype(np.float32)
    turns[:, HIPS, 0] -= 0.5
    turns[:, KNEES, 0] += 0.9
    turns[:, ANKLES, 0] -= 0.4
    return turns


class Glider:
    """People who hold a pose and glide over the floor, their toes at a height of their own size."""

    def __init__(
        self, count: int = 1, sizes: tuple[float, ...] = (1.0,), height: float = TOE.standing
    ) -> None:
        self.scale = np.array([sizes[i % len(sizes)] for i in range(count)], np.float32)
        self.offsets = self.scale[:, None, None] * canonical_skeleton().offsets
        self.kernels = [self._kernel(count, feet) for feet in (True, False)]
        feet = self.kernels[0].body.feet
        assert feet is not None
        self.feet = feet
        self.feet.root.hold[:] = 0.0
        self.pose, self.place = bent_pose(count), np.zeros((count, 3), np.float32)
        self.stand(height)

    def _kernel(self, count: int, feet: bool) -> PoseKernel:
        body = BodyArrays.of(count, feet)
        for index in range(count):
            body.put(index, self.offsets[index], float(self.scale[index]))
        return PoseKernel(DEFAULT_LAYOUT, quat_identity((23,)), body)

    def _joints(self) -> Floats:
        return forward_kinematics(expmap_to_quat(self.pose), self.place, self.offsets, PARENTS)[1]

    def stand(self, height: float) -> None:
        """Put the lower toe at a height of a body of size one."""
        lowest = self._joints()[:, TOES, 1].min(axis=-1) - self.place[:, 1]
        self.place[:, 1] = height * self.scale - lowest

    def step(self, velocity: float, contact: float) -> tuple[Floats, Floats]:
        """Shown and predicted positions of the next frame, checked to belong to the shown rotations."""
        self.place[:, 2] += velocity * self.scale
        count, own = len(self.place), self.place / self.scale[:, None]
        features = np.zeros((count, FEATURE_COUNT), np.float32)
        features[:, COLUMNS.blocks["root_rotation"]] = quat_to_sixd(expmap_to_quat(self.pose[:, 0]))
        features[:, COLUMNS.blocks["joint_rotations"]] = self.pose[:, 1:].reshape(count, -1)
        features[:, COLUMNS.root_height] = own[:, 1]
        ground = np.stack([own[:, 0], own[:, 2], np.zeros(count, np.float32)], axis=1)
        contacts = np.full((count, 4), contact, np.float32)
        (turns, root, shown), (_, _, plain) = (k.pose(features, contacts, ground) for k in self.kernels)
        _, again = forward_kinematics(turns, root, self.offsets, PARENTS)
        assert np.abs(again - shown).max() < 2e-2, "positions are those of the rotations"
        return shown, plain


def test_without_contact_nothing_changes() -> None:
    glider = Glider(3)
    for _ in range(20):
        shown, plain = glider.step(1.0, 0.0)
        assert np.array_equal(shown, plain)


def test_a_touching_toe_comes_to_rest_and_stays() -> None:
    glider = Glider(2, (1.0, 0.8))
    toes = np.stack([glider.step(0.5, 0.9)[0][:, TOES][..., ::2] for _ in range(15)])
    steps = np.linalg.norm(np.diff(toes, axis=0), axis=-1)
    assert steps[LOCK.brake_frames + 1 :].max() < 1e-2
    assert (np.diff(steps[: LOCK.brake_frames + 1], axis=0) < 1e-2).all(), "braked, not stopped at once"
    assert steps[0].min() > 0.1


def test_letting_go_is_gradual() -> None:
    glider = Glider()
    for _ in range(12):
        glider.step(0.5, 0.9)
    gaps = []
    for _ in range(LOCK.ease_frames + 4):
        shown, plain = glider.step(0.5, 0.0)
        gaps.append(float(np.abs(shown - plain)[:, TOES][..., ::2].max()))
    assert gaps[0] > 1.0 and gaps[-1] < 1e-3
    assert np.abs(np.diff(gaps)).max() < 0.35 * gaps[0]


def test_feet_that_slide_far_take_new_places_by_steps_one_after_the_other() -> None:
    glider = Glider(2, (1.0, 1.5))
    gaps, heights = [], []
    for _ in range(90):
        shown, plain = glider.step(0.5, 0.9)
        gaps.append(np.linalg.norm((shown - plain)[:, TOES][..., ::2], axis=-1) / glider.scale[:, None])
        heights.append(shown[:, TOES, 1] / glider.scale[:, None])
    gap, height = np.stack(gaps), np.stack(heights)  # (T, 2, 2)
    assert gap[..., 0].max() < LOCK.max_slide + 1.5 and gap.max() < LOCK.max_wait * LOCK.max_slide + 1.5
    for foot in range(2):
        assert (gap[20:, :, foot].min(axis=0) < 1.5).all()
    up = height > TOE.standing + TOE.slack + 1.0
    assert (up.sum(axis=0) > 5).all() and not (up[..., 0] & up[..., 1]).any()
    assert height.max() < TOE.standing + TOE.slack + LOCK.step_height + 0.1


def test_hips_come_down_for_a_leg_that_is_too_short() -> None:
    glider = Glider()
    glider.pose[:] = 0.0
    glider.stand(TOE.standing)
    heights = [float(glider.step(0.9, 0.9)[0][0, 0, 1]) for _ in range(12)]
    assert heights[-1] < heights[0] - 0.05
    for _ in range(80):
        shown, plain = glider.step(0.0, 0.0)
    assert np.abs(shown - plain).max() < 1e-3, "and go up again"


def test_toes_rise_to_where_standing_ones_are_and_out_of_the_floor() -> None:
    sizes = (1.0, 0.8)
    middle = 0.5 * (TOE.lowest + TOE.swing)
    for contact, speed, lowest in (
        (0.9, 0.2, TOE.standing - TOE.slack),
        (0.1, 0.0, TOE.lowest),
        (0.1, 0.5 * TOE.fast, middle),
        (0.1, 2.0 * TOE.fast, TOE.swing),
    ):
        glider = Glider(2, sizes, height=0.5)
        toes = np.stack([glider.step(speed, contact)[0][:, TOES, 1] for _ in range(30)])
        for number, size in enumerate(sizes):
            assert abs(toes[-1, number].min() - lowest * size) < 0.05
        assert np.diff(toes, axis=0).max() < 0.6 * lowest, "not at once"


def test_toes_in_contact_come_down() -> None:
    glider = Glider(1, height=TOE.standing + 4.0)
    toes = np.stack([glider.step(0.0, 0.9)[0][:, TOES, 1] for _ in range(60)])
    assert abs(toes[-1].min() - TOE.standing - TOE.slack) < 0.05
    assert np.abs(np.diff(toes, axis=0)).max() < 1.2, "not at once"


def test_feet_in_contact_hold_the_root() -> None:
    held, free = Glider(2, (1.0, 0.8)), Glider(2, (1.0, 0.8))
    held.feet.root.hold[:] = 1.0
    for glider in (held, free):
        for _ in range(30):
            glider.step(0.4, 0.9)
    reached = 1.0 - (1.0 - HOLD.pace) ** np.arange(1, 30)
    expected = -reached.sum() * 0.4 / (1.0 + (0.4 / 2.0) ** 2) * held.scale
    assert (
        np.allclose(held.feet.root.carry[:, 1], expected, rtol=1e-3)
        and np.abs(held.feet.root.carry[:, 0]).max() < 1e-3
    )
    assert not free.feet.root.carry.any()
    carried = held.feet.root.carry.copy()
    for _ in range(60):
        held.step(0.4, 0.1)
    rest = -(1.0 - HOLD.pace) / HOLD.pace * reached[-1] * 0.4 / (1.0 + (0.4 / 2.0) ** 2) * held.scale
    assert np.allclose(held.feet.root.carry[:, 1] - carried[:, 1], rest, rtol=1e-3), (
        "feet in the air let go softly"
    )


def test_characters_do_not_touch_each_other_and_forget_on_reset() -> None:
    alone, both = Glider(1), Glider(2)
    both.pose[1] = bent_pose(1, 7)[0]
    for t in range(20):
        contact = 0.9 if t < 10 else 0.1
        one, two = alone.step(0.5, contact)[0], both.step(0.5, contact)[0]
        assert np.abs(one[0] - two[0]).max() < 1e-4
        if t == 7:
            both.feet.reset(1)
            assert not both.feet.plants.locked[1].any() and both.feet.plants.locked[0].all()
