"""Mutated keys, bone maps, answers of raters and results of experiments: each works, or is refused in one line."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fuzz.mutation import (
    READING_SECONDS,
    SLOW_SECONDS,
    for_seconds,
    mutated_json,
    mutated_text,
    refuses_or_works,
)
from motionkit.control.keys import read_keys
from motionkit.lab.paper.model_results import read_models
from motionkit.lab.paper.page import Extras, bodies_section, long_section, scenes_section
from motionkit.lab.paper.ttest import FORMAT, read_answers, scores
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import write_bvh
from motionkit.rig.map_file import read_rig_map, write_rig_map
from motionkit.rig.names import map_rig
from synthetic_motions import make_walk

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
EXPERIMENTS = Path(__file__).parents[2] / "experiments"
KEYS = {
    "keys": [
        {"time": 1.5, "position": [0.3, 2.0], "facing": 20},
        {"time": 2.4, "joints": {"RightHand": [0.2, 1.6, 3.2]}},
        {"time": 3.6, "pose": {"file": "walk.bvh", "seconds": 0.5}, "position": [0.8, 4.6], "facing": 10},
    ]
}
ANSWERS = {
    "format": FORMAT,
    "rater": "A",
    "answers": [
        {"group": g, "model": m, "score": s} for g, m, s in (("a", "x", 1), ("b", "x", 5), ("a", "y", 3))
    ],
}
Case = Callable[[random.Random, Path], Callable[[], object]]


def put(chance: random.Random, path: Path, value: object) -> None:
    """Write a JSON value with its values or its letters mutated."""
    if chance.random() < 0.7:
        path.write_text(json.dumps(mutated_json(chance, value)), "utf-8", "surrogatepass")
    else:
        path.write_bytes(mutated_text(chance, json.dumps(value, indent=1)))


@pytest.fixture(scope="module")
def cases(tiny_model: MotionModel) -> dict[str, Case]:
    walk = make_walk(60)

    def keys(chance: random.Random, folder: Path) -> Callable[[], object]:
        if not (folder / "walk.bvh").exists():
            write_bvh(folder / "walk.bvh", walk)
        put(chance, folder / "keys.json", KEYS)
        return lambda: read_keys(folder / "keys.json", tiny_model)

    def bone_map(chance: random.Random, folder: Path) -> Callable[[], object]:
        path = folder / "map.json"
        write_rig_map(path, walk.skeleton, map_rig(walk.skeleton))
        put(chance, path, json.loads(path.read_text()))
        return lambda: read_rig_map(path, walk.skeleton)

    def answers(chance: random.Random, folder: Path) -> Callable[[], object]:
        put(chance, folder / "answers.json", ANSWERS)
        return lambda: [
            (s.mean, s.deviation) for s in scores(read_answers([folder / "answers.json"])).values()
        ]

    def results(chance: random.Random, folder: Path) -> Callable[[], object]:
        kind = chance.choice(("long", "bodies", "scenes"))
        place = folder / kind
        place.mkdir(exist_ok=True)
        put(
            chance,
            place / "one.json",
            json.loads(chance.choice(sorted((EXPERIMENTS / kind).glob("*.json"))).read_text()),
        )

        def work() -> None:
            if kind == "long":
                long_section(read_models(place, "long"), folder)
            elif kind == "bodies":
                bodies_section(read_models(place, "bodies"))
            else:
                scenes_section(Extras(scenes=tuple(read_models(place, "scenes"))).scenes, folder)

        return work

    return {"keys": keys, "map": bone_map, "answers": answers, "results": results}


@pytest.mark.parametrize("kind", ["keys", "map", "answers", "results"])
@settings(
    derandomize=True, deadline=None, suppress_health_check=list(HealthCheck), database=None,
    phases=(Phase.generate,), max_examples=150,
)  # fmt: skip
@given(seed=st.integers(0, 2**32 - 1))
def test_requests(
    cases: dict[str, Case], tmp_path_factory: pytest.TempPathFactory, kind: str, seed: int
) -> None:
    folder = tmp_path_factory.getbasetemp() / f"fuzz-{kind}"
    folder.mkdir(exist_ok=True)
    refuses_or_works(cases[kind](random.Random(seed), folder), READING_SECONDS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["keys", "map", "answers", "results"])
def test_requests_for_long(cases: dict[str, Case], tmp_path: Path, kind: str) -> None:
    for_seconds(0.05 * SLOW_SECONDS, lambda chance: refuses_or_works(cases[kind](chance, tmp_path)))
