"""What test_sanitizers.py runs in a process of its own: the kernels on random shapes and numbers.

Usage: python sanitized.py FOLDER_OF_LIBRARIES
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from motionkit.control import steering_kernel
from motionkit.control.path import PathPart, make_path
from motionkit.control.path_place import PathPlace, plan_route
from motionkit.control.steering import Steering
from motionkit.features.control import ControlLayout, Controls
from motionkit.features.layout import LAYOUTS
from motionkit.inference import frame_kernel, step_kernel
from motionkit.inference.character import CharacterStream
from motionkit.inference.frame_arrays import BodyArrays
from motionkit.inference.frame_kernel import PoseKernel
from motionkit.inference.noise import Noise
from motionkit.inference.step import NetworkStep
from motionkit.inference.step_kernel import StepKernel
from motionkit.inference.step_weights import pack
from motionkit.models import attention_kernel
from motionkit.models.bundled import load_bundled_model
from motionkit.models.config import ModelConfig
from motionkit.models.file_check import weight_shapes
from motionkit.models.parts import PARTITIONS
from motionkit.models.presets import preset
from motionkit.models.weights import NetworkWeights

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from oracle.step import numpy_step

ODD_NUMBERS = (np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-45, 0.0)
load_library = step_kernel.load_library


def random_config(rng: np.random.Generator) -> ModelConfig:
    """Sizes that fit no tile, vector or block."""
    heads = int(rng.integers(1, 20))
    width = heads * int(rng.integers(1, 9))
    width += -width % heads + heads * max(0, -(-(4 - width) // heads))
    control = int(rng.integers(1, max(2, width // 2)))
    return ModelConfig().changed(
        partition=str(rng.choice(list(PARTITIONS))),
        width=width,
        heads=heads,
        ffn=int(rng.integers(1, 70)),
        layers=int(rng.integers(1, 4)),
        window=int(rng.integers(1, 18)),
        kernel=int(rng.integers(1, 5)),
        control_width=control,
        control_embedding=control + int(rng.integers(0, 9)),
        shared_channels=int(rng.integers(0, width - control)),
        contact_hidden=int(rng.integers(1, 70)),
        fusion=str(rng.choice(["linear", "none"])),
        layer_controls=bool(rng.integers(2)),
        head_momentum=bool(rng.integers(2)),
    )


def usual(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Normal numbers."""
    return rng.standard_normal(shape).astype(np.float32)


