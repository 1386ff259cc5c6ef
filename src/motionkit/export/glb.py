"""Writes motions as binary glTF: into the file of the user's character, or with a body of our own, in metres, +Y up.

The latter has a skeleton in a skin, a body mesh and one animation.

Importers make bones of skin joints only, so the skin has all joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.export.clip import Clip
from motionkit.export.figure import Figure, make_figure, materials, skin_weights
from motionkit.motion.rotations import quat_inverse, quat_rotate
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.character import Character
from motionkit.rig.gltf import INDICES, VERTICES, GltfDocument
from motionkit.rig.read_glb import clip_names, unused_name


def write_glb(path: str | Path, clip: Clip) -> None:
    """Write a motion of any rig as a .glb file, atomically: into the file of its character, or with a body."""
    if clip.host is not None:
        _write_into(path, clip, clip.host)
        return
    document = GltfDocument()
    figure = make_figure(clip.motion, clip.new_body)
    joints = add_figure(document, figure, clip.name)
    rotations, translations = figure.locals()
    moving = {joint: translations[:, joint] for joint in figure.motion.moving_joints()}
    add_animation(document, clip, joints, rotations, moving)
    document.write(path)


def write_vrm(path: str | Path, clip: Clip) -> None:
    """Write the avatar that a motion is on with the motion as an animation; raises MotionkitError without an avatar."""
    if clip.character is None:
        raise MotionkitError(
            f"{path}: a .vrm is an avatar: give one with --rig avatar.vrm, or write its animation as .vrma"
        )
    if not clip.character.skeleton.humanoid:
        source = clip.character.tree.file.path
        raise MotionkitError(
            f"{path}: not written: {source} has no humanoid part, as a .vrm has; write a .glb"
        )
    _write_into(path, clip, clip.character)


def _write_into(path: str | Path, clip: Clip, character: Character) -> None:
    """Write the file of a character with a motion on it as one more animation; all else stays byte for byte."""
    file = character.tree.file
    if not character.holds(clip.motion):
        ours, theirs = (set(each.names) for each in (character.skeleton, clip.motion.skeleton))
        if more := sorted(theirs - ours):
            why = f"adds the joint {more[0]} to those of {file.path}; --root ground is for other formats"
        elif ours - theirs:
            why = f"lacks the joint {min(ours - theirs)} of {file.path}"
        else:
            why = f"has another rest pose than {file.path}, which keeps its own; --rest is for other formats"
        raise MotionkitError(f"{path}: not written: the motion {why}")
    document = file.addition()
    used = [] if clip.alone else clip_names(file)
    name = unused_name(clip.name, used)
    tracks = character.tracks(clip.motion)
    add_tracks(document, replace(clip, name=name), tracks)
    parts = character.parts({node for node, _, _ in tracks})
    file.write_added(path, document, ["animations"] if clip.alone else [], parts)


def add_figure(document: GltfDocument, figure: Figure, name: str) -> list[int]:
    """Add a scene with the skinned joints and the body; returns the joints' nodes."""
    rotations, translations = figure.rest_locals()
    joints = add_joints(document, figure.motion.skeleton, translations, rotations, figure.axes)
    skin = _add_skin(document, figure, joints)
    body = document.add("nodes", {"name": "Body", "mesh": _add_mesh(document, figure), "skin": skin})
    document.json |= {"scenes": [{"name": name, "nodes": [joints[0], body]}], "scene": 0}
    return joints


