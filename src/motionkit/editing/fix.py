"""Repairs a clip of any rig: glitches, jitter, floor and foot sliding. Joints, bone lengths and unit stay.

Glitches and jitter are removed on the rig's own joints. Floor and feet are repaired on the canonical joints, with the
rig's bone lengths; the rotations of foot locking are then applied to the rig's joints in world space.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from motionkit.arrays import Array, length
from motionkit.data.cleaning import Limb, hold_ends, repair
from motionkit.data.smoothing import smooth, smooth_rotations, window_at
from motionkit.editing.root_from_feet import root_from_feet
from motionkit.errors import MotionkitError, SkeletonError
from motionkit.finish.finish import Finish, finish
from motionkit.metrics.body_movement import geodesic_movement
from motionkit.metrics.report import evaluate_motion
from motionkit.metrics.smoothness import mean_jerk
from motionkit.motion.ankles import Foot, repair_ankles
from motionkit.motion.floor import TOES, floor_shift
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_angle,
    quat_continuous,
    quat_inverse,
    quat_multiply,
    quat_normalize,
)
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS
from motionkit.names import counted
from motionkit.rig.names import RigMap, map_rig
from motionkit.rig.up_axis import up_axis, up_name
from motionkit.rig.upright import Upright, relative_rotation

LEG_PARTS = ("UpLeg", "Leg", "Foot", "ToeBase")
SIDES = ("Left", "Right")
# Measures of the table, and their names there. The share of low toes that are fast (skate-ratio) is none of them: feet
# that are held land and lift off faster, so it rises where no foot slides in contact.
MEASURED: dict[str, str] = {
    "floor-height": "height of standing feet",
    "penetration-max": "deepest below the floor",
    "afs": "foot sliding (AFS)",
    "standing-speed": "speed of standing toes",
    "jerk": "trembling (jerk)",
}
PASSES = 8  # most passes of all repairs, and over glitches; each may uncover others
# cm/s, and cm besides, that a root moves at most between two frames; further leaps are spikes, or frames elsewhere.
FASTEST_ROOT, ROOT_SLACK = 2000.0, 50.0
# Most frames at the start of a clip that are apart from it, and the mean turn of the joints (degrees) out of them: at
# least, and relative to the median of the steps after. Rest poses at the start of clips turn by 13 and more; measured.
MOST_APART, APART, APART_SHARE = 3, 10.0, 8.0
# Share, and amounts besides, by which a step may raise what it is to lower, and what it is not about; nobody sees them.
WORSE_SHARE = 1.05
WORSE = {"jerk": 0.02, "afs": 0.005, "floor": 0.02, "standing-speed": 0.1}
WORSE_BESIDE = {"afs": 0.02, "penetration-max": 0.5, "jerk": 0.02}
WORSE_IN_ALL = WORSE_BESIDE | {"standing-speed": 2.0}
# cm that a pass moves joints, in the mean and at most, and radians that it turns them, below which it is left out
# and repairs end: nobody sees them.
SEEN_MEAN, SEEN, SEEN_TURN = 0.05, 1.0, 1.0
# Share of a track's third differences that the filter leaves at most if it trembles: .06 to .45 in trembling captures,
# by their rate, .55 to 1 in clean ones, fast or slow; measured.
TREMBLES = 0.5
FAR_OFF = 15.0  # cm; without toes the floor is uncertain, so it is moved only if it is further off than this


@dataclass(frozen=True)
class Repairs:
    """Which repairs to make; strength is the width of the filter against trembling, as a share of the usual one.

    root_from_feet gives the root a new way, by the feet that stand (editing/root_from_feet.py).
    """

    glitches: bool = True
    trembling: bool = True
    floor: bool = True
    sliding: bool = True
    strength: float = 1.0
    root_from_feet: bool = False


@dataclass(frozen=True)
class Measurement:
    """One row of the table: measured quantity, values before and after (None if not measurable), unit."""

    name: str
    before: float | None
    after: float | None
    unit: str


@dataclass(frozen=True, eq=False)
class Fixed:
    """A repaired motion.

    Attributes:
        motion: the repaired motion, on the same joints, in the same unit and with the same up axis.
        table: measurements before and after.
        glitches: (frame, joint) of every repaired pop and flip.
        notes: repairs that were not possible, or were taken back because they made it worse.
    """

    motion: Motion
    table: tuple[Measurement, ...]
    glitches: tuple[tuple[int, str], ...]
    notes: tuple[str, ...]


def fix_motion(motion: Motion, repairs: Repairs | None = None) -> Fixed:
    """Repair a motion of any rig; the floor and feet of rigs that are not human are left unchanged.

    Raises:
        MotionkitError: the motion has fewer than two frames.
    """
    repairs = repairs or Repairs()
    if len(motion) < 2:
        raise MotionkitError(f"expected at least 2 frames to repair, found {len(motion)}")
    if not motion.skeleton.offsets[1:].any() and motion.local_positions is None:
        raise SkeletonError("all bones have zero length, expected a rig")
    first = _apart(motion)
    source = Upright.of(motion.cut(first, len(motion)))
    made, rig = source.motion, _rig(source.motion)
    joints = _Joints(_limbs(made, rig), _feet(made, rig))
    costs = _Costs(_standing(source))
    found = _repaired(made, joints)[1]
    glitches: list[tuple[int, str]] = []
    notes: list[str] = []
    if first:
        words = ("frame is", "it is") if first == 1 else (f"{first} frames are", "they are")
        notes = [f"the first {words[0]} no part of the motion, such as a rest pose: left as {words[1]}"]
    refused: dict[str, str] = {}
    for number in range(PASSES):
        tried = _one_pass(made, repairs, rig, joints, costs)
        notes += tried.notes if number == 0 else ()
        refused = tried.refused if number == 0 else {k: v for k, v in refused.items() if k in tried.refused}
        if _unchanged(made, tried.motion):
            break
        made, glitches = tried.motion, [*glitches, *tried.glitches]
    if made is source.motion:
        same = costs.table(source, source, (len(found),) * 2)
        end = "nothing was changed" if refused else "nothing to repair"
        return Fixed(motion, same, (), (*notes, *refused.values(), end))
    after = Upright(made)
    table = costs.table(source, after, (len(found), len(_repaired(made, joints)[1])))
    notes += _worse_in_all(table)
    repaired_frames = tuple(dict.fromkeys((frame + first, joint) for frame, joint in glitches))
    return Fixed(
        motion.cut(0, first).followed_by(source.back(made)),
        table,
        repaired_frames,
        (*notes, *refused.values()),
    )


class _Joints(NamedTuple):
    """The legs and arms of a rig, and the ankle and toes of its left and right foot, where they are known."""

    limbs: list[Limb]
    feet: list[Foot | None]


class _Pass(NamedTuple):
    """What one pass of all repairs made: the motion, the repaired glitches, notes, and why steps were refused."""

    motion: Motion
    glitches: list[tuple[int, str]]
    notes: list[str]
    refused: dict[str, str]


def _one_pass(source: Motion, repairs: Repairs, rig: RigMap | None, joints: _Joints, costs: _Costs) -> _Pass:
    """All chosen repairs once. They depend on the motion alone, so that a next run leaves what is repaired here."""
    made = Upright(source)
    first = was = costs.of(made)
    glitches: list[tuple[int, str]] = []
    notes: list[str] = []
    refused: dict[str, str] = {}
    if repairs.glitches:
        bridged, spikes = _without_spikes(source)
        notes += [f"the root leaps away in {counted(spikes, 'frame')}: bridged"] if spikes else []
        repaired, glitches = _without_glitches(bridged, joints)
        if repaired is not source:
            made = Upright(repaired)
            was = costs.of(made)
    for step in _steps(repairs, rig):
        motion, step_notes = step.make(made)
        if motion is not made.motion:
            tried = Upright(motion)
            now = costs.of(tried)
            if worse := _made_worse(step, was, now, first) or _overturned(made, tried):
                refused[step.name] = f"{step.name}: taken back, because {worse}"
                step_notes = ()
            else:
                made, was = tried, now
        notes += step_notes
    return _Pass(made.motion, glitches, list(dict.fromkeys(notes)), refused)


def _unchanged(before: Motion, after: Motion) -> bool:
    """Whether a pass has changed nothing that a person could see."""
    moved = np.linalg.norm(motion_kinematics(after)[1] - motion_kinematics(before)[1], axis=-1)
    turned = quat_angle(before.local_rotations, after.local_rotations)
    return bool(moved.mean() < SEEN_MEAN and moved.max() < SEEN and turned.max() < SEEN_TURN)


def _apart(motion: Motion) -> int:
    """Number of frames at the start from which the whole body leaps into the rest of the clip, MOST_APART at a time."""
    steps = geodesic_movement(motion.local_rotations).mean(axis=1)
    first = 0
    while len(motion) - first >= 4 * MOST_APART:
        ahead = steps[first : first + 4 * MOST_APART]
        leaps = np.flatnonzero(
            ahead[:MOST_APART] > max(APART, APART_SHARE * float(np.median(ahead[MOST_APART:])))
        )
        if not leaps.size:
            break
        first += int(leaps[-1]) + 1
    return first


def _without_glitches(motion: Motion, joints: _Joints) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion without glitches, repaired as long as that leaves fewer of them, and all that were repaired."""
    every: list[tuple[int, str]] = []
    repaired, found = _repaired(motion, joints)
    for _ in range(PASSES):
        again, left = _repaired(repaired, joints)
        if len(left) >= len(found):
            break
        motion, every = repaired, every + found
        repaired, found = again, left
    return motion, list(dict.fromkeys(every))


