"""Reads the animations of a glTF file as motions on the joints of its character."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from motionkit.arrays import Array, Doubles, lerp
from motionkit.errors import MotionkitError, naming
from motionkit.free_memory import check_memory
from motionkit.motion.bvh_rows import Notes, filled, filled_turns
from motionkit.motion.frame_rate import nominal_rate
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import matrix_to_quat, quat_normalize, quat_slerp, quat_to_matrix
from motionkit.names import visible
from motionkit.reading import ALL, report_notes, user_animation
from motionkit.rig.character import Character, nearest_rotations
from motionkit.rig.gltf import GltfFile

CM = 100.0
FPS = 60.0  # rate of a file whose keys are not evenly spaced, or too few
KEY_RATE_WITHIN = 1e-4  # keys are float32
DENSE = 15.0  # keys a second from which frames at the keys show splines and steps, too
FASTEST, LONGEST = 480.0, 3600.0  # frames per second, and seconds, of the fastest and the longest animation
MOST_POSES = 2**23  # joints times frames between a few keys; an hour of 77 joints at 30 fps
KEY_WITHIN = 1e-3  # share of the time between keys; a frame this little before a key counts as at the key
_WIDTHS = {"rotation": 4, "translation": 3, "scale": 3}


@dataclass(frozen=True, eq=False)
class Track:
    """The keys of one property of a node: times (N,) in seconds, values (N, C), or (3 N, C) with splines' tangents."""

    node: int
    path: str
    times: Doubles
    values: Doubles
    how: str

    def at(self, times: Array) -> Array:
        """Values (T, C) at some times; constant beyond the ends."""
        keys, values = self.times, self.values
        spline = self.how == "CUBICSPLINE"
        if len(keys) == 1:
            return np.broadcast_to(values[1 if spline else 0], (len(times), values.shape[1])).copy()
        after = np.clip(np.searchsorted(keys, times, side="right"), 1, len(keys) - 1)
        before, span = after - 1, (keys[after] - keys[after - 1])[:, None]
        share = np.clip((times[:, None] - keys[before, None]) / span, 0.0, 1.0)
        if spline:  # in-tangent, value and out-tangent of each key
            arriving, passing, leaving = values[0::3], values[1::3], values[2::3]
            return (
                (1 + 2 * share) * (1 - share) ** 2 * passing[before]
                + share * (1 - share) ** 2 * span * leaving[before]
                + share**2 * (3 - 2 * share) * passing[after]
                + share**2 * (share - 1) * span * arriving[after]
            )
        if self.how == "STEP":
            share = np.floor(share + KEY_WITHIN)  # keys are float32
        if self.path == "rotation":
            return quat_slerp(quat_normalize(values[before]), quat_normalize(values[after]), share[:, 0])
        return lerp(values[before], values[after], share)


def told_types(file: GltfFile, clip: str) -> tuple[tuple[str, float], ...]:
    """The motion types and their seconds that motionkit writes beside an animation; empty if there are none."""
    number = [name for name, _ in clip_lengths(file)].index(clip)
    extras = file.items("animations")[number].get("extras")
    types = extras.get("types") if isinstance(extras, dict) else None
    if not isinstance(types, list):
        return ()
    fits = all(
        isinstance(each, list)
        and len(each) == 2
        and isinstance(each[0], str)
        and type(each[1]) in (int, float)
        and 0.0 <= each[1] < float("inf")
        for each in types
    )
    return tuple((visible(kind), float(seconds)) for kind, seconds in types) if fits else ()


def motion_of(character: Character, clip: str | None = None) -> tuple[str, Motion]:
    """The name and the motion, in metres, of an animation of a character, by its name if there are several.

    Raises MotionkitError, naming the file.
    """
    file = character.tree.file
    name, animation = _animation(file, clip)
    tracks = _tracks(file, animation, _moving(character))
    if not tracks:
        raise file.fault(f"its animation {visible(name)} moves no joint of the skeleton")
    times, fps = _frames(file, tracks, len(character.nodes), _told_rate(file, animation))
    index = {node: joint for joint, node in enumerate(character.nodes)}
    rotations = np.broadcast_to(character.pose[0], (len(times), len(index), 4)).astype(np.float32)
    places: dict[int, Array] = {}
    if character.posed:  # nodes without keys stay as the file has them
        places = {joint: np.tile(place, (len(times), 1)) for joint, place in enumerate(character.pose[1])}
    for track in tracks:
        joint = index.get(track.node)
        values = track.at(times)
        if track.path == "scale":
            _check_scale(character, track.node, values)
        elif joint is not None and track.path == "rotation":
            rotations[:, joint] = quat_normalize(np.roll(values, 1, axis=-1))
        elif joint is not None:
            places[joint] = values
    motion = character.motion(rotations, places, fps)
    above = [track for track in tracks if track.node not in index and track.path != "scale"]
    return name, _carried(character, motion, above, times) if above else motion


def clip_lengths(file: GltfFile) -> list[tuple[str, float]]:
    """Names and seconds of the animations of a file."""
    ends = [
        max([0.0, *(_last_key(file, sampler) for sampler in _objects(file, animation, "samplers"))])
        for animation in file.items("animations")
    ]
    return list(zip(clip_names(file), ends, strict=True))


