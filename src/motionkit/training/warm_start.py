"""Start a run from the weights of a trained model."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.errors import ModelError
from motionkit.features.control import ControlLayout
from motionkit.models.model import MotionModel
from motionkit.models.predictor import Predictor

CONTROL_WEIGHTS = ("shallow.embed_controls.weight", "deep.embed_controls.weight")


def warm_start(network: Predictor, dataset: Dataset, model: MotionModel) -> None:
    """Copy a model's weights into a network. Types are matched by name; weights of new types stay as they are.

    The dataset takes over the model's scaling and pose embedding, because the weights depend on them.

    Raises:
        ModelError: if the networks differ in size, or the features in their reference rotations.
    """
    # A quaternion and its negative are the same rotation.
    turned = 1.0 - np.abs((dataset.reference_rotations * model.reference_rotations).sum(-1))
    if float(turned.max()) > 1e-4:
        raise ModelError(
            f"{dataset.folder}: the dataset's reference rotations differ from the model's; "
            "start from a model that was trained on this dataset"
        )
    old = {name: torch.from_numpy(array) for name, array in model.network.arrays.items()}
    new = network.state_dict()
    with torch.no_grad():
        for name, value in new.items():
            if name not in old:
                continue
            if name in CONTROL_WEIGHTS:
                _copy_controls(value, old[name], ControlLayout(dataset.types), model.controls)
            elif value.shape == old[name].shape:
                value.copy_(old[name])
            else:
                raise ModelError(
                    f"the model's {name} is {tuple(old[name].shape)}, the preset's is {tuple(value.shape)}: "
                    "expected the preset the model was trained with"
                )
    dataset.scaling, dataset.trajectory_scaling = model.scaling, model.trajectory_scaling
    dataset.pose_embedding = model.pose_embedding


def _copy_controls(new: Tensor, old: Tensor, layout: ControlLayout, before: ControlLayout) -> None:
    """Copy the rows of control embeddings (P, C, D), signal by signal."""
    for name in ("skeleton", "trajectory", "flag", "phase", "reference", "reference_gain"):
        new[:, getattr(layout, name)] = old[:, getattr(before, name)]
    for i, kind in enumerate(layout.types):
        if kind in before.types:
            new[:, layout.type.start + i] = old[:, before.type.start + before.types.index(kind)]
