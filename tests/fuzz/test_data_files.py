"""Mutated BVH files, label tables, paths and datasets: each works, or is refused in one clear line."""

from __future__ import annotations

import json
import os
import random
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fuzz.mutation import (
    READING_SECONDS,
    SLOW_SECONDS,
    files_below,
    for_seconds,
    mutated_bytes,
    mutated_json,
    mutated_text,
    refuses_or_works,
    refuses_or_works_apart,
)
from motionkit.control.path import read_path
from motionkit.data.dataset import Dataset
from motionkit.data.labels import find_sources
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.errors import MotionkitError
from motionkit.export.formats import write_motion
from motionkit.metrics.report import evaluate_files
from motionkit.motion.bvh import bvh_to_motion, motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.motion import Motion
from motionkit.rig.mirror import mirror_file
from motionkit.rig.read_file import read_file
from synthetic_acclaim import write_acclaim
from synthetic_motions import make_walk

# numpy's warnings would reach the user's terminal beside the one line.
pytestmark = [pytest.mark.thorough, pytest.mark.filterwarnings("error::RuntimeWarning")]

# Seeds do not shrink: a smaller one is another case.
quick = settings(
    derandomize=True,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    database=None,
    phases=(Phase.generate,),
)
seeds = st.integers(0, 2**32 - 1)

