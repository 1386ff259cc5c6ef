"""Every way of making a frame makes the same motion: one table, over all controls together, in closed loop.

Each way goes on from its own frames for 300 frames in which types blend, trajectories come and go, phases run,
references are shown with their gain or not at all, correlated noise is drawn, and the root-slip correction is on, in
part, and off. Random networks of all shapes are compared in tests/inference/test_step.py and in
tests/models/test_streaming.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from motionkit.export.onnx_export import check_export, every_control
from motionkit.inference.character import CharacterStream, model_first_type
from motionkit.inference.noise import Noise
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel
from motionkit.inference.step_weights import pack
from motionkit.inference.stepping import TorchStep
from motionkit.models.bundled import load_bundled_model
from motionkit.models.network import NetworkStream, PartTransformer
from motionkit.models.weights import NetworkWeights
from oracle.characters import pose_in_numpy
from oracle.step import numpy_step

FRAMES = 300


class WholeStream(NetworkStream):
    """The network's forward over the last receptive field at every frame."""

    def __init__(self, network: PartTransformer, batch: int) -> None:
        super().__init__(network, batch)
        self.recomputes = True
        self.reset()


class WholeStep(TorchStep):
    """TorchStep on WholeStream."""

    def __init__(self, network: NetworkWeights, batch: int) -> None:
        super().__init__(network, batch)
        self.streams = [WholeStream(self.network, 1) for _ in range(batch)]

    def alone(self) -> WholeStep:
        """A step of the same network for one character."""
        return WholeStep(self.weights, 1)


@dataclass(frozen=True, eq=False)
class Made:
    """Joints (T, 23, 3) in cm, normalised features (T, 276) and contacts (T, 4)."""

    positions: np.ndarray
    features: np.ndarray
    contacts: np.ndarray


def _numpy() -> NetworkStep:
    return numpy_step(pack(load_bundled_model().network), 1)


def _kernel(small: bool) -> NetworkStep:
    return NetworkStep(StepKernel(pack(load_bundled_model().network), small), 1)


# The network's step, and whether the C kernels draw and pose the frame.
WAYS: dict[str, tuple[Callable[[], NetworkStep | TorchStep], bool]] = {
    "torch, forward": (lambda: WholeStep(load_bundled_model().network, 1), False),
    "torch, stream": (lambda: TorchStep(load_bundled_model().network, 1), False),
    "numpy": (_numpy, False),
    "numpy, C frame": (_numpy, True),
    "C, float32": (lambda: _kernel(False), True),
    "C, 16 bits": (lambda: _kernel(True), True),
}


@cache
def made(way: str) -> Made:
    """What a way makes of every_control, from the first type's start pose."""
    model = load_bundled_model()
    step, compiled = WAYS[way]
    stream = CharacterStream(model, 1, Noise(temperature=0.2), seed=3, ik=False)
    if not compiled:
        pose_in_numpy(stream)
    stream.state.network = step()
    stream.reset(0, type=model_first_type(model))
    positions, features, contacts = [], [], []
    for asked in every_control(model, FRAMES):
        frame = stream.step(asked)
        positions.append(frame.positions[0])
        contacts.append(frame.contacts[0])
        features.append(stream.state.frame.x[0].copy())
    return Made(np.stack(positions), np.stack(features), np.stack(contacts))


# Largest distance of a joint (cm), of a normalised feature and of a contact, between two ways.
TABLE = [
    ("torch, stream", "torch, forward", 0.005, 1e-4, 1e-4),
    ("numpy", "torch, stream", 0.005, 1e-4, 1e-4),
    ("numpy", "torch, forward", 0.005, 1e-4, 1e-4),
    ("numpy, C frame", "numpy", 0.005, 1e-4, 1e-4),
    ("C, float32", "numpy", 0.005, 1e-4, 1e-4),
    # The first second of this script magnifies differences of rounding; the test below says that they die down.
    ("C, 16 bits", "C, float32", 3.0, 0.3, 0.1),
    ("C, 16 bits", "torch, forward", 3.0, 0.3, 0.1),
]


@pytest.mark.parametrize(("way", "other", "positions", "features", "contacts"), TABLE)
def test_all_ways_make_the_same_motion(
    way: str, other: str, positions: float, features: float, contacts: float
) -> None:
    ours, theirs = made(way), made(other)
    apart = [
        float(np.linalg.norm(ours.positions - theirs.positions, axis=-1).max()),
        float(np.abs(ours.features - theirs.features).max()),
        float(np.abs(ours.contacts - theirs.contacts).max()),
    ]
    assert all(
        found < allowed for found, allowed in zip(apart, (positions, features, contacts), strict=True)
    ), (way, other, apart)


def test_16_bits_come_back_to_the_same_motion() -> None:
    """Positions hold what was walked meanwhile, features do not."""
    ours, theirs = made("C, 16 bits"), made("C, float32")
    assert float(np.abs(ours.features - theirs.features)[FRAMES // 2 :].max()) < 0.02
    assert float(np.abs(ours.contacts - theirs.contacts)[FRAMES // 2 :].max()) < 0.01


def test_the_graph_makes_the_motion_of_c() -> None:
    pytest.importorskip("onnxruntime")
    onnx_export = pytest.importorskip("motionkit.export.onnx_export")
    model = load_bundled_model()
    graph = onnx_export.build_graph(model).SerializeToString()
    check = check_export(model, graph, "default", FRAMES)
    assert check.positions < 0.005 and check.features < 1e-4


def test_every_control_is_among_them() -> None:
    script = every_control(load_bundled_model(), FRAMES)
    assert len(script) == FRAMES
    weights = np.concatenate([asked.type_weights for asked in script])
    assert ((weights > 0.1).sum(axis=1) > 1).mean() > 0.1 and (weights.max(axis=0) == 1.0).sum() == 4
    for values in (
        [asked.trajectory_mask[0] for asked in script],
        [asked.phase[0] >= 0.0 for asked in script],
        [asked.slip_correction[0] > 0.0 for asked in script],
    ):
        assert 0.2 < np.mean(values) < 0.9
    gains = {float(asked.reference_gain[0]) for asked in script}
    assert 0.0 in gains and len(gains) > 2
    moved = made("numpy")
    assert np.abs(np.diff(moved.positions[:, 0], axis=0)).sum() > 100.0, "it goes somewhere"
