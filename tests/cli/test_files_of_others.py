"""Two runs on one output, files that motionkit did not write, and runs that are killed while they write."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from motionkit.locks import locked
from motionkit.motion.bvh import write_bvh
from synthetic_characters import CHARACTERS, skinned
from synthetic_motions import make_walk

pytestmark = pytest.mark.thorough

TINY = ("--preset", "tiny", "--steps", "1", "--device", "cpu")


@pytest.fixture(autouse=True)
def clips(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    write_bvh(tmp_path / "clips" / "walk.bvh", make_walk(60))
    (tmp_path / "hero.glb").write_bytes(skinned(CHARACTERS["plain"]()))


def visible(folder: Path) -> dict[str, bytes]:
    """All files of a folder by name."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (("preprocess", "clips", "-o", "ds"), "ds"),
        (("quickstart", "clips", "-o", "out"), "out"),
        (("train", "DATASET", "-o", "m.safetensors", *TINY), "m.run"),
        (("train", "DATASET", "-o", "m.safetensors", "--run-folder", "r", "--force", *TINY), "r"),
        (("experiment", "run", "last frame", "--data", "DATASET", "--results", "r"), "r/D_L/cpu/FILE"),
    ],
)
def test_the_second_run_on_an_output_is_refused(
    motionkit, tmp_path: Path, dataset_folder: Path, words: tuple[str, ...], place: str
) -> None:
    words = tuple(str(dataset_folder) if word == "DATASET" else word for word in words)
    where = Path(place.replace("FILE", "last-frame-0.json"))
    with locked(where, "testing"):
        before = visible(tmp_path)
        said = motionkit(*words)
        assert said.code == 1 and "another run is" in said.err and "(process " in said.err
        assert visible(tmp_path) == before
    assert not list(tmp_path.rglob(".*"))


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (("demo", "-o", "out"), ("index.html",)),
        (("demo", "-o", "out"), ("sw.js",)),
        (("demo", "-o", "out"), ("model.bin", "three-LICENSE.txt")),
        (("quickstart", "clips", "-o", "out"), ("motions.html",)),
        (("quickstart", "clips", "-o", "out"), ("verdict.md",)),
        (("quickstart", "clips", "-o", "out", "--resume"), ("motions.png",)),
    ],
)
def test_files_that_motionkit_did_not_write_stay(
    motionkit, tmp_path: Path, words: tuple[str, ...], names: tuple[str, ...]
) -> None:
    (tmp_path / "out").mkdir()
    for name in (*names, "notes.txt"):
        (tmp_path / "out" / name).write_text("mine")
    before = visible(tmp_path)
    said = motionkit(*words)
    assert said.code == 2 and "was not written by motionkit" in said.err and visible(tmp_path) == before
    if words[0] == "demo":
        assert motionkit(*words, "--force").code == 0
        after = visible(tmp_path / "out")
        assert after["notes.txt"] == b"mine" and b"mine" not in {after[name] for name in names}
        assert motionkit(*words).code == 0, "its own files may be replaced"


# Runs the command line and kills it before the n-th call that makes a file last or take its name.
KILLED_AT = """
import os, signal, sys
left = int(sys.argv[1])

def deadly(plain):
    def call(*args, **options):
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return plain(*args, **options)
    return call

for name in ("fsync", "replace", "rename"):
    setattr(os, name, deadly(getattr(os, name)))
sys.argv = ["motionkit", *sys.argv[2:]]
from motionkit.cli.main import main
main()
"""
MOTION = ("synthesize", "--types", "idle:0.1", "--model", "MODEL", "--seed", "SEED", "-o")
# Commands that write, and how many files.
WRITING: list[tuple[tuple[str, ...], int]] = [
    ((*MOTION, "out/a.bvh"), 1),
    *(((*MOTION, f"out/a.{ending}"), 1) for ending in ("glb", "csv", "npz", "usda", "vrma")),
    *(
        (("convert", "clips/walk.bvh", f"out/a.{ending}"), 1)
        for ending in ("bvh", "glb", "csv", "npz", "usda")
    ),
    (("convert", "clips", "out", "--format", "csv", "--jobs", "1"), 1),
    (("trim", "clips/walk.bvh", "-o", "out/a.bvh", "--from", "0.1"), 1),
    (("join", "clips/walk.bvh", "clips/walk.bvh", "-o", "out/a.bvh"), 1),
    (("mirror", "clips/walk.bvh", "out/a.bvh"), 1),
    (("loop", "clips/walk.bvh", "-o", "out/a.bvh"), 1),
    (("fix", "clips/walk.bvh", "-o", "out/a.bvh"), 1),
    (("retarget", "clips/walk.bvh", "--rig", "clips/walk.bvh", "-o", "out/a.bvh"), 1),
    (("retarget", "clips/walk.bvh", "--rig", "hero.glb", "-o", "out/a.glb"), 1),
    (("join", "clips/walk.bvh", "clips/walk.bvh", "-o", "out/a.glb", "--rig", "hero.glb"), 1),
    (("fix", "clips", "-o", "out", "--jobs", "1"), 1),
    (("follow-path", "line", "--size", "0.2", "--model", "MODEL", "--seed", "SEED", "-o", "out/a.bvh"), 1),
    *((("view", "clips/walk.bvh", "-o", f"out/a.{ending}"), 1) for ending in ("html", "png", "gif")),
    (("preprocess", "clips", "-o", "out/ds"), 6),
    (("export", "--onnx", "out/a.onnx", "--model", "MODEL"), 2),
    (("demo", "-o", "out", "--model", "MODEL"), 5),
]
writing = pytest.mark.parametrize(
    ("words", "several"),
    [pytest.param(*each, marks=[pytest.mark.slow] * (each is not WRITING[0])) for each in WRITING],
)


