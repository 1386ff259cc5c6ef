"""A connected client: its send queue and its rate limit."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any

from motionkit.play.limits import Limits, RateLimit
from motionkit.play.requests import ProtocolError, Request

STALL_SECONDS = 10.0  # a client that reads nothing for this long is disconnected
MOST_EVENTS = 256  # most events in the queue
BYTES_PER_UNIT = 2048  # message cost grows by one per this many bytes
# Extra cost of expensive requests, in messages.
COSTS = {"add": 20, "body": 20, "reset": 20, "path": 5, "record": 10}


class TooManyMessages(ProtocolError):
    """A client exceeds limits.messages_per_second."""


class Client:
    """The send queue of a client: all events in order, but only the newest frame."""

    def __init__(self, number: int, as_json: bool, limits: Limits, now: float, first_frame: int = 0) -> None:
        self.number, self.as_json, self.first_frame = number, as_json, first_frame
        self._rate = RateLimit(limits.messages_per_second, now)
        self._events: deque[str] = deque()
        self._frame: str | bytes | None = None
        self._wake = asyncio.Event()
        self._ending = self._closed = False
        self.stalled = self.let_go = False
        self.heard = now  # time of the last message

    def charge(self, size: int, now: float) -> None:
        """Charge a message of this many bytes; raises TooManyMessages."""
        self.heard = now
        self._charge(1.0 + size / BYTES_PER_UNIT, now)

    def charge_work(self, request: Request, now: float) -> None:
        """Charge the extra cost of a request; raises TooManyMessages."""
        self._charge(COSTS.get(request.do, 0), now)

    def _charge(self, cost: float, now: float) -> None:
        if not self._rate.allows(cost, now):
            raise TooManyMessages(f"too many messages; send at most {self._rate.per_second:g} a second")

    def tell(self, event: dict[str, Any]) -> None:
        """Queue an event."""
        if len(self._events) >= MOST_EVENTS:
            self.stalled = True
        else:
            self._events.append(json.dumps(event, allow_nan=False, separators=(",", ":")))
        self._wake.set()

    def show(self, frame: str | bytes) -> None:
        """Queue a frame; it replaces an unsent one."""
        self._frame = frame
        self._wake.set()

    def end(self, event: dict[str, Any]) -> None:
        """Queue the last event; pump returns after it."""
        self.tell(event)
        self._ending = True

    def dismiss(self, event: dict[str, Any]) -> None:
        """Queue the last event, after which the connection will be closed."""
        self.let_go = True
        self.end(event)

    def leave(self) -> None:
        """Stop sending; pump returns."""
        self._closed = True
        self._wake.set()

    async def pump(self, send: Callable[[str | bytes], Awaitable[None]]) -> None:
        """Send queued messages until the last event, until the client stalls, or until leave is called.

        Cancelling the task does not suffice: before Python 3.12, wait_for can swallow a cancellation that arrives just
        as the send completes.
        """
        while not self.stalled and not self._closed:
            await self._wake.wait()
            self._wake.clear()
            try:
                while self._events and not self._closed:
                    await asyncio.wait_for(send(self._events.popleft()), STALL_SECONDS)
                if self._ending:
                    return
                frame, self._frame = self._frame, None
                if frame is not None and not self._closed:
                    await asyncio.wait_for(send(frame), STALL_SECONDS)
            except (asyncio.TimeoutError, OSError):
                self.stalled = True
