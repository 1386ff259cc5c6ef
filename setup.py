"""The one thing pyproject.toml cannot say: the optional C kernels of the network's step, of a frame around it and of
attention in training.

They use no Python API, so one wheel per system serves every Python 3. Without a C compiler, or with one that does
not know vector extensions, motionkit installs all the same and numpy does the work.
"""

import sys

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

FLAGS = ["-O3", "-fopenmp-simd", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"]

# The frame is to be what numpy makes of it.
UNFUSED = ["-O3", "-ffp-contract=off", "-fno-math-errno"]

ENDING = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def kernel(name: str, sources: list[str], flags: list[str], headers: list[str]) -> Extension:
    """A library that is left out where it cannot be compiled."""
    windows = sys.platform == "win32"
    return Extension(
        f"motionkit.{name}",
        [f"src/motionkit/{source}" for source in sources],
        depends=[f"src/motionkit/{header}" for header in headers],
        extra_compile_args=[] if windows else flags,
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


class AnyPythonWheel(bdist_wheel):
    """A wheel for every Python 3 on one kind of system."""

    def get_tag(self) -> tuple[str, str, str]:
        """The system's tag alone."""
        return "py3", "none", super().get_tag()[2]


setup(
    cmdclass={"build_ext": BuildLibraries, "bdist_wheel": AnyPythonWheel},
    ext_modules=[
        kernel("inference._step_kernel", ["inference/step_kernel.c"], FLAGS, ["models/vectors.h"]),
        kernel("models._attention_kernel", ["models/attention_kernel.c"], FLAGS, ["models/vectors.h"]),
        kernel(
            "inference._frame_kernel",
            ["inference/frame_kernel.c", "inference/foot_kernel.c"],
            UNFUSED,
            ["inference/frame_kernel.h", "inference/kernel_math.h"],
        ),
    ],
)
