"""Where the system has no C compiler a build asks for Zig's; without any it fails in one line."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.motion.bvh import read_bvh

ROOT = Path(__file__).resolve().parents[1]
REQUIRED = (
    "import sys; sys.path.insert(0, 'native_build'); import backend; "
    "print('needs', backend.get_requires_for_build_wheel(), backend.get_requires_for_build_editable())"
)
HIDDEN_ZIG = "import runpy, sys; sys.modules['ziglang'] = None; sys.argv = {}; runpy.run_path('setup.py')"
BUILD = ["setup.py", "-q", "build", "--build-lib", "installed"]


def run(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Python with some words in a folder."""
    changed = os.environ | environment
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=folder, env=changed, capture_output=True, text=True, timeout=170)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A copy of the package's source, without what has been built."""
    ignored = shutil.ignore_patterns("*.so", "*.egg-info", "__pycache__", "web", "*.safetensors")
    for name in ("src", "native_build"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored)
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    return tmp_path


def test_a_build_asks_for_zig_only_where_there_is_no_compiler(source: Path) -> None:
    without = run(source, "-c", REQUIRED, CC="false")
    assert without.stdout.splitlines()[-1].count("ziglang") == 2, without.stderr[-2000:]
    if shutil.which("gcc"):
        found = run(source, "-c", REQUIRED, CC="gcc")
        assert found.stdout.splitlines()[-1].startswith("needs []"), found.stderr[-2000:]


def test_without_any_compiler_it_fails_in_one_line(source: Path) -> None:
    failed = run(source, "-c", HIDDEN_ZIG.format(BUILD), CC="false")
    assert failed.returncode != 0 and not list(source.rglob("*.so"))
    lines = failed.stderr.splitlines()
    assert lines[-1] == "error: motionkit needs a C compiler: install GCC or Clang, or `pip install ziglang`"


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed")
def test_what_zig_compiles_synthesizes(source: Path) -> None:
    built = run(source, *BUILD, CC="false")
    assert built.returncode == 0 and len(list((source / "installed").rglob("*.so"))) == 3, built.stderr[
        -2000:
    ]
    shutil.copytree(
        ROOT / "src" / "motionkit" / "assets", source / "installed/motionkit/assets", dirs_exist_ok=True
    )
    words = ["-m", "motionkit", "synthesize", "--types", "running:0.5,cartwheel:0.5", "-o", "a.bvh"]
    done = run(source, *words, PYTHONPATH=str(source / "installed"))
    assert done.returncode == 0, done.stderr
    assert len(read_bvh(source / "a.bvh").values) == 60
