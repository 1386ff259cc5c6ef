from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import motionkit as mk
from motionkit.data.dataset import Dataset
from motionkit.data.options import PreprocessOptions
from motionkit.data.phases import turns_over
from motionkit.errors import ModelError
from motionkit.features.control import ControlLayout
from motionkit.models.bundled import BUNDLED, load_bundled_model, reference_rotations
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel
from motionkit.models.predictor import Predictor
from motionkit.models.presets import preset
from motionkit.motion.bvh import write_bvh
from motionkit.training import rehearsal
from motionkit.training.initial_network import (
    INITIAL_SHARE,
    InitialNetwork,
    _with_head,
    begin,
    check_start,
    similar_types,
)
from motionkit.training.presets import FINE_TUNE, fine_tune_options
from motionkit.training.rehearsal import keep_types
from motionkit.training.trainer import train
from synthetic_motions import make_walk

pytestmark = pytest.mark.thorough

SMALL = {"batch": 2, "window": 16, "splices": 0, "score_seconds": 0.0, "period": 1, "precision": "float32"}


@pytest.fixture(autouse=True)
def short_roll_outs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "ROLLOUTS", 1)
    monkeypatch.setattr(rehearsal, "SECONDS", 5.0)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with the bundled model's reference rotations: recorded walking, called Gehen, and a made-up walk."""
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "clips" / "Gehen").mkdir(parents=True)
    (folder / "clips" / "idle").mkdir()
    walk = mk.synthesize("walking:4", seed=3).motion
    for number in range(2):
        write_bvh(folder / "clips" / "Gehen" / f"{number}.bvh", walk.cut(60 * number, 60 * number + 150))
    write_bvh(folder / "clips" / "idle" / "a.bvh", make_walk(120))
    mk.preprocess([folder / "clips"], folder / "dataset", PreprocessOptions(jobs=1))
    return folder / "dataset"


def test_a_dataset_has_the_reference_rotations_of_the_bundled_model(foreign: Path) -> None:
    model = load_bundled_model()
    assert np.allclose(Dataset(foreign).reference_rotations, model.reference_rotations)
    assert reference_rotations("own", model.config.layout) is None
    assert reference_rotations(BUNDLED, "expmap-root-1") is None


def test_references_of_a_model_of_another_layout_are_refused(tiny_model_file: Path) -> None:
    with pytest.raises(ModelError, match="expected a model of layout expmap-root-1, found sixd-root-1"):
        reference_rotations(tiny_model_file, "expmap-root-1")


def test_own_references_cannot_begin_from_the_bundled_model(dataset: Dataset) -> None:
    with pytest.raises(ModelError, match="preprocess it again with --references"):
        check_start(dataset, load_bundled_model())


def test_a_new_type_begins_as_the_type_that_moves_most_alike(foreign: Path) -> None:
    """Names that the model has go before movement."""
    model, dataset = load_bundled_model(), Dataset(foreign)
    dataset.pose_embedding = model.pose_embedding
    assert similar_types(dataset, model) == {"Gehen": "walking", "idle": "idle"}


