"""Ten minutes of one GPU: the networks of the laboratory and the bundled recipe, on data packed small.

    python benchmarks/gpu_job.py pack datasets/paper datasets/free -o job      # on a machine with the datasets
    python benchmarks/gpu_job.py times job                                     # a minute: is all as expected?
    python benchmarks/gpu_job.py laboratory job -o results --steps 3000 --seeds 5
    python benchmarks/gpu_job.py bundled job -o results --minutes 4

A packed dataset holds rotations in 16 bits and the path of the root; features are computed from them again, to within
a thousandth of their deviation. --device cpu rehearses everything.
"""

from __future__ import annotations

import argparse
import json
import lzma
import os
import shutil
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common import print_table

from motionkit.data.dataset import Clip, Dataset
from motionkit.features.encode import encode_motion
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_to_expmap

STEPS_OF_ROTATION = 1e-4  # radians
SMALL = ("contacts", "ground", "types", "phases")
PACKED = "features.xz"


def pack(folder: Path, output: Path) -> None:
    """Write a dataset folder without its features, from which they can be computed again."""
    dataset = Dataset(folder)
    output.mkdir(parents=True)
    for name in (*SMALL, "manifest"):
        suffix = ".json" if name == "manifest" else ".npy"
        shutil.copy(folder / f"{name}{suffix}", output)
    rows = max(clip.start + clip.frames for clip in dataset.clips)
    turns = np.zeros((rows, 23, 3), np.int16)
    heights = np.zeros((rows, 1), np.int16)
    for clip in _recorded(dataset):
        motion = dataset.motion(clip, dataset.read(clip))
        span = slice(clip.start, clip.start + clip.frames)
        turns[span] = np.round(quat_to_expmap(motion.local_rotations) / STEPS_OF_ROTATION)
        heights[span] = np.round(motion.root_positions[:, 1:2] * 100.0)
    columns = np.concatenate([turns.reshape(rows, -1), heights], axis=1)
    steps = np.diff(columns, axis=0, prepend=columns[:1] * 0).astype(np.int16).T.copy()
    # High and low bytes apart, column by column: most of the high ones are alike.
    shuffled = steps.view(np.uint8).reshape(*steps.shape, 2).transpose(0, 2, 1).tobytes()
    (output / PACKED).write_bytes(lzma.compress(shuffled, preset=6))


def unpack(folder: Path, output: Path) -> Path:
    """Write the dataset folder of a packed one, and return it; what is there is kept."""
    if output.exists():
        return output
    part = output.with_name(f".{output.name}")
    shutil.copytree(folder, part, dirs_exist_ok=True)
    facts = json.loads((folder / "manifest.json").read_text("utf-8"))
    rows = len(np.load(folder / "types.npy"))
    np.save(part / "features.npy", np.zeros((rows, 276), np.float32))
    dataset = Dataset(part)
    raw = np.frombuffer(lzma.decompress((folder / PACKED).read_bytes()), np.uint8)
    steps = raw.reshape(-1, 2, rows).transpose(0, 2, 1).copy().view(np.int16)[..., 0]
    columns = np.cumsum(steps, axis=1, dtype=np.int16).T.astype(np.float32)
    ground = np.load(folder / "ground.npy")
    features = np.zeros((rows, 276), np.float32)
    for clip in _recorded(dataset):
        span = slice(clip.start, clip.start + clip.frames)
        turns = columns[span, :-1].reshape(clip.frames, 23, 3) * STEPS_OF_ROTATION
        places = np.stack([ground[span, 0], columns[span, -1] / 100.0, ground[span, 1]], axis=1)
        motion = Motion(
            dataset.skeleton(clip), expmap_to_quat(turns), places.astype(np.float32), facts["fps"]
        )
        encoded = encode_motion(motion, dataset.reference_rotations, dataset.layout.version, ground[span, 2])
        features[span] = encoded.features
    np.save(part / "features.npy", features)
    (part / PACKED).unlink()
    os.replace(part, output)
    return output


def _recorded(dataset: Dataset) -> list[Clip]:
    return [clip for clip in dataset.clips if not clip.mirrored]


# ---- what runs on the GPU ----


