"""Stability: whether long roll-outs keep moving, keep their feet on the floor and stay close to recorded poses."""

from __future__ import annotations

import random
from collections import defaultdict
from dataclasses import replace

import numpy as np

from motionkit.control.script import TypePart
from motionkit.lab.scoreboard.report import Goal, Section, all_of
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.body import Body
from motionkit.metrics.smoothness import mean_jerk
from motionkit.models.model import MotionModel
from motionkit.tables import Table
from motionkit.training.verdict.real import MotionProfile, RealMotion
from motionkit.training.verdict.rolling import Plan, Progress, Take

FREEZE_SECONDS = 5.0
# Frozen: over FREEZE_SECONDS the joints are slower than this share of the lower speed limit of the type's profile.
FROZEN_SHARE = 0.5
EDGE_SHARE = 1 / 3  # share of the roll-out at both ends between which foot height is compared
DRIFT_LIMIT = 5.0  # cm
FLOAT_LIMIT = 3.0  # cm between the foot height of the roll-out and of the recordings
DISTANCE_LIMIT, JERK_LIMIT = 1.5, 1.5  # relative to the recordings
CHANGE_SECONDS = (3.0, 8.0)  # shortest and longest time of a type in the mixed roll-out


def frozen_seconds(body: Body, slowest: float) -> float:
    """Return the seconds in windows of FREEZE_SECONDS whose mean joint speed is below `slowest` (rad/s)."""
    size = min(len(body), round(FREEZE_SECONDS * body.fps))
    starts = range(0, len(body) - size + 1, size)
    return sum(body.cut(s, s + size).joint_speed() < slowest for s in starts) * size / body.fps


def foot_height(bodies: list[Body]) -> float:
    """Return the height of the lower foot above the floor in cm: the lower quartile over frames, without jumps."""
    return float(np.quantile(np.concatenate([body.lifts.min(axis=-1) for body in bodies]), 0.25))


def height_drift(body: Body) -> float:
    """Return the change of foot_height in cm from the first third of the roll-out to the last third.

    Foot height is used because the mean height of the root also changes with squats.
    """
    edge = max(1, int(EDGE_SHARE * len(body)))
    return foot_height([body.cut(len(body) - edge, len(body))]) - foot_height([body.cut(0, edge)])


def _floating(body: Body, real: RealMotion, parts: tuple[TypePart, ...]) -> float | None:
    """Return foot_height minus that of the type's recordings in cm; None for a plan of several types."""
    kinds = {part.type for part in parts}
    if len(kinds) > 1:
        return None
    found = [stretch.body for stretch in real.of_type(kinds.pop())]
    return foot_height([body]) - foot_height(found) if found else None


def real_measures(real: RealMotion, kind: str) -> tuple[float, float]:
    """Return the mean distance (cm per joint) of a type's recordings to the nearest training pose, and their mean jerk.

    The distance is that of the held-out recordings, or else of the training recordings, to the poses of other
    recordings: the mirror image of a training clip may be held out.
    """
    found = real.of_type(kind)
    held_out = real.of_type(kind, real.held_out)
    distances, jerks, frames = [], [], []
    for stretch in held_out or found:
        each = real.pose_distances(stretch.body, stretch.clip).min(axis=1)
        distances.append(each[np.isfinite(each)])
    for stretch in found:
        jerks.append(mean_jerk(stretch.body.positions, real.fps).value or 0.0)
        frames.append(float(len(stretch.body)))
    far = np.concatenate([*distances, np.zeros(0, np.float32)])
    jerk = sum(j * f for j, f in zip(jerks, frames, strict=True)) / max(sum(frames), 1.0)
    return float(far.mean()) if len(far) else float("nan"), jerk


def _mixed(recorded: dict[str, tuple[float, float]], parts: tuple[TypePart, ...]) -> tuple[float, float]:
    """Return the average of real_measures over the types of a plan, weighted by their seconds; NaN if none is known."""
    seconds: dict[str, float] = defaultdict(float)
    for part in parts:
        seconds[part.type] += part.seconds
    measures = np.array([recorded[kind] for kind in seconds])
    shares = np.array(list(seconds.values()))[:, None]
    # A type with one clip has no distance and counts for the jerk only.
    known = shares * np.isfinite(measures)
    sums, weights = (np.nan_to_num(measures) * known).sum(axis=0), known.sum(axis=0)
    distance, jerk = np.divide(sums, weights, out=np.full(2, np.nan), where=weights > 0.0)
    return float(distance), float(jerk)


def _row(
    name: str,
    take: Take,
    real: RealMotion,
    recorded: dict[str, tuple[float, float]],
    parts: tuple[TypePart, ...],
) -> dict[str, float | str | bool | None]:
    """Return one row of the table: a roll-out compared with recordings of the same types in the same shares."""
    profiles: list[MotionProfile] = [m for m in (real.profile(part.type) for part in parts) if m is not None]
    slowest = min((m.speeds[0] for m in profiles), default=0.0) * FROZEN_SHARE
    body = take.default
    finite = bool(np.isfinite(body.positions).all())
    if not finite:
        return {"type": name, "finite": False}
    distance, jerk = _mixed(recorded, parts)
    heights = body.positions[:, 0, 1]
    near = float(real.pose_distances(body.every(10)).min(axis=1).mean())
    return {
        "type": name,
        "finite": True,
        "frozen, s": sum(frozen_seconds(part.default, slowest) for part in take.performed()),
        "foot height drift, cm": height_drift(body),
        "foot height − real, cm": _floating(body, real, parts),
        "lowest root, cm": float(heights.min()),
        "highest root, cm": float(heights.max()),
        "pose distance, cm": near,
        "pose distance / real": near / distance if distance > 0 else None,
        "jerk / real": (mean_jerk(body.positions, body.fps).value or 0.0) / jerk if jerk > 0 else None,
    }