def _repaired(motion: Motion, joints: _Joints) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion without flipped limbs, pops, leaps at its ends and feet out of range, and the repaired frames."""

    def repair_feet(made: Motion) -> tuple[Motion, list[tuple[int, str]]]:
        canonical = Upright(made).canonical if any(joints.feet) else None
        return (made, []) if canonical is None else repair_ankles(made, canonical, joints.feet)

    repaired, found = repair(motion, joints.limbs, repair_feet)
    held, ends = hold_ends(repaired)
    return held, found + ends


def _without_spikes(motion: Motion) -> tuple[Motion, int]:
    """The motion with its root bridged where it leaps away, and how many frames were; the longest stretch stays."""
    roots = motion.root_positions.astype(np.float64)
    leap = FASTEST_ROOT / motion.fps + ROOT_SLACK
    cuts = np.flatnonzero(np.linalg.norm(np.diff(roots, axis=0), axis=1) > leap) + 1
    if not cuts.size:
        return motion, 0
    runs = [run for run in np.split(np.arange(len(roots)), cuts)]
    longest = max(range(len(runs)), key=lambda i: len(runs[i]))
    kept = list(runs[longest])
    for others, end in ((runs[longest + 1 :], -1), (runs[:longest][::-1], 0)):
        for run in others:  # a stretch that the body can have reached from the nearest one that is kept
            near = run[0 if end else -1]
            gap = abs(int(near) - int(kept[end]))
            if np.linalg.norm(roots[near] - roots[kept[end]]) <= leap * gap:
                kept = [*kept, *run] if end else [*run, *kept]
    away = np.setdiff1d(np.arange(len(roots)), kept)
    for axis in range(3):
        roots[away, axis] = np.interp(away, kept, roots[kept, axis])
    return replace(motion, root_positions=roots.astype(motion.root_positions.dtype)), len(away)


class _Step(NamedTuple):
    """A repair: its name, the measure that it is to lower, and what it does to a motion in cm with Y up."""

    name: str
    measure: str
    make: Callable[[Upright], tuple[Motion, tuple[str, ...]]]


def _steps(repairs: Repairs, rig: RigMap | None) -> list[_Step]:
    """The chosen repairs after those of glitches, in order."""
    floor, sliding = replace(repairs, floor=True, sliding=False), Repairs(floor=False)
    steps = [
        (
            repairs.trembling,
            _Step("trembling", "jerk", lambda made: (_steadied(made.motion, repairs.strength), ())),
        ),
        (repairs.root_from_feet, _Step("root from feet", "afs", _with_root_from_feet)),
        (repairs.floor, _Step("floor", "floor", lambda made: _on_the_floor(made, rig, floor))),
        (repairs.sliding, _Step("sliding", "standing-speed", lambda made: _on_the_floor(made, rig, sliding))),
    ]
    return [step for chosen, step in steps if chosen]


def _made_worse(step: _Step, was: dict[str, float], now: dict[str, float], first: dict[str, float]) -> str:
    """What a step makes worse, in words: what it is to lower, or feet and jerk beyond the source's; "" for nothing."""
    limits = {name: max(was.get(name, 0.0), first.get(name, np.inf)) for name in WORSE_BESIDE}
    limits |= {step.measure: was[step.measure]} if step.measure in was else {}
    for name, before in limits.items():
        slack = (WORSE if name == step.measure else WORSE_BESIDE)[name]
        if now.get(name, 0.0) > WORSE_SHARE * before + slack:
            what = MEASURED.get(name, "feet off the floor, cm:")
            return f"it made it worse ({what} {before:.3g} to {now[name]:.3g})"
    return ""


