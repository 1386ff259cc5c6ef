"""The checkpoint of a training run: all that resuming needs, as safetensors, written atomically."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor, nn

from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError, ModelError
from motionkit.files import atomic_write
from motionkit.models.file_check import TensorFacts, check_number, check_shapes, check_values
from motionkit.models.tensor_file import TensorFile, open_tensors
from motionkit.seeds import LARGEST_SEED
from motionkit.training.learner import Learner
from motionkit.training.optimizer import Muon
from motionkit.training.options import TrainOptions, flat_options, with_changes
from motionkit.training.progress import Progress
from motionkit.training.window_blocks import BlockStart

FORMAT = "motionkit-run-1"
ADAMW = ("step", "exp_avg", "exp_avg_sq")  # state per parameter
MUON = ("momentum",)
MOST_BYTES = 4 * 2**30
MOST_STEPS = 10**12  # also the most seconds
MOST_BLOCK = 1000  # most steps of a block
MOST_CYCLES = 100
# Options that a resumed run may change: its length and its outputs.
# "sampler.splices" stays that of the beginning, as the number depends on the minutes.
FREE_ON_RESUME = ("steps", "minutes", "optimizer.cycles", "output.", "sampler.splices")
# Options that a resumed run takes from its checkpoint: the most, and whether a number is whole and must be there.
TAKEN = {
    "seed": (LARGEST_SEED, True, True),
    "sampler.splices": (100_000, True, True),
    "sampler.kept_share": (1, False, False),
    "steps": (MOST_STEPS, True, False),
    "minutes": (MOST_STEPS, False, False),
}


class Checkpoint:
    """The checkpoint in the folder of a run; a run can only be resumed with the same options and clips."""

    def __init__(self, folder: Path, dataset: Dataset, options: TrainOptions) -> None:
        self.path, self.options = folder / "checkpoint.safetensors", options
        self.dataset, self.digest = dataset, dataset.digest()

    def save(self, learner: Learner, at: Progress, block: BlockStart | None) -> None:
        """Write weights, their running average, optimizer states, the random state, options and progress.

        block is the start of the present block; None between blocks.
        """
        facts = {
            "format": FORMAT,
            "step": at.step,
            "seconds": at.seconds,
            "cycles": learner.ended,
            "losses": at.losses,
            "options": self.options.to_dict(),
            "clips": self.digest,
            "references": self.dataset.reference_rotations.tolist(),
        }
        tensors = {f"weights.{n}": t for n, t in learner.module.state_dict().items()}
        tensors.update({f"average.{n}": t for n, t in learner.average.items()})
        tensors.update({f"ends.{n}": t for n, t in learner.ends_of_cycles.items()})
        owners = _owners(learner)
        for name, p in learner.module.named_parameters():
            for key, value in owners[p].state.get(p, {}).items():
                tensors[f"optimizer.{key}.{name}"] = value.reshape(1) if value.dim() == 0 else value
        if block is not None:
            tensors.update({f"block.{n}": t for n, t in block.weights.items()})
            facts["block"] = {"step": block.step, "progress": block.progress}
        tensors["random.cpu"] = torch.get_rng_state()
        if torch.cuda.is_available():
            tensors["random.cuda"] = torch.cuda.get_rng_state()
        tensors = {n: t.detach().cpu().contiguous().clone() for n, t in tensors.items()}
        with atomic_write(self.path, "wb") as file:
            file.write(save(tensors, metadata={"run": json.dumps(facts)}))

    def load(self, learner: Learner, at: Progress) -> BlockStart | None:
        """Restore what save wrote; return the start of the present block, or None between blocks.

        Raises:
            DatasetError: if there is no checkpoint, or the run had other clips.
            ModelError: if it is damaged, or the run had other options, except FREE_ON_RESUME.
        """
        path = self.path
        if not path.is_file():
            raise DatasetError(f"{path}: no checkpoint to resume from")
        with _open_run(path) as (file, facts):
            self._check_options(flat_options(facts["options"]))
            self.options = with_changes(self.options, {"splices": _taken(path, facts)["sampler.splices"]})
            try:
                _check_fit(file.found, learner, facts)
                tensors = {name: torch.from_numpy(array) for name, array in file.read_all().items()}
                _check_numbers(tensors)
            except ModelError as error:
                raise ModelError(
                    f"{path}: the checkpoint does not fit this preset or is damaged ({error})"
                ) from None
        # Earlier releases did not write these.
        references = np.array(facts.get("references", self.dataset.reference_rotations), np.float32)
        same_clips = facts.get("clips", self.digest) == self.digest
        if not same_clips or not self.dataset.encoded_alike(references):
            other = "reference rotations" if same_clips else "training clips"
            raise DatasetError(
                f"{path}: the run was started with other {other} than those of "
                f"{self.dataset.folder}; resume it with the same, or delete {path.parent} and start anew"
            )
        _restore(path, tensors, learner)
        at.step, at.seconds = int(facts["step"]), float(facts["seconds"])
        at.losses = facts.get("losses", {})
        learner.ended = facts.get("cycles", 0)
        block = facts.get("block")
        if block is None:
            return None
        return BlockStart(block["step"], float(block["progress"]), _under(tensors, "block."))

    def _check_options(self, before: dict[str, Any]) -> None:
        """Raise ModelError if the run was started with other options."""
        # Earlier releases had only AdamW and did not write the method.
        before = {"optimizer.method": "adamw"} | before
        now = flat_options(json.loads(json.dumps(self.options.to_dict())))
        changed = [k for k in before if k in now and before[k] != now[k] and not k.startswith(FREE_ON_RESUME)]
        if changed:
            words = ", ".join(f"{name} {before[name]!r:.60} (now {now[name]!r:.60})" for name in changed)
            raise ModelError(
                f"{self.path}: the run was started with {words}; resume it with the same options"
            )


def run_options(path: Path) -> dict[str, Any]:
    """The options of a checkpoint's run, by the names of flat_options; raises ModelError if it is damaged."""
    with _open_run(path) as (_, facts):
        return _taken(path, facts)


