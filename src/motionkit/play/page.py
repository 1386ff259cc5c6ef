"""Checks of HTTP requests: access, and the resource they name. Request paths never become file names."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Collection

from motionkit.play.recording import Recordings

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
_HOST = re.compile(r"(?:\[([0-9A-Fa-f:.]+)\]|([^\s:;\[\]]+))(?::\d{1,5})?")
_RECORDING = re.compile(r"/recordings/([A-Za-z0-9_-]{1,64}\.([a-z]{3,4}))")
_FIGURE = re.compile(r"/figures/(\d{1,4})")
_CONTENT = {
    "bvh": "text/plain; charset=utf-8",
    "glb": "model/gltf-binary",
    "vrma": "model/gltf-binary",
    "usda": "text/plain; charset=utf-8",
    "csv": "text/csv; charset=utf-8",
}


def policy(host: str) -> str:
    """The content security policy of the page, which is self-contained and connects only to this server."""
    return (
        "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'unsafe-inline'; "
        f"img-src data: blob:; connect-src 'self' blob: data: ws://{host}; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )


def host_name(host: str) -> str:
    """The name in a Host header, without port and IPv6 brackets; empty if the header is invalid."""
    match = _HOST.fullmatch(host)
    return "" if match is None else (match[1] or match[2]).lower()


def is_loopback(address: str) -> bool:
    """Whether only this machine can reach a listening address."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address.lower() == "localhost"


def known_names(listens_on: str) -> frozenset[str]:
    """The host names of this server, besides numeric addresses."""
    names = LOOPBACK_NAMES | {listens_on.lower()}
    return names if is_loopback(listens_on) else names | {socket.gethostname().lower()}


def host_allowed(host: str, names: Collection[str], numbers: bool) -> bool:
    """Whether a Host header names this server.

    A foreign web page can point its own name to this machine (DNS rebinding), but not a numeric address.
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
    """Whether an origin may open a WebSocket: the page itself, or a program (which sends no Origin)."""
    return origin is None or origin.lower() in (f"http://{host}".lower(), f"https://{host}".lower())


def find_recording(path: str, recordings: Recordings) -> tuple[bytes, str, str] | None:
    """The recording that a request path names, its content type and a file name; else None."""
    match = _RECORDING.fullmatch(path)
    found = None if match is None else recordings.get(match[1])
    if match is None or found is None:
        return None
    return found, _CONTENT.get(match[2], "application/octet-stream"), f"motionkit-recording.{match[2]}"


def figure_number(path: str) -> int | None:
    """The number of the body whose mesh a request path names, else None."""
    match = _FIGURE.fullmatch(path)
    return None if match is None else int(match[1])
