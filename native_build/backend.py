"""The build backend: setuptools, with a C compiler where the system has none.

The C kernels are libraries that ctypes loads; they use no Python API, so one wheel per system serves every Python 3.
They need vector extensions: GCC's or Clang's. Where a build finds neither, it asks for ziglang, Zig's package on PyPI,
which brings Clang and all that it links with.
"""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (  # noqa: F401  the hooks that stay
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)
from setuptools.errors import CompileError

ZIG = "ziglang>=0.13"
PROBE = "typedef float vec __attribute__((vector_size(32))); vec twice(vec x) { return x + x; }\n"
# Clang of Windows exports no function unless told to; GCC and Zig export all.
SYSTEM_COMPILERS = ("gcc",) if sys.platform == "win32" else ("cc", "gcc", "clang")
LIBRARY = ["-shared"] if sys.platform == "win32" else ["-shared", "-fPIC"]
MATHS = [] if sys.platform == "win32" else ["-lm"]

Settings = Mapping[str, Any] | None


def system_compiler() -> list[str] | None:
    """The words that call the system's compiler, or the one that the variable CC names; None if none does the work."""
    asked = os.environ.get("CC")
    found = [shlex.split(asked)] if asked else [[name] for name in SYSTEM_COMPILERS]
    return next((words for words in found if _compiles(words)), None)


def compiler() -> list[str]:
    """The words that call a compiler: the system's, else Zig's. Raises CompileError where there is none."""
    words = system_compiler()
    if words is None and importlib.util.find_spec("ziglang") is not None:
        # Zig compiles for the machine it is on; a wheel is for all of its kind.
        words = [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]
    if words is None:
        raise CompileError("motionkit needs a C compiler: install GCC or Clang, or `pip install ziglang`")
    return words


def build_library(sources: list[str], flags: list[str], out: Path) -> None:
    """Compile C files into a shared library. Raises CompileError."""
    out.parent.mkdir(parents=True, exist_ok=True)
    words = [*compiler(), *LIBRARY, *flags, *sources, "-o", str(out), *MATHS]
    print(shlex.join(words), flush=True)
    if subprocess.run(words).returncode != 0:
        raise CompileError(f"the C compiler failed: {shlex.join(words)}")


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """What a build of a wheel needs besides setuptools (PEP 517)."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *_needed()]


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """What an editable install needs besides setuptools (PEP 660)."""
    return [*build_meta.get_requires_for_build_editable(config_settings), *_needed()]


def _needed() -> list[str]:
    return [] if system_compiler() else [ZIG]


def _compiles(words: list[str]) -> bool:
    """Whether a compiler makes a library with vectors."""
    if shutil.which(words[0]) is None:
        return False
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "probe.c", Path(folder) / "probe.so"
        source.write_text(PROBE)
        tried = [*words, *LIBRARY, str(source), "-o", str(out)]
        return subprocess.run(tried, capture_output=True).returncode == 0 and out.is_file()
