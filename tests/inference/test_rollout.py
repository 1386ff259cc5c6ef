"""What the loop around the network does with a drawn frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from model_changes import with_presets
from motionkit.arrays import Array, lerp
from motionkit.features.control import Controls
from motionkit.features.layout import DEFAULT_LAYOUT, FEATURE_COUNT, feature_layout
from motionkit.inference import slip_correction
from motionkit.inference.frame_kernel import blended_columns
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import RolloutState
from motionkit.metrics.ground import average_foot_sliding
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.rotations import rotate_ground
from oracle.characters import draw_in_numpy
from oracle.draw import standing_move

KINDS = ("walking", "cartwheel")
ROOT = feature_layout(DEFAULT_LAYOUT).blocks["root_rotation"]


def asked(model: MotionModel, weights: Array) -> Controls:
    return Controls.of_types(weights)


def started(
    model: MotionModel, velocity_blend: dict[str, float], compiled: bool, noise: Noise | None = None
) -> tuple[RolloutState, Array]:
    """Two walkers and their normalised seed frames, the second of them half asked for a cartwheel."""
    model = with_presets(model, "velocity_blend", velocity_blend)
    seed = model.types["walking"].start_poses[0]
    state = RolloutState(model, 2, noise or Noise("mean"))
    if not compiled:
        draw_in_numpy(state)
    features = np.stack([seed.features, seed.features])
    weights = np.zeros((2, len(model.types)), np.float32)
    weights[:, model.type_id("walking")] = 1.0
    state.start(features, np.stack([seed.contacts, seed.contacts]), weights)
    return state, model.scaling.normalize(features)


@pytest.mark.parametrize("compiled", [True, False])
def test_inertia_is_a_share_of_the_last_movement(compiled: bool) -> None:
    model = load_bundled_model()
    weights = np.zeros((2, len(model.types)), np.float32)
    weights[0, model.type_id(KINDS[0])] = 1.0
    weights[1, [model.type_id(kind) for kind in KINDS]] = 0.5
    free, frames = started(model, {}, compiled)
    free.step(asked(model, weights))
    drawn = free.frame.x.copy()
    onwards = 2.0 * frames[:, -1] - frames[:, -2]
    blended = blended_columns(model.config.layout)
    assert int((blended == 0.0).sum()) == 46  # heights and their velocities
    drawn_alone = np.delete(np.arange(FEATURE_COUNT), ROOT)  # the root's rotation is made one again
    for velocity_blend, expected in (
        ({"walking": 0.3}, (0.3, 0.15)),
        ({"walking": 0.2, "cartwheel": 0.6}, (0.2, 0.4)),
    ):
        state, _ = started(model, velocity_blend, compiled)
        features, _, _ = state.step(asked(model, weights))
        shares = np.array(expected)[:, None] * blended
        wanted = lerp(drawn, onwards, shares)
        assert np.allclose(state.frame.x[:, drawn_alone], wanted[:, drawn_alone], atol=1e-5)
        assert np.allclose(state.frame.x[:, ROOT], wanted[:, ROOT], atol=0.05)
        assert np.allclose(features, model.scaling.denormalize(state.frame.x), atol=1e-3)
        # The next frame goes on from this one.
        before, now = frames[:, -1], state.frame.x.copy()
        again, _ = started(model, velocity_blend, compiled)
        again.step(asked(model, weights))
        again.controls.type_presets[:, 1] = 1.0
        again.step(asked(model, weights))
        gone_on = again.frame.x - (2.0 * now - before)
        assert (
            float(np.abs(gone_on[:, drawn_alone][:, blended[drawn_alone] > 0.0]).max())
            < 1e-4
            < float(np.abs(gone_on[:, blended == 0.0]).max())
        )


@pytest.mark.parametrize("compiled", [True, False])
def test_the_rotation_of_the_root_is_a_rotation_in_every_frame(compiled: bool) -> None:
    model = load_bundled_model()
    weights = np.zeros((2, len(model.types)), np.float32)
    weights[:, model.type_id("cartwheel")] = 1.0
    state, _ = started(model, {}, compiled, Noise("sample", 1.0))
    for _ in range(20):
        features, _, _ = state.step(asked(model, weights))
        columns = features[:, ROOT].reshape(2, 2, 3).astype(np.float64)
        assert np.allclose(columns @ columns.swapaxes(1, 2), np.eye(2), atol=1e-6)
        assert np.allclose(model.scaling.normalize(features)[:, ROOT], state.frame.x[:, ROOT], atol=1e-5)


def test_inertia_makes_motion_smoother() -> None:
    model = load_bundled_model()
    weights = np.zeros((2, len(model.types)), np.float32)
    weights[:, model.type_id("walking")] = 1.0
    jerks = []
    for share in (0.0, 0.4):
        state, _ = started(model, {"walking": share}, True, Noise("sample", 0.3))
        frames = np.stack([state.step(asked(model, weights))[0] for _ in range(60)])
        jerks.append(float(np.linalg.norm(np.diff(frames / model.scaling.std, n=3, axis=0), axis=-1).mean()))
    assert jerks[1] < 0.85 * jerks[0]


# ---- slip_correction ----


def standing_walk(model: MotionModel, share: float, compiled: bool, drift: float = 0.0) -> tuple[Array, ...]:
    """Ground (60, 3) and feet (60, 4, 3) in the world of one who walks; drift is added to the root's speed."""
    model = with_presets(model, "slip_correction", {"walking": share})
    seed = model.types["walking"].start_poses[0]
    state = RolloutState(model, 1, Noise("mean"))
    if not compiled:
        draw_in_numpy(state)
    weights = np.zeros((1, len(model.types)), np.float32)
    weights[0, model.type_id("walking")] = 1.0
    state.start(seed.features[None], seed.contacts[None], weights)
    space, layout = state.drawing.space, feature_layout(model.config.layout)
    mean = space.mean.copy()
    mean[layout.blocks["root_xz_velocity"].start] += drift  # as if the network had drawn a step to the side
    state.drawing.space = replace(space, mean=mean)
    ground, feet = [], []
    for _ in range(60):
        features, _, at = state.step(asked(model, weights))
        here = features[0, slip_correction.foot_columns(model.config.layout)]
        across = rotate_ground(at[0, 2], here[:, [0, 2]]) + at[0, :2]
        ground.append(at[0])
        feet.append(np.stack([across[:, 0], here[:, 1], across[:, 1]], axis=-1))
    return np.stack(ground), np.stack(feet)


