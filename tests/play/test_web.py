"""Page and WebSocket, with a client written from docs/live.md."""

from __future__ import annotations

import asyncio
import http.client
import json
import logging
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from motionkit.inference.character import CharacterStream
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import bvh_to_motion, read_bvh, write_bvh
from motionkit.motion.rotations import quat_angle
from motionkit.motion.skeleton import canonical_skeleton
from motionkit.play.client import Client, TooManyMessages
from motionkit.play.frames import WorldFrame
from motionkit.play.limits import Limits
from motionkit.play.live import Live
from motionkit.play.requests import parse_request
from motionkit.play.session import Session
from motionkit.rig.on_rig import read_rig
from play.conftest import PATIENCE, Running, Web
from synthetic_rigs import FAMILIES, renamed, walk


@pytest.fixture(autouse=True)
def nothing_logged(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """The log must stay empty, whatever clients do."""
    yield
    assert [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING] == []


def get(server: Running, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    host, port = server.addresses.url.removeprefix("http://").rstrip("/").split(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=PATIENCE)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    out = answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
    connection.close()
    return out


def closing_code(client: Web) -> int | None:
    """Read until the connection is closed; returns the close code."""
    try:
        while True:
            client.read()
    except ConnectionClosed as closed:
        return None if closed.rcvd is None else closed.rcvd.code


def test_hello_then_frames_in_order(serve: Callable, web: Callable) -> None:
    client = web(serve())
    assert client.hello["event"] == "hello" and client.hello["protocol"] == 1
    first = client.until("frame", lambda f: client.hello["character"] in f["characters"])
    numbers = [first["frame"]] + [client.until("frame")["frame"] for _ in range(5)]
    assert all(b > a for a, b in pairwise(numbers))
    shown = first["characters"][client.hello["character"]]
    quats = np.array(shown["rotations"]).reshape(23, 4)
    assert np.allclose(np.linalg.norm(quats, axis=1), 1.0, atol=1e-4)
    assert first["step_ms"] > 0.0 and first["time"] > 0.0


def test_a_wish_shows_in_the_frames(serve: Callable, web: Callable) -> None:
    client = web(serve())
    mine = client.hello["character"]
    client.ask(do="wish", velocity=[0, 300], type="running", seq=41)
    frame = client.until("frame", lambda f: f["characters"].get(mine, {}).get("seq") == 41)
    assert client.hello["types"][frame["characters"][mine]["type"]]["name"] == "running"
    client.ask(do="perform", type="cartwheel", seq=42)
    frame = client.until("frame", lambda f: f["characters"].get(mine, {}).get("seq") == 42)
    assert frame["characters"][mine]["flags"] & 1


def test_two_clients_see_each_other_and_steer_their_own(serve: Callable, web: Callable) -> None:
    server = serve()
    one, two = web(server), web(server)
    mine, other = one.hello["character"], two.hello["character"]
    told = one.until("characters", lambda e: len(e["characters"]) == 2)
    assert [c["owner"] for c in told["characters"]] == [one.hello["client"], two.hello["client"]]
    two.ask(do="wish", velocity=[0, 120], seq=7)
    seen = one.until("frame", lambda f: f["characters"].get(other, {}).get("seq") == 7)
    assert seen["characters"][mine]["seq"] == 0
    one.ask(do="wish", character=other, velocity=[0, 0])
    assert one.until("error")["message"] == f"character {other} is not yours"


def test_a_vanished_client_frees_its_character(serve: Callable, web: Callable) -> None:
    server = serve()
    one, two = web(server), web(server)
    one.until("characters", lambda e: len(e["characters"]) == 2)
    # The connection breaks without a close frame: the socket is closed and sends a reset.
    two.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    two.socket.socket.shutdown(socket.SHUT_RDWR)
    told = one.until("characters", lambda e: len(e["characters"]) == 1)
    assert told["characters"][0]["id"] == one.hello["character"]
    server.wait_until(lambda: len(server.server.live.clients) == 1)


def test_a_refused_request_leaves_the_connection_open(serve: Callable, web: Callable) -> None:
    client = web(serve())
    client.ask(do="wish", type="flying")
    error = client.until("error")
    assert "unknown motion type 'flying'" in error["message"] and error["closing"] is False
    client.ask(do="ping", stamp=2.5)
    assert client.until("pong")["stamp"] == 2.5


@pytest.mark.parametrize(
    "message",
    [b"\x00\x01", "", "{", "[]", '{"do": "wish", "velocity": [1]}', '{"do": "x"}', "[" * 50000, "\x00"],
)
def test_a_malformed_message_is_told_and_closes(serve: Callable, web: Callable, message: str | bytes) -> None:
    server = serve()
    client = web(server)
    client.socket.send(message)
    error = client.until("error")
    assert error["closing"] is True and "expected" in error["message"]
    assert closing_code(client) == 1003
    server.wait_until(lambda: not server.server.live.session.characters)
    assert web(server).hello["event"] == "hello", "the server goes on"


def test_a_message_too_long_closes(serve: Callable, web: Callable) -> None:
    client = web(serve())
    client.socket.send("x" * (client.hello["limits"]["message_bytes"] + 1))
    assert closing_code(client) == 1009


def test_a_flood_is_cut_off(serve: Callable, web: Callable) -> None:
    client = web(serve(limits=Limits(messages_per_second=50)))
    with pytest.raises(ConnectionClosed) as closed:
        for number in range(100_000):
            client.ask(do="wish", seq=number)
    assert closed.value.rcvd is None or closed.value.rcvd.code == 1008


def test_requests_that_cost_much_count_for_more() -> None:
    client = Client(1, False, Limits(messages_per_second=50), now=0.0)
    reset, wish = parse_request('{"do": "reset"}'), parse_request('{"do": "wish"}')
    for request in (reset, reset, wish):
        client.charge(20, now=0.0)
        client.charge_work(request, now=0.0)
    client.charge(20, now=0.0)
    with pytest.raises(TooManyMessages, match="at most 50 a second"):
        client.charge_work(reset, now=0.0)
    client.charge_work(reset, now=1.0)
    with pytest.raises(TooManyMessages):
        client.charge(65536, now=1.0)


@pytest.fixture
def slow_work(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Make resets take much longer than a frame; the frames at which they happen."""
    at: list[int] = []
    streams, step = CharacterStream.reset, Session.step
    newest = [0]

    def slow_reset(*words: Any) -> None:
        at.append(newest[0])
        time.sleep(0.1)
        streams(*words)

    def counted(session: Session, *words: Any) -> WorldFrame:
        newest[0] += 1
        return step(session, *words)

    monkeypatch.setattr(CharacterStream, "reset", slow_reset)
    monkeypatch.setattr(Session, "step", counted)
    return at


def test_one_who_asks_for_much_work_does_not_hold_up_the_frames(
    serve: Callable, tcp: Callable, slow_work: list[int]
) -> None:
    client = tcp(serve(tcp=0))
    slow_work.clear()
    client.send(b'{"do": "reset"}\n' * 8 + b'{"do": "ping"}\n')
    client.until("pong")
    assert len(slow_work) == 8 and all(b > a for a, b in pairwise(slow_work)), "frames between any two"


def test_many_who_come_at_once_do_not_hold_up_the_frames(serve: Callable, slow_work: list[int]) -> None:
    server = serve(tcp=0, limits=Limits(clients=4))
    with ExitStack() as stack:
        crowd = [
            stack.enter_context(socket.create_connection(server.addresses.tcp, PATIENCE)) for _ in range(7)
        ]
        said = [json.loads(stack.enter_context(one.makefile("rb")).readline()) for one in crowd]
    assert sorted(one["event"] for one in said) == ["error"] * 3 + ["hello"] * 4, "who waits has a place"
    assert len(slow_work) == 4 and all(b > a for a, b in pairwise(slow_work))


def test_who_changes_something_all_the_time_does_not_fill_the_others_outboxes(
    serve: Callable, web: Callable, tcp: Callable
) -> None:
    server = serve(tcp=0)
    restless, other = tcp(server), web(server)
    begun = other.until("frame", lambda f: len(f["characters"]) == 2)["frame"]
    asked = [json.dumps({"do": "noise", "temperature": n / 100}).encode() + b"\n" for n in range(1, 151)]
    restless.send(b"".join(asked))
    told, frame, heard = 0, begun, None
    while heard != 1.5:
        event = other.read()
        if event["event"] == "characters":
            told += 1
            heard = event["characters"][0]["temperature"]
        elif event["event"] == "frame":
            frame = event["frame"]
    frame = other.until("frame")["frame"]
    assert told <= frame - begun + 1


def test_a_character_may_go_at_the_very_end_of_its_path(tiny_model: MotionModel) -> None:
    live = Live(Session(tiny_model))
    character = live.session.join(1)
    assert character is not None
    frame = replace(live.session.step(), arrived=(character.id,))
    live.session.leave(1)
    live._send(frame)


def test_who_was_let_go_can_ask_for_nothing_more(tiny_model: MotionModel) -> None:
    """Its connection may stay open for a while; a character made then would belong to nobody."""

    async def asks() -> None:
        live = Live(Session(tiny_model, limits=Limits(clients=1, characters=3, idle_seconds=0.0)))
        first = await live.join(False)
        second = await live.join(False)
        assert first is not None and second is not None and first.let_go
        await live.take(first, json.dumps({"do": "add"}))
        assert [one.owner for one in live.session.characters.values()] == [second.number]
        live.leave(first)
        live.leave(second)
        assert not live.session.characters

    asyncio.run(asks())


def test_a_client_that_leaves_while_something_is_sent_is_let_go() -> None:
    """Before Python 3.12, wait_for swallows a cancellation that arrives when the send completes."""

    async def leaves() -> None:
        client = Client(1, False, Limits(), now=0.0)

        async def send(_: str | bytes) -> None:
            client.leave()
            pump.cancel()

        pump = asyncio.get_running_loop().create_task(client.pump(send))
        client.show(b"frame")
        await asyncio.wait([pump], timeout=PATIENCE)
        assert pump.done()

    asyncio.run(leaves())


def test_broken_websocket_frames_close(serve: Callable, web: Callable) -> None:
    server = serve()
    for garbage in (b"\xff" * 64, b"\x81\x05hello", b"\x8f\x80\x00\x00\x00\x00"):
        client = web(server)
        client.socket.socket.sendall(garbage)
        assert closing_code(client) in (None, 1002)
    server.wait_until(lambda: not server.server.live.clients)


def test_garbage_instead_of_http(serve: Callable, web: Callable) -> None:
    server = serve()
    host, port = server.addresses.url.removeprefix("http://").rstrip("/").split(":")
    for garbage in (
        b"\x00" * 100,
        b"POST / HTTP/1.1\r\n\r\n",
        b"GET /" + b"a" * 20000,
        b"GET / HTTP/1.1\r\n" * 300,
    ):
        with socket.create_connection((host, int(port)), PATIENCE) as connection:
            connection.sendall(garbage)
            connection.shutdown(socket.SHUT_WR)
            try:
                while connection.recv(4096):
                    pass
            except ConnectionResetError:
                pass
    assert web(server).hello["event"] == "hello"


def test_there_is_room_for_so_many(serve: Callable, web: Callable) -> None:
    server = serve(limits=Limits(clients=2, characters=1))
    one, two = web(server), web(server)
    assert one.hello["character"] is not None and two.hello["character"] is None
    with pytest.raises(ConnectionClosed) as closed:
        web(server)
    assert closed.value.rcvd is not None and closed.value.rcvd.code == 1013
    one.socket.close()
    server.wait_until(lambda: len(server.server.live.clients) == 1)
    two.ask(do="add")
    assert len(two.until("characters", lambda e: e["characters"] != [])["characters"]) == 1


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"additional_headers": {"Host": "evil.example"}},
        {"origin": "http://evil.example", "additional_headers": {"Host": "evil.example"}},
    ],
)
def test_pages_of_others_cannot_connect(serve: Callable, headers: dict) -> None:
    server = serve()
    with pytest.raises(InvalidStatus) as refused:
        connect(server.addresses.socket, **headers)
    assert refused.value.response.status_code in (400, 403)
    assert server.server.live.clients == {}


def test_the_own_page_can_connect(serve: Callable, web: Callable) -> None:
    server = serve()
    assert web(server, origin=server.addresses.url.rstrip("/")).hello["event"] == "hello"


def test_the_page(serve: Callable) -> None:
    status, headers, body = get(serve(), "/")
    assert status == 200 and headers["content-type"].startswith("text/html")
    assert body.lower().startswith(b"<!doctype html>") and int(headers["content-length"]) == len(body)
    assert "default-src 'none'" in headers["content-security-policy"]


def test_headless_serves_no_page_but_sockets(serve: Callable, web: Callable) -> None:
    server = serve(page=False)
    assert get(server, "/")[0] == 404
    assert web(server).hello["event"] == "hello"


@pytest.mark.parametrize(
    "path",
    [
        "/../../etc/passwd",
        "/etc/passwd",
        "//etc/passwd",
        "/play.html",
        "/recordings/",
        "/recordings/x.bvh",
        "/recordings/../../etc/passwd.bvh",
        "/%2e%2e/x",
        "/recordings/%00.bvh",
        "/?x",
        "/live/x",
        "*",
    ],
)
def test_no_path_reaches_a_file(serve: Callable, path: str) -> None:
    status, _, body = get(serve(page=False), path)
    assert status == 404 and body == b"not found\n"


def test_other_names_of_this_server_are_refused(serve: Callable) -> None:
    status, _, body = get(serve(), "/", Host="evil.example")
    assert status == 403 and b"<html" not in body


def test_a_recording_comes_down_as_it_was_sent(serve: Callable, web: Callable, tmp_path: Path) -> None:
    server = serve()
    client = web(server)
    mine = client.hello["character"]
    client.ask(do="wish", velocity=[0, 200], seq=1)
    client.ask(do="record", on=True)
    frames = {}
    while len(frames) < 20:
        frame = client.until("frame", lambda f: f["characters"].get(mine, {"flags": 0})["flags"] & 4)
        frames[frame["frame"]] = frame["characters"][mine]
    client.ask(do="record", on=False)
    event: dict = {}
    while event.get("event") != "recorded":
        event = client.read()
        if event["event"] == "frame" and event["characters"][mine]["flags"] & 4:
            frames[event["frame"]] = event["characters"][mine]
    status, headers, body = get(server, event["url"])
    assert status == 200 and "attachment" in headers["content-disposition"]
    (tmp_path / "got.bvh").write_bytes(body)
    motion = bvh_to_motion(read_bvh(tmp_path / "got.bvh"))
    assert len(motion) == event["frames"] and event["seconds"] == pytest.approx(len(motion) / 60)
    # A slow reader misses frames; those it got are in the file, each at its number.
    last = max(frames)
    first = last - len(motion) + 1
    assert min(frames) >= first and len(frames) <= len(motion)
    for number, shown in frames.items():
        at = number - first
        turned = np.array(shown["rotations"]).reshape(23, 4)
        assert float(quat_angle(motion.local_rotations[at], turned).max()) < 1e-3
        assert np.allclose(motion.root_positions[at], np.array(shown["root"]), atol=1e-4)


def test_a_client_that_reads_nothing_does_not_hold_up_the_others(
    serve: Callable, web: Callable, tcp: Callable
) -> None:
    server = serve(tcp=0)
    tcp(server)
    other = web(server)
    begun = other.until("frame")["frame"]
    for _ in range(60):
        other.until("frame")
    assert other.until("frame")["frame"] >= begun + 60
    held = server.ask(lambda: max(len(c._events) for c in server.server.live.clients.values()))
    assert held < 5, "frames do not pile up"


def test_a_client_that_takes_nothing_in_is_closed(serve: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motionkit.play.client.STALL_SECONDS", 0.2)
    server = serve(tcp=0)
    with socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        deaf.connect(server.addresses.tcp)
        server.wait_until(lambda: len(server.server.live.session.characters) == 1)
        server.wait_until(lambda: not server.server.live.session.characters)
        assert server.ask(lambda: server.server.live.clients) == {}


def test_figures_of_bodies_are_made_when_asked_for(
    serve: Callable, tiny_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = {"default": canonical_skeleton().offsets, "taller": 1.2 * canonical_skeleton().offsets}
    server = serve(model=replace(tiny_model, characters=bodies))
    figures = server.server._figures
    assert list(server.ask(lambda: figures._made)) == [0], "that of the default body is begun"
    statures = []
    for number in (0, 1, 1):
        while get(server, f"/figures/{number}")[0] == 202:
            pass  # it is being made; the machine may be busy
        status, headers, body = get(server, f"/figures/{number}")
        assert (status, headers["content-type"]) == (200, "application/json")
        statures.append(json.loads(body)["stature"])
    assert statures[1] / statures[0] == pytest.approx(1.2, abs=1e-3) and statures[1] == statures[2]
    monkeypatch.setattr("motionkit.play.figures.WAIT_SECONDS", 0.0)
    figures._made.clear()
    assert get(server, "/figures/1")[0] == 202, "who asks is not kept waiting"
    for path in ("/figures/2", "/figures/9999", "/figures/x", "/figures/"):
        assert get(server, path)[0] == 404
    headless = serve(page=False)
    assert get(headless, "/figures/0")[0] == 404 and not headless.server._figures._made


def test_a_recording_on_a_users_rig(serve: Callable, web: Callable, tmp_path: Path) -> None:
    write_bvh(tmp_path / "my.bvh", renamed(walk(2), FAMILIES["unreal"]).scaled(0.01))
    server = serve(rig=read_rig(tmp_path / "my.bvh"))
    client = web(server)
    mine = client.hello["character"]
    client.ask(do="record", on=True)
    client.until("frame", lambda f: f["characters"].get(mine, {"flags": 0})["flags"] & 4)
    client.ask(do="record", on=False)
    event = client.until("recorded")
    status, _, body = get(server, event["url"])
    assert status == 200
    assert body.decode().split("MOTION")[0] == (tmp_path / "my.bvh").read_text().split("MOTION")[0]
    assert f"Frames: {event['frames']}" in body.decode()


def test_a_recording_in_a_format_that_takes_an_avatar_goes_on(serve: Callable, web: Callable) -> None:
    client = web(serve())
    mine = client.hello["character"]
    client.ask(do="record", on=True, format="vrm")
    assert "takes an avatar" in client.until("error")["message"]
    client.ask(do="record", on=True)
    client.until("frame", lambda f: f["characters"].get(mine, {"flags": 0})["flags"] & 4)
    client.ask(do="record", on=False, format="vrm")
    assert "takes an avatar" in client.until("error")["message"]
    client.ask(do="record", on=False, format="bvh")
    assert client.until("recorded")["format"] == "bvh", "what was recorded is kept"


def test_a_recording_in_another_format(serve: Callable, web: Callable) -> None:
    server = serve(recording_format="usda")
    client = web(server)
    assert client.hello["recording_format"] == "usda"
    mine = client.hello["character"]
    vrma, usda = ({"format": ending} for ending in ("vrma", "usda"))
    gltf, text = ("model/gltf-binary", b"glTF"), ("text/plain; charset=utf-8", b"#usda 1.0")
    for begun, asked, ending, (content, begin) in (
        ({}, {}, "usda", text),
        ({}, vrma, "vrma", gltf),
        (vrma, {}, "vrma", gltf),
        (vrma, {"format": None}, "vrma", gltf),
        (vrma, usda, "usda", text),
    ):
        client.ask(do="record", on=True, **begun)
        client.until("frame", lambda f: f["characters"].get(mine, {"flags": 0})["flags"] & 4)
        client.ask(do="record", on=False, **asked)
        event = client.until("recorded")
        assert event["format"] == ending
        status, headers, body = get(server, event["url"])
        assert (status, headers["content-type"]) == (200, content) and body.startswith(begin)
        assert headers["content-disposition"] == f'attachment; filename="motionkit-recording.{ending}"'
        # A frame of this recording that is read late is none of the next.
        client.until("frame", lambda f: not f["characters"].get(mine, {"flags": 4})["flags"] & 4)
    client.ask(do="record", on=False, format="fbx")
    assert "format: expected one of bvh, glb," in client.until("error")["message"]


def test_recordings_do_not_pile_up(serve: Callable, web: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def slow(*_: object) -> bytes:
        begun.set()
        assert go_on.wait(PATIENCE)
        return b"HIERARCHY"

    monkeypatch.setattr("motionkit.play.live.file_bytes", slow)
    client = web(serve(limits=Limits(recordings=1)))
    mine = client.hello["character"]

    def recorded() -> None:
        client.ask(do="record", on=True)
        client.until("frame", lambda f: f["characters"].get(mine, {"flags": 0})["flags"] & 4)
        client.ask(do="record", on=False)

    recorded()
    assert begun.wait(PATIENCE)
    client.ask(do="record", on=True)
    assert client.until("error")["message"] == "earlier recordings are still being written"
    go_on.set()
    client.until("recorded")
    recorded()
    client.until("recorded")


def test_requests_in_a_row_are_obeyed_in_order(serve: Callable, web: Callable) -> None:
    client = web(serve())
    mine = client.hello["character"]
    for number in range(1, 20):
        client.socket.send(json.dumps({"do": "wish", "velocity": [0, 10 * number], "seq": number}))
    client.until("frame", lambda f: f["characters"][mine]["seq"] == 19)