def _worse_in_all(table: Sequence[Measurement]) -> list[str]:
    """Notes on what is worse than in the source after all passes, each of which may have made it a little worse."""
    rows, notes = {row.name: row for row in table}, []
    for name, slack in WORSE_IN_ALL.items():
        row = rows.get(MEASURED[name])
        if row is None or row.before is None or row.after is None:
            continue
        if row.after > WORSE_SHARE * row.before + slack:
            change = f"{row.before:.3g} to {row.after:.3g}"
            notes.append(f"{row.name} is worse than before ({change}); a smaller --strength changes less")
    return notes


def _overturned(before: Upright, after: Upright) -> str:
    """Which axis would seem to be up after a step, if Y did before; "" if it still does."""
    axes = [up_axis(motion_kinematics(each.motion)[1], each.motion.skeleton) for each in (before, after)]
    return f"{up_name(axes[1])} would then seem to be up" if axes[1][1] < 1.0 <= axes[0][1] else ""


def _standing(source: Upright) -> Array:
    """Flags (T, 2) of toes that stand in this frame and the one before; (T, 0) for rigs that are not human."""
    toes = source.contacts[:, 1::2] > 0.0
    return toes & np.concatenate([np.zeros_like(toes[:1]), toes[:-1]])


@dataclass(frozen=True, eq=False)
class _Costs:
    """What is measured of a clip before and after repairs; stands (T, 2) are the toes that stand before."""

    standing_toes: Array

    def measured(self, upright: Upright) -> dict[str, tuple[float, str]]:
        """The values and units of MEASURED that can be taken."""
        if upright.canonical is None:
            jerk = _jerk(upright.motion)
            return {} if jerk is None else {"jerk": (jerk, "m/s^3")}
        try:
            rows = {row.id: row.motion for row in evaluate_motion(upright.canonical).rows}
        except MotionkitError:  # a clip of a few frames can be repaired but not measured
            return {}
        values = {name: rows[name] for name in MEASURED if name in rows}
        out = {name: (row.value, row.unit) for name, row in values.items() if row.value is not None}
        if self.standing_toes.any():
            toes = upright.positions[:, list(TOES)].astype(np.float64)
            speeds = length(np.diff(toes[..., ::2], axis=0)) * upright.motion.fps
            out["standing-speed"] = float(speeds[self.standing_toes[1:]].mean()), "cm/s"
        return out

    def of(self, upright: Upright) -> dict[str, float]:
        """The values; floor is how far feet are off their height, or below zero."""
        out = {name: value for name, (value, _) in self.measured(upright).items()}
        if "floor-height" in out:
            out["floor"] = abs(out.pop("floor-height") - STANDING_HEIGHTS[1])
        if {"floor", "penetration-max"} <= out.keys():
            out["floor"] = max(out["floor"], out["penetration-max"])
        return out

    def table(
        self, before: Upright, after: Upright, glitches: tuple[float, float]
    ) -> tuple[Measurement, ...]:
        """The rows of the table; glitches are their numbers before and after."""
        first, last = self.measured(before), self.measured(after)
        names = MEASURED if before.canonical is not None and after.canonical is not None else ["jerk"]
        rows = [Measurement("glitches", *glitches, "")]
        for name in names:
            (was, unit), (now, _) = (each.get(name, (None, "")) for each in (first, last))
            rows.append(Measurement(MEASURED[name], was, now, unit))
        return tuple(rows)


