"""Loops: finds the best cycle of a clip, cuts it out and closes it, so that its last frame continues in its first.

Two frames are ends of a cycle if poses, velocities and contacts are similar in the root's frame. The remaining
difference of poses is spread over the whole cycle, where it is invisible. The remaining difference of velocities fades
within a fraction of a second on both sides.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from motionkit.arrays import Array, distances_between, lerp, smoothstep
from motionkit.editing.root_motion import at_origin
from motionkit.errors import MotionkitError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_continuous,
    quat_from_yaw,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_slerp,
    quat_to_expmap,
    rotate_ground,
    wrap_angle,
)
from motionkit.rig.upright import Upright

if TYPE_CHECKING:
    from motionkit.control.synthesize import SynthesisResult
    from motionkit.rig.rig import Rig

LEAST_SECONDS, MOST_SECONDS = 0.1, 3600.0  # s, of a length to ask for
SHORTEST = 0.4  # s, shortest cycle; half a step never looks like a cycle
COARSE = 1200  # most frames in the first search; the second search refines the result at the full rate
STRETCH = 120.0  # s, longest part of a clip that is searched at once, or four cycles: strides stay shorter than steps
VELOCITY_SECONDS = 0.08  # s, weight of velocities: a difference of 1 cm/s counts as 0.08 cm
CONTACT_CM = 6.0  # cm, cost of one foot joint that is in contact at one end only
MOST_TURN = np.deg2rad(30.0)  # largest turn of a cycle; it is removed evenly over the cycle
# Limit of the difference between the ends: this share of the median difference between any two frames, within
# [LEAST_LIMIT, MOST_LIMIT] cm.
MOST_SHARE, LEAST_LIMIT, MOST_LIMIT = 0.3, 2.5, 8.0
# A cycle is good if its difference is below AS_GOOD times the best, or below GOOD cm. The shortest good cycle wins.
AS_GOOD, GOOD = 1.25, 3.0
LIVELY = 0.6  # least movement per frame in a cycle, as a share of the clip's mean: rules out pauses
# Somewhere in a cycle the pose must differ from its ends by this share of the clip's median difference.
LEAVES = 0.85
# A clip with a smaller median difference is calm (standing), and its cycles take at least CALM_SHORTEST.
CALM, CALM_SHORTEST = 5.0, 2.0  # cm, s
CLOSED = (
    1.0  # cm; a clip whose last frame is this near to its first, in the heading frame, is a cycle already
)
CLOSED_STEP = 0.5  # the same, as a share of the clip's median step between frames
STILL = 0.05  # cm; a clip with a smaller median difference does not move
# Cycles whose mean velocity is within this share of the clip's median one, or this many cm/s, are preferred.
PACE_SHARE, PACE = 0.1, 10.0
# Among lengths this close to the requested one, as a share or in seconds, the most similar ends win.
WISH_SHARE, WISH_SECONDS = 0.05, 0.1
FADE_SECONDS = 0.25  # s, time on each side of the seam in which the difference of velocities fades
STANDING_SPEED = 25.0  # cm/s; a slower cycle ends at the place where it began
FAR_FROM_WISH = 0.1  # share of a requested length; a larger deviation is reported
CYCLES = 3  # times that a cycle is repeated for a change, of which the second is kept
LOOP_SECONDS = 8.0  # s, default length of the motion to search for a cycle
LOOP_TRIES = (2, 4, 8)  # longer attempts, as multiples of that length, if nothing repeats


@dataclass(frozen=True)
class Seam:
    """The discontinuity where a loop repeats, compared with consecutive frames of the loop.

    Attributes:
        distance: cm between the last frame and the first, for the joint that moves most.
        speed: cm/s between its velocities into the last frame and out of the first.
        frame_distance: largest distance between consecutive frames, cm.
        frame_speed: largest difference of velocities between consecutive frames, cm/s.
    """

    distance: float
    speed: float
    frame_distance: float
    frame_speed: float

    def sentence(self) -> str:
        """The seam in words."""
        return (
            f"seam {self.distance:.2f} cm and {self.speed:.0f} cm/s apart; elsewhere two frames in a row are up to "
            f"{self.frame_distance:.1f} cm and {self.frame_speed:.0f} cm/s apart"
        )

    def as_dict(self) -> dict[str, float]:
        """Plain values for JSON."""
        return {
            "seam_cm": self.distance,
            "seam_cm_s": self.speed,
            "frame_cm": self.frame_distance,
            "frame_cm_s": self.frame_speed,
        }


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed cycle.

    Attributes:
        motion: the frames of the cycle; the last one equals the first, apart from its place on the ground.
        start, end: first and last frame of the cycle in the clip, both included; the motion may repeat it.
        seam: the discontinuity where the cycle repeats.
        difference: cm between the ends of the cycle in the clip: poses, velocities and contacts combined.
        times: how often the motion repeats the cycle.
        at_pace: whether the cycle has about the clip's median velocity, if the clip travels.
    """

    motion: Motion
    start: int
    end: int
    seam: Seam
    difference: float
    times: int = 1
    at_pace: bool = True

    @property
    def seconds(self) -> float:
        """Length of the motion: of the cycle, as often as it is repeated."""
        return (len(self.motion) - 1) / self.motion.fps

    def note(self, wish: float | None) -> str | None:
        """A remark on a cycle that is much longer or shorter than requested (in seconds), else None."""
        if wish is None or abs(self.seconds - wish) <= FAR_FROM_WISH * wish:
            return None
        return f"the cycle nearest to {wish:g} s lasts {self.seconds:.2f} s"

    def sentence(self, name: str) -> str:
        """Which frames of a clip of this name it is, and its length, in words."""
        frames = f"frames {self.start} to {self.end} of {name}"
        once = f"{frames}, {self.seconds / self.times:.2f} s"
        return once if self.times == 1 else f"{once}, {self.times} times: {self.seconds:.2f} s"


