"""Repairs a clip of any rig: glitches, jitter, floor and foot sliding. Joints, bone lengths and unit stay.

Glitches and jitter are removed on the rig's own joints. Floor and feet are repaired on the canonical joints, with the
rig's bone lengths; the rotations of foot locking are then applied to the rig's joints in world space.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from motionkit.arrays import Array
from motionkit.data.cleaning import Limb, mend
from motionkit.data.smoothing import smooth, smooth_rotations, window_at
from motionkit.editing.root_from_feet import root_from_feet
from motionkit.errors import MotionkitError, SkeletonError
from motionkit.finish.finish import Finish, finish
from motionkit.metrics.body_movement import geodesic_movement
from motionkit.metrics.report import evaluate_motion
from motionkit.metrics.smoothness import mean_jerk
from motionkit.motion.floor import floor_shift
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_continuous, quat_inverse, quat_multiply, quat_normalize
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS
from motionkit.names import counted
from motionkit.rig.names import RigMap, map_rig
from motionkit.rig.up_axis import up_axis, up_name
from motionkit.rig.upright import Upright, relative_rotation

LEG_PARTS = ("UpLeg", "Leg", "Foot", "ToeBase")
SIDES = ("Left", "Right")
# Metrics of the table, and their names there.
MEASURED: dict[str, str] = {
    "floor-height": "height of standing feet",
    "penetration-max": "deepest below the floor",
    "afs": "foot sliding (AFS)",
    "skate-ratio": "share of standing toes that slide",
    "jerk": "jerk",
}
PASSES = 8  # most passes over glitches; each may uncover others
# cm/s, and cm besides, that a root moves at most between two frames; further leaps are spikes, or frames elsewhere.
FASTEST_ROOT, ROOT_SLACK = 2000.0, 50.0
# Most frames at the start of a clip that are apart from it, and the mean turn of the joints (degrees) out of them: at
# least, and relative to the median of the steps after. Rest poses at the start of clips turn by 13 and more; measured.
MOST_APART, APART, APART_SHARE = 3, 10.0, 8.0
# Share, and amount besides, by which a step may raise a measure; else it is taken back.
WORSE_SHARE = 1.05
WORSE = {"jerk": 0.02, "afs": 0.02, "floor": 0.02}
SETTLED = 1.0  # cm that feet may be off their height before floor and feet are repaired once more
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
    if first := _apart(motion):
        fixed = fix_motion(motion.cut(first, len(motion)), repairs)
        note = f"the clip begins with {counted(first, 'frame')} apart from the rest, such as a rest pose: left as it is"
        shifted = tuple((frame + first, joint) for frame, joint in fixed.glitches)
        return Fixed(
            motion.cut(0, first).followed_by(fixed.motion), fixed.table, shifted, (note, *fixed.notes)
        )
    source = Upright.of(motion)
    made, rig = source.motion, _rig(source.motion)
    limbs = _limbs(made, rig)
    found = mend(made, limbs)[1]
    glitches: list[tuple[int, str]] = []
    notes: list[str] = []
    if repairs.glitches:
        made, spikes = _without_spikes(made)
        notes += [f"the root leaps away in {counted(spikes, 'frame')}: bridged"] if spikes else []
        made, glitches = _mended(made, limbs)
    for _ in range(PASSES):
        shown = made
        for step in _steps(repairs, rig):
            made, told = _tried(made, step, source.motion)
            notes += told
        if made is shown or not repairs.floor or _off_the_floor(made) < SETTLED:
            break
        repairs = replace(repairs, trembling=False, root_from_feet=False)
    left = mend(made, limbs)[1]
    table = _table(source, Upright(made), (float(len(found)), float(len(left))))
    return Fixed(source.back(made), table, tuple(glitches), tuple(dict.fromkeys(notes)))


def _apart(motion: Motion) -> int:
    """Number of frames at the start, at most MOST_APART, from which the whole body leaps into the rest of the clip."""
    if len(motion) < 4 * MOST_APART:
        return 0
    steps = geodesic_movement(motion.local_rotations[: 4 * MOST_APART + 1]).mean(axis=1)
    usual = float(np.median(steps[MOST_APART:]))
    leaps = np.flatnonzero(steps[:MOST_APART] > max(APART, APART_SHARE * usual))
    return int(leaps[-1]) + 1 if leaps.size else 0


def _mended(motion: Motion, limbs: list[Limb]) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion without glitches, mended until another pass finds none or no fewer, and all that were found."""
    every: list[tuple[int, str]] = []
    fewest = None
    for _ in range(PASSES):
        mended, found = mend(motion, limbs)
        if not found or (fewest is not None and len(found) >= fewest):
            break
        motion, fewest = mended, len(found)
        every += found
    return motion, list(dict.fromkeys(every))


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
    """A repair: its name, the measure that it is to lower, and what it does to a motion."""

    name: str
    measure: str
    make: Callable[[Motion], tuple[Motion, tuple[str, ...]]]


