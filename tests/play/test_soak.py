"""Long use: clients join, send valid and invalid requests and vanish, while memory must not grow.

MOTIONKIT_SOAK_SECONDS=600 python -m pytest tests/play/test_soak.py -m slow -s
"""

from __future__ import annotations

import asyncio
import faulthandler
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

VISITORS = 7  # at a time, beside one that stays
WARM_UP = 0.3  # share of the time in which memory may grow
PATIENCE = 60.0

STRANGE = [None, True, -1, 0.5, 10**400, 1e308, "", "x" * 300, "\0", [], [1e9], [[]], {}, {"do": "wish"}]
GARBAGE: list[str | bytes] = [
    "", "{", "null", "[]", "NaN", "[" * 60_000, '{"do":' * 9_000, '{"do": "wish", "velocity": [NaN, 0]}', "\ufffd" * 99,
    b"", b"\x01", b"\xff" * 4000, "9" * 60_000, "x" * 70_000,
]  # fmt: skip


def valid_request(chance: random.Random, hello: dict[str, Any]) -> dict[str, Any]:
    """A request that docs/live.md allows; now and then for an unknown character or type."""
    names = [kind["name"] for kind in hello["types"]]
    kind = chance.choice([*names, None, "no such type"])
    do = chance.choice(["wish"] * 12 + ["perform", "path", "ping"] * 2 + ["add", "remove", "body", "reset"])
    do = chance.choice([do] * 9 + ["noise", "record"])
    request: dict[str, Any] = {"do": do}
    if do not in ("add", "ping") and chance.random() < 0.1:
        request["character"] = chance.randrange(50)
    if do == "wish":
        velocity = chance.choice([None, [chance.uniform(-400, 400), chance.uniform(-400, 400)], [0, 0]])
        request |= {
            "velocity": velocity,
            "type": kind,
            "facing": chance.choice([None, chance.uniform(-9, 9)]),
        }
    elif do == "perform":
        request |= {"type": chance.choice(names), "seconds": chance.uniform(0.5, 3)}
    elif do == "path":
        count = chance.choice([2, 5, 500])
        request["points"] = [[chance.gauss(0, 200), chance.gauss(0, 200)] for _ in range(count)]
    elif do == "body" or (do == "add" and chance.random() < 0.5):
        request["body"] = chance.choice([body["name"] for body in hello["bodies"]])
    elif do == "noise":
        request |= {
            "kind": chance.choice(["mean", "sample", "correlated"]),
            "temperature": chance.uniform(0, 2),
        }
    elif do == "record":
        request["on"] = chance.random() < 0.5
    elif do == "ping":
        request["stamp"] = chance.random()
    return request


def malformed_request(chance: random.Random, hello: dict[str, Any]) -> str | bytes:
    """Text that is mostly not a request."""
    if chance.random() < 0.5:
        return chance.choice(GARBAGE)
    request = valid_request(chance, hello)
    key = chance.choice([*request, "unknown"])
    request[key] = chance.choice(STRANGE)
    return json.dumps(request)


