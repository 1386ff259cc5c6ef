"""The C kernels as WebAssembly, which the page of `motionkit demo` runs: built from the sources that are here."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from motionkit.inference import stepping
from motionkit.inference.kernel_image import kernel_image
from motionkit.inference.rollout import Noise
from motionkit.inference.step_kernel import kernel_library
from motionkit.models.model import MotionModel

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


@pytest.mark.skipif(kernel_library() is None, reason="motionkit was installed without its C kernel")
def test_characters_start_alike_where_no_kernel_is_installed(
    tiny_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Keys and values of the start pose lie in memory as the kernel wants them."""

    def rings() -> np.ndarray:
        image = kernel_image(tiny_model, Noise())
        kept = image.own[image.addresses["keys"] : image.addresses["filled"]]
        return np.frombuffer(kept[: len(kept) // 4 * 4], "<f4")

    compiled = rings()
    monkeypatch.setattr(stepping, "_packed", lambda network, batch: (stepping.pack(network), batch, None))
    assert np.abs(compiled).max() > 0.5
    assert np.abs(rings() - compiled).max() < 0.01
