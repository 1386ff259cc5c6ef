"""When to make each frame and when to send it: the clock of the live server, without any waiting in it."""

from __future__ import annotations

from collections import deque

SLACK = 0.0005  # s by which a step begins earlier than it needs to
MEMORY = 0.99  # a frame later this much of the longest recent step is still reckoned with
LATE_SHARE = 0.5  # of a frame's time; who is later than that shifts the schedule instead of hurrying
BEHIND_BELOW, STEADY_ABOVE = 0.90, 0.97  # of the wanted rate


class Pacer:
    """Deadlines at an even rate.

    A frame is made just before its deadline and sent at it, so that frames leave evenly whatever the
    step takes. One that is late by less than half a frame leaves the deadlines where they are; a later
    one shifts them all: time is lost, but frames never come in a burst. Times are in seconds on any
    clock that does not run backwards.
    """

    def __init__(self, fps: float, now: float) -> None:
        self.interval = 1.0 / fps
        self.due = now + self.interval
        self.behind = False
        self.step_seconds = 0.0  # smoothed
        self._longest = 0.0
        self._sent: deque[float] = deque([now])
        self._since = now  # of the last change of behind

    @property
    def begin(self) -> float:
        """When to begin with the next frame."""
        return self.due - min(self.interval, self._longest + SLACK)

    @property
    def fps(self) -> float:
        """Frames sent in the last second, per second."""
        if len(self._sent) < 2:
            return 0.0
        return (len(self._sent) - 1) / max(self._sent[-1] - self._sent[0], 1e-9)

    def made(self, seconds: float) -> None:
        """A step took so long."""
        self._longest = max(seconds, MEMORY * self._longest)
        share = 0.1 if self.step_seconds else 1.0
        self.step_seconds += share * (seconds - self.step_seconds)

    def sent(self, now: float) -> bool:
        """A frame was sent; answers whether behind has changed, which it does once a second at most."""
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
