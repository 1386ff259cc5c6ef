"""The start of a run: a network with random weights, or with the weights of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.arrays import Array
from motionkit.data.dataset import Dataset
from motionkit.data.repeat import repeat_short_types
from motionkit.errors import ModelError
from motionkit.features.control import ControlLayout
from motionkit.models.architectures import build
from motionkit.models.bundled import open_model
from motionkit.models.config import ModelConfig, PredictorConfig
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionType, ReferenceClip, facing_velocity
from motionkit.models.predictor import Predictor
from motionkit.models.presets import preset
from motionkit.training.options import TrainOptions
from motionkit.training.rehearsal import keep_types

# If a run keeps types, its weights are interpolated by this share towards the initial ones (Wortsman et al. 2022,
# "Robust fine-tuning of zero-shot models"); docs/results-log.md has its effect.
INITIAL_SHARE = 0.25
USUAL_SPEED = 50.0  # cm/s that weigh as much as a unit of the pose embedding when types are compared
HEAD = ("head_leak", "head_momentum", "trajectory_skip")  # fields of a part transformer's head
CONTROL_WEIGHTS = ("shallow.embed_controls.weight", "deep.embed_controls.weight")


@dataclass(frozen=True, eq=False)
class InitialNetwork:
    """The network of a run before its first step.

    Attributes:
        kept: types of the initial model that have no recordings; the dataset holds roll-outs of them instead.
        weights: the initial model's weights, if types are kept.
        new_types: names of types that the initial model lacks.
    """

    network: Predictor
    layout: ControlLayout
    kept: dict[str, MotionType] = field(default_factory=dict)
    repeated: tuple[str, ...] = ()
    weights: dict[str, Tensor] | None = None
    new_types: tuple[str, ...] = ()

    def towards_initial(self, trained: dict[str, Tensor]) -> dict[str, Tensor]:
        """The trained weights; if types are kept, interpolated by INITIAL_SHARE towards the initial ones.

        Rows of control embeddings for new types stay unchanged, because the initial model had none.
        """
        if self.weights is None:
            return trained
        out = {name: torch.lerp(value, self.weights[name], INITIAL_SHARE) for name, value in trained.items()}
        size = len(self.layout.types)
        rows = [
            self.layout.type.start + sample * size + self.layout.types.index(kind)
            for sample in range(self.layout.type_samples)
            for kind in self.new_types
        ]
        for name in set(CONTROL_WEIGHTS) & set(out):
            out[name][:, rows] = trained[name][:, rows]
        return out


def begin(dataset: Dataset, options: TrainOptions) -> InitialNetwork:
    """Make the network of a run. If the run starts from a model, this may add clips to the dataset, in memory.

    Raises:
        DatasetError: if the dataset's features have another layout than the network's.
        ModelError: if the model does not fit the dataset or the preset.
    """
    config = preset(options.preset, **options.config)
    dataset.check_layout(config.layout, f"preset {options.preset} needs")
    if options.init is None:
        layout = ControlLayout(dataset.types, config.controls)
        return InitialNetwork(build(config, layout.size), layout)
    model = open_model(options.init)
    config = _with_head(config, model.config, options.config)
    check_start(dataset, model)
    repeated = repeat_short_types(dataset)
    names = keep_types(dataset, model, options.seed) if options.sampler.kept_share else ()
    layout = ControlLayout(dataset.types, config.controls)
    network = build(config, layout.size)
    warm_start(network, dataset, model)
    weights = {name: value.clone() for name, value in network.state_dict().items()} if names else None
    new_types = tuple(set(dataset.types) - set(model.types))
    kept = {name: model.types[name] for name in names}
    return InitialNetwork(network, layout, kept, repeated, weights, new_types)


def _with_head(
    config: PredictorConfig, of_model: PredictorConfig, given: Mapping[str, Any]
) -> PredictorConfig:
    """The config with the head of the model's network, which has no weights of its own and could be missed silently."""
    if not isinstance(config, ModelConfig) or not isinstance(of_model, ModelConfig):
        return config
    same = {name: getattr(of_model.head, name) for name in HEAD if name not in given}
    return replace(config, head=replace(config.head, **same))


def check_start(dataset: Dataset, model: MotionModel) -> None:
    """Raise ModelError if dataset and model have different reference rotations."""
    if not dataset.encoded_alike(model.reference_rotations):
        raise ModelError(
            f"{dataset.folder}: the dataset's reference rotations differ from the model's; "
            "preprocess it again with --references and this model, or train with --from-scratch"
        )


