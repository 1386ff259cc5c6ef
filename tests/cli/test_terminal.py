"""The commands in a real terminal: bars, widths, Ctrl-C, and names with control characters."""

from __future__ import annotations

import os
import re
import select
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from motionkit.cli.main import main
from motionkit.names import visible

from .test_mirror import RIG

pytestmark = pytest.mark.thorough

pty = pytest.importorskip("pty")
fcntl = pytest.importorskip("fcntl")
termios = pytest.importorskip("termios")

CONTROL_SEQUENCE = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")
LONG_MOTION = RIG.replace("Frames: 2", "Frames: 40") + RIG.splitlines()[-1].join(["", "\n"]) * 38


def open_terminal(columns: int) -> tuple[int, int]:
    """Both ends of a pseudo-terminal of this width."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    return ours, theirs


@contextmanager
def standard_streams_in(terminal: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Connect the streams of this process to a terminal."""
    kept = [os.dup(number) for number in range(3)]
    for number in range(3):
        os.dup2(terminal, number)
    with (
        open(1, "w", closefd=False) as out,
        open(2, "w", closefd=False) as err,
        monkeypatch.context() as patch,
    ):
        patch.setattr(sys, "stdout", out)
        patch.setattr(sys, "stderr", err)
        try:
            yield
        finally:
            out.flush()
            err.flush()
            for number, saved in enumerate(kept):
                os.dup2(saved, number)
                os.close(saved)


