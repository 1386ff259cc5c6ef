"""Gaits: how steadily they go, how they turn in tight circles, and how often types step.

Circles are walked again by plain motion matching over the training clips, with the same foot locking.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionkit.arrays import Array
from motionkit.control.path import shape_path
from motionkit.lab.scoreboard.paths import leaning, slip, steered_types, steps_a_second
from motionkit.lab.scoreboard.report import Goal, Section, all_of, at_least, at_most
from motionkit.lab.scoreboard.starts import LOW
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.body import Body
from motionkit.metrics.trajectory import trajectory_distance
from motionkit.models.motion_type import MotionKind
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.tables import Cell, Table
from motionkit.training.verdict.rolling import Progress, grouped, roll_paths

STEADY = 1.3  # largest variation of speed relative to the recordings
SPEED_SECONDS = 1.0  # over which a speed is measured
LEAST_SECONDS = 1.5  # of a recording whose speed is measured
SLIP = 5.0  # cm/s; largest mean speed of low toes in a circle of 1 m radius
LIVELY = 0.9  # least arm swing relative to the recordings
STEP_RATES = (1.0 / 1.2, 1.2)  # steps a second relative to the recordings
FEWEST_STEPS = 0.25  # a second; types that step less have no target
CIRCLES = (1.0, 3.0)  # radii in m
HANDS = (JOINT_NAMES.index("LeftHand"), JOINT_NAMES.index("RightHand"))


def gaits_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: each gait alone, circles beside motion matching, and the steps of all types."""
    takes = trial.alone(lambda share: progress(0.6 * share))
    default = {kind: [take.default for take in found] for kind, found in takes.items()}
    by_type = {
        kind: [part.default for take in found for part in take.performed()] for kind, found in takes.items()
    }
    parts = [_steadiness(trial, default), _steps(trial, by_type)]
    if circles := _circles(trial, lambda share: progress(0.6 + 0.4 * share)):
        parts.append(circles)
    settings = trial.settings
    notes = [
        f"speed: over {SPEED_SECONDS:g} s; variation: standard deviation over mean within a roll-out of "
        f"{settings.accuracy_seconds:g} s, or within a recording of at least {LEAST_SECONDS:g} s; mean over roll-outs, "
        "and the worst; between seeds: standard deviation of their mean speeds",
        f"slip: mean speed over the ground of toes less than {LOW:g} cm above a standing one; arm swing: standard "
        "deviation of the hands' places ahead of the hips; motion matching: over the training clips, transitions not "
        f"blended, feet locked; {settings.repeats} characters per circle",
        f"steps: toes put down a second where the type is shown; types with fewer than {FEWEST_STEPS:g} in the "
        "recordings have no target",
    ]
    return Section(
        "gaits",
        "Gaits and steps",
        [table for table, _ in parts],
        [g for _, each in parts for g in each],
        notes,
    )


def _speeds(body: Body) -> Array:
    """Speeds (N,) of the root over the ground in m/s, each over SPEED_SECONDS; none for a shorter motion."""
    span = round(SPEED_SECONDS * body.fps)
    places = body.positions[:, 0, [0, 2]]
    return np.linalg.norm(places[span:] - places[:-span], axis=-1) / (100.0 * SPEED_SECONDS)


def _variation(body: Body) -> float:
    speeds = _speeds(body)
    return float(speeds.std() / speeds.mean())


def _steadiness(trial: Trial, default: dict[str, list[Body]]) -> tuple[Table, list[Goal]]:
    rows: list[tuple[Cell, ...]] = []
    goals: list[Goal] = []
    for kind, bodies in default.items():
        recorded = [s.body for s in trial.real.of_type(kind) if s.body.seconds >= LEAST_SECONDS]
        if trial.model.kind(kind) is not MotionKind.GAIT or not recorded:
            continue
        made, real = [_variation(body) for body in bodies], float(np.mean([_variation(b) for b in recorded]))
        apart, real_apart = (float(np.std([_speeds(b).mean() for b in each])) for each in (bodies, recorded))
        rows.append((kind, float(np.mean(made)), max(made), real, apart, real_apart))
        goals.append(at_most(f"{kind}: variation of speed / real", float(np.mean(made)) / real, STEADY))
    columns = (
        "gait",
        "variation of speed",
        "worst",
        "recorded",
        "between seeds, m/s",
        "between recordings, m/s",
    )
    return Table("Steadiness", columns, rows), goals