def odd(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Normal numbers, a few of them not."""
    out = usual(rng, shape)
    out.flat[rng.integers(0, out.size, 3)] = rng.choice(ODD_NUMBERS, 3)
    return out


def random_network(rng: np.random.Generator, config: ModelConfig, control_size: int) -> NetworkWeights:
    """Weights that keep numbers about as large as they are."""
    arrays = {
        name: (rng.uniform(-1.0, 1.0, shape) / np.sqrt(shape[-1])).astype(np.float32)
        for name, shape in weight_shapes(config, control_size).items()
    }
    return NetworkWeights(config, control_size, arrays)


def try_steps(rng: np.random.Generator) -> None:
    """A random network for some characters: as numpy has it on usual numbers, then on odd ones."""
    size = ControlLayout(tuple("abcdefgh"[: rng.integers(1, 9)])).size
    weights = pack(random_network(rng, random_config(rng), size))
    batch = int(rng.choice([1, 2, 7, 8, 9, 16, 17, 33]))
    kernels = (StepKernel(weights), StepKernel(weights, True))
    steps = [numpy_step(weights, batch), *(NetworkStep(kernel, batch) for kernel in kernels)]
    for frame in range(20):
        make = odd if frame >= 18 else usual
        given = make(rng, (batch, 276)), make(rng, (batch, 4)), make(rng, (batch, size))
        for step in steps:
            step.step(*given)
        if frame < 18:
            np.testing.assert_allclose(steps[1].mean, steps[0].mean, atol=1e-4)
            np.testing.assert_allclose(steps[2].mean, steps[0].mean, atol=1e-2)
            np.testing.assert_allclose(steps[1].contact_logits, steps[0].contact_logits, atol=1e-4)


def try_poses(rng: np.random.Generator) -> None:
    """Random bodies, feet and floors, and odd ones."""
    count, layout = int(rng.integers(1, 9)), str(rng.choice(LAYOUTS))
    body = BodyArrays.of(count, bool(rng.integers(2)))
    body.offsets[:], body.scale[:] = odd(rng, (count, 23, 3)), rng.uniform(0.5, 1.5, count)
    kernel = PoseKernel(layout, odd(rng, (23, 4)), body)
    for _ in range(10):
        kernel.pose(odd(rng, (count, 276)), odd(rng, (count, 4)), odd(rng, (count, 3)))
    frame_kernel.rises(layout, odd(rng, (count, 276)), odd(rng, (count, 23)))


def try_characters(rng: np.random.Generator) -> None:
    """Whole characters, drawn, held and locked."""
    model = load_bundled_model()
    model = replace(model, network=random_network(rng, preset("tiny"), model.controls.size))
    noise = Noise(str(rng.choice(["mean", "sample", "correlated"])))
    stream = CharacterStream(model, 3, noise, 3, ik=True)
    weights = rng.dirichlet(np.ones(len(model.types)), 3).astype(np.float32)
    for frame in range(20):
        way = (odd if frame >= 18 else usual)(rng, (3, 24))
        asked = replace(Controls.of_types(weights), trajectory=way, phase=np.full(3, 0.5, np.float32))
        stream.step(asked.with_mask(1.0))


def try_attention(rng: np.random.Generator) -> None:
    """Attention of random sizes and its gradients, in both formats, on usual and odd numbers."""
    P, B, T, E, W = (int(rng.integers(1, most)) for most in (4, 4, 40, 30, 18))
    for kind in (torch.float32, torch.bfloat16):
        for make in (usual, odd):
            shapes = ((P, B, T, 3, E, 8), (P, 3, E, 8), (P, W, 8))
            qkv, bias, position = (torch.from_numpy(make(rng, shape)).requires_grad_() for shape in shapes)
            attention_kernel.attend(qkv.to(kind), bias, position).float().square().sum().backward()


def try_steering(rng: np.random.Generator) -> None:
    """Wishes and places, some of them odd."""
    steering = Steering(load_bundled_model())
    for frame in range(200):
        place, wish = ((odd if frame % 5 == 4 else usual)(rng, (3,)) * 200.0 for _ in range(2))
        steering.observe(*place.tolist(), bool(rng.integers(2)))
        kind = steering.type(tuple(wish[:2].tolist()), float(wish[2]))
        steering.trajectory(kind, tuple(wish[:2].tolist()), float(wish[2]) if rng.integers(2) else None)


def try_paths(rng: np.random.Generator) -> None:
    """A path that turns anywhere, and places on and off it."""
    model = load_bundled_model()
    parts = [
        PathPart(
            rng.normal(0.0, 200.0, (int(rng.integers(2, 9)), 2)),
            str(rng.choice(list(model.types))),
            None if rng.integers(2) else float(rng.uniform(5.0, 900.0)),
            float(rng.choice([0.0, 0.1, 1.0])),
        )
        for _ in range(int(rng.integers(1, 5)))
    ]
    place, ground = PathPlace(plan_route(model, make_path(parts))), np.zeros(3)
    for frame in range(400):
        place.move((odd(rng, (3,)) if frame % 9 == 8 else ground).astype(np.float64))
        ground[:2] += rng.normal(0.0, 10.0, 2) + place.words.trajectory[:2]


def main() -> None:
    folder, rng = Path(sys.argv[1]), np.random.default_rng(7)
    for module in (step_kernel, frame_kernel, attention_kernel, steering_kernel):
        module.load_library = lambda path, name, version: load_library(folder / path.name, name, version)
    np.seterr(all="ignore")
    works = (
        (try_steps, 40),
        (try_poses, 40),
        (try_characters, 3),
        (try_attention, 20),
        (try_steering, 20),
        (try_paths, 20),
    )
    for work, times in works:
        for _ in range(times):
            work(rng)
    print("clean")


if __name__ == "__main__":
    main()
