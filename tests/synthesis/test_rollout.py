"""What the loop around the network does with a drawn frame."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from motionkit.models.bundled import load_bundled_model
from motionkit.models.checkpoint import MotionModel
from motionkit.synthesis.rollout import FrameControls, Noise, RolloutState

KINDS = ("walking", "cartwheel")


def asked(model: MotionModel, weights: torch.Tensor) -> FrameControls:
    count = len(weights)
    return FrameControls(weights, torch.zeros(count, 24), torch.zeros(count), torch.full((count,), -1.0))


def started(
    model: MotionModel, inertia: dict[str, float], compiled: bool, noise: Noise | None = None
) -> tuple[RolloutState, torch.Tensor]:
    """Two walkers and their normalised seed frames, the second of them half asked for a cartwheel."""
    model = replace(model, inertia=inertia)
    seed = model.seeds["walking"][0]
    state = RolloutState(model, 2, noise or Noise("mean"), compiled=compiled)
    features = torch.stack([seed.features, seed.features])
    weights = torch.zeros(2, len(model.types))
    weights[:, model.type_id("walking")] = 1.0
    state.start(features, torch.stack([seed.contacts, seed.contacts]), weights)
    return state, model.scaling.normalize(features)


@pytest.mark.parametrize("compiled", [True, False])
def test_inertia_is_a_share_of_the_last_movement(compiled: bool) -> None:
    model = load_bundled_model()
    weights = torch.zeros(2, len(model.types))
    weights[0, model.type_id(KINDS[0])] = 1.0
    weights[1, [model.type_id(kind) for kind in KINDS]] = 0.5
    free, frames = started(model, {}, compiled)
    free.step(asked(model, weights))
    drawn = torch.from_numpy(free.normalised.copy())
    onwards = 2.0 * frames[:, -1] - frames[:, -2]
    for shares, expected in (
        ({"walking": 0.3}, (0.3, 0.15)),
        ({"walking": 0.2, "cartwheel": 0.6}, (0.2, 0.4)),
    ):
        state, _ = started(model, shares, compiled)
        features, _, _ = state.step(asked(model, weights))
        wanted = torch.lerp(drawn, onwards, torch.tensor(expected)[:, None])
        assert torch.allclose(torch.from_numpy(state.normalised), wanted, atol=1e-5)
        assert torch.allclose(features, model.scaling.denormalize(wanted), atol=1e-3)
        # The next frame goes on from this one.
        before, now = frames[:, -1], torch.from_numpy(state.normalised.copy())
        again, _ = started(model, shares, compiled)
        again.step(asked(model, weights))
        again._inertias[:] = 1.0
        again.step(asked(model, weights))
        assert torch.allclose(torch.from_numpy(again.normalised), 2.0 * now - before, atol=1e-4)


def test_inertia_makes_motion_smoother() -> None:
    model = load_bundled_model()
    weights = torch.zeros(2, len(model.types))
    weights[:, model.type_id("walking")] = 1.0
    jerks = []
    for share in (0.0, 0.4):
        state, _ = started(model, {"walking": share}, True, Noise("sample", 0.3))
        frames = torch.stack([state.step(asked(model, weights))[0] for _ in range(60)])
        jerks.append(float(torch.diff(frames / model.scaling.std, n=3, dim=0).norm(dim=-1).mean()))
    assert jerks[1] < 0.8 * jerks[0]
