"""What the server answers to plain HTTP: its page and recordings. Requests never name files."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Collection
from pathlib import Path

from motionkit.apps.play.recording import Recordings

PAGE = Path(__file__).resolve().parents[2] / "assets" / "web" / "play.html"
LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
_RECORDING = re.compile(r"/recordings/([A-Za-z0-9_-]{1,64})\.bvh")
_HEADERLESS_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>motionkit play</title>
<body style="font: 16px/1.5 sans-serif; max-width: 40em; margin: 3em auto">
<h1>motionkit play</h1>
<p>The live session is running. This installation has no page for it; programs connect by WebSocket to
<code>/live</code> on this address, as docs/live.md tells.</p>
"""


def load_page() -> bytes:
    """The page as it is served."""
    return PAGE.read_bytes() if PAGE.is_file() else _HEADERLESS_PAGE.encode()


def policy(host: str) -> str:
    """The content security policy of the page: all it needs is in it, and it talks to this server only."""
    return (
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
        f"img-src data: blob:; connect-src 'self' ws://{host}; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )


def host_name(host: str) -> str:
    """The name in a Host header, without its port; brackets of IPv6 addresses taken off."""
    if host.startswith("["):
        return host[1:].partition("]")[0].lower()
    return host.partition(":")[0].lower()


def is_loopback(address: str) -> bool:
    """Whether an address to listen on reaches this machine only."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address.lower() == "localhost"


def known_names(listens_on: str) -> frozenset[str]:
    """Names this server goes by, beside the numbers of its addresses."""
    names = LOOPBACK_NAMES | {listens_on.lower()}
    return names if is_loopback(listens_on) else names | {socket.gethostname().lower()}


def host_allowed(host: str, names: Collection[str], numbers: bool) -> bool:
    """Whether a Host header names this server.

    A web page elsewhere can make its own name point here (DNS rebinding), but not an address in numbers.
    """
    name = host_name(host)
    if name in names:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return numbers


def origin_allowed(origin: str | None, host: str) -> bool:
    """Whether a WebSocket may be opened from an origin: the page itself, or a program, which sends none."""
    return origin is None or origin.lower() in (f"http://{host}".lower(), f"https://{host}".lower())


def find_recording(path: str, recordings: Recordings) -> bytes | None:
    """The file a path asks for, if it is one of the recordings."""
    match = _RECORDING.fullmatch(path)
    return None if match is None else recordings.get(match.group(1))