def _rig(motion: Motion) -> RigMap | None:
    try:
        return map_rig(motion.skeleton)
    except SkeletonError:
        return None


def _limbs(motion: Motion, rig: RigMap | None) -> list[Limb]:
    """Upper, middle and end joints of the legs and arms whose joints directly follow each other."""
    out: list[Limb] = []
    for side in SIDES if rig is not None else ():
        for names in (("UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand")):
            joints = [rig.places.get(side + name) for name in names] if rig is not None else []
            upper, middle, end = joints
            if upper is None or middle is None or end is None:
                continue
            if motion.skeleton.parents[middle] == upper and motion.skeleton.parents[end] == middle:
                out.append((upper, middle, end))
    return out


def _feet(motion: Motion, rig: RigMap | None) -> list[Foot | None]:
    """Ankle and toe joint of the left and right foot, where the one directly follows the other."""
    out: list[Foot | None] = []
    for side in SIDES:
        ankle, toe = (
            rig.places.get(side + name) if rig is not None else None for name in ("Foot", "ToeBase")
        )
        joined = ankle is not None and toe is not None and motion.skeleton.parents[toe] == ankle
        out.append((ankle, toe) if joined else None)  # type: ignore[arg-type]
    return out


def _steadied(motion: Motion, strength: float) -> Motion:
    """The motion with the joints and the root filtered that tremble."""
    window = window_at(motion.fps * strength)
    turns, roots, local = motion.local_rotations, motion.root_positions, motion.local_positions
    smoothed = smooth_rotations(turns, window)
    trembling = _trembles(quat_continuous(turns), smoothed)
    turns = np.where(trembling[:, None], smoothed, turns)
    smooth_roots = smooth(roots, window)
    if _trembles(roots, smooth_roots):
        roots = smooth_roots
    if local is not None:
        smoothed = smooth(local, window)
        local = np.where(_trembles(local, smoothed)[:, None], smoothed, local)
    return replace(motion, local_rotations=turns, root_positions=roots, local_positions=local)


