"""HTSS, the hierarchical two-stream model of Ghosh et al. 2021, with control signals in place of text.

Five part encoders (32), joined to arms and legs with the torso (128) and to upper and lower body (512); a GRU of 512
for each of the two; GRU cells that decode each to velocities, which are added to the present pose. Controls are mapped
to features and added in encoder and decoder (paper section 5.3). Smooth L1 of poses, velocities, embeddings and the
autoencoded pose with 1, 0.1, 0.1 and 0.001, and a discriminator with 0.001.
Shape legend: B batch, T frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.func import functional_call

from motionkit.features.control import TRAJECTORY_COUNT
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.lab.networks.baseline import NO_SIGMA, BaselineConfig, contact_loss, masked_mean, steps
from motionkit.models.batch import Batch, FeatureSpace
from motionkit.models.parts import partition
from motionkit.models.predictor import NextFrame, Predictor

WEIGHTS = {"pose": 1.0, "velocity": 0.1, "embedding": 0.1, "autoencoded": 0.001, "gan": 0.001}
DISCRIMINATOR_WIDTH, DISCRIMINATOR_KERNEL = 64, 4
LIMBS = ("left arm", "right arm", "left leg", "right leg")
PARTS = (*LIMBS, "spine")

State = tuple[list[Tensor], list[Tensor]]  # of the two encoders, and of the two decoders


@dataclass(frozen=True)
class TwoStreamConfig(BaselineConfig):
    """Sizes of the network; part, limb and body are those of its paper."""

    architecture: str = "htss"
    part: int = 32
    limb: int = 128
    body: int = 512
    decoder: int = (
        256  # its paper does not give it; with 256 the parameters come near those the TPTN paper counts
    )


class Discriminator(nn.Module):
    """Says of windows of velocities whether they are recorded."""

    def __init__(self) -> None:
        super().__init__()
        width, kernel = DISCRIMINATOR_WIDTH, DISCRIMINATOR_KERNEL
        self.layers = nn.Sequential(
            nn.Conv1d(FEATURE_COUNT, width, kernel, stride=2),
            nn.LeakyReLU(0.2),
            nn.Conv1d(width, width, kernel, stride=2),
            nn.LeakyReLU(0.2),
            nn.Conv1d(width, 1, 1),
        )

    def forward(self, frames_BTF: Tensor) -> Tensor:
        return self.layers(steps(frames_BTF).transpose(1, 2))

    @staticmethod
    def whole(mask: Tensor) -> Tensor:
        """Return which of its windows (B, 1, W) hold frames of a mask (B, T) only."""
        padded = 1.0 - (mask[:, 1:] * mask[:, :-1] > 0.0).float()[:, None]
        for _ in range(2):
            padded = F.max_pool1d(padded, DISCRIMINATOR_KERNEL, stride=2)
        return 1.0 - padded


class BodyEncoder(Predictor):
    """Embeds five parts, with the torso as arms and legs, and these as upper and lower body."""

    def __init__(self, config: TwoStreamConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        layout = feature_layout(config.layout)
        self.columns: dict[str, list[int]] = {}
        for part in partition("five").parts:
            joints = part.joints if part.name == "spine" else part.joints[1:]  # the torso has the root
            self.columns[part.name] = [c for joint in joints for c in layout.joint_columns(joint)]
        self.encode_parts = nn.ModuleList(nn.Linear(size, config.part) for size in self.part_sizes())
        self.encode_limbs = nn.ModuleList(nn.Linear(2 * config.part, config.limb) for _ in LIMBS)
        self.encode_bodies = nn.ModuleList(nn.Linear(2 * config.limb, config.body) for _ in range(2))

    def part_sizes(self) -> list[int]:
        """Return the number of columns of the limbs and the torso."""
        return [len(self.columns[name]) for name in PARTS]

    def embed(self, x: Tensor) -> list[Tensor]:
        """Return the embeddings (..., 512) of upper and lower body of frames x (..., 276)."""
        parts = [
            F.relu(layer(x[..., self.columns[name]]))
            for layer, name in zip(self.encode_parts, PARTS, strict=True)
        ]
        limbs = [
            F.relu(layer(torch.cat([part, parts[4]], dim=-1)))
            for layer, part in zip(self.encode_limbs, parts, strict=False)
        ]
        pairs = (limbs[:2], limbs[2:])
        return [layer(torch.cat(pair, dim=-1)) for layer, pair in zip(self.encode_bodies, pairs, strict=True)]


class TwoStream(BodyEncoder):
    """Upper and lower body as two recurrent streams."""

    config: TwoStreamConfig
    config_class = TwoStreamConfig

    def __init__(self, config: TwoStreamConfig, control_size: int) -> None:
        super().__init__(config, control_size)
        self.embed_controls = nn.ModuleList(nn.Linear(control_size, config.body) for _ in range(2))
        self.encoders = nn.ModuleList(nn.GRU(config.body, config.body, batch_first=True) for _ in range(2))
        self.decoders = nn.ModuleList(nn.GRU(config.body, config.decoder, batch_first=True) for _ in range(2))
        self.decode_limbs = nn.ModuleList(nn.Linear(config.decoder, 2 * config.limb) for _ in range(2))
        self.decode_parts = nn.ModuleList(nn.Linear(config.limb, config.part) for _ in LIMBS)
        self.decode_torso = nn.Linear(4 * config.limb, config.part)
        self.to_columns = nn.ModuleList(nn.Linear(config.part, size) for size in self.part_sizes())
        self.to_rest = nn.Linear(2 * config.decoder, CONTACT_COUNT + TRAJECTORY_COUNT)
        self.discriminator = Discriminator()

    def pose(self, decoded: list[Tensor]) -> Tensor:
        """Return columns (..., 276) from the decoders' states of upper and lower body."""
        both = [F.relu(layer(each)) for layer, each in zip(self.decode_limbs, decoded, strict=True)]
        limbs = [limb for each in both for limb in each.chunk(2, dim=-1)]
        parts = [F.relu(layer(limb)) for layer, limb in zip(self.decode_parts, limbs, strict=True)]
        parts.append(F.relu(self.decode_torso(torch.cat(limbs, dim=-1))))
        out = parts[0].new_zeros(*parts[0].shape[:-1], FEATURE_COUNT)
        for layer, part, name in zip(self.to_columns, parts, PARTS, strict=True):
            out[..., self.columns[name]] = layer(part).to(out.dtype)
        return out

    def run(self, x: Tensor, controls: Tensor, state: State | None) -> tuple[NextFrame, State]:
        """Predict from frames (B, T, 276), and return the state to go on from."""
        controls_512 = [layer(controls) for layer in self.embed_controls]
        encoded, decoded, states = [], [], ([], [])  # type: ignore[var-annotated]
        for i, body in enumerate(self.embed(x)):
            made, kept = self.encoders[i](body + controls_512[i], None if state is None else state[0][i])
            encoded.append(made)
            states[0].append(kept)
            made, kept = self.decoders[i](made + controls_512[i], None if state is None else state[1][i])
            decoded.append(made)
            states[1].append(kept)
        mean = x + self.pose(decoded).float()
        contacts, trajectory = (
            self.to_rest(torch.cat(decoded, dim=-1)).float().split([CONTACT_COUNT, TRAJECTORY_COUNT], dim=-1)
        )
        return NextFrame(mean, torch.full_like(mean, NO_SIGMA), contacts, trajectory), states

    def losses(self, batch: Batch, space: FeatureSpace, progress: float) -> dict[str, Tensor]:
        """Return the four smooth L1 terms, those of contacts and trajectory, and both sides of the GAN."""
        made, _ = self.run(batch.inputs, batch.controls, None)
        assert made.trajectory_mean is not None
        mask = batch.mask

        def smooth(a: Tensor, b: Tensor, weights: Tensor = mask) -> Tensor:
            return masked_mean(F.smooth_l1_loss(a, b, reduction="none"), weights)

        embedded = zip(self.embed(made.mean), self.embed(batch.targets), strict=True)
        terms = {
            "pose": smooth(made.mean, batch.targets),
            "velocity": smooth(steps(made.mean), steps(batch.targets), mask[:, 1:]),
            "embedding": torch.stack([smooth(a.float(), b.detach().float()) for a, b in embedded]).sum(),
            "autoencoded": smooth(self._autoencoded(batch.inputs), batch.inputs),
            "gan": self._fooled(made.mean, mask),
        }
        return {
            **{name: WEIGHTS[name] * value for name, value in terms.items()},
            "trajectory": smooth(made.trajectory_mean, batch.trajectory),
            "contact": contact_loss(made, batch),
            "discriminator": self._discriminator_loss(made.mean, batch.targets, mask),
        }

    def _autoencoded(self, x: Tensor) -> Tensor:
        """Return frames decoded from their own embeddings, without time."""
        decoded = [
            decoder(encoder(body.flatten(0, 1)[:, None])[0])[0].reshape(*x.shape[:2], -1)
            for body, encoder, decoder in zip(self.embed(x), self.encoders, self.decoders, strict=True)
        ]
        return self.pose(decoded).float()

    def _fooled(self, made: Tensor, mask: Tensor) -> Tensor:
        """Return how little the discriminator takes predictions for recordings; its weights get no gradient."""
        fixed = {name: value.detach() for name, value in self.discriminator.named_parameters()}
        logits = functional_call(self.discriminator, fixed, (made,)).float()
        return _told(logits, 1.0, mask)

    def _discriminator_loss(self, made: Tensor, real: Tensor, mask: Tensor) -> Tensor:
        """Return how badly the discriminator tells predictions from recordings; predictions get no gradient."""
        false, true = self.discriminator(made.detach()).float(), self.discriminator(real).float()
        return _told(false, 0.0, mask) + _told(true, 1.0, mask)

    def stream(self, batch: int) -> TwoStreamState:
        """Return the state of a batch of characters."""
        return TwoStreamState(self)


def _told(logits: Tensor, recorded: float, mask: Tensor) -> Tensor:
    """Return how badly logits (B, 1, W) of a Discriminator tell that windows are recorded (1) or not (0)."""
    wanted = torch.full_like(logits, recorded)
    return F.binary_cross_entropy_with_logits(logits, wanted, weight=Discriminator.whole(mask))


class TwoStreamState:
    """The recurrent states of B characters."""

    def __init__(self, network: TwoStream) -> None:
        self.network = network
        self.reset()

    def reset(self, warmup: int = 0) -> None:
        """Forget all frames."""
        self.state: State | None = None

    def step(
        self, x_BF: Tensor, contacts_B4: Tensor, controls_BC: Tensor, latent_BZ: Tensor | None = None
    ) -> NextFrame:
        """Predict the next frame."""
        made, self.state = self.network.run(x_BF[:, None], controls_BC[:, None], self.state)
        assert made.trajectory_mean is not None
        return NextFrame(
            made.mean[:, 0], made.log_sigma[:, 0], made.contact_logits[:, 0], made.trajectory_mean[:, 0]
        )
