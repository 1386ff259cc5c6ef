"""A character's motion depends on its seed alone: not on the characters beside it, nor on the number of threads."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import motionkit
from motionkit.control.script import TypePart, parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.features.control import Controls
from motionkit.inference import step_kernel
from motionkit.inference.character import CharacterStream
from motionkit.inference.noise import Noise
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel

pytestmark = pytest.mark.thorough

HERE = Path(__file__)
PLAN = "running:0.1,cartwheel:0.2"


@pytest.fixture
def model() -> MotionModel:
    """The bundled model, packed anew, not with what others have left."""
    bundled = load_bundled_model()
    return replace(bundled, network=replace(bundled.network))


def crowd(
    model: MotionModel, plans: list[list[TypePart]], count: int, seed: int, **options: object
) -> list[bytes]:
    """The rotations and places of each of a crowd, to the last bit."""
    made = synthesize(model, plans, SynthesisOptions(count, seed, ik=True, **options))  # type: ignore[arg-type]
    motions = [one.motion for one in made.motions]
    return [motion.local_rotations.tobytes() + motion.root_positions.tobytes() for motion in motions]


@pytest.mark.parametrize(
    "noise", [Noise(), Noise("sample", 0.3), Noise("mean")], ids=lambda noise: noise.kind
)
def test_every_one_of_a_crowd_is_the_one_of_its_seed(model: MotionModel, noise: Noise) -> None:
    plans = [parse_types(PLAN)]
    three, forty = (crowd(model, plans, count, 5, noise=noise) for count in (3, 40))
    assert three == forty[:3]
    for index in (0, 2, 17, 39):
        assert crowd(model, plans, 1, 5 + index, noise=noise) == [forty[index]]
    assert len(set(forty)) > 9


def test_with_plans_and_bodies_in_turn_too(model: MotionModel) -> None:
    """The second plan starts from fewer frames than the first."""
    kicking = model.types["kicking"]
    short = tuple(replace(p, features=p.features[:9], contacts=p.contacts[:9]) for p in kicking.start_poses)
    types = {**model.types, "kicking": replace(kicking, start_poses=short)}
    tall = {**model.characters, "tall": 1.2 * model.characters["default"]}
    model = replace(model, types=types, characters=tall)
    plans = [parse_types(text) for text in ("walking:0.4", "kicking:0.3,idle:0.4", "backflip:0.5")]
    seven = crowd(model, plans, 7, 11, character="default,tall")
    for index, made in enumerate(seven):
        body = ("default", "tall")[index % 2]
        assert crowd(model, [plans[index % 3]], 1, 11 + index, character=body) == [made], index


@pytest.mark.parametrize("ik", [True, False])
def test_live_characters_too_whatever_is_reset(model: MotionModel, ik: bool) -> None:
    count, frames = 40, 36
    random = np.random.default_rng(0)
    weights = random.dirichlet(np.ones(len(model.types)), count).astype(np.float32)
    asked = Controls(
        weights,
        random.normal(0.0, 30.0, (count, 24)).astype(np.float32),
        (np.arange(count) % 2).astype(np.float32),
        random.uniform(-0.5, 1.0, count).astype(np.float32),
        random.standard_normal((count, 72), np.float32),
        (np.arange(count) % 3).astype(np.float32),
        random.random(count, np.float32),
    )
    resets = {10: (2, "running"), 25: (7, "kicking"), 31: (2, "idle")}

    def run(rows: list[int]) -> np.ndarray:
        stream = CharacterStream(model, len(rows), Noise(), 7 + rows[0], ik)
        mine = asked.at(rows)
        kept = []
        for frame in range(frames):
            row, kind = resets.get(frame, (-1, ""))
            if row in rows:
                stream.reset(rows.index(row), type=kind, place=(10.0, 5.0, 0.3))
            shown = stream.step(mine)
            kept.append(np.concatenate([shown.positions.reshape(len(rows), -1), shown.contacts], axis=1))
        return np.stack(kept, axis=1)

    everyone = run(list(range(count)))
    for rows in ([0], [2], [7], [39], [1, 2, 3]):
        assert np.array_equal(run(rows), everyone[rows]), rows


def fingerprints() -> str:
    """Of a crowd, by one worker and by two; printed by this file as a script."""
    plans, found = [parse_types(PLAN)], []
    for workers in (1, 2):
        bundled = load_bundled_model()
        model = replace(bundled, network=replace(bundled.network))
        step_kernel.cores = lambda workers=workers: workers  # type: ignore[assignment]
        found.append(hashlib.sha256(b"".join(crowd(model, plans, 40, 5))).hexdigest())
    return "\n".join(found)


def test_threads_change_no_byte() -> None:
    said = []
    path = os.pathsep.join([str(Path(motionkit.__file__).parents[1]), str(HERE.parents[1])])
    for threads in ("1", "5"):
        changed = {"PYTHONPATH": path, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        done = subprocess.run(
            [sys.executable, str(HERE)], capture_output=True, text=True, timeout=170, env=os.environ | changed
        )
        assert done.returncode == 0, done.stderr[-2000:]
        said.append(done.stdout.split())
    assert said[0] == said[1]
    one, two = said[0]
    assert one == two


if __name__ == "__main__":
    print(fingerprints())
