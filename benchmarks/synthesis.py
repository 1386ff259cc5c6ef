"""A frame of motion by every way of making one: recomputed as in the paper, streamed, as an ONNX graph.

    python benchmarks/synthesis.py [--model FILE] [--characters 1 64] [--steps 300]

Controls, noise, network, integration, forward kinematics and, where named, foot locking are all in the
time; only "network alone" and the floor leave them out. The floor is one pass over memory of the size of
the weights, the least that a step has to do. The processor's time is printed beside the clock's: where
the two are far apart, the machine was busy with something else. One character has one core, a crowd has
all of them.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from common import percentiles, print_table

from motionkit.arrays import Floats
from motionkit.features.control import Controls
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.character import CharacterStream
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel
from motionkit.inference.step_weights import StepWeights, pack
from motionkit.inference.stepping import TorchStep
from motionkit.models.bundled import open_model
from motionkit.models.model import MotionModel
from motionkit.models.weights import NetworkWeights

Step = Callable[[], object]


class WindowStep(TorchStep):
    """The paper's method: run the whole network over the last 87 frames and use the last prediction."""

    def __init__(self, network: NetworkWeights, batch: int) -> None:
        super().__init__(network, batch)
        sizes = (FEATURE_COUNT, CONTACT_COUNT, network.control_size)
        self.past = [np.zeros((batch, network.config.receptive_field, size), np.float32) for size in sizes]

    @torch.inference_mode()
    def step(self, x: Floats, contacts: Floats, controls: Floats) -> None:
        """Predict the next frame from a new frame."""
        new = (v[:, None] for v in (x, contacts, controls))
        self.past = [
            np.concatenate([past[:, 1:], now], axis=1) for past, now in zip(self.past, new, strict=True)
        ]
        made = self.network(*(torch.from_numpy(past) for past in self.past))
        self.mean[:], self.log_sigma[:] = made.mean[:, -1].numpy(), made.log_sigma[:, -1].numpy()
        self.contact_logits[:] = made.contact_logits[:, -1].numpy()


def asked_of(model: MotionModel, count: int) -> Controls:
    """Return type weights that give every character its own type."""
    weights = np.eye(len(model.types), dtype=np.float32)[np.arange(count) % len(model.types)]
    return Controls.of_types(weights)


def characters(
    model: MotionModel,
    count: int,
    make: Callable[[], NetworkStep | TorchStep],
    ik: bool,
) -> Step:
    """Return a function that makes a whole frame for count characters with a given network step."""
    stream = CharacterStream(model, count, ik=ik)
    stream.state.network = make()
    asked = asked_of(model, count)
    return lambda: stream.step(asked)


def network_alone(step: NetworkStep) -> Step:
    """Return a function that runs the network alone."""
    rng = np.random.default_rng(0)
    x, contacts = (rng.standard_normal((step.batch, n), np.float32) for n in (FEATURE_COUNT, CONTACT_COUNT))
    controls = rng.standard_normal(step.arrays.controls.shape, np.float32)
    return lambda: step.step(x, contacts, controls)


def floor(weights: StepWeights, bits: int) -> Step:
    """Return a function that sums over as much memory as the weights take."""
    modules = (weights.shallow, weights.deep)
    size = sum(array.size for module in modules for array in vars(module).values()) + weights.head.size
    memory = np.ones(size * bits // 32, np.float32)
    return lambda: memory.sum()


def graph(model: MotionModel, folder: Path) -> Step:
    """Return a function that runs the ONNX graph, including forward kinematics."""
    from motionkit.export.onnx_export import OnnxStep, build_graph

    path = folder / "model.onnx"
    path.write_bytes(build_graph(model).SerializeToString())
    step = OnnxStep(path)
    step.values["type_weights"][:] = asked_of(model, 1).type_weights
    step.values["phase"][:], step.values["slip_correction"][:] = -1.0, 1.0
    return step.step


def timed(step: Step, steps: int, limit: float) -> tuple[list[float], list[float]]:
    """Return wall-clock and processor seconds of each step, after some warm-up steps."""
    for _ in range(3):
        step()
    seconds: list[float] = []
    busy: list[float] = []
    while len(seconds) < steps and (sum(seconds) < limit or len(seconds) < 5):
        began, worked = time.perf_counter(), time.process_time()
        step()
        seconds.append(time.perf_counter() - began)
        busy.append(time.process_time() - worked)
    return seconds, busy


def ways(model: MotionModel, count: int, folder: Path) -> dict[str, Step]:
    """Return the functions to time for a number of characters; the first is the baseline."""
    network, weights = model.network, pack(model.network)
    out: dict[str, Step] = {
        "recompute the window, torch": characters(model, count, lambda: WindowStep(network, count), False),
    }
    if count == 1:
        out["stream, torch"] = characters(model, count, lambda: TorchStep(network, count), False)
    kernels = {"C, float32": StepKernel(weights), "C, 16 bits": StepKernel(weights, small=True)}
    for name, kernel in kernels.items():
        make = lambda kernel=kernel: NetworkStep(kernel, count)  # noqa: E731
        out[f"stream, {name}"] = characters(model, count, make, False)
        out[f"stream, {name}, foot locking"] = characters(model, count, make, True)
        out[f"network alone, {name}"] = network_alone(make())
    if count == 1:
        with suppress(ImportError):
            import onnxruntime  # noqa: F401

            out["ONNX Runtime, float32"] = graph(model, folder)
        out["floor: 32-bit weights"], out["floor: 16-bit weights"] = floor(weights, 32), floor(weights, 16)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, help="a model file; the bundled model by default")
    parser.add_argument("--characters", type=int, nargs="+", default=[1, 64])
    parser.add_argument("--steps", type=int, default=300, help="timed steps of each method")
    parser.add_argument("--seconds", type=float, default=2.0, help="seconds after which a method stops early")
    arguments = parser.parse_args()
    model = open_model(arguments.model)
    cores = torch.get_num_threads()
    rows = []
    for count in arguments.characters:
        torch.set_num_threads(1 if count == 1 else cores)
        baseline = 0.0
        with tempfile.TemporaryDirectory() as folder:
            for name, step in ways(model, count, Path(folder)).items():
                seconds, busy = timed(step, arguments.steps, arguments.seconds)
                p50, p95, p99 = percentiles(seconds)
                baseline = baseline or p50
                times = [f"{1000 * p:.2f}" for p in (p50, p95, p99, percentiles(busy)[0])]
                rows.append([f"{count}: {name}", *times, f"{count / p50:.0f}", f"{baseline / p50:.1f}"])
    header = [
        "characters: way",
        "p50 ms",
        "p95 ms",
        "p99 ms",
        "CPU p50 ms",
        "character-frames/s",
        "times as fast",
    ]
    memory = NetworkStep(StepKernel(pack(model.network)), 1).bytes_per_character
    print_table("time per frame, and speed-up over recomputing", header, rows)
    print(f"state of the network: {memory / 1024:.0f} KB per character")


if __name__ == "__main__":
    main()
