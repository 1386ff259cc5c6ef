"""The sockets of `motionkit play`: web page and WebSocket, line-delimited JSON over TCP, VMC over UDP."""

from __future__ import annotations

import asyncio
import errno
import hmac
import json
import logging
import secrets
import signal
import socket as socketlib
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers, MultipleValuesError
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response
from websockets.protocol import State

from motionkit.errors import MotionkitError
from motionkit.files import parse_json
from motionkit.motion.motion import Motion
from motionkit.play.client import Client, TooManyMessages
from motionkit.play.figures import Figures
from motionkit.play.frames import WorldFrame
from motionkit.play.live import Live, error_event
from motionkit.play.on_rig import LiveRig
from motionkit.play.page import (
    figure_number,
    find_recording,
    host_allowed,
    is_loopback,
    known_names,
    origin_allowed,
    policy,
)
from motionkit.play.requests import ProtocolError
from motionkit.play.session import Session
from motionkit.play.vmc import VmcBody, osc_bundles
from motionkit.rig.rig import Rig
from motionkit.view.viewer import page_asset

SOCKET_PATH = "/live"
CLOSE_SECONDS = 1.0  # s, time for clients to disconnect when the server stops
WAITING_BYTES = 8192  # unsent bytes in the buffers of a socket
TOKEN_SECONDS = 10.0  # s, time for a TCP client to send the token
WAITING_ROOM = 4  # most connections of one kind that have not joined, as a multiple of the client limit
CLOSE_MALFORMED, CLOSE_RATE, CLOSE_FULL = 1003, 1008, 1013  # WebSocket close codes (RFC 6455)


METHODS = (b"GET ", b"HEAD ")


class ServeError(MotionkitError):
    """A port or address cannot be used."""


@dataclass(frozen=True)
class ServerOptions:
    """Addresses to listen on and send to; port 0 picks a free port, None disables the output.

    rig is the rig of recordings and JSON frames; clip animates its joints that have no canonical joint.
    recording_format is used by requests that name none.
    """

    host: str = "127.0.0.1"
    port: int = 8642
    tcp: int | None = None
    vmc: tuple[str, int] | None = None
    page: bool = True
    rig: Rig | None = None
    clip: Motion | None = None
    recording_format: str = "bvh"


@dataclass(frozen=True)
class Addresses:
    """Addresses of the running server; url and socket include the token if one is needed."""

    url: str
    socket: str
    tcp: tuple[str, int] | None
    vmc: tuple[str, int] | None
    token: str | None = None


