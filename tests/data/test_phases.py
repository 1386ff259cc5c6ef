"""Which types turn the body over, and how far a performance of them has come."""

import math

import numpy as np
import torch

from motionkit.data.phases import NO_PHASE, phase_track, phase_types, turns_over
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import canonical_skeleton


def rolled(degrees: float, frames: int = 40) -> torch.Tensor:
    """Features of a body that rolls about Z to an angle and back."""
    rotations = quat_identity((frames, 23))
    half = 0.5 * math.radians(degrees) * torch.sin(torch.linspace(0, math.pi, frames))
    rotations[:, 0, 0], rotations[:, 0, 3] = torch.cos(half), torch.sin(half)
    root = torch.tensor([0.0, 95.0, 0.0]).expand(frames, 3)
    return encode_motion(Motion(canonical_skeleton(), rotations, root, 60.0)).features


def test_turns_over_needs_the_hips_upside_down():
    assert turns_over(rolled(180.0), DEFAULT_LAYOUT)
    assert not turns_over(rolled(60.0), DEFAULT_LAYOUT)


def test_types_that_mostly_turn_over_have_a_phase():
    clips = [
        (rolled(170.0, 40), np.zeros(40, np.int16)),
        (rolled(170.0, 60), np.zeros(60, np.int16)),
        (rolled(30.0, 50), np.ones(50, np.int16)),
    ]
    assert phase_types(clips, DEFAULT_LAYOUT) == {0: 50.0}


def test_phase_runs_through_each_stretch():
    types = np.array([1, 1, 0, 0, 0, 0, 1, 0, 0])
    track = phase_track(types, [0])
    assert np.allclose(track, [NO_PHASE, NO_PHASE, 0, 0.25, 0.5, 0.75, NO_PHASE, 0, 0.5])
    assert np.all(phase_track(types, []) == NO_PHASE)
