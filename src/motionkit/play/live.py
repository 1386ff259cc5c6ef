"""The running session: clients join, send requests and leave; every frame is sent to all of them on time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from motionkit.errors import ControlError, MotionkitError
from motionkit.motion.motion import Motion
from motionkit.play.client import COSTS, Client
from motionkit.play.frames import CharacterState, WorldFrame, frame_bytes, frame_text
from motionkit.play.limits import Limits
from motionkit.play.on_rig import LiveRig
from motionkit.play.pace import Pacer
from motionkit.play.recording import Recordings, file_bytes, holds
from motionkit.play.requests import ProtocolError, Request, parse_request
from motionkit.play.session import Recorded, Session
from motionkit.rig.rig import Rig

CHANGES_CHARACTERS = frozenset({"add", "remove", "body", "noise", "record"})
LOOK_SECONDS = 0.1  # s between checks that a waiting client is still connected
REST = 3.0  # after slow work such as a reset, the next must wait this multiple of its duration


class SlowWork:
    """Turns at work that takes as long as several frames, such as a reset: one at a time, and a share of all time."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock, self._lock = clock, asyncio.Lock()
        self._rested = 0.0  # clock time at which slow work may begin again

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Wait for a turn: a client that asks for much has to wait, and frames keep going out to everyone."""
        async with self._lock:
            await asyncio.sleep(max(0.0, self._rested - self.clock()))
            began = self.clock()
            try:
                yield
            finally:
                now = self.clock()
                self._rested = now + REST * (now - began)


class RecordingWriter:
    """Writes recordings as files in a thread, one at a time, while frames go on.

    Attributes:
        files: what was written.
        format: of recordings whose request names none, one of FORMATS.
    """

    def __init__(self, limits: Limits, rig: tuple[Rig | None, Motion | None], format: str) -> None:
        self.files, self.format = Recordings(limits.recordings, limits.recording_bytes), format
        self._most, self._rig = limits.recordings, rig
        self._one = asyncio.Semaphore(1)
        self._tasks: set[asyncio.Task] = set()

    @property
    def full(self) -> bool:
        """Whether as many recordings are being written as may be kept."""
        return len(self._tasks) >= self._most

    def check(self, format: str | None) -> None:
        """Raise ControlError for a format that recordings on this rig cannot have; None is the usual one."""
        if not holds(format, self._rig[0]):
            raise ControlError(
                "the format vrm takes an avatar; motionkit play has none without --rig avatar.vrm"
            )

    def write(self, recorded: Recorded, tell: Callable[[dict[str, Any]], None]) -> None:
        """Begin to write a recording; tell is called with the event of its end."""
        task = asyncio.get_running_loop().create_task(self._write(recorded, tell))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _write(self, recorded: Recorded, tell: Callable[[dict[str, Any]], None]) -> None:
        format = recorded.format or self.format
        try:
            async with self._one:
                data = await asyncio.to_thread(file_bytes, recorded.motion, *self._rig, format)
        except MotionkitError as error:
            tell(error_event(error, closing=False))
            return
        tell(
            {
                "event": "recorded",
                "character": recorded.character,
                "url": f"/recordings/{self.files.add(data, format)}",
                "format": format,
                "frames": len(recorded.motion),
                "seconds": recorded.motion.seconds,
            }
        )


class Live:
    """A session with its clients and its clock; it runs in one event loop."""

    def __init__(
        self,
        session: Session,
        clock: Callable[[], float] = time.perf_counter,
        rig: tuple[Rig | None, Motion | None] = (None, None),
        recording_format: str = "bvh",
    ) -> None:
        """Add clients and a clock to a session.

        rig is that of recordings and JSON frames, with a clip that animates its other joints (file_bytes).
        recording_format, one of FORMATS, is for requests that name none.
        """
        self.session, self.clock = session, clock
        self._live_rig = None if rig[0] is None else LiveRig(rig[0])
        self.clients: dict[int, Client] = {}
        self.writer = RecordingWriter(session.limits, rig, recording_format)
        self.slow_work = SlowWork(clock)
        self.pacer = Pacer(session.model.fps, clock())
        self.watchers: list[Callable[[WorldFrame], None]] = []  # called with every frame
        self._last_client = 0
        self._joining = 0  # clients waiting for their character
        self._changed = False  # whether characters changed since clients were last told

    # ---- clients ----

    async def join(self, as_json: bool, closed: Callable[[], bool] = lambda: False) -> Client | None:
        """Add a client and queue its hello; None if the server is full and no client is idle, or the client has gone.

        closed: whether the client has disconnected; it then loses its turn.
        """
        if len(self.clients) + self._joining >= self.session.limits.clients and not self._let_one_go():
            return None
        self._joining += 1
        turn = asyncio.ensure_future(self._join_in_turn(as_json))
        try:
            while not turn.done() and not closed():
                await asyncio.wait([turn], timeout=LOOK_SECONDS)
        finally:
            self._joining -= 1
            if not turn.done():
                turn.cancel()
        return turn.result() if turn.done() else None

    async def _join_in_turn(self, as_json: bool) -> Client:
        async with self.slow_work.turn():
            return self._welcome(as_json)

    def _let_one_go(self) -> bool:
        """Disconnect the client that was silent longest, if it counts as idle."""
        quiet = min(self.clients.values(), key=lambda client: client.heard, default=None)
        if quiet is None or self.clock() - quiet.heard < self.session.limits.idle_seconds:
            return False
        error = ProtocolError("another client needs the place; send a ping now and then to keep yours")
        quiet.dismiss(error_event(error, closing=True))
        self.leave(quiet)
        return True

    def _welcome(self, as_json: bool) -> Client:
        self._last_client += 1
        # A frame that is computed but not yet sent lacks the new character.
        first_frame = self.session.number + 1
        client = Client(self._last_client, as_json, self.session.limits, self.clock(), first_frame)
        character = self.session.join(client.number)
        self.clients[client.number] = client
        rig = {} if self._live_rig is None else {"rig": self._live_rig.as_dict()}
        recordings = {"recording_format": self.writer.format}
        client.tell(self.session.hello(client.number, character) | recordings | rig)
        if self.pacer.behind:
            client.tell(self.pace_event())
        self._changed = True
        return client

    def leave(self, client: Client) -> None:
        """Remove a client that has disconnected."""
        if self.clients.pop(client.number, None) is not None:
            self.session.leave(client.number)
            self._changed = True

    async def take(self, client: Client, message: str | bytes) -> None:
        """Handle a message from a client; messages of disconnected clients are ignored.

        Raises:
            ProtocolError: the message is invalid; the caller must close the client.
        """
        if client.number not in self.clients:
            return  # disconnected, but its connection is not closed yet
        client.charge(len(message), self.clock())
        if isinstance(message, bytes):
            raise ProtocolError("expected text, found a binary message")
        request = parse_request(message)
        client.charge_work(request, self.clock())
        if request.do == "ping":
            stamp = request.fields["stamp"]
            client.tell({"event": "pong", "stamp": stamp, "time": self.session.time})
        elif request.do in COSTS:
            async with self.slow_work.turn():
                if client.number in self.clients:
                    self._obey(client, request)
        else:
            self._obey(client, request)

    def _obey(self, client: Client, request: Request) -> None:
        try:
            if request.fields.get("on") and self.writer.full:
                raise ControlError("earlier recordings are still being written")
            self.writer.check(request.fields.get("format"))
            recorded = self.session.obey(client.number, request)
        except ControlError as error:
            client.tell(error_event(error, closing=False))
            return
        if recorded is not None:
            self._keep(recorded)
        if request.do in CHANGES_CHARACTERS:
            self._changed = True

    def _tell_all(self, event: dict[str, Any]) -> None:
        for client in self.clients.values():
            client.tell(event)

    # ---- recordings ----

    def _keep(self, recorded: Recorded) -> None:
        def tell(event: dict[str, Any]) -> None:
            client = self.clients.get(recorded.owner or 0)
            if client is not None:
                client.tell(event)

        self.writer.write(recorded, tell)

    # ---- the clock ----

    async def run(self) -> None:
        """Compute and send frames until cancelled."""
        self.pacer = Pacer(self.session.model.fps, self.clock())
        while True:
            await self._until(self.pacer.begin)
            began = self.clock()
            frame = self.session.step(self.pacer.fps)
            self.pacer.made(self.clock() - began)
            await self._until(self.pacer.due)
            self._send(frame)

    async def _until(self, then: float) -> None:
        # Sleep even if late, so that requests are handled between any two frames.
        await asyncio.sleep(max(0.0, then - self.clock()))

    def _send(self, frame: WorldFrame) -> None:
        # At most once per frame: otherwise a client with constant changes would fill every queue.
        if self._changed:
            self._changed = False
            self._tell_all({"event": "characters", "characters": self.session.character_list()})
        self._show(frame)
        for watcher in self.watchers:
            watcher(frame)
        for number in frame.arrived:
            character = self.session.characters.get(number)  # may be gone since the frame was computed
            owner = None if character is None else self.clients.get(character.owner or 0)
            if owner is not None:
                owner.tell({"event": "arrived", "character": number})
        ended = self.session.full()
        for recorded in ended:
            self._keep(recorded)
            self._changed = True
        if self.pacer.sent(self.clock()):
            self._tell_all(self.pace_event())

    def _show(self, frame: WorldFrame) -> None:
        forms: dict[bool, str | bytes] = {}  # each encoding, made once and only if a client uses it
        for client in self.clients.values():
            if frame.number < client.first_frame:
                continue
            if client.as_json not in forms:
                as_json = client.as_json
                forms[as_json] = (
                    frame_text(frame, self.session.model.type_names, self._on_rig)
                    if as_json
                    else frame_bytes(frame)
                )
            client.show(forms[client.as_json])

    def _on_rig(self, one: CharacterState) -> dict[str, Any]:
        """Additional JSON fields of a character that has the rig's body, else none."""
        character = self.session.characters.get(one.id)
        if self._live_rig is None or character is None or character.body != self._live_rig.rig.name:
            return {}
        return {"rig": self._live_rig.pose(one)}

    def pace_event(self) -> dict[str, Any]:
        """The event for a change of pace: the machine falls behind or catches up."""
        return {
            "event": "pace",
            "behind": self.pacer.behind,
            "fps": round(self.pacer.fps, 2),
            "step_ms": round(1000.0 * self.pacer.step_seconds, 3),
        }


def error_event(error: MotionkitError | ProtocolError, closing: bool) -> dict[str, Any]:
    """The event for a client whose request is invalid."""
    return {"event": "error", "message": str(error), "closing": closing}
