"""One connected client: what is still to be sent to it, and how much it may ask for."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any

from motionkit.play.limits import Limits, RateLimit
from motionkit.play.requests import ProtocolError, Request

STALL_SECONDS = 10.0  # a client that takes in nothing for so long is closed
MOST_EVENTS = 256  # that wait to be sent
BYTES_PER_UNIT = 2048  # a longer message counts as several
# Requests that take more work than most, in messages.
COSTS = {"add": 20, "body": 20, "reset": 20, "path": 5, "record": 10}


class TooManyMessages(ProtocolError):
    """A client that asks for more than limits.messages_per_second."""


class Client:
    """The outbox of a client: all events in their order, but of the frames only the newest."""

    def __init__(self, number: int, as_json: bool, limits: Limits, now: float) -> None:
        self.number, self.as_json = number, as_json
        self._rate = RateLimit(limits.messages_per_second, now)
        self._events: deque[str] = deque()
        self._frame: str | bytes | None = None
        self._wake = asyncio.Event()
        self._ending = self._gone = False
        self.stalled = self.let_go = False
        self.heard = now  # when it last said something

    def charge(self, size: int, now: float) -> None:
        """Count a message of so many bytes; raises TooManyMessages."""
        self.heard = now
        self._charge(1.0 + size / BYTES_PER_UNIT, now)

    def charge_work(self, request: Request, now: float) -> None:
        """Count what a request costs beyond that; raises TooManyMessages."""
        self._charge(COSTS.get(request.do, 0), now)

    def _charge(self, cost: float, now: float) -> None:
        if not self._rate.allows(cost, now):
            raise TooManyMessages(f"too many messages, at most {self._rate.per_second:g} a second are taken")

    def tell(self, event: dict[str, Any]) -> None:
        """Send an event as soon as may be."""
        if len(self._events) >= MOST_EVENTS:
            self.stalled = True
        else:
            self._events.append(json.dumps(event, allow_nan=False, separators=(",", ":")))
        self._wake.set()

    def show(self, frame: str | bytes) -> None:
        """Send a frame, in place of one that has not gone out yet."""
        self._frame = frame
        self._wake.set()

    def end(self, event: dict[str, Any]) -> None:
        """Send a last event, after which pump returns."""
        self.tell(event)
        self._ending = True

    def dismiss(self, event: dict[str, Any]) -> None:
        """Send a last event, after which the connection is to be closed."""
        self.let_go = True
        self.end(event)

    def leave(self) -> None:
        """Send nothing any more, and let pump return."""
        self._gone = True
        self._wake.set()

    async def pump(self, send: Callable[[str | bytes], Awaitable[None]]) -> None:
        """Send what is to be sent; returns after the last event, when the client takes nothing in, or after leave.

        Cancelling alone would not end it for sure: before Python 3.12, wait_for answers as if nothing had
        happened when what it waits for is done at the same moment.
        """
        while not self.stalled and not self._gone:
            await self._wake.wait()
            self._wake.clear()
            try:
                while self._events and not self._gone:
                    await asyncio.wait_for(send(self._events.popleft()), STALL_SECONDS)
                if self._ending:
                    return
                frame, self._frame = self._frame, None
                if frame is not None and not self._gone:
                    await asyncio.wait_for(send(frame), STALL_SECONDS)
            except (asyncio.TimeoutError, OSError):
                self.stalled = True