def make_loop(motion: Motion, seconds: float | None = None, from_origin: bool = False) -> Loop:
    """Find the best cycle of a motion of any rig and close it.

    Args:
        seconds: length of the cycle; by default that of the shortest good one.
        from_origin: move the cycle to the origin, facing +Z; without it, the cycle keeps its place.

    A clip that is closed already is taken whole. If no cycle is as long as asked, a shorter one is repeated.

    Raises:
        MotionkitError: the motion never repeats, or no loop can be so long.
    """
    check_seconds(seconds)
    upright = Upright.of(motion)
    start, end, difference = _cycle(upright, seconds)
    times = 1
    if seconds is not None and _away(end - start, upright, seconds) > FAR_FROM_WISH * seconds:
        shorter = _cycle(upright)
        again = max(1, round(seconds * upright.motion.fps / (shorter[1] - shorter[0])))
        if _away(again * (shorter[1] - shorter[0]), upright, seconds) < _away(end - start, upright, seconds):
            (start, end, difference), times = shorter, again
    closed = _repeated(_closed(upright, start, end), times)
    if from_origin:
        closed = at_origin(closed, cyclic=True)
    usual = np.median(upright.velocities, axis=0)
    travels = float(np.linalg.norm(usual)) > STANDING_SPEED  # else strikes and jumps would be far from it
    at_pace = not travels or bool(_near_pace(upright.velocities[start:end].mean(axis=0), usual))
    return Loop(upright.back(closed), start, end, seam(closed), difference, times, at_pace)


def check_seconds(seconds: float | None) -> None:
    """Raise MotionkitError for the length of a loop that none can have; None is any length."""
    if seconds is not None and not LEAST_SECONDS <= seconds <= MOST_SECONDS:
        expected = f"expected a loop of {LEAST_SECONDS:g} to {MOST_SECONDS:g} s"
        raise MotionkitError(f"{expected}, found {seconds:g}")


def loop_seconds(wish: float | None) -> float:
    """How many seconds to synthesize for a loop of a given length: enough for several cycles."""
    return LOOP_SECONDS if wish is None else max(LOOP_SECONDS, 2.0 * wish + 2.0)


