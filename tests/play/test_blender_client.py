"""The live part of the Blender add-on, without Blender, against a server."""

from __future__ import annotations

import importlib.util
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from motionkit.motion.skeleton import canonical_skeleton, leg_length
from motionkit.play.limits import Limits
from play.conftest import PATIENCE

ADDON = Path(__file__).resolve().parents[2] / "integrations" / "blender" / "motionkit_blender.py"
READ_EVERY = 0.005  # seconds


@pytest.fixture
def addon(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The add-on as a module; Blender's own modules are stand-ins."""
    bases = SimpleNamespace(PropertyGroup=object, Operator=object, Panel=object, Object=object)
    monkeypatch.setitem(sys.modules, "bpy", MagicMock(types=bases))  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "mathutils", MagicMock())
    spec = importlib.util.spec_from_file_location("motionkit_blender", ADDON)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def live(addon: ModuleType) -> Iterator[Callable[..., Any]]:
    """A function that connects the add-on to a port."""
    made = []

    def connect(port: int, **options: Any) -> Any:
        made.append(addon.LiveClient(port, **options))
        return made[-1]

    yield connect
    for client in made:
        client.close()


@pytest.mark.parametrize(
    ("system", "command", "words"),
    [
        ("posix", "python -m motionkit", ["python", "-m", "motionkit"]),
        ("posix", "'/opt/my tools/motionkit'", ["/opt/my tools/motionkit"]),
        ("nt", r"C:\venv\Scripts\motionkit.exe", [r"C:\venv\Scripts\motionkit.exe"]),
        ("nt", r'"C:\My Tools\python.exe" -m motionkit', [r"C:\My Tools\python.exe", "-m", "motionkit"]),
    ],
)
def test_the_command_may_be_a_path_of_any_system(
    addon: ModuleType, monkeypatch: pytest.MonkeyPatch, system: str, command: str, words: list[str]
) -> None:
    monkeypatch.setattr(addon, "os", SimpleNamespace(name=system))
    assert addon.command_words(command) == words


def until(client: Any, holds: Callable[[dict], bool] = lambda _: True) -> dict[str, Any]:
    """The next character shown that meets a condition."""
    ends = time.monotonic() + PATIENCE
    while time.monotonic() < ends:
        shown = client.newest()
        if shown is not None and holds(shown):
            return shown
        time.sleep(READ_EVERY)
    raise AssertionError("nothing of the kind was shown")


def test_it_shows_whom_somebody_steers_and_its_own_character_only_where_alone(
    serve: Callable, live: Callable, tcp: Callable
) -> None:
    server = serve(tcp=0)
    client = live(server.addresses.tcp[1])
    own = until(client)["id"]
    assert own == client.hello["character"] and len(client.hello["joints"]) == 23
    other = tcp(server)
    other.ask(do="wish", velocity=[0, 300], seq=4)
    shown = until(client, lambda one: one["id"] == other.hello["character"] and one["seq"] == 4)
    assert len(shown["rotations"]) == len(shown["positions"]) == 23
    other.file.close()
    other.socket.close()
    until(client, lambda one: one["id"] == own)


def test_one_that_connects_last_shows_the_first(serve: Callable, live: Callable, tcp: Callable) -> None:
    server = serve(tcp=0)
    other = tcp(server)
    assert until(live(server.addresses.tcp[1]))["id"] == other.hello["character"]


def test_one_without_a_character_of_its_own(serve: Callable, live: Callable, tcp: Callable) -> None:
    server = serve(tcp=0, limits=Limits(characters=1))
    other = tcp(server)
    client = live(server.addresses.tcp[1])
    assert until(client)["id"] == other.hello["character"] and client.hello["character"] is None


def test_after_a_pause_the_newest_frame_is_shown(serve: Callable, live: Callable, tcp: Callable) -> None:
    server = serve(tcp=0)
    other = tcp(server)
    client = live(server.addresses.tcp[1])
    until(client)
    time.sleep(1.0)  # as while Blender is busy
    for seq in (1, 2):
        other.ask(do="wish", seq=seq)
        other.until("frame", lambda f, seq=seq: f["characters"][0]["seq"] == seq)
    time.sleep(0.3)
    read = 0

    def is_last(one: dict) -> bool:
        nonlocal read
        read += 1
        return one["seq"] == 2

    until(client, is_last)
    assert read <= 10, "not the frames of the pause one after another"


def test_nothing_waits_where_nothing_comes(live: Callable, addon: ModuleType) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        now = 0.0
        client = live(silent.getsockname()[1], clock=lambda: now)
        assert client.newest() is None
        now = addon.PATIENCE + 1.0
        with pytest.raises(OSError, match="no frame for 15 s"):
            client.newest()