BVH_WORDS = (
    *(
        "JOINT x",
        "ROOT",
        "End Site",
        "MOTION",
        "Frames: 2",
        "Frames: 999999999",
        "Frame Time: 1",
        "{",
        "}",
        "OFFSET",
    ),
    *(
        "CHANNELS 1 Xrotation",
        "CHANNELS 6",
        "Xposition",
        "Zrotation",
        "Frame Time: 10",
        "9999999",
        "-9999999",
        "1e-30",
    ),
)
LABEL_WORDS = (
    "walk.bvh",
    "WALK.BVH",
    "../walk.bvh",
    "train",
    "test",
    "valid",
    "-1",
    "1e10",
    '"',
    '"a\nb"',
    "[/b]",
)
PATH_WORDS = (
    "walking",
    "1e6",
    "-1e6",
    "15",
    "0.05",
    "[0, 1]",
    "[[0, 0], [1e308, 1]]",
    '"type"',
    "{}",
    "null",
)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A BVH file of the canonical rig, twelve frames of a walk."""
    path = tmp_path_factory.mktemp("walk") / "walk.bvh"
    write_bvh(path, make_walk(12))
    return path


EXTREMES = ("0", "9999999", "-9999999", "1e-30", "-1e-7", "3000", "-0.001", "180", "90", "1e6", "360.000001")


def strange_bvh(chance: random.Random, text: str) -> bytes:
    """A BVH text whose grammar is whole and whose numbers are allowed, but such as nobody recorded."""
    head, motion = text.split("MOTION\n")
    rows = motion.rstrip("\n").split("\n")[2:] or [""]
    rows = chance.choice((rows, rows[:1], rows[:2], rows * 3, rows[::-1]))
    share = chance.choice((0.0, 0.002, 0.02, 0.5, 1.0))
    extremes = chance.choice((EXTREMES, EXTREMES, (chance.choice(EXTREMES),)))

    def changed(line: str) -> str:
        return " ".join(chance.choice(extremes) if chance.random() < share else w for w in line.split(" "))

    kept = (
        head
        if chance.random() < 0.5
        else "\n".join(
            line.split("OFFSET ")[0] + "OFFSET " + changed(line.split("OFFSET ")[1])
            if "OFFSET " in line
            else line
            for line in head.split("\n")
        )
    )
    rows = [changed(row) if chance.random() < 0.5 else row for row in rows]
    time = chance.choice(("0.0166667", "0.0001", "1", "0.5", "0.008333"))
    return f"{kept}MOTION\nFrames: {len(rows)}\nFrame Time: {time}\n{chr(10).join(rows)}\n".encode()


def bvh_case(chance: random.Random, folder: Path, files: list[Path]) -> Callable[[], None]:
    """A mutated BVH file, and all that reads one: the motion, its image, its metrics."""
    path, image = folder / "damaged.bvh", folder / "image.bvh"
    image.unlink(missing_ok=True)
    text = chance.choice(files).read_text("latin-1")
    strange = chance.random() < 0.5 and text.isascii() and text.count("MOTION\n") == 1
    path.write_bytes(strange_bvh(chance, text) if strange else mutated_text(chance, text, BVH_WORDS))

    def work() -> None:
        motion = bvh_to_motion(read_bvh(path))
        for values in (motion.local_rotations, motion.root_positions, motion.skeleton.offsets):
            assert torch.isfinite(torch.as_tensor(values)).all()
        for use in (lambda: mirror_file(path, image), lambda: told(evaluate_files(path))):
            before = files_below(folder)
            if refuses_or_works(use):
                assert files_below(folder) == before, "a refusal leaves no file"
        if image.exists():
            read_bvh(image)

    return work


def told(report) -> None:
    text = json.dumps(report.as_dict(), allow_nan=False)
    assert len(text) < 100_000


@settings(quick, max_examples=300)
@given(seed=seeds)
def test_bvh_files(tmp_path_factory, seed: int, walk: Path, broken_folder: Path) -> None:
    folder = tmp_path_factory.getbasetemp() / "bvh"
    folder.mkdir(exist_ok=True)
    refuses_or_works(bvh_case(random.Random(seed), folder, [walk, broken_folder / "good.bvh"]))


ACCLAIM_WORDS = (
    ":units",
    ":root",
    ":hierarchy",
    ":bonedata",
    "begin",
    "end",
    "root",
    "lfemur",
    "length",
    "rx",
    "2",
)


def acclaim_case(chance: random.Random, folder: Path) -> Callable[[], None]:
    """A mutated .asf or .amc, or both."""
    made = write_acclaim(folder, make_walk(3))
    for path in chance.choice(([made], [folder / "07.asf"], [made, folder / "07.asf"])):
        path.write_bytes(mutated_text(chance, path.read_text(), ACCLAIM_WORDS))
    return lambda: finite(bvh_to_motion(read_file(made)))


def archive_case(chance: random.Random, folder: Path) -> Callable[[], None]:
    """A mutated archive: its bytes, or those of one of its arrays with everything else right."""
    path, arrays = folder / "a.npz", {"poses": np.zeros((4, 72)), "trans": np.ones((4, 3)), "fps": 30.0}
    write_motion(path, make_walk(4)) if chance.random() < 0.5 else np.savez(path, **arrays)
    if chance.random() < 0.3:
        path.write_bytes(mutated_bytes(chance, path.read_bytes()))
    else:
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        name = chance.choice(sorted(parts))
        whole = chance.random() < 0.3
        parts[name] = mutated_bytes(chance, parts[name][: None if whole else 128]) + (
            b"" if whole else parts[name][128:]
        )
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in parts.items():
                archive.writestr(name, data)
    return lambda: finite(bvh_to_motion(read_file(path)))


def finite(motion: Motion) -> None:
    for values in (motion.local_rotations, motion.root_positions, motion.skeleton.offsets):
        assert np.isfinite(values).all()


LABELS = "file,start_frame,end_frame,type,subject,fps,split\nwalk.bvh,0,60,walking,1,,train\nwalk.bvh,60,-1,run,,120,\n"


def labels_case(chance: random.Random, folder: Path) -> Callable[[], None]:
    """A mutated table beside a file it names."""
    (folder / "walk.bvh").write_text("x")
    (folder / "labels.csv").write_bytes(mutated_text(chance, LABELS, LABEL_WORDS))

    def work() -> None:
        for source in find_sources([folder])[0]:
            for segment in source.segments:
                assert 0 <= segment.start <= 10**9 and -1 <= segment.end <= 10**9
                assert segment.type.isprintable() and "," not in segment.type and ":" not in segment.type

    return work


PATH = {
    "parts": [
        {"type": "walking", "speed": 1.4, "points": [[0, 0], [0, 3], [1, 4]]},
        {"type": "run", "points": [[2, 9]]},
    ]
}
PATH_TABLE = "x,z,type,speed\n0,0,walking,1.4\n0,3,walking,1.4\n1,4,running,\n2,9,running,\n"


def path_case(chance: random.Random, folder: Path) -> Callable[[], None]:
    """A mutated path in JSON, by its values or its letters, or as a table."""
    kind = chance.randrange(3)
    path = folder / ("path.csv" if kind == 0 else "path.json")
    if kind == 0:
        path.write_bytes(mutated_text(chance, PATH_TABLE, PATH_WORDS))
    elif kind == 1:
        path.write_bytes(mutated_text(chance, json.dumps(PATH, indent=1), PATH_WORDS))
    else:
        path.write_text(json.dumps(mutated_json(chance, PATH)))

    def work() -> None:
        found = read_path(path)
        assert torch.isfinite(torch.as_tensor(found.points)).all() and found.length <= 1_000_100.0

    return work


def one_case(tmp_path_factory: pytest.TempPathFactory, make: Callable, seed: int) -> None:
    folder = tmp_path_factory.getbasetemp() / make.__name__
    folder.mkdir(exist_ok=True)
    refuses_or_works(make(random.Random(seed), folder), READING_SECONDS)


@pytest.mark.parametrize("make", [labels_case, path_case])
@settings(quick, max_examples=500)
@given(seed=seeds)
def test_label_tables_and_paths(tmp_path_factory, make: Callable, seed: int) -> None:
    one_case(tmp_path_factory, make, seed)


@pytest.mark.parametrize("make", [acclaim_case, archive_case])
@pytest.mark.filterwarnings("ignore::UserWarning")
@settings(quick, max_examples=150)
@given(seed=seeds)
def test_other_sources_of_motion(tmp_path_factory, make: Callable, seed: int) -> None:
    one_case(tmp_path_factory, make, seed)


def dataset_case(chance: random.Random, whole: Path, folder: Path) -> Callable[[], None]:
    """A dataset with its manifest, one array's header or numbers, or one whole file mutated."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for file in whole.iterdir():
        os.link(file, folder / file.name)
    kind = chance.randrange(5)
    name = "manifest.json" if kind <= 2 else chance.choice(sorted(p.name for p in whole.glob("*.npy")))
    data = (whole / name).read_bytes()
    (folder / name).unlink()  # not to write through the link
    if kind <= 1:
        (folder / name).write_text(json.dumps(mutated_json(chance, json.loads(data))))
    elif kind == 2:
        (folder / name).write_bytes(mutated_bytes(chance, data))
    elif kind == 3:
        (folder / name).write_bytes(mutated_bytes(chance, data[:128]) + data[128:])
    else:
        array = np.load(whole / name).copy()
        array.flat[chance.randrange(array.size)] = chance.choice((1, 100, 127))
        if array.dtype.kind == "f":
            array.flat[chance.randrange(array.size)] = chance.choice((np.nan, np.inf, -1e38, 1e20))
        np.save(folder / name, array if chance.random() < 0.7 else array[: len(array) // 2])
    return lambda: read_whole(folder)


def read_whole(folder: Path) -> None:
    """Open a dataset and take in all that training takes."""
    dataset = Dataset(folder)
    parts = [
        dataset.scaling,
        dataset.trajectory_scaling,
        dataset.reference_rotations,
        dataset.bodies,
        dataset.characters,
    ]
    assert parts and dataset.phase_seconds is not None and len(dataset.sided_types) == len(dataset.types)
    for clip in (*dataset.clips[:3], *dataset.clips[-2:]):
        data = dataset.read(clip)
        assert len(data.features) == clip.frames
        for values in (data.features, data.ground, data.reference):
            assert torch.isfinite(torch.as_tensor(values)).all()
        dataset.skeleton(clip)
        dataset.clip_types(clip)


@settings(quick, max_examples=200)
@given(seed=seeds)
def test_datasets(tmp_path_factory, seed: int, dataset_folder: Path) -> None:
    folder = tmp_path_factory.getbasetemp() / "dataset-copy"
    refuses_or_works(dataset_case(random.Random(seed), dataset_folder, folder))


# ---- long runs: what may take long in children of their own ----


@pytest.mark.slow
def test_bvh_files_for_long(tmp_path: Path, walk: Path, broken_folder: Path) -> None:
    files = [walk, *sorted(broken_folder.glob("*.bvh"))]
    for_seconds(0.15 * SLOW_SECONDS, lambda chance: refuses_or_works_apart(bvh_case(chance, tmp_path, files)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_tables_and_paths_for_long(tmp_path: Path) -> None:
    def case(chance: random.Random) -> None:
        make = chance.choice((labels_case, path_case, acclaim_case, archive_case))
        refuses_or_works(make(chance, tmp_path), READING_SECONDS)

    for_seconds(0.1 * SLOW_SECONDS, case)


@pytest.mark.slow
def test_datasets_for_long(tmp_path: Path, dataset_folder: Path) -> None:
    def case(chance: random.Random) -> None:
        refuses_or_works_apart(dataset_case(chance, dataset_folder, tmp_path / "copy"))

    for_seconds(0.15 * SLOW_SECONDS, case)


@pytest.mark.slow
def test_preprocess_of_mutated_files_for_long(tmp_path: Path) -> None:
    """Two files and a table, each mutated or not: a dataset that can be read, or a refusal and no file."""
    clips, output = tmp_path / "clips", tmp_path / "ds"

    def case(chance: random.Random) -> None:
        shutil.rmtree(clips, ignore_errors=True)
        shutil.rmtree(output, ignore_errors=True)
        clips.mkdir()
        (clips / "other.bvh").write_text(long)
        labels_case(chance, clips)
        if chance.random() < 0.5:
            (clips / "labels.csv").unlink()
        strange = chance.random() < 0.7
        damaged = strange_bvh(chance, long) if strange else mutated_text(chance, long, BVH_WORDS)
        (clips / "walk.bvh").write_bytes(damaged)
        refuses_or_works_apart(work)

    def work() -> None:
        try:
            preprocess([clips], output, PreprocessOptions(jobs=1))
        except MotionkitError:
            assert [p.name for p in tmp_path.iterdir()] == ["clips"]
            raise
        read_whole(output)
        assert sorted(p.name for p in tmp_path.iterdir()) == ["clips", "ds"]

    write_bvh(tmp_path / "long.bvh", motion_to_bvh(make_walk(90)))
    long = (tmp_path / "long.bvh").read_text()
    (tmp_path / "long.bvh").unlink()
    for_seconds(0.1 * SLOW_SECONDS, case)
