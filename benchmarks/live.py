"""Latency of `motionkit play`: the step, a key to its first frame on loopback, and a key to the response.

    python benchmarks/live.py [--model FILE] [--presses 60] [--repeats 2] [--characters 1 4 8] [--no-browser]

The server runs as a process of its own and is asked over TCP, as a program would; then its page is opened in headless
Chromium (through playwright), which draws in software: what it reaches is a lower bound for browsers with a graphics
card. motionkit.lab.scoreboard.response defines the response; the baseline is the 0.7 s that the paper reports
for its own demo.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np
from common import percentiles, print_table

from motionkit.control.drive import Wish
from motionkit.lab.scoreboard.response import (
    AFTER_SECONDS,
    BEFORE_SECONDS,
    Command,
    commands,
    response_seconds,
)
from motionkit.metrics.body import Body
from motionkit.models.bundled import open_model
from motionkit.models.model import MotionModel
from motionkit.play.requests import Request
from motionkit.play.session import Session

PAPER_SECONDS = 0.7
MOST_DELAY_MS, MOST_RESPONSE_SECONDS = 50.0, 0.5
WARM_UP = 60  # frames
PATIENCE = 60.0  # seconds
PAGE_SIZE = {"width": 1280, "height": 720}
DRAWN_SECONDS = 5.0  # for which drawn frames are counted
SOFTWARE = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
AT_ONCE = 4  # characters that get commands at the same time


class Client:
    """A TCP client whose thread records when each frame arrives."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.lines = self.socket.makefile("r", encoding="utf-8")
        self.hello = json.loads(self.lines.readline())
        self.frames: list[tuple[float, dict[str, Any]]] = []
        self.arrived = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            for line in self.lines:
                now = time.perf_counter()
                event = json.loads(line)
                if event["event"] == "error":
                    print(f"the server says: {event['message']}", file=sys.stderr)
                if event["event"] == "frame":
                    with self.arrived:
                        self.frames.append((now, event))
                        self.arrived.notify_all()
        except OSError:
            pass

    def ask(self, **request: Any) -> float:
        """Send a request and return the time."""
        data = json.dumps(request).encode() + b"\n"
        now = time.perf_counter()
        self.socket.sendall(data)
        return now

    def wish(self, wish: Wish, character: int, seq: int) -> float:
        """Send a wish."""
        velocity = None if wish.velocity is None else list(wish.velocity)
        return self.ask(
            do="wish", character=character, velocity=velocity, facing=wish.facing, type=wish.type, seq=seq
        )

    def first_frame(self, seq: int) -> float:
        """Return when the first frame arrived that includes a request."""
        with self.arrived:
            while not (self.frames and self.frames[-1][1]["characters"][0]["seq"] == seq):
                if not self.arrived.wait(PATIENCE):
                    raise SystemExit(f"no frame came within {PATIENCE:g} s")
            return self.frames[-1][0]

    def characters(self, least: int) -> list[int]:
        """Return the ids of the characters in the newest frame, once there are this many."""
        with self.arrived:
            while not self.frames or len(self.frames[-1][1]["characters"]) < least:
                if not self.arrived.wait(PATIENCE):
                    raise SystemExit(f"no frame came within {PATIENCE:g} s")
            return [c["id"] for c in self.frames[-1][1]["characters"]]

    def close(self) -> None:
        """Close the connection."""
        self.socket.shutdown(socket.SHUT_RDWR)
        self.socket.close()


@contextmanager
def server(model: str | None) -> Iterator[dict[str, Any]]:
    """Run a server and yield its addresses."""
    command = [sys.executable, "-m", "motionkit", "play", "--no-open", "--port", "0", "--tcp", "0", "--json"]
    command += ["--model", model] if model else []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            raise SystemExit("the server did not start")
        try:
            yield json.loads(line)
        finally:
            process.terminate()


def step_times(model: MotionModel, count: int, frames: int) -> list[float]:
    """Return the seconds of each step of a session with this many running characters."""
    session = Session(model)
    fields = {"character": None, "velocity": (0.0, 300.0), "facing": None, "type": None, "seq": 0}
    for client in range(count):
        session.join(client)
        session.obey(client, Request("wish", fields))
    return [session.step().step_ms / 1000.0 for _ in range(WARM_UP + frames)][WARM_UP:]


