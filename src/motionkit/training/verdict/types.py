"""A verdict for each type of a model in a minute or two: does it work, and if not, why?

Every type is judged by the recordings it was trained on (real.py) in roll-outs from standing and from walking. Gaits
also follow a path. The measures are those of the scoreboard; only the roll-outs are fewer and shorter.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from motionkit.control.path import Path2D, shape_path
from motionkit.control.steering import NEUTRAL_SECONDS
from motionkit.data.workers import Map
from motionkit.inference.noise import Noise
from motionkit.metrics.body import Body
from motionkit.metrics.detectors import detection_windows
from motionkit.metrics.ground import average_foot_sliding
from motionkit.metrics.trajectory import trajectory_distance
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.floor import floor_height, foot_positions
from motionkit.names import counted
from motionkit.tables import Table
from motionkit.training.verdict.extents import SPREAD, what_is_off
from motionkit.training.verdict.judge import GRACE, LIVELY, Judge
from motionkit.training.verdict.real import PROFILE_SECONDS, SHORTEST, RealMotion
from motionkit.training.verdict.rolling import commanded_plans, grouped, roll_paths, roll_plans


@dataclass(frozen=True)
class VerdictSettings:
    """How much is rolled out for a verdict.

    Attributes:
        accuracy_seconds: length of each, counted from the command.
        repeats: characters that follow each path.
        first_seed: by default the first of those that settings are not chosen by.
    """

    seeds: int = 8
    accuracy_seconds: float = 6.0
    repeats: int = 2
    first_seed: int = 1000
    noise: Noise = field(default_factory=Noise)


QUICK_TYPES = VerdictSettings()
# Targets: share of roll-outs that show the type (benchmarks/verdicts.py), distance from the path (cm) of walks and of
# runs, and sliding of held feet relative to the recordings, unless one of them slides more.
DETECTED_SHARE, WALKS_WITHIN, RUNS_WITHIN, SLIDING = 0.85, 1.0, 2.0, 1.3
WALK_RADIUS, RUN_RADIUS = 2.0, 4.0  # metres of the figure-eight
FEW_STEPS = 300  # fewest steps of a run from a model; docs/training.md shows what so many bring
FEW_SECONDS = 10.0  # recordings of a type shorter than this in all are too few to learn from


@dataclass(frozen=True)
class TypeVerdict:
    """How one type of a model does.

    Attributes:
        clips, seconds: its training clips and their length.
        shown, rollouts: roll-outs that show the type, of all.
        joint_speed: mean joint speed relative to the recordings.
        path: mean distance in cm from a figure-eight; None for types that no velocity steers, infinite if a character
            does not follow it to the end.
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
    sliding_target: float = SLIDING

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
    settings: VerdictSettings = QUICK_TYPES,
    progress: Callable[[float], None] | None = None,
    each: Map = map,
) -> list[TypeVerdict]:
    """Judge every type of a model that the recordings of judge show, in its order; `each` is a map over roll-outs."""
    kinds = [
        kind for kind in model.types if kind in judge.real.types and judge.real.profile(kind) is not None
    ]
    judge = Judge(judge.real, by_recordings=True)
    seeds = range(settings.first_seed, settings.first_seed + settings.seeds)
    plans = commanded_plans(model, kinds, seeds, settings.accuracy_seconds)
    report = progress or (lambda share: None)
    takes = roll_plans(model, plans, settings.noise, each, lambda share: report(0.6 * share))
    paths = _path_distances(model, kinds, settings, lambda share: report(0.6 + 0.3 * share))
    verdicts = {}
    for kind, mine in zip(kinds, grouped(takes, settings.seeds), strict=True):
        bodies = [take.default.cut(round(NEUTRAL_SECONDS * model.fps), len(take.default)) for take in mine]
        gait = model.types[kind].gait
        target = RUNS_WITHIN if gait is not None and gait.runs else WALKS_WITHIN
        verdicts[kind] = verdict_on(judge, kind, bodies, paths.get(kind), target)
        report(0.9 + 0.1 * len(verdicts) / len(kinds))
    real = judge.real
    return [verdicts.get(kind) or _unlearnt(real, kind) for kind in model.types if kind in real.types]


