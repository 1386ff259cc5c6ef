"""Judges whether motion shows a type: by the type's detector, else by the motion profile of its recordings."""

from __future__ import annotations

from motionkit.evaluation.body import Body
from motionkit.evaluation.detectors import DETECTORS, HOLD, detection_windows
from motionkit.evaluation.real import PROFILE_SECONDS, RealMotion

GRACE = 1.0  # seconds after a command that count as the transition
# Limits of mean joint speed relative to the recordings, for types judged by their motion profile.
LIVELY = (0.7, 1.4)


class Judge:
    """Decides whether motion shows a type: by the type's detector, else by the motion profile of its recordings."""

    def __init__(self, real: RealMotion) -> None:
        self.real = real

    def knows(self, kind: str) -> bool:
        """Whether a type has a detector, or a motion profile that can tell it from others."""
        profile = self.real.profile(kind) if kind in self.real.types else None
        return kind in DETECTORS or (profile is not None and profile.judges)

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
        a share HOLD of the windows, counted from GRACE seconds after the command. A type judged by its motion
        profile must also move as fast as its recordings do in the mean, within LIVELY.
        """
        if self.window(kind) == 0.0:
            return self.shows(kind, body)
        after = body.cut(round(GRACE * body.fps), len(body))
        return self._lively(kind, after) and self.share(kind, after) >= HOLD

    def _lively(self, kind: str, body: Body) -> bool:
        if kind in DETECTORS:
            return True
        ratio = self.speed_ratio(kind, body)
        return ratio is not None and LIVELY[0] <= ratio <= LIVELY[1]

    def speed_ratio(self, kind: str, body: Body) -> float | None:
        """Return the mean joint speed of a motion divided by that of the type's recordings; None without any."""
        profile = self.real.profile(kind) if kind in self.real.types else None
        return None if profile is None else body.joint_speed() / profile.joint_speed