def key_delays(client: Client, presses: int) -> list[float]:
    """Return the seconds from a key, pressed at random moments, to the first frame that includes it."""
    generator = random.Random(0)
    mine = client.hello["character"]
    out = []
    for seq in range(1, presses + 1):
        time.sleep(generator.uniform(0.05, 0.12))
        speed = generator.choice([0.0, 120.0, 300.0])
        pressed = client.wish(Wish((0.0, speed)), mine, seq)
        out.append(client.first_frame(seq) - pressed)
    return out


def frame_gaps(client: Client, seconds: float) -> list[float]:
    """Return the seconds between arriving frames."""
    first = len(client.frames)
    time.sleep(seconds)
    times = [when for when, _ in client.frames[first:]]
    return [b - a for a, b in pairwise(times)]


def responses(port: int, wanted: Sequence[Command], fps: float) -> list[float]:
    """Return the seconds from each command's key to the arrival of the frame from which the motion responds."""
    out: list[float] = []
    client = Client(port)
    room = min(AT_ONCE, int(client.hello["limits"]["characters"]))
    for first in range(0, len(wanted), room):
        some = wanted[first : first + room]
        for _ in range(len(some) - len(client.characters(1))):
            client.ask(do="add")
        ids = client.characters(len(some))[: len(some)]
        for number, command in zip(ids, some, strict=True):
            client.wish(command.before, number, 1)
        time.sleep(BEFORE_SECONDS)
        start = len(client.frames)
        pressed = [client.wish(command.after, number, 2) for number, command in zip(ids, some, strict=True)]
        time.sleep(AFTER_SECONDS + 0.5)
        for number, command, when in zip(ids, some, pressed, strict=True):
            out.append(_response(client.frames[start:], number, command, when, fps))
    client.close()
    return out


def _response(
    frames: list[tuple[float, dict]], number: int, command: Command, pressed: float, fps: float
) -> float:
    shown = [next(c for c in event["characters"] if c["id"] == number) for _, event in frames]
    body = Body(
        np.array([c["rotations"] for c in shown]),
        np.array([c["positions"] for c in shown]),
        np.array([c["heading"] for c in shown]),
        fps,
    )
    seconds = response_seconds(command.answers(body), fps)
    return AFTER_SECONDS if seconds is None else frames[round(seconds * fps)][0] - pressed


