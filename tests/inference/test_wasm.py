"""The C kernels as WebAssembly, which the page of `motionkit demo` runs: built from the sources that are here."""

from __future__ import annotations

import sys
from pathlib import Path

WEB = Path(__file__).resolve().parents[2] / "web"


def test_the_kernels_are_built_from_their_sources() -> None:
    sys.path.insert(0, str(WEB))
    try:
        import build_wasm
    finally:
        sys.path.remove(str(WEB))
    built = build_wasm.built_hash(build_wasm.MODULE.read_bytes())
    assert built == build_wasm.source_hash(), (
        "out of date: pip install ziglang==0.13.0.post1 && python web/build_wasm.py"
    )
