"""Data by which a page poses a user's character: its nodes that follow the joints of a figure (web/src/lib/hero.js).

In the world, a node turns as its joint times a constant rotation. Then twist is spread, and nodes are moved so that
joints are in place; one that goes along under the hips (Rig.under) is moved first, from its rest pose and not down.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.files import read_bytes
from motionkit.motion.rotations import quat_inverse, quat_multiply, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.rig.character import Character
from motionkit.rig.gltf import GltfFile
from motionkit.rig.rig import Rig, mover
from motionkit.rig.to_rig import turning_joints
from motionkit.rig.twist import twists
from motionkit.rig.up_axis import up_turn

MAX_BYTES = 100_000_000  # of a character on a page


def page_bytes(file: GltfFile) -> bytes:
    """The bytes of a character's file; raises MotionkitError if a page cannot show it."""
    file.addition()  # refuses what lies in other files
    if "KHR_draco_mesh_compression" in file.json.get("extensionsRequired", ()):
        raise file.fault("its meshes are compressed by Draco, which pages do not unpack; save it without")
    return read_bytes(file.path, MAX_BYTES, "a character for a page")


def character_joints(character: Character, moving: Iterable[int], scale: float, up: Array) -> dict[str, Any]:
    """The data for a motion on the character's own joints, of which the places of `moving` change.

    scale is metres on the page per unit of the file, up (3,) the up axis of the file.
    """
    nodes, turns = character.nodes, character.turns
    return {
        **_placement(scale, up),
        "drives": [[node, joint, *_numbers(turns[joint])] for joint, node in enumerate(nodes)],
        "moves": [[nodes[joint], nodes[joint], joint, False] for joint in moving],
    }


def rig_joints(rig: Rig, raised: Array, lift: Array) -> dict[str, Any]:
    """The data for live motion of the canonical joints on a rig that has a character.

    raised and lift (3,) lead from the hips of the live body to those of the rig, in cm, in its own axes and in those of
    the world.
    """
    character, moved = rig.character, mover(rig.skeleton, rig.channels, rig.joints)
    assert character is not None and moved is not None  # make_rig has checked it
    nodes, turns, back = character.nodes, character.turns, quat_inverse(rig.differences).astype(np.float64)
    place = [nodes[rig.joints.places["Hips"]], JOINT_NAMES.index("Hips")]

    def axis(joint: int, direction: Array) -> list[float]:
        return _numbers(quat_rotate(quat_inverse(character.axes[joint]), direction))

    return {
        **_placement(rig.scale / 100.0, rig.up),
        "drives": [
            [nodes[joint], carrier, *_numbers(quat_multiply(back[carrier], turns[joint]))]
            for joint, carrier in sorted(turning_joints(rig).items())
        ],
        "moves": [[nodes[0], *place, True]] * character.under + [[nodes[moved], *place, False]],
        "raised": _numbers(raised / 100.0),
        "lift": _numbers(lift / 100.0),
        "twists": [
            {
                "node": nodes[one.source],
                "axis": axis(one.source, one.axis),
                "taken": one.from_source,
                "shares": [[nodes[j], share, *axis(j, one.axis)] for j, share in one.shares.items()],
            }
            for one in twists(rig)
        ],
    }


def _placement(scale: float, up: Array) -> dict[str, Any]:
    zero = [0.0, 0.0, 0.0]
    return {"scale": scale, "turn": _numbers(up_turn(up)), "raised": zero, "lift": zero, "twists": []}


def _numbers(values: Array) -> list[float]:
    return [round(float(value), 7) for value in values]
