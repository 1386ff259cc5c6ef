from __future__ import annotations

import pytest

from motionkit.play.page import figure_number, host_allowed, known_names, origin_allowed


@pytest.mark.parametrize(
    ("listens_on", "host", "allowed"),
    [
        ("127.0.0.1", "127.0.0.1:8642", True),
        ("127.0.0.1", "localhost:8642", True),
        ("127.0.0.1", "LOCALHOST", True),
        ("127.0.0.1", "localhost:9000", True),  # a forwarded port
        ("127.0.0.1", "[::1]:8642", True),
        ("127.0.0.1", "evil.example:8642", False),
        ("127.0.0.1", "localhost.evil.example", False),
        ("127.0.0.1", "127.0.0.1.evil.example", False),
        ("127.0.0.1", "192.168.1.7:8642", False),
        ("127.0.0.1", "", False),
        ("127.0.0.1", "[::1", False),
        ("127.0.0.1", "[::1]evil.example", False),
        ("127.0.0.1", "localhost:", False),
        ("127.0.0.1", "localhost:80; script-src *", False),
        ("127.0.0.1", "localhost;x", False),
        ("127.0.0.1", "user@localhost", False),
        ("::1", "[::1]:8642", True),
        ("0.0.0.0", "192.168.1.7:8642", True),
        ("0.0.0.0", "[fe80::1]:8642", True),
        ("0.0.0.0", "evil.example", False),
        ("studio.local", "studio.local:8642", True),
        ("studio.local", "other.local:8642", False),
    ],
)
def test_hosts(listens_on: str, host: str, allowed: bool) -> None:
    numbers = not listens_on.startswith(("127.", "::1"))
    assert host_allowed(host, known_names(listens_on), numbers) == allowed


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        (None, True),
        ("http://localhost:8642", True),
        ("https://localhost:8642", True),
        ("http://localhost:8643", False),
        ("http://localhost", False),
        ("http://evil.example", False),
        ("null", False),
        ("", False),
        ("http://localhost:8642.evil.example", False),
    ],
)
def test_origins(origin: str | None, allowed: bool) -> None:
    assert origin_allowed(origin, "localhost:8642") == allowed


@pytest.mark.parametrize(
    ("path", "number"),
    [
        ("/figures/0", 0),
        ("/figures/28", 28),
        ("/figures/", None),
        ("/figures/-1", None),
        ("/figures/0/", None),
        ("/figures/00000", None),
        ("/figures/../0", None),
    ],
)
def test_figures(path: str, number: int | None) -> None:
    assert figure_number(path) == number
