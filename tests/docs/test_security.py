"""SECURITY.md states the limits that the code enforces."""

from __future__ import annotations

from pathlib import Path

from motionkit.files import MAX_TEXT_BYTES
from motionkit.models import checkpoint
from motionkit.motion import bvh_text
from motionkit.training import run_state


def test_the_sizes_are_those_of_the_code() -> None:
    text = " ".join((Path(__file__).parents[2] / "SECURITY.md").read_text("utf-8").split())
    sizes = (bvh_text.MAX_BYTES, checkpoint.MOST_BYTES, MAX_TEXT_BYTES)
    bvh, model, words = (size // 2**20 for size in sizes)
    assert f"{bvh} MiB for BVH, {model} MiB for a model, {words} MiB for text" in text
    assert f"{run_state.MOST_BYTES // 2**30} GiB for a checkpoint" in text
