"""The one thing pyproject.toml cannot say: the optional C kernel of the network's step.

Without a C compiler, or with one that does not know vector extensions, motionkit installs all the same
and numpy does the work.
"""

import sys

from setuptools import Extension, setup

FLAGS = ["-O3", "-fopenmp-simd", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"]

setup(
    ext_modules=[
        Extension(
            "motionkit.models._step_kernel",
            ["src/motionkit/models/step_kernel.c"],
            extra_compile_args=[] if sys.platform == "win32" else FLAGS,
            libraries=[] if sys.platform == "win32" else ["m"],
            optional=True,
        )
    ]
)
