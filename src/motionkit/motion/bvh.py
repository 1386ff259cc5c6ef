"""BVH files: reading, writing, and conversion to and from Motion.

bvhio reads the hierarchy and numpy the motion block. That is several times faster than bvhio's keyframes
(benchmarks/bvh_reading.py), and exact in float64. BVH angles are in degrees.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Array
from motionkit.errors import BvhError
from motionkit.files import atomic_write
from motionkit.motion.bvh_rows import MAX_NUMBER, implausible_value
from motionkit.motion.bvh_text import LONGEST_FRAME, SHORTEST_FRAME, read_bvh_text
from motionkit.motion.frame_rate import ENOUGH_DIGITS, EXACT_WITHIN, nominal_rate, significant_digits
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import euler_to_quat, quat_continuous, quat_to_euler
from motionkit.motion.skeleton import Skeleton

POSITION_CHANNELS = ("Xposition", "Yposition", "Zposition")
# A joint whose position channels, taken as a place in the world, lie this much nearer to the root than its parent is to
# them taken as an offset, has its place in the world there.
WORLD_SHARE = 0.25
ROTATION_ORDER = "ZYX"  # the order of the CMU files and of motionkit's own files


@dataclass(frozen=True, eq=False)
class BvhFile:
    """The contents of a BVH file, in its own units.

    Attributes:
        skeleton: hierarchy and rest pose, lengths in file units.
        channels: the channel names of each joint, in file order.
        values: (T, C) the motion block in degrees and file units; C counts the channels of all joints.
        frame_time: seconds per frame, as declared.
        hierarchy: text of the hierarchy section, as it was read and as it is written; None to make one from skeleton
            and channels, also where the text had to be repaired.
        rate_within: largest relative difference of the rate from a whole number, by the digits of the frame time.
    """

    skeleton: Skeleton
    channels: tuple[tuple[str, ...], ...]
    values: NDArray[np.float64]
    frame_time: float
    hierarchy: str | None = None
    rate_within: float = EXACT_WITHIN

    @property
    def fps(self) -> float:
        """The declared frame rate, without the rounding of the frame time (nominal_rate)."""
        return nominal_rate(1.0 / self.frame_time, self.rate_within)

    def picked(self, joints: Sequence[int]) -> BvhFile:
        """Some joints, with the parents of each, in another order, with their channels and values."""
        columns = self.columns()
        return BvhFile(
            self.skeleton.picked(joints),
            tuple(self.channels[joint] for joint in joints),
            self.values[:, [column for joint in joints for column in columns[joint]]],
            self.frame_time,
            rate_within=self.rate_within,
        )

    def columns(self) -> list[range]:
        """The columns of each joint in values."""
        out, start = [], 0
        for names in self.channels:
            out.append(range(start, start + len(names)))
            start += len(names)
        return out


def read_bvh(path: str | Path) -> BvhFile:
    """Read a BVH file; raises BvhError, naming file and line, if it is invalid.

    Repairs are reported as reading.py says.
    """
    import bvhio  # a local import, because it takes a quarter of a second

    text = read_bvh_text(path)
    with tempfile.NamedTemporaryFile("w", suffix=".bvh", encoding="ascii", delete=False) as header:
        header.write(text.header)
    try:
        root = bvhio.readAsBvh(header.name, loadKeyFrames=False).Root
    except (SyntaxError, IndexError, RecursionError) as error:
        raise BvhError(path, f"the hierarchy cannot be read ({error})") from None
    finally:
        Path(header.name).unlink(missing_ok=True)
    names: list[str] = []
    parents: list[int] = []
    offsets: list[tuple[float, float, float]] = []
    channels: list[tuple[str, ...]] = []
    ends: dict[int, tuple[float, float, float]] = {}
    waiting = [(root, -1)]
    while waiting:  # depth first, children in file order, which is the order of the channels
        joint, parent = waiting.pop()
        index = len(names)
        names.append(text.names[int(joint.Name[1:])])
        parents.append(parent)
        offsets.append(tuple(joint.Offset))
        channels.append(tuple(joint.Channels))
        if not joint.Children:
            ends[index] = tuple(joint.EndSite)
        waiting.extend((child, index) for child in reversed(joint.Children))
    skeleton = Skeleton(tuple(names), tuple(parents), np.array(offsets, np.float32), ends)
    bvh = BvhFile(
        skeleton, tuple(channels), text.values, text.frame_time, text.hierarchy, rate_within=text.rate_within
    )
    _fill_places(bvh)
    _check_places(path, bvh)
    return bvh


def _fill_places(bvh: BvhFile) -> None:
    """Write the OFFSETs into the position channels of joints if all of these but the root's are zero.

    Such channels hold nothing: read as places, they would draw the whole body to one point.
    """
    places = {
        column: float(bvh.skeleton.offsets[joint, "XYZ".index(name[0])])
        for joint, (names, columns) in enumerate(zip(bvh.channels, bvh.columns(), strict=True))
        for name, column in zip(names, columns, strict=True)
        if joint and name.endswith("position")
    }
    if any(places.values()) and not bvh.values[:, list(places)].any():
        bvh.values[:, list(places)] = list(places.values())


def _check_places(path: str | Path, bvh: BvhFile) -> None:
    """Raise BvhError for joints whose position channels hold places in the world, which would tear the body apart."""
    places = {}
    for joint, (names, columns) in enumerate(zip(bvh.channels, bvh.columns(), strict=True)):
        at = [columns[names.index(name)] for name in POSITION_CHANNELS if name in names]
        if len(at) == 3:
            places[joint] = bvh.values[:, at]
    root = places.pop(0, None)
    if root is None:
        return
    found = [
        joint
        for joint, place in places.items()
        if np.median(np.linalg.norm(place - root, axis=1))
        < WORLD_SHARE * np.median(np.linalg.norm(place - bvh.skeleton.offsets[joint], axis=1))
    ]
    if found:
        listed = ", ".join(bvh.skeleton.names[joint] for joint in found[:3])
        raise BvhError(
            path,
            f"the position channels of {listed} hold places in the world (as Vicon writes segments), expected places "
            "relative to the parent; export the file with positions of the root alone",
        )


def bvh_to_motion(bvh: BvhFile, scale: float = 1.0, fps: float | None = None) -> Motion:
    """Convert a BVH file to a motion, with lengths multiplied by scale, at the declared frame rate or at fps."""
    frames, joints = bvh.values.shape[0], len(bvh.skeleton)
    rotations = np.zeros((frames, joints, 4), np.float64)
    offsets = bvh.skeleton.offsets.astype(np.float64)
    places = np.broadcast_to(offsets, (frames, joints, 3)).copy()
    translates = False
    values = bvh.values
    by_order: dict[str, list[tuple[int, list[int]]]] = {}
    for joint, (names, columns) in enumerate(zip(bvh.channels, bvh.columns(), strict=True)):
        turns = [c for name, c in zip(names, columns, strict=True) if name.endswith("rotation")]
        order = "".join(name[0] for name in names if name.endswith("rotation"))
        by_order.setdefault(order, []).append((joint, turns))
        for name, column in zip(names, columns, strict=True):
            if name.endswith("position"):
                places[:, joint, "XYZ".index(name[0])] = values[:, column]
                translates = translates or joint > 0
    for order, members in by_order.items():
        turned = [turns for _, turns in members]
        rotations[:, [joint for joint, _ in members]] = euler_to_quat(np.deg2rad(values[:, turned]), order)
    motion = Motion(
        bvh.skeleton,
        quat_continuous(rotations).astype(np.float32),
        places[:, 0].astype(np.float32),
        bvh.fps if fps is None else fps,
        places.astype(np.float32) if translates else None,
    )
    return motion if scale == 1.0 else motion.scaled(scale)


def motion_to_bvh(motion: Motion, channels: tuple[tuple[str, ...], ...] | None = None) -> BvhFile:
    """Convert a motion to the given BVH channels; by default ZYX rotations, and positions of the joints that translate.

    Angles are unwrapped over time, so that curves in an editor do not jump by 360 degrees.
    """
    if channels is None:
        turns = tuple(f"{axis}rotation" for axis in ROTATION_ORDER)
        moves = POSITION_CHANNELS
        moving = motion.moving_joints()
        channels = tuple(moves + turns if j in moving else turns for j in range(len(motion.skeleton)))
    orders = ["".join(name[0] for name in names if name.endswith("rotation")) for names in channels]
    eulers = _unrolled_eulers(motion, orders)
    blocks: list[Array] = []
    places = motion.translations()
    for joint, names in enumerate(channels):
        for name in names:
            if name.endswith("position"):
                blocks.append(places[:, joint, "XYZ".index(name[0])].astype(np.float64))
            else:
                blocks.append(eulers[:, joint, orders[joint].index(name[0])])
    values = np.stack(blocks, axis=-1)
    return BvhFile(motion.skeleton, channels, values, 1.0 / motion.fps)


def _unrolled_eulers(motion: Motion, orders: list[str]) -> Array:
    """Unwrapped Euler angles (T, J, 3) in degrees; the nearer of two equivalent triples to the previous frame."""
    first = np.zeros((len(motion), len(orders), 3))
    for joint, order in enumerate(orders):
        if len(order) not in (0, 3):
            raise BvhError(
                motion.skeleton.names[joint], f"cannot write {len(order)} rotation channels, expected 3"
            )
        if order:
            first[:, joint] = quat_to_euler(motion.local_rotations[:, joint].astype(np.float64), order)
    second = first * np.array([1.0, -1.0, 1.0]) + math.pi
    out = first.copy()
    turn = 2 * math.pi
    for t in range(1, len(out)):
        a = first[t] + turn * np.round((out[t - 1] - first[t]) / turn)
        b = second[t] + turn * np.round((out[t - 1] - second[t]) / turn)
        nearer = np.abs(a - out[t - 1]).sum(-1) <= np.abs(b - out[t - 1]).sum(-1)
        out[t] = np.where(nearer[:, None], a, b)
    return np.rad2deg(out)


def write_bvh(path: str | Path, motion: Motion | BvhFile, scale: float = 1.0) -> None:
    """Write a BVH file atomically, with lengths multiplied by scale.

    Raises:
        BvhError: read_bvh would refuse a value, such as NaN; path stays unchanged.
        MotionkitError: path cannot be written.
    """
    bvh = (
        motion
        if isinstance(motion, BvhFile)
        else motion_to_bvh(motion.scaled(scale) if scale != 1.0 else motion)
    )
    if isinstance(motion, BvhFile) and scale != 1.0:
        bvh = _scaled_file(bvh, scale)
    bvh = _depth_first(bvh)
    _check_numbers(path, bvh)
    with atomic_write(path) as file:
        file.write(bvh.hierarchy or _hierarchy_text(bvh))
        file.write(f"MOTION\nFrames: {bvh.values.shape[0]}\nFrame Time: {_frame_time_text(bvh)}\n")
        np.savetxt(file, bvh.values, fmt="%.6f", delimiter=" ")


def _frame_time_text(bvh: BvhFile) -> str:
    """The frame time with the digits that it needs; zeros say that a short one is exact, if it is."""
    text = f"{bvh.frame_time:.9g}"
    exact = bvh.rate_within <= EXACT_WITHIN
    return f"{bvh.frame_time:.8f}" if exact and significant_digits(text) < ENOUGH_DIGITS else text


def bvh_hierarchy(skeleton: Skeleton) -> tuple[str, list[int]]:
    """The hierarchy section of a skeleton's files, and its joint indices in the order of their channels."""
    still = np.zeros((1, len(skeleton), 4), np.float32)
    still[..., 0] = 1.0
    bvh = _depth_first(motion_to_bvh(Motion(skeleton, still, np.zeros((1, 3), np.float32), 60.0)))
    return _hierarchy_text(bvh), [skeleton.names.index(name) for name in bvh.skeleton.names]


