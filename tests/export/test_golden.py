"""The numbers in files of every format: if any of these values changes, what is written has changed.

PYTHONPATH=tests python tests/export/test_golden.py prints them anew.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.editing.root_motion import with_ground_root
from motionkit.export.clip import Clip
from motionkit.export.formats import read_clip, write_motion
from motionkit.motion.motion import Motion, resample
from motionkit.rig.gltf import GltfFile
from synthetic_motions import make_dance

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
KINDS = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e[-+]?\d+)?")


def sources() -> dict[str, Motion | Clip]:
    """A recorded clip of another rig and unit, made motion with labels, and joints that move apart."""
    recorded = read_clip(DATA / "35_30.bvh")
    made = Clip(make_dance(20), "dance", (("dancing", 0.2), ("idle", 1.0)))
    return {
        "recorded": recorded.with_motion(resample(recorded.motion.cut(0, 40), 30.0)),
        "made": made.with_motion(make_dance(20)),
        "apart": with_ground_root(make_dance(20)),
    }


def numbers(value: Any) -> list[float]:
    """All numbers in a JSON value, in order."""
    if isinstance(value, dict):
        return [number for key in value for number in numbers(value[key])]
    if isinstance(value, list):
        return [number for each in value for number in numbers(each)]
    return [float(value)] if isinstance(value, (int, float)) else []


def accessor(file: GltfFile, item: dict[str, Any]) -> np.ndarray:
    """The numbers of an accessor of any type."""
    start = file.items("bufferViews")[item["bufferView"]].get("byteOffset", 0) + item.get("byteOffset", 0)
    count = item["count"] * WIDTHS[item["type"]]
    return np.frombuffer(file.data, KINDS[item["componentType"]], count, start)


def arrays(path: Path) -> list[np.ndarray]:
    """What a file holds."""
    if path.suffix in (".glb", ".vrma"):
        file = GltfFile(path)
        facts = {name: value for name, value in file.json.items() if name not in ("images", "asset")}
        return [np.array(numbers(facts)), *(accessor(file, item) for item in file.items("accessors"))]
    if path.suffix == ".npz":
        with np.load(path) as file:
            return [file[name] for name in sorted(file) if file[name].dtype.kind in "fiub"]
    text = path.read_text("utf-8").replace("\n", " ")
    return [np.array([float(word) for word in NUMBER.findall(text)]), np.array([len(text.split())])]


def figures(path: Path) -> list[float]:
    """How many numbers a file has, and sums of their logarithms, small ones too, times random numbers."""
    every = np.concatenate([array.astype(np.float64).ravel() for array in arrays(path)])
    sizes = np.sign(every) * np.log1p(1000.0 * np.abs(every)) / np.sqrt(len(every))
    return [len(every), *(np.random.default_rng(0).normal(size=(2, len(every))) @ sizes)]


def written(folder: Path, source: str, ending: str) -> list[float]:
    write_motion(folder / f"a.{ending}", sources()[source])
    return figures(folder / f"a.{ending}")


FILES = [
    (source, ending)
    for source in ("recorded", "made", "apart")
    for ending in ("bvh", "glb", "vrma", "usda", "npz", "csv")
]


# fmt: off
VALUES: dict[tuple[str, str], list[float]] = {
    ("recorded", "bvh"): [1108.0, -4.6024, -8.8565],
    ("recorded", "glb"): [128967.0, 1.8458, 0.2925],
    ("recorded", "vrma"): [1271.0, -7.1443, -0.994],
    ("recorded", "usda"): [154487.0, 5.8731, -2.7013],
    ("recorded", "npz"): [3633.0, -3.6965, -0.0327],
    ("recorded", "csv"): [2231.0, -4.9845, 18.3644],
    ("made", "bvh"): [1550.0, -3.9746, -0.128],
    ("made", "glb"): [129323.0, -6.6289, -2.3737],
    ("made", "vrma"): [2193.0, -1.1267, 3.2965],
    ("made", "usda"): [155761.0, 9.9033, 6.7409],
    ("made", "npz"): [5313.0, 0.419, 4.3191],
    ("made", "csv"): [3341.0, 0.7881, -2.0409],
    ("apart", "bvh"): [1674.0, 3.3857, -3.1528],
    ("apart", "glb"): [129506.0, -6.6757, 2.6604],
    ("apart", "vrma"): [2191.0, -3.3606, -2.2905],
    ("apart", "usda"): [155993.0, 6.7484, 3.1813],
    ("apart", "npz"): [6977.0, 9.2294, 6.3575],
    ("apart", "csv"): [3481.0, -4.1537, 13.1817],
}
# fmt: on


@pytest.mark.parametrize(("source", "ending"), FILES)
def test_files_hold_the_numbers_that_they_held(tmp_path: Path, source: str, ending: str) -> None:
    assert written(tmp_path, source, ending) == pytest.approx(VALUES[source, ending], rel=1e-6, abs=1e-3)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        for name in FILES:
            sys.stdout.write(
                f"    {name}: {[round(float(value), 4) for value in written(Path(place), *name)]},\n".replace(
                    "'", '"'
                )
            )
