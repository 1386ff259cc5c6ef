"""How much the live server lets anyone ask for; docs/live.md tells users."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Limits:
    """What hello tells every client, and the server holds to.

    Attributes:
        clients: connected at the same time, by WebSocket and TCP together.
        idle_seconds: after which a client that says nothing makes room for another, if all places are taken.
        characters: in the world.
        message_bytes: of one request.
        messages_per_second: in the long run; as many may come at once.
        path_points: of a drawn path.
        path_cm: its length.
        record_seconds: after which a recording ends by itself.
        recordings: kept for download, the newest.
        recording_bytes: of all of them together.
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

    def told(self) -> dict[str, float]:
        """The limits a client has to know of."""
        return asdict(self)


class RateLimit:
    """A bucket that fills by messages_per_second and may hold a second's worth."""

    def __init__(self, per_second: float, now: float) -> None:
        self.per_second, self.left, self.then = per_second, per_second, now

    def allows(self, cost: float, now: float) -> bool:
        """Whether a message of a cost may come now; takes it out of the bucket if so."""
        self.left = min(self.per_second, self.left + (now - self.then) * self.per_second)
        self.then = now
        if cost > self.left:
            return False
        self.left -= cost
        return True
