"""Joins clips one after another: each continues where and how the one before it ends.

The next clip is moved and turned over the ground to where the one before it is. Both are cut where their poses,
velocities and contacts are most similar; what still differs decays (motion/inertialize.py), and feet that touch the
ground meanwhile are held. All other frames stay as they were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from motionkit.arrays import Array, distances_between, lerp, smoothstep
from motionkit.editing.fix import moved_like
from motionkit.editing.loop import pose_rows
from motionkit.errors import MotionkitError, SkeletonError
from motionkit.finish.feet import clear_toes, contacts_around, lock_feet
from motionkit.finish.on_rig import on_rig
from motionkit.free_memory import check_memory
from motionkit.metrics.ground import average_foot_sliding
from motionkit.motion.bvh import motion_to_bvh
from motionkit.motion.floor import floor_height, floor_shift, foot_positions
from motionkit.motion.inertialize import continued
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_continuous, quat_slerp
from motionkit.motion.skeleton import Skeleton, spoken
from motionkit.reading import as_found, reading
from motionkit.rig.names import map_rig
from motionkit.rig.on_rig import on_the_floor
from motionkit.rig.retarget import retarget
from motionkit.rig.rig import Rig, make_rig
from motionkit.rig.units import rig_unit
from motionkit.rig.up_axis import up_name
from motionkit.rig.upright import Upright

WINDOW = 1.0  # s at the end of a clip and at the start of the next in which frames to join are looked for
BLEND = 0.5  # s over which the difference at a join decays
# cm, mean distance of the joints of two poses: further apart they are not joined, and from FAR on the blend shows.
MOST_APART, FAR = 25.0, 15.0
AS_GOOD, NEAR = 1.1, 0.2  # a pair within this factor and this many cm of the best is as good
SAME_REST = 0.01  # share of the body by which the bones of the same rig may differ
FADE = 0.2  # s before and after, over which foot locking fades in and out


@dataclass(frozen=True)
class Seam:
    """Where two clips are joined.

    Attributes:
        leave: s in the clip before, its last moment.
        enter: s in the next clip, which goes on from there.
        frame: the first frame of the next clip in the joined motion.
        apart: cm between the poses, the mean over the joints.
        farthest: the joint that is furthest apart, and its distance in cm.
        sliding: cm/s by which the feet slide around the join before and after they are held; None if not human.
    """

    leave: float
    enter: float
    frame: int
    apart: float
    farthest: tuple[str, float]
    sliding: tuple[float, float] | None

    def sentence(self, first: str, second: str) -> str:
        """The seam in words, with the names of the clips."""
        joint, far = self.farthest
        text = (
            f"{first} to {self.leave:.2f} s, {second} from {self.enter:.2f} s: poses {self.apart:.1f} cm apart "
            f"({joint} {far:.0f} cm)"
        )
        if self.sliding is not None:
            text += f"; feet slide {self.sliding[0]:.1f} cm/s, held {self.sliding[1]:.1f}"
        return text

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        sliding = self.sliding or (None, None)
        return {
            "leave": self.leave,
            "enter": self.enter,
            "frame": self.frame,
            "apart_cm": self.apart,
            "farthest": self.farthest[0],
            "farthest_cm": self.farthest[1],
            "sliding_cm_s": sliding[0],
            "sliding_held_cm_s": sliding[1],
        }


@dataclass(frozen=True, eq=False)
class Joined:
    """Clips in one motion, on the rig of the first, and the seams between them."""

    motion: Motion
    seams: tuple[Seam, ...]


def join_motions(
    motions: Sequence[Motion],
    *,
    at: Sequence[tuple[float, float]] | None = None,
    window: float | None = None,
    blend: float = BLEND,
    rig: Rig | None = None,
    fps: float | None = None,
    names: Sequence[str] | None = None,
) -> Joined:
    """Join motions one after another; those of other human rigs are retargeted.

    Args:
        motions: two or more, of any rig and rate.
        at: for each join, seconds at which the motion before is left and the next is entered; by default the best
            pair of frames within the window.
        window: seconds at the end of a motion and at the start of the next; WINDOW by default, or half a motion.
        blend: seconds over which the difference at a join decays.
        rig: rig of the result; that of the first motion by default.
        fps: rate of the result; that of the first motion by default.
        names: of the motions, for messages.

    Raises:
        MotionkitError: fewer than two motions, a window or a time outside of one, or poses that are too different.
        SkeletonError: motions of different rigs, of which one is not human.
    """
    names = names or [f"motion {number}" for number in range(1, len(motions) + 1)]
    rate = fps or (motions[0].fps if motions else 0.0)
    _check_number(motions, at, rate)
    clips = _on_one_rig([resample(each, rate) for each in motions], rig, names)
    _check_lengths(clips, names, window)
    parts, contacts, seams = [clips[0].motion], [clips[0].contacts], list[Seam]()
    before = 0  # frames of all parts but the last
    start, turn = 0, 0.0  # the frame at which the clip before was entered, and by how much it was turned
    for number, (left, entered) in enumerate(pairwise(clips)):
        words = (names[number], names[number + 1])
        i, j = (
            _best_frames(left, entered, start, window, blend, words)
            if at is None
            else _requested_frames(left, entered, start, at[number], words)
        )
        left_out = len(left.motion) - 1 - i
        end = len(parts[-1]) - left_out
        seams.append(_seam(left, entered, i, j, before + end))
        turn += float(left.heading[i] - entered.heading[j])
        decay = max(1, round(blend * rate))
        parts[-1:] = _joined_at(parts[-1], end, entered.motion, j, turn, decay)
        before += len(parts[-2])
        contacts[-1:] = contacts[-1][: len(contacts[-1]) - left_out], entered.contacts[j + 1 :]
        start = j
    made = parts[0].followed_by(*parts[1:])
    frames = [seam.frame for seam in seams]
    locked = _with_locked_feet(made, np.concatenate(contacts), frames, round(blend * rate))
    slides = zip(*(_sliding(each, frames, blend) for each in (made, locked)), strict=True)
    measured = [
        replace(seam, sliding=None if None in slid else slid)
        for seam, slid in zip(seams, slides, strict=True)
    ]
    return Joined(clips[0].back(locked), tuple(measured))


def _check_number(motions: Sequence[Motion], at: Sequence[tuple[float, float]] | None, rate: float) -> None:
    if len(motions) < 2:
        raise MotionkitError(f"expected at least 2 clips to join, found {len(motions)}")
    if at is not None and len(at) != len(motions) - 1:
        raise MotionkitError(f"{len(motions)} clips have {len(motions) - 1} joins, found times for {len(at)}")
    joints = max(len(each.skeleton) for each in motions)
    check_memory(round(sum(each.seconds for each in motions) * rate), joints, rate)


def _on_one_rig(motions: Sequence[Motion], rig: Rig | None, names: Sequence[str]) -> list[Upright]:
    """The motions on one rig, that of the first by default, in cm with Y up and on the floor of the first."""
    target = Upright.of(motions[0])
    if rig is not None:
        with as_found():
            scale = rig_unit(rig.skeleton, rig.leg)[0]
        if _same(target.motion.skeleton, rig.skeleton.scaled(scale)):
            target = replace(target, scale=scale, up=rig.up, rig=rig.skeleton)
        else:
            target = _retargeted(motions[0], rig, scale, rig.up, names[0])
    out = [target]
    for motion, name in zip(motions[1:], names[1:], strict=True):
        mine = Upright.of(motion)
        if _same(mine.motion.skeleton, target.motion.skeleton):
            mine = Upright(replace(mine.motion, skeleton=target.motion.skeleton))
        else:
            rig = rig or _rig_of(motions[0], names)
            mine = _retargeted(motion, rig, target.scale, target.up, name)
        out.append(_level(mine, target))
    if any(each.canonical is None for each in out):  # then all are compared by the joints of the rig
        out = [replace(each, as_human=False) for each in out]
    moving = any(each.motion.local_positions is not None for each in out)
    return [replace(each, motion=_with_places(each.motion)) for each in out] if moving else out


def _same(mine: Skeleton, other: Skeleton) -> bool:
    """Whether two skeletons in cm have the same joints and the same bones; the place of the root does not count."""
    if not mine.same_hierarchy(other):
        return False
    near = SAME_REST * max(float(np.ptp(other.rest_positions(), axis=0).max()), 1e-6)
    return bool(np.abs(mine.offsets[1:] - other.offsets[1:]).max(initial=0.0) <= near)


def _rig_of(motion: Motion, names: Sequence[str]) -> Rig:
    try:
        return make_rig(motion_to_bvh(motion), names[0])
    except SkeletonError as error:
        raise SkeletonError(f"{names[0]}: the other clips are on other rigs, and {error}") from None


def _retargeted(motion: Motion, rig: Rig, scale: float, up: Array, name: str) -> Upright:
    """A motion of another human rig on a rig, whose scale in cm and up axis are known."""
    try:
        canonical = on_the_floor(retarget(motion_to_bvh(motion))[0])
    except SkeletonError as error:
        raise SkeletonError(f"{name}: is on another rig, and {error}") from None
    same_rig = rig.skeleton.same_hierarchy(motion.skeleton) and motion.local_positions is None
    made = on_rig(canonical, rig, clip=motion if same_rig else None)
    with reading(up=up_name(up), cm=scale):
        return Upright.of(made)


def _level(upright: Upright, first: Upright) -> Upright:
    """A motion whose feet stand as high as those of the first; as it is if one of them never stands."""
    if upright.canonical is None or first.canonical is None:
        return upright
    (mine, notes), (target, others) = floor_shift(upright.canonical), floor_shift(first.canonical)
    if notes or others:
        return upright
    up = np.array([0.0, mine - target, 0.0], np.float32)
    return replace(upright, motion=replace(upright.motion, root_positions=upright.motion.root_positions + up))


def _with_places(motion: Motion) -> Motion:
    """The motion with local positions, which some others of a row have."""
    if motion.local_positions is not None:
        return motion
    places = np.repeat(motion.skeleton.offsets[None].astype(np.float32), len(motion), axis=0)
    places[:, 0] = motion.root_positions
    return replace(motion, local_positions=places)


def _check_lengths(clips: Sequence[Upright], names: Sequence[str], window: float | None) -> None:
    for clip, name in zip(clips, names, strict=True):
        if len(clip.motion) < 4:
            raise MotionkitError(f"{name}: expected at least 4 frames to join, found {len(clip.motion)}")
        if window is not None and window > clip.motion.seconds:
            raise MotionkitError(
                f"{name}: lasts {clip.motion.seconds:.2f} s, expected at least the window of {window:g} s"
            )


def _requested_frames(
    left: Upright, entered: Upright, start: int, at: tuple[float, float], words: tuple[str, str]
) -> tuple[int, int]:
    """The frames of given times, for which there must be a frame before and after."""
    out = []
    for clip, seconds, name, least, after in (
        (left, at[0], words[0], start + 2, 0),
        (entered, at[1], words[1], 0, 2),
    ):
        frame, last = round(seconds * clip.motion.fps), len(clip.motion) - 1 - after
        if not least <= frame <= last:
            raise MotionkitError(
                f"{name}: asked to join at {seconds:g} s, expected {least / clip.motion.fps:.2f} to "
                f"{last / clip.motion.fps:.2f} s"
            )
        out.append(frame)
    return out[0], max(out[1], 1)


def _best_frames(
    left: Upright, entered: Upright, start: int, window: float | None, blend: float, words: tuple[str, str]
) -> tuple[int, int]:
    """The most similar frames at the end of a clip and at the start of the next; raises MotionkitError."""
    fps, frames = left.motion.fps, (len(left.motion), len(entered.motion))
    spans = [round((window or min(WINDOW, 0.5 * n / fps)) * fps) for n in frames]
    # A clip goes on until half the difference to the one before it has decayed, if it is long enough.
    least = min(start + max(2, round(0.5 * blend * fps)) if start else 1, frames[0] - 2)
    ends = np.arange(max(least, frames[0] - max(spans[0], 1)), frames[0])
    starts = np.arange(1, max(1, min(spans[1], frames[1] - 3)) + 1)
    apart = distances_between(pose_rows(left)[ends], pose_rows(entered)[starts])
    near = apart <= AS_GOOD * apart.min() + NEAR  # of them, those that keep most of both clips
    kept = np.where(near, ends[:, None] - starts, -np.inf)
    row, column = np.unravel_index(int(kept.argmax()), apart.shape)
    i, j = int(ends[row]), int(starts[column])
    mean, (joint, far) = _apart(left, entered, i, j)
    if mean > MOST_APART:
        raise MotionkitError(
            f"{words[0]} and {words[1]} are too different to join: {joint} {far:.0f} cm apart at best; "
            "trim them, or give times to join them at all the same"
        )
    return i, j


def _apart(left: Upright, entered: Upright, i: int, j: int) -> tuple[float, tuple[str, float]]:
    """The mean distance in cm of two poses in the heading frame, and the joint that is furthest apart."""
    apart = np.linalg.norm(left.facing_positions[i] - entered.facing_positions[j], axis=-1)
    skeleton = (left.canonical or left.motion).skeleton
    joint = int(apart.argmax())
    return float(apart.mean()), (spoken(skeleton.names[joint]), float(apart[joint]))


def _seam(left: Upright, entered: Upright, i: int, j: int, frame: int) -> Seam:
    fps = left.motion.fps
    return Seam(i / fps, j / fps, frame, *_apart(left, entered, i, j), None)


def _joined_at(
    made: Motion, end: int, entered: Motion, j: int, turn: float, decay: int
) -> tuple[Motion, Motion]:
    """A motion until `end`, and then another from after frame j: what stays, and the end that the next join needs."""
    after = continued(made, end - 1, entered, j, np.array(turn, np.float32), decay)
    speed = max(end - 2, 0)  # two frames give the speed at a join
    joined = made.cut(speed, end).followed_by(after)
    return made.cut(0, speed), replace(joined, local_rotations=quat_continuous(joined.local_rotations))


def _with_locked_feet(motion: Motion, contacts: Array, frames: Sequence[int], decay: int) -> Motion:
    """The motion with feet locked that are in contact while the difference at a join decays.

    Args:
        contacts: (T, 4) as recorded, or (T, 0) where a clip is not read as a human.
        frames: the first frames after the joins.
        decay: frames over which the differences decay.
    """
    canonical = Upright(motion).canonical if contacts.size else None
    if canonical is None:
        return motion
    up = np.array([0.0, floor_shift(canonical)[0], 0.0], np.float32)
    before = replace(canonical, root_positions=canonical.root_positions + up)
    near, share = np.zeros_like(contacts), np.zeros(len(motion), np.float32)
    for frame in frames:
        end = min(frame + decay, len(motion))
        touching = contacts_around(contacts, frame, end, motion.fps)
        near = np.maximum(near, touching)
        share[frame:end] = 1.0
    share[near.any(axis=1)] = 1.0
    every, marked = np.arange(len(motion)), np.flatnonzero(share)
    ahead = np.searchsorted(marked, every).clip(max=len(marked) - 1)
    distance = np.minimum(np.abs(marked[ahead] - every), np.abs(marked[ahead - 1] - every))
    share = smoothstep(np.clip(1.0 - distance / (FADE * motion.fps), 0.0, 1.0)).astype(np.float32)
    locked = clear_toes(lock_feet(before, near))
    after = replace(
        before,
        local_rotations=quat_slerp(before.local_rotations, locked.local_rotations, share[:, None]),
        root_positions=lerp(before.root_positions, locked.root_positions, share[:, None]),
    )
    moved, changed = moved_like(motion, map_rig(motion.skeleton), before, after), share > 0.0
    return replace(
        moved,
        local_rotations=np.where(changed[:, None, None], moved.local_rotations, motion.local_rotations),
        root_positions=np.where(changed[:, None], moved.root_positions, motion.root_positions),
    )


def _sliding(motion: Motion, frames: Sequence[int], blend: float) -> list[float | None]:
    """The speed in cm/s by which feet on the floor slide around each join; None for rigs that are not human."""
    canonical = Upright(motion).canonical
    if canonical is None:
        return [None] * len(frames)
    feet = foot_positions(motion_kinematics(canonical)[1])
    floor, span = floor_height(feet, motion.fps), round(blend * motion.fps) + 1
    around = [feet[max(0, frame - span // 2) : frame + span] for frame in frames]
    return [(average_foot_sliding(each, floor).value or 0.0) * motion.fps for each in around]