def clip_names(file: GltfFile) -> list[str]:
    """Names of the animations of a file; one without a name is called by its number, from 1.

    The second of one name is called NAME_2, as when one is added to a file.
    """
    out: list[str] = []
    for number, animation in enumerate(file.items("animations"), 1):
        name = animation.get("name")
        out.append(unused_name(name if isinstance(name, str) and name.strip() else str(number), out))
    return out


def unused_name(name: str, used: Collection[str]) -> str:
    """The name, or with the first number from 2 after it that is not used."""
    number, free = 2, name
    while free in used:
        free, number = f"{name}_{number}", number + 1
    return free


def _last_key(file: GltfFile, sampler: dict[str, Any]) -> float:
    """The time of the last key as the accessor gives it, which glTF demands; nothing is read for it."""
    largest = file.item("accessors", sampler.get("input")).get("max")
    if not isinstance(largest, list) or len(largest) != 1 or type(largest[0]) not in (int, float):
        return 0.0
    return float(largest[0])


def _animation(file: GltfFile, clip: str | None) -> tuple[str, dict[str, Any]]:
    """The name and the animation of a name, by default the chosen one or the only one."""
    clips = clip_lengths(file)
    clip = clip or (user_animation() if len(clips) > 1 and user_animation() != ALL else None)
    listed = ", ".join(f"{visible(name)} ({seconds:.2f} s)" for name, seconds in clips)
    if not clips:
        raise file.fault("has no animation; as a rig it can be given with --rig")
    requested = user_animation()
    if len(clips) == 1 and requested not in (None, ALL, clips[0][0]):
        report_notes(
            file.path,
            (
                f"its only animation, {visible(clips[0][0])}, for it has none called {visible(str(requested))}",
            ),
        )
    if clip is None and len(clips) > 1:
        raise file.fault(f"has {len(clips)} animations, choose one with --clip: {listed}")
    found = [i for i, (name, _) in enumerate(clips) if clip in (None, name)]
    if not found:
        raise file.fault(f"has no animation called {visible(str(clip))}; it has: {listed}")
    return clips[found[0]][0], file.items("animations")[found[0]]


