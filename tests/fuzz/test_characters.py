"""Mutated .glb and .vrm files: each is read, animated and shown, or refused in one clear line, within a second."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fuzz.mutation import (
    READING_SECONDS,
    SLOW_SECONDS,
    for_seconds,
    mutated_bytes,
    mutated_json,
    refuses_or_works,
)
from motionkit.export.formats import read_clip, write_motion
from motionkit.motion.bvh import bvh_to_motion
from motionkit.rig.character import read_character
from motionkit.rig.gltf import BIN_CHUNK, JSON_CHUNK, MAGIC
from motionkit.rig.read_file import read_file
from motionkit.view.character_data import character_joints, page_bytes
from synthetic_characters import CHARACTERS, skinned
from synthetic_motions import make_walk

pytestmark = [pytest.mark.thorough, pytest.mark.filterwarnings("error::RuntimeWarning")]
FLOATS = (float("nan"), float("inf"), 3e38, -1e30, 1e6, 1e-45, 0.0, -1.0)


def animated(value: dict[str, Any]) -> None:
    """Turn and move the first joints of a character: by one key, linearly, in steps and by a sparse accessor."""
    numbers = {"bufferView": 2, "componentType": 5126}  # the weights: 1, 0, 0, 0, and so on
    first = len(value["accessors"])
    value["accessors"] += [
        {**numbers, "count": 2, "type": "SCALAR", "byteOffset": 4 * 3, "max": [1.0]},
        {**numbers, "count": 2, "type": "VEC4"},
        {**numbers, "count": 2, "type": "VEC3", "byteOffset": 4},
        {"componentType": 5126, "count": 2, "type": "VEC4", "sparse": {
            "count": 2, "indices": {"bufferView": 1, "byteOffset": 23, "componentType": 5121},
            "values": {"bufferView": 2}}},
    ]  # fmt: skip
    joints = value["skins"][0]["joints"]
    value["animations"] = [{
        "name": "turn",
        "samplers": [
            {"input": first, "output": first + 1},
            {"input": first, "output": first + 2, "interpolation": "STEP"},
            {"input": first, "output": first + 3, "interpolation": "LINEAR"},
        ],
        "channels": [
            {"sampler": 0, "target": {"node": joints[1], "path": "rotation"}},
            {"sampler": 1, "target": {"node": joints[0], "path": "translation"}},
            {"sampler": 2, "target": {"node": joints[2], "path": "rotation"}},
        ],
    }]  # fmt: skip


def chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the buffer of a binary glTF file."""
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def whole(value: object, data: bytes) -> bytes:
    text = json.dumps(value).encode("utf-8", "surrogatepass")
    parts = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(data), BIN_CHUNK) + data
    return struct.pack("<III", MAGIC, 2, 12 + len(parts)) + parts


def mutated_character(chance: random.Random, data: bytes) -> bytes:
    """A file with something wrong: its bytes, a part of its JSON, or the numbers of its buffer."""
    kind, (value, buffer) = chance.randrange(8), chunks(data)
    if kind == 0:
        return mutated_bytes(chance, data)
    if kind == 1:
        return whole(mutated_json(chance, value), buffer)
    if kind <= 5:
        part = chance.choice([key for key in value if key != "asset"])
        value[part] = mutated_json(chance, value[part])
        return whole(value, buffer)
    numbers = np.frombuffer(buffer, "<f4").copy()
    for _ in range(chance.choice((1, 1, 3, len(numbers)))):
        numbers[chance.randrange(len(numbers))] = chance.choice(FLOATS)
    return whole(value, numbers.tobytes())


def character_case(chance: random.Random, folder: Path) -> Callable[[], None]:
    """A mutated character, and all that reads one: its motion, its joints on a page, a motion into its file."""
    kind = chance.choice(("own", "plain", "twists", "vrm0", "vrm1"))
    path = folder / ("a.vrm" if kind.startswith("vrm") else "a.glb")
    out = path.with_stem("out")
    if kind == "own":
        write_motion(path, make_walk(3))
    else:
        path.write_bytes(skinned(CHARACTERS[kind](), animated))
    read_file(path)  # what is mutated is whole
    path.write_bytes(mutated_character(chance, path.read_bytes()))
    out.unlink(missing_ok=True)

    def show() -> None:
        character = read_character(path)
        page_bytes(character.tree.file)
        text = json.dumps(character_joints(character, [0], 1.0, np.array([0.0, 1.0, 0.0])), allow_nan=False)
        assert len(text) < 10**6

    def read() -> None:
        motion = bvh_to_motion(read_file(path))
        for values in (motion.local_rotations, motion.root_positions, motion.skeleton.offsets):
            assert np.isfinite(values).all()

    def add() -> None:
        write_motion(out, read_clip(path))

    def work() -> None:
        for use in (show, read):
            refuses_or_works(use, READING_SECONDS)
        if refuses_or_works(add, READING_SECONDS):
            assert not out.exists(), "a refusal leaves no file"
        else:
            json.dumps(chunks(out.read_bytes())[0], allow_nan=False)

    return work


@settings(
    derandomize=True, deadline=None, suppress_health_check=list(HealthCheck), database=None,
    phases=(Phase.generate,), max_examples=150,
)  # fmt: skip
@given(seed=st.integers(0, 2**32 - 1))
def test_characters(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    folder = tmp_path_factory.getbasetemp() / "characters"
    folder.mkdir(exist_ok=True)
    character_case(random.Random(seed), folder)()


@pytest.mark.slow
def test_characters_for_long(tmp_path: Path) -> None:
    for_seconds(0.1 * SLOW_SECONDS, lambda chance: character_case(chance, tmp_path)())
