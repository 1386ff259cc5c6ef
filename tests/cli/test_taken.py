"""Every command that takes a clip says what it took: frames, rate, unit, up axis and joints."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from motionkit.export.formats import write_motion
from synthetic_motions import make_walk

WORDS = "150 frames at 60 fps; unit: centimetres; +Y up; 23 joints found by name"


def test_units_of_characters_and_files_that_are_given_twice(motionkit, tmp_path: Path) -> None:
    """A .glb is in metres whatever reads it, and each clip of a join has its line."""
    write_motion(tmp_path / "a.glb", make_walk(150))
    line = f"  a.glb: {WORDS}".replace("centimetres", "metres, as the format says")
    for words in (
        "convert a.glb a.csv",
        "metrics a.glb",
        "retarget a.glb --rig @cmu",
        "view a.glb --no-open",
    ):
        assert line in motionkit(*words.split()).out.splitlines(), words
    assert motionkit("join", "a.glb", "a.glb").out.splitlines().count(line) == 2


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [("walk.txt", None, WORDS), ("walk.csv", "time,x", "the name of a file of another kind ends in .bvh")],
)
@pytest.mark.parametrize("command", ["trim", "view", "retarget", "metrics", "mirror"])
def test_names_with_an_unknown_ending(
    motionkit, tmp_path: Path, command: str, name: str, text: str | None, said: str
) -> None:
    """All commands read such a file as BVH, or say which names there are."""
    write_motion(tmp_path / "a.bvh", make_walk(150))
    (tmp_path / name).write_text(text or (tmp_path / "a.bvh").read_text())
    target = {"view": ["--no-open", "-o", "b.html"], "metrics": []}.get(command, ["-o", "b.bvh"])
    done = motionkit(command, name, *target)
    assert said in done.out + done.err and (done.code == 0) == (text is None)


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
    told = (told.get("clips") or [told])[0]["taken"]
    assert set([told] if isinstance(told, str) else told) == {WORDS}