def slide(feet: Array) -> float:
    return average_foot_sliding(feet, slip_correction.FLOOR).value or 0.0


@pytest.mark.parametrize("compiled", [True, False])
def test_grip_keeps_feet_where_they_stand(compiled: bool) -> None:
    model = load_bundled_model()
    loose = slide(standing_walk(model, 0.0, compiled, drift=60.0)[1])
    half, firm = (slide(standing_walk(model, share, compiled, drift=60.0)[1]) for share in (0.5, 1.0))
    assert firm < half < loose and firm < 0.6 * loose


def body_on_the_ground(seed: int) -> tuple[Array, Array, Array, Array]:
    """Four foot joints (1, 4, 3), 20 cm apart, some low and some high, and any turn (1,) and step (1, 2)."""
    random = np.random.default_rng(seed)
    feet = 20.0 * random.standard_normal((1, 4, 3), np.float32)
    feet[..., 1] = np.array([8.0, 2.0, 12.0, 3.0], np.float32)
    return (
        feet,
        feet + random.standard_normal((1, 4, 3), np.float32),
        random.standard_normal(1, np.float32) / 60,
        feet[:, 0, :2],
    )


def test_feet_that_all_go_the_same_way_are_stopped() -> None:
    feet, _, _, _ = body_on_the_ground(0)
    nothing = np.zeros(1, np.float32), np.zeros((1, 2), np.float32)
    there = feet.copy()
    there[..., 0] -= 0.7
    there[..., 2] += 0.4
    angle, step = standing_move(feet, there, *nothing)
    share = 1.0 / (1.0 + float(np.hypot(0.7, 0.4)) / slip_correction.LIMIT)
    assert np.allclose(step, [[-0.7 * share, 0.4 * share]], atol=1e-6) and abs(float(angle[0])) < 1e-6


def test_a_body_that_spins_on_its_feet_is_turned_back() -> None:
    feet, _, _, _ = body_on_the_ground(1)
    feet[..., 1] = 2.0
    # The heading has turned by 0.02 rad, and the feet with it: they should have stayed.
    turn, step = np.full(1, 0.02, np.float32), np.zeros((1, 2), np.float32)
    angle, move = standing_move(feet, feet, turn, step)
    assert -0.02 < float(angle[0]) < -0.012
    before = moves_of(feet, feet, 0.02, np.zeros(2, np.float32))
    after = moves_of(feet, feet, 0.02 + float(angle[0]), move[0].astype(np.float32))
    assert float(np.linalg.norm(after)) < 0.4 * float(np.linalg.norm(before))


def moves_of(feet: Array, before: Array, turn: float, step: Array) -> Array:
    """How far (4, 2) feet move over the ground."""
    turned = rotate_ground(np.array(-turn), before[0][:, [0, 2]])
    return feet[0][:, [0, 2]] + step - turned


def test_feet_in_the_air_hold_nothing() -> None:
    feet, before, turn, step = body_on_the_ground(2)
    feet[..., 1] += 20.0
    angle, move = standing_move(feet, before, turn, step)
    assert float(np.abs(angle).max()) == 0.0 and float(np.abs(move).max()) == 0.0


def test_a_foot_that_stands_holds_more_than_one_that_swings() -> None:
    feet, _, _, _ = body_on_the_ground(3)
    feet[..., 1] = 2.0
    there = feet.copy()
    there[0, 2:, 0] -= 5.0  # the right foot steps
    _, move = standing_move(feet, there, np.zeros(1, np.float32), np.zeros((1, 2), np.float32))
    assert 0.0 > float(move[0, 0]) > -1.0


def test_controls_say_how_much_of_the_grip_counts() -> None:
    model = load_bundled_model()
    weights = np.zeros((2, len(model.types)), np.float32)
    weights[:, model.type_id("dance-salsa")] = 1.0
    state, _ = started(with_presets(model, "slip_correction", {"dance-salsa": 0.5}), {}, True)
    free, _ = started(model, {}, True)
    free.controls.type_presets[:, 2] = 0.0
    state.controls.type_presets[model.type_id("dance-salsa"), 2] = 0.5
    for _ in range(3):
        held, _, _ = state.step(
            replace(asked(model, weights), slip_correction=np.array([0.0, 1.0], np.float32))
        )
        loose, _, _ = free.step(asked(model, weights))
    assert np.array_equal(held[0], loose[0])
    assert not np.array_equal(held[1, :3], loose[1, :3])
