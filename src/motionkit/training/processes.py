"""The device of a run, and the processes that share its batches (torchrun)."""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from motionkit.errors import DatasetError, MotionkitError


@dataclass(frozen=True)
class Processes:
    """One process of a run: its device, its rank, and the number of processes."""

    device: torch.device
    rank: int = 0
    world: int = 1

    @classmethod
    def join(cls, device: str) -> Processes:
        """Join the process group of torchrun, if there is one; device is "auto", "cpu", "cuda" or "cuda:1"."""
        local = resolve_device(device)
        if "RANK" not in os.environ or int(os.environ.get("WORLD_SIZE", "1")) < 2:
            return cls(local)
        if not dist.is_initialized():
            dist.init_process_group("nccl" if local.type == "cuda" else "gloo")
        return cls(local, dist.get_rank(), dist.get_world_size())

    @property
    def first(self) -> bool:
        """Whether this is the process that writes and reports; the others only compute."""
        return self.rank == 0

    def places(self, batch: int) -> range:
        """This process's share of the windows of a batch. Raises DatasetError if the batch does not divide evenly."""
        if batch % self.world:
            raise DatasetError(f"--batch {batch}: expected a multiple of the {self.world} processes")
        share = batch // self.world
        return range(self.rank * share, (self.rank + 1) * share)

    def shared(self, module: nn.Module) -> nn.Module:
        """The module, with gradients averaged over all processes."""
        if self.world == 1:
            return module
        ids = [self.device.index] if self.device.type == "cuda" else None
        return DistributedDataParallel(module, device_ids=ids)

    def mean(self, values: Tensor) -> list[float]:
        """The mean of values (N,) over all processes."""
        if self.world > 1:
            dist.all_reduce(values)
            values = values / self.world
        return values.tolist()

    def agree(self, seconds: float) -> float:
        """Return the first process's clock, so that all processes stop at the same step."""
        if self.world == 1:
            return seconds
        value = torch.tensor([seconds], device=self.device, dtype=torch.float64)
        dist.broadcast(value, 0)
        return float(value)

    def leave(self) -> None:
        """Wait for the other processes and end the group."""
        if self.world > 1:
            dist.barrier()
            dist.destroy_process_group()


def resolve_device(name: str) -> torch.device:
    """Return a device by name; "auto" is CUDA if available. Raises MotionkitError for an unknown or missing device."""
    if name == "auto":
        name = f"cuda:{os.environ.get('LOCAL_RANK', '0')}" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise MotionkitError(f"unknown device {name!r}, expected auto, cpu, cuda or cuda:1") from None
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise MotionkitError(f"device {name!r} not found; there are {torch.cuda.device_count()} CUDA devices")
    return device
