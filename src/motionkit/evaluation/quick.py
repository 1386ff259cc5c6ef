"""A verdict for each type of a model in a minute or two: does it work, and if not, why?

Every type is judged by the recordings it was trained on (real.py) in roll-outs from standing and from walking. Gaits
also follow a path. The measures are those of the scoreboard; only the roll-outs are fewer and shorter.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from motionkit.control.path import shape_path
from motionkit.control.steering import NEUTRAL_SECONDS
from motionkit.data.workers import Map
from motionkit.evaluation.body import Body
from motionkit.evaluation.detectors import detection_windows
from motionkit.evaluation.judge import GRACE, LIVELY, Judge
from motionkit.evaluation.paths import PathTrial, follow_trials
from motionkit.evaluation.real import PROFILE_SECONDS, SHORTEST, RealMotion
from motionkit.evaluation.report import Goal, Section, Table, markdown_table
from motionkit.evaluation.rolling import Take, commanded_plans, roll_plans
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.evaluation.trial import Trial
from motionkit.metrics.foot_sliding import average_foot_sliding
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.floor import floor_height, foot_positions

QUICK_TYPES = EvaluationSettings(seeds=8, accuracy_seconds=6.0, repeats=2)
# Targets: share of roll-outs that show the type, distance from the path (cm) of walks and of runs, and sliding of
# held feet relative to the recordings.
SHOWN, WALKS_WITHIN, RUNS_WITHIN, SLIDING = 0.95, 1.0, 2.0, 1.3
WALK_RADIUS, RUN_RADIUS = 2.0, 4.0  # metres of the figure-eight
FEW_SECONDS = 10.0  # recordings of a type shorter than this in all are too few to learn from


@dataclass(frozen=True)
class TypeVerdict:
    """How one type of a model does.

    Attributes:
        type: its name.
        clips, seconds: its training clips and their length.
        shown, rollouts: roll-outs that show the type, of all.
        joint_speed: mean joint speed relative to the recordings.
        path: mean distance in cm from a figure-eight; None for types that no velocity steers.
        path_target: the largest good distance in cm.
        sliding: foot sliding of the roll-outs with held feet relative to that of the recordings.
        reasons: what is wrong, in plain words; empty for a type that works.
    """

    type: str
    clips: int
    seconds: float
    shown: int
    rollouts: int
    joint_speed: float
    path: float | None
    path_target: float
    sliding: float
    reasons: tuple[str, ...] = ()

    @property
    def works(self) -> bool:
        """Whether nothing is wrong with the type."""
        return not self.reasons

    def sentence(self) -> str:
        """The verdict in one line."""
        if self.works:
            return f"{self.type} works: shown in {self.shown} of {self.rollouts} roll-outs"
        return f"{self.type} does not work: {'; '.join(self.reasons)}"


def quick_verdicts(
    model: MotionModel,
    judge: Judge,
    settings: EvaluationSettings = QUICK_TYPES,
    progress: Callable[[float], None] | None = None,
    each: Map = map,
) -> list[TypeVerdict]:
    """Judge every type of a model that the recordings of judge show, in the order of the model.

    Args:
        each: a map over roll-outs, such as that of worker processes; results do not depend on it.
    """
    kinds = [
        kind for kind in model.types if kind in judge.real.types and judge.real.profile(kind) is not None
    ]
    judge = Judge(judge.real, own_clips=True)
    seeds = range(settings.first_seed, settings.first_seed + settings.seeds)
    plans = commanded_plans(model, kinds, seeds, settings.accuracy_seconds)
    report = progress or (lambda share: None)
    takes = roll_plans(model, plans, settings.noise, each, lambda share: report(0.7 * share))
    paths = _path_distances(model, kinds, settings, lambda share: report(0.7 + 0.3 * share))
    size = settings.seeds
    verdicts = {
        kind: _verdict(model, judge, kind, takes[i * size : (i + 1) * size], paths.get(kind))
        for i, kind in enumerate(kinds)
    }
    real = judge.real
    return [verdicts.get(kind) or _unlearnt(real, kind) for kind in model.types if kind in real.types]


def _unlearnt(real: RealMotion, kind: str) -> TypeVerdict:
    """The verdict on a type without training clips, or without one that is long enough."""
    longest = real.longest.get(kind, 0.0)
    why = "there are no clips to learn from"
    if longest:
        why = f"its clips are too short: at most {longest:.1f} s, and {SHORTEST / real.fps:g} s are needed"
    return TypeVerdict(kind, 0, 0.0, 0, 0, 0.0, None, WALKS_WITHIN, 0.0, (why,))


def types_section(trial: Trial, progress: Callable[[float], None]) -> Section:
    """Measure the section: a verdict for each type."""
    return verdict_section(quick_verdicts(trial.model, trial.judge, trial.settings, progress, trial.each))


def verdict_section(verdicts: list[TypeVerdict]) -> Section:
    """The verdicts as a section of a scoreboard."""
    columns = (
        "type",
        "verdict",
        "shown",
        "joint speed / real",
        "path, cm",
        "sliding / real",
        "clips",
        "seconds",
        "why",
    )
    rows = [
        (
            v.type,
            "works" if v.works else "does not work",
            f"{v.shown} of {v.rollouts}",
            v.joint_speed,
            v.path,
            v.sliding,
            v.clips,
            v.seconds,
            "; ".join(v.reasons),
        )
        for v in verdicts
    ]
    notes = [
        f"shown: roll-outs within the limits of the type's recordings, after {NEUTRAL_SECONDS:g} s of another type",
        f"path: mean distance of the root from a figure-eight of {WALK_RADIUS:g} m, for runs of {RUN_RADIUS:g} m; "
        f"to be within {WALKS_WITHIN:g} and {RUNS_WITHIN:g} cm",
        f"sliding: of feet that are held, relative to the recordings; at most {SLIDING:g}",
    ]
    goals = [
        Goal(f"{v.type} works", float(v.works), "yes", 1.0, None, "; ".join(v.reasons)) for v in verdicts
    ]
    return Section("types", "Does each type work?", [Table("Types", columns, rows)], goals, notes)


def verdict_page(verdicts: list[TypeVerdict], settings: EvaluationSettings) -> str:
    """The verdicts as Markdown, for someone who has not measured motion before."""
    section = verdict_section(verdicts)
    works = sum(verdict.works for verdict in verdicts)
    lines = [
        "# Which types work",
        "",
        f"{works} of {len(verdicts)} types work.",
        "",
        *(f"- {verdict.sentence()}" for verdict in verdicts),
        "",
        f"Each type was asked for in {settings.seeds} roll-outs of {settings.accuracy_seconds:g} s, from standing and "
        "from walking. Gaits also followed a figure-eight.",
        "",
        *markdown_table(section.tables[0]),
        "",
        *(f"- {note}" for note in section.notes),
    ]
    return "\n".join(lines) + "\n"


def _verdict(
    model: MotionModel, judge: Judge, kind: str, takes: list[Take], path: float | None
) -> TypeVerdict:
    skip = round(NEUTRAL_SECONDS * model.fps)
    bodies = [take.default.cut(skip, len(take.default)) for take in takes]
    found = judge.real.of_type(kind, "train")
    profile = judge.real.profile(kind)
    assert profile is not None
    late = [body.cut(round(GRACE * body.fps), len(body)) for body in bodies]
    recorded = np.average([_sliding(s.body) for s in found], weights=[len(s.body) for s in found])
    gait = model.types[kind].gait
    verdict = TypeVerdict(
        kind,
        len({stretch.clip for stretch in found}),
        sum(stretch.body.seconds for stretch in found),
        sum(judge.performs(kind, body) for body in bodies),
        len(bodies),
        sum(body.joint_speed() for body in late) / len(late) / max(profile.joint_speed, 1e-6),
        path,
        RUNS_WITHIN if gait is not None and gait.runs else WALKS_WITHIN,
        float(np.mean([_sliding(body) for body in late]) / max(recorded, 0.02)),
    )
    return replace(verdict, reasons=reasons_of(verdict, judge, late))


def _path_distances(
    model: MotionModel, kinds: list[str], settings: EvaluationSettings, progress: Callable[[float], None]
) -> dict[str, float]:
    """Mean distance in cm from a figure-eight for each type of kinds that velocity steers; standing is left out."""
    trials = []
    for kind in kinds:
        each = model.types[kind]
        if each.kind is MotionKind.GAIT and each.gait is not None:
            runs = each.gait.runs
            path = shape_path("figure-eight", RUN_RADIUS if runs else WALK_RADIUS, [kind], None)
            trials.append(PathTrial(kind, path, RUNS_WITHIN if runs else WALKS_WITHIN))
    if not trials:
        return {}
    found = follow_trials(model, trials, settings, progress)
    return {trial.name: followed.mean for trial, followed in zip(trials, found, strict=True)}


def _sliding(body: Body) -> float:
    """Average foot sliding of a body in cm per frame, on its own floor."""
    feet = foot_positions(body.positions)
    return average_foot_sliding(feet, floor_height(feet, body.fps)).value or 0.0


def reasons_of(verdict: TypeVerdict, judge: Judge, bodies: list[Body]) -> tuple[str, ...]:
    """What is wrong with a type, and what may be the cause."""
    out = []
    moves = _moves(verdict)
    if verdict.shown < SHOWN * verdict.rollouts:
        words = f"shown in {verdict.shown} of {verdict.rollouts} roll-outs"
        cause = moves or _cause(verdict, judge, bodies)
        out.append(f"{words} ({cause})" if cause else words)
    elif moves:
        out.append(moves)
    if verdict.path is not None and not verdict.path <= verdict.path_target:
        out.append(f"{verdict.path:.1f} cm from its path, expected at most {verdict.path_target:g}")
    if verdict.sliding > SLIDING:
        out.append(f"feet slide {verdict.sliding:.1f} times as far as in the clips")
    if out and verdict.clips == 1:
        out.append("there is one clip to learn from")
    if out and verdict.seconds < FEW_SECONDS:
        out.append(f"there are {verdict.seconds:.1f} s of clips to learn from")
    return tuple(out)


def _moves(verdict: TypeVerdict) -> str:
    """How much a type moves in the mean of its roll-outs, if that is too little or too much."""
    if not verdict.joint_speed >= LIVELY[0]:
        return f"it moves {verdict.joint_speed:.2f} times as much as the clips"
    if verdict.joint_speed > LIVELY[1]:
        return f"it moves {verdict.joint_speed:.1f} times as much as the clips"
    return ""


def _cause(verdict: TypeVerdict, judge: Judge, bodies: list[Body]) -> str:
    """Why roll-outs of a type that moves enough are not within the limits of its recordings."""
    profile = judge.real.profile(verdict.type)
    assert profile is not None
    nearest: Counter[str] = Counter()
    far = []
    for body in bodies:
        for window in detection_windows(body, PROFILE_SECONDS):
            distances = judge.real.pose_distances(window).mean(axis=0)
            nearest[judge.real.types[int(distances.argmin())]] += 1
            far.append(float(distances[profile.kind]))
    other = nearest.most_common(1)[0][0]
    if other != verdict.type:
        return f"its poses are more like {other}"
    distance = float(np.mean(far))
    return f"poses {distance:.1f} cm per joint from the clips" if distance > profile.distance else ""
