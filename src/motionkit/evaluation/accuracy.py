"""Action accuracy: how often the motion shows the type that was asked for, in recordings and in roll-outs."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from motionkit.control.script import TypePart
from motionkit.evaluation.body import Body
from motionkit.evaluation.detectors import DETECTORS, HOLD, LEAST_WINDOW, detection_windows
from motionkit.evaluation.real import PROFILE_SECONDS, RealMotion
from motionkit.evaluation.report import Goal, Section, Table
from motionkit.evaluation.rolling import NEUTRAL_SECONDS, Plan, Progress, neutral_types, roll_plans
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.models.model import MotionModel

GRACE = 1.0  # seconds after a command that count as the transition
MEASURED_CONFUSION = 0.05  # the report leaves out smaller shares of other types
# Target share of roll-outs for a type with several training clips, and for one with a single clip.
TARGET_MANY, TARGET_ONE = 0.95, 0.8
TARGET_REAL = 0.95  # target share of the recorded windows of a type
# Limits of mean joint speed relative to the recordings, for types judged by their motion profile.
LIVELY = (0.7, 1.4)


class Judge:
    """Decides whether motion shows a type: by the type's detector, else by the motion profile of its recordings."""

    def __init__(self, real: RealMotion) -> None:
        self.real = real

    def knows(self, kind: str) -> bool:
        """Whether a type has a detector or a motion profile."""
        return kind in DETECTORS or (kind in self.real.types and self.real.profile(kind) is not None)

    def window(self, kind: str) -> float:
        """Length of a type's detection windows in seconds; 0 for a type that is performed once."""
        return DETECTORS[kind].window if kind in DETECTORS else PROFILE_SECONDS

    def description(self, kind: str) -> str:
        """Return the detector in words."""
        profile = None if kind in DETECTORS else self.real.profile(kind)
        return DETECTORS[kind].description if profile is None else profile.description()

    def shows(self, kind: str, body: Body, without: int = -1) -> bool:
        """Whether a window shows a type. Poses of clip number `without` are left out of the comparison."""
        if kind in DETECTORS:
            return DETECTORS[kind].shows(body)
        profile = self.real.profile(kind)
        assert profile is not None
        return profile.shows(body, self.real.pose_distances(body, without).mean(axis=0))

    def share(self, kind: str, body: Body) -> float:
        """Return the share of a motion's windows that show a type."""
        windows = detection_windows(body, self.window(kind))
        return sum(self.shows(kind, window) for window in windows) / len(windows)

    def performs(self, kind: str, body: Body) -> bool:
        """Whether the motion after a command performs the commanded type.

        A type that is performed once must be detected at least once. Any other type must be detected in
        a share HOLD of the windows, counted from GRACE seconds after the command.
        """
        if self.window(kind) == 0.0:
            return self.shows(kind, body)
        return self.share(kind, body.cut(round(GRACE * body.fps), len(body))) >= HOLD


@dataclass(frozen=True)
class Calibration:
    """How recordings score on the detector of a type.

    Attributes:
        type: the name of the type.
        windows: number of recorded windows of the type.
        shown: number of these windows that the detector accepts.
        failing: clips with rejected windows.
        others: share of accepted windows for each other type, where it is at least MEASURED_CONFUSION.
    """

    type: str
    windows: int
    shown: int
    failing: tuple[str, ...]
    others: dict[str, float]

    @property
    def share(self) -> float | None:
        """Share of the type's own windows that the detector accepts; None without windows."""
        return self.shown / self.windows if self.windows else None


def calibrate(judge: Judge, kinds: tuple[str, ...]) -> list[Calibration]:
    """Run the detector of each type on the recordings of all types, training and held-out.

    A recording is compared with the poses of other clips only. Recordings shorter than half a window are left out.
    """
    own: dict[str, list[bool]] = defaultdict(list)
    failing: dict[str, list[str]] = defaultdict(list)
    others: dict[str, dict[str, list[bool]]] = {kind: defaultdict(list) for kind in kinds}
    for stretch in judge.real.stretches:
        for window in {judge.window(kind) for kind in kinds}:
            if stretch.body.seconds < LEAST_WINDOW * window:
                continue
            for part in detection_windows(stretch.body, window):
                shown = _shown(judge, [k for k in kinds if judge.window(k) == window], part, stretch.clip)
                for kind, shows in shown.items():
                    if kind != stretch.type:
                        others[kind][stretch.type].append(shows)
                        continue
                    own[kind].append(shows)
                    if not shows and stretch.name not in failing[kind]:
                        failing[kind].append(stretch.name)
    return [
        Calibration(
            kind,
            len(own[kind]),
            sum(own[kind]),
            tuple(failing[kind]),
            {
                other: sum(found) / len(found)
                for other, found in others[kind].items()
                if sum(found) / len(found) >= MEASURED_CONFUSION
            },
        )
        for kind in kinds
    ]