@pytest.fixture
def in_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """A function that runs a command in tmp_path in a terminal: in_terminal(80, "view", ...), exit code and text."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("CI", "true")  # opens no browser
    for name in ("COLUMNS", "NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)

    def run(columns: int, *words: object) -> tuple[int, str]:
        ours, theirs = open_terminal(columns)
        said: list[bytes] = []
        over = threading.Event()
        reader = threading.Thread(target=lambda: said.extend(_read(ours, over)))
        reader.start()
        code = 0
        with standard_streams_in(theirs, monkeypatch):
            monkeypatch.setattr(sys, "argv", ["motionkit", *map(str, words)])
            try:
                main()
            except SystemExit as stop:
                code = int(stop.code or 0)
        over.set()
        reader.join()
        os.close(theirs)
        os.close(ours)
        return code, b"".join(said).decode("utf-8")

    return run


def _read(terminal: int, over: threading.Event) -> Iterator[bytes]:
    """What is written to a terminal until a command is over.

    Its other end may stay open: a helper that multiprocessing starts keeps its standard error to the end of the tests.
    """
    while True:
        last = over.is_set()
        if select.select([terminal], [], [], 0.05)[0]:
            yield os.read(terminal, 65536)
        elif last:
            return


def drawn_lines(text: str) -> list[str]:
    """The text written to each line of a terminal, overwritten text included."""
    return re.split(r"[\r\n]+", CONTROL_SEQUENCE.sub("", text))


def bars(text: str) -> list[str]:
    """The lines that show a bar."""
    return [line for line in drawn_lines(text) if "━" in line or "╺" in line]


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    (tmp_path / "clip.bvh").write_text(LONG_MOTION)
    return tmp_path / "clip.bvh"


@pytest.mark.parametrize("columns", [80, 40])
@pytest.mark.parametrize(
    ("words", "stage"),
    [
        (["view", "CLIP", "-o", "x.gif", "--width", 160], "drawing"),
        (["view", "CLIP", "-o", "x.mp4", "--width", 160], "drawing"),
        (["mirror", "FOLDER", "out"], "working"),
        (["preprocess", "CLIPS", "-o", "ds", "--jobs", 1], "reading"),
        (["synthesize", "--model", "MODEL", "--types", "idle:0.5"], "synthesizing"),
        (["synthesize", "--model", "MODEL", "--types", "idle:0.1", "--count", 3], "writing"),
        (["follow-path", "line", "--model", "MODEL", "--size", 0.2], "following"),
        (["evaluate", "MODEL", "DATASET", "--quick", "--only", "reconstruction"], "reconstruction"),
        (["metrics", "CLIPS"], "measuring"),
    ],
)
def test_every_bar_fits_and_is_taken_away(
    in_terminal, columns: int, words: list, stage: str, clip: Path, clips_folder: Path, dataset_folder: Path,
    tiny_model_file: Path, tmp_path: Path,
) -> None:  # fmt: skip
    if "x.mp4" in words:
        pytest.importorskip("imageio_ffmpeg")
    folder = tmp_path / "in"
    folder.mkdir()
    clip.rename(folder / "clip.bvh")
    places = {
        "CLIP": folder / "clip.bvh", "FOLDER": folder, "CLIPS": clips_folder, "MODEL": tiny_model_file,
        "DATASET": dataset_folder,
    }  # fmt: skip
    code, text = in_terminal(columns, *(places.get(word, word) for word in words))
    assert code == 0, text
    shown = [line for line in bars(text) if stage in line]
    assert shown and all(len(line.rstrip()) <= columns for line in shown)
    assert any(re.search(r"\d+/\d+", line) or stage == "drawing" for line in shown)
    assert text.count("\x1b[?25h") >= text.count("\x1b[?25l") > 0, "the cursor is there again"
    assert "Traceback" not in text


@pytest.mark.parametrize("columns", [80, 40])
@pytest.mark.usefixtures("unscored")
def test_training_in_a_terminal(in_terminal, columns: int, dataset_folder: Path) -> None:
    words = (
        "--preset",
        "tiny",
        "--batch",
        2,
        "--window",
        16,
        "--splices",
        0,
        "--device",
        "cpu",
        "--steps",
        40,
    )
    code, text = in_terminal(columns, "train", dataset_folder, "-o", "m.safetensors", *words)
    assert code == 0 and "trained after 40 steps" in text and "Traceback" not in text
    shown = bars(text)
    assert shown and all(len(line.rstrip()) <= columns for line in shown)
    assert any(re.search(r"step \d+ of 40, \d+%", line) for line in shown) or columns < 60


HOSTILE = "red\x1b[31m\x07[bold]x[/b]\u202e"


def test_names_are_shown_and_never_obeyed(in_terminal, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    name = HOSTILE.replace("/", "") + "\n2.bvh"
    (folder / name).write_text(RIG)
    (folder / "torn \x1b]0;title\x07.bvh").write_text("HIERARCHY\n")
    said = [
        in_terminal(80, "mirror", folder / name, f"out-{name}"),
        in_terminal(80, "mirror", folder, tmp_path / "out \x1b[2J"),
        in_terminal(80, "view", folder / name, "-o", "x\x1b[5m.png"),
        in_terminal(80, "metrics", folder / name),
        in_terminal(80, "metrics", "no\x1b[5m.bvh"),
        in_terminal(80, "view", folder / name, "x\x1b[5m", "--width", "3\x1b[5m"),
        in_terminal(80, "\x1b[5mdance"),
        in_terminal(80, "preprocess", folder, "-o", "ds\x1b[5m", "--jobs", 1),
        in_terminal(80, "train", "ds\x1b[5m", "--init", "\x1b[5m", "--steps", 1),
    ]
    text = "".join(text for _, text in said)
    for sequence in ("\x1b[31m", "\x07", "\u202e", "\x1b]", "\x1b[2J", "\x1b[5m"):
        assert sequence not in text
    assert r"out-red\x1b[31m\x07[bold]x[b]\u202e\n2.bvh" in text
    assert [code for code, _ in said[:3]] == [0, 1, 0]


def test_a_type_that_looks_like_markup(in_terminal, clips_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    (folder / "[red]walk").mkdir(parents=True)
    for number, name in enumerate(("walk_02.bvh", "idle_01.bvh")):
        (folder / "[red]walk" / f"{number}.bvh").write_bytes((clips_folder / name).read_bytes())
    (tmp_path / "labels.csv").write_text(
        "file,start_frame,end_frame,type\n0.bvh,0,-1,[/b]\n1.bvh,0,-1,[bold]\n"
    )
    code, text = in_terminal(80, "preprocess", folder, "-o", "ds", "--jobs", 1, "--labels", "labels.csv")
    assert "[/b]" in text and "[bold]" in text and code == 0


def test_what_is_visible() -> None:
    assert visible("a\x1b[1m\r\n\t\x9b\x7f\u2028é☺ 走") == r"a\x1b[1m\r\n\t\x9b\x7f\u2028é☺ 走"
    assert visible(os.fsdecode(b"caf\xe9")) == r"caf\xe9"
    assert visible("\ud800") == r"\ud800"


@pytest.mark.parametrize(
    "settings", [{"PYTHONIOENCODING": "ascii"}, {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0"}]
)
def test_names_beyond_the_encoding(settings: dict[str, str], tmp_path: Path) -> None:
    """Such names, and one that is not UTF-8, are read, written and printed in results, errors and JSON."""
    names = [os.fsencode("é走.bvh"), b"\xff\xe9.bvh"]
    for name in names:
        (tmp_path / os.fsdecode(name)).write_text(RIG)
    code = (
        "import sys\nfrom motionkit.cli.main import main\n"
        "for words in %r:\n"
        "    sys.argv = ['motionkit', *map(__import__('os').fsdecode, words)]\n"
        "    try:\n        main()\n    except SystemExit as stop:\n        print(stop.code, flush=True)\n"
    )  # fmt: skip
    calls = [[b"mirror", name, b"out-" + name, *extra] for name in names for extra in ([], [b"--json"])]
    calls += [[b"metrics", names[1] + b".no"], [b"view", names[1], b"-o", names[1] + b".html"]]
    done = subprocess.run(
        [sys.executable, "-c", code % calls],
        cwd=tmp_path,
        env=os.environ | settings,
        capture_output=True,
        timeout=60,
    )
    assert b"Traceback" not in done.stderr and done.returncode == 0, done.stderr
    assert sorted(os.listdir(os.fsencode(tmp_path))) == sorted(
        [*names, *(b"out-" + name for name in names), names[1] + b".html"]
    )
    assert rb"out-\xff\xe9.bvh: the mirror image of" in done.stdout