def _trembles(values: Array, smoothed: Array) -> Array:
    """Which of the tracks (T, ..., n) tremble (...): those whose third differences the filter halves at least."""
    before, after = (
        np.linalg.norm(np.diff(each.astype(np.float64), n=3, axis=0), axis=-1).sum(axis=0)
        for each in (values, smoothed)
    )
    return np.asarray(after < TREMBLES * before)


def _with_root_from_feet(upright: Upright) -> tuple[Motion, tuple[str, ...]]:
    """The motion with the root where its standing feet say, and notes."""
    motion, canonical = upright.motion, upright.canonical
    if canonical is None:
        return motion, ("the rig is not a known human one: its root was left as it is",)
    made = root_from_feet(canonical)
    was, goes = (
        np.linalg.norm(np.diff(each.root_positions[:, ::2], axis=0), axis=1).sum() / 100.0
        for each in (canonical, made)
    )
    shift = made.root_positions - canonical.root_positions
    note = f"root from feet: it goes {goes:.2f} m over the ground, before {was:.2f} m"
    return replace(motion, root_positions=motion.root_positions + shift), (note,)


def _on_the_floor(upright: Upright, rig: RigMap | None, repairs: Repairs) -> tuple[Motion, tuple[str, ...]]:
    """The motion with its floor at zero and feet locked during contacts, and notes."""
    motion, canonical = upright.motion, upright.canonical
    if canonical is None or rig is None:
        return motion, ("the rig is not a known human one: floor and feet were left as they are",)
    shift, notes = floor_shift(canonical)
    up = np.array([0.0, shift, 0.0], np.float32)
    raised = replace(motion, root_positions=motion.root_positions + up)
    if repairs.sliding:
        before = replace(canonical, root_positions=canonical.root_positions + up)
        raised = moved_like(raised, rig, before, finish(before, upright.contacts, Finish(drawn=False)))
    sure = all(f"{side}ToeBase" in rig.places for side in SIDES) or abs(shift) > FAR_OFF
    if repairs.floor and not sure and not repairs.root_from_feet:
        notes = (*notes, "the rig has no toes, which show where its floor is: it was left where it is")
    if not (repairs.floor and sure):
        raised = replace(raised, root_positions=raised.root_positions - up)
    return raised, notes


def moved_like(motion: Motion, rig: RigMap, before: Motion, after: Motion) -> Motion:
    """The rig's motion, legs turned and root moved in the world like the canonical body from before to after."""
    old, _ = motion_kinematics(before)
    new, _ = motion_kinematics(after)
    turns: dict[int, Array] = {}
    for name in (side + part for side in SIDES for part in LEG_PARTS):
        joint = JOINT_NAMES.index(name)
        for place in {rig.places.get(name), rig.turns.get(name)} - {None}:
            assert place is not None
            turns[place] = quat_multiply(new[:, joint], quat_inverse(old[:, joint]))
    moved = replace(
        motion, root_positions=motion.root_positions + after.root_positions - before.root_positions
    )
    return turned_in_world(moved, turns)


def turned_in_world(motion: Motion, turns: dict[int, Array]) -> Motion:
    """The motion with some joints turned by world rotations (T, 4); their descendants follow.

    Args:
        turns: joint index to the rotation by which its global rotation is multiplied; the other joints keep theirs
            relative to their parents.
    """
    rotations, _ = motion_kinematics(motion)
    local = motion.local_rotations.copy()
    now = list(np.moveaxis(rotations, 1, 0))
    for joint, parent in enumerate(motion.skeleton.parents):
        if joint in turns:
            now[joint] = quat_multiply(turns[joint], rotations[:, joint])
            local[:, joint] = now[joint] if parent < 0 else relative_rotation(now[parent], now[joint])
        elif parent >= 0:
            now[joint] = quat_multiply(now[parent], local[:, joint])
    return replace(motion, local_rotations=quat_continuous(quat_normalize(local)))


def _jerk(motion: Motion) -> float | None:
    """The jerk of a motion; None if it is too short to have one."""
    try:
        return mean_jerk(motion_kinematics(motion)[1], motion.fps).value
    except MotionkitError:
        return None
