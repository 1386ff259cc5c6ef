"""The optimizer of a run: Muon for the matrices within the layers of a part transformer, AdamW for all else.

Muon (Jordan et al. 2024) steps along the momentum of a matrix with all singular values made equal. So gradients from
few frames move the weights as far as gradients shared by all frames. Steps have the length that AdamW's would have on
average (Liu et al. 2025, "Muon is Scalable for LLM Training"), so one learning rate serves both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch
import torch.distributed as dist
import torch.nn.functional as F
from torch import Tensor, nn

from motionkit.training.options import OptimizerOptions

MOMENTUM = 0.95
# Coefficients of x, x^3 and x^5. Applied REPETITIONS times, the polynomial maps nearly all singular values in 0 to 1
# to about 0.7 to 1.2.
POLYNOMIAL = (3.4445, -4.7750, 2.0315)
REPETITIONS = 5
AS_ADAMW = 0.2  # usual root mean square of an AdamW update at rate 1


def orthogonalized(x: Tensor, bfloat16: bool = False) -> Tensor:
    """Return matrices (B, M, N) with the singular vectors of x and singular values near 1, by Newton-Schulz steps."""
    turned, dtype = x.shape[-2] > x.shape[-1], x.dtype
    x = _low(x)  # x x^T is smaller than x^T x
    x = x / (torch.linalg.matrix_norm(x, keepdim=True) + 1e-7)
    if bfloat16:
        x = x.bfloat16()
    a, b, c = POLYNOMIAL
    for _ in range(REPETITIONS):
        square = x @ x.transpose(-1, -2)
        x = torch.baddbmm(x, torch.baddbmm(square, square, square, beta=b, alpha=c), x, beta=a)
    x = x.to(dtype)
    return x.transpose(-1, -2) if turned else x


class Muon(torch.optim.Optimizer):
    """Muon for parameters (..., M, C N), each given with its C: they hold C matrices (M, N) side by side for each part.

    Of several seeds, they hold those of each seed.
    """

    def __init__(
        self,
        parameters: Iterable[tuple[nn.Parameter, int]],
        rate: float | Tensor,
        weight_decay: float,
        bfloat16: bool,
    ) -> None:
        pairs = list(parameters)
        super().__init__([p for p, _ in pairs], {"lr": rate, "weight_decay": weight_decay})
        self.counts = [count for _, count in pairs]
        self.bfloat16 = bfloat16

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        """Make a step along the gradients."""
        assert closure is None
        group = self.param_groups[0]
        counts = dict(zip(group["params"], self.counts, strict=True))
        moved = [p for p in group["params"] if p.grad is not None]
        ahead = dict(zip(moved, self._ahead(moved), strict=True))
        # Matrices with the same shorter and longer side are made orthogonal in one batch.
        alike: dict[tuple[int, ...], list[nn.Parameter]] = {}
        for p in moved:
            sides = (p.shape[-2], p.shape[-1] // counts[p])
            alike.setdefault(tuple(sorted(sides)), []).append(p)
        for (_, longer), members in alike.items():
            low = [
                _low(matrix).flatten(0, -3) for p in members for matrix in ahead[p].chunk(counts[p], dim=-1)
            ]
            updates = iter(self._shared(torch.cat(low)).split([len(x) for x in low]))
            whole = []
            for p in members:
                high = p.shape[-1] // counts[p] < p.shape[-2]
                apart = [next(updates) for _ in range(counts[p])]
                apart = [x.transpose(-1, -2) for x in apart] if high else apart
                whole.append((apart[0] if len(apart) == 1 else torch.cat(apart, dim=-1)).reshape(p.shape))
            torch._foreach_mul_([*members], 1.0 - group["lr"] * group["weight_decay"])
            torch._foreach_mul_(whole, -group["lr"] * AS_ADAMW * longer**0.5)
            torch._foreach_add_([*members], whole)

    def _shared(self, x: Tensor) -> Tensor:
        """Make matrices (N, M, M') orthogonal. Processes share the work and then exchange the results."""
        world = dist.get_world_size() if dist.is_initialized() else 1
        if world == 1:
            return orthogonalized(x, self.bfloat16)
        share = -(-len(x) // world)
        padded = F.pad(x, (0, 0, 0, 0, 0, world * share - len(x)))
        mine = orthogonalized(padded[dist.get_rank() * share :][:share], self.bfloat16)
        # Products in 16 bits are sent in 16 bits, without loss.
        mine = (mine.bfloat16() if self.bfloat16 else mine).contiguous()
        found = torch.empty((world * share, *x.shape[1:]), dtype=mine.dtype, device=mine.device)
        # As bytes, because not every backend knows every number format.
        dist.all_gather(list(found.view(torch.uint8).split(share)), mine.view(torch.uint8))
        return found[: len(x)].to(x.dtype)

    def _ahead(self, moved: list[nn.Parameter]) -> list[Tensor]:
        """Update the momenta of parameters by their gradients, and return the Nesterov directions."""
        for p in moved:
            if not self.state[p]:
                self.state[p]["momentum"] = torch.zeros_like(p)
        gradients = [p.grad for p in moved if p.grad is not None]
        momenta = [self.state[p]["momentum"] for p in moved]
        torch._foreach_lerp_(momenta, gradients, 1.0 - MOMENTUM)
        return list(torch._foreach_lerp(gradients, momenta, MOMENTUM))


def _low(x: Tensor) -> Tensor:
    """Return matrices, transposed if they have more rows than columns."""
    return x.transpose(-1, -2) if x.shape[-2] > x.shape[-1] else x


def _adamw(
    parameters: Sequence[nn.Parameter], options: OptimizerOptions, rate: float | Tensor
) -> torch.optim.AdamW:
    """Return AdamW, fused into one kernel if this torch supports it, which is three times as fast on a CPU."""
    settings: dict[str, Any] = {
        "lr": rate,
        "betas": options.betas,
        "weight_decay": options.weight_decay,
        "capturable": isinstance(rate, Tensor),
    }
    try:
        return torch.optim.AdamW(parameters, fused=True, **settings)
    except RuntimeError:  # no fused kernel for this device
        return torch.optim.AdamW(parameters, **settings)


def make_optimizers(
    parameters: Mapping[str, nn.Parameter],
    matrices: Mapping[str, int],
    options: OptimizerOptions,
    bfloat16: bool,
) -> list[torch.optim.Optimizer]:
    """Return the optimizers of parameters by name; matrices are those that Muon may update (layer_matrices).

    On a GPU the learning rate is a tensor, so that a CUDA graph of a step reads the present one.
    """
    counts = matrices if options.method == "muon" else {}
    device = next(iter(parameters.values())).device
    rate = options.rate if device.type == "cpu" else torch.tensor(options.rate, device=device)
    made: list[torch.optim.Optimizer] = [
        _adamw([p for name, p in parameters.items() if name not in counts], options, rate)
    ]
    if counts:
        chosen = [(parameters[name], count) for name, count in counts.items()]
        made.append(Muon(chosen, rate, options.weight_decay, bfloat16))
    return made


def set_rate(optimizer: torch.optim.Optimizer, rate: Tensor) -> None:
    """Set the learning rate of all parameters to that in a tensor."""
    for group in optimizer.param_groups:
        if isinstance(group["lr"], Tensor):
            group["lr"].copy_(rate)
        else:
            group["lr"] = float(rate)
