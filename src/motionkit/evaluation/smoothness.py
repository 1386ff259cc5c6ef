"""Smoothness of transitions that no clip contains: does a joint turn faster than in the recordings?

A few recorded frames contain jumps of one joint by up to half a turn. Compared with them every motion would be
smooth. The limit is therefore the joint speed that 99.9 % of the recorded frames stay below.
"""

from __future__ import annotations

import numpy as np

from motionkit.control.script import TypePart
from motionkit.evaluation.body import Body
from motionkit.evaluation.real import RealMotion
from motionkit.evaluation.report import Goal, Section, Table
from motionkit.evaluation.rolling import Plan, Progress, roll_plans
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.metrics.body_movement import geodesic_movement
from motionkit.models.model import MotionModel
from motionkit.motion.skeleton import JOINT_NAMES

REAL_SHARE = 0.999  # of the recorded frames are below the limit
LASTING_SECONDS = 3.0  # for types that have no length of their own
SEQUENCES = (
    ("running", "twist", "cartwheel", "kicking"),
    ("running", "side-somersault", "cartwheel", "running"),
    ("walking", "backflip", "handspring", "walking"),
    ("punching", "w-kicking", "dance-modern", "exercise"),
)


def fastest_turn(body: Body) -> tuple[float, str]:
    """Return the speed in degrees per second of the fastest joint between two frames, and its name."""
    speeds = geodesic_movement(body.rotations).max(axis=0) * body.fps
    joint = int(speeds.argmax())
    return float(speeds[joint]), JOINT_NAMES[joint]


def recorded_limit(real: RealMotion) -> tuple[float, float]:
    """Return the limit and the largest speed of the fastest joint over the recorded frames, in degrees per second."""
    frames = np.concatenate(
        [geodesic_movement(s.body.rotations).max(axis=1) * s.body.fps for s in real.stretches]
    )
    ordered = np.sort(frames)
    return float(ordered[int(REAL_SHARE * (len(ordered) - 1))]), float(ordered[-1])


def smoothness_section(
    model: MotionModel, real: RealMotion, settings: EvaluationSettings, progress: Progress
) -> Section:
    """Measure the section: the fastest joint of each sequence, relative to the recordings."""
    limit, largest = recorded_limit(real)
    rows, goals = [], []
    known = [s for s in SEQUENCES if set(s) <= set(model.types)]
    for number, sequence in enumerate(known):
        parts = tuple(TypePart(k, model.phase_seconds(k) or LASTING_SECONDS) for k in sequence)
        plans = [Plan(parts, seed) for seed in range(settings.repeats)]
        performed = roll_plans(model, plans, settings.noise, settings.seed)
        fastest, where = max(fastest_turn(p.body) for p in performed)
        name = " → ".join(sequence)
        rows.append((name, fastest, where, fastest / limit))
        goals.append(Goal(f"{name}: fastest joint / real", fastest / limit, "≤ 1", None, 1.0))
        progress((number + 1) / len(known))
    columns = ("sequence", "fastest joint, degrees/s", "joint", "/ real")
    notes = [
        f"the largest value of {settings.repeats} characters; each type lasts its own length or {LASTING_SECONDS:g} s",
        f"real: {limit:.0f} degrees/s; the fastest joint is slower in {REAL_SHARE:.1%} of the recorded frames; the "
        f"largest recorded value, {largest:.0f} degrees/s, is not used",
    ]
    return Section(
        "smoothness",
        "Smoothness of transitions",
        [Table("Fastest joint per sequence", columns, rows)],
        goals,
        notes,
    )
