"""Reads the first animation of a skinned glTF file as a Motion, in cm.

A BVH rig has identity rotations in its rest pose and no scales. So scaled nodes, scaling matrices and morphs are
refused, and the offsets are turned by the rest rotations.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.errors import MotionkitError
from motionkit.motion.frame_rate import nominal_rate
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    matrix_to_quat,
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_slerp,
)
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.gltf import GltfFile

CM = 100.0
FPS = 60.0  # rate of a file whose keys are not evenly spaced
FASTEST, MOST_FRAMES = 480.0, 500_000  # largest rate and number of frames
KEY_WITHIN = 1e-3  # share of the time between keys; a frame this little before a key counts as at the key
MOST_JOINTS = 1000
# Extensions that only concern meshes and their appearance.
_HARMLESS = ("KHR_materials", "KHR_texture", "KHR_lights", "KHR_draco_mesh", "KHR_mesh_quantization", "VRMC_")


def read_glb(path: str | Path) -> Motion:
    """Read the first animation of a .glb file, on the joints of its first skin and the nodes above them.

    Raises:
        MotionkitError: the file has no skin or animation, or has a morph animation or a scale; the message names it.
    """
    file = GltfFile(path)
    _check_extensions(file)
    joints = _joints(file)
    names, parents, offsets, rest = _rest(file, joints)
    times, fps = _times(file, joints)
    rotations = np.broadcast_to(rest, (len(times), *rest.shape)).copy()
    places = np.broadcast_to(offsets, (len(times), *offsets.shape)).copy()
    for joint, kind, keys, values, how in _channels(file, joints):
        sampled = _sampled(keys, values, times, how, kind == "rotation")
        if kind == "rotation":
            rotations[:, joints.index(joint)] = np.roll(sampled, 1, axis=-1)
        elif kind == "translation":
            places[:, joints.index(joint)] = sampled
        elif not np.allclose(sampled, 1.0, atol=1e-3):
            raise file.fault(f"scales the joint {names[joints.index(joint)]}, which BVH cannot hold")
    return _straightened(file, names, parents, rest, offsets, rotations, places, fps)


def _check_extensions(file: GltfFile) -> None:
    extensions = file.json.get("extensions")
    if isinstance(extensions, dict) and "VRM" in extensions:
        raise file.fault("is a VRM 0.x avatar, expected a skinned .glb with an animation")
    needed = file.json.get("extensionsRequired") or []
    for name in map(str, needed if isinstance(needed, list) else [needed]):
        if not name.startswith(_HARMLESS):
            raise file.fault(f"needs the extension {name}, which motionkit does not read")


def _joints(file: GltfFile) -> list[int]:
    """Nodes of the first skin and the nodes above them, parents before children."""
    skins, nodes = file.items("skins"), file.items("nodes")
    if not skins:
        raise file.fault("has no skin, expected a skinned skeleton with an animation")
    above: dict[int, int] = {}
    for index, node in enumerate(nodes):
        for child in _indices(file, node.get("children", [])):
            file.item("nodes", child)
            above[child] = index
    wanted: set[int] = set()
    for joint in _indices(file, skins[0].get("joints", [])):
        file.item("nodes", joint)
        while joint not in wanted:
            wanted.add(joint)
            if joint not in above:
                break
            joint = above[joint]
    roots = [joint for joint in sorted(wanted) if joint not in above]
    if len(roots) != 1:
        raise file.fault(f"the skin has {len(roots)} roots, expected one")
    if len(wanted) > MOST_JOINTS:
        raise file.fault(f"the skin has {len(wanted)} joints, expected at most {MOST_JOINTS}")
    ordered, waiting = [], [roots[0]]
    while waiting:
        joint = waiting.pop()
        if joint in ordered:
            raise file.fault(f"nodes[{joint}] is its own ancestor")
        ordered.append(joint)
        children = _indices(file, nodes[joint].get("children", []))
        waiting += [child for child in reversed(children) if child in wanted]
    return ordered


def _indices(file: GltfFile, values: Any) -> list[int]:
    if not isinstance(values, list) or not all(
        isinstance(v, int) and not isinstance(v, bool) for v in values
    ):
        raise file.fault("a list of nodes holds something that is no index")
    return values


def _rest(file: GltfFile, joints: list[int]) -> tuple[list[str], list[int], Array, Array]:
    """Names, parents, local translations (J, 3) in metres and local rotations (J, 4) of the nodes."""
    names, parents, places, turns = [], [], [], []
    above = {child: node for node in joints for child in file.items("nodes")[node].get("children", [])}
    for joint in joints:
        node = file.items("nodes")[joint]
        name = str(node.get("name") or f"joint{joint}")
        while name in names:
            name += "_"
        names.append(name)
        parents.append(joints.index(above[joint]) if joint in above else -1)
        place, turn = _pose(file, node, name)
        places.append(place)
        turns.append(turn)
    return names, parents, np.array(places), np.array(turns)


def _pose(file: GltfFile, node: dict[str, Any], name: str) -> tuple[Array, Array]:
    if "matrix" in node:
        matrix = _vector(file, node["matrix"], 16).reshape(4, 4).T
        if not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-3):
            raise file.fault(f"the matrix of {name} scales or shears, which BVH cannot hold")
        return matrix[:3, 3], matrix_to_quat(matrix[:3, :3])
    if not np.allclose(_vector(file, node.get("scale", [1, 1, 1]), 3), 1.0, atol=1e-3):
        raise file.fault(f"the node {name} is scaled, which BVH cannot hold")
    turn = np.roll(_vector(file, node.get("rotation", [0, 0, 0, 1]), 4), 1)
    if abs(float(np.linalg.norm(turn)) - 1.0) > 0.1:
        raise file.fault(f"the rotation of {name} is no unit quaternion")
    return _vector(file, node.get("translation", [0, 0, 0]), 3), quat_normalize(turn)


def _vector(file: GltfFile, values: Any, size: int) -> Array:
    numbers = isinstance(values, list) and all(isinstance(v, (int, float)) for v in values)
    if not numbers or len(values) != size or not all(abs(v) < 1e7 for v in values):
        raise file.fault(f"a node has {str(values)[:40]}, expected {size} numbers")
    return np.array(values, np.float64)


def _channels(file: GltfFile, joints: list[int]) -> list[tuple[int, str, Array, Array, str]]:
    """Node, path, times (N,), values and interpolation of each channel of the first animation that moves a joint."""
    animations = file.items("animations")
    if not animations:
        raise file.fault("has no animation")
    out = []
    animation = animations[0]
    for channel in animation.get("channels", []):
        target = channel.get("target", {})
        path, node = target.get("path"), target.get("node")
        if path == "weights":
            raise file.fault("animates morph targets, which BVH cannot hold")
        if node not in joints:
            continue
        if path not in ("rotation", "translation", "scale"):
            raise file.fault(f"animates {path!r}, expected rotations and translations")
        samplers = animation.get("samplers", [])
        which = channel.get("sampler")
        if not isinstance(which, int) or not 0 <= which < len(samplers):
            raise file.fault(f"a channel refers to the sampler {which}, which it does not have")
        sampler = samplers[which]
        how = sampler.get("interpolation", "LINEAR")
        keys = file.array(sampler.get("input"), 1)[:, 0].astype(np.float64)
        values = file.array(sampler.get("output"), 4 if path == "rotation" else 3).astype(np.float64)
        if how == "CUBICSPLINE":  # tangent, value, tangent
            values, how = values[1::3], "LINEAR"
        if len(values) != len(keys) or not bool((np.diff(keys) > 0.0).all()):
            raise file.fault(
                f"a channel has {len(values)} values for {len(keys)} times, or times that do not rise"
            )
        out.append((node, path, keys, values, how))
    if not out:
        raise file.fault("its first animation moves no joint of the skin")
    return out


def _times(file: GltfFile, joints: list[int]) -> tuple[Array, float]:
    """Times (T,) of the frames in seconds, and their rate."""
    channels = _channels(file, joints)
    start, end = min(keys[0] for _, _, keys, _, _ in channels), max(keys[-1] for _, _, keys, _, _ in channels)
    longest = max((keys for _, _, keys, _, _ in channels), key=len)
    steps = np.diff(longest)
    fps = FPS
    if len(steps) and float(np.ptp(steps)) < 0.02 * float(np.median(steps)):
        fps = nominal_rate(1.0 / float(steps.mean()))
    if not 1e-3 < fps <= FASTEST:
        raise file.fault(f"its keys are {fps:.4g} a second, expected up to {FASTEST:g}")
    count = round((end - start) * fps) + 1
    if count > MOST_FRAMES:
        raise file.fault(
            f"its animation has {count:,} frames at {fps:g} fps, expected at most {MOST_FRAMES:,}"
        )
    return start + np.arange(count) / fps, fps


def _sampled(keys: Array, values: Array, times: Array, how: str, turns: bool) -> Array:
    """Interpolate values (N, C) at keys (N,) at some times; constant beyond the ends."""
    after = np.clip(np.searchsorted(keys, times, side="right"), 1, max(len(keys) - 1, 1))
    before = after - 1
    if len(keys) == 1:
        return np.broadcast_to(values[0], (len(times), values.shape[1])).copy()
    share = np.clip((times - keys[before]) / (keys[after] - keys[before]), 0.0, 1.0)
    if how == "STEP":
        share = np.floor(share + KEY_WITHIN)  # keys are float32
    if turns:
        return quat_slerp(quat_normalize(values[before]), quat_normalize(values[after]), share)
    return lerp(values[before], values[after], share[:, None])


def _straightened(
    file: GltfFile,
    names: list[str],
    parents: list[int],
    rest: Array,
    offsets: Array,
    rotations: Array,
    places: Array,
    fps: float,
) -> Motion:
    """The motion on a skeleton with identity rotations in its rest pose, as BVH needs."""
    above = [rest[0]]
    for joint in range(1, len(names)):
        above.append(quat_multiply(above[parents[joint]], rest[joint]))
    world = np.stack(above)  # global rotations of the rest pose
    outer = np.stack([world[parent] if parent >= 0 else np.array([1.0, 0, 0, 0]) for parent in parents])
    turned = quat_multiply(quat_multiply(outer, rotations), quat_inverse(world))
    moved = quat_rotate(outer, places)
    still = quat_rotate(outer, offsets)
    ends = {}
    for joint, node in enumerate(_joints(file)):
        extras = file.items("nodes")[node].get("extras")
        end = extras.get("end_site") if isinstance(extras, dict) else None
        if isinstance(end, list) and joint not in parents:
            x, y, z = quat_rotate(world[joint], _vector(file, end, 3)) * CM
            ends[joint] = (float(x), float(y), float(z))
    skeleton = Skeleton(tuple(names), tuple(parents), (still * CM).astype(np.float32), ends)
    travels = np.abs(moved - still)[:, 1:].max(initial=0.0) > 1e-5
    local = (moved * CM).astype(np.float32) if travels else None
    if not bool(np.isfinite(turned).all()):
        raise MotionkitError(f"{file.path}: a rotation is not a number")
    return Motion(
        skeleton,
        quat_continuous(quat_normalize(turned)).astype(np.float32),
        (moved[:, 0] * CM).astype(np.float32),
        fps,
        local,
    )
