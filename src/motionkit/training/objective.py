"""A network and its losses as one module, as DistributedDataParallel needs it."""

from __future__ import annotations

from contextlib import nullcontext

import torch
from torch import Tensor, nn

from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError
from motionkit.features.control import ControlLayout
from motionkit.models.network import PartTransformer
from motionkit.models.predictor import Predictor
from motionkit.training.losses import (
    Batch,
    ConsistencyModules,
    FeatureSpace,
    LossOptions,
    training_losses,
)


class NetworkLosses(nn.Module):
    """A network that defines its own losses (Predictor.losses), as one module."""

    def __init__(self, network: Predictor, dataset: Dataset) -> None:
        super().__init__()
        self.network = network
        self.space = FeatureSpace.of(dataset)

    def to_device(self, device: torch.device) -> None:
        """Move the weights and the feature space to a device."""
        self.to(device)
        self.space = self.space.to(device)

    def use(self, options: LossOptions) -> None:
        """Use these options for the losses from now on. A network with its own losses ignores them."""

    @property
    def weights(self) -> dict[str, float]:
        """The weights of the losses by name; 1 for those that are not named."""
        return {}

    def forward(self, batch: Batch, autocast: bool, progress: float) -> dict[str, Tensor]:
        with torch.autocast(batch.inputs.device.type, torch.bfloat16) if autocast else nullcontext():
            return self.network.losses(batch, self.space, progress)


class TrainingModule(NetworkLosses):
    """A part transformer with its consistency modules and the losses of training/losses.py."""

    network: PartTransformer

    def __init__(self, network: PartTransformer, dataset: Dataset, options: LossOptions) -> None:
        super().__init__(network, dataset)
        self.consistency = ConsistencyModules(network) if network.config.head.consistency else None
        self.types = dataset.types
        self.use(options)

    def to_device(self, device: torch.device) -> None:
        super().to_device(device)
        self.use(self.options)

    def use(self, options: LossOptions) -> None:
        share = _step_share(self.types, options, self.network.config.controls)
        self.options = options
        self.step_share = None if share is None else share.to(self.space.mean.device)

    @property
    def weights(self) -> dict[str, float]:
        return self.options.weights

    def forward(self, batch: Batch, autocast: bool, progress: float) -> dict[str, Tensor]:
        kind = batch.inputs.device.type
        with torch.autocast(kind, torch.bfloat16) if autocast else nullcontext():
            prediction = self.network(batch.inputs, batch.contacts, batch.controls)
        # Outside autocast, because losses and consistency modules need float32.
        return training_losses(
            self.network,
            self.consistency,
            prediction,
            batch,
            self.space,
            self.options,
            self.step_share,
        )


def _step_share(types: tuple[str, ...], options: LossOptions, controls: str) -> Tensor | None:
    """Return weights (C,) whose product with controls is the share of types with step_weight; None if all have it."""
    unknown = set(options.step_except) - set(types)
    if unknown:
        raise DatasetError(
            f"--step-except: unknown type {min(unknown)!r}, expected some of {', '.join(types)}"
        )
    if not options.step_weight or not options.step_except:
        return None
    layout = ControlLayout(types, controls)
    share = torch.zeros(layout.size)
    now = layout.type.start  # the types of the first frame ahead
    share[now : now + len(types)] = torch.tensor([float(name not in options.step_except) for name in types])
    return share
