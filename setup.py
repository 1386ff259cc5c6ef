"""What pyproject.toml cannot say: the C kernels of the network's step, of a frame around it, of steering
and of attention in training; and the README for package indexes.

native_build/backend.py finds the compiler.
"""

import os
import re
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

sys.path.insert(0, str(Path(__file__).with_name("native_build")))
from backend import build_library

FLAGS = ["-O3", "-g0", "-fopenmp-simd", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"]

# Rounded in the order of the source on every system.
UNFUSED = ["-O3", "-g0", "-ffp-contract=off", "-fno-math-errno"]

ENDING = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def kernel(name: str, sources: list[str], headers: list[str], flags: list[str]) -> Extension:
    """A library of C files."""
    return Extension(
        f"motionkit.{name}",
        [f"src/motionkit/{source}" for source in sources],
        depends=[f"src/motionkit/{header}" for header in headers],
        extra_compile_args=flags,
    )


class BuildLibraries(build_ext):
    """Builds libraries that are loaded by ctypes: no Python version in their names, nothing for Python to call."""

    def get_ext_filename(self, fullname: str) -> str:
        """The path of a library, named without the Python it was built by."""
        return "/".join(fullname.split(".")) + ENDING

    def build_extension(self, ext: Extension) -> None:
        """Compile and link a library in one call."""
        build_library(ext.sources, ext.extra_compile_args, Path(self.get_ext_fullpath(ext.name)))


class AnyPythonWheel(bdist_wheel):
    """A wheel for every Python 3 on one kind of system."""

    def get_tag(self) -> tuple[str, str, str]:
        """The system's tag alone."""
        return "py3", "none", super().get_tag()[2]


def long_description(text: str, address: str) -> str:
    """The README for where the files beside it are not.

    Its links lead to the repository at an address (environment variable MOTIONKIT_URL), as GitHub lays it out. Without
    one they are plain words, and pictures are left out.
    """

    def there(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        if not address:
            return "" if picture else words
        return f"{picture}[{words}]({address}/{'raw' if picture else 'blob'}/main/{target})"

    return re.sub(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)\s]+)\)", there, text)


setup(
    long_description=long_description(
        Path(__file__).with_name("README.md").read_text("utf-8"),
        os.environ.get("MOTIONKIT_URL", "").rstrip("/"),
    ),
    long_description_content_type="text/markdown",
    cmdclass={"build_ext": BuildLibraries, "bdist_wheel": AnyPythonWheel},
    ext_modules=[
        kernel("inference._step_kernel", ["inference/step_kernel.c"], ["models/vectors.h"], FLAGS),
        kernel("models._attention_kernel", ["models/attention_kernel.c"], ["models/vectors.h"], FLAGS),
        kernel(
            "inference._frame_kernel",
            ["inference/frame_kernel.c", "inference/foot_kernel.c"],
            ["inference/frame_kernel.h", "inference/kernel_math.h"],
            UNFUSED,
        ),
        kernel("control._steering_kernel", ["control/steering_kernel.c"], [], UNFUSED),
    ],
)
