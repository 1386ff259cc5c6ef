"""The start of a run: a network with random weights, or with the weights of a model."""

from __future__ import annotations

from dataclasses import dataclass, field

from torch import Tensor

from motionkit.data.dataset import Dataset
from motionkit.data.repeat import repeat_short_types
from motionkit.features.control import ControlLayout
from motionkit.models.architectures import build
from motionkit.models.bundled import open_model
from motionkit.models.motion_type import MotionType
from motionkit.models.predictor import Predictor
from motionkit.models.presets import preset
from motionkit.training.options import TrainOptions
from motionkit.training.rehearsal import keep_types
from motionkit.training.warm_start import check_start, part_way_back, warm_start


@dataclass(frozen=True, eq=False)
class Beginning:
    """The network of a run before its first step.

    Attributes:
        layout: the columns of its control vectors.
        kept: types of the initial model that have no recordings; the dataset holds roll-outs of them instead.
        repeated: names of types whose short recordings are looped.
        weights: the initial model's weights, if types are kept.
        new_types: names of types that the initial model lacks.
    """

    network: Predictor
    layout: ControlLayout
    kept: dict[str, MotionType] = field(default_factory=dict)
    repeated: tuple[str, ...] = ()
    weights: dict[str, Tensor] | None = None
    new_types: tuple[str, ...] = ()

    def part_way_back(self, weights: dict[str, Tensor]) -> dict[str, Tensor]:
        """The trained weights; if types are kept, interpolated towards the initial ones, so that less is forgotten."""
        if self.weights is None:
            return weights
        return part_way_back(weights, self.weights, self.layout, self.new_types)


def begin(dataset: Dataset, options: TrainOptions) -> Beginning:
    """Make the network of a run. If the run starts from a model, this may add clips to the dataset, in memory.

    Raises:
        DatasetError: if the dataset's features have another layout than the network's.
        ModelError: if the model does not fit the dataset or the preset.
    """
    config = preset(options.preset, **options.config)
    dataset.check_layout(config.layout, f"preset {options.preset} needs")
    if options.init is None:
        layout = ControlLayout(dataset.types, config.controls)
        return Beginning(build(config, layout.size), layout)
    model = open_model(options.init)
    check_start(dataset, model)
    repeated = repeat_short_types(dataset)
    names = keep_types(dataset, model, options.seed) if options.sampler.kept_share else ()
    layout = ControlLayout(dataset.types, config.controls)
    network = build(config, layout.size)
    warm_start(network, dataset, model)
    weights = {name: value.clone() for name, value in network.state_dict().items()} if names else None
    new_types = tuple(set(dataset.types) - set(model.types))
    kept = {name: model.types[name] for name in names}
    return Beginning(network, layout, kept, repeated, weights, new_types)