def add_joints(
    document: GltfDocument,
    skeleton: Skeleton,
    translations: Array,
    rotations: Array | None = None,
    axes: Array | None = None,
) -> list[int]:
    """Add a node for each joint; returns their indices.

    Args:
        translations: (J, 3) of the rest pose, relative to the parents.
        rotations: (J, 4) likewise, none by default.
        axes: (J, 4) rotations from the joints' axes to those in which the skeleton has its ends, none by default.
    """
    first = len(document.json.get("nodes", []))
    for joint, name in enumerate(skeleton.names):
        node: dict[str, Any] = {"name": name, "translation": _numbers(translations[joint])}
        if rotations is not None:
            node["rotation"] = _numbers(_xyzw(rotations[joint]))
        if children := skeleton.children(joint):
            node["children"] = [first + child for child in children]
        if joint in skeleton.end_sites:
            end = np.array(skeleton.end_sites[joint])
            end = end if axes is None else quat_rotate(quat_inverse(axes[joint]), end)
            node["extras"] = {"end_site": _numbers(end)}
        document.add("nodes", node)
    return [first + joint for joint in range(len(skeleton))]


def add_animation(
    document: GltfDocument, clip: Clip, joints: list[int], rotations: Array, moving: dict[int, Array]
) -> None:
    """Add the animation of a clip: local rotations (T, J, 4), and translations (T, 3), in m, of joints that move."""
    tracks = [(joints[j], "translation", values) for j, values in moving.items()]
    tracks += [(node, "rotation", _xyzw(rotations[:, joint])) for joint, node in enumerate(joints)]
    add_tracks(document, clip, tracks)


def add_tracks(document: GltfDocument, clip: Clip, tracks: Sequence[tuple[int, str, Array]]) -> None:
    """Add an animation with the name and the times of a clip: node, path and values (T, C) of each track."""
    motion = clip.motion
    times = document.accessor((np.arange(len(motion)) / motion.fps).astype(np.float32), "SCALAR", bounds=True)
    extras = {"fps": motion.fps, "types": [[kind, seconds] for kind, seconds in clip.types]}
    animation: dict[str, Any] = {"name": clip.name, "channels": [], "samplers": [], "extras": extras}
    for number, (node, path, values) in enumerate(tracks):
        output = document.accessor(values.astype(np.float32), f"VEC{values.shape[1]}")
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})
        animation["channels"].append({"sampler": number, "target": {"node": node, "path": path}})
    document.add("animations", animation)


def _add_skin(document: GltfDocument, figure: Figure, joints: list[int]) -> int:
    # The buffer stores matrices column by column.
    columns = figure.inverse_binds.transpose(0, 2, 1).astype(np.float32)
    matrices = document.accessor(columns, "MAT4")
    skin = {"name": "Skeleton", "joints": joints, "skeleton": joints[0], "inverseBindMatrices": matrices}
    return document.add("skins", skin)


def _add_mesh(document: GltfDocument, figure: Figure) -> int:
    """Add the body with one primitive per material; returns the index of the mesh."""
    surface = figure.surface
    joints, weights = skin_weights(surface)
    attributes = {
        "POSITION": document.accessor(surface.points.astype(np.float32), "VEC3", VERTICES, bounds=True),
        "NORMAL": document.accessor(figure.normals.astype(np.float32), "VEC3", VERTICES),
        "JOINTS_0": document.accessor(joints, "VEC4", VERTICES),
        "WEIGHTS_0": document.accessor(weights, "VEC4", VERTICES),
    }
    primitives = []
    for name, color, triangles in materials(surface):
        look = {"baseColorFactor": [*color, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
        material = document.add("materials", {"name": name, "pbrMetallicRoughness": look})
        corners = surface.triangles[triangles].reshape(-1).astype(np.uint32)
        indices = document.accessor(corners, "SCALAR", INDICES)
        primitives.append({"attributes": attributes, "indices": indices, "material": material})
    return document.add("meshes", {"name": "Body", "primitives": primitives})


def _xyzw(quat: Array) -> Array:
    """Quaternions (..., 4) in glTF's order x, y, z, w."""
    return np.roll(quat, -1, axis=-1)


def _numbers(values: Array) -> list[float]:
    """Numbers rounded to float32's digits; -0 becomes 0."""
    return [float(f"{value:.9g}") + 0.0 for value in values.astype(np.float32).tolist()]
