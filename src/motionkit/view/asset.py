"""The bodies that motionkit shows, made by docs/make_body.py from MakeHuman's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motionkit.view.surface import Array

_FOLDER = Path(__file__).parents[1] / "assets/bodies"
BODIES = ("adult", "woman", "heavy")
POINT_STEPS = 10_000  # steps per metre of stored points


@dataclass(frozen=True, eq=False)
class Asset:
    """A body in its own rest pose, with the soles at height zero, facing +Z; lengths in m.

    Attributes:
        places: canonical joints and joints of fingers to their places (3,).
        parents: joints to their parents; "" for the hips.
        names: J names of joints, in the order of the weights' indices.
        points: (V, 3).
        triangles: (F, 3) point indices.
        weights: (V, J) skin weights, which add up to 1.
        regions: (V,) index into surface.REGIONS.
        palette: (R, 3) colours of the regions, 0 to 255.
    """

    places: dict[str, Array]
    parents: dict[str, str]
    names: tuple[str, ...]
    points: Array
    triangles: NDArray[np.int64]
    weights: Array
    regions: NDArray[np.int64]
    palette: Array


@cache
def load_asset(name: str = BODIES[0]) -> Asset:
    """One of BODIES; its arrays must not be changed."""
    with np.load(_FOLDER / f"{name}.npz") as data:
        names = tuple(name.decode() for name in data["names"].tolist())
        parents = data["parents"].tolist()
        weights = np.zeros((len(data["points"]), len(names)))
        for joints, steps in zip(data["joints"].T, data["weights"].T, strict=True):
            weights[np.arange(len(weights)), joints] += steps / 255.0
        return Asset(
            dict(zip(names, data["places"].astype(np.float64), strict=True)),
            {name: names[p] if p >= 0 else "" for name, p in zip(names, parents, strict=True)},
            names,
            data["points"] / POINT_STEPS,
            data["triangles"].astype(np.int64),
            weights,
            data["regions"].astype(np.int64),
            data["palette"].astype(np.float64),
        )
