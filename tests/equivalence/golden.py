"""Seeded roll-outs of the bundled model as plain arrays: what a change of the code must leave as it is.

`python tests/equivalence/golden.py` writes golden.npz anew, after a change that is meant to change motion.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from motionkit.control.drive import Driver, Wish, together
from motionkit.control.follow import follow_path
from motionkit.control.path import shape_path
from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.data.dataset import Dataset
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.inference.character import CharacterStream
from motionkit.inference.noise import Noise
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion

FILE = Path(__file__).with_name("golden.npz")
SAMPLE = Path(__file__).resolve().parents[2] / "examples" / "data"
EVERY = 12  # frames between those kept


def positions(motion: Motion) -> np.ndarray:
    """Joint positions (T, 23, 3) in cm of every EVERY-th frame."""
    _, places = motion_kinematics(motion)
    return np.asarray(places, np.float32)[::EVERY]


def synthesized(types: str, **options: object) -> np.ndarray:
    """Positions of one or more synthesized characters, one after another."""
    made = synthesize(load_bundled_model(), parse_types(types), SynthesisOptions(**({"ik": False} | options)))  # type: ignore[arg-type]
    return np.concatenate([positions(one.motion) for one in made.motions])


def followed(shape: str, types: list[str], speed: float | None = None) -> np.ndarray:
    """Positions of a character along a named shape."""
    path = shape_path(shape, 3.0, types, speed)
    return positions(follow_path(load_bundled_model(), path, SynthesisOptions(seed=5, ik=True)).motion)


def driven() -> np.ndarray:
    """Positions of two live characters that are steered, dance and kick."""
    model = load_bundled_model()
    characters = CharacterStream(model, 2, Noise(), seed=3)
    drivers = [Driver(model), Driver(model)]
    kept = []
    for frame in range(360):
        if frame == 20:
            drivers[0].set_wish(Wish(velocity=(0.0, 140.0)))
            drivers[1].set_wish(Wish(velocity=None, type="dance-salsa"))
        if frame == 150:
            drivers[0].set_wish(Wish(velocity=(250.0, 100.0)))
        if frame == 200:
            drivers[1].set_wish(Wish())
            drivers[1].perform("kicking")
        ground = characters.ground
        shown = characters.step(together([d(frame, ground[i : i + 1]) for i, d in enumerate(drivers)]))
        if frame % EVERY == 0:
            kept.append(np.asarray(shown.positions))
    return np.concatenate(kept)


def features(folder: Path) -> np.ndarray:
    """Features of the sample after preprocess, every so many rows."""
    preprocess([SAMPLE], folder, PreprocessOptions(jobs=1))
    dataset = Dataset(folder)
    return np.concatenate([np.asarray(dataset.read(clip).features)[::97] for clip in dataset.clips])


CASES: dict[str, Callable[[], np.ndarray]] = {
    "gaits": lambda: synthesized("running:3,cartwheel:3,walking:3", seed=1, ik=True),
    "dances": lambda: synthesized("dance-salsa:4,dance-modern:4", seed=2, ik=True),
    "strikes, feet free": lambda: synthesized("kicking:3,punching:3", seed=3),
    "a crowd": lambda: synthesized("idle:2,backflip:2", seed=4, count=3, ik=True),
    "white noise": lambda: synthesized("balance:2,jumping-b:2", seed=5, noise=Noise("sample", 0.1)),
    "the mean": lambda: synthesized("martial-arts:4", seed=6, noise=Noise("mean")),
    "a clip to start from": lambda: synthesized("running:3", seed=7, init=SAMPLE / "16_45.bvh", fps=30.0),
    "figure-eight": lambda: followed("figure-eight", ["walking"]),
    "circle, three types": lambda: followed("circle", ["running", "cartwheel", "b-walking"]),
    "live": driven,
}

if __name__ == "__main__":
    import tempfile

    values = {name: case() for name, case in CASES.items()}
    values["features"] = features(Path(tempfile.mkdtemp()) / "sample")
    np.savez_compressed(FILE, **values)
    print(FILE.stat().st_size)
