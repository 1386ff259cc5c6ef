"""Action accuracy: does the motion show what was asked for? Of recordings first, then of the model's roll-outs."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from motionkit.control.script import TypePart
from motionkit.evaluation.body import Body
from motionkit.evaluation.detectors import DETECTORS, HOLD, LEAST_WINDOW, sign_windows
from motionkit.evaluation.real import PROFILE_SECONDS, RealMotion
from motionkit.evaluation.report import Goal, Section, Table
from motionkit.evaluation.rolling import NEUTRAL_SECONDS, Plan, Progress, neutral_types, roll_plans
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.models.checkpoint import MotionModel

GRACE = 1.0  # seconds after a command that belong to the transition
MEASURED_CONFUSION = 0.05  # smaller shares of another type are not listed
# To reach (share of roll-outs) by a type with several training clips, and by one with a single clip.
TARGET_MANY, TARGET_ONE = 0.95, 0.8
TARGET_REAL = 0.95  # of the recorded windows of a type
# Mean joint speed over the recordings', for types judged by their profile.
LIVELY = (0.7, 1.4)


class Judge:
    """Tells whether a stretch of motion shows a type: by the table of detectors, else by the profile of its recordings."""

    def __init__(self, real: RealMotion) -> None:
        self.real = real

    def knows(self, kind: str) -> bool:
        """Whether there is anything to judge a type by."""
        return kind in DETECTORS or (kind in self.real.types and self.real.profile(kind) is not None)

    def window(self, kind: str) -> float:
        """Seconds of the windows a type is judged by; 0 for a type that is performed once."""
        return DETECTORS[kind].window if kind in DETECTORS else PROFILE_SECONDS

    def says(self, kind: str) -> str:
        """The detector in words."""
        profile = None if kind in DETECTORS else self.real.profile(kind)
        return DETECTORS[kind].says if profile is None else profile.says()

    def shows(self, kind: str, body: Body, without: int = -1) -> bool:
        """Whether a window shows a type; without is the number of a clip whose poses do not count."""
        if kind in DETECTORS:
            return DETECTORS[kind].shows(body)
        profile = self.real.profile(kind)
        assert profile is not None
        return profile.shows(body, self.real.pose_distances(body, without).mean(axis=0))

    def share(self, kind: str, body: Body) -> float:
        """The share of a motion's windows that show a type."""
        windows = sign_windows(body, self.window(kind))
        return sum(self.shows(kind, window) for window in windows) / len(windows)

    def obeys(self, kind: str, body: Body) -> bool:
        """Whether what was done from a command on is what was asked for.

        A type that is performed once has to come at least once. Any other has to show in HOLD of the
        windows, from GRACE seconds after the command.
        """
        if self.window(kind) == 0.0:
            return self.shows(kind, body)
        return self.share(kind, body.cut(round(GRACE * body.fps), len(body))) >= HOLD


@dataclass(frozen=True)
class Calibration:
    """How recordings fare by the detector of a type.

    Attributes:
        windows: recorded windows of the type, shown of them that show it.
        failing: clips with windows that do not.
        others: for other types the share of their recorded windows that show it, if at least MEASURED_CONFUSION.
    """

    type: str
    windows: int
    shown: int
    failing: tuple[str, ...]
    others: dict[str, float]

    @property
    def share(self) -> float | None:
        """Of the type's own windows, None without any."""
        return self.shown / self.windows if self.windows else None