def times(job: Path, arguments: argparse.Namespace) -> None:
    """Print milliseconds of a step: the bundled recipe alone, and the laboratory's networks side by side."""
    from motionkit.training.presets import train_options
    from motionkit.training.trainer import TrainingRun

    device = torch.device(arguments.device)
    options = train_options("tptn", steps=10_000, batch=32, splices=50, stages=(), score_seconds=0.0)
    run = TrainingRun(
        Dataset(unpack(job / "free", job / "unpacked-free")),
        job / "m.safetensors",
        options,
        device=str(device),
    )
    run.sampler.make_splices()
    run.learner.module.train()
    block = [run.blocks.next(step, 0.0) for step in range(16)]
    rows = []
    for name, work in (
        ("a block of 16 batches", lambda: [run.blocks.next(16 + step, 0.0) for step in range(16)]),
        ("16 steps", lambda: [run.learner.step(each, run.blocks.options, run.progress) for each in block]),
    ):
        work()
        rows.append([f"bundled recipe, 32 x 96: {name}", f"{_seconds(work, device, 4) / 16 * 1e3:.2f}"])
        print(rows[-1], flush=True)
    run.blocks.close()
    sets = [[name] for name in arguments.alone]
    works = [(names, arguments.batches[0]) for names in sets]
    for names, batch in works + [(arguments.names, batch) for batch in arguments.batches]:
        try:
            seconds = _together(job, arguments, names, batch, arguments.steps)[0]
        except RuntimeError as error:
            traceback.print_exc(limit=-4)
            print(f"{', '.join(names)}: {error}", flush=True)
            continue
        what = ", ".join(names) if len(names) == 1 else f"{len(names)} networks"
        what = f"{what}, {arguments.seeds} seeds, {batch} windows each"
        rows.append([what, f"{seconds / arguments.steps * 1e3:.2f}"])
        print(rows[-1], flush=True)
    print_table(f"ms per step, {_machine(device)}", ["what", "ms"], rows)


def _seconds(work: Any, device: torch.device, repeats: int) -> float:
    began = time.perf_counter()
    for _ in range(repeats):
        work()
    if device.type == "cuda":
        torch.cuda.synchronize()
    return (time.perf_counter() - began) / repeats


def _machine(device: torch.device) -> str:
    return torch.cuda.get_device_name() if device.type == "cuda" else "CPU"


def _together(
    job: Path, arguments: argparse.Namespace, names: Any, batch: int, steps: int
) -> tuple[float, dict[str, Any], Dataset]:
    """Train networks side by side; return the seconds after the first step, the stacks and the dataset."""
    from motionkit.lab.paper.datasets import select
    from motionkit.lab.paper.together import stack, train_together
    from motionkit.lab.paper.variants import variant
    from motionkit.training.presets import train_options

    device = torch.device(arguments.device)
    dataset = select(unpack(job / "paper", job / "unpacked-paper"), "D_L")
    seeds = list(range(arguments.seeds))
    stacks = {}
    for name in names:
        each = variant(name)
        options = [
            train_options(
                each.preset,
                steps=steps,
                budget="long",
                config=dict(each.config),
                seed=seed,
                batch=batch,
                **each.options,
            )
            for seed in seeds
        ]
        stacks[name] = stack(dataset, options, device)
    began: list[float] = []

    def progress(share: float) -> None:
        began.append(time.perf_counter())

    train_together(dataset, stacks, seeds, device, progress)
    if device.type == "cuda":
        torch.cuda.synchronize()
    return (time.perf_counter() - began[0]) * steps / max(1, steps - 10), stacks, dataset


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    packing = commands.add_parser("pack")
    packing.add_argument("paper", type=Path)
    packing.add_argument("free", type=Path)
    packing.add_argument("-o", "--output", type=Path, required=True)
    timing = commands.add_parser("times")
    timing.add_argument("job", type=Path)
    timing.add_argument("--device", default="cuda")
    timing.add_argument("--seeds", type=int, default=5)
    timing.add_argument("--steps", type=int, default=40)
    timing.add_argument("--batches", type=int, nargs="+", default=[4, 16])
    timing.add_argument("--names", nargs="+", default=["TPTN", "EBTN"], help="networks to time side by side")
    timing.add_argument("--alone", nargs="+", default=["TPTN"], help="networks to time alone")
    arguments = parser.parse_args()
    if arguments.command == "pack":
        pack(arguments.paper, arguments.output / "paper")
        pack(arguments.free, arguments.output / "free")
    else:
        times(arguments.job, arguments)


if __name__ == "__main__":
    main()