def _unlearnt(real: RealMotion, kind: str) -> TypeVerdict:
    """The verdict on a type without training clips, or without one that is long enough."""
    longest = real.longest.get(kind, 0.0)
    why = "there are no clips to learn from"
    if longest:
        why = f"its clips are too short: at most {longest:.2g} s, and {SHORTEST / real.fps:g} s are needed"
    return TypeVerdict(kind, 0, 0.0, 0, 0, 0.0, None, WALKS_WITHIN, 0.0, (why,))


def verdict_table(verdicts: list[TypeVerdict]) -> Table:
    """Return the verdicts with what was measured for them."""
    columns = (
        "type", "verdict", "shown", "joint speed / real", "path, cm", "sliding / real", "clips", "seconds", "why",
    )  # fmt: skip
    rows = [
        (
            v.type,
            "works" if v.works else "does not work",
            f"{v.shown} of {v.rollouts}",
            v.joint_speed,
            None if v.path == float("inf") else v.path,
            v.sliding,
            v.clips,
            v.seconds,
            "; ".join(v.reasons),
        )
        for v in verdicts
    ]
    return Table("Types", columns, rows)


def verdict_notes() -> list[str]:
    """Return what the columns of the table mean."""
    return [
        f"shown: roll-outs within the limits of the type's recordings, after {NEUTRAL_SECONDS:g} s of another type: "
        "how high and low hands, feet and hips come, speed over the ground and of joints, time in the air, steps, "
        f"strikes, poses. Limits are what the clips show, widened by {SPREAD:g} times their spread and a margin",
        f"path: mean distance of the root from a figure-eight of {WALK_RADIUS:g} m, for runs of {RUN_RADIUS:g} m; "
        f"to be within {WALKS_WITHIN:g} and {RUNS_WITHIN:g} cm",
        f"sliding: of feet that are held, relative to the recordings; at most {SLIDING:g}, or as much as in one clip",
    ]


def training_summary(model: MotionModel) -> str:
    """How long a model was trained, and what more time has brought elsewhere, in one line."""
    steps, seconds = model.card.get("steps"), model.card.get("seconds")
    if not steps or seconds is None:
        return "how long it was trained is not known"
    text = f"trained for {counted(steps, 'step')} in {seconds / 60.0:.1f} minutes"
    fine_tuned = (model.card.get("options") or {}).get("init")
    return (
        f"{text}; docs/training.md shows what {FEW_STEPS} bring" if fine_tuned and steps < FEW_STEPS else text
    )


def verdict_page(verdicts: list[TypeVerdict], settings: VerdictSettings, training: str = "") -> str:
    """The verdicts as Markdown, for someone who has not measured motion before."""
    works = sum(verdict.works for verdict in verdicts)
    lines = [
        "<!-- written by motionkit quickstart -->",
        "",
        "# Which types work",
        "",
        f"{works} of {len(verdicts)} types work.",
        *([f"{training[0].upper()}{training[1:]}."] if training else []),
        "",
        *(f"- {verdict.sentence()}" for verdict in verdicts),
        "",
        f"Each type was asked for in {settings.seeds} roll-outs of {settings.accuracy_seconds:g} s, from standing and "
        "from walking. Gaits also followed a figure-eight.",
        "",
        *verdict_table(verdicts).markdown(),
        "",
        *(f"- {note}" for note in verdict_notes()),
    ]
    return "\n".join(lines) + "\n"


