"""The training step, which changes the weights, and the running average of the weights."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from motionkit.data.dataset import Dataset
from motionkit.features.layout import FEATURE_COUNT
from motionkit.models.attention import LocalAttention
from motionkit.models.network import PartTransformer
from motionkit.models.predictor import Predictor
from motionkit.training.losses import Batch, LossOptions, total_loss
from motionkit.training.objective import NetworkLosses, TrainingModule
from motionkit.training.optimizer import make_optimizers, set_rate
from motionkit.training.options import TrainOptions
from motionkit.training.processes import Processes
from motionkit.training.progress import Progress
from motionkit.training.replay import Replayed

# The paper's loss is a sum over columns. This makes it a mean, so the gradient norm does not depend on their number.
LOSS_SCALE = 1.0 / FEATURE_COUNT


class Learner:
    """A network with its losses and optimizers.

    Attributes:
        average: running average of the network's weights by name, which becomes the model.
        ended: number of cycles of the learning rate that have ended; empty ends_of_cycles before the first.
        ends_of_cycles: sum of the averages at their ends.
        seeds: number of networks that are trained at once (StackedLearner).
    """

    def __init__(
        self, network: Predictor, dataset: Dataset, options: TrainOptions, processes: Processes
    ) -> None:
        # Part transformers have configurable losses; other networks have losses of their own.
        self.module = (
            TrainingModule(network, dataset, options.losses)
            if isinstance(network, PartTransformer)
            else NetworkLosses(network, dataset)
        )
        self.module.to_device(processes.device)
        self.trainable = processes.shared(self.module)
        # Dropout must differ between processes; initial weights, which are set before, must not.
        torch.manual_seed(options.seed + 1 + processes.rank)
        self._begin(dict(self.module.named_parameters()), options, processes, seeds=1)

    def _begin(
        self, weights: dict[str, nn.Parameter], options: TrainOptions, processes: Processes, seeds: int
    ) -> None:
        self.weights, self.seeds, self.clip_norm = weights, seeds, options.optimizer.clip_norm
        self.autocast = _use_bfloat16(options.optimizer.precision, processes.device)
        if processes.device.type == "cuda":  # tensor cores: factors have 10 bits, sums are float32
            torch.set_float32_matmul_precision("high")
        matrices = {f"network.{name}": count for name, count in self.network.layer_matrices().items()}
        self.optimizers = make_optimizers(weights, matrices, options.optimizer, self.autocast)
        self.average = {
            name: weights[f"network.{name}"].detach().clone() for name in self.network.state_dict()
        }
        self.ended, self.ends_of_cycles = 0, dict[str, Tensor]()
        # Losses of other networks depend on the progress of the run, which a CUDA graph would freeze.
        self._replays = isinstance(self.module, TrainingModule) and processes.world == 1
        # On a GPU a step is a CUDA graph, captured again whenever the losses change.
        self._replayed = Replayed(lambda *_: ())
        self._loss_options: LossOptions | None = None
        self._terms: list[str] = []

    @property
    def network(self) -> Predictor:
        """The network that is trained; of stacked ones, the first, whose weights are not used."""
        return self.module.network

    def averages(self) -> list[dict[str, Tensor]]:
        """Return copies of the averaged weights of each seed's network by name, on the CPU.

        After several cycles of the learning rate it is the mean of the averages at their ends and of the present one,
        which generalizes better than the last alone (Izmailov et al. 2018, stochastic weight averaging).
        """
        copies = {name: value.to("cpu", copy=True) for name, value in self.average.items()}
        for name, ends in self.ends_of_cycles.items():
            copies[name].add_(ends.cpu()).div_(self.ended + 1)
        if self.seeds == 1:
            return [copies]
        return [{name: value[i] for name, value in copies.items()} for i in range(self.seeds)]

    def step(self, batch: Batch, options: TrainOptions, at: Progress) -> dict[str, Tensor]:
        """Update the weights with a batch; return the losses by name, their "total", and the "gradient" norm.

        options are those of the present stage of the run. On a GPU the next step overwrites the returned numbers, and
        nothing waits for them before they are read.
        """
        self._end_cycles(at.cycle)
        if options.losses != self._loss_options:
            self._loss_options = options.losses
            self.module.use(options.losses)
            self._replayed = Replayed(lambda *inputs: self._step(*inputs, progress=at.share), self._state)
        # At first the average follows quickly, to forget the random initial weights.
        decay = min(options.optimizer.ema, (1.0 + at.step) / (10.0 + at.step))
        numbers = torch.tensor([at.rate, 1.0 - decay]).to(batch.inputs.device, non_blocking=True)
        inputs = (numbers, *vars(batch).values())
        values = self._replayed(*inputs) if self._replays else self._step(*inputs, progress=at.share)
        return dict(zip(self._terms, values, strict=True))

    def _end_cycles(self, ended: int) -> None:
        """Keep the average if a cycle has ended; one that ended several counts so many times."""
        if ended > self.ended:
            for name, value in self.average.items():
                kept = self.ends_of_cycles.setdefault(name, torch.zeros_like(value))
                kept.add_(value, alpha=ended - self.ended)
            self.ended = ended

    def _step(self, numbers: Tensor, *batch: Tensor, progress: float) -> tuple[Tensor, ...]:
        """Make a step, with the learning rate and the weight of the new weights in their average as two numbers."""
        terms = self.gradients(Batch(*batch), progress)
        terms["gradient"] = self.update(numbers[0], numbers[1])
        self._terms = list(terms)
        return tuple(terms.values())

    def _state(self) -> list[Tensor]:
        """Return the tensors that a step changes."""
        states = [
            value for each in self.optimizers for kept in each.state.values() for value in kept.values()
        ]
        return [*self.weights.values(), *self.average.values(), *states]

    def gradients(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        """Compute the gradients of a batch; return the losses by name, and their "total"."""
        for p in self.weights.values():
            p.grad = None
        terms = self.losses(batch, progress)
        loss = total_loss(terms, self.module.weights) * LOSS_SCALE
        loss.sum().backward()
        found = {name: value.detach() for name, value in terms.items()}
        return found | {"total": loss.detach() / LOSS_SCALE}

    def losses(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        """Return the losses of a batch by name."""
        return self.trainable(batch, self.autocast, progress)

    @torch.no_grad()
    def update(self, rate: Tensor, newest: Tensor) -> Tensor:
        """Update the weights at a rate, and their average by a weight of the newest; return the norm of the gradients.

        A gradient that is not finite counts as zero.
        """
        norm = self._clip([p for p in self.weights.values() if p.grad is not None])
        for each in self.optimizers:
            set_rate(each, rate)
            each.step()
        averages = list(self.average.values())
        ahead = torch._foreach_sub([self.weights[f"network.{name}"] for name in self.average], averages)
        torch._foreach_mul_(ahead, newest)
        torch._foreach_add_(averages, ahead)
        return norm

    def _clip(self, moved: list[nn.Parameter]) -> Tensor:
        """Shorten gradients to clip_norm, those of each seed for itself, and return their norms before."""
        if self.seeds == 1 and moved[0].device.type == "cpu":
            norm = nn.utils.clip_grad_norm_(moved, self.clip_norm)
            if not norm.isfinite():
                for p in moved:
                    p.grad = torch.zeros_like(p)
            return norm
        # One long gradient for each seed, in few kernels, and without waiting for the norm.
        flat = torch.cat([p.grad.reshape(self.seeds, -1) for p in moved if p.grad is not None], dim=1)
        norm = torch.linalg.vector_norm(flat, dim=1, keepdim=True)
        flat = torch.where(norm.isfinite(), flat * (self.clip_norm / (norm + 1e-6)).clamp(max=1.0), 0.0)
        for p, part in zip(moved, flat.split([p.numel() // self.seeds for p in moved], dim=1), strict=True):
            p.grad = part.contiguous().view(p.shape)  # fused optimizers read no strides
        return norm.squeeze(1) if self.seeds > 1 else norm.squeeze()


class StackedLearner(Learner):
    """Networks of several seeds that are trained as one: weights, batches and losses have a first dimension of seeds.

    A step of small networks on a GPU costs what launching its kernels costs, and stacked networks share the kernels.
    Modules are alike but for their weights, and not recurrent, which torch cannot stack.
    """

    module: TrainingModule

    def __init__(
        self, modules: Sequence[TrainingModule], options: TrainOptions, processes: Processes
    ) -> None:
        for each in modules:
            each.to_device(processes.device)
        weights, self.buffers = torch.func.stack_module_state(modules)  # type: ignore[arg-type]
        self.module = modules[0]  # whose own weights are not used
        for layer in self.module.modules():
            if isinstance(layer, LocalAttention):
                layer.in_torch = True  # the C kernel takes no stacks
        torch.manual_seed(options.seed + 1)
        stacked = {name: nn.Parameter(value.detach()) for name, value in weights.items()}
        self._begin(stacked, options, processes, len(modules))

    def losses(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        names: list[str] = []

        def one(
            weights: dict[str, Tensor], buffers: dict[str, Tensor], *tensors: Tensor
        ) -> tuple[Tensor, ...]:
            inputs = (Batch(*tensors), self.autocast, progress)
            found = torch.func.functional_call(self.module, (weights, buffers), inputs)
            names[:] = found
            return tuple(found.values())

        values = torch.func.vmap(one, randomness="different")(
            dict(self.weights), self.buffers, *vars(batch).values()
        )
        return dict(zip(names, values, strict=True))


def _use_bfloat16(precision: str, device: torch.device) -> bool:
    """Whether to use bfloat16; "auto" uses it if the processor has instructions for it, because emulation is slow."""
    if precision == "auto":
        if device.type == "cuda":
            return torch.cuda.is_bf16_supported()
        supported = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
        return bool(supported())
    return precision == "bfloat16"
