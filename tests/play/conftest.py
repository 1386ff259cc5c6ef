from __future__ import annotations

import asyncio
import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

from motionkit.models.model import MotionModel
from motionkit.motion.skeleton import Skeleton
from motionkit.play.figures import standing_rig
from motionkit.play.limits import Limits
from motionkit.play.server import Addresses, PlayServer, ServerOptions
from motionkit.play.session import Session
from view.conftest import browser, open_page  # noqa: F401

PATIENCE = 60.0  # seconds; the test machine may be slow and busy


@dataclass
class Running:
    """A server in its own thread."""

    server: PlayServer
    addresses: Addresses
    loop: asyncio.AbstractEventLoop

    def ask(self, question: Callable[[], Any]) -> Any:
        """The result of a function called between two frames, in the server's thread."""

        async def answer() -> Any:
            return question()

        return asyncio.run_coroutine_threadsafe(answer(), self.loop).result(PATIENCE)

    def wait_until(self, holds: Callable[[], bool]) -> None:
        """Wait until a condition holds in the server; fails after a while."""

        async def wait() -> None:
            while not holds():
                await asyncio.sleep(0.005)

        asyncio.run_coroutine_threadsafe(asyncio.wait_for(wait(), PATIENCE), self.loop).result(2 * PATIENCE)


@contextmanager
def running(server: PlayServer) -> Iterator[Running]:
    ready, faults = threading.Event(), []
    found: dict[str, Any] = {}

    def told(addresses: Addresses) -> None:
        found.update(addresses=addresses, loop=asyncio.get_running_loop(), task=asyncio.current_task())
        ready.set()

    def run() -> None:
        try:
            asyncio.run(server.run(told))
        except asyncio.CancelledError:
            pass
        except BaseException as fault:
            faults.append(fault)
        ready.set()

    thread = threading.Thread(target=run)
    thread.start()
    assert ready.wait(PATIENCE)
    if faults:
        raise faults[0]
    yield Running(server, found["addresses"], found["loop"])
    found["loop"].call_soon_threadsafe(found["task"].cancel)
    thread.join(PATIENCE)
    assert not thread.is_alive() and not faults, f"the server did not end well: {faults}"


@pytest.fixture(scope="session", autouse=True)
def one_figure_for_all() -> Iterator[None]:
    """Make the figure of the same body once: it takes every server a part of a second."""
    made: dict[bytes, dict[str, Any]] = {}

    def make(body: Skeleton, hero: dict[str, Any] | None = None) -> dict[str, Any]:
        if hero is not None:
            return standing_rig(body, hero)
        key = body.offsets.tobytes()
        if key not in made:
            made[key] = standing_rig(body)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("motionkit.play.figures.standing_rig", make)
        yield


@pytest.fixture
def serve(tiny_model: MotionModel) -> Iterator[Callable[..., Running]]:
    """A function that starts a server on free ports: serve(tcp=0, limits=Limits(...)); stopped after the test.

    model and body are those of the session.
    """
    with ExitStack() as stack:

        def start(
            limits: Limits | None = None,
            model: MotionModel = tiny_model,
            body: str = "default",
            **options: Any,
        ) -> Running:
            server = PlayServer(Session(model, body, limits=limits), ServerOptions(port=0, **options))
            return stack.enter_context(running(server))

        yield start


@dataclass
class Web:
    """A small client written from docs/live.md alone."""

    socket: ClientConnection
    hello: dict[str, Any] = field(default_factory=dict)

    def ask(self, **request: Any) -> None:
        self.socket.send(json.dumps(request))

    def read(self) -> dict[str, Any]:
        """The next message: an event, or a frame as a dictionary with event "frame"."""
        message = self.socket.recv(timeout=PATIENCE)
        return json.loads(message) if isinstance(message, str) else read_frame(message)

    def until(self, event: str, holds: Callable[[dict], bool] = lambda _: True) -> dict[str, Any]:
        """The next event of a kind that meets a condition; earlier messages are skipped."""
        while True:
            found = self.read()
            if found["event"] == event and holds(found):
                return found


def read_frame(data: bytes) -> dict[str, Any]:
    """Parse a binary frame as docs/live.md specifies it."""
    kind, version, count, number, time, step, fps = struct.unpack_from("<BBHIdff", data)
    assert (kind, version, len(data)) == (1, 1, 24 + 396 * count)
    characters = {}
    for n in range(count):
        at = 24 + 396 * n
        id_, seq, type_, flags, contacts, heading = struct.unpack_from("<IIHBBf", data, at)
        characters[id_] = {
            "seq": seq,
            "type": type_,
            "flags": flags,
            "contacts": contacts,
            "heading": heading,
            "root": struct.unpack_from("<3f", data, at + 16),
            "rotations": struct.unpack_from("<92f", data, at + 28),
        }
    return {
        "event": "frame",
        "frame": number,
        "time": time,
        "step_ms": step,
        "fps": fps,
        "characters": characters,
    }


@pytest.fixture
def web() -> Iterator[Callable[..., Web]]:
    """A function that connects a WebSocket client to a server and takes its hello: web(server)."""
    with ExitStack() as stack:

        def start(server: Running, **options: Any) -> Web:
            options = {"open_timeout": PATIENCE, "close_timeout": 2, "compression": None, **options}
            client = Web(stack.enter_context(connect(server.addresses.socket, **options)))
            client.hello = client.read()
            return client

        yield start


@dataclass
class Lines:
    """A client of the TCP port, likewise."""

    socket: socket.socket
    hello: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.file = self.socket.makefile("r", encoding="utf-8")

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def ask(self, **request: Any) -> None:
        self.send(json.dumps(request).encode() + b"\n")

    def read(self) -> dict[str, Any]:
        line = self.file.readline()
        if not line:
            raise EOFError
        return json.loads(line)

    def until(self, event: str, holds: Callable[[dict], bool] = lambda _: True) -> dict[str, Any]:
        while True:
            found = self.read()
            if found["event"] == event and holds(found):
                return found


@pytest.fixture
def tcp() -> Iterator[Callable[[Running], Lines]]:
    """A function that connects a TCP client and takes its hello: tcp(server)."""
    with ExitStack() as stack:

        def start(server: Running) -> Lines:
            assert server.addresses.tcp is not None
            connection = stack.enter_context(socket.create_connection(server.addresses.tcp, PATIENCE))
            client = Lines(connection)
            client.hello = client.read()
            return client

        yield start