class PlayServer:
    """Serves a live session on its sockets."""

    def __init__(self, session: Session, options: ServerOptions) -> None:
        self.options = options
        self.live = Live(session, rig=(options.rig, options.clip), recording_format=options.recording_format)
        self._page = page_asset("play.html").encode() if options.page else None
        names = list(session.model.characters)
        characters = {}
        if options.page and options.rig is not None and options.rig.character is not None:
            if options.rig.character.has_mesh:
                characters[names.index(options.rig.name)] = LiveRig(options.rig).page_character()
        self._figures = Figures([session.model.character(name) for name in names], characters)
        self._first_figure = names.index(session.body)
        self._connections: dict[asyncio.Task, asyncio.StreamWriter] = {}  # TCP connections
        most = WAITING_ROOM * session.limits.clients
        self._web_strangers, self._tcp_strangers = Strangers(most), Strangers(most)
        self._names = known_names(options.host)
        self._numbers = not is_loopback(options.host)
        # Clients from other machines must know the token.
        self.token = None if is_loopback(options.host) else secrets.token_urlsafe(18)
        self._cookie = ""  # cookie name; includes the port, because a host's cookies are shared by all ports

    async def run(self, ready: Callable[[Addresses], None] | None = None) -> None:
        """Serve until cancelled or stopped by SIGINT or SIGTERM.

        Raises:
            ServeError: a port is in use, or an address does not belong to this machine.
        """
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        async with AsyncExitStack() as open_:
            for number in (signal.SIGINT, signal.SIGTERM):
                # Windows and other threads than the main one have no handlers; there Ctrl-C raises KeyboardInterrupt.
                with suppress(NotImplementedError, RuntimeError, ValueError):
                    loop.add_signal_handler(number, stop.set)
                    open_.callback(loop.remove_signal_handler, number)
            addresses = await self._open(open_)
            if self.options.page:
                self._figures.begin(self._first_figure)
            clock = loop.create_task(self.live.run())
            open_.push_async_callback(_cancelled, clock)
            if ready is not None:
                ready(addresses)
            stopping = loop.create_task(stop.wait())
            open_.push_async_callback(_cancelled, stopping)
            await asyncio.wait([clock, stopping], return_when=asyncio.FIRST_COMPLETED)
            if clock.done():
                clock.result()  # raises the session's error

    async def _open(self, open_: AsyncExitStack) -> Addresses:
        host, options = self.options.host, self.options
        if options.vmc is not None:
            open_.callback((await self._open_vmc(*options.vmc)).close)
        try:
            web = await serve(
                self._web_client,
                host,
                options.port,
                process_request=self._answer_method,
                create_connection=partial(_Connection, self._web_strangers),  # type: ignore[arg-type]
                compression=None,
                max_size=self.live.session.limits.message_bytes,
                close_timeout=CLOSE_SECONDS,
                server_header=None,
                logger=_quiet_logger(),
            )
        except (OSError, ValueError) as error:  # an invalid host name is a ValueError
            raise _serve_error(host, options.port, "--port", error) from None
        open_.push_async_callback(self._close_web, web)
        port = web.sockets[0].getsockname()[1]
        tcp = None
        if options.tcp is not None:
            limit = self.live.session.limits.message_bytes
            try:
                server = await asyncio.start_server(self._tcp_client, host, options.tcp, limit=limit)
            except (OSError, ValueError) as error:
                raise _serve_error(host, options.tcp, "--tcp", error) from None
            open_.push_async_callback(self._close_tcp, server)
            tcp = (reachable_name(host), server.sockets[0].getsockname()[1])
        self._cookie = f"motionkit-{port}"
        name = reachable_name(host)
        name = f"[{name}]" if ":" in name else name
        query = "" if self.token is None else f"?token={self.token}"
        url, live = f"http://{name}:{port}/{query}", f"ws://{name}:{port}{SOCKET_PATH}{query}"
        return Addresses(url, live, tcp, options.vmc, self.token)

    # ---- HTTP ----

    async def _answer_method(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        """The response to GET or HEAD (the same without a body)."""
        assert isinstance(connection, _Connection)
        if self._knows_token(request, request.path.partition("?")[2]):
            self._web_strangers.know(connection.transport)
        response = await self._answer(request)
        if connection.method != b"HEAD":
            return response
        return _method_refused() if response is None else replace(response, body=b"")

    async def _answer(self, request: HttpRequest) -> Response | None:
        """The response to an HTTP request; None if it may open a WebSocket."""
        try:
            host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
        except MultipleValuesError:
            return _response(HTTPStatus.BAD_REQUEST, "send at most one Host and one Origin header")
        if not host_allowed(host, self._names, self._numbers):
            return _response(HTTPStatus.FORBIDDEN, "the Host header does not name this server")
        path, _, query = request.path.partition("?")
        if path == SOCKET_PATH:
            if not origin_allowed(origin, host):
                return _response(HTTPStatus.FORBIDDEN, "only the page of this server may connect")
            return None if self._knows_token(request, query) else _token_missing()
        if path == "/" and self._page is not None:
            if not self._knows_token(request, query):
                return _token_missing()
            headers = {"Content-Security-Policy": policy(host)}
            if self.token is not None:  # the page needs the token to open its socket
                headers["Set-Cookie"] = f"{self._cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            return _response(HTTPStatus.OK, self._page, "text/html; charset=utf-8", headers)
        number = figure_number(path)
        if number is not None and self._page is not None:
            if not self._knows_token(request, query):
                return _token_missing()
            figure = await self._figures.get(number)
            if figure:
                return _response(HTTPStatus.OK, figure, "application/json")
            if figure is not None:
                return _response(HTTPStatus.ACCEPTED, "the figure is being made; ask again")
        recording = find_recording(path, self.live.writer.files)
        if recording is not None:
            data, content, name = recording
            named = {"Content-Disposition": f'attachment; filename="{name}"'}
            return _response(HTTPStatus.OK, data, content, named)
        return _response(HTTPStatus.NOT_FOUND, "not found")

    def _knows_token(self, request: HttpRequest, query: str) -> bool:
        """Whether a request has the token in its URL or cookie; True if no token is required."""
        tokens = parse_qs(query).get("token", [])
        for line in request.headers.get_all("Cookie"):
            with suppress(CookieError):
                cookie = SimpleCookie(line).get(self._cookie)
                tokens += [] if cookie is None else [cookie.value]
        return self.token is None or any(self._is_token(word) for word in tokens)

    def _is_token(self, word: object) -> bool:
        # Constant time, so that timing does not reveal the token.
        return isinstance(word, str) and hmac.compare_digest(
            word.encode("utf-8", "replace"), (self.token or "").encode()
        )

    # ---- clients ----

    async def _web_client(self, socket: ServerConnection) -> None:
        async def send(message: str | bytes) -> None:
            try:
                await socket.send(message)
            except ConnectionClosed as error:
                raise ConnectionError(str(error)) from None

        _send_late(socket.transport)
        client = await self.live.join(as_json=False, closed=lambda: socket.state is not State.OPEN)
        with suppress(ConnectionClosed):
            if client is None:
                await socket.close(CLOSE_FULL, "too many clients")
                return
            fault = await self._attend(client, socket, send, socket.transport.abort)
            if fault is not None:
                code = CLOSE_RATE if isinstance(fault, TooManyMessages) else CLOSE_MALFORMED
                await socket.close(code, "see the error event")

    async def _tcp_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async def send(message: str | bytes) -> None:
            writer.write((message if isinstance(message, bytes) else message.encode()) + b"\n")
            await writer.drain()

        def closed() -> bool:
            return reader.at_eof() or writer.is_closing()

        task = asyncio.current_task()
        assert task is not None
        self._connections[task] = writer
        self._tcp_strangers.meet(writer.transport)
        _send_late(writer.transport)
        try:
            lines = self._lines(reader)
            fault = await self._tcp_fault(lines)
            self._tcp_strangers.know(writer.transport)
            client = None if fault else await self.live.join(as_json=True, closed=closed)
            if client is None:
                refused = error_event(ProtocolError(fault or "too many clients"), closing=True)
                writer.write(json.dumps(refused).encode() + b"\n")
            else:
                await self._attend(client, lines, send, writer.transport.abort)
            # Read what the client still sends: otherwise the system may discard our unread answer.
            with suppress(OSError, asyncio.TimeoutError):
                writer.write_eof()
                await asyncio.wait_for(_read_away(reader), CLOSE_SECONDS)
        except asyncio.CancelledError:
            pass  # the server stops; asyncio of Python 3.11 would print a traceback
        finally:
            self._tcp_strangers.know(writer.transport)
            writer.close()
            del self._connections[task]

    async def _tcp_fault(self, lines: AsyncIterator[str]) -> str | None:
        """Why a TCP client may not join, else None; reads the token first if one is required."""
        if self.token is None:
            return None
        with suppress(ProtocolError, StopAsyncIteration, asyncio.TimeoutError):
            message = parse_json(
                await asyncio.wait_for(lines.__anext__(), TOKEN_SECONDS), "token", ProtocolError
            )
            if isinstance(message, dict) and self._is_token(message.get("token")):
                return None
        return 'send the token of this server first: {"token": "..."}'

    async def _close_web(self, server: Server) -> None:
        """Close port and connections; does not wait for connections that stay open."""
        for client in self.live.clients.values():
            client.leave()
        server.close()
        ended = asyncio.ensure_future(server.wait_closed())
        await asyncio.wait([ended], timeout=2.0 * CLOSE_SECONDS)
        await _cancelled(ended)

    async def _close_tcp(self, server: asyncio.Server) -> None:
        """Close port and connections; their tasks end as if the clients had disconnected."""
        server.close()
        for writer in self._connections.values():
            writer.transport.abort()
        if self._connections:
            await asyncio.wait(list(self._connections), timeout=CLOSE_SECONDS)
        for task in list(self._connections):
            await _cancelled(task)

    async def _attend(
        self,
        client: Client,
        messages: AsyncIterable[str | bytes],
        send: Callable[[str | bytes], Awaitable[None]],
        abort: Callable[[], None],
    ) -> ProtocolError | None:
        """Serve a client until it disconnects; returns the error for which it must be closed, else None."""

        def sent_all(_: asyncio.Task) -> None:
            if client.stalled:
                self.live.leave(client)  # its last requests may wait for their turns for long
                abort()
            elif client.let_go:  # after the last event is sent
                loop.call_later(CLOSE_SECONDS, abort)

        loop = asyncio.get_running_loop()
        pump = loop.create_task(client.pump(send))
        pump.add_done_callback(sent_all)
        try:
            async for message in messages:
                await self.live.take(client, message)
        except ProtocolError as error:
            client.end(error_event(error, closing=True))
            await asyncio.wait([pump])
            return error
        finally:
            self.live.leave(client)
            client.leave()
            await _cancelled(pump)
        return None

    async def _lines(self, reader: asyncio.StreamReader) -> AsyncIterator[str]:
        """Lines from a TCP client; raises ProtocolError for a line that is too long or not UTF-8."""
        while True:
            try:
                line = await reader.readuntil(b"\n")
            except (asyncio.IncompleteReadError, OSError):
                return
            except asyncio.LimitOverrunError:
                most = self.live.session.limits.message_bytes
                raise ProtocolError(f"expected lines of at most {most} bytes, found a longer one") from None
            try:
                yield line.decode("utf-8")
            except UnicodeDecodeError:
                raise ProtocolError("expected UTF-8 text, found other bytes") from None

    # ---- VMC ----

    async def _open_vmc(self, host: str, port: int) -> asyncio.DatagramTransport:
        loop, session = asyncio.get_running_loop(), self.live.session
        try:
            transport, _ = await loop.create_datagram_endpoint(
                asyncio.DatagramProtocol, remote_addr=(host, port)
            )
        except (OSError, ValueError) as error:
            raise ServeError(f"{host}:{port}: cannot send to this address ({_reason(error)})") from None
        kept = session.keep()
        bodies: dict[str, VmcBody] = {}

        def show(frame: WorldFrame) -> None:
            state = next((one for one in frame.characters if one.id == kept.id), None)
            if state is None:
                return
            if kept.body not in bodies:
                bodies[kept.body] = VmcBody(session.model.character(kept.body))
            for bundle in osc_bundles(bodies[kept.body].messages(state, frame.time)):
                transport.sendto(bundle)

        self.live.watchers.append(show)
        return transport


class _Connection(ServerConnection):
    """A connection that answers every HTTP method: websockets accepts only GET, or, in some versions, any method."""

    method: bytes | None = None
    _partial = b""
    _refused = False

    def __init__(self, strangers: Strangers, *words: Any, **options: Any) -> None:
        self._strangers = strangers
        super().__init__(*words, **options)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._strangers.meet(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._strangers.know(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self._refused:
            return
        if self.method is None:
            data = self._partial = self._partial + data
            if any(word.startswith(data) for word in METHODS):
                return  # the rest of the method is still to come
            if not data.startswith(METHODS):
                self._refuse()
                return
            self._partial = b""
            self.method = data.partition(b" ")[0]
            if self.method == b"HEAD":
                data = b"GET" + data[len(b"HEAD") :]
        super().data_received(data)

    def _refuse(self) -> None:
        self._refused = True
        assert isinstance(self.transport, asyncio.Transport)
        self.transport.write(_method_refused().serialize())
        # Keep reading for a while: otherwise the client might not get the answer.
        self.transport.write_eof()
        asyncio.get_running_loop().call_later(CLOSE_SECONDS, self.transport.abort)


class Strangers:
    """Connections that have not shown that they may join, oldest first; a new one displaces the oldest of too many."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._open: dict[asyncio.BaseTransport, None] = {}

    def meet(self, transport: asyncio.BaseTransport) -> None:
        """Count a new connection."""
        self._open[transport] = None
        if len(self._open) > self.most:
            oldest = next(iter(self._open))
            del self._open[oldest]
            assert isinstance(oldest, asyncio.Transport)
            oldest.abort()

    def know(self, transport: asyncio.BaseTransport) -> None:
        """Stop counting a connection: it has the token, or is closed."""
        self._open.pop(transport, None)


def _send_late(transport: asyncio.BaseTransport) -> None:
    """Limit the socket's buffers, so that a slow client gets new frames rather than old ones."""
    assert isinstance(transport, asyncio.WriteTransport)
    transport.set_write_buffer_limits(high=WAITING_BYTES)
    connection = transport.get_extra_info("socket")
    if hasattr(socketlib, "TCP_NOTSENT_LOWAT"):
        connection.setsockopt(socketlib.IPPROTO_TCP, socketlib.TCP_NOTSENT_LOWAT, WAITING_BYTES)


async def _read_away(reader: asyncio.StreamReader) -> None:
    while await reader.read(65536):
        pass


async def _cancelled(task: asyncio.Task) -> None:
    """Cancel a task and wait until it has ended."""
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


def _response(
    status: HTTPStatus,
    body: bytes | str,
    kind: str = "text/plain; charset=utf-8",
    more: dict[str, str] | None = None,
) -> Response:
    data = body if isinstance(body, bytes) else f"{body}\n".encode()
    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(data)),
            "Connection": "close",
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            **(more or {}),
        }
    )
    return Response(status.value, status.phrase, headers, data)


