"""Compiles the C kernels of frames and steering to WebAssembly for the page of `motionkit demo`, and checks them.

    pip install ziglang==0.13.0.post1
    python web/build_wasm.py            # writes src/motionkit/assets/web/motionkit.wasm
    python web/build_wasm.py --check    # fails if it is not what the sources give

The module carries the hash of its sources and of the flags.
"""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import tempfile
from pathlib import Path

WEB = Path(__file__).resolve().parent
KERNELS = WEB.parent / "src" / "motionkit"
MODULE = KERNELS / "assets" / "web" / "motionkit.wasm"
FRAME = [KERNELS / "inference" / name for name in ("step_kernel.c", "frame_kernel.c", "foot_kernel.c")]
SOURCES = [*FRAME, KERNELS / "control" / "steering_kernel.c"]
FUNCTIONS = (
    *("step", "scratch_size", "draw_frames", "pose_frames", "__heap_base"),
    *("observe", "spring_speed", "steered_type", "steer"),
    *("path_points", "even_points", "plan_path", "follow"),
)
# Products are not fused with sums: native frames are not either (setup.py).
FLAGS = [
    "-target", "wasm32-wasi", "-mexec-model=reactor", "-O3", "-msimd128", "-fno-stack-protector",
    "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-Wl,--strip-all,-z,stack-size=262144",
    *(f"-Wl,--export={name}" for name in FUNCTIONS),
]  # fmt: skip
SECTION = b"source-sha256"


def source_hash() -> str:
    """The hash of all that the module is made of."""
    files, waiting = set[Path](), list(SOURCES)
    while waiting:
        file = waiting.pop().resolve()
        if file not in files:
            files.add(file)
            waiting += [
                file.parent / name for name in re.findall(r'#include "(.+?)"', file.read_text("utf-8"))
            ]
    digest = hashlib.sha256(" ".join(FLAGS).encode())
    for file in sorted(files):
        digest.update(f"{file.name}\n".encode() + file.read_bytes().replace(b"\r\n", b"\n") + b"\n")
    return digest.hexdigest()


def built_hash(module: bytes) -> str:
    """The hash that a module carries, in the custom section at its end; nothing for another module."""
    found = re.search(rb"\x0d" + SECTION + rb"([0-9a-f]{64})$", module)
    return found[1].decode() if found else ""


def build() -> bytes:
    """The module, compiled now."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / MODULE.name
        words = [sys.executable, "-m", "ziglang", "cc", *FLAGS, *map(str, SOURCES), "-o", str(out)]
        subprocess.run(words, check=True)
        content = bytes([len(SECTION)]) + SECTION + source_hash().encode()
        assert len(content) < 128  # its length is one byte
        return out.read_bytes() + bytes([0, len(content)]) + content


if __name__ == "__main__":
    if "--check" in sys.argv:
        if not MODULE.exists() or built_hash(MODULE.read_bytes()) != source_hash():
            sys.exit(f"{MODULE} is out of date: python web/build_wasm.py")
    else:
        MODULE.write_bytes(build())
        print(f"{MODULE.name} {MODULE.stat().st_size / 1024:.0f} KiB")
