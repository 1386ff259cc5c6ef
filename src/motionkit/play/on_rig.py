"""Frames of live characters on a user's rig, for clients that read JSON."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.rig import Rig, stance_part
from motionkit.motion.skeleton import STANDING_HEIGHTS
from motionkit.motion.to_rig import from_body, rig_body, standing_height
from motionkit.play.frames import Shown, rounded


def with_rig(model: MotionModel, rig: Rig) -> MotionModel:
    """The model with the body of a rig among its characters, by the rig's name: its feet are held live, too."""
    return replace(model, characters=model.characters | {rig.name: rig_body(rig).offsets})


class LiveRig:
    """Puts the characters that have the body of a rig on its joints, frame by frame."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.body = rig_body(rig)
        # Live feet stand where those of the canonical body do; those of the rig stand higher or lower.
        usual = STANDING_HEIGHTS[stance_part(rig.joints) == "ToeBase"]
        self._lift = np.array([0.0, standing_height(rig, usual) - usual, 0.0], np.float32)

    def told(self) -> dict[str, Any]:
        """The rig, as in hello."""
        skeleton = self.rig.skeleton
        return {
            "name": self.rig.name,
            "joints": list(skeleton.names),
            "parents": list(skeleton.parents),
            "offsets": rounded(skeleton.offsets, 6),
        }

    def pose(self, one: Shown) -> dict[str, Any]:
        """One character on the rig: local rotations (J, 4) and positions (J, 3), in the rig's unit and axes."""
        body = Motion(self.body, one.rotations[None], one.root[None] + self._lift, 60.0)
        made = from_body(body, self.rig)
        places = made.skeleton.offsets.copy() if made.local_positions is None else made.local_positions[0]
        places[0] = made.root_positions[0]
        return {"rotations": rounded(made.local_rotations[0], 6), "positions": rounded(places, 5)}
