"""Transitions that are in no clip: does a joint turn faster than any does in the recordings?"""

from __future__ import annotations

from motionkit.evaluation.body import Body
from motionkit.evaluation.real import RealMotion
from motionkit.evaluation.report import Goal, Section, Table
from motionkit.evaluation.rolling import Plan, Progress, roll_plans
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.metrics.body_movement import geodesic_movement
from motionkit.models.checkpoint import MotionModel
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.synthesis.plan import TypePart

LASTING_SECONDS = 3.0  # of a type without a length of its own
SEQUENCES = (
    ("running", "twist", "cartwheel", "kicking"),
    ("running", "side-somersault", "cartwheel", "running"),
    ("walking", "backflip", "handspring", "walking"),
    ("punching", "w-kicking", "dance-modern", "exercise"),
)


def fastest_turn(body: Body) -> tuple[float, str]:
    """Degrees per second of the fastest joint between two frames, and its name."""
    speeds = geodesic_movement(body.rotations).amax(dim=0) * body.fps
    joint = int(speeds.argmax())
    return float(speeds[joint]), JOINT_NAMES[joint]


def smoothness_section(
    model: MotionModel, real: RealMotion, settings: EvaluationSettings, progress: Progress
) -> Section:
    """The section of the scoreboard: the fastest joint of each sequence against that of all recordings."""
    limit, joint = max(fastest_turn(stretch.body) for stretch in real.stretches)
    rows, goals = [], []
    known = [s for s in SEQUENCES if set(s) <= set(model.types)]
    for number, sequence in enumerate(known):
        parts = tuple(TypePart(k, model.phase_seconds(k) or LASTING_SECONDS) for k in sequence)
        plans = [Plan(parts, seed) for seed in range(settings.few)]
        performed = roll_plans(model, plans, settings.noise, settings.seed)
        fastest, where = max(fastest_turn(p.body) for p in performed)
        name = " → ".join(sequence)
        rows.append((name, fastest, where, fastest / limit))
        goals.append(Goal(f"{name}, fastest joint / real", fastest / limit, "≤ 1", None, 1.0))
        progress((number + 1) / len(known))
    columns = ("sequence", "fastest joint, degrees/s", "joint", "/ real")
    notes = [
        f"the largest of {settings.few} characters, each type for its own length or {LASTING_SECONDS:g} s; the fastest "
        f"joint of all recordings is {joint} at {limit:.0f} degrees/s",
    ]
    return Section(
        "smoothness", "Transitions in no clip", [Table("Fastest joint", columns, rows)], goals, notes
    )
