from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import motionkit
from motionkit import __version__
from motionkit.cli.main import COMMANDS
from motionkit.models.bundled import BUNDLED_MODEL

pytestmark = pytest.mark.thorough

# Slow imports that --help must avoid.
HEAVY = ("torch", "numpy", "rich", "bvhio", "safetensors", "PIL")
ASK_FOR_HELP = """
import sys, os
from motionkit.cli.main import main
sys.argv = ["motionkit", *sys.argv[1:]]
try:
    main()
except SystemExit as stop:
    assert not stop.code
times = os.times()
print(f"{times.user + times.system:.3f}", *(name for name in %r if name in sys.modules), file=sys.stderr)
"""


def ask(*words: str) -> tuple[str, float, list[str]]:
    """Help text, processor seconds it took, and which of the heavy packages were imported."""
    done = subprocess.run(
        [sys.executable, "-c", ASK_FOR_HELP % (HEAVY,), *words], capture_output=True, text=True, timeout=50
    )
    assert done.returncode == 0, done.stderr
    seconds, *heavy = done.stderr.split()
    return done.stdout, float(seconds), heavy


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_answers_at_once(command: str) -> None:
    """In processor time, which other work on the machine does not change; the best of three."""
    asked = [ask(*command.split(), "--help") for _ in range(3)]
    text, _, heavy = asked[0]
    assert text.startswith(f"Usage: motionkit {command}".strip())
    assert "--json" in text or command in ("", "experiment"), "a group's commands have options of their own"
    assert heavy == []
    assert min(seconds for _, seconds, _ in asked) < 0.4


def test_help_lists_every_command() -> None:
    text = ask("--help")[0]
    assert all(f"  {name} " in text for name in COMMANDS)
    assert "Exit codes: 0 done, 1 the data or the work failed, 2 wrong usage" in text


def test_the_console_script_is_the_package() -> None:
    script = Path(sys.executable).with_name("motionkit")
    command = [str(script)] if script.exists() else [sys.executable, "-m", "motionkit"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=50)
    assert done.returncode == 0 and __version__ in done.stdout


def test_the_version_says_what_the_installation_computes_with() -> None:
    code = (
        "import sys; sys.modules['torch'] = None; sys.argv = ['motionkit', '--version']; "
        "from motionkit.cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=50)
    told = dict(line.split(": ", 1) for line in done.stdout.splitlines()[1:])
    assert list(told) == ["kernels", "torch", "model"] and done.returncode == 0
    assert told["kernels"] == "step, frame"
    assert told["torch"] == version("torch")
    assert told["model"].startswith(f"{BUNDLED_MODEL.name}, 23 types")


def test_a_missing_kernel_is_one_line_and_the_version_says_so(tmp_path: Path) -> None:
    """As where a file of the installation has been lost."""
    source = Path(motionkit.__file__).parent
    shutil.copytree(source, tmp_path / "motionkit", ignore=shutil.ignore_patterns("_frame_kernel.*", "web"))
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}

    def told(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "motionkit", *words]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=100, cwd=tmp_path, env=environment
        )

    fault = r"the library \S+_frame_kernel\S+ is missing: install motionkit anew"
    version = told("--version")
    assert version.returncode == 0 and re.search(rf"^kernels: {fault}", version.stdout, re.MULTILINE)
    made = told("synthesize", "--types", "walking:0.1", "-o", "a.bvh")
    assert made.returncode == 1 and re.fullmatch(rf"error: {fault}.*\n", made.stderr, re.IGNORECASE)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("motionkit fol", ["follow-path"]),
        ("motionkit view --no", ["--no-open"]),
        ("motionkit ", list(COMMANDS)),
    ],
)
def test_the_shell_completes_commands_and_options(words: str, expected: list[str]) -> None:
    place = {"COMP_WORDS": words, "COMP_CWORD": str(words.count(" ")), "_MOTIONKIT_COMPLETE": "bash_complete"}
    command = "import sys; sys.argv = ['motionkit']; from motionkit.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, timeout=50, env=os.environ | place
    )
    assert [line.removeprefix("plain,") for line in done.stdout.splitlines()] == expected


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_what_a_shell_is_to_read(shell: str) -> None:
    command = "import sys; sys.argv = ['motionkit']; from motionkit.cli.main import main; main()"
    asked = os.environ | {"_MOTIONKIT_COMPLETE": f"{shell}_source"}
    done = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, timeout=50, env=asked
    )
    assert f"_MOTIONKIT_COMPLETE={shell}_complete" in done.stdout
    if reader := shutil.which(shell):
        assert subprocess.run([reader, "-n"], input=done.stdout, text=True, timeout=50).returncode == 0


@pytest.mark.parametrize(
    "words",
    [
        ["dance"],
        ["--loud"],
        ["preprocess"],
        ["preprocess", "no-such-folder"],
        ["preprocess", ".", "--fps", "0"],
        ["preprocess", ".", "--layout", "x"],
        ["preprocess", ".", "--labels", "no.csv"],
        ["train"],
        ["train", "no-such-folder"],
        ["train", ".", "--preset", "huge"],
        ["train", ".", "--steps", "-1"],
        ["train", ".", "--minutes", "soon"],
        ["synthesize"],
        ["synthesize", "--types", "running", "--noise", "pink"],
        ["synthesize", "--types", "running", "--count", "0"],
        ["synthesize", "--types", "running", "--model", "no-such-file"],
        ["synthesize", "--types", "running", "--init", "no-such-file.bvh"],
        ["follow-path"],
        ["follow-path", "circle", "--types", ","],
        ["follow-path", "way.json", "--size", "3"],
        ["metrics"],
        ["metrics", "no-such-file.bvh"],
        ["mirror", "only-one.bvh"],
        ["view"],
    ],
)
def test_wrong_usage_exits_with_2(motionkit, words: list[str], tmp_path: Path) -> None:
    said = motionkit(*words)
    assert said.code == 2
    assert not said.out and "Error" in said.err and "Traceback" not in said.err
    assert not list(tmp_path.iterdir())


def test_a_closed_pipe_is_no_traceback(clips_folder: Path) -> None:
    command = [sys.executable, "-m", "motionkit", "metrics", str(clips_folder / "idle_01.bvh")]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    running.stdout.close()
    assert "Traceback" not in running.communicate(timeout=55)[1]


def test_one_line_for_a_fault_in_a_real_process(tmp_path: Path) -> None:
    (tmp_path / "bad.bvh").write_text("HIERARCHY\nROOT Hips\n")
    done = subprocess.run(
        [sys.executable, "-m", "motionkit", "metrics", "bad.bvh", "--json"],
        cwd=tmp_path, capture_output=True, text=True, timeout=55, env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr.startswith("error: bad.bvh") and len(done.stderr.splitlines()) == 1


def test_infinite_numbers_are_null_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    from motionkit.cli.common import print_json

    print_json({"a": [float("nan"), float("inf"), 1.5], "b": {"c": (1, None)}})
    assert json.loads(capsys.readouterr().out) == {"a": [None, None, 1.5], "b": {"c": [1, None]}}


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no interval timers here")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_during_an_import_waits_for_its_end(name: str, tmp_path: Path) -> None:
    (tmp_path / "starting.py").write_text(
        f"import signal\nsignal.raise_signal(signal.{name})\nprint('started')\n"
    )
    code = (
        "import click, time\n"
        "from motionkit.cli import main\n"
        "def run(**_):\n"
        "    import starting\n"
        "    time.sleep(50)\n"
        "main.cli.main = run\n"
        "main.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout.split(), done.stderr.split()) == (130, ["started"], ["stopped"])
