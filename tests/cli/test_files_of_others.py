"""Two runs on one output, files that motionkit did not write, and runs that are killed while they write."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.locks import held
from motionkit.motion.bvh import write_bvh
from synthetic_motions import make_walk

TINY = ("--preset", "tiny", "--steps", "1", "--device", "cpu")


@pytest.fixture(autouse=True)
def clips(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    write_bvh(tmp_path / "clips" / "walk.bvh", make_walk(60))


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
    with held(where, "testing"):
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
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("words", "several"),
    [
        ((*MOTION, "out/a.bvh"), 1),
        pytest.param((*MOTION, "out/a.glb"), 1, marks=SLOW),
        pytest.param((*MOTION, "out/a.csv"), 1, marks=SLOW),
        pytest.param((*MOTION, "out/a.npz"), 1, marks=SLOW),
        pytest.param((*MOTION, "out/a.usda"), 1, marks=SLOW),
        pytest.param((*MOTION, "out/a.vrma"), 1, marks=SLOW),
        pytest.param(("mirror", "clips/walk.bvh", "out/a.bvh"), 1, marks=SLOW),
        pytest.param(("loop", "clips/walk.bvh", "-o", "out/a.bvh", "--from", "0"), 1, marks=SLOW),
        pytest.param(("fix", "clips/walk.bvh", "-o", "out/a.bvh"), 1, marks=SLOW),
        pytest.param(("retarget", "clips/walk.bvh", "--to", "clips/walk.bvh", "-o", "out/a.bvh"), 1, marks=SLOW),
        pytest.param(("view", "clips/walk.bvh", "-o", "out/a.html"), 1, marks=SLOW),
        pytest.param(("view", "clips/walk.bvh", "-o", "out/a.png"), 1, marks=SLOW),
        pytest.param(("view", "clips/walk.bvh", "-o", "out/a.gif"), 1, marks=SLOW),
        pytest.param(("preprocess", "clips", "-o", "out/ds"), 6, marks=SLOW),
        pytest.param(("export", "--onnx", "out/a.onnx", "--model", "MODEL"), 2, marks=SLOW),
        pytest.param(("demo", "-o", "out", "--model", "MODEL"), 5, marks=SLOW),
    ],
)  # fmt: skip
def test_a_killed_run_leaves_whole_files_and_the_next_cleans_up(
    tmp_path: Path, words: tuple[str, ...], several: int, tiny_model_file: Path
) -> None:
    def run(at: int, seed: int) -> int:
        places = {"SEED": str(seed), "MODEL": str(tiny_model_file)}
        asked = [places.get(word, word) for word in words]
        command = [sys.executable, "-c", KILLED_AT, str(at), *asked]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True).returncode

    out, (old, new) = tmp_path / "out", (1, 2) if "SEED" in words else (1, 1)
    assert run(0, new) == 0
    whole = visible(out)
    assert len(whole) == several
    assert run(0, old) == 0
    former, kills = visible(out), 0
    while run(kills + 1, new) == -signal.SIGKILL:
        kills += 1
        for name, data in visible(out).items():
            if "/." not in f"/{name}":
                assert data in (former[name], whole[name]), (kills, name)
        assert run(0, old) == 0
        assert visible(out).keys() == former.keys(), f"what kill {kills} left is not cleaned up"
    assert kills >= 2