class Crowd:
    """All clients of one soak test, and what they received."""

    def __init__(self, told: dict[str, Any], seed: int) -> None:
        self.told, self.chance = told, random.Random(seed)
        self.seen: Counter[str] = Counter()
        self.newest: list[dict[str, Any]] = []  # the characters last told to the client that stays
        self.over = False  # cancelling is not enough: before Python 3.12, wait_for may swallow it

    async def stay(self) -> None:
        """A client that watches throughout: frames must keep coming, whole and in order.

        Without pings of its own, whose 20 s a busy machine may exceed: frames say that the server lives.
        """
        async with connect(
            self.told["socket"], compression=None, open_timeout=PATIENCE, ping_interval=None
        ) as socket:
            hello = json.loads(await socket.recv())
            number = 0
            while True:
                message = await asyncio.wait_for(socket.recv(), PATIENCE)
                if isinstance(message, str):
                    event = json.loads(message)
                    assert event["event"] in ("characters", "pace"), event
                    self.newest = event.get("characters", self.newest)
                    continue
                count, new = int.from_bytes(message[2:4], "little"), int.from_bytes(message[4:8], "little")
                assert len(message) == 24 + 396 * count and 0 < count <= hello["limits"]["characters"]
                assert new > number
                number = new
                self.seen["frames"] += 1

    async def alone(self) -> None:
        """Wait until the client that stays is told only of its own character."""
        while len(self.newest) != 1:
            await asyncio.sleep(0.05)

    async def visit(self) -> None:
        """Run one client after another."""
        while not self.over:
            await asyncio.sleep(self.chance.uniform(0.0, 0.2))
            with suppress(ConnectionClosed, OSError, EOFError, asyncio.TimeoutError):
                await self.chance.choice([self._web, self._web, self._tcp, self._stranger])()

    async def _web(self) -> None:
        async with connect(
            self.told["socket"], compression=None, open_timeout=PATIENCE, close_timeout=2
        ) as socket:
            hello = json.loads(await socket.recv())
            self.seen["web clients"] += 1
            reading = asyncio.create_task(self._read(socket))
            try:
                for _ in range(self.chance.randrange(150)):
                    await socket.send(json.dumps(valid_request(self.chance, hello)))
                    await asyncio.sleep(self.chance.uniform(0.0, 0.08))
                match self.chance.randrange(5):
                    case 0:
                        await socket.close()
                    case 1:
                        await socket.send(malformed_request(self.chance, hello))
                        await asyncio.sleep(0.3)
                    case 2:
                        socket.transport.write(self.chance.randbytes(200))
                        await asyncio.sleep(0.3)
                    case 3:
                        socket.transport.pause_reading()
                        await asyncio.sleep(self.chance.uniform(0.5, 2.0))
            finally:
                reading.cancel()
                socket.transport.abort()

    async def _read(self, socket: ClientConnection) -> None:
        with suppress(ConnectionClosed):
            async for message in socket:
                if isinstance(message, str):
                    event = json.loads(message)
                    self.seen[event["event"]] += 1
                    if event["event"] == "recorded":
                        await self._get(event["url"])

    async def _tcp(self) -> None:
        reader, writer = await asyncio.open_connection(*self.told["tcp"], limit=1 << 20)
        try:
            hello = json.loads(await reader.readline())
            self.seen["TCP clients"] += 1
            for _ in range(self.chance.randrange(100)):
                writer.write(json.dumps(valid_request(self.chance, hello)).encode() + b"\n")
                line = await reader.readline()
                if not line:
                    return
                self.seen[json.loads(line)["event"] + " by TCP"] += 1
            if self.chance.random() < 0.5:
                said = malformed_request(self.chance, hello)
                writer.write((said if isinstance(said, bytes) else said.encode()) + b"\n")
                await asyncio.sleep(0.2)
        finally:
            writer.transport.abort()

    async def _stranger(self) -> None:
        """A client that speaks another protocol, or requests missing pages."""
        self.seen["strangers"] += 1
        if self.chance.random() < 0.5:
            await self._get(
                self.chance.choice(["/", "/../x", "/recordings/a.bvh", "/live", "*", "/" + "a" * 9000])
            )
            return
        port = int(self.told["url"].rstrip("/").rpartition(":")[2])
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(self.chance.choice([b"", b"\0" * 300, b"GET / HTTP/1.1\r\n", self.chance.randbytes(99)]))
        await asyncio.sleep(self.chance.uniform(0.0, 0.2))
        writer.transport.abort()

    async def _get(self, path: str) -> None:
        port = int(self.told["url"].rstrip("/").rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        answer = await asyncio.wait_for(reader.read(), PATIENCE)
        assert answer.startswith(b"HTTP/1.1 ") or not answer
        writer.close()


def resident_mb(process: int) -> float:
    """Memory of a process, MB."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024


async def soak(told: dict[str, Any], process: int, seconds: float) -> tuple[Crowd, list[float]]:
    """Run the crowd for at least this long and wait until it has left; returns memory over time, MB."""
    crowd = Crowd(told, seed=1)
    stays = asyncio.create_task(crowd.stay())
    visitors = [asyncio.create_task(crowd.visit()) for _ in range(VISITORS)]
    memory, ends = [], time.monotonic() + seconds
    # A busy machine gets longer, so that enough happens.
    while time.monotonic() < ends or (
        min(crowd.seen["frames"], crowd.seen["web clients"]) < 3 and time.monotonic() < ends + 2 * PATIENCE
    ):
        await asyncio.sleep(min(1.0, seconds / 40))
        memory.append(resident_mb(process))
        for task in (stays, *visitors):
            if task.done():
                task.result()
    crowd.over = True
    for task in visitors:
        task.cancel()
    _, late = await asyncio.wait(visitors, timeout=PATIENCE)
    assert not late
    await asyncio.wait_for(crowd.alone(), PATIENCE)
    stays.cancel()
    await asyncio.wait([stays], timeout=PATIENCE)
    return crowd, memory


@pytest.fixture(scope="module")
def server(request: pytest.FixtureRequest) -> Iterator[tuple[dict[str, Any], int]]:
    """`motionkit play` with a model: its addresses and process id; its log must stay empty."""
    words = [sys.executable, "-m", "motionkit", "play", "--port", "0", "--tcp", "0", "--no-open", "--json"]
    if request.param == "tiny":
        words += ["--model", str(request.getfixturevalue("tiny_model_file"))]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield json.loads(process.stdout.readline()), process.pid
        finally:
            process.terminate()
            try:
                _, said = process.communicate(timeout=PATIENCE)
            finally:
                process.kill()  # a process that hangs must not block the other tests
    assert said == "stopped\n" and process.returncode == 0


def run(told: dict[str, Any], process: int, seconds: float, most_growth: float) -> None:
    crowd, memory = asyncio.run(soak(told, process, seconds))
    settled = memory[int(WARM_UP * len(memory)) :]
    third = len(settled) // 3
    begun, ended = statistics.median(settled[:third]), statistics.median(settled[-third:])
    print(f"{seconds:g} s: {begun:.1f} MB after warm-up, {ended:.1f} MB at the end; {dict(crowd.seen)}")
    assert ended - begun < most_growth, [round(m, 1) for m in memory[:: max(1, len(memory) // 30)]]


linux = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")


@linux
@pytest.mark.parametrize("server", ["tiny"], indirect=True)
def test_a_short_soak(server: tuple[dict[str, Any], int]) -> None:
    run(*server, 6.0, most_growth=25.0)


@linux
@pytest.mark.slow
@pytest.mark.parametrize("server", ["bundled"], indirect=True)
def test_a_long_soak_without_growth_of_memory(server: tuple[dict[str, Any], int]) -> None:
    seconds = float(os.environ.get("MOTIONKIT_SOAK_SECONDS", "600"))
    # Other limits than those of tests that take up to 15 minutes.
    faulthandler.cancel_dump_traceback_later()
    signal.alarm(round(seconds) + 600)
    run(*server, seconds, most_growth=8.0)
