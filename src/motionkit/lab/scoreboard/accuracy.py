"""Action accuracy: how often the motion shows the type that was asked for, in recordings and in roll-outs."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from motionkit.control.steering import NEUTRAL_SECONDS, neutral_types
from motionkit.lab.scoreboard.report import Goal, Section, at_least
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.body import Body
from motionkit.metrics.detectors import HOLD, LEAST_WINDOW, detection_windows
from motionkit.models.model import MotionModel
from motionkit.tables import Cell, Table
from motionkit.training.verdict.judge import GRACE, LIVELY, Judge
from motionkit.training.verdict.rolling import Progress, Take, commanded_plans, grouped

MEASURED_CONFUSION = 0.05  # the report leaves out smaller shares of other types
# Target share of roll-outs for a type with several training clips, and for one with a single clip.
TARGET_MANY, TARGET_ONE = 0.95, 0.8
TARGET_REAL = 0.95  # target share of the recorded windows of a type
TARGET_ALONE = 20 / 23  # target share of the types to be shown without reference recordings


@dataclass(frozen=True)
class Calibration:
    """How recordings score on the detector of a type.

    Attributes:
        windows, accepted: its recorded windows, and those that the detector accepts.
        failing: clips with rejected windows.
        others: share of accepted windows for each other type, where it is at least MEASURED_CONFUSION.
    """

    type: str
    windows: int
    accepted: int
    failing: tuple[str, ...]
    others: dict[str, float]

    @property
    def share(self) -> float | None:
        """Share of the type's own windows that the detector accepts; None without windows."""
        return self.accepted / self.windows if self.windows else None


def calibrate(judge: Judge, kinds: tuple[str, ...]) -> list[Calibration]:
    """Run the detector of each type on the recordings of all types, training and held-out.

    A recording is compared with the poses of other clips only. Recordings shorter than half a window are left out.
    """
    accepted: dict[str, list[bool]] = defaultdict(list)
    failing: dict[str, list[str]] = defaultdict(list)
    others: dict[str, dict[str, list[bool]]] = {kind: defaultdict(list) for kind in kinds}
    for stretch in judge.real.stretches:
        for window in {judge.window(kind) for kind in kinds}:
            if stretch.body.seconds < LEAST_WINDOW * window:
                continue
            for part in detection_windows(stretch.body, window):
                detected = _detected_types(
                    judge, [k for k in kinds if judge.window(k) == window], part, stretch.clip
                )
                for kind, shows in detected.items():
                    if kind != stretch.type:
                        others[kind][stretch.type].append(shows)
                        continue
                    accepted[kind].append(shows)
                    if not shows and stretch.name not in failing[kind]:
                        failing[kind].append(stretch.name)
    return [
        Calibration(
            kind,
            len(accepted[kind]),
            sum(accepted[kind]),
            tuple(failing[kind]),
            {
                other: sum(found) / len(found)
                for other, found in others[kind].items()
                if sum(found) / len(found) >= MEASURED_CONFUSION
            },
        )
        for kind in kinds
    ]


def accuracy_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: run the detectors on recordings and on the model's roll-outs."""
    kinds = tuple(kind for kind in trial.model.types if trial.judge.knows(kind))
    bare = trial.without_references
    share = 1.0 if bare is None else 0.5
    found = measure_accuracy(trial, kinds, lambda done: progress(share * done))
    alone = {} if bare is None else {
        each.type: each for each in measure_accuracy(trial, kinds, lambda done: progress(0.5 + 0.5 * done), bare)
    }  # fmt: skip
    real = {c.type: c for c in calibrate(trial.judge, kinds)}
    rows: list[tuple[Cell, ...]] = []
    for each in found:
        calibration, none = real[each.type], alone.get(each.type)
        row: tuple[Cell, ...] = (each.type, each.training_clips, each.share, each.raw_share, each.joint_speed)
        if bare is not None:
            row += (None if none is None else none.share, None if none is None else none.joint_speed)
        rows.append((*row, calibration.share, calibration.windows))
    columns: tuple[str, ...] = ("type", "training clips", "accuracy", "raw", "joint speed / real")
    if bare is not None:
        columns += ("without references", "joint speed / real, without")
    columns += ("real windows detected", "real windows")
    return Section(
        "accuracy",
        "Action accuracy",
        [Table("Action accuracy per type", columns, rows), _detectors(trial.judge, kinds, real)],
        _goals(trial.judge, found, list(alone.values()), real),
        _notes(trial, kinds),
    )