def _steps(trial: Trial, by_type: dict[str, list[Body]]) -> tuple[Table, list[Goal]]:
    rows: list[tuple[Cell, ...]] = []
    measured, failing = [], []
    for kind, bodies in by_type.items():
        recorded = [s.body for s in trial.real.of_type(kind)]
        if not recorded:
            continue
        made, real = _rate(bodies), _rate(recorded)
        rows.append((kind, made, real, made / real if real else None))
        if real >= FEWEST_STEPS and trial.model.kind(kind) is not MotionKind.PERFORMANCE:
            measured.append(kind)
            if not STEP_RATES[0] <= made / real <= STEP_RATES[1]:
                failing.append(kind)
    goal = all_of("steps a second within 1.2 times recorded: share of types", measured, failing)
    return Table("Steps", ("type", "steps a second", "recorded", "/ recorded"), rows), [goal]


def _rate(bodies: list[Body]) -> float:
    """Steps a second over all frames of some bodies."""
    return float(
        np.sum([steps_a_second(b) * b.seconds for b in bodies]) / np.sum([b.seconds for b in bodies])
    )


def _circles(trial: Trial, progress: Progress) -> tuple[Table, list[Goal]] | None:
    gaits = steered_types(trial.model)
    if gaits is None or not trial.matched.knows(*gaits):
        return None
    kinds = tuple(dict.fromkeys(gaits))
    trials = [
        (kind, radius, shape_path("circle", radius, [kind], None)) for kind in kinds for radius in CIRCLES
    ]
    trials = [each for each in trials if each[:2] != (gaits[1], CIRCLES[0]) or len(kinds) == 1]
    repeats = trial.settings.repeats
    tasks = [(path, seed) for *_, path in trials for seed in trial.seeds(repeats)]
    walks = roll_paths(trial.model, tasks, trial.settings.noise, trial.each, progress)
    matched = [trial.matched.along(path) for *_, path in trials]
    swings = {
        kind: arm_swing([s.body for s in trial.real.of_type(kind) if s.body.seconds >= 1.0]) for kind in kinds
    }
    rows: list[tuple[Cell, ...]] = []
    goals: list[Goal] = []
    for (kind, radius, path), mine, other in zip(trials, grouped(walks, repeats), matched, strict=True):
        bodies = [walk.take.default for walk in mine]
        name = f"circle r = {radius:g} m, {kind}"
        for who, each in ((name, bodies), (f"{name}: motion matching", [other])):
            distances = [trajectory_distance(b.positions[:, 0, [0, 2]], path.points).mean for b in each]
            lean, needed = (float(np.mean(found)) for found in zip(*map(leaning, each), strict=True))
            rows.append((
                who, float(np.mean(distances)), slip(each), max(slip([b]) for b in each), arm_swing(each),
                swings[kind], lean, needed,
            ))  # fmt: skip
        if recorded := swings[kind]:
            goals.append(at_least(f"{name}: arm swing / real", (arm_swing(bodies) or 0.0) / recorded, LIVELY))
        if kind == gaits[0] and radius == CIRCLES[0]:
            goals.append(at_most(f"{name}: slip of low toes, cm/s", slip(bodies), SLIP))
    columns = (
        "circle", "mean distance, cm", "slip, cm/s", "worst slip, cm/s", "arm swing, cm", "recorded arm swing, cm",
        "leaning, degrees", "needed, degrees",
    )  # fmt: skip
    return Table("Circles", columns, rows), goals


def arm_swing(bodies: Sequence[Body]) -> float | None:
    """Return how far hands swing: the standard deviation in cm of their places ahead of the hips, mean over bodies.

    None without bodies.
    """
    swings = []
    for body in bodies:
        hands = body.positions[:, list(HANDS)] - body.positions[:, :1]
        facing = np.stack([np.sin(body.heading), np.cos(body.heading)], axis=-1)
        swings.append(float((hands[..., [0, 2]] * facing[:, None]).sum(axis=-1).std(axis=0).mean()))
    return float(np.mean(swings)) if swings else None
