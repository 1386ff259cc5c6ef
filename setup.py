"""What pyproject.toml cannot say: the optional C kernels of the network's step, of a frame around it and of attention
in training; and the README for package indexes.

They use no Python API, so one wheel per system serves every Python 3. Without a C compiler, or with one that does
not know vector extensions, motionkit installs all the same and numpy does the work.
"""

import os
import re
import shutil
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

FLAGS = ["-O3", "-fopenmp-simd", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"]

# The frame is to be what numpy makes of it.
UNFUSED = ["-O3", "-ffp-contract=off", "-fno-math-errno"]

# What clang-cl, Clang for MSVC, is told for these.
MSVC_FLAGS = {
    "-O3": "/clang:-O3",
    "-fopenmp-simd": "/clang:-fopenmp-simd",
    "-fno-math-errno": "/clang:-fno-math-errno",
    "-fno-trapping-math": "/clang:-fno-trapping-math",
    "-ffp-contract=off": "/clang:-ffp-contract=off",
    "-Wno-psabi": "-Wno-psabi",
}

ENDING = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def kernel(
    name: str, sources: list[str], flags: list[str], headers: list[str], functions: list[str]
) -> Extension:
    """A library that is left out where it cannot be compiled; functions are those that Python calls."""
    windows = sys.platform == "win32"
    return Extension(
        f"motionkit.{name}",
        [f"src/motionkit/{source}" for source in sources],
        depends=[f"src/motionkit/{header}" for header in headers],
        extra_compile_args=[MSVC_FLAGS[flag] for flag in flags] if windows else flags,
        export_symbols=functions,
        libraries=[] if windows else ["m"],
        optional=True,
    )


class BuildLibraries(build_ext):
    """Builds libraries that are loaded by ctypes: no Python version in their names, nothing for Python to call."""

    def get_ext_filename(self, fullname: str) -> str:
        """The path of a library, named without the Python it was built by."""
        return "/".join(fullname.split(".")) + ENDING

    def get_export_symbols(self, ext: Extension) -> list[str]:
        """No PyInit function."""
        return ext.export_symbols

    def build_extensions(self) -> None:
        """With MSVC compile by clang-cl, since MSVC itself has no vector extensions."""
        if self.compiler.compiler_type == "msvc":
            self.compiler.initialize()
            clang = shutil.which("clang-cl") or shutil.which("clang-cl", path=r"C:\Program Files\LLVM\bin")
            if clang is not None:
                self.compiler.cc = clang
        super().build_extensions()


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
        kernel(
            "inference._step_kernel",
            ["inference/step_kernel.c"],
            FLAGS,
            ["models/vectors.h"],
            ["step_kernel_version", "scratch_size", "step"],
        ),
        kernel(
            "models._attention_kernel",
            ["models/attention_kernel.c"],
            FLAGS,
            ["models/vectors.h"],
            ["attention_kernel_version", "attention_forward", "attention_backward"],
        ),
        kernel(
            "inference._frame_kernel",
            ["inference/frame_kernel.c", "inference/foot_kernel.c"],
            UNFUSED,
            ["inference/frame_kernel.h", "inference/kernel_math.h"],
            ["frame_kernel_version", "draw_frames", "pose_frames"],
        ),
    ],
)