def accuracy_section(
    model: MotionModel, judge: Judge, settings: EvaluationSettings, progress: Progress
) -> Section:
    """Measure the section: run the detectors on recordings and on the model's roll-outs."""
    kinds = tuple(kind for kind in model.types if judge.knows(kind))
    found = measure_accuracy(model, judge, settings, kinds, progress)
    real = {c.type: c for c in calibrate(judge, kinds)}
    rows = []
    for each in found:
        own = real[each.type]
        rows.append((each.type, each.training_clips, each.share, each.joint_speed, own.share, own.windows))
    columns = (
        "type",
        "training clips",
        "accuracy",
        "joint speed / real",
        "real windows detected",
        "real windows",
    )
    detectors = [
        (
            kind,
            f"{judge.window(kind):g} s" if judge.window(kind) else "once",
            judge.description(kind),
            ", ".join(f"{k} {v:.0%}" for k, v in sorted(real[kind].others.items(), key=lambda i: -i[1])),
            ", ".join(real[kind].failing),
        )
        for kind in kinds
    ]
    unknown = [kind for kind in model.types if kind not in kinds]
    notes = [
        f"{settings.seeds} roll-outs per type: {NEUTRAL_SECONDS:g} s of {' or '.join(neutral_types(model))}, then "
        f"{settings.accuracy_seconds:g} s of the type; accuracy: share of roll-outs in which the type is detected",
        f"a lasting type must be detected in {HOLD:.0%} of its windows, counted from {GRACE:g} s after the command; "
        "a type that is performed once must be detected at least once",
        "real windows: the same detectors on recordings of at least half a window, compared with poses of other "
        "clips only",
    ]
    if unknown:
        notes.append(f"not measured, because the dataset has no recordings: {', '.join(unknown)}")
    detector_columns = (
        "type",
        "window",
        "detector",
        "detected in real windows of other types",
        "real clips it misses",
    )
    tables = [
        Table("Action accuracy per type", columns, rows),
        Table("Detectors", detector_columns, detectors),
    ]
    return Section("accuracy", "Action accuracy", tables, _goals(found, real), notes)


def _goals(found: list[TypeAccuracy], real: dict[str, Calibration]) -> list[Goal]:
    goals = []
    for each in found:
        target = TARGET_ONE if each.training_clips == 1 else TARGET_MANY
        clips = "one training clip" if each.training_clips == 1 else ""
        goals.append(Goal(f"accuracy of {each.type}", each.share, f"≥ {target:.0%}", target, None, clips))
        if each.type not in DETECTORS:
            limits = f"{LIVELY[0]:g} to {LIVELY[1]:g}"
            goals.append(Goal(f"joint speed of {each.type} / real", each.joint_speed, limits, *LIVELY))
    shares = {kind: own.share for kind, own in real.items() if own.share is not None}
    failing = [kind for kind, share in shares.items() if share < TARGET_REAL]
    if shares:
        good = 1.0 - len(failing) / len(shares)
        note = f"below: {', '.join(failing)}" if failing else ""
        what = f"types detected in ≥ {TARGET_REAL:.0%} of their real windows"
        goals.append(Goal(what, good, "all", 1.0, None, note))
    return goals


def _shown(judge: Judge, kinds: list[str], body: Body, clip: int) -> dict[str, bool]:
    """Return which types a recorded window shows. One measurement of pose distances serves all types."""
    out = {kind: DETECTORS[kind].shows(body) for kind in kinds if kind in DETECTORS}
    profiles = {kind: judge.real.profile(kind) for kind in kinds if kind not in DETECTORS}
    if profiles:
        distances = judge.real.pose_distances(body, clip).mean(axis=0)
        out |= {k: profile is not None and profile.shows(body, distances) for k, profile in profiles.items()}
    return out


@dataclass(frozen=True)
class TypeAccuracy:
    """Action accuracy of one type.

    Attributes:
        type: the name of the type.
        rollouts: number of roll-outs.
        shown: number of roll-outs in which the type is detected.
        joint_speed: mean joint speed divided by that of the recordings; None without recordings.
        training_clips: number of training clips of the type.
    """

    type: str
    rollouts: int
    shown: int
    joint_speed: float | None
    training_clips: int

    @property
    def share(self) -> float:
        """Share of the roll-outs in which the type is detected."""
        return self.shown / self.rollouts


def measure_accuracy(
    model: MotionModel,
    judge: Judge,
    settings: EvaluationSettings,
    kinds: tuple[str, ...] | None = None,
    progress: Progress | None = None,
) -> list[TypeAccuracy]:
    """Command every type in turn, from standing and from walking, and count how often it is performed.

    Each roll-out performs a neutral type for NEUTRAL_SECONDS and is then commanded its own type for
    settings.accuracy_seconds, with the phase and the reference poses of `synthesize`.

    Args:
        kinds: the types to measure; all types of the model if None.
    """
    kinds = tuple(k for k in (kinds or model.types) if judge.knows(k))
    neutral = neutral_types(model)
    seeds = settings.seeds
    plans = [
        Plan(
            (
                TypePart(neutral[seed % len(neutral)], NEUTRAL_SECONDS),
                TypePart(kind, settings.accuracy_seconds),
            ),
            seed,
        )
        for kind in kinds
        for seed in range(seeds)
    ]
    performed = roll_plans(model, plans, settings.noise, settings.seed, progress)
    skip = round(NEUTRAL_SECONDS * model.fps)
    out = []
    for number, kind in enumerate(kinds):
        bodies = [p.body.cut(skip, len(p.body)) for p in performed[number * seeds : (number + 1) * seeds]]
        profile = judge.real.profile(kind) if kind in judge.real.types else None
        speeds = [body.cut(round(GRACE * body.fps), len(body)).joint_speed() for body in bodies]
        clips = {s.clip for s in judge.real.of_type(kind, "train")}
        out.append(
            TypeAccuracy(
                kind,
                seeds,
                sum(judge.performs(kind, body) for body in bodies),
                sum(speeds) / len(speeds) / profile.joint_speed if profile else None,
                len(clips),
            )
        )
    return out
