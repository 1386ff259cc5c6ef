"""Newline-delimited JSON, with a client written from docs/live.md."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable

import pytest

from motionkit.models.model import MotionModel
from motionkit.play.limits import Limits
from motionkit.play.live import Live
from motionkit.play.session import Session


def test_frames_as_json(serve: Callable, tcp: Callable) -> None:
    client = tcp(serve(tcp=0))
    assert client.hello["event"] == "hello" and client.hello["protocol"] == 1 and client.hello["fps"] == 60.0
    client.ask(do="wish", velocity=[0, 300], type="running", seq=3)
    frame = client.until("frame", lambda f: f["characters"][0]["seq"] == 3)
    (shown,) = frame["characters"]
    assert shown["id"] == client.hello["character"] and shown["type"] == "running"
    assert len(shown["positions"]) == len(shown["rotations"]) == 23
    assert shown["positions"][0] == pytest.approx(shown["root"], abs=0.01)
    assert all(math.isclose(math.hypot(*q), 1.0, abs_tol=1e-3) for q in shown["rotations"])
    assert len(shown["contacts"]) == 4 and shown["following"] is None
    assert client.until("frame")["frame"] > frame["frame"]


def test_positions_follow_from_rotations_as_the_page_says(serve: Callable, tcp: Callable) -> None:
    """Forward kinematics by hand, from hello's parents and offsets."""
    client = tcp(serve(tcp=0))
    (shown,) = client.until("frame")["characters"]
    offsets = client.hello["bodies"][0]["offsets"]
    turns, places = [shown["rotations"][0]], [shown["root"]]
    for joint in range(1, 23):
        parent = client.hello["parents"][joint]
        turned = _turn(turns[parent], offsets[joint])
        places.append([a + b for a, b in zip(places[parent], turned, strict=True)])
        turns.append(_times(turns[parent], shown["rotations"][joint]))
    for place, expected in zip(places, shown["positions"], strict=True):
        assert place == pytest.approx(expected, abs=0.05)


def _times(a: list[float], b: list[float]) -> list[float]:
    (w, x, y, z), (p, q, r, s) = a, b
    return [
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    ]


def _turn(q: list[float], v: list[float]) -> list[float]:
    w, x, y, z = q
    return _times(_times(q, [0.0, *v]), [w, -x, -y, -z])[1:]


def test_a_tcp_client_and_a_page_share_the_world(serve: Callable, tcp: Callable, web: Callable) -> None:
    server = serve(tcp=0)
    one, two = tcp(server), web(server)
    one.ask(do="perform", type="cartwheel", seq=9)
    two.until("frame", lambda f: f["characters"][one.hello["character"]]["seq"] == 9)
    one.socket.close()
    one.file.close()
    two.until("characters", lambda e: len(e["characters"]) == 1)


@pytest.mark.parametrize(
    "data",
    [
        b"\n",
        b"hello\n",
        b"\xff\xfe\n",
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        b'{"do": "fly"}\n',
        b"x" * 70000,
        b"\x00\n",
    ],
)
def test_a_line_that_is_no_request_is_told_and_closes(serve: Callable, tcp: Callable, data: bytes) -> None:
    server = serve(tcp=0)
    client = tcp(server)
    client.send(data)
    assert client.until("error")["closing"] is True
    with pytest.raises((EOFError, ConnectionError)):
        while True:
            client.read()
    server.wait_until(lambda: not server.server.live.clients)


def test_half_a_line_at_the_end_is_nothing(serve: Callable, tcp: Callable) -> None:
    server = serve(tcp=0)
    client = tcp(server)
    client.send(b'{"do": "wi')
    client.socket.shutdown(1)
    server.wait_until(lambda: not server.server.live.clients)


def test_no_room(serve: Callable, tcp: Callable) -> None:
    server = serve(tcp=0, limits=Limits(clients=1))
    tcp(server)
    assert tcp(server).hello == {"event": "error", "message": "too many clients", "closing": True}


def test_the_first_frame_has_the_character_of_a_client_that_joins_while_it_is_made(
    tiny_model: MotionModel,
) -> None:
    """A frame that was computed before a client joined, and is sent after, is not for it."""

    async def shown() -> list[list[int]]:
        live = Live(Session(tiny_model))
        seen: list[list[int]] = []

        async def send(message: str | bytes) -> None:
            told = json.loads(message)
            if told["event"] == "frame":
                seen.append([one["id"] for one in told["characters"]])

        computed = live.session.step(60.0)
        client = await live.join(as_json=True)
        assert client is not None
        pump = asyncio.ensure_future(client.pump(send))
        for frame in (computed, live.session.step(60.0)):
            live._send(frame)
            await asyncio.sleep(0.05)
        client.leave()
        await pump
        return seen

    assert asyncio.run(shown()) == [[1]]