def random_plan(model: MotionModel, kinds: list[str], seconds: float, seed: int) -> Plan:
    """Return a plan of types in random order, each for a random time or one whole performance, for `seconds` in all."""
    chance = random.Random(seed)
    parts, total = [], 0.0
    while total < seconds:
        kind = chance.choice(kinds)
        time = model.phase_seconds(kind) or chance.uniform(*CHANGE_SECONDS)
        # Whole frames, so that plans of one length have one number of frames.
        time = round(min(time, seconds - total) * model.fps) / model.fps
        if time <= 0.0:
            break
        parts.append(TypePart(kind, time))
        total += time
    return Plan(tuple(parts), seed)


def stability_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: one long roll-out of every type, and one with random changes of type."""
    model, real, settings = trial.model, trial.real, trial.settings
    kinds = [kind for kind in trial.recorded_types if real.profile(kind) is not None]
    if not kinds:
        note = "not measured: the dataset has no training recordings of the model's types"
        return Section("stability", "Stability", notes=[note])
    seed = settings.first_seed
    plans = [Plan((TypePart(kind, settings.stability_seconds),), seed) for kind in kinds]
    plans.append(random_plan(model, kinds, settings.mixed_seconds, seed))
    names = [*kinds, "random type changes"]
    bare = trial.without_references
    share = 1.0 if bare is None else 0.5
    takes = trial.roll(plans, lambda x: progress(share * x))
    alone = [] if bare is None else trial.roll(plans, lambda x: progress(share + share * x), bare)
    recorded = {kind: real_measures(real, kind) for kind in kinds}

    def table(title: str, takes: list[Take]) -> tuple[Table, list[dict]]:
        rows = [
            _row(name, take, real, recorded, plan.parts)
            for name, take, plan in zip(names, takes, plans, strict=True)
        ]
        columns = max((tuple(row) for row in rows), key=len)
        return Table(title, columns, [tuple(row.get(column) for column in columns) for row in rows]), rows

    title = f"{settings.stability_seconds:g} s per type, {settings.mixed_seconds:g} s of random type changes"
    first, rows = table(title, takes)
    tables = [first, table(f"{title}: raw", [replace(take, default=take.raw) for take in takes])[0]]
    if alone:
        tables.append(table(f"{title}: without references", alone)[0])
    notes = [
        "as synthesize makes them by default; raw: the same with feet not locked; without references: with --reference "
        "none",
        f"frozen: seconds in windows of {FREEZE_SECONDS:g} s whose joints are slower than {FROZEN_SHARE:g} times the "
        "lower speed limit of the type's motion profile, where the type is shown",
        "foot height: height of the lower foot above the floor, lower quartile over frames; drift: last third of the "
        "roll-out minus the first; − real: minus that of the type's recordings",
        "pose distance: mean distance per joint to the nearest training pose of any type; / real: divided by that of "
        "the type's held-out recordings, or of its training recordings to other clips if none is held out",
        "jerk / real: jerk of 60 fps positions divided by that of the type's recordings; for random type changes the "
        "recordings of its types are weighted by their seconds",
    ]
    return Section("stability", "Stability", tables, _goals(rows, settings), notes)


def _goals(rows: list[dict], settings: EvaluationSettings) -> list[Goal]:
    checks = [
        ("finite", "finite", 1.0, None),
        ("not frozen", "frozen, s", None, 0.0),
        (f"foot height drift within {DRIFT_LIMIT:g} cm", "foot height drift, cm", -DRIFT_LIMIT, DRIFT_LIMIT),
        (
            f"foot height within {FLOAT_LIMIT:g} cm of real",
            "foot height − real, cm",
            -FLOAT_LIMIT,
            FLOAT_LIMIT,
        ),
        (f"pose distance ≤ {DISTANCE_LIMIT:g} times real", "pose distance / real", None, DISTANCE_LIMIT),
        (f"jerk ≤ {JERK_LIMIT:g} times real", "jerk / real", None, JERK_LIMIT),
    ]
    goals = []
    *alone, mixed = rows
    mixed_checks: dict[str, bool] = {}
    for what, column, lowest, highest in checks:
        found = {row["type"]: _within(row, column, lowest, highest) for row in alone}
        measured = [kind for kind, good in found.items() if good is not None]
        name = f"{settings.stability_seconds:g} s per type, {what}: share of types"
        goals.append(all_of(name, measured, [kind for kind in measured if not found[kind]]))
        if (good := _within(mixed, column, lowest, highest)) is not None:
            mixed_checks[what] = good
    name = f"{settings.mixed_seconds:g} s of random type changes: share of these checks"
    goals.append(all_of(name, list(mixed_checks), [what for what, good in mixed_checks.items() if not good]))
    return goals


def _within(row: dict, column: str, lowest: float | None, highest: float | None) -> bool | None:
    """Whether a value of a row is within its limits; None if it could not be measured. Motion must be finite."""
    if not row["finite"]:
        return False
    value = row.get(column)
    if value is None:
        return None
    return (lowest is None or value >= lowest) and (highest is None or value <= highest)
