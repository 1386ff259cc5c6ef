"""Live characters on a user's rig, for clients that read JSON."""

from __future__ import annotations

import base64
from dataclasses import replace
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS, Skeleton, canonical_skeleton
from motionkit.play.frames import CharacterState, rounded
from motionkit.rig import names, rest_pose, twist
from motionkit.rig.gltf_nodes import VRM_BONES
from motionkit.rig.rig import PLAUSIBLE_STANCE, Rig, stance_part
from motionkit.rig.soles import LiveSoles, body_soles, read_soles
from motionkit.rig.to_rig import THIGHS, from_body, rig_body, standing_height
from motionkit.view.character_data import MAX_BYTES, page_bytes, rig_joints

# cm, median ankle height in the training recordings while heel and toe are in contact.
STANDING_ANKLE = 7.6
_TOES = [JOINT_NAMES.index(f"{side}ToeBase") for side in ("Left", "Right")]


def with_soles(model: MotionModel) -> MotionModel:
    """The model with the soles of the body that is shown on its characters' joints, for pages."""
    own = {name: LiveSoles(*body_soles(model.character(name)), floor=0.0) for name in model.characters}
    return replace(model, soles=own | model.soles)


def with_rig(model: MotionModel, rig: Rig) -> MotionModel:
    """The model with the rig's body among its characters, under the rig's name; feet are locked on that body."""
    body = rig_body(rig)
    offsets = body.offsets.copy()
    offsets[body.children(0)] += _raised(body)
    soles, known = read_soles(rig), model.soles
    if soles is not None:
        known = known | {rig.name: LiveSoles(*soles, floor=-_lift(rig, body))}
    return replace(model, characters=model.characters | {rig.name: offsets}, soles=known)


def _raised(body: Skeleton) -> Array:
    """Offset (3,), in cm, that with_rig adds to all joints that hang on the hips of a body.

    The hips of a live character are placed like those of the canonical body. A rig may have its hips at thigh height,
    or ankles higher above the toes; without the offset, its feet would float or sink into the floor.
    """
    usual = canonical_skeleton()
    return usual.offsets[THIGHS].mean(axis=0) - body.offsets[THIGHS].mean(axis=0) + _ankles_higher(body)


def _ankles_higher(body: Skeleton) -> Array:
    """Offset (3,), in cm, by which a body's ankles stand higher than those of the canonical body.

    Lower ankles need no offset: the root-height correction raises them, and foot locking pitches the feet.
    """
    depth = float((canonical_skeleton().offsets - body.offsets)[_TOES, 1].mean())
    return np.array([0.0, max(depth, 0.0), 0.0], np.float32)


def _lift(rig: Rig, body: Skeleton) -> float:
    """Rise in cm of a live character: its feet may stand higher or lower than the canonical ones it is posed by."""
    toes = stance_part(rig.joints) == "ToeBase"
    usual = STANDING_HEIGHTS[1] if toes else STANDING_ANKLE + float(_ankles_higher(body)[1])
    soles = read_soles(rig)
    standing = standing_height(rig, usual) if soles is None else sum(sole.depth for sole in soles) / 2.0
    return standing - usual


def rig_tables() -> dict[str, Any]:
    """All that a page needs to do the same with a rig by itself, as JSON values (web/src/demo/rig.js)."""
    heights = {"ToeBase": STANDING_HEIGHTS[1], "Foot": STANDING_ANKLE}
    known = {"bones": VRM_BONES, "standing": heights, "plausible": PLAUSIBLE_STANCE, "mostBytes": MAX_BYTES}
    return {**names.tables(), **rest_pose.tables(), **twist.tables(), **known}


class LiveRig:
    """Puts characters that have a rig's body on the rig, frame by frame."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.body = rig_body(rig)
        self._raised = _raised(self.body)
        self._lift = np.array([0.0, _lift(rig, self.body), 0.0], np.float32)

    def as_dict(self) -> dict[str, Any]:
        """The rig for hello."""
        skeleton = self.rig.skeleton
        return {
            "name": self.rig.name,
            "joints": list(skeleton.names),
            "parents": list(skeleton.parents),
            "offsets": rounded(skeleton.offsets, 6),
        }

    def page_character(self) -> dict[str, Any]:
        """The rig's character for the page, posed as pose does; raises MotionkitError if it cannot be shown."""
        character = self.rig.character
        assert character is not None
        data = base64.b64encode(page_bytes(character.tree.file)).decode()
        return rig_joints(self.rig, self._raised, self._lift) | {"data": data}

    def pose(self, one: CharacterState) -> dict[str, Any]:
        """A character on the rig: local rotations (J, 4) and positions (J, 3), in the rig's unit and axes."""
        hips = one.root + quat_rotate(one.rotations[0], self._raised) + self._lift
        body = Motion(self.body, one.rotations[None], hips[None], 60.0)
        made = from_body(body, self.rig)
        places = made.skeleton.offsets.copy() if made.local_positions is None else made.local_positions[0]
        places[0] = made.root_positions[0]
        return {"rotations": rounded(made.local_rotations[0], 6), "positions": rounded(places, 5)}
