"""Mutated model and run files: each works, or is refused in one clear line and leaves no file."""

from __future__ import annotations

import json
import random
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fuzz.mutation import (
    SLOW_SECONDS,
    files_below,
    for_seconds,
    mutated_bytes,
    mutated_json,
    refuses_or_works_apart,
)
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.errors import MotionkitError
from motionkit.models.checkpoint import load_model
from motionkit.motion.bvh import read_bvh, write_bvh
from motionkit.training.trainer import train

pytestmark = pytest.mark.thorough

quick = settings(derandomize=True, deadline=None, suppress_health_check=list(HealthCheck), database=None)
seeds = st.integers(0, 2**32 - 1)
FLOATS = (float("nan"), float("inf"), -float("inf"), 3e38, -1e30, 1e12, 1e-45, 0.0, -1.0)


class File:
    """A safetensors file taken apart, so that any of it can be wrong."""

    def __init__(self, path: Path, key: str) -> None:
        whole = path.read_bytes()
        length = int.from_bytes(whole[:8], "little")
        self.key, self.data = key, whole[8 + length :]
        self.table = json.loads(whole[8 : 8 + length])
        self.document = json.loads(self.table.pop("__metadata__")[key])

    def mutated(self, chance: random.Random) -> bytes:
        """The file with something wrong: its bytes, its table, its document or the numbers of a tensor."""
        table, document, data = dict(self.table), self.document, self.data
        kind = chance.randrange(6)
        if kind == 0:
            return mutated_bytes(chance, self._whole(table, document, data))
        if kind == 1:
            names = chance.sample(sorted(table), 2)
            changed = mutated_json(chance, {name: table.pop(name) for name in names})
            table |= changed if isinstance(changed, dict) else {}
        elif kind == 2:
            document = mutated_json(chance, document)
        elif kind in (3, 4):
            holder = chance.choice(sorted(k for k, v in document.items() if isinstance(v, dict) and v))
            document = document | {holder: mutated_json(chance, document[holder])}
        else:
            data = self._spoilt(chance)
        return self._whole(table, document, data)

    def _spoilt(self, chance: random.Random) -> bytes:
        """The data with other numbers in a tensor, or in all those of the network."""
        floats = sorted(name for name, entry in self.table.items() if entry["dtype"] == "F32")
        names = floats if chance.random() < 0.2 else [chance.choice(floats)]
        out, number = bytearray(self.data), struct.pack("<f", chance.choice(FLOATS))
        for name in names:
            first, last = self.table[name]["data_offsets"]
            end = last if chance.random() < 0.5 else min(last, first + 4)
            out[first:end] = number * ((end - first) // 4)
        return bytes(out)

    def _whole(self, table: Any, document: Any, data: bytes) -> bytes:
        header = {"__metadata__": {self.key: json.dumps(document)}, **table}
        text = json.dumps(header).encode("utf-8", "surrogatepass")
        return len(text).to_bytes(8, "little") + text + data


@pytest.fixture(scope="module")
def model_case(
    tiny_model_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[random.Random], None]:
    """Opens a mutant of the tiny model and synthesizes a few frames with it."""
    original, folder = File(tiny_model_file, "motionkit"), tmp_path_factory.mktemp("fuzzed-model")

    def case(chance: random.Random) -> None:
        path, made = folder / "m.safetensors", folder / "out.bvh"
        path.write_bytes(original.mutated(chance))
        made.unlink(missing_ok=True)

        def work() -> None:
            before = files_below(folder)
            try:
                model = load_model(path)
                parts = [TypePart(kind, 3.0 / model.fps) for kind in model.type_names[:2]]
                result = synthesize(model, parts, SynthesisOptions(count=2, ik=True))
                write_bvh(made, result.motions[0].motion)
            except MotionkitError:
                assert files_below(folder) == before
                raise
            assert len(read_bvh(made).values) == 6

        refuses_or_works_apart(work)

    return case


@pytest.fixture(scope="module")
def run_case(
    dataset_folder: Path, tiny_options: Callable, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[random.Random], None]:
    """Goes on from a mutant of a run's checkpoint for one step."""
    folder = tmp_path_factory.mktemp("fuzzed-run")
    model, run = folder / "m.safetensors", folder / "m.run"
    train(dataset_folder, model, tiny_options(steps=1, splices=0), device="cpu")
    original = File(run / "checkpoint.safetensors", "run")

    def case(chance: random.Random) -> None:
        model.unlink(missing_ok=True)
        shutil.rmtree(run)
        run.mkdir()
        (run / "checkpoint.safetensors").write_bytes(original.mutated(chance))

        def work() -> None:
            before = files_below(folder)
            try:
                train(dataset_folder, model, tiny_options(steps=2, splices=0), resume=True, device="cpu")
            except MotionkitError:
                assert files_below(folder) == before
                raise
            load_model(model)

        refuses_or_works_apart(work)

    return case


@settings(quick, max_examples=16)
@given(seed=seeds)
def test_models(model_case: Callable[[random.Random], None], seed: int) -> None:
    model_case(random.Random(seed))


@settings(quick, max_examples=8)
@given(seed=seeds)
def test_runs(run_case: Callable[[random.Random], None], seed: int) -> None:
    run_case(random.Random(seed))


@pytest.mark.slow
def test_models_for_long(model_case: Callable[[random.Random], None]) -> None:
    for_seconds(0.35 * SLOW_SECONDS, model_case)


@pytest.mark.slow
def test_runs_for_long(run_case: Callable[[random.Random], None]) -> None:
    for_seconds(0.15 * SLOW_SECONDS, run_case)