def in_browser(url: str, presses: int) -> tuple[float, list[float]] | None:
    """Return drawn frames per second of a running character, and seconds from keys to the first drawn frame with them.

    None where there is no Chromium or no playwright.
    """
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    if chromium is None:
        return None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=SOFTWARE)
        page = browser.new_context(viewport=PAGE_SIZE, bypass_csp=True).new_page()
        page.goto(url)
        page.wait_for_function("motionkit.own?.root", timeout=1000 * PATIENCE)
        page.keyboard.down("Shift")
        page.keyboard.down("w")
        page.wait_for_timeout(2000)  # without a graphics card the page needs a while to choose its resolution
        count = "[motionkit.stage.frames, performance.now()]"
        (first, began), _ = page.evaluate(count), page.wait_for_timeout(1000 * DRAWN_SECONDS)
        last, ended = page.evaluate(count)
        page.keyboard.up("Shift")
        generator = random.Random(0)
        times: list[float] = []
        for n in range(presses):
            page.wait_for_timeout(generator.uniform(50, 120))
            page.wait_for_function(
                "!motionkit.waiting.length && !motionkit.answered", timeout=1000 * PATIENCE
            )
            page.evaluate("motionkit.responses.length = 0")
            (page.keyboard.up if n % 2 == 0 else page.keyboard.down)("w")
            page.wait_for_function("motionkit.responses.length", timeout=1000 * PATIENCE)
            times.append(page.evaluate("motionkit.responses[0]") / 1000.0)
        browser.close()
    return 1000.0 * (last - first) / (ended - began), times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", help="a model file; the bundled model by default")
    parser.add_argument("--characters", type=int, nargs="+", default=[1, 4, 8])
    parser.add_argument("--frames", type=int, default=600, help="timed steps per number of characters")
    parser.add_argument("--presses", type=int, default=60, help="number of key presses to time")
    parser.add_argument("--repeats", type=int, default=2, help="repeats of each command")
    parser.add_argument("--no-browser", action="store_true", help="skip the page")
    arguments = parser.parse_args()
    model = open_model(arguments.model)
    budget = 1000.0 / model.fps
    rows, alone = [], None
    for count in arguments.characters:
        p50, p95, p99 = (1000.0 * p for p in percentiles(step_times(model, count, arguments.frames)))
        alone = alone or (count, p50, p99)
        rows.append([str(count), f"{p50:.2f}", f"{p95:.2f}", f"{p99:.2f}", f"{budget / p50:.1f}"])
    title = f"server step of a whole session, ms; ratio: frame time at {model.fps:g} fps ({budget:.1f} ms) over p50"
    print_table(title, ["characters", "p50", "p95", "p99", "ratio"], rows)
    seen = None
    with server(arguments.model) as told:
        client = Client(told["tcp"][1])
        time.sleep(1.0)
        gaps = [1000.0 * p for p in percentiles(frame_gaps(client, 5.0))]
        delays = [1000.0 * p for p in percentiles(key_delays(client, arguments.presses))]
        client.close()
        kinds = [c for c in commands(model) for _ in range(arguments.repeats)]
        obeyed = responses(told["tcp"][1], kinds, model.fps)
        if not arguments.no_browser:
            seen = in_browser(told["url"], arguments.presses)
            if seen is None:
                print("no Chromium or no playwright: the page is skipped", file=sys.stderr)
    rows = [
        ["between arriving frames", *(f"{p:.1f}" for p in gaps), f"{budget:.1f}"],
        ["key to its first frame", *(f"{p:.1f}" for p in delays), f"at most {MOST_DELAY_MS:g}"],
    ]
    print_table("one client on loopback, ms", ["what", "p50", "p95", "p99", "target"], rows)
    if gaps[0] > 1.1 * budget:
        print(f"the machine did not reach {model.fps:g} fps: these figures show its load")
    rows, every = [], []
    for number in range(0, len(kinds), arguments.repeats):
        times = obeyed[number : number + arguments.repeats]
        mean = sum(times) / len(times)
        every.extend(times)
        rows.append([kinds[number].name, f"{mean:.2f}", f"{max(times):.2f}", f"{PAPER_SECONDS / mean:.1f}"])
    middle = statistics.median(every)
    rows.append(["median of all", f"{middle:.2f}", f"{max(every):.2f}", f"{PAPER_SECONDS / middle:.1f}"])
    title = (
        f"key to response, s; target at most {MOST_RESPONSE_SECONDS:g}; no response counts as {AFTER_SECONDS:g} s; "
        f"ratio: {PAPER_SECONDS:g} s over the mean"
    )
    print_table(title, ["command", "mean", "slowest", "ratio"], rows)
    assert alone is not None
    count, step50, step99 = alone
    rows = [
        _short(f"server step, {count} character(s), ms", step50, step99, budget, budget / step50),
        _short(
            "key to first changed frame, ms", delays[0], delays[2], MOST_DELAY_MS, MOST_DELAY_MS / delays[0]
        ),
    ]
    if seen is not None:
        drawn, shown = seen[0], [1000.0 * p for p in percentiles(seen[1])]
        rows += [
            _short(
                "key to first changed picture, ms",
                shown[0],
                shown[2],
                MOST_DELAY_MS,
                MOST_DELAY_MS / shown[0],
            ),
            _short("pictures drawn a second", drawn, None, model.fps, drawn / model.fps),
        ]
    slowest = percentiles(every)[2]
    rows.append(
        _short("key to response, s", middle, slowest, MOST_RESPONSE_SECONDS, MOST_RESPONSE_SECONDS / middle)
    )
    rows.append(
        _short("key to obeyed, s, beside the paper", middle, slowest, PAPER_SECONDS, PAPER_SECONDS / middle)
    )
    print_table(
        "in short; the ratio is above 1 where it is better", ["what", "p50", "p99", "wanted", "ratio"], rows
    )


def _short(what: str, p50: float, p99: float | None, wanted: float, ratio: float) -> list[str]:
    """Return a row of the last table."""
    return [what, f"{p50:.2f}", "" if p99 is None else f"{p99:.2f}", f"{wanted:.4g}", f"{ratio:.2f}"]


if __name__ == "__main__":
    main()
