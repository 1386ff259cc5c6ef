"""A training run on disk: everything to go on from, as safetensors, written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from motionkit.errors import ModelError
from motionkit.files import atomic_write

FORMAT = "motionkit-run-1"


def save_run(
    path: Path,
    module: nn.Module,
    average: dict[str, Tensor],
    optimizer: torch.optim.Optimizer,
    facts: dict[str, Any],
) -> None:
    """Write weights, their running average, optimizer moments and the random state."""
    tensors = {f"weights.{n}": t for n, t in module.state_dict().items()}
    tensors.update({f"average.{n}": t for n, t in average.items()})
    for name, p in module.named_parameters():
        for key, value in optimizer.state.get(p, {}).items():
            tensors[f"optimizer.{key}.{name}"] = value.reshape(1) if value.dim() == 0 else value
    tensors["random.cpu"] = torch.get_rng_state()
    if torch.cuda.is_available():
        tensors["random.cuda"] = torch.cuda.get_rng_state()
    tensors = {n: t.detach().cpu().contiguous().clone() for n, t in tensors.items()}
    with atomic_write(path, "wb") as file:
        file.write(save(tensors, metadata={"run": json.dumps({"format": FORMAT, **facts})}))


def load_run(
    path: Path, module: nn.Module, average: dict[str, Tensor], optimizer: torch.optim.Optimizer
) -> dict[str, Any]:
    """Put everything back as save_run found it; raises ModelError if the file does not fit."""
    try:
        with safe_open(str(path), framework="pt") as file:
            facts = json.loads((file.metadata() or {}).get("run", "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except (SafetensorError, OSError, ValueError) as error:
        raise ModelError(f"{path}: not a training checkpoint ({error})") from None
    if not isinstance(facts, dict) or facts.get("format") != FORMAT:
        raise ModelError(f"{path}: not a training checkpoint of this release")
    try:
        module.load_state_dict(_under(tensors, "weights."))
        for name, value in _under(tensors, "average.").items():
            average[name].copy_(value)
        for name, p in module.named_parameters():
            state = {}
            for key in ("step", "exp_avg", "exp_avg_sq"):
                moment = tensors.get(f"optimizer.{key}.{name}")
                if moment is not None:
                    state[key] = moment.reshape(()) if key == "step" else moment.to(p.device)
            if state:
                optimizer.state[p] = state
        torch.set_rng_state(tensors["random.cpu"])
        if torch.cuda.is_available() and "random.cuda" in tensors:
            torch.cuda.set_rng_state(tensors["random.cuda"])
    except (RuntimeError, KeyError, TypeError) as error:
        raise ModelError(
            f"{path}: the checkpoint does not fit this preset ({str(error).splitlines()[0]})"
        ) from None
    return facts


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