def test_training_from_the_bundled_model_keeps_its_weights_and_scaling(foreign: Path, tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    train(foreign, path, fine_tune_options("tptn", steps=1, **(SMALL | {"rate": 1e-9})), device="cpu")
    made, bundled = load_model(path), load_bundled_model()
    assert made.type_names == ("Gehen", "idle") and made.card["options"]["init"] == BUNDLED
    assert np.array_equal(made.scaling.mean, bundled.scaling.mean)
    name = "shallow.embed_controls.weight"
    new, old = made.network.arrays[name], bundled.network.arrays[name]
    assert np.allclose(
        new[:, made.controls.type.start],
        old[:, bundled.controls.type.start + bundled.type_id("walking")],
        atol=1e-5,
    )
    assert np.allclose(new[:, made.controls.trajectory], old[:, bundled.controls.trajectory], atol=1e-5)
    for name, value in bundled.network.arrays.items():
        if made.network.arrays[name].shape == value.shape:
            assert np.allclose(made.network.arrays[name], value, atol=1e-5), name


def test_a_network_has_the_head_of_the_model_that_it_begins_from(foreign: Path) -> None:
    """Its leak has no weights, and its momentum would be left out."""
    options = fine_tune_options("tptn", steps=1, config={"head_leak": 0.5, "head_momentum": True})
    assert begin(Dataset(foreign), options).network.config.head.head_leak == 0.5, "it was asked for"
    of_model = load_bundled_model().config
    absolute = replace(of_model, head=replace(of_model.head, head_leak=0.0, head_momentum=False))
    assert _with_head(absolute, of_model, {}) == of_model


def test_added_types_leave_those_of_the_model_as_they_are(foreign: Path, tmp_path: Path) -> None:
    path, given = tmp_path / "mine.safetensors", Dataset(foreign)
    before = dict(vars(given), _arrays=dict(given._arrays))
    train(
        given,
        path,
        fine_tune_options("tptn", steps=1, kept_share=0.5, **(SMALL | {"rate": 1e-9})),
        device="cpu",
    )
    assert all(vars(given)[name] is value for name, value in before.items() if name != "_arrays")
    assert given._arrays == before["_arrays"] and "scaling" not in vars(given), "the caller's is not changed"
    made, bundled = load_model(path), load_bundled_model()
    assert set(made.types) == {"Gehen", *bundled.types}
    assert made.type_names[:2] == ("Gehen", "idle")
    for name in set(bundled.types) - {"idle"}:
        assert made.types[name].preset == bundled.types[name].preset
        assert np.array_equal(
            made.types[name].start_poses[0].features, bundled.types[name].start_poses[0].features
        )
    both = [model.types["cartwheel"].reference_clips[0].poses for model in (made, bundled)]
    assert np.array_equal(*both)


def test_kept_types_are_trained_on_roll_outs_of_the_model(foreign: Path) -> None:
    model, dataset = load_bundled_model(), Dataset(foreign)
    dataset.scaling, dataset.pose_embedding = model.scaling, model.pose_embedding
    kept = keep_types(dataset, model)
    assert dataset.types == ("Gehen", "idle", *kept) and len(kept) == len(model.types) - 1
    mine = [
        clip
        for clip in dataset.select("train")
        if (dataset.clip_types(clip) == dataset.types.index("cartwheel")).all()
    ]
    assert len(mine) == 1 and mine[0].frames == round(5.0 * model.fps)
    data = dataset.read(mine[0])
    # A cartwheel that would not end within the roll-out does not begin.
    assert (data.phases >= 0.0).mean() > 0.35 and data.reference.any()
    assert turns_over(data.features, dataset.layout.version)
    walking = next(
        c for c in dataset.select("train") if (dataset.clip_types(c) == dataset.types.index("walking")).all()
    )
    assert np.linalg.norm(np.diff(dataset.read(walking).ground[:, :2], axis=0), axis=1).sum() > 300.0


def test_weights_go_part_of_the_way_back_but_for_new_types() -> None:
    layout = ControlLayout(("new", "old"))
    name = "shallow.embed_controls.weight"
    begun = {"other": torch.zeros(3), name: torch.zeros(2, layout.size, 4)}
    trained = {key: torch.ones_like(value) for key, value in begun.items()}
    made = InitialNetwork(Predictor(None, 0), layout, weights=begun, new_types=("new",)).towards_initial(
        trained
    )
    back = torch.tensor(1.0 - INITIAL_SHARE)
    assert torch.equal(made["other"], back.expand(3))
    new, old = layout.type.start, layout.type.start + 1
    assert bool((made[name][:, new] == 1.0).all()) and bool((made[name][:, old] == back).all())
    assert bool((made[name][:, : layout.type.start] == back).all())


def test_windows_of_kept_types_have_their_share(foreign: Path) -> None:
    from motionkit.training.sampler import WindowSampler
    from motionkit.training.windows import SamplerOptions

    model, dataset = load_bundled_model(), Dataset(foreign)
    dataset.scaling, dataset.pose_embedding = model.scaling, model.pose_embedding
    kept = keep_types(dataset, model)
    shares = WindowSampler(dataset, SamplerOptions(kept_share=0.3), kept=kept).probabilities
    assert float(shares[2:].sum()) == pytest.approx(0.3) and float(shares[:2].sum()) == pytest.approx(0.7)


def test_fine_tuning_has_settings_of_its_own_that_can_be_changed() -> None:
    options = fine_tune_options("tptn", minutes=5)
    assert options.init == BUNDLED and options.optimizer.rate == FINE_TUNE["rate"]
    assert fine_tune_options("tptn", minutes=5, rate=1e-4).optimizer.rate == 1e-4
    assert preset("tptn").to_dict() == load_bundled_model().config.to_dict()


def test_roll_outs_of_a_kept_type_begin_from_all_its_start_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[list[Any]] = []

    def roll_out(model: MotionModel, names: tuple[str, ...], starts: list[Any], *_: Any) -> Any:
        begun.append(starts)
        raise StopIteration

    monkeypatch.setattr(rehearsal, "roll_out", roll_out)
    model = load_bundled_model()
    kinds = [name for name, kind in model.types.items() if len(kind.start_poses) == 3]
    for kept in (kinds[:3], kinds[:4], kinds[:6]):
        with pytest.raises(StopIteration):
            rehearsal.model_clips(model, tuple(kept) * 4, 1.0, 0)
        starts = [begun[-1][number :: len(kept)] for number in range(len(kept))]
        assert all(len({id(pose) for pose in of_type}) == 3 for of_type in starts)
