"""The checkpoint of a training run: everything to resume from, as safetensors, written atomically."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch import Tensor, nn

from motionkit.errors import ModelError
from motionkit.files import atomic_write
from motionkit.models.file_check import TensorFacts, check_shapes, check_values
from motionkit.models.tensor_file import TensorFile, open_tensors
from motionkit.training.optimizer import Muon
from motionkit.training.options import flat_options
from motionkit.training.window_blocks import BlockStart

FORMAT = "motionkit-run-1"
ADAMW = ("step", "exp_avg", "exp_avg_sq")  # what it keeps of each parameter
MUON = ("momentum",)
MOST_BYTES = 4 * 2**30
MOST_STEPS = 10**12  # also the limit of seconds
MOST_BLOCK = 1000  # steps of a block


def save_run(
    path: Path,
    module: nn.Module,
    average: dict[str, Tensor],
    optimizers: Sequence[torch.optim.Optimizer],
    facts: dict[str, Any],
    block: BlockStart | None,
) -> None:
    """Write weights, their running average, optimizer moments, the random state and facts such as the step.

    Args:
        block: the start of the block that the run is within, if it is.
    """
    tensors = {f"weights.{n}": t for n, t in module.state_dict().items()}
    tensors.update({f"average.{n}": t for n, t in average.items()})
    owners = _owners(optimizers)
    for name, p in module.named_parameters():
        for key, value in owners[p].state.get(p, {}).items():
            tensors[f"optimizer.{key}.{name}"] = value.reshape(1) if value.dim() == 0 else value
    if block is not None:
        tensors.update({f"block.{n}": t for n, t in block.weights.items()})
        facts = facts | {"block": {"step": block.step, "progress": block.progress}}
    tensors["random.cpu"] = torch.get_rng_state()
    if torch.cuda.is_available():
        tensors["random.cuda"] = torch.cuda.get_rng_state()
    tensors = {n: t.detach().cpu().contiguous().clone() for n, t in tensors.items()}
    with atomic_write(path, "wb") as file:
        file.write(save(tensors, metadata={"run": json.dumps({"format": FORMAT, **facts})}))


def run_options(path: Path) -> dict[str, Any]:
    """The options of the run of a checkpoint, by the names of flat_options; raises ModelError as load_run does."""
    with open_tensors(path, "run", "a training checkpoint", MOST_BYTES) as file:
        facts = _facts_of(path, file)
    try:
        _check_facts(facts)
    except ModelError as error:
        raise ModelError(f"{path}: the checkpoint is damaged ({error})") from None
    return flat_options(facts["options"])


def _facts_of(path: Path, file: TensorFile) -> dict[str, Any]:
    """The facts of an open checkpoint, not checked further; raises ModelError if it is none of this release."""
    facts = file.metadata
    if not isinstance(facts, dict) or facts.get("format") != FORMAT:
        raise ModelError(f"{path}: not a training checkpoint of this release")
    return facts


def load_run(
    path: Path,
    module: nn.Module,
    average: dict[str, Tensor],
    optimizers: Sequence[torch.optim.Optimizer],
) -> tuple[dict[str, Any], BlockStart | None]:
    """Restore what save_run wrote and return its facts, and the start of the block that the run was within.

    Raises:
        ModelError: if the file is damaged or does not fit.
    """
    with open_tensors(path, "run", "a training checkpoint", MOST_BYTES) as file:
        facts = _facts_of(path, file)
        try:
            _check_facts(facts)
            _check_fit(file.found, module, average, optimizers, "block" in facts)
            tensors = {name: torch.from_numpy(array) for name, array in file.read_all().items()}
            _check_numbers(tensors)
        except ModelError as error:
            raise ModelError(
                f"{path}: the checkpoint does not fit this preset or is damaged ({error})"
            ) from None
    try:
        torch.set_rng_state(tensors["random.cpu"])
        if torch.cuda.is_available() and "random.cuda" in tensors:
            torch.cuda.set_rng_state(tensors["random.cuda"])
    except (RuntimeError, TypeError) as error:
        raise ModelError(f"{path}: the checkpoint is damaged ({str(error).splitlines()[0]})") from None
    module.load_state_dict(_under(tensors, "weights."))
    for name, value in _under(tensors, "average.").items():
        average[name].copy_(value)
    owners = _owners(optimizers)
    for name, p in module.named_parameters():
        optimizer = owners[p]
        kept = {key: tensors.get(f"optimizer.{key}.{name}") for key in _kept(optimizer)}
        # A fused optimizer has its steps where its parameters are, any other on the CPU.
        at = p.device if optimizer.defaults.get("fused") else torch.device("cpu")
        optimizer.state[p] = {
            key: value.reshape(()).to(at) if key == "step" else value.to(p.device)
            for key, value in kept.items()
            if value is not None  # before the first step
        }
    block = facts.get("block")
    if block is None:
        return facts, None
    return facts, BlockStart(block["step"], float(block["progress"]), _under(tensors, "block."))


def _owners(optimizers: Sequence[torch.optim.Optimizer]) -> dict[nn.Parameter, torch.optim.Optimizer]:
    """Return which of the optimizers moves each parameter."""
    return {p: each for each in optimizers for group in each.param_groups for p in group["params"]}


def _kept(optimizer: torch.optim.Optimizer) -> tuple[str, ...]:
    """Return what an optimizer keeps of each parameter."""
    return MUON if isinstance(optimizer, Muon) else ADAMW


def _check_facts(facts: dict[str, Any]) -> None:
    """Raise ModelError for a step, a time or options that no run can have."""
    step, seconds = facts.get("step"), facts.get("seconds")
    if isinstance(step, bool) or not isinstance(step, int) or not 0 <= step <= MOST_STEPS:
        raise ModelError(f"step is {step!r:.60}, expected a number from 0 to {MOST_STEPS}")
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not 0 <= seconds <= MOST_STEPS:
        raise ModelError(f"seconds is {seconds!r:.60}, expected a number from 0 to {MOST_STEPS}")
    block = facts.get("block")
    if block is not None:
        begins, progress = (
            (block.get(n) for n in ("step", "progress")) if isinstance(block, dict) else (None, 0)
        )
        if (
            isinstance(begins, bool)
            or not isinstance(begins, int)
            or not 0 <= begins < step <= begins + MOST_BLOCK
        ):
            raise ModelError(f"the block begins at step {begins!r:.60}, expected one shortly before {step}")
        if isinstance(progress, bool) or not isinstance(progress, (int, float)) or not 0 <= progress <= 1:
            raise ModelError(f"progress is {progress!r:.60}, expected a number from 0 to 1")
    if not isinstance(facts.get("options"), dict):
        raise ModelError(f"options is {facts.get('options')!r:.60}, expected an object")


def _check_fit(
    found: Mapping[str, TensorFacts],
    module: nn.Module,
    average: dict[str, Tensor],
    optimizers: Sequence[torch.optim.Optimizer],
    within_block: bool,
) -> None:
    """Raise ModelError unless a file has exactly the tensors of this module's run, with their shapes and types."""
    expected = {f"weights.{name}": tuple(value.shape) for name, value in module.state_dict().items()}
    expected |= {f"average.{name}": tuple(value.shape) for name, value in average.items()}
    if within_block:
        expected |= {f"block.{name}": tuple(value.shape) for name, value in average.items()}
    owners = _owners(optimizers)
    for name, p in module.named_parameters():
        keys = {key: f"optimizer.{key}.{name}" for key in _kept(owners[p])}
        if any(key in found for key in keys.values()):  # none before the first step
            expected |= {name: (1,) if key == "step" else tuple(p.shape) for key, name in keys.items()}
    expected["random.cpu"] = tuple(torch.get_rng_state().shape)
    if "random.cuda" in found:
        expected["random.cuda"] = found["random.cuda"].shape
    check_shapes(found, expected)
    for name, facts in found.items():
        if facts.dtype != ("U8" if name.startswith("random.") else "F32"):
            raise ModelError(f"the tensor {name!r} is of type {facts.dtype}")


def _check_numbers(tensors: dict[str, Tensor]) -> None:
    """Raise ModelError for numbers with which training cannot continue."""
    check_values((name, value.numpy()) for name, value in tensors.items())
    for key, least in (("step", 1.0), ("exp_avg_sq", 0.0)):
        for name, value in _under(tensors, f"optimizer.{key}.").items():
            if float(value.min()) < least:
                raise ModelError(f"the tensor {f'optimizer.{key}.{name}'!r} has {float(value.min()):g}")


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
