"""Damaged or malicious datasets are refused when opened, in one line that names the file."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.data import dataset as module
from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError


@pytest.fixture
def copy(dataset_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(dataset_folder, tmp_path / "copy"))


def refusal(folder: Path) -> str:
    with pytest.raises(DatasetError) as caught:
        dataset = Dataset(folder)
        for clip in dataset.clips:
            dataset.read(clip)
    message = str(caught.value)
    assert "\n" not in message and str(folder) in message and len(message) < 500 + len(str(folder))
    return message


def changed(*keys: Any, to: Any) -> Callable[[dict], None]:
    def change(manifest: dict) -> None:
        place: Any = manifest
        for key in keys[:-1]:
            place = place[key]
        if to is KeyError:
            del place[keys[-1]]
        else:
            place[keys[-1]] = to

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        *(
            (changed(key, to=KeyError), key)
            for key in ("types", "fps", "layout", "bodies", "clips", "characters")
        ),
        *((changed(key, to=None), key) for key in ("references", "feature_scaling", "phase_seconds")),
        (changed("types", to="walking"), "types"),
        (changed("types", 0, to=3), "types"),
        (changed("types", 0, to="walk,run"), "types"),
        (changed("types", 0, to="walking"), "types"),  # there twice
        (changed("types", to=[]), "types"),
        (changed("fps", to=0), "fps"),
        (changed("fps", to="60"), "fps"),
        (changed("fps", to=True), "fps"),
        (changed("layout", to=["sixd-root-1"]), "layout"),
        (changed("layout", to="cubist"), "layout"),
        (changed("bodies", to=[]), "bodies"),
        (changed("bodies", 0, 3, to=[1.0, 2.0]), "bodies"),
        (changed("bodies", 0, 3, 1, to="2"), "bodies"),
        (changed("bodies", 0, 3, 1, to=1e39), "bodies"),
        (changed("characters", to=[]), "characters"),
        (changed("characters", "x", to=[[1.0]]), "characters"),
        (changed("references", 4, to=[0.0, 0.0, 0.0, 0.0]), "references"),
        (changed("feature_scaling", "mean", to=[0.0]), "feature_scaling"),
        (changed("feature_scaling", "std", 7, to=0.0), "feature_scaling"),
        (changed("feature_scaling", "std", 7, to=-1.0), "feature_scaling"),
        (changed("trajectory_scaling", to={}), "trajectory_scaling"),
        (changed("phase_seconds", "somersault", to=1.0), "phase_seconds"),
        (changed("phase_seconds", "walking", to=0), "phase_seconds"),
        (changed("phase_events", "walking", to="somersault"), "phase_events"),
        (changed("phase_events", "walking", to=[]), "phase_events"),
        (changed("clips", to={}), "clips"),
        (changed("clips", 0, to=[]), "clip 0"),
        (changed("clips", 1, "start", to=-1), "clip 1"),
        (changed("clips", 1, "start", to=1.5), "clip 1"),
        (changed("clips", 1, "frames", to=0), "clip 1"),
        (changed("clips", 1, "frames", to=10**9), "rows"),
        (changed("clips", 1, "frames", to=10**30), "clip 1"),
        (changed("clips", 1, "split", to="valid"), "clip 1"),
        (changed("clips", 1, "split", to=[]), "clip 1"),
        (changed("clips", 1, "body", to=7), "clip 1"),
        (changed("clips", 1, "mirrored", to=1), "clip 1"),
        (changed("clips", 1, "name", to=None), "clip 1"),
        (changed("clips", 1, "colour", to="red"), "clip 1"),
        (changed("clips", 1, "subject", to=KeyError), "clip 1"),
        (changed("format", to="[/b]" * 1000), "dataset format"),
    ],
)
def test_a_manifest_with_one_fault(copy: Path, change: Callable[[dict], None], says: str) -> None:
    path = copy / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))
    assert says in refusal(copy)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"format": 1, "fps": NaN}', '{"format": 1' + "0" * 400 + "}"]
)
def test_a_manifest_of_brackets_or_digits(copy: Path, text: str) -> None:
    (copy / "manifest.json").write_text(text)
    assert "manifest.json" in refusal(copy)


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("features", lambda a: a[:, :-1], "expected (N, 276) of float32"),
        ("features", lambda a: a.astype(np.float64), "of float64"),
        ("features", lambda a: a.astype(">f4"), "of >f4"),
        ("features", lambda a: a.ravel(), "expected (N, 276)"),
        ("contacts", lambda a: a.astype(np.int8), "of int8"),
        ("contacts", lambda a: a + 1, "expected 0 to 1"),
        ("ground", lambda a: a[None], "expected (N, 3)"),
        ("types", lambda a: a + 6, "row 0 has"),
        ("types", lambda a: a - 100, "expected 0 to 5"),
        ("phases", lambda a: a * np.nan, "row 0 has nan, expected -1 to 1"),
        ("phases", lambda a: a[:-1], "rows"),
        ("types", lambda a: np.concatenate([a, a]), "different numbers of rows"),
        ("types", lambda a: np.array(3, np.int16), "expected (N) of int16"),
    ],
)
def test_an_array_of_another_kind(copy: Path, name: str, change: Callable, says: str) -> None:
    path = copy / f"{name}.npy"
    np.save(path, change(np.load(path)))
    assert says in refusal(copy)


@pytest.mark.parametrize("number", [np.nan, np.inf, 3e38])
def test_features_that_are_no_numbers_are_told_with_their_row(copy: Path, number: float) -> None:
    path = copy / "features.npy"
    features = np.load(path)
    features[33, 5] = number
    np.save(path, features)
    assert "features.npy: row 33 has" in refusal(copy)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"PK\x03\x04" + bytes(100),
        b"\x80\x04N.",
        b"\x93NUMPY\x01\x00\x06\x00{}}}\n\n",
        b"\x93NUMPY\x01\x00\x16\x00" + b"{'descr': '<f4', 'fort",
    ],
)
def test_an_array_that_is_none(copy: Path, data: bytes) -> None:
    (copy / "ground.npy").write_bytes(data)
    assert "ground.npy: cannot be read" in refusal(copy)


def test_headers_that_promise_too_much(copy: Path) -> None:
    for shape in ("(99999999999999999999, 3)", "(-1, 3)", "(3000000000000, 3)", "('a', 3)"):
        text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
        (copy / "ground.npy").write_bytes(b"\x93NUMPY\x01\x00\x76\x00" + text.encode() + bytes(100))
        assert "ground.npy" in refusal(copy)


@pytest.mark.parametrize("name", ["manifest.json", "features.npy"])
def test_pipes_and_devices_are_refused(copy: Path, name: str) -> None:
    (copy / name).unlink()
    os.mkfifo(copy / name)
    assert f"{name}: is not a regular file" in refusal(copy)
    (copy / name).unlink()
    (copy / name).symlink_to("/dev/zero")
    assert f"{name}: is not a regular file" in refusal(copy)


def test_a_dataset_replaced_while_it_is_opened_is_told(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the arrays of one would be read with the manifest of the other."""
    shutil.copytree(copy, tmp_path / "new")
    honest = module.open_array

    def opened(path: Path, name: str, rows: int) -> np.ndarray:
        if name == "types":
            copy.rename(tmp_path / "former")
            (tmp_path / "new").rename(copy)
        return honest(path, name, rows)

    monkeypatch.setattr(module, "open_array", opened)
    assert "was replaced while it was being opened" in refusal(copy)


def test_a_dataset_replaced_while_it_is_mapped_goes_on_as_it_was(copy: Path, tmp_path: Path) -> None:
    dataset = Dataset(copy)
    before = dataset.read(dataset.clips[0]).features.copy()
    for name in ("features", "ground"):  # as preprocess does: another file in the place, never the same one
        other = np.zeros_like(np.load(copy / f"{name}.npy"))
        np.save(tmp_path / "other.npy", other)
        os.replace(tmp_path / "other.npy", copy / f"{name}.npy")
    assert (dataset.read(dataset.clips[0]).features == before).all()


def test_a_dataset_whose_only_training_clips_are_mirrored_can_be_read(copy: Path) -> None:
    path = copy / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["clips"] = [clip for clip in manifest["clips"] if clip["mirrored"] or clip["split"] == "test"]
    path.write_text(json.dumps(manifest))
    dataset = Dataset(copy)
    assert np.isfinite(dataset.read(dataset.clips[0]).reference).all()
    manifest["clips"] = [clip for clip in manifest["clips"] if clip["split"] == "test"]
    path.write_text(json.dumps(manifest))
    assert "no training clips" in refusal(copy)
