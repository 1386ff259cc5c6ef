"""The one thing pyproject.toml cannot say: the optional C kernels of the network's step and of a frame around it.

Without a C compiler, or with one that does not know vector extensions, motionkit installs all the same
and numpy does the work.
"""

import sys

from setuptools import Extension, setup

FLAGS = ["-O3", "-fopenmp-simd", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"]

# The frame is to be what numpy makes of it.
UNFUSED = ["-O3", "-ffp-contract=off", "-fno-math-errno"]


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


setup(
    ext_modules=[
        kernel("models._step_kernel", ["models/step_kernel.c"], FLAGS, []),
        kernel(
            "synthesis._frame_kernel",
            ["synthesis/frame_kernel.c", "synthesis/foot_kernel.c"],
            UNFUSED,
            ["synthesis/frame_kernel.h", "synthesis/kernel_math.h"],
        ),
    ]
)