def verdict_on(
    judge: Judge,
    kind: str,
    bodies: Sequence[Body],
    path: float | None = None,
    path_target: float = WALKS_WITHIN,
) -> TypeVerdict:
    """Judge what was made of a type, each from the command on, by the recordings of the type."""
    found = judge.real.of_type(kind, "train")
    profile = judge.real.profile(kind)
    assert profile is not None
    late = [body.cut(round(GRACE * body.fps), len(body)) for body in bodies]
    nearest = [judge.nearest_part(kind, body) for body in bodies]
    slides = [_sliding(s.body) for s in found]
    recorded = max(float(np.average(slides, weights=[len(s.body) for s in found])), 0.02)
    verdict = TypeVerdict(
        kind,
        len({stretch.clip for stretch in found}),
        sum(stretch.body.seconds for stretch in found),
        sum(judge.performs(kind, body) for body in bodies),
        len(bodies),
        sum(body.joint_speed() for body in nearest) / len(nearest) / max(profile.joint_speed, 1e-6),
        path,
        path_target,
        float(np.mean([_sliding(body) for body in late]) / recorded),
        sliding_target=max(SLIDING, max(slides) / recorded),
    )
    return replace(verdict, reasons=reasons_of(verdict, judge, nearest))


def _path_distances(
    model: MotionModel, kinds: list[str], settings: VerdictSettings, progress: Callable[[float], None]
) -> dict[str, float]:
    """Mean distance in cm from a figure-eight for each type of kinds that velocity steers; standing is left out."""
    paths: dict[str, Path2D] = {}
    for kind in kinds:
        each = model.types[kind]
        if each.kind is MotionKind.GAIT and each.gait is not None:
            radius = RUN_RADIUS if each.gait.runs else WALK_RADIUS
            paths[kind] = shape_path("figure-eight", radius, [kind], None)
    seeds = range(settings.first_seed, settings.first_seed + settings.repeats)
    tasks = [(path, seed) for path in paths.values() for seed in seeds]
    walks = roll_paths(model, tasks, settings.noise, progress=progress)
    out = {}
    for (kind, path), mine in zip(paths.items(), grouped(walks, len(seeds)), strict=True):
        tracks = [walk.take.default.positions[:, 0, [0, 2]] for walk in mine]
        distances = [trajectory_distance(track, path.points).mean for track in tracks]
        out[kind] = float(np.mean(distances)) if all(walk.finished for walk in mine) else float("inf")
    return out


def _sliding(body: Body) -> float:
    """Average foot sliding of a body in cm per frame, on its own floor."""
    feet = foot_positions(body.positions)
    return average_foot_sliding(feet, floor_height(feet, body.fps)).value or 0.0


def reasons_of(verdict: TypeVerdict, judge: Judge, bodies: list[Body]) -> tuple[str, ...]:
    """What is wrong with a type, and what may be the cause."""
    out = []
    moves = _moves(verdict)
    if verdict.shown < DETECTED_SHARE * verdict.rollouts:
        words = f"shown in {verdict.shown} of {verdict.rollouts} roll-outs"
        cause = moves or _cause(verdict, judge, bodies)
        out.append(f"{words} ({cause})" if cause else words)
    elif moves:
        out.append(moves)
    if verdict.path == float("inf"):
        out.append("does not follow a path to its end")
    elif verdict.path is not None and not verdict.path <= verdict.path_target:
        out.append(f"{verdict.path:.1f} cm from its path, expected at most {verdict.path_target:g}")
    if verdict.sliding > verdict.sliding_target:
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
    windows = [window for body in bodies for window in detection_windows(body, PROFILE_SECONDS)]
    if off := what_is_off(profile.extents, windows):
        return off
    nearest: Counter[str] = Counter()
    far = []
    for window in windows:
        distances = judge.real.pose_distances(window).mean(axis=0)
        nearest[judge.real.types[int(distances.argmin())]] += 1
        far.append(float(distances[profile.kind]))
    other = nearest.most_common(1)[0][0]
    if other != verdict.type:
        return f"its poses are more like {other}"
    distance = float(np.mean(far))
    return f"poses {distance:.1f} cm per joint from the clips" if distance > profile.distance else ""
