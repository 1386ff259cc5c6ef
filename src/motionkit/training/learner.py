"""The training step, which changes the weights, and the running average of the weights."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from motionkit.data.dataset import Dataset
from motionkit.features.layout import FEATURE_COUNT
from motionkit.models.network import PartTransformer
from motionkit.models.predictor import Predictor
from motionkit.training.losses import Batch, LossOptions, total_loss
from motionkit.training.objective import OwnLosses, TrainingModule
from motionkit.training.optimizer import make_optimizers
from motionkit.training.options import TrainOptions
from motionkit.training.processes import Processes
from motionkit.training.progress import Progress
from motionkit.training.replay import Replayed

# The paper's loss is a sum over columns. This makes it a mean, so the gradient norm does not depend on their number.
LOSS_SCALE = 1.0 / FEATURE_COUNT


class Learner:
    """A network with its losses and optimizers.

    Attributes:
        module: the network and its losses.
        average: running average of the network's weights by name, which becomes the model.
        optimizers: each updates some of the weights.
    """

    def __init__(
        self, network: Predictor, dataset: Dataset, options: TrainOptions, processes: Processes
    ) -> None:
        # Part transformers have configurable losses; other networks have losses of their own.
        self.module = (
            TrainingModule(network, dataset, options.losses)
            if isinstance(network, PartTransformer)
            else OwnLosses(network, dataset)
        )
        self.module.to_device(processes.device)
        self.trainable = processes.shared(self.module)
        # Dropout must differ between processes; initial weights, which are set before, must not.
        torch.manual_seed(options.seed + 1 + processes.rank)
        self.autocast = _use_bfloat16(options.optimizer.precision, processes.device)
        if processes.device.type == "cuda":  # tensor cores: factors have 10 bits, sums are float32
            torch.set_float32_matmul_precision("high")
        self.optimizers = make_optimizers(self.module, network, options.optimizer, self.autocast)
        self.average = {n: p.detach().clone() for n, p in network.state_dict().items()}
        # Losses of other networks depend on the progress of the run, which a CUDA graph would freeze.
        self._replays = isinstance(self.module, TrainingModule) and processes.world == 1
        # On a GPU a step is a CUDA graph, captured again whenever the losses change.
        self._replayed = Replayed(lambda *_: ())
        self._loss_options: LossOptions | None = None
        self._terms: list[str] = []

    @property
    def network(self) -> Predictor:
        """The network that is trained."""
        return self.module.network

    def step(self, batch: Batch, options: TrainOptions, at: Progress) -> dict[str, Tensor]:
        """Update the weights with a batch; return the losses by name, their "total", and the "gradient" norm.

        Args:
            options: settings of the present stage of the run.
        """
        for group in (group for each in self.optimizers for group in each.param_groups):
            group["lr"] = at.rate
        terms = self.gradients(batch, options.losses, at.share)
        norm = nn.utils.clip_grad_norm_(self.module.parameters(), options.optimizer.clip_norm)
        if math.isfinite(float(norm)):
            for each in self.optimizers:
                each.step()
            self.update_average(at)
        return terms | {"gradient": norm.detach()}

    def gradients(self, batch: Batch, options: LossOptions, progress: float) -> dict[str, Tensor]:
        """Compute the gradients of a batch; return the losses by name, and their "total"."""
        if options != self._loss_options:  # a new stage needs a new graph
            self._loss_options = options
            self.module.use(options)
            self._replayed = Replayed(lambda *given: tuple(self._gradients(Batch(*given), progress).values()))
        if not self._replays:
            return self._gradients(batch, progress)
        values = self._replayed(*vars(batch).values())
        return dict(zip(self._terms, values, strict=True))

    def _gradients(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        for each in self.optimizers:
            each.zero_grad(set_to_none=True)
        terms = self.trainable(batch, self.autocast, progress)
        loss = total_loss(terms, self.module.weights) * LOSS_SCALE
        loss.backward()
        found = {name: value.detach() for name, value in terms.items()}
        found["total"] = loss.detach() / LOSS_SCALE
        self._terms = list(found)
        return found

    @torch.no_grad()
    def update_average(self, at: Progress) -> None:
        """Update the running average of the weights."""
        # At first the average follows quickly, to forget the random initial weights.
        decay = min(at.options.optimizer.ema, (1.0 + at.step) / (10.0 + at.step))
        state = self.network.state_dict()
        averages = list(self.average.values())
        torch._foreach_lerp_(averages, [state[n] for n in self.average], 1.0 - decay)


def _use_bfloat16(precision: str, device: torch.device) -> bool:
    """Whether to use bfloat16; "auto" uses it if the processor has instructions for it, because emulation is slow."""
    if precision == "auto":
        if device.type == "cuda":
            return torch.cuda.is_bf16_supported()
        supported = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
        return bool(supported())
    return precision == "bfloat16"
