"""The options of preprocess."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motionkit.arrays import Array
from motionkit.features.layout import DEFAULT_LAYOUT


@dataclass(frozen=True, eq=False)
class PreprocessOptions:
    """The options of preprocess; the command's help describes them.

    Attributes:
        reference_rotations: (23, 4) of the model that training will start from; by default the data's mean rotations.
        held_out: the splits that take clips which the labels leave undecided.
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