def _objects(file: GltfFile, animation: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    found = animation.get(kind, [])
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise file.fault(f"{kind} of an animation is no list of objects")
    return found


def _moving(character: Character) -> set[int]:
    """The nodes that move the character: its joints and all nodes above them."""
    moving, node = set(character.nodes), character.tree.parents[character.nodes[0]]
    while node >= 0:
        moving.add(node)
        node = character.tree.parents[node]
    return moving


def _tracks(file: GltfFile, animation: dict[str, Any], moving: set[int]) -> list[Track]:
    """The tracks of some nodes; those of other nodes, of morph targets and of extensions are left out."""
    samplers = _objects(file, animation, "samplers")
    out: list[Track] = []
    notes = Notes(file.path)
    read: dict[int, Doubles] = {}  # times by accessor, which many samplers share
    left_out: dict[str, bool] = {}  # names of nodes, and whether their shapes change
    seen: set[tuple[int, str]] = set()
    for channel in _objects(file, animation, "channels"):
        target, which = channel.get("target"), channel.get("sampler")
        if not isinstance(target, dict) or type(which) is not int or not 0 <= which < len(samplers):
            raise file.fault("a channel has no target, or a sampler that does not exist")
        node, path = target.get("node"), target.get("path")
        if not isinstance(path, str) or path not in (*_WIDTHS, "weights") or node is None:
            continue
        entry = file.item("nodes", node)
        if node not in moving or path == "weights":
            left_out[str(entry.get("name") or f"node{node}")] = path == "weights"
            continue
        if (node, path) in seen:
            raise file.fault(f"two channels of an animation move the {path} of node {node}")
        seen.add((node, path))
        accessor: Any = samplers[which].get("input")
        how = samplers[which].get("interpolation", "LINEAR")
        if how not in ("LINEAR", "STEP", "CUBICSPLINE"):
            raise file.fault(f"interpolation {visible(str(how)[:20])}, expected LINEAR, STEP or CUBICSPLINE")
        file.item("accessors", accessor)
        if accessor not in read:
            read[accessor] = file.array(accessor, 1)[:, 0].astype(np.float64)
        values = file.array(samplers[which].get("output"), _WIDTHS[path], notes.strict).astype(np.float64)
        count = len(values) / 3 if how == "CUBICSPLINE" else len(values)
        if count != len(read[accessor]) or not bool((np.diff(read[accessor]) > 0.0).all()):
            raise file.fault(
                f"a channel has {count:g} values for {len(read[accessor])} times, or times that do not rise"
            )
        out.append(Track(node, path, read[accessor], _filled(file, path, values, int(count), notes), how))
    report_notes(file.path, (*notes.lines, *_without(left_out)))
    return out


def _without(left_out: Mapping[str, bool]) -> list[str]:
    """What a motion does not hold of an animation: changes of shapes, and nodes that move outside the skeleton."""
    out = []
    for shapes, what in ((False, "moving nodes outside the skeleton"), (True, "changing shapes")):
        names = [visible(name) for name, changes in left_out.items() if changes == shapes]
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            out.append(f"{what} left out: {', '.join(names[:3])}{more}")
    return out


def _filled(file: GltfFile, path: str, values: Doubles, keys: int, notes: Notes) -> Doubles:
    """Values of keys, with those that are no numbers filled as in other files."""
    if path == "rotation" and len(values) == keys:
        values = filled_turns(values[:, None], notes)[:, 0]
    else:  # with splines' tangents
        values = filled(values.reshape(keys, -1), [path] * (values.size // keys), notes).reshape(values.shape)
    if not bool(np.isfinite(values).all()):
        raise file.fault(f"the {path} of a node is mostly no number")
    return values


def _told_rate(file: GltfFile, animation: dict[str, Any]) -> float | None:
    """The rate that motionkit wrote beside an animation, if it did."""
    extras = animation.get("extras")
    fps: Any = extras.get("fps") if isinstance(extras, dict) else None
    known = isinstance(fps, (int, float)) and not isinstance(fps, bool) and 1.0 <= fps <= FASTEST
    return float(fps) if known else None


def _frames(file: GltfFile, tracks: list[Track], joints: int, told: float | None) -> tuple[Doubles, float]:
    """Times (T,) of the frames in seconds, and their rate, which is the told one for keys that fit it."""
    start, end = min(track.times[0] for track in tracks), max(track.times[-1] for track in tracks)
    keys = max((track.times for track in tracks), key=len)
    fps = _key_rate(keys, tracks) or FPS
    if told and np.abs((keys - start) * told - np.arange(len(keys))).max() < 0.02:
        fps = told
    if fps > FASTEST:
        raise file.fault(f"its keys are {fps:.4g} a second, expected up to {FASTEST:g}")
    count = round((end - start) * fps) + 1
    if end - start > LONGEST:
        raise file.fault(f"its animation lasts {end - start:,.0f} s, expected at most {LONGEST:,.0f}")
    if count > len(keys) and count * joints > MOST_POSES:
        raise file.fault(
            f"its animation has {count:,} frames of {joints} joints between {len(keys):,} keys, expected at most "
            f"{MOST_POSES // joints:,} frames"
        )
    with naming(file.path, MotionkitError):
        check_memory(count, joints, fps)
    return start + np.arange(count) / fps, fps


def _key_rate(keys: Doubles, tracks: list[Track]) -> float | None:
    """The rate of a track's keys, if frames at it show all tracks as they are."""
    steps = np.diff(keys)
    if not len(steps) or float(np.ptp(steps)) >= 0.02 * float(np.median(steps)) or float(steps.mean()) > 1.0:
        return None
    fps = 1.0 / float(steps.mean())
    frames = [(track.times - keys[0]) * fps for track in tracks]
    if any(float(np.abs(at - at.round()).max()) > 0.1 for at in frames):
        return None  # keys between frames
    curved = fps < DENSE and any(track.how != "LINEAR" for track in tracks)
    return None if curved else nominal_rate(fps, KEY_RATE_WITHIN)


def _check_scale(character: Character, node: int, values: Array) -> None:
    """Raise MotionkitError for a joint whose scale leaves that of the rest pose, which no motion holds."""
    rest = np.linalg.norm(character.tree.local[node][:3, :3], axis=0)
    if not np.allclose(values, rest, rtol=1e-2, atol=1e-4 * float(rest.max())):
        raise character.tree.fault(f"scales the node {character.tree.name(node)}, which a motion cannot hold")


def _carried(character: Character, motion: Motion, tracks: list[Track], times: Doubles) -> Motion:
    """A motion in metres whose root is also moved by the nodes above it."""
    tree, chain = character.tree, []
    node = tree.parents[character.nodes[0]]
    while node >= 0:
        chain.append(node)
        node = tree.parents[node]
    moved = np.broadcast_to(np.eye(4), (len(times), 4, 4))
    for node in reversed(chain):
        local = np.broadcast_to(tree.local[node], (len(times), 4, 4)).copy()
        for track in (track for track in tracks if track.node == node):
            values = track.at(times)
            if track.path == "translation":
                local[:, :3, 3] = values
            else:
                size = np.linalg.norm(tree.local[node][:3, :3], axis=0)
                local[:, :3, :3] = quat_to_matrix(quat_normalize(np.roll(values, 1, axis=-1))) * size
        moved = moved @ local
    # The root is where the rest of the chain has it; from there the moving chain takes it.
    away = moved @ np.linalg.inv(character.outer[0])
    turns = nearest_rotations(away[:, :3, :3])
    root = np.einsum("tab,tb->ta", away[:, :3, :3], motion.root_positions) + away[:, :3, 3]
    rotations = motion.local_rotations.copy()
    first = turns @ quat_to_matrix(rotations[:, 0].astype(np.float64))
    rotations[:, 0] = matrix_to_quat(first)
    places = motion.local_positions
    if places is not None:
        places = places.copy()
        places[:, 0] = root
    return Motion(motion.skeleton, rotations, root.astype(np.float32), motion.fps, places)