def _taken(path: Path, facts: dict[str, Any]) -> dict[str, Any]:
    """The options of a run by flat names; those of TAKEN are numbers within their limits, or None."""
    options = flat_options(facts["options"])
    try:
        for name, (most, whole, needed) in TAKEN.items():
            if needed or options.setdefault(name) is not None:
                check_number(name, options.get(name), 0, most, whole)
    except ModelError as error:
        raise ModelError(f"{path}: the checkpoint is damaged ({error})") from None
    return options


@contextmanager
def _open_run(path: Path) -> Iterator[tuple[TensorFile, dict[str, Any]]]:
    """Open a checkpoint; yields the file and its checked metadata. Raises ModelError if it is not of this release."""
    with open_tensors(path, "run", "a training checkpoint", MOST_BYTES) as file:
        facts = file.metadata
        if not isinstance(facts, dict) or facts.get("format") != FORMAT:
            raise ModelError(f"{path}: not a training checkpoint of this release")
        try:
            _check_facts(facts)
        except ModelError as error:
            raise ModelError(f"{path}: the checkpoint is damaged ({error})") from None
        yield file, facts


def _restore(path: Path, tensors: dict[str, Tensor], learner: Learner) -> None:
    """Set random state, weights, their running average and optimizers to those of a checkpoint."""
    try:
        torch.set_rng_state(tensors["random.cpu"])
        if torch.cuda.is_available() and "random.cuda" in tensors:
            torch.cuda.set_rng_state(tensors["random.cuda"])
    except (RuntimeError, TypeError) as error:
        raise ModelError(f"{path}: the checkpoint is damaged ({str(error).splitlines()[0]})") from None
    learner.module.load_state_dict(_under(tensors, "weights."))
    for name, value in _under(tensors, "average.").items():
        learner.average[name].copy_(value)
    learner.ends_of_cycles = {
        name: value.to(learner.average[name].device) for name, value in _under(tensors, "ends.").items()
    }
    owners = _owners(learner)
    for name, p in learner.module.named_parameters():
        optimizer = owners[p]
        kept = {key: tensors.get(f"optimizer.{key}.{name}") for key in _kept(optimizer)}
        # A fused optimizer has its step counts on the parameters' device, any other on the CPU.
        at = p.device if optimizer.defaults.get("fused") else torch.device("cpu")
        optimizer.state[p] = {
            key: value.reshape(()).to(at) if key == "step" else value.to(p.device)
            for key, value in kept.items()
            if value is not None  # there is no state before the first step
        }