def _method_refused() -> Response:
    return _response(HTTPStatus.METHOD_NOT_ALLOWED, "use GET or HEAD", more={"Allow": "GET, HEAD"})


def _token_missing() -> Response:
    return _response(
        HTTPStatus.FORBIDDEN,
        "this server requires a token; use the full address that motionkit play printed",
    )


def reachable_name(host: str) -> str:
    """The host name for clients; an address of this machine if the server listens on all addresses."""
    if host not in ("", "0.0.0.0", "::"):
        return host
    family, away, here = (
        (socketlib.AF_INET6, "2001:db8::1", "::1")
        if host == "::"
        else (socketlib.AF_INET, "192.0.2.1", "127.0.0.1")
    )
    try:
        with socketlib.socket(family, socketlib.SOCK_DGRAM) as probe:
            probe.connect((away, 9))  # sends nothing; only looks up the route
            return str(probe.getsockname()[0])
    except OSError:
        return here


def _serve_error(host: str, port: int, option: str, error: OSError | ValueError) -> ServeError:
    number = getattr(error, "errno", None)
    if number == errno.EADDRINUSE:
        return ServeError(f"{host}:{port}: the port is in use; choose another with {option}")
    if number == errno.EACCES:
        return ServeError(f"{host}:{port}: no permission for this port; choose one above 1023 with {option}")
    return ServeError(f"{host}:{port}: cannot listen on this address ({_reason(error)})")


def _reason(error: OSError | ValueError) -> str:
    return getattr(error, "strerror", None) or str(error)


def _quiet_logger() -> logging.Logger:
    """A logger for the server's own errors; it drops reports of invalid HTTP."""
    logger = logging.getLogger("motionkit.play")
    logger.addFilter(_is_ours)
    return logger


def _is_ours(record: logging.LogRecord) -> bool:
    return "opening handshake failed" not in record.getMessage()