def _hierarchy_text(bvh: BvhFile) -> str:
    return "\n".join(["HIERARCHY", *_hierarchy_lines(bvh)]) + "\n"


def _check_numbers(path: str | Path, bvh: BvhFile) -> None:
    """Raise BvhError for a value that a file cannot hold, before it replaces a good file at path."""
    found = implausible_value(bvh.values)
    if found:
        raise BvhError(path, f"not written: {found[1]}")
    for joint, name in enumerate(bvh.skeleton.names):
        numbers = [*bvh.skeleton.offsets[joint].tolist(), *bvh.skeleton.end_sites.get(joint, ())]
        if not all(abs(number) <= MAX_NUMBER for number in numbers):
            raise BvhError(path, f"not written: the offset of {name} is not a number up to {MAX_NUMBER:,.0f}")
    if not SHORTEST_FRAME <= bvh.frame_time <= LONGEST_FRAME:
        raise BvhError(
            path,
            f"not written: {bvh.frame_time:g} seconds per frame, expected {SHORTEST_FRAME:g} to {LONGEST_FRAME:g}",
        )


def _depth_first(bvh: BvhFile) -> BvhFile:
    """Sort the joints of a file in depth-first order, as the format nests them."""
    skeleton = bvh.skeleton
    order: list[int] = []
    waiting = [0]
    while waiting:
        joint = waiting.pop()
        order.append(joint)
        waiting.extend(reversed(skeleton.children(joint)))
    return bvh if order == list(range(len(skeleton))) else bvh.picked(order)