def warm_start(network: Predictor, dataset: Dataset, model: MotionModel) -> None:
    """Copy a model's weights into a network.

    A type that the model lacks gets the control weights of the type that moves most alike. The dataset gets the model's
    scaling and pose embedding, because the weights depend on them.

    Raises:
        ModelError: if the networks differ in size; nothing is changed then.
    """
    layout = ControlLayout(dataset.types, network.config.controls)
    _check_fit(network, model, layout)
    dataset.scaling, dataset.trajectory_scaling = model.scaling, model.trajectory_scaling
    dataset.pose_embedding = model.pose_embedding
    likes = similar_types(dataset, model)
    old = {name: torch.from_numpy(array) for name, array in model.network.arrays.items()}
    new = network.state_dict()
    with torch.no_grad():
        for name, value in new.items():
            if name not in old:
                continue
            if name in CONTROL_WEIGHTS:
                _copy_controls(value, old[name], layout, model.controls, likes)
            else:
                value.copy_(old[name])


def _its_preset(model: MotionModel) -> str:
    name = model.card.get("options", {}).get("preset")
    return f", {name}" if isinstance(name, str) else ""


def _check_fit(network: Predictor, model: MotionModel, layout: ControlLayout) -> None:
    """Raise ModelError if the weights of a model do not fit a network with this layout of controls."""
    if layout.kind != model.controls.kind:
        raise ModelError("the model has other control signals than the preset: expected the same preset")
    old = model.network.arrays
    for name, value in network.state_dict().items():
        if name in old and name not in CONTROL_WEIGHTS and value.shape != old[name].shape:
            raise ModelError(
                f"the model is of another size than the preset ({name} has {tuple(old[name].shape)} numbers, not "
                f"{tuple(value.shape)}): expected the preset the model was trained with{_its_preset(model)}"
            )


def _copy_controls(
    new: Tensor, old: Tensor, layout: ControlLayout, before: ControlLayout, likes: dict[str, str]
) -> None:
    """Copy the rows of control embeddings (P, C, D), signal by signal; likes names the old type for each new type."""
    added = () if layout.kind == "paper" else ("flag", "phase", "reference", "reference_gain")
    for name in ("skeleton", "trajectory", *added):
        new[:, getattr(layout, name)] = old[:, getattr(before, name)]
    for sample in range(layout.type_samples):
        start, start_before = (each.type.start + sample * len(each.types) for each in (layout, before))
        for i, kind in enumerate(layout.types):
            if kind in likes:
                new[:, start + i] = old[:, start_before + before.types.index(likes[kind])]


def similar_types(dataset: Dataset, model: MotionModel) -> dict[str, str]:
    """For each type of a dataset, the model's type to start from: that of the same name, or the most similar one.

    Types are compared by poses and by velocity over the ground. The dataset must have the model's pose embedding.
    """
    known = {
        name: _movement([_clip_rows(c, model.fps) for c in t.reference_clips])
        for name, t in model.types.items()
    }
    known = {name: facts for name, facts in known.items() if facts is not None}
    likes = {}
    for i, kind in enumerate(dataset.types):
        mine = None if kind in model.types else _movement(_type_rows(dataset, i))
        if kind in model.types:
            likes[kind] = kind
        elif mine is not None and known:
            likes[kind] = min(known, key=lambda name: float(np.linalg.norm(known[name] - mine)))
    return likes


def _movement(rows: list[Array]) -> Array | None:
    """Means and standard deviations (52,) over all rows (T, 26) of poses and velocities; None without rows."""
    if not rows:
        return None
    whole = np.concatenate(rows)
    return np.concatenate([whole.mean(axis=0), whole.std(axis=0)])


def _clip_rows(clip: ReferenceClip, fps: float) -> Array:
    """Pose embeddings and scaled ground velocities (L - 1, 26) of a reference clip."""
    return np.concatenate([clip.poses[1 : len(clip)], facing_velocity(clip, fps) / USUAL_SPEED], axis=1)


def _type_rows(dataset: Dataset, kind: int) -> list[Array]:
    """Pose embeddings and scaled ground velocities (T, 26) of a type in each training clip that has it."""
    block, rows = dataset.layout.blocks["root_xz_velocity"], []
    for clip in dataset.select("train"):
        of_type = dataset.clip_types(clip) == kind
        if bool(of_type.any()):
            features = dataset.read(clip).features[of_type]
            velocity = features[:, block] / USUAL_SPEED
            rows.append(np.concatenate([dataset.pose_embedding.of(features), velocity], axis=1))
    return rows