def _steps(repairs: Repairs, rig: RigMap | None) -> list[_Step]:
    """The wanted repairs after those of glitches, in order."""
    steps = [
        (
            repairs.trembling,
            _Step("trembling", "jerk", lambda motion: (_steadied(motion, repairs.strength), ())),
        ),
        (repairs.root_from_feet, _Step("root from feet", "afs", _with_root_from_feet)),
        (
            repairs.floor,
            _Step("floor", "floor", lambda motion: _on_the_floor(motion, rig, Repairs(sliding=False))),
        ),
        (
            repairs.sliding,
            _Step("sliding", "afs", lambda motion: _on_the_floor(motion, rig, Repairs(floor=False))),
        ),
    ]
    return [step for wanted, step in steps if wanted]


def _tried(made: Motion, step: _Step, source: Motion) -> tuple[Motion, list[str]]:
    """The motion after a step, and notes; without the step if it makes anything worse.

    What a step is to lower may not rise, and feet may not slide more than in the source. Jerk may rise, because feet
    that are held stop.
    """
    tried, told = step.make(made)
    if tried is made:
        return made, list(told)
    was, now, first = _costs(made), _costs(tried), _costs(source)
    for name, slack in WORSE.items():
        if name not in (step.measure, "afs"):
            continue
        before = was.get(name) if name == step.measure else max(was.get(name, 0.0), first.get(name, np.inf))
        if before is not None and now.get(name, 0.0) > WORSE_SHARE * before + slack:
            why = f"{MEASURED.get(name, name)} {before:.3g} to {now[name]:.3g}"
            return made, [f"{step.name}: taken back, because it made it worse ({why})"]
    axes = [up_axis(motion_kinematics(each)[1], each.skeleton) for each in (made, tried)]
    if axes[1][1] < 1.0 <= axes[0][1]:
        return made, [f"{step.name}: taken back, because {up_name(axes[1])} would then seem to be up"]
    return tried, list(told)


def _costs(motion: Motion) -> dict[str, float]:
    """The measures of WORSE, as far as they can be taken; floor is how far feet are off their height, or below zero."""
    canonical = Upright(motion).canonical
    if canonical is None:
        jerk = _jerk(motion)
        return {} if jerk is None else {"jerk": jerk}
    try:
        report = evaluate_motion(canonical)
    except MotionkitError:
        return {}
    found = {name: report.value(name) for name in ("jerk", "afs", "floor-height", "penetration-max")}
    out = {name: value for name, value in found.items() if value is not None}
    if "floor-height" in out:
        out["floor"] = abs(out.pop("floor-height") - STANDING_HEIGHTS[1])
    if {"floor", "penetration-max"} <= out.keys():
        out["floor"] = max(out["floor"], out["penetration-max"])
    return out


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


def _steadied(motion: Motion, strength: float) -> Motion:
    """The motion with jitter removed."""
    window = window_at(motion.fps * strength)
    local = motion.local_positions
    return replace(
        motion,
        local_rotations=smooth_rotations(motion.local_rotations, window),
        root_positions=smooth(motion.root_positions, window),
        local_positions=None if local is None else smooth(local, window),
    )


def _off_the_floor(motion: Motion) -> float:
    """How far in cm standing feet are off their height."""
    canonical = Upright(motion).canonical
    return 0.0 if canonical is None else abs(floor_shift(canonical)[0])


def _with_root_from_feet(motion: Motion) -> tuple[Motion, tuple[str, ...]]:
    """The motion with the root where its standing feet say, and notes."""
    canonical = Upright(motion).canonical
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


def _on_the_floor(motion: Motion, rig: RigMap | None, repairs: Repairs) -> tuple[Motion, tuple[str, ...]]:
    """The motion with its floor at zero and feet locked during contacts, and notes."""
    upright = Upright(motion)
    canonical = upright.canonical
    if canonical is None or rig is None:
        return motion, ("the rig is not a known human one: floor and feet were left as they are",)
    shift, notes = floor_shift(canonical)
    up = np.array([0.0, shift, 0.0], np.float32)
    raised = replace(motion, root_positions=motion.root_positions + up)
    if repairs.sliding:
        before = replace(canonical, root_positions=canonical.root_positions + up)
        raised = moved_like(raised, rig, before, finish(before, upright.contacts, Finish(drawn=False)))
    sure = all(f"{side}ToeBase" in rig.places for side in SIDES) or abs(shift) > FAR_OFF
    if repairs.floor and not sure:
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


def _table(before: Upright, after: Upright, glitches: tuple[float, float]) -> tuple[Measurement, ...]:
    rows = [Measurement("glitches", *glitches, "")]
    if before.canonical is None or after.canonical is None:
        values = [_jerk(each.motion) for each in (before, after)]
        return (*rows, Measurement(MEASURED["jerk"], values[0], values[1], "m/s^3"))
    try:
        reports = [evaluate_motion(each) for each in (before.canonical, after.canonical)]
    except MotionkitError:  # a clip of a few frames can be repaired but not measured
        return (*rows, *(Measurement(words, None, None, "") for words in MEASURED.values()))
    for name, words in MEASURED.items():
        pair = [next((row.motion for row in report.rows if row.id == name), None) for report in reports]
        first, last = pair
        if first is not None and last is not None:
            rows.append(Measurement(words, first.value, last.value, first.unit))
    return tuple(rows)


def _jerk(motion: Motion) -> float | None:
    """The jerk of a motion; None if it is too short to have one."""
    try:
        return mean_jerk(motion_kinematics(motion)[1], motion.fps).value
    except MotionkitError:
        return None