def find_loops(
    make: Callable[[int], SynthesisResult], kinds: Sequence[str], seconds: float | None = None
) -> tuple[SynthesisResult, list[Loop]]:
    """The best cycle of each synthesized motion, closed and moved to the origin.

    Args:
        make: synthesizes the motions at a multiple of their usual length; called again with more if nothing repeats
            at the usual velocity.
        kinds: their types, which motions take in turn; before a performance they stand.
        seconds: length of the cycle, as in make_loop.

    Returns:
        The result, whose motions are the cycles; and the cycles.

    Raises:
        MotionkitError: even the longest motions never repeat.
    """
    from motionkit.control.script import TypePart

    found = None
    for times in (1, *LOOP_TRIES):
        result = make(times)
        try:
            cycles = [make_loop(one.motion, seconds, from_origin=True) for one in result.motions]
        except MotionkitError as error:
            fault = str(error).replace("the clip", "the motion", 1)
            continue
        found = found or (result, cycles)
        if all(cycle.at_pace for cycle in cycles):
            found = result, cycles
            break
    if found is None:
        raise MotionkitError(f"{fault}; try another --seed, or --seconds")
    result, cycles = found
    motions = tuple(
        replace(
            one,
            motion=cycle.motion,
            contacts=one.contacts[_rows(cycle, len(one.motion), len(one.contacts))],
            types=(TypePart(kind, cycle.seconds),),
            unfinished=None,
            cyclic=True,
        )
        for one, cycle, kind in zip(result.motions, cycles, itertools.cycle(kinds), strict=False)
    )
    return replace(result, motions=motions), cycles


def _rows(cycle: Loop, frames: int, rows: int) -> Array:
    """The row of each frame of a cycle in an array of a number of rows beside the frames that it was taken from."""
    steps = cycle.end - cycle.start
    taken = cycle.start + np.arange(len(cycle.motion)) % steps
    return np.rint(taken * (rows - 1) / max(frames - 1, 1)).astype(np.int64)


def cycle_on_rig(cycle: Motion, rig: Rig, ik: bool, clip: Motion | None = None) -> Motion:
    """A closed cycle from the origin on the skeleton of a rig, closed again; arguments as for finish.on_rig.on_rig."""
    from motionkit.finish.on_rig import on_rig

    if not ik and clip is None:
        return on_rig(cycle, rig, ik)
    rounds = None if clip is None else in_rounds(clip, cycle)
    return changed_cycle(cycle, lambda repeated: on_rig(repeated, rig, ik, rounds))


def changed_cycle(cycle: Motion, change: Callable[[Motion], Motion]) -> Motion:
    """A closed cycle from the origin after a change that looks at neighbouring frames, such as finishing on a rig."""
    steps = len(cycle) - 1
    upright = Upright.of(change(_repeated(cycle, CYCLES)))
    return upright.back(at_origin(_closed(upright, steps, 2 * steps), cyclic=True))


