"""No head and no foot of the bundled model is turned over, from any of its start poses."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.rotations import quat_angle, quat_identity
from motionkit.motion.skeleton import JOINT_NAMES

# Degrees from the rest pose: heads of all types have 70 at most, feet 83. A joint that is turned over has 130 or more.
MOST = {"Head": 95.0, "LeftFoot": 105.0, "RightFoot": 105.0}


@pytest.mark.parametrize("kind", load_bundled_model().types)
def test_heads_and_feet_are_not_turned_over(kind: str) -> None:
    model = load_bundled_model()
    parts = parse_types(kind if model.phase_seconds(kind) else f"{kind}:2")
    made = synthesize(model, parts, SynthesisOptions(len(model.types[kind].start_poses), 0)).motions
    for joint, most in MOST.items():
        turns = np.concatenate([one.motion.local_rotations[:, JOINT_NAMES.index(joint)] for one in made])
        away = np.degrees(quat_angle(quat_identity(turns.shape[:1]), turns))
        assert away.max() < most, joint
