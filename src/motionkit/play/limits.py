"""Limits of the live server (docs/live.md)."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Limits:
    """Limits that the server enforces and sends in hello.

    Attributes:
        clients: most clients at a time, WebSocket and TCP combined.
        idle_seconds: after this long without a message, a client may be disconnected to make room for another.
        characters: most characters in the session.
        message_bytes: size of the largest request.
        messages_per_second: sustained rate per client; bursts may use one second's worth.
        path_points: most points of a drawn path.
        path_cm: greatest length of a path.
        record_seconds: length at which a recording ends by itself.
        recordings: number of recordings kept for download, the newest ones.
        recording_bytes: total size of the kept recordings.
    """

    clients: int = 16
    idle_seconds: float = 60.0
    characters: int = 8
    message_bytes: int = 65536
    messages_per_second: int = 200
    path_points: int = 2000
    path_cm: float = 50_000.0
    record_seconds: float = 300.0
    recordings: int = 20
    recording_bytes: int = 100_000_000

    def as_dict(self) -> dict[str, float]:
        """The limits as sent in hello."""
        return asdict(self)


class RateLimit:
    """A token bucket: fills at a rate per second, holds one second's worth."""

    def __init__(self, per_second: float, now: float) -> None:
        self.per_second, self.left, self.then = per_second, per_second, now

    def allows(self, cost: float, now: float) -> bool:
        """Whether a message of this cost is allowed now; if so, takes its cost from the bucket."""
        self.left = min(self.per_second, self.left + (now - self.then) * self.per_second)
        self.then = now
        if cost > self.left:
            return False
        self.left -= cost
        return True