def in_rounds(clip: Motion, cycle: Motion) -> Motion:
    """The beginning of a clip, as long as a closed cycle, at its rate, and as often as changed_cycle repeats the cycle.

    Its end leads back to its first frame; the last frame of a shorter clip is held.
    """
    clip, frames = resample(clip, cycle.fps), len(cycle) - 1
    rows = np.tile(np.minimum(np.arange(frames), len(clip) - 1), CYCLES)
    fade = max(1, min(round(FADE_SECONDS * cycle.fps), frames // 2))
    back = np.tile(smoothstep(np.maximum(np.arange(frames) - frames + fade, 0) / fade), CYCLES)[:, None]
    turns, places = clip.local_rotations, clip.local_positions
    return replace(
        clip,
        local_rotations=quat_slerp(turns[rows], turns[[0]], back),
        root_positions=clip.root_positions[rows],
        local_positions=None if places is None else lerp(places[rows], places[[0]], back[..., None]),
    )


def _away(steps: int, upright: Upright, seconds: float) -> float:
    """How many seconds a cycle of so many steps differs from a wish."""
    return abs(steps / upright.motion.fps - seconds)


def _repeated(cycle: Motion, times: int) -> Motion:
    """A closed cycle several times in a row, each from the place where the last one ended."""
    if times == 1:
        return cycle
    steps = len(cycle) - 1
    away = (cycle.root_positions[-1] - cycle.root_positions[0]) * np.array([1.0, 0.0, 1.0], np.float32)
    frames = np.arange(times * steps + 1)
    rows = np.where(frames == frames[-1], steps, frames % steps)
    rounds = np.minimum(frames // steps, times - 1)[:, None].astype(np.float32)
    local = cycle.local_positions
    return replace(
        cycle,
        local_rotations=quat_continuous(cycle.local_rotations[rows]),
        root_positions=cycle.root_positions[rows] + rounds * away,
        local_positions=None if local is None else local[rows],
    )


def _cycle(upright: Upright, seconds: float | None = None) -> tuple[int, int, float]:
    """The cycle of find_cycle; the whole clip if nothing else repeats and its last frame is its first, or nearly.

    A clip that was made as a cycle is not cut for one that is a little shorter.
    """
    apart, step = _ends(upright)
    whole = 0, len(upright.motion) - 1, float(apart.mean())
    try:
        found = find_cycle(upright, seconds)
    except MotionkitError:
        if not step or apart.max() > max(CLOSED, CLOSED_STEP * step):
            raise
        return whole
    made_as_one = seconds is None and apart.max() < min(CLOSED, step)
    return whole if made_as_one and 2 * (found[1] - found[0]) > whole[1] else found


def is_cycle(motion: Motion) -> bool:
    """Whether a motion was made as one cycle: its last frame equals its first, somewhere else on the ground perhaps."""
    if len(motion) < 3:
        return False
    apart, step = _ends(Upright.of(motion))
    return bool(apart.max() < min(CLOSED, step))


def at_rate(motion: Motion, fps: float, cyclic: bool = False) -> Motion:
    """Resample a motion; one that was made as a cycle, or is said to be cyclic, stays closed."""
    return resample(motion, fps, cyclic or (motion.fps != fps and is_cycle(motion)))


def _ends(upright: Upright) -> tuple[Array, float]:
    """Distances (J,) in cm of the last frame from the first, and the median step of the fastest joint; 0 if still."""
    ends = upright.positions if upright.canonical is None else upright.facing_positions
    moves = len(ends) > 2 and float(np.ptp(ends, axis=0).max()) > CLOSED
    steps = np.linalg.norm(np.diff(ends, axis=0), axis=-1)
    return np.linalg.norm(ends[-1] - ends[0], axis=-1), float(np.median(steps.max(axis=-1))) if moves else 0.0


def find_cycle(upright: Upright, seconds: float | None = None) -> tuple[int, int, float]:
    """First and last frame of the best cycle, and the difference between them in cm.

    A long clip is searched in stretches. Of their cycles, those at the clip's pace are preferred.

    Raises:
        MotionkitError: the motion never repeats.
    """
    motion = upright.motion
    stretches = -(-len(motion) // round(max(STRETCH, 4.0 * (seconds or 0.0)) * motion.fps))
    if stretches <= 1:
        return _found(upright, seconds)
    usual = np.median(upright.velocities, axis=0)
    found, faults = [], set[str]()
    for frames in np.array_split(np.arange(len(motion)), stretches):
        first = int(frames[0])
        part = Upright(motion.cut(first, first + len(frames)))
        try:
            start, end, difference = _found(part, seconds)
        except MotionkitError as error:
            faults.add(str(error))
            continue
        other_pace = not _near_pace(part.velocities[start : end + 1].mean(axis=0), usual)
        found.append((other_pace, difference, first + start, first + end))
    if not found:
        words = f"the clip never repeats within {len(motion) / stretches / motion.fps:.0f} s"
        raise MotionkitError(faults.pop() if len(faults) == 1 else words)
    _, difference, start, end = min(found)
    return start, end, difference


def _found(upright: Upright, seconds: float | None) -> tuple[int, int, float]:
    """The cycle of find_cycle in a clip that is not too long for one search."""
    fps, frames = upright.motion.fps, len(upright.motion)
    least = max(3, round(SHORTEST * fps))
    if frames <= least + 1:
        raise MotionkitError(
            f"the clip lasts {frames / fps:.2g} s, expected more than {SHORTEST:g} s to find a cycle in"
        )
    rows = pose_rows(upright)
    stride = max(1, -(-frames // COARSE))
    every = np.arange(0, frames, stride)
    apart = distances_between(rows[every], rows[every])
    usual = float(np.median(apart))
    if usual < CALM:
        least = min(round(CALM_SHORTEST * fps), frames - 2)
    if usual < STILL:
        raise MotionkitError("the clip does not move, expected movement to find a cycle in")
    pairs = _allowed(upright, every, least) & (_reach(apart) >= LEAVES * usual)
    if not bool(pairs.any()):
        raise MotionkitError(
            "the clip never repeats: no two frames have the same facing and enough movement between them"
        )
    limit = min(max(MOST_SHARE * usual, LEAST_LIMIT), MOST_LIMIT)
    usual_pace = pairs & _at_its_pace(upright, every)
    pairs = usual_pace if bool((apart[usual_pace] <= limit).any()) else pairs
    apart = np.where(pairs, apart, np.inf)
    a, b = (
        _shortest(apart, every, limit)
        if seconds is None
        else _nearest(apart, every, seconds * fps, fps, limit)
    )
    start, end, difference = _refined(rows, int(every[a]), int(every[b]), stride, least)
    if difference > limit:
        raise MotionkitError(
            f"the clip never repeats: the ends of its best cycle, frames {start} and {end}, are too different to loop: "
            f"{_furthest(upright, start, end)}"
        )
    return start, end, difference


def _furthest(upright: Upright, start: int, end: int) -> str:
    """What is furthest between two frames, in words: a joint in the heading frame, or how one moves."""
    skeleton = (upright.canonical or upright.motion).skeleton
    poses = upright.facing_positions
    apart = np.linalg.norm(poses[end] - poses[start], axis=-1)
    joint = int(apart.argmax())
    speeds = (
        np.linalg.norm(np.gradient(poses, axis=0)[[start, end]], axis=-1).max(axis=0) * upright.motion.fps
    )
    if VELOCITY_SECONDS * float(speeds.max()) > float(apart[joint]) and apart[joint] < LEAST_LIMIT:
        return f"{skeleton.names[int(speeds.argmax())]} moves another way"
    return f"{skeleton.names[joint]} {apart[joint]:.0f} cm apart"


def pose_rows(upright: Upright) -> Array:
    """Poses, velocities and contacts (T, C), scaled so that the distance of two rows is a mean over joints in cm."""
    poses = upright.facing_positions.astype(np.float64)
    frames, joints = poses.shape[:2]
    speeds = np.gradient(poses, axis=0) * upright.motion.fps
    # Poses hardly show sliding feet and a stopping root, so root velocity weighs as much as all joints together.
    parts = [
        poses.reshape(frames, -1) / np.sqrt(joints),
        VELOCITY_SECONDS * speeds.reshape(frames, -1) / np.sqrt(joints),
        VELOCITY_SECONDS * upright.velocities,
        CONTACT_CM / 2.0 * upright.contacts,
    ]
    return np.concatenate(parts, axis=1)


def _allowed(upright: Upright, every: Array, least: int) -> Array:
    """Which pairs of frames (N, N) may be ends: far enough apart, similar headings, and movement in between."""
    speeds = np.linalg.norm(np.gradient(upright.facing_positions.astype(np.float64), axis=0), axis=-1).mean(
        axis=1
    )
    moved = np.cumsum(speeds)[every]
    lengths = every[None, :] - every[:, None]
    heading = upright.heading[every].astype(np.float64)
    turned = np.abs(wrap_angle(heading[None, :] - heading[:, None]))
    mean = float(speeds.mean())
    lively = moved[None, :] - moved[:, None] >= LIVELY * mean * lengths
    return (lengths >= least) & (turned <= MOST_TURN) & lively


def _reach(apart: Array) -> Array:
    """Largest difference (N, N) from the first of two frames, over all frames up to the second."""
    return np.asarray(np.maximum.accumulate(np.triu(apart), axis=1))


def _at_its_pace(upright: Upright, every: Array) -> Array:
    """Which pairs of frames (N, N) enclose motion at about the clip's median velocity."""
    way = np.cumsum(upright.velocities, axis=0)[every]
    lengths = np.maximum(every[None, :] - every[:, None], 1)[..., None]
    return _near_pace((way[None, :] - way[:, None]) / lengths, np.median(upright.velocities, axis=0))


def _near_pace(velocities: Array, usual: Array) -> Array:
    """Which velocities (..., 2) are about a usual one (2,)."""
    away = np.linalg.norm(velocities - usual, axis=-1)
    return np.asarray(away <= max(PACE_SHARE * float(np.linalg.norm(usual)), PACE))


def _shortest(apart: Array, every: Array, limit: float) -> tuple[int, int]:
    """Indices of the ends of the shortest good cycle, given the differences (N, N); disallowed pairs are infinite."""
    lengths = every[None, :] - every[:, None]
    good = apart <= max(AS_GOOD * float(apart.min()), min(0.5 * limit, GOOD))
    near = good & (lengths <= 1.1 * lengths[good].min())
    return _least(np.where(near, apart, np.inf))


def _nearest(apart: Array, every: Array, wish: float, fps: float, limit: float) -> tuple[int, int]:
    """Indices of the ends of the cycle whose length is nearest to the requested one, in frames."""
    away = np.abs(every[None, :] - every[:, None] - wish)
    tolerance = max(min(WISH_SHARE * wish, WISH_SECONDS * fps), 0.5 * (every[1] - every[0]))
    best = float(apart.min())
    # The coarse search may miss a pair that would be within the limit at the full rate.
    usable = apart <= (limit if best <= limit else AS_GOOD * best)
    if not bool((usable & (away <= tolerance)).any()):
        # Otherwise a pair on the slope beside a minimum would win for its length, though its ends differ more.
        usable &= _bottoms(apart)
    near = usable & (away <= away[usable].min() + tolerance)
    return _least(np.where(near, apart, np.inf))


def _bottoms(values: Array) -> Array:
    """Which values (N, M) are local minima among their four neighbours."""
    wide = np.pad(values, 1, constant_values=np.inf)
    beside = wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]
    lowest: Array = np.minimum.reduce(beside)
    return values <= lowest


def _least(values: Array) -> tuple[int, int]:
    row, column = np.unravel_index(int(values.argmin()), values.shape)
    return int(row), int(column)


def _refined(rows: Array, start: int, end: int, stride: int, least: int) -> tuple[int, int, float]:
    """The best ends within one stride of the coarse result; the length changes by at most one stride."""
    starts = np.arange(max(0, start - stride), min(len(rows), start + stride + 1))
    ends = np.arange(max(0, end - stride), min(len(rows), end + stride + 1))
    apart = distances_between(rows[starts], rows[ends])
    lengths = ends[None, :] - starts[:, None]
    apart[(lengths < least) | (np.abs(lengths - (end - start)) > stride)] = np.inf
    a, b = _least(apart)
    return int(starts[a]), int(ends[b]), float(apart[a, b])


def _closed(upright: Upright, start: int, end: int) -> Motion:
    """The frames start to end (included), changed so that the last one equals the first, apart from its place."""
    source = upright.motion.cut(start, end + 1)
    heading = upright.heading[start : end + 1].astype(np.float64)
    steps = end - start
    share = np.arange(steps + 1) / steps
    fade = _fades(steps, upright.motion.fps)
    # Work in the heading frame, so that the cycle's place and heading do not matter.
    facing = quat_from_yaw(-heading)
    rotations = source.local_rotations.astype(np.float64)
    rotations[:, 0] = quat_multiply(facing, rotations[:, 0])
    rotations = _closed_rotations(quat_normalize(quat_continuous(rotations)), share, fade)
    turn = wrap_angle(heading[-1:] - heading[:1])[0]
    rate = np.diff(heading) - turn / steps
    straight = heading[0] + np.concatenate([[0.0], np.cumsum(rate)])
    straight += fade @ np.array([rate[0] - rate[-1]])
    heights = source.root_positions[:, 1:2].astype(np.float64)
    place = _closed_track(
        source.root_positions[:, [0, 2]].astype(np.float64), heading, straight, fade, upright.motion.fps
    )
    rotations[:, 0] = quat_multiply(quat_from_yaw(straight), rotations[:, 0])
    heights = _closed_values(heights, share, fade)
    roots = np.concatenate([place[:, :1], heights, place[:, 1:]], axis=1)
    local = source.local_positions
    if local is not None:
        local = _closed_values(local.astype(np.float64), share, fade).astype(np.float32)
    return replace(
        source,
        local_rotations=quat_continuous(quat_normalize(rotations)).astype(np.float32),
        root_positions=roots.astype(np.float32),
        local_positions=local,
    )


def _fades(steps: int, fps: float) -> Array:
    """Offset (T, 1) per unit by which the first step of a cycle exceeds its last step."""
    frames = np.arange(steps + 1.0)
    wide = max(2.0, min(FADE_SECONDS * fps, 0.4 * steps))
    out = np.zeros(steps + 1)
    for side in (frames, steps - frames):
        out -= 0.5 * side * np.square(np.clip(1.0 - side / wide, 0.0, 1.0))
    return out[:, None]


def _closed_rotations(rotations: Array, share: Array, fade: Array) -> Array:
    """Rotations (T, J, 4), changed so that the last frame equals the first."""
    gap = quat_to_expmap(quat_multiply(rotations[0], quat_inverse(rotations[-1])))
    spread = (share - 0.5)[:, None, None] * gap
    out = quat_multiply(expmap_to_quat(spread), rotations)
    into = quat_to_expmap(quat_multiply(out[-1], quat_inverse(out[-2])))
    away = quat_to_expmap(quat_multiply(out[1], quat_inverse(out[0])))
    out = quat_multiply(expmap_to_quat(fade[..., None] * (away - into)), out)
    out[-1] = out[0]
    return out


def _closed_values(values: Array, share: Array, fade: Array) -> Array:
    """Values (T, ...), changed so that the last frame equals the first."""
    shape = (len(values), *[1] * (values.ndim - 1))
    out = values + (share - 0.5).reshape(shape) * (values[0] - values[-1])
    out = out + fade.reshape(shape) * ((out[1] - out[0]) - (out[-1] - out[-2]))
    out[-1] = out[0]
    return out


def _closed_track(track: Array, heading: Array, straight: Array, fade: Array, fps: float) -> Array:
    """The ground track (T, 2) for new headings: the same steps in the heading frame, with equal first and last step.

    A track that hardly travels ends at its start.
    """
    middle, now = 0.5 * (heading[1:] + heading[:-1]), 0.5 * (straight[1:] + straight[:-1])
    steps = rotate_ground(now - middle, np.diff(track, axis=0))
    out = track[0] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    away = out[-1] - out[0]
    if float(np.linalg.norm(away)) * fps / (len(track) - 1) < STANDING_SPEED:
        out = out - np.arange(len(track))[:, None] / (len(track) - 1) * away
    return out + fade * ((out[1] - out[0]) - (out[-1] - out[-2]))


def motion_seam(motion: Motion) -> Seam:
    """The seam of a loop on any rig."""
    return seam(Upright.of(motion).motion)


def seam(motion: Motion) -> Seam:
    """The seam of a loop, in cm: its last frame compared with its first, moved to the last frame's place."""
    _, positions = motion_kinematics(motion)
    positions = positions.astype(np.float64)
    cycle = (positions[-1, 0] - positions[0, 0]) * np.array([1.0, 0.0, 1.0])
    again = np.concatenate([positions, positions[1:3] + cycle])
    steps = np.diff(again, axis=0)
    bends = np.linalg.norm(np.diff(steps, axis=0), axis=-1).max(axis=-1) * motion.fps
    last = len(positions) - 1
    return Seam(
        float(np.linalg.norm(positions[0] + cycle - positions[-1], axis=-1).max()),
        float(bends[last - 1]),
        float(np.linalg.norm(steps[:last], axis=-1).max()),
        float(bends[: last - 1].max()),
    )