@pytest.mark.parametrize("answer", [b"SSH-2.0\r\n", b"[1]\n", b'{"event": "frame"}\n', b"\xff\n"])
def test_something_else_answers(live: Callable, answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        client = live(stranger.getsockname()[1])
        other, _ = stranger.accept()
        with other:
            other.sendall(answer)
            with pytest.raises(OSError, match="something other"):
                until(client)


def test_a_frame_that_comes_in_pieces(live: Callable) -> None:
    hello = b'{"event": "hello", "character": 1, "limits": {"idle_seconds": 60}}\n'
    frame = b'{"event": "frame", "characters": [{"id": 1, "seq": 7}]}\n'
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = live(server.getsockname()[1])
        other, _ = server.accept()
        with other:
            other.sendall(hello + frame + frame[:20])
            assert until(client) == {"id": 1, "seq": 7}
            assert client.newest() is None
            other.sendall(frame[20:])
            assert until(client) == {"id": 1, "seq": 7}


def test_no_room(serve: Callable, live: Callable, tcp: Callable) -> None:
    server = serve(tcp=0, limits=Limits(clients=1))
    tcp(server)
    with pytest.raises(OSError, match="too many clients"):
        until(live(server.addresses.tcp[1]))


def test_a_ping_keeps_its_place(serve: Callable, live: Callable) -> None:
    server = serve(tcp=0, limits=Limits(idle_seconds=30.0))
    now = 0.0
    client = live(server.addresses.tcp[1], clock=lambda: now)
    until(client)
    (heard,) = server.ask(lambda: [each.heard for each in server.server.live.clients.values()])
    until(client)
    assert server.ask(lambda: [each.heard for each in server.server.live.clients.values()]) == [heard]
    now = 11.0
    until(client)
    server.wait_until(lambda: all(each.heard > heard for each in server.server.live.clients.values()))


def operator(addon: ModuleType, port: int, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any]:
    """The running operator, and the context it runs in."""
    monkeypatch.setattr(addon, "selected_armature", lambda _: "armature")
    context = MagicMock()
    context.scene.motionkit.port = port
    made = addon.MOTIONKIT_OT_live()
    made.report = MagicMock()
    made.began = made.execute(context)
    return made, context


def test_the_operator_shows_frames_and_stops_when_the_server_ends(
    addon: ModuleType, serve: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[Any] = []
    monkeypatch.setattr(addon, "pose", lambda *told: shown.append(told))
    server = serve(tcp=0)
    made, context = operator(addon, server.addresses.tcp[1], monkeypatch)
    assert made.began == {"RUNNING_MODAL"}
    tick = SimpleNamespace(type="TIMER")
    ends = time.monotonic() + PATIENCE
    while not shown and time.monotonic() < ends:
        assert made.modal(context, tick) == {"PASS_THROUGH"}
        time.sleep(READ_EVERY)
    armature, skeleton, character = shown[0]
    assert armature == "armature" and len(skeleton["joints"]) == len(character["rotations"]) == 23
    server.ask(lambda: [writer.transport.abort() for writer in server.server._connections.values()])
    while (state := made.modal(context, tick)) == {"PASS_THROUGH"} and time.monotonic() < ends:
        time.sleep(READ_EVERY)
    assert state == {"CANCELLED"} and made.client._socket.fileno() == -1
    context.window_manager.event_timer_remove.assert_called_once_with(made.timer)
    ((kind, said), _) = made.report.call_args
    assert kind == {"ERROR"} and said.startswith("live mode has stopped: ")


def test_escape_ends_the_operator(
    addon: ModuleType, serve: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve(tcp=0)
    made, context = operator(addon, server.addresses.tcp[1], monkeypatch)
    assert made.modal(context, SimpleNamespace(type="ESC")) == {"FINISHED"}
    context.window_manager.event_timer_remove.assert_called_once_with(made.timer)
    made.report.assert_not_called()
    server.wait_until(lambda: not server.server.live.clients)


def test_the_operator_says_where_nothing_listens(addon: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    made, _ = operator(addon, port, monkeypatch)
    assert made.began == {"CANCELLED"}
    ((_, said), _) = made.report.call_args
    assert said.startswith(f"no motionkit play --tcp {port}: ")


def test_the_length_of_canonical_legs(addon: ModuleType) -> None:
    assert addon.LEG == pytest.approx(leg_length(canonical_skeleton()) / 100.0, abs=0.0001)