def calibrate(judge: Judge, kinds: tuple[str, ...]) -> list[Calibration]:
    """Hold recordings of all types, training and held-out ones, against the detector of each type.

    A recording is compared with the poses of other clips only. One shorter than half a window is too short to tell.
    """
    own: dict[str, list[bool]] = defaultdict(list)
    failing: dict[str, list[str]] = defaultdict(list)
    others: dict[str, dict[str, list[bool]]] = {kind: defaultdict(list) for kind in kinds}
    for stretch in judge.real.stretches:
        for window in {judge.window(kind) for kind in kinds}:
            if stretch.body.seconds < LEAST_WINDOW * window:
                continue
            for part in sign_windows(stretch.body, window):
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
    """The section of the scoreboard: the detectors on recordings, and on the model's roll-outs."""
    kinds = tuple(kind for kind in model.types if judge.knows(kind))
    found = measure_accuracy(model, judge, settings, kinds, progress)
    real = {c.type: c for c in calibrate(judge, kinds)}
    rows = []
    for each in found:
        own = real[each.type]
        rows.append((each.type, each.training_clips, each.share, each.joint_speed, own.share, own.windows))
    columns = ("type", "training clips", "shown", "joint speed / real", "real windows that pass", "windows")
    detectors = [
        (
            kind,
            f"{judge.window(kind):g} s" if judge.window(kind) else "once",
            judge.says(kind),
            ", ".join(f"{k} {v:.0%}" for k, v in sorted(real[kind].others.items(), key=lambda i: -i[1])),
            ", ".join(real[kind].failing),
        )
        for kind in kinds
    ]
    unknown = [kind for kind in model.types if kind not in kinds]
    notes = [
        f"{settings.seeds} roll-outs a type: {NEUTRAL_SECONDS:g} s of {' or '.join(neutral_types(model))}, then "
        f"{settings.seconds:g} s of the type; shown: the share of them that show its detector",
        f"a lasting detector has to show in {HOLD:.0%} of its windows from {GRACE:g} s after the command, one of a type "
        "performed once at least once",
        "recordings of at least half a window are judged by the same detectors, against poses of other clips only",
    ]
    if unknown:
        notes.append(f"not in the dataset, so not judged: {', '.join(unknown)}")
    sign_columns = (
        "type",
        "window",
        "detector",
        "other types whose real windows pass",
        "real clips that fail",
    )
    tables = [
        Table("Action accuracy: share of roll-outs that show the type", columns, rows),
        Table("Detectors", sign_columns, detectors),
    ]
    return Section("accuracy", "Action accuracy", tables, _goals(found, real), notes)


def _goals(found: list[TypeAccuracy], real: dict[str, Calibration]) -> list[Goal]:
    goals = []
    for each in found:
        target = TARGET_ONE if each.training_clips == 1 else TARGET_MANY
        clips = "one training clip" if each.training_clips == 1 else ""
        goals.append(Goal(f"{each.type} shown", each.share, f"≥ {target:.0%}", target, None, clips))
        if each.type not in DETECTORS:
            limits = f"{LIVELY[0]:g} to {LIVELY[1]:g}"
            goals.append(Goal(f"{each.type} joint speed / real", each.joint_speed, limits, *LIVELY))
    shares = {kind: own.share for kind, own in real.items() if own.share is not None}
    failing = [kind for kind, share in shares.items() if share < TARGET_REAL]
    if shares:
        good = 1.0 - len(failing) / len(shares)
        note = f"fewer: {', '.join(failing)}" if failing else ""
        what = f"types whose detector ≥ {TARGET_REAL:.0%} of the real windows show"
        goals.append(Goal(what, good, "all", 1.0, None, note))
    return goals


def _shown(judge: Judge, kinds: list[str], body: Body, clip: int) -> dict[str, bool]:
    """Which types a recorded window shows; the distances to poses are measured once for all."""
    out = {kind: DETECTORS[kind].shows(body) for kind in kinds if kind in DETECTORS}
    profiles = {kind: judge.real.profile(kind) for kind in kinds if kind not in DETECTORS}
    if profiles:
        distances = judge.real.pose_distances(body, clip).mean(axis=0)
        out |= {k: profile is not None and profile.shows(body, distances) for k, profile in profiles.items()}
    return out


@dataclass(frozen=True)
class TypeAccuracy:
    """How a model obeys a type.

    Attributes:
        rollouts, shown: roll-outs, and those that show the detector.
        joint_speed: mean joint speed over that of the recordings, None without any.
        training_clips: recordings the type was learnt from.
    """

    type: str
    rollouts: int
    shown: int
    joint_speed: float | None
    training_clips: int

    @property
    def share(self) -> float:
        """Of the roll-outs that show the type."""
        return self.shown / self.rollouts


def measure_accuracy(
    model: MotionModel,
    judge: Judge,
    settings: EvaluationSettings,
    kinds: tuple[str, ...] | None = None,
    progress: Progress | None = None,
) -> list[TypeAccuracy]:
    """Ask for every type in turn, from standing and from walking, and see how often it comes.

    Each roll-out starts with NEUTRAL_SECONDS of a neutral type, then is asked for its type for some
    seconds, with the phase and the recorded track `synthesize` gives it.
    """
    kinds = tuple(k for k in (kinds or model.types) if judge.knows(k))
    neutral = neutral_types(model)
    seeds = settings.seeds
    plans = [
        Plan(
            (TypePart(neutral[seed % len(neutral)], NEUTRAL_SECONDS), TypePart(kind, settings.seconds)), seed
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
                sum(judge.obeys(kind, body) for body in bodies),
                sum(speeds) / len(speeds) / profile.joint_speed if profile else None,
                len(clips),
            )
        )
    return out
