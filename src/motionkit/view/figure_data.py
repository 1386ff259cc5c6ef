"""Data with which a page draws a figure: rig, body and frames, in metres with Y up, compressed.

An array is packed as {"type", "shape", "data"}: little-endian, deflated, base64. Integer arrays hold differences
between rows, which compress well.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion, as_motion
from motionkit.motion.rotations import matrix_to_quat
from motionkit.rig.character import Character
from motionkit.rig.sides import joint_sides
from motionkit.rig.units import rig_places
from motionkit.rig.upright import CM, in_metres
from motionkit.view.asset import BODIES
from motionkit.view.body import make_body
from motionkit.view.character_data import character_joints
from motionkit.view.contact_sheet_geometry import Figure, low_frames, motion_figure, sliding_frames
from motionkit.view.surface import COLOR_SHARES

QUATERNION_STEPS = 32767  # steps per unit of a quaternion; resolves a few thousandths of a degree
POINT_STEPS = 10_000  # most steps per metre of body points, 0.1 mm each; points further than 3 m have fewer
NORMAL_STEPS = 127  # steps per unit of their normals


@dataclass(frozen=True, eq=False)
class MotionView:
    """A motion to display.

    Attributes:
        name: the motion's title.
        motion: in any unit, with Y or Z up.
        types: motion types and their seconds in sequence; empty if unknown.
        path: (N, 2) x, z of the requested path in cm, or None.
        character: the .glb or .vrm file that the motion is for, or None.
        body: the one of BODIES that human rigs get.
    """

    name: str
    motion: Motion
    types: Sequence[tuple[str, float]] = ()
    path: Array | None = None
    character: Character | None = None
    body: str = BODIES[0]

    @property
    def skinned_character(self) -> Character | None:
        """The character, to be shown instead of a figure, if it has meshes and the motion is on its joints."""
        one = self.character
        return one if one is not None and one.has_mesh and one.holds(self.motion) else None


def motion_views(motions: Sequence[Motion], names: Sequence[str] = ()) -> list[MotionView]:
    """Motions with names, by default "motion 1", "motion 2" ...

    Raises:
        MotionkitError: the numbers of names and motions differ.
    """
    if names and len(names) != len(motions):
        raise MotionkitError(f"expected a name for each of {len(motions)} motions, found {len(names)}")
    called = names or [f"motion {number}" for number in range(1, len(motions) + 1)]
    return [MotionView(name, as_motion(motion)) for name, motion in zip(called, motions, strict=True)]


def pack(values: NDArray, kind: str) -> dict[str, Any]:
    """Pack an array of any shape for the page; kind is "f4", or "i2", "i1", "u2" or "u1" for integers."""
    array = np.asarray(values)
    if kind == "f4":
        raw = array.astype("<f4")
    else:  # wraps around, as the sums in the page do
        flat = array.astype(np.int64).reshape(len(array), -1)
        steps = np.diff(flat, axis=0, prepend=np.zeros((1, flat.shape[1]), dtype=np.int64))
        raw = (steps & (0xFFFF if kind[1] == "2" else 0xFF)).astype(f"<u{kind[1]}")
    data = base64.b64encode(zlib.compress(raw.tobytes(), 9)).decode("ascii")
    return {"type": kind, "shape": list(array.shape), "data": data}


def figure_data(view: MotionView) -> dict[str, Any]:
    """The page's data for a motion: rig, body, frames, contacts, types and path."""
    metres = in_metres(view.motion)
    motion = metres.motion
    figure = motion_figure(motion)
    places = rig_places(motion.skeleton)
    path = None if view.path is None else pack(view.path.astype(np.float64) * CM, "f4")
    character, on_page = view.skinned_character, None
    if character is not None:
        unit = metres.scale / character.metres(view.motion)
        on_page = character_joints(character, [0, *motion.moving_joints()[1:]], unit, metres.up)
    return {
        "name": view.name,
        "fps": motion.fps,
        "frames": len(motion),
        "scale": metres.scale,
        "unit": metres.note,
        "floor": 0.0 if figure.floor_is_zero else figure.floor,
        **rig_data(motion, figure, None if on_page else view.body),
        "hero": on_page,
        "rotations": pack((motion.local_rotations.astype(np.float64) * QUATERNION_STEPS).round(), "i2"),
        "roots": pack(motion.root_positions, "f4"),
        "moving": _moving(motion),
        "feet": [
            {
                "side": side,
                "joint": foot if foot < len(motion.skeleton) else places[f"{side.title()}Foot"],
                "low": pack(low_frames(figure, foot), "u1"),
                "slides": pack(sliding_frames(figure, foot), "u1"),
            }
            for side, foot in figure.feet.items()
        ],
        "types": _bands(view, len(motion) / motion.fps),
        "path": path,
    }


def rig_data(motion: Motion, figure: Figure | None = None, body: str | None = BODIES[0]) -> dict[str, Any]:
    """The page's data for a rig, of a motion in metres with Y up and its motion_figure, and for its body.

    The body is None where a user's character takes its place.
    """
    figure = figure or motion_figure(motion)
    skeleton = motion.skeleton
    bones = [joint for _, joint in figure.bones if joint < len(skeleton)]
    return {
        "joints": list(skeleton.names),
        "parents": list(skeleton.parents),
        "sides": list(joint_sides(skeleton.names)),
        "offsets": pack(skeleton.offsets, "f4"),
        "bones": bones,
        "ends": [[joint, *end] for joint, end in sorted(skeleton.end_sites.items())],
        "hips": figure.hips,
        "head": figure.head,
        "stature": figure.stature,
        "body": None if body is None else _body_data(motion, figure, body),
    }


def _body_data(motion: Motion, figure: Figure, body: str) -> dict[str, Any]:
    """One of BODIES, fitted to a skeleton."""
    surface, pose = make_body(motion, figure, body)
    furthest = float(np.abs(surface.points).max(initial=0.0))
    steps = min(POINT_STEPS, int(np.iinfo(np.int16).max / max(furthest, 1e-9)))
    return {
        "rotations": pack(matrix_to_quat(pose.rotations), "f4"),
        "places": pack(pose.places, "f4"),
        "points": pack((surface.points * steps).round(), "i2"),
        "steps": steps,
        "triangles": pack(surface.triangles, "u2"),
        "joints": pack(surface.joints, "u2"),
        "weights": pack((surface.weights * 255).round(), "u1"),
        "normals": pack((surface.normals * NORMAL_STEPS).round(), "i1"),
        "regions": pack(surface.regions, "u1"),
        "shades": [
            [*color, share] for color, share in zip(surface.palette.tolist(), COLOR_SHARES, strict=True)
        ],
    }


def _moving(motion: Motion) -> dict[str, Any] | None:
    """Local positions of joints that move relative to their parents."""
    places, joints = motion.local_positions, motion.moving_joints()[1:]
    return (
        None if places is None or not joints else {"joints": joints, "places": pack(places[:, joints], "f4")}
    )


def _bands(view: MotionView, seconds: float) -> list[dict[str, Any]]:
    bands, start = [], 0.0
    for kind, length in view.types:
        bands.append({"type": kind, "start": start, "end": min(start + length, seconds)})
        start += length
    return bands
