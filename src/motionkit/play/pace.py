"""The schedule of the live server: when to compute and send each frame. It does not wait itself."""

from __future__ import annotations

from collections import deque

SLACK = 0.0005  # s, margin by which a frame is started early
MEMORY = 0.99  # decay per frame of the longest recent computing time
LATE_SHARE = 0.5  # share of a frame's time; a larger delay shifts the schedule
BEHIND_BELOW, STEADY_ABOVE = 0.90, 0.97  # shares of the target rate below and above which `behind` changes


class Pacer:
    """Deadlines at an even rate.

    A frame is computed just before its deadline and sent at the deadline, so that frames are evenly spaced for any
    computing time. A delay of less than half a frame leaves the deadlines unchanged. A longer delay shifts them all:
    time is lost, but frames never come in bursts. Times are in seconds of any monotonic clock.
    """

    def __init__(self, fps: float, now: float) -> None:
        self.interval = 1.0 / fps
        self.due = now + self.interval
        self.behind = False
        self.step_seconds = 0.0  # smoothed computing time
        self._longest = 0.0
        self._sent: deque[float] = deque([now])
        self._since = now  # time of the last change of `behind`

    @property
    def begin(self) -> float:
        """Time at which to start the next frame."""
        return self.due - min(self.interval, self._longest + SLACK)

    @property
    def fps(self) -> float:
        """Frames per second, over the last second."""
        if len(self._sent) < 2:
            return 0.0
        return (len(self._sent) - 1) / max(self._sent[-1] - self._sent[0], 1e-9)

    def made(self, seconds: float) -> None:
        """Record the computing time of a frame."""
        self._longest = max(seconds, MEMORY * self._longest)
        share = 0.1 if self.step_seconds else 1.0
        self.step_seconds += share * (seconds - self.step_seconds)

    def sent(self, now: float) -> bool:
        """Record that a frame was sent; returns whether `behind` changed, which happens at most once a second."""
        late = now - self.due
        self.due = (now if late > LATE_SHARE * self.interval else self.due) + self.interval
        self._sent.append(now)
        while self._sent[0] < now - 1.0 and len(self._sent) > 2:
            self._sent.popleft()
        if now - self._since < 1.0:
            return False
        share = self.fps * self.interval
        changed = share > STEADY_ABOVE if self.behind else share < BEHIND_BELOW
        if changed:
            self.behind, self._since = not self.behind, now
        return changed
