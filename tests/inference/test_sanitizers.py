"""The C kernels under the address and undefined-behaviour sanitizers of GCC, where it has them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import motionkit
from motionkit.native import LIBRARY_ENDING

PACKAGE = Path(motionkit.__file__).parent
SOURCES = {
    "_step_kernel": ["inference/step_kernel.c"],
    "_attention_kernel": ["models/attention_kernel.c"],
    "_frame_kernel": ["inference/frame_kernel.c", "inference/foot_kernel.c"],
    "_steering_kernel": ["control/steering_kernel.c"],
}
FLAGS = ["-O1", "-g", "-fopenmp-simd", "-Wno-psabi", "-shared", "-fPIC"]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
# The process is Python's: its leaks, and what torch allocates and frees by other means, are not looked at.
OPTIONS = "detect_leaks=0:alloc_dealloc_mismatch=0:detect_odr_violation=0"


def build(source: list[Path], library: Path) -> str:
    """Builds a library with sanitizers and answers what the compiler complained of, "" if nothing."""
    command = ["gcc", *FLAGS, *SANITIZERS, *map(str, source), "-o", str(library), "-lm"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=120).stderr
    except FileNotFoundError:
        return "no gcc"


def sanitized_python(script: list[str]) -> subprocess.CompletedProcess[str]:
    """Runs Python with the sanitizer's library loaded before all others."""
    found = subprocess.run(["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True)
    environment = os.environ | {
        "LD_PRELOAD": found.stdout.strip(),
        "ASAN_OPTIONS": OPTIONS,
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([str(PACKAGE.parent), os.environ.get("PYTHONPATH", "")]),
    }
    command = [sys.executable, *script]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, env=environment)


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all kernels, built with sanitizers."""
    folder = tmp_path_factory.mktemp("sanitized")
    probe = folder / "probe.c"
    probe.write_text("int probe(int *a, int i) { return a[i]; }\n")
    if build([probe], folder / "probe.so"):
        pytest.skip("no compiler with sanitizers")
    for name, sources in SOURCES.items():
        built = folder / f"{name}{LIBRARY_ENDING}"
        assert build([PACKAGE / source for source in sources], built) == ""
    return folder


@pytest.mark.sanitizer
def test_random_shapes_and_models(libraries: Path) -> None:
    done = sanitized_python([str(Path(__file__).with_name("sanitized.py")), str(libraries)])
    assert done.returncode == 0 and done.stdout.strip() == "clean", done.stderr[-4000:]


@pytest.mark.sanitizer
def test_a_fault_would_be_found(libraries: Path) -> None:
    """One number read beyond the end of an array ends the process."""
    script = (
        "import ctypes, sys, numpy as np; array = np.zeros(1000, np.int32)\n"
        "probe = ctypes.CDLL(sys.argv[1]).probe; probe.argtypes = [ctypes.c_void_p, ctypes.c_int]\n"
        "probe(array.ctypes.data, 999); print('within', flush=True); probe(array.ctypes.data, 1000)\n"
    )
    done = sanitized_python(["-c", script, str(libraries / "probe.so")])
    assert done.stdout.strip() == "within" and done.returncode != 0 and "heap-buffer-overflow" in done.stderr
