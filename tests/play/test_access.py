"""Access to the server: tokens if other machines can connect, HTTP methods, idle clients."""

from __future__ import annotations

import http.client
import json
import logging
import socket
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from motionkit.play.limits import Limits
from motionkit.play.server import reachable_name
from play.conftest import PATIENCE, Lines, Running


@pytest.fixture(autouse=True)
def nothing_logged(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    yield
    assert [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING] == []


@pytest.fixture
def everywhere(serve: Callable) -> Running:
    """A server that listens on all addresses."""
    return serve(host="0.0.0.0", tcp=0)


def ask(
    server: Running, path: str, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, dict[str, str], bytes]:
    port = urlsplit(server.addresses.url).port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    out = answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
    connection.close()
    return out


def socket_address(server: Running, query: str = "") -> str:
    return f"ws://127.0.0.1:{urlsplit(server.addresses.url).port}/live{query}"


def test_the_address_holds_a_token_where_others_can_connect(everywhere: Running, serve: Callable) -> None:
    token = everywhere.addresses.token
    assert token is not None and len(token) >= 24
    assert everywhere.addresses.url.endswith(f"/?token={token}")
    assert everywhere.addresses.socket.endswith(f"/live?token={token}")
    here = serve().addresses
    assert here.token is None and "token" not in here.url + here.socket


def test_the_page_asks_for_the_token(everywhere: Running) -> None:
    token = everywhere.addresses.token
    for path in ("/", "/?token=", "/?token=wrong", f"/?tokens={token}", "/?token=%ff", "/figures/0"):
        status, headers, body = ask(everywhere, path)
        assert status == 403 and "set-cookie" not in headers and token not in body.decode()
    status, headers, body = ask(everywhere, f"/?token={token}")
    assert status == 200 and body.lower().startswith(b"<!doctype html>")
    assert "HttpOnly; SameSite=Strict" in headers["set-cookie"]
    cookie = headers["set-cookie"].partition(";")[0]
    assert ask(everywhere, "/", Cookie=cookie)[0] == 200
    assert ask(everywhere, "/figures/0", Cookie=cookie)[0] in (200, 202)
    assert ask(everywhere, "/", Cookie=f"{cookie}x")[0] == 403


def test_sockets_ask_for_the_token(everywhere: Running) -> None:
    token = everywhere.addresses.token
    for query in ("", "?token=wrong", "?token=%C3%A9"):
        with pytest.raises(InvalidStatus) as refused:
            connect(socket_address(everywhere, query), open_timeout=PATIENCE)
        assert refused.value.response.status_code == 403
    cookie = {"Cookie": ask(everywhere, f"/?token={token}")[1]["set-cookie"].partition(";")[0]}
    for query, headers in ((f"?token={token}", {}), ("", cookie)):
        with connect(
            socket_address(everywhere, query), open_timeout=PATIENCE, additional_headers=headers
        ) as client:
            assert json.loads(client.recv(timeout=PATIENCE))["event"] == "hello"


@pytest.mark.parametrize(
    "first", [b'{"do": "ping"}', b'{"token": "wrong"}', b'{"token": 5}', b"[" * 5000, b"\xff", b'"token"']
)
def test_tcp_asks_for_the_token(everywhere: Running, first: bytes) -> None:
    port = everywhere.addresses.tcp[1]
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as connection:
        client = Lines(connection)
        client.send(first + b"\n")
        error = client.read()
        assert error["event"] == "error" and error["closing"] and "token" in error["message"]
        with pytest.raises(EOFError):
            client.read()
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as connection:
        client = Lines(connection)
        client.send(json.dumps({"token": everywhere.addresses.token}).encode() + b"\n")
        assert client.read()["event"] == "hello"


def test_who_never_sends_the_token_holds_no_place(
    everywhere: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.play.server.TOKEN_SECONDS", 0.1)
    with socket.create_connection(("127.0.0.1", everywhere.addresses.tcp[1]), PATIENCE) as connection:
        client = Lines(connection)
        assert "token" in client.read()["message"]
        with pytest.raises(EOFError):
            client.read()


@pytest.mark.parametrize("kind", ["tcp", "web"])
def test_silent_connections_do_not_lock_out_who_has_the_token(serve: Callable, kind: str) -> None:
    server = serve(host="0.0.0.0", tcp=0, limits=Limits(clients=1))
    place, token = server.server, server.addresses.token
    port = server.addresses.tcp[1] if kind == "tcp" else urlsplit(server.addresses.url).port
    strangers = place._tcp_strangers if kind == "tcp" else place._web_strangers
    quiet = []
    for _ in range(20):
        quiet.append(socket.create_connection(("127.0.0.1", port), PATIENCE))
    server.wait_until(lambda: len(strangers._open) == strangers.most == 4)
    if kind == "tcp":
        with socket.create_connection(("127.0.0.1", port), PATIENCE) as connection:
            client = Lines(connection)
            client.send(json.dumps({"token": token}).encode() + b"\n")
            assert client.read()["event"] == "hello"
    else:
        with connect(socket_address(server, f"?token={token}")) as page:
            assert json.loads(page.recv(PATIENCE))["event"] == "hello"
            again = [socket.create_connection(("127.0.0.1", port), PATIENCE) for _ in range(9)]
            page.send(json.dumps({"do": "ping", "stamp": 1}))
            while True:
                told = page.recv(PATIENCE)
                if isinstance(told, str) and json.loads(told)["event"] == "pong":
                    break
            quiet += again
    for connection in quiet:
        connection.close()
    server.wait_until(lambda: not strangers._open)


def test_who_left_before_its_turn_holds_no_place(serve: Callable) -> None:
    server = serve(tcp=0, limits=Limits(clients=2))
    live = server.server.live

    def busy(seconds: float) -> None:
        live.slow_work._rested = live.clock() + seconds

    server.ask(lambda: busy(3600.0))
    left = [socket.create_connection(server.addresses.tcp, PATIENCE) for _ in range(2)]
    server.wait_until(lambda: live._joining == 2)
    for connection in left:
        connection.close()
    server.wait_until(lambda: live._joining == 0)
    server.ask(lambda: busy(0.0))
    with socket.create_connection(server.addresses.tcp, PATIENCE) as connection:
        assert Lines(connection).read()["event"] == "hello"


def test_a_stop_during_joins_is_quiet(serve: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is logged, as the fixture above sees; a client that keeps its connection open is cut off."""
    monkeypatch.setattr("motionkit.play.live.LOOK_SECONDS", 3600.0)
    monkeypatch.setattr("motionkit.play.server.CLOSE_SECONDS", 0.1)
    server = serve(tcp=0)
    live = server.server.live
    server.ask(lambda: setattr(live.slow_work, "_rested", live.clock() + 3600.0))
    for _ in range(8):
        socket.create_connection(server.addresses.tcp, PATIENCE)
    server.wait_until(lambda: live._joining == 8)


def test_idle_clients_make_room(serve: Callable, tcp: Callable, web: Callable) -> None:
    server = serve(tcp=0, limits=Limits(clients=2, idle_seconds=0.0))
    first, second = tcp(server), tcp(server)
    third = tcp(server)
    assert third.hello["event"] == "hello" and third.hello["limits"]["idle_seconds"] == 0.0
    assert "another client needs the place" in first.until("error")["message"]
    with pytest.raises(EOFError):
        while True:
            first.read()
    assert web(server).hello["event"] == "hello"
    assert second.until("error")["closing"]
    assert len(server.ask(lambda: dict(server.server.live.clients))) == 2


def test_clients_that_speak_keep_their_places(serve: Callable, tcp: Callable) -> None:
    server = serve(tcp=0, limits=Limits(clients=2, idle_seconds=3600.0))
    first, _ = tcp(server), tcp(server)
    with socket.create_connection(server.addresses.tcp, PATIENCE) as connection:
        assert Lines(connection).read()["message"] == "too many clients"
    # The client heard last stays, even if it came first.
    live = server.server.live
    numbers = server.ask(lambda: list(live.clients))

    def all_quiet_but_the_first() -> None:
        for number in numbers:
            live.clients[number].heard -= 7200.0

    server.ask(all_quiet_but_the_first)
    first.ask(do="ping", stamp=1)
    first.until("pong")
    assert tcp(server).hello["event"] == "hello"
    assert numbers[0] in server.ask(lambda: list(live.clients))


@pytest.mark.parametrize(
    "method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "PATCH", "BREW", "get", "Head", "M-SEARCH", "B4"]
)
@pytest.mark.parametrize("path", ["/", "/live", "/nowhere"])
def test_other_methods_are_refused(serving: Running, method: str, path: str) -> None:
    for body in (None, b"x" * 200_000 if path == "/" else b"x"):
        status, headers, _ = ask(serving, path, method, body)
        assert status == 405 and headers["allow"] == "GET, HEAD"


def test_head_has_the_headers_of_get_and_no_body(serving: Running) -> None:
    for path, wanted in (("/", 200), ("/nowhere", 404)):
        got, head = ask(serving, path), ask(serving, path, "HEAD")
        assert got[0] == head[0] == wanted and got[2] and head[1] == got[1]
        with raw(serving) as connection:
            connection.sendall(f"HEAD {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            assert b"".join(iter(lambda: connection.recv(65536), b"")).endswith(b"\r\n\r\n")
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    assert ask(serving, "/live", "HEAD", None, **upgrade, **key)[0] == 405


def test_a_method_may_come_in_pieces(serving: Running) -> None:
    with raw(serving) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for piece in (b"G", b"E", b"T /nowhere HTTP/1.1\r\n", b"Host: localhost\r\n\r\n"):
            connection.sendall(piece)
        assert connection.recv(100).startswith(b"HTTP/1.1 404 ")


@pytest.mark.parametrize(
    "data", [b"\x16\x03\x01\x02\x00\x01", b"get / HTTP/1.1\r\n\r\n", b"A" * 5000, b" \r\n"]
)
def test_what_is_no_http_is_closed(serving: Running, data: bytes) -> None:
    with raw(serving) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert not answer.startswith(b"HTTP/1.1 200")
    assert ask(serving, "/")[0] == 200


def raw(server: Running) -> socket.socket:
    return socket.create_connection(("127.0.0.1", urlsplit(server.addresses.url).port), PATIENCE)


def test_an_address_for_everybody_is_one_that_can_be_reached() -> None:
    assert reachable_name("127.0.0.1") == "127.0.0.1" and reachable_name("studio.local") == "studio.local"
    for host in ("0.0.0.0", "::", ""):
        assert reachable_name(host) not in ("", "0.0.0.0", "::")


@pytest.fixture(scope="module")
def serving(tiny_model: object) -> Iterator[Running]:
    """One local server for all tests that only request pages."""
    from motionkit.play.server import PlayServer, ServerOptions
    from motionkit.play.session import Session
    from play.conftest import running

    with running(PlayServer(Session(tiny_model), ServerOptions(port=0))) as server:
        yield server
