"""A signal that arrives while a temporary file, folder or lock is being made leaves none of them behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.motion.bvh import write_bvh
from synthetic_motions import make_walk

# Runs the command line with a function of a module that sends SIGTERM to its own process just before it returns.
STOP_IN = """
import os, signal, sys
module = __import__(sys.argv[1])
name, stopped = sys.argv[2], []
plain = getattr(module, name)

def with_signal(*args, **options):
    result = plain(*args, **options)
    if not stopped and any(".out" in str(value) for value in (*args, *options.values())):
        stopped.append(name)
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(100):  # Python runs signal handlers between instructions
            pass
    return result

setattr(module, name, with_signal)
sys.argv = ["motionkit", *sys.argv[3:]]
from motionkit.cli.main import main
main()
"""


@pytest.mark.parametrize(
    ("function", "command"),
    [
        (("tempfile", "mkdtemp"), ("preprocess", "clips", "-o", "out", "--jobs", "1")),
        (("os", "open"), ("preprocess", "clips", "-o", "out", "--jobs", "1")),
        (("os", "open"), ("mirror", "clips/walk.bvh", "out.bvh")),
    ],
)
def test_nothing_is_left(function: tuple[str, str], command: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    write_bvh(tmp_path / "clips" / "walk.bvh", make_walk(60))
    done = subprocess.run(
        [sys.executable, "-c", STOP_IN, *function, *command], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr.strip()) == (130, "stopped")
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]