def _detectors(judge: Judge, kinds: tuple[str, ...], real: dict[str, Calibration]) -> Table:
    rows = [
        (
            kind,
            f"{judge.window(kind):g} s" if judge.window(kind) else "once",
            judge.description(kind),
            ", ".join(f"{k} {v:.0%}" for k, v in sorted(real[kind].others.items(), key=lambda i: -i[1])),
            ", ".join(real[kind].failing),
        )
        for kind in kinds
    ]
    columns = (
        "type",
        "window",
        "detector",
        "detected in real windows of other types",
        "real clips it misses",
    )
    return Table("Detectors", columns, rows)


def _notes(trial: Trial, kinds: tuple[str, ...]) -> list[str]:
    model, settings = trial.model, trial.settings
    notes = [
        f"{settings.seeds} roll-outs per type: {NEUTRAL_SECONDS:g} s of {' or '.join(neutral_types(model))}, then "
        f"{settings.accuracy_seconds:g} s of the type, as synthesize makes them by default; accuracy: share of "
        "roll-outs in which the type is detected; raw: the same with feet not locked; without references: the same "
        "with --reference none",
        f"a lasting type must be detected in {HOLD:.0%} of its windows, counted from {GRACE:g} s after the command; "
        "a type that is performed once must be detected at least once; a type without a detector of its own must also "
        "move as fast as calm or busy recordings in each roll-out, and, to be shown without references, at "
        f"{LIVELY[0]:g} to {LIVELY[1]:g} times the joint speed of its recordings in the mean of all roll-outs",
        "real windows: the same detectors on recordings of at least half a window, compared with poses of other "
        "clips only",
    ]
    unknown = [kind for kind in model.types if kind not in kinds]
    missing = [kind for kind in unknown if kind not in trial.recorded_types]
    thin = [kind for kind in unknown if kind in trial.recorded_types]
    if missing:
        notes.append(f"not measured, because the dataset has no recordings: {', '.join(missing)}")
    if thin:
        notes.append(
            "not measured, because no detector fits and one recording cannot be compared with another: "
            f"{', '.join(thin)}"
        )
    return notes


def _goals(
    judge: Judge, found: list[TypeAccuracy], alone: list[TypeAccuracy], real: dict[str, Calibration]
) -> list[Goal]:
    goals = []
    for each in found:
        target = _target(each)
        clips = "one training clip" if each.training_clips == 1 else ""
        goals.append(at_least(f"accuracy of {each.type}", each.share, target, clips, ".0%"))
        if judge.detector(each.type) is None:
            limits = f"{LIVELY[0]:g} to {LIVELY[1]:g}"
            goals.append(Goal(f"joint speed of {each.type} / real", each.joint_speed, limits, *LIVELY))
    if alone:
        reached = [each for each in alone if is_reached(judge, each)]
        failing = [each.type for each in alone if each not in reached]
        what = f"types shown without reference recordings, of {len(alone)}"
        note = f"not shown: {', '.join(failing)}" if failing else ""
        goals.append(at_least(what, len(reached), round(TARGET_ALONE * len(alone)), note))
    shares = {kind: calibration.share for kind, calibration in real.items() if calibration.share is not None}
    failing = [kind for kind, share in shares.items() if share < TARGET_REAL]
    if shares:
        good = 1.0 - len(failing) / len(shares)
        note = f"below: {', '.join(failing)}" if failing else ""
        what = f"types detected in ≥ {TARGET_REAL:.0%} of their real windows"
        goals.append(Goal(what, good, "all", 1.0, None, note))
    return goals


