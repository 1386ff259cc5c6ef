"""Scheduled sampling (Bengio et al. 2015): predictions of the network as training inputs.

In plain training every input frame is recorded; in a roll-out none is. A network that is slightly too slow on
recorded frames gets slower on its own frames, and in the end it stands still. Here some windows are run frame by
frame, and each prediction becomes the next input. By chance, or if the prediction is too far off, the recorded
frame is the input again. The target is always the recorded next frame, so the network learns to come back.
Sequences of predictions must be short: once the rhythm is lost, the best guess of the recorded frame is the mean pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motionkit.features.layout import feature_layout
from motionkit.features.reference import REFERENCE_COUNT
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_weights import why_not_packable
from motionkit.inference.stepping import stepper
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.predictor import NextFrame, Predictor
from motionkit.models.torch_rotations import orthonormal
from motionkit.training.replay import Replayed


@dataclass(frozen=True)
class ScheduledSamplingOptions:
    """Settings of scheduled sampling."""

    share: float = 0.4  # share of windows with predictions as inputs
    period: int = 16  # steps whose windows are run together, with the weights of the first step
    back: float = 0.08  # probability per frame of returning to the recorded frame
    limit: float = 0.5  # RMS of the normalised error above which the recorded frame is the input again
    # The same for frames with reference poses or a phase, which keep the rhythm and so allow longer sequences.
    reference_back: float = 0.02
    reference_limit: float = 1.0
    temperature: float = 0.1  # sampling temperature of the predictions
    rho: float = 0.95  # correlation of the noise from frame to frame, as in synthesis


class PredictedInputs:
    """Replaces inputs of windows by predictions of a network. On a GPU the whole roll-out is one CUDA graph.

    The matrix (276, 72) of the ReferenceMap makes reference poses relative to predictions.
    """

    def __init__(self, network: Predictor, reference_matrix: Tensor, space: FeatureSpace) -> None:
        self.network, self.reference_matrix, self.space = network, reference_matrix, space
        self.options = ScheduledSamplingOptions()
        self._roll_out = Replayed(self._frames)

    @torch.no_grad()
    def __call__(
        self, batch: Batch, options: ScheduledSamplingOptions, generators: list[torch.Generator]
    ) -> Batch:
        """Return a batch in which short sequences of inputs and contacts are predictions of the network.

        A frame at which the input returns to the recorded frame is masked from the losses, because no body makes that
        step. Each window has a generator on the batch's device, so that windows do not depend on each other.
        """
        if options != self.options:
            self.options, self._roll_out = options, Replayed(self._frames)
        _, T, F = batch.inputs.shape
        fresh = torch.stack([torch.randn(T, F, generator=g, device=g.device) for g in generators])
        chance = torch.stack([torch.rand(T, generator=g, device=g.device) for g in generators])
        arrays = (batch.inputs, batch.targets, batch.contacts, batch.controls, batch.mask)
        was_training = self.network.training
        self.network.eval()
        made = self._roll_out(*arrays, fresh, chance)
        self.network.train(was_training)
        # Copies, because the next call overwrites a graph's results.
        inputs, contacts, controls, mask = (x.clone() for x in made)
        return replace(batch, inputs=inputs, contacts=contacts, controls=controls, mask=mask)

    def _frames(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        """Return inputs, contacts, controls and mask of a roll-out.

        tensors are inputs, targets, contacts, controls and mask of a batch, normal noise (B, T, F), and uniform random
        numbers (B, T).
        """
        inputs, targets, contacts, controls, mask, fresh, chance = tensors
        options, network, device = self.options, self.network, inputs.device
        step = _frame_step(network, len(inputs), device)
        reference_columns = slice(network.control_size - 1 - REFERENCE_COUNT, network.control_size - 1)
        phase = slice(reference_columns.start - 2, reference_columns.start)
        reference_gain = controls[..., network.control_size - 1] > 0
        if network.config.controls == "paper":  # neither reference poses nor a phase
            timed = reference_gain = torch.zeros_like(reference_gain)
        else:
            timed = reference_gain | (controls[..., phase] != 0.0).any(dim=-1)
        stays = chance >= torch.where(timed, options.reference_back, options.back)
        limit = torch.where(timed, options.reference_limit, options.limit)
        inputs, contacts, controls, mask = (x.clone() for x in (inputs, contacts, controls, mask))
        rolled = torch.zeros_like(stays[:, 0])
        noise, rho = (
            fresh[:, 0],
            options.rho,
        )  # of the frame before, so that its deviation is 1 from the start
        for t in range(inputs.shape[1] - 1):
            made = step(inputs[:, t], contacts[:, t], controls[:, t])
            noise = rho * noise + (1.0 - rho * rho) ** 0.5 * fresh[:, t + 1]
            frame = self._keep_rotation(made.mean + options.temperature * noise * torch.exp(made.log_sigma))
            error = (frame - targets[:, t]).square().mean(dim=-1).sqrt()
            now = stays[:, t] & (error < limit[:, t])
            mask[:, t + 1] *= ~(rolled & ~now)
            chosen = now[:, None]
            moved = torch.where(chosen, frame - inputs[:, t + 1], 0.0)
            inputs[:, t + 1] += moved
            controls[:, t + 1, reference_columns] -= reference_gain[:, t + 1, None] * (
                moved @ self.reference_matrix
            )
            contacts[:, t + 1] = torch.where(chosen, torch.sigmoid(made.contact_logits), contacts[:, t + 1])
            rolled = now
        return inputs, contacts, controls, mask

    def _keep_rotation(self, frame: Tensor) -> Tensor:
        """Return normalised frames (B, 276) whose root rotation is orthonormal, as in synthesis."""
        columns = feature_layout(self.space.layout)
        if not columns.root_is_sixd:
            return frame
        root = columns.blocks["root_rotation"]
        mean, std = self.space.mean[root], self.space.std[root]
        kept = (orthonormal(frame[:, root] * std + mean) - mean) / std
        return torch.cat([frame[:, : root.start], kept, frame[:, root.stop :]], dim=-1)


def _frame_step(
    network: Predictor, batch: int, device: torch.device
) -> Callable[[Tensor, Tensor, Tensor], NextFrame]:
    """Return a function that predicts the next frame: the C step of synthesis on a CPU, else the network's stream."""
    if device.type != "cpu" or why_not_packable(network.config) is not None:
        return network.stream(batch).step
    state = stepper(network.weights(), batch)
    assert isinstance(state, NetworkStep)
    mean, log_sigma, logits = map(torch.from_numpy, (state.mean, state.log_sigma, state.contact_logits))
    made = NextFrame(mean, log_sigma, logits, None)

    def step(x: Tensor, contacts: Tensor, controls: Tensor) -> NextFrame:
        state.step(x.numpy(), contacts.numpy(), controls.numpy())
        return made

    return step


def sampled_windows(first: int, count: int, share: float) -> list[int]:
    """Return which of the windows first to first + count of a block use predictions, as indices from first."""
    return [i for i in range(count) if int((first + i + 1) * share) > int((first + i) * share)]
