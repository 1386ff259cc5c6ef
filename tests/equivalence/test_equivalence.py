"""Every way of making a frame makes the same motion: one table, over all controls together.

Types blend, trajectories come and go, phases run, references are shown with their gain or not at all, correlated noise
is drawn, and the root-slip correction is on, in part, and off. A closed loop makes more of the last bits, by how much
depends on the machine. So each frame is made from the one that numpy has made before it, and the network's memory is
each way's own; closed loops are compared over a stretch, and by where they go. Random networks of all shapes are
compared in tests/inference/test_step.py and in tests/models/test_streaming.py.
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

pytestmark = pytest.mark.thorough

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
    """Joints (T, 23, 3) in cm, normalised features (T, 276), contacts (T, 4), and what each frame went on from."""

    positions: np.ndarray
    features: np.ndarray
    contacts: np.ndarray
    begun: list[list[np.ndarray]]


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


STATE = ("x", "before", "contacts", "ground")  # of a frame, from which the next one goes on


@cache
def made(way: str, closed: bool = False) -> Made:
    """What a way makes of every_control, from the first type's start pose.

    closed: from its own frames; else each frame goes on from where numpy was before it.
    """
    model = load_bundled_model()
    step, compiled = WAYS[way]
    stream = CharacterStream(model, 1, Noise(temperature=0.2), seed=3, ik=False)
    if not compiled:
        pose_in_numpy(stream)
    stream.state.network = step()
    stream.reset(0, type=model_first_type(model))
    state = [getattr(stream.state.frame, name) for name in STATE]
    led = None if closed or way == "numpy" else made("numpy").begun
    positions, features, contacts, begun = [], [], [], []
    for number, asked in enumerate(every_control(model, FRAMES)):
        if led is not None:
            for mine, its in zip(state, led[number], strict=True):
                mine[:] = its
        begun.append([values.copy() for values in state])
        frame = stream.step(asked)
        positions.append(frame.positions[0])
        contacts.append(frame.contacts[0])
        features.append(stream.state.frame.x[0].copy())
    return Made(np.stack(positions), np.stack(features), np.stack(contacts), begun)


# Of a frame: largest distance of a joint from numpy's (cm), of a normalised feature and of a contact.
TABLE = [
    ("torch, forward", 2e-4, 2e-5, 2e-5),
    ("torch, stream", 2e-4, 2e-5, 2e-5),
    pytest.param("numpy, C frame", 2e-4, 2e-5, 2e-5),
    pytest.param("C, float32", 2e-4, 2e-5, 2e-5),
    pytest.param("C, 16 bits", 0.01, 4e-3, 2e-3),
]


@pytest.mark.parametrize(("way", "positions", "features", "contacts"), TABLE)
def test_all_ways_make_the_same_frames(way: str, positions: float, features: float, contacts: float) -> None:
    ours, theirs = made(way), made("numpy")
    apart = [
        float(np.linalg.norm(ours.positions - theirs.positions, axis=-1).max()),
        float(np.abs(ours.features - theirs.features).max()),
        float(np.abs(ours.contacts - theirs.contacts).max()),
    ]
    assert all(
        found < allowed for found, allowed in zip(apart, (positions, features, contacts), strict=True)
    ), (way, apart)


@pytest.mark.parametrize(
    ("way", "near"),
    [
        pytest.param("C, float32", 0.02),
        pytest.param("C, 16 bits", 2.0),
    ],
)
def test_closed_loops_go_the_same_way(way: str, near: float) -> None:
    """Places over a second; then how far the hips went, how much the joints moved, and features come back."""
    ours, theirs = made(way, closed=True), made("numpy")
    assert np.abs(ours.positions - theirs.positions)[:60].max() < near
    for a, b in zip(_amounts(ours), _amounts(theirs), strict=True):
        assert a == pytest.approx(b, rel=0.02)
    assert float(np.abs(ours.features - theirs.features)[FRAMES // 2 :].max()) < 0.05
    assert float(np.abs(ours.contacts - theirs.contacts)[FRAMES // 2 :].max()) < 0.05


def _amounts(one: Made) -> tuple[float, float]:
    """The way of the hips over the ground (cm), and the mean way of a joint beside them."""
    hips = one.positions[:, :1]
    ways = np.linalg.norm(np.diff(hips[..., [0, 2]], axis=0), axis=-1).sum()
    return float(ways), float(
        np.linalg.norm(np.diff(one.positions - hips, axis=0), axis=-1).sum(axis=0).mean()
    )


def test_the_graph_makes_the_motion_of_c() -> None:
    """In closed loop, but no longer than every control takes to change."""
    pytest.importorskip("onnxruntime")
    onnx_export = pytest.importorskip("motionkit.export.onnx_export")
    model = load_bundled_model()
    graph = onnx_export.build_graph(model).SerializeToString()
    check = check_export(model, graph, "default", 120)
    assert check.positions < 0.02 and check.features < 1e-3


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