def _owners(learner: Learner) -> dict[nn.Parameter, torch.optim.Optimizer]:
    """Return the optimizer of each parameter."""
    return {p: each for each in learner.optimizers for group in each.param_groups for p in group["params"]}


def _kept(optimizer: torch.optim.Optimizer) -> tuple[str, ...]:
    """Return the names of an optimizer's state per parameter."""
    return MUON if isinstance(optimizer, Muon) else ADAMW


def _check_facts(facts: dict[str, Any]) -> None:
    """Raise ModelError for steps, times or options that no run can have."""
    step: Any = facts.get("step")
    check_number("step", step, 0, MOST_STEPS, whole=True)
    check_number("seconds", facts.get("seconds"), 0, MOST_STEPS)
    check_number("cycles", facts.get("cycles", 0), 0, MOST_CYCLES, whole=True)
    block = facts.get("block")
    if block is not None:
        block = block if isinstance(block, dict) else {}
        least = max(0, step - MOST_BLOCK)
        check_number("the first step of the block", block.get("step"), least, step - 1, whole=True)
        check_number("progress", block.get("progress"), 0, 1)
    losses = facts.get("losses", {})
    if not isinstance(losses, dict) or not all(isinstance(value, float) for value in losses.values()):
        raise ModelError(f"losses are {losses!r:.60}, expected numbers by name")
    if not isinstance(facts.get("options"), dict):
        raise ModelError(f"options is {facts.get('options')!r:.60}, expected an object")


def _check_fit(found: Mapping[str, TensorFacts], learner: Learner, run: Mapping[str, Any]) -> None:
    """Raise ModelError if a file does not have exactly the tensors of this run, with their shapes and types."""
    module, average = learner.module, learner.average
    expected = {f"weights.{name}": tuple(value.shape) for name, value in module.state_dict().items()}
    expected |= {f"average.{name}": tuple(value.shape) for name, value in average.items()}
    for kind, there in (("block", "block" in run), ("ends", run.get("cycles", 0))):
        if there:
            expected |= {f"{kind}.{name}": tuple(value.shape) for name, value in average.items()}
    owners = _owners(learner)
    for name, p in module.named_parameters():
        keys = {key: f"optimizer.{key}.{name}" for key in _kept(owners[p])}
        if any(key in found for key in keys.values()):  # there is no state before the first step
            expected |= {name: (1,) if key == "step" else tuple(p.shape) for key, name in keys.items()}
    expected["random.cpu"] = tuple(torch.get_rng_state().shape)
    if "random.cuda" in found:
        expected["random.cuda"] = found["random.cuda"].shape
    check_shapes(found, expected)
    for name, facts in found.items():
        if facts.dtype != ("U8" if name.startswith("random.") else "F32"):
            raise ModelError(f"the tensor {name!r} is of type {facts.dtype}")


def _check_numbers(tensors: dict[str, Tensor]) -> None:
    """Raise ModelError for values with which training cannot continue."""
    check_values((name, value.numpy()) for name, value in tensors.items())
    for key, least in (("step", 1.0), ("exp_avg_sq", 0.0)):
        for name, value in _under(tensors, f"optimizer.{key}.").items():
            if float(value.min()) < least:
                raise ModelError(f"the tensor {f'optimizer.{key}.{name}'!r} has {float(value.min()):g}")


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
