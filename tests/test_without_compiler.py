"""Without a C compiler motionkit installs all the same, and numpy does the work; the tests say so aloud."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.motion.bvh import read_bvh

ROOT = Path(__file__).resolve().parents[1]


def run(folder: Path, *words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Python with some words in a folder."""
    command = [sys.executable, *map(str, words)]
    changed = os.environ | environment
    return subprocess.run(command, cwd=folder, env=changed, capture_output=True, text=True, timeout=150)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package as it is installed where every call of the compiler fails."""
    folder = tmp_path_factory.mktemp("source")
    shutil.copytree(
        ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("*.so", "*.egg-info", "__pycache__")
    )
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    fails = shutil.which("false")
    if fails is None:
        pytest.skip("no command that fails")
    built = run(folder, "setup.py", "-q", "build", "--build-lib", "installed", CC=fails, CXX=fails)
    assert built.returncode == 0, built.stderr[-2000:]
    assert "_step_kernel" in built.stderr, "the installer says what it leaves out"
    return folder / "installed"


def test_it_installs_and_synthesizes(installed: Path, tmp_path: Path) -> None:
    assert not list(installed.rglob("*.so"))
    words = ["-m", "motionkit", "synthesize", "--types", "running:0.5,cartwheel:0.5", "-o", "a.bvh"]
    done = run(tmp_path, *words, PYTHONPATH=str(installed))
    assert done.returncode == 0, done.stderr
    assert len(read_bvh(tmp_path / "a.bvh").values) == 60


@pytest.mark.parametrize("asked", ["", "required"])
def test_a_test_run_says_so(installed: Path, tmp_path: Path, asked: str) -> None:
    path = os.pathsep.join([str(installed), str(ROOT / "tests")])
    words = [
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "--collect-only",
        ROOT / "tests" / "motion" / "test_units.py",
    ]
    done = run(tmp_path, *words, PYTHONPATH=path, MOTIONKIT_KERNELS=asked)
    assert "C kernels: NOT LOADED (step, frame, attention)" in done.stdout or asked
    assert done.returncode == (1 if asked else 0), done.stdout + done.stderr
    assert not asked or "MOTIONKIT_KERNELS=required" in done.stdout + done.stderr