def _detected_types(judge: Judge, kinds: list[str], body: Body, clip: int) -> dict[str, bool]:
    """Return which types a recorded window shows. One measurement of pose distances serves all types."""
    detectors = {kind: judge.detector(kind) for kind in kinds}
    out = {kind: found.shows(body) for kind, found in detectors.items() if found is not None}
    profiles = {kind: judge.real.profile(kind) for kind in kinds if kind not in out}
    if profiles:
        distances = judge.real.pose_distances(body, clip).mean(axis=0)
        out |= {k: profile is not None and profile.shows(body, distances) for k, profile in profiles.items()}
    return out


def _target(each: TypeAccuracy) -> float:
    return TARGET_ONE if each.training_clips == 1 else TARGET_MANY


def is_reached(judge: Judge, each: TypeAccuracy) -> bool:
    """Whether a type is shown in enough roll-outs, and moves as much in their mean as its recordings."""
    speed = each.joint_speed
    lively = judge.detector(each.type) is not None or (speed is not None and LIVELY[0] <= speed <= LIVELY[1])
    return lively and each.share >= _target(each)


@dataclass(frozen=True)
class TypeAccuracy:
    """Action accuracy of one type.

    Attributes:
        detected: roll-outs in which the type is detected.
        raw_detected: the same for the raw network output; None if it was not judged.
        joint_speed: its mean divided by that of the recordings; None without recordings.
    """

    type: str
    rollouts: int
    detected: int
    raw_detected: int | None
    joint_speed: float | None
    training_clips: int

    @property
    def share(self) -> float:
        """Share of the roll-outs in which the type is detected."""
        return self.detected / self.rollouts

    @property
    def raw_share(self) -> float | None:
        """The same for the raw network output."""
        return None if self.raw_detected is None else self.raw_detected / self.rollouts


def measure_accuracy(
    trial: Trial,
    kinds: tuple[str, ...] | None = None,
    progress: Progress | None = None,
    model: MotionModel | None = None,
) -> list[TypeAccuracy]:
    """Command every type in turn, from standing and from walking, and count how often it is performed.

    Each roll-out performs a neutral type for NEUTRAL_SECONDS and is then commanded its own type for
    settings.accuracy_seconds. The raw output of another model, such as the one without references, is not judged.
    """
    raw = model is None
    model, judge, settings = model or trial.model, trial.judge, trial.settings
    kinds = tuple(k for k in (kinds or model.types) if judge.knows(k))
    seeds = trial.seeds(settings.seeds)
    plans = commanded_plans(model, kinds, seeds, settings.accuracy_seconds)
    rolled = trial.roll(plans, progress, model)
    skip = round(NEUTRAL_SECONDS * model.fps)
    return [
        _accuracy(judge, kind, [take.cut(skip, len(take.default)) for take in takes], raw)
        for kind, takes in zip(kinds, grouped(rolled, len(seeds)), strict=True)
    ]


def _accuracy(judge: Judge, kind: str, takes: list[Take], raw: bool) -> TypeAccuracy:
    bodies = [take.default for take in takes]
    ratios = [judge.speed_ratio(kind, body.cut(round(GRACE * body.fps), len(body))) for body in bodies]
    known = [ratio for ratio in ratios if ratio is not None]
    return TypeAccuracy(
        kind,
        len(takes),
        sum(judge.performs(kind, body) for body in bodies),
        sum(judge.performs(kind, take.raw) for take in takes) if raw else None,
        sum(known) / len(known) if known else None,
        len({s.clip for s in judge.real.of_type(kind, "train")}),
    )
