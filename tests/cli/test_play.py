"""`motionkit play` as a separate process."""

from __future__ import annotations

import json
import logging
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from motionkit.cli.play import _visible_log
from synthetic_characters import CHARACTERS, skinned

COMMAND = [sys.executable, "-m", "motionkit", "play", "--no-open"]
PATIENCE = 150  # seconds; starting takes long on a slow and busy machine


@pytest.fixture
def play(tiny_model_file: Path) -> Iterator[Callable[..., subprocess.Popen]]:
    """A function that starts the command; a process left over is killed after the test."""
    with ExitStack() as stack:

        def start(*words: str) -> subprocess.Popen:
            command = [*COMMAND, "--model", str(tiny_model_file), *words]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        yield start


def addresses(process: subprocess.Popen) -> dict[str, Any]:
    assert process.stdout is not None
    return json.loads(process.stdout.readline())


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="Windows has no SIGINT for other processes")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_stopped(play: Callable, number: signal.Signals) -> None:
    process = play("--port", "0", "--tcp", "0", "--headless", "--json")
    told = addresses(process)
    assert told["url"].startswith("http://127.0.0.1:") and told["vmc"] is None
    with socket.create_connection(tuple(told["tcp"]), PATIENCE) as client, client.makefile("r") as lines:
        assert json.loads(lines.readline())["event"] == "hello"
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert err.strip().splitlines()[-1] == "stopped" and "Traceback" not in err and out == ""


@pytest.mark.parametrize(
    ("name", "words", "kind"),
    [("a.glb", (), "glb"), ("a.VRM", (), "vrm"), ("a.glb", ("--format", "bvh"), "bvh")],
)
def test_recordings_are_the_character_by_default(
    play: Callable, tmp_path: Path, name: str, words: tuple[str, ...], kind: str
) -> None:
    (tmp_path / name).write_bytes(skinned(CHARACTERS["vrm1"]()))
    options = ("--port", "0", "--tcp", "0", "--headless", "--json", "--rig", str(tmp_path / name))
    told = addresses(play(*options, *words))
    with socket.create_connection(tuple(told["tcp"]), PATIENCE) as client, client.makefile("r") as lines:
        assert json.loads(lines.readline())["recording_format"] == kind


def test_formats_that_cannot_be_recorded_are_refused_at_once(motionkit, tmp_path: Path) -> None:
    """Blender writes FBX, in seconds; a .glb without a humanoid part is no avatar."""
    (tmp_path / "a.glb").write_bytes(skinned(CHARACTERS["plain"]()))
    for form, said in (("fbx", "'fbx' is not one of"), ("vrm", "--format vrm takes an avatar")):
        refused = motionkit("play", "--headless", "--port", 0, "--rig", "a.glb", "--format", form)
        assert refused.code == 2 and said in refused.err


@pytest.mark.parametrize("option", ["--port", "--tcp"])
def test_a_port_in_use_is_one_line(play: Callable, option: str) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = [option, str(port)] + ([] if option == "--port" else ["--port", "0"])
        process = play(*words)
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1 and out == ""
    assert err == f"error: 127.0.0.1:{port}: the port is in use; choose another with {option}\n"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--vmc", "39539"], 2, "expected HOST:PORT such as 127.0.0.1:39539, found '39539'"),
        (["--vmc", "localhost:99999"], 2, "expected HOST:PORT"),
        (["--port", "70000"], 2, "70000"),
        (["--character", "giant", "--port", "0"], 1, "unknown character 'giant'"),
        (["--host", "192.0.2.1", "--port", "0"], 1, "192.0.2.1:0: cannot listen on"),
        (["--host", "a" * 300, "--port", "0"], 1, "cannot listen on"),
        (["--vmc", "a" * 300 + ":80", "--port", "0"], 1, "cannot send to"),
        (["--host", "\x1b[31mred", "--port", "0"], 1, "\\x1b[31mred:0: cannot listen on"),
        (["--model", "nowhere.safetensors"], 2, "nowhere.safetensors"),
    ],
)
def test_what_cannot_be_served(
    motionkit: Callable, tiny_model_file: Path, words: list[str], code: int, said: str
) -> None:
    model = [] if "--model" in words else ["--model", str(tiny_model_file)]
    outcome = motionkit("play", "--no-open", *model, *words)
    assert outcome.code == code and said in outcome.err and "Traceback" not in outcome.err
    assert code == 2 or outcome.failed_with(said)


def test_without_websockets_it_says_what_to_install(
    motionkit: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "websockets", None)
    assert motionkit("play", "--no-open").failed_with("pip install 'motionkit[play]'")


def test_what_clients_sent_is_harmless_in_the_log(capsys: pytest.CaptureFixture[str]) -> None:
    with _visible_log():
        try:
            raise ValueError("\x1b]0;owned\x07\x9b31m")
        except ValueError:
            logging.getLogger("motionkit.play").error("fault of \x1b[31m%s", "\x1b[2J", exc_info=True)
    told = capsys.readouterr().err
    assert "Traceback" in told and "owned" in told
    assert not any(letter in told for letter in "\x1b\x07\x9b")
