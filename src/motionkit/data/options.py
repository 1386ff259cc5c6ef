"""What a person may choose where a dataset is made of BVH files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motionkit.arrays import Array
from motionkit.features.layout import DEFAULT_LAYOUT


@dataclass(frozen=True, eq=False)
class PreprocessOptions:
    """The options of preprocess; the command's help describes them.

    reference_rotations (23, 4) are those of the model that training is to begin from; by default the mean rotations
    of the data itself. held_out names the splits that clips are taken for, where labels do not say.
    """

    labels: Path | None = None
    fps: float | None = None
    scale: float | None = None
    mirror: bool = True
    own_bodies: bool = False
    layout: str = DEFAULT_LAYOUT
    jobs: int = 0
    strict: bool = False
    smooth: bool = True
    level: bool = True
    reference_rotations: Array | None = None
    held_out: tuple[str, ...] = ("validation", "test")
