"""Every command that takes a clip says what it took: frames, rate, unit, up axis and joints."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from motionkit.export.formats import write_motion
from synthetic_motions import make_walk

WORDS = "150 frames at 60 fps; unit: centimetres; +Y up; 23 joints found by name"


@pytest.mark.parametrize(
    "words",
    [
        "trim {} --to 1 -o a.bvh",
        "fix {} -o a.bvh",
        "loop {} -o a.bvh",
        "convert {} a.npz",
        "mirror {} a.bvh",
        "join {} {} -o a.bvh",
        "retarget {} --rig @mixamo -o a.bvh",
        "view {} --no-open -o a.html",
        "view {} --rig @mixamo --no-open -o a.html",
        "metrics {}",
    ],
)
def test_every_command_says_what_it_took(motionkit, tmp_path: Path, words: str) -> None:
    name = "Gang ü 1.bvh"
    write_motion(tmp_path / name, make_walk(150))
    command = [name if word == "{}" else word for word in words.split()]
    done = motionkit(*command)
    assert done.code == 0, done.err
    assert f"  {name}: {WORDS}" in done.out.splitlines()
    told = json.loads(motionkit(*command, "--json").out)
    told = (told.get("clips") or told.get("mirrored") or [told])[0]["taken"]
    assert set([told] if isinstance(told, str) else told) == {WORDS}
