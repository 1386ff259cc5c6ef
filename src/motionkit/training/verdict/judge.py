"""Judges whether motion shows a type: by a detector that fits its recordings, else by their motion profile."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from functools import cached_property

from motionkit.metrics.body import Body
from motionkit.metrics.detectors import DETECTORS, HOLD, LEAST_WINDOW, Detector, detection_windows
from motionkit.training.verdict.real import PROFILE_SECONDS, MotionProfile, RealMotion

GRACE = 1.0  # seconds after a command that count as the transition
# Limits of mean joint speed relative to the recordings, for types judged by their motion profile.
LIVELY = (0.7, 1.4)


def fitting_detectors(real: RealMotion) -> dict[str, str]:
    """Return the detector (a key of DETECTORS) of each type that has one, whatever the type is called.

    It must accept a share HOLD of the type's recorded windows; of several, that is taken which accepts least of the
    other types. A detector that fits several types cannot tell them apart and is given to none of them, except to a
    type with a single recording, which nothing else could judge.
    """
    accepted = _accepted_shares(real)
    found: dict[str, str] = {}
    for kind in real.types:
        fitting = [name for name in DETECTORS if accepted[name].get(kind, 0.0) >= HOLD]
        if fitting:
            found[kind] = min(fitting, key=lambda name: (sum(accepted[name].values()), name != kind))
    several = Counter(found.values())
    return {kind: name for kind, name in found.items() if several[name] == 1 or not _has_profile(real, kind)}


def _accepted_shares(real: RealMotion) -> dict[str, dict[str, float]]:
    """The share of the recorded windows of each type that each detector accepts."""
    accepted: dict[str, dict[str, list[bool]]] = {name: defaultdict(list) for name in DETECTORS}
    for stretch in real.stretches:
        for name, detector in DETECTORS.items():
            if stretch.body.seconds >= LEAST_WINDOW * detector.window:
                windows = detection_windows(stretch.body, detector.window)
                accepted[name][stretch.type] += [detector.shows(window) for window in windows]
    return {name: {kind: sum(f) / len(f) for kind, f in kinds.items()} for name, kinds in accepted.items()}


def _has_profile(real: RealMotion, kind: str) -> bool:
    profile = real.profile(kind)
    return profile is not None and profile.judges


class Judge:
    """Decides whether motion shows a type, by the recordings.

    With by_recordings every type is judged by the motion profile of its own recordings, without detectors. Then it must
    also reach as far, go as fast, fly and step as they do.
    """

    def __init__(self, real: RealMotion, by_recordings: bool = False) -> None:
        self.real, self.by_recordings = real, by_recordings

    @cached_property
    def detectors(self) -> dict[str, str]:
        """The detector of each type that has one, by its recordings."""
        return {} if self.by_recordings else fitting_detectors(self.real)

    def detector(self, kind: str) -> Detector | None:
        """Return the detector that judges a type; None for a type judged by its motion profile."""
        return DETECTORS[self.detectors[kind]] if kind in self.detectors else None

    def knows(self, kind: str) -> bool:
        """Whether a type has a detector, or a motion profile that can tell it from others."""
        return kind in self.detectors or (kind in self.real.types and _has_profile(self.real, kind))

    def window(self, kind: str) -> float:
        """Length of a type's detection windows in seconds; 0 for a type that is performed once."""
        detector = self.detector(kind)
        return PROFILE_SECONDS if detector is None else detector.window

    def description(self, kind: str) -> str:
        """Return the detector in words."""
        detector = self.detector(kind)
        if detector is not None:
            return detector.description
        profile = self.real.profile(kind)
        return "" if profile is None else profile.description()

    def shows(self, kind: str, body: Body, without: int = -1) -> bool:
        """Whether a window shows a type. Poses of clip number `without` are left out of the comparison."""
        detector = self.detector(kind)
        if detector is not None:
            return detector.shows(body)
        profile = self.real.profile(kind)
        assert profile is not None
        if self.by_recordings and not profile.reaches(body):
            return False
        return profile.shows(body, self.real.pose_distances(body, without).mean(axis=0))

    def share(self, kind: str, body: Body) -> float:
        """Return the share of a motion's windows that show a type."""
        windows = detection_windows(body, self.window(kind))
        return sum(self.shows(kind, window) for window in windows) / len(windows)

    def performs(self, kind: str, body: Body) -> bool:
        """Whether the motion after a command performs the commanded type.

        A type that is performed once must be detected at least once, with by_recordings each type that has a phase. Any
        other type must be detected in a share HOLD of the windows, counted from GRACE seconds after the command. A
        type judged by its motion profile must also move as fast in the mean as calm or busy recordings do, within
        LIVELY.
        """
        if self.window(kind) == 0.0:
            return self.shows(kind, body)
        if performances := self._performances(kind, body):
            return any(self.shows(kind, each) for each in performances)
        after = body.cut(round(GRACE * body.fps), len(body))
        return self._lively(kind, after) and self.share(kind, after) >= HOLD

    def nearest_part(self, kind: str, body: Body) -> Body:
        """Return what is compared with the type's own clips of the motion after a command.

        Of a type that is performed it is the stretch of a clip's length that is most like the clips, of any other all
        but the first GRACE seconds.
        """
        profile = self._profile(kind)
        performances = self._performances(kind, body)
        if profile is None or not performances:
            return body.cut(round(GRACE * body.fps), len(body))

        def unlike(part: Body) -> tuple[float, float]:
            speed = max(part.joint_speed(), 1e-6) / max(profile.joint_speed, 1e-6)
            return profile.excess(part), abs(
                math.log(speed)
            )  # standing before a strike is within its clips, too

        return min(performances, key=unlike)

    def _performances(self, kind: str, body: Body) -> list[Body]:
        """Stretches of the length of a type's clips, if it is judged by them and has a phase.

        Around performances a roll-out stands and runs up, which their clips need not show.
        """
        profile = self._profile(kind)
        if not self.by_recordings or profile is None or not profile.performance:
            return []
        return detection_windows(body, profile.performance)

    def _lively(self, kind: str, body: Body) -> bool:
        if kind in self.detectors:
            return True
        profile = self._profile(kind)
        if profile is None:
            return False
        slowest, fastest = LIVELY[0] * profile.usual[0], LIVELY[1] * profile.usual[1]
        return slowest <= body.joint_speed() <= fastest

    def _profile(self, kind: str) -> MotionProfile | None:
        return self.real.profile(kind) if kind in self.real.types else None

    def speed_ratio(self, kind: str, body: Body) -> float | None:
        """Return the mean joint speed of a motion divided by that of the type's recordings; None without any."""
        profile = self._profile(kind)
        return None if profile is None else body.joint_speed() / profile.joint_speed
