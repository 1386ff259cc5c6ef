"""The skeleton control signal shown with five performers: what is measured, and what changes with the signal alone."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.cli.main import main
from motionkit.data.dataset import Dataset
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.errors import DatasetError, MotionkitError
from motionkit.lab.paper.bodies import MEASURES, measures, performers, slopes
from motionkit.lab.paper.model_results import read_models
from motionkit.lab.paper.page import bodies_section
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import write_bvh
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import canonical_skeleton, leg_length
from motionkit.training.presets import train_options
from motionkit.training.trainer import train
from synthetic_motions import make_walk

SIZES = (0.8, 0.85, 0.9, 0.95, 1.0, 1.1)
SMALL = {
    "width": 48, "heads": 4, "ffn": 96, "layers": 1, "control_width": 16, "control_embedding": 16,
    "shared_channels": 12,
}  # fmt: skip


def sized(motion: Motion, size: float) -> Motion:
    skeleton = canonical_skeleton(size * motion.skeleton.offsets)
    return replace(motion, skeleton=skeleton, root_positions=size * motion.root_positions)


@pytest.fixture(scope="module")
def crowd_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of walks of six performers, one of them with a test clip."""
    folder = tmp_path_factory.mktemp("crowd")
    lines = ["file,start_frame,end_frame,type,subject,split"]
    for number, size in enumerate(SIZES):
        write_bvh(folder / f"{number}.bvh", sized(make_walk(120, turn=0.1 * number), size))
        lines.append(f"{number}.bvh,0,-1,walking,P{number},train")
    write_bvh(folder / "long.bvh", sized(make_walk(300), SIZES[2]))
    lines.append("long.bvh,0,-1,walking,P2,test")
    (folder / "labels.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    options = PreprocessOptions(jobs=1, layout="expmap-root-1", own_bodies=True, smooth=False)
    preprocess([folder], folder / "data", options)
    return folder / "data"


@pytest.fixture(scope="module")
def crowd_model(crowd_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("crowd-model") / "crowd.safetensors"
    options = train_options(
        "tptn-paper", steps=4, batch=2, window=24, precision="float32", score_seconds=0.0, config=SMALL
    )
    train(crowd_folder, path, options, device="cpu")
    return path


def test_five_performers_from_short_to_long_legs(crowd_folder: Path) -> None:
    dataset = Dataset(crowd_folder)
    chosen = performers(dataset, "walking")
    legs = [leg_length(canonical_skeleton(dataset.bodies[body])) for body in chosen.values()]
    assert len(set(chosen.values())) == 5 and legs == sorted(legs)
    whole = leg_length(canonical_skeleton())
    assert legs[0] == pytest.approx(SIZES[0] * whole, rel=1e-3) and legs[-1] == pytest.approx(
        SIZES[-1] * whole, rel=1e-3
    )
    with pytest.raises(DatasetError, match="bodies with walking: 6, expected at least 7"):
        performers(dataset, "walking", 7)
    with pytest.raises(DatasetError, match="bodies with flying: 0, expected at least 5"):
        performers(dataset, "flying")


def test_measures_of_recorded_frames_are_those_of_the_body(crowd_folder: Path) -> None:
    dataset = Dataset(crowd_folder)
    found = []
    for clip in dataset.select("train"):
        if not clip.mirrored:
            made = measures(dataset, dataset.read(clip).features)
            assert made["legs"] == pytest.approx(leg_length(dataset.skeleton(clip)), rel=2e-3)
            found.append(made)
    # The same walk on other bodies: everything grows alike.
    small, large = (min(found, key=lambda m: m["legs"]), max(found, key=lambda m: m["legs"]))
    for key in MEASURES:
        assert large[key] / small[key] == pytest.approx(SIZES[-1] / SIZES[0], rel=0.1), key


def test_the_command_changes_the_signal_alone(
    crowd_model: Path,
    crowd_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("motionkit.lab.paper.bodies.MADE", 150)
    words = ["bodies", str(crowd_model), "--data", str(crowd_folder), "--seeds", "1", "-o", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["motionkit", "experiment", *words])
    main()
    (result,) = read_models(tmp_path, "bodies")
    made = [each["made"] for each in result["performers"]]
    assert len(made) == 5 and all(set(each) == set(MEASURES) for each in made)
    assert all(np.isfinite(list(each.values())).all() for each in made)
    assert len({each["legs"] for each in made}) == 5, "the same seed, and another body in the signal"
    text = "\n".join(bodies_section([result]))
    assert "P0" in text and "How much of a difference" in text
    assert "wrote" in capsys.readouterr().out


def test_slopes_say_how_far_the_signal_is_followed() -> None:
    own = [70.0, 80.0, 90.0]
    half = [{"recorded": dict.fromkeys(MEASURES, x), "made": dict.fromkeys(MEASURES, 0.5 * x)} for x in own]
    assert slopes(half) == pytest.approx(dict.fromkeys(MEASURES, 0.5))


def test_models_without_bodies_and_other_files_are_refused(
    tiny_model: MotionModel, crowd_folder: Path, tmp_path: Path
) -> None:
    from motionkit.lab.paper.bodies import show_bodies

    with pytest.raises(MotionkitError, match="is not shown bodies"):
        show_bodies(tiny_model, Dataset(crowd_folder), "walking", 1, lambda share: None)
    (tmp_path / "odd.json").write_text(json.dumps({"performers": 3}))
    with pytest.raises(MotionkitError, match=r"odd\.json: not the results of bodies"):
        read_models(tmp_path, "bodies")
