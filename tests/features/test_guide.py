"""Outlines of poses and the guides made of them."""

from __future__ import annotations

import torch

from motionkit.features.guide import GUIDE_COUNT, GUIDE_OFFSETS, OUTLINE_COUNT, fit_outline, guide_signal
from motionkit.features.layout import feature_layout

LAYOUT = feature_layout()
POSITIONS = LAYOUT.blocks["joint_positions"]


def poses(frames: int = 400, rank: int = 5) -> torch.Tensor:
    """Features (T, 276) whose joint positions vary along a few directions, everything else at random."""
    generator = torch.Generator().manual_seed(3)
    features = torch.randn(frames, 276, generator=generator)
    size = POSITIONS.stop - POSITIONS.start
    directions = torch.randn(rank, size, generator=generator)
    shares = torch.randn(frames, rank, generator=generator)
    features[:, POSITIONS] = 10.0 * shares @ directions + torch.linspace(0, 100, size)
    return features


def test_an_outline_keeps_what_differs() -> None:
    features = poses()
    outline = fit_outline(features, torch.ones(len(features)), LAYOUT)
    shown = outline.of(features)
    assert shown.shape == (400, OUTLINE_COUNT)
    # Five directions and their mirror images: at most ten, so that sixteen tell all.
    tell = torch.cat([shown, torch.ones(400, 1)], dim=1)
    found = tell @ torch.linalg.lstsq(tell, features[:, POSITIONS], driver="gelsd").solution
    assert torch.allclose(found, features[:, POSITIONS], atol=0.05)


def test_only_joint_positions_count() -> None:
    features = poses()
    outline = fit_outline(features, torch.ones(len(features)), LAYOUT)
    other = torch.randn_like(features)
    other[:, POSITIONS] = features[:, POSITIONS]
    assert torch.equal(outline.of(other), outline.of(features))


def test_mirroring_changes_signs_only() -> None:
    features = poses()
    outline = fit_outline(features, torch.ones(len(features)), LAYOUT)
    columns, signs = LAYOUT.mirror_map()
    plain, mirrored = outline.of(features), outline.of(features[:, columns] * signs)
    varies = plain.abs().amax(dim=0) > 1e-2
    assert int(varies.sum()) >= 5
    assert torch.allclose(plain.abs()[:, varies], mirrored.abs()[:, varies], atol=2e-3)
    assert (plain[:, varies] * mirrored[:, varies]).sum(dim=0).lt(0).any(), "some are odd"


def test_weights_say_which_frames_count() -> None:
    features = poses()
    weights = torch.zeros(400)
    weights[:100] = 1.0
    a = fit_outline(features, weights, LAYOUT)
    b = fit_outline(features[:100], torch.ones(100), LAYOUT)
    assert torch.allclose(a.of(features), b.of(features), atol=1e-3)


def test_a_guide_looks_ahead_and_holds_the_last_pose() -> None:
    outlines = torch.arange(50.0)[:, None].expand(50, OUTLINE_COUNT)
    guide = guide_signal(outlines, torch.tensor([0, 40]))
    assert guide.shape == (2, GUIDE_COUNT)
    ahead = guide.reshape(2, len(GUIDE_OFFSETS), OUTLINE_COUNT)[..., 0]
    assert ahead.tolist() == [[5.0, 15.0, 30.0], [45.0, 49.0, 49.0]]