def _scaled_file(bvh: BvhFile, scale: float) -> BvhFile:
    names = [name for joint in bvh.channels for name in joint]
    factor = np.array([scale if name.endswith("position") else 1.0 for name in names])
    return replace(bvh, skeleton=bvh.skeleton.scaled(scale), values=bvh.values * factor, hierarchy=None)


def _hierarchy_lines(bvh: BvhFile) -> list[str]:
    skeleton = bvh.skeleton
    depth = [0] * len(skeleton)
    lines: list[str] = []
    for joint, parent in enumerate(skeleton.parents):
        depth[joint] = depth[parent] + 1 if parent >= 0 else 0
        if joint:  # close the brackets between the previous joint and this one
            lines.extend("\t" * d + "}" for d in range(depth[joint - 1], depth[joint] - 1, -1))
        tab = "\t" * depth[joint]
        x, y, z = (float(v) for v in skeleton.offsets[joint])
        names = bvh.channels[joint]
        lines.append(f"{tab}{'JOINT' if joint else 'ROOT'} {skeleton.names[joint]}")
        lines.append(tab + "{")
        lines.append(f"{tab}\tOFFSET {x:.6f} {y:.6f} {z:.6f}")
        lines.append(" ".join([f"{tab}\tCHANNELS {len(names)}", *names]))
        if joint in skeleton.end_sites or not skeleton.children(joint):
            x, y, z = skeleton.end_sites.get(joint, (0.0, 0.0, 0.0))
            lines.extend(
                [f"{tab}\tEnd Site", tab + "\t{", f"{tab}\t\tOFFSET {x:.6f} {y:.6f} {z:.6f}", tab + "\t}"]
            )
    lines.extend("\t" * d + "}" for d in range(depth[-1], -1, -1))
    return lines