def started(folder: Path, at: int, words: Sequence[object]) -> subprocess.Popen:
    """A run that is killed at its at-th call that makes a file last."""
    command = [sys.executable, "-c", KILLED_AT, str(at), *map(str, words)]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


class Killed:
    """Runs of a command on an old output, of which some are killed."""

    def __init__(self, folder: Path, words: tuple[str, ...], several: int, model: Path) -> None:
        self.folder, self.out, self.words, self.model = folder, folder / "out", words, model
        self.old, self.new = (1, 2) if "SEED" in words else (1, 1)
        assert self.finishes(self.begun(0, self.new))
        self.whole = visible(self.out)
        assert len(self.whole) == several
        assert self.finishes(self.begun(0, self.old))
        self.former = visible(self.out)

    def begun(self, at: int, seed: int) -> subprocess.Popen:
        """A run that is killed at its at-th call that makes a file last."""
        places = {"SEED": str(seed), "MODEL": str(self.model)}
        return started(self.folder, at, [places.get(word, word) for word in self.words])

    def finishes(self, run: subprocess.Popen) -> bool:
        """Whether a run was not killed; each file is the old or the new one, and the next run cleans up."""
        killed = run.wait() == -signal.SIGKILL
        assert killed or run.returncode == 0
        if killed:
            for name, data in visible(self.out).items():
                if "/." not in f"/{name}":
                    assert data in (self.former[name], self.whole[name]), name
            assert self.begun(0, self.old).wait() == 0
            assert visible(self.out).keys() == self.former.keys(), (
                "what the killed run left is not cleaned up"
            )
        return not killed


@writing
def test_a_killed_run_leaves_whole_files_and_the_next_cleans_up(
    tmp_path: Path, words: tuple[str, ...], several: int, tiny_model_file: Path
) -> None:
    runs, kills = Killed(tmp_path, words, several, tiny_model_file), 0
    while not runs.finishes(runs.begun(kills + 1, runs.new)):
        kills += 1
    print(f"killed {kills} times: {' '.join(words)}")
    assert kills >= 2


@pytest.mark.slow
@pytest.mark.parametrize(("words", "several"), WRITING)
def test_a_run_killed_at_any_moment_leaves_whole_files(
    tmp_path: Path, words: tuple[str, ...], several: int, tiny_model_file: Path
) -> None:
    runs, chance = Killed(tmp_path, words, several, tiny_model_file), random.Random(1)
    began = time.monotonic()
    assert runs.finishes(runs.begun(0, runs.old))
    lasts, kills = time.monotonic() - began, 0
    for _ in range(int(os.environ.get("MOTIONKIT_KILLS", "4"))):
        run = runs.begun(0, runs.new)
        time.sleep(lasts * chance.uniform(0.4, 1.0))
        run.kill()
        kills += not runs.finishes(run)
    print(f"killed {kills} times: {' '.join(words)}")


@pytest.mark.slow
def test_a_killed_experiment_leaves_a_whole_result_or_none(tmp_path: Path, paper_folder: Path) -> None:
    words = ["experiment", "run", "last frame", "--set", "all", "--data", paper_folder, "--frames", 30]
    chance, kills, lasts, began = random.Random(1), 0, 0.0, time.monotonic()
    for at in (0, 1, 2, *[0] * int(os.environ.get("MOTIONKIT_KILLS", "4"))):
        run = started(tmp_path, at, [*words, "--results", "out"])
        if at == 0 and kills:
            time.sleep(lasts * chance.uniform(0.4, 1.0))
            run.kill()
        killed = run.wait() == -signal.SIGKILL
        kills += killed
        made = [data for name, data in visible(tmp_path / "out").items() if name.endswith(".json")]
        assert len(made) == (not killed) and all(json.loads(data)["groups"] for data in made)
        assert started(tmp_path, 0, [*words, "--results", "out"]).wait() == 0
        assert len(visible(tmp_path / "out")) == 1, "what the killed run left is not cleaned up"
        shutil.rmtree(tmp_path / "out")
        lasts = 0.5 * (time.monotonic() - began) if not kills else lasts
    print(f"killed {kills} times: {' '.join(map(str, words))}")
    assert kills >= 2
