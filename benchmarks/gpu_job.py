"""Ten minutes of one GPU: the networks of the laboratory and the bundled recipe, on data packed small.

    python benchmarks/gpu_job.py pack datasets/paper datasets/free -o job    # on a machine with the datasets
    python benchmarks/gpu_job.py times job                                   # two minutes: is all as expected?
    python benchmarks/gpu_job.py all job out --minutes 9.5                   # everything, results in out

`all` trains the networks of the paper (`laboratory`), then the bundled recipe (`bundled`) while processors test what
was trained (`tests`). It copies results to the output folder every few seconds, and ends in time whatever is
unfinished.

A packed dataset holds rotations in 16 bits and the path of the root. Features are computed from them again, to within
a twentieth of their deviation. Frames where that fails are packed as they are, such as the first of a clip, whose
velocity comes from the frame before. --device cpu rehearses everything. Tests run on processors, because eleven
processes of them on the GPU made a training fifteen times slower. Beside the windows of the bundled recipe a test takes
50 s on a core of a machine with sixteen.
"""

from __future__ import annotations

import argparse
import json
import lzma
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common import print_table

from motionkit.arrays import Floats
from motionkit.data.dataset import Clip, Dataset
from motionkit.features.encode import encode_motion
from motionkit.lab.paper.datasets import select
from motionkit.lab.paper.runs import Plan, model_file, options_of, run_one
from motionkit.lab.paper.together import stack, train_all, train_together
from motionkit.lab.paper.variants import VARIANTS, variant
from motionkit.models.checkpoint import load_model, save_model
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_to_expmap
from motionkit.training.calibration import calibrated_gains, calibrated_noise, training_judge, with_presets
from motionkit.training.options import with_changes
from motionkit.training.presets import train_options
from motionkit.training.report import TrainEvent
from motionkit.training.trainer import TrainingRun, train

STEPS_OF_ROTATION = 1e-4  # radians
SMALL = ("contacts", "ground", "types", "phases")
PACKED, EXACT = "features.xz", "exact.npz"
MOST_ERROR = 0.05  # of a feature, as a share of its deviation
SPARE_MINUTES = 2.0  # to unpack, to make graphs, and to write models
# Without the LSTM, which torch cannot stack: its five seeds take four times as long as those of any other network.
PAPER_NETWORKS = [each.name for each in VARIANTS if each.preset == "tptn-paper" and each.name != "TP-LSTM4LR"]


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
        rotations = motion.local_rotations
        rotations = np.where(rotations[..., :1] < 0.0, -rotations, rotations)  # 16 bits hold half a turn
        turns[span] = np.round(quat_to_expmap(rotations) / STEPS_OF_ROTATION)
        heights[span] = np.round(motion.root_positions[:, 1:2] * 100.0)
    columns = np.concatenate([turns.reshape(rows, -1), heights], axis=1)
    steps = np.diff(columns, axis=0, prepend=columns[:1] * 0).astype(np.int16).T.copy()
    # High and low bytes apart, column by column: most of the high ones are alike.
    shuffled = steps.view(np.uint8).reshape(*steps.shape, 2).transpose(0, 2, 1).tobytes()
    (output / PACKED).write_bytes(lzma.compress(shuffled, preset=6))
    recorded = np.load(folder / "features.npy")[: len(columns)]
    off = np.abs(_features(output) - recorded) > MOST_ERROR * np.abs(dataset.scaling.std)
    wrong = np.flatnonzero(off.any(axis=1))
    np.savez(output / EXACT, rows=wrong.astype(np.int32), features=recorded[wrong])
    print(f"{output}: {len(wrong)} of {len(columns)} frames as they are", flush=True)


def unpack(job: Path, name: str) -> Path:
    """Write the dataset folder of a packed one of a job, and return it; what is there is kept."""
    folder, output = job / name, job / "unpacked" / name
    if output.exists():
        return output
    output.parent.mkdir(parents=True, exist_ok=True)
    part = output.with_name(f".{output.name}")
    shutil.copytree(folder, part, dirs_exist_ok=True)
    features = _features(folder)
    with np.load(folder / EXACT) as exact:
        features[exact["rows"]] = exact["features"]
    np.save(part / "features.npy", features)
    for name in (PACKED, EXACT):
        (part / name).unlink()
    os.replace(part, output)
    return output


def _features(folder: Path) -> Floats:
    """Return the features (T, 276) of a packed dataset, computed from its rotations and ground."""
    facts = json.loads((folder / "manifest.json").read_text("utf-8"))
    rows = len(np.load(folder / "types.npy"))
    raw = np.frombuffer(lzma.decompress((folder / PACKED).read_bytes()), np.uint8)
    steps = raw.reshape(-1, 2, rows).transpose(0, 2, 1).copy().view(np.int16)[..., 0]
    columns = np.cumsum(steps, axis=1, dtype=np.int16).T.astype(np.float32)
    ground = np.load(folder / "ground.npy")
    features = np.zeros((rows, 276), np.float32)
    with tempfile.TemporaryDirectory() as opened:  # a dataset cannot be opened without features
        for name in (*(f"{each}.npy" for each in SMALL), "manifest.json"):
            shutil.copy(folder / name, opened)
        np.save(Path(opened) / "features.npy", features)
        dataset = Dataset(Path(opened))
        for clip in _recorded(dataset):
            span = slice(clip.start, clip.start + clip.frames)
            turns = columns[span, :-1].reshape(clip.frames, 23, 3) * STEPS_OF_ROTATION
            places = np.stack([ground[span, 0], columns[span, -1] / 100.0, ground[span, 1]], axis=1)
            rotations, places = expmap_to_quat(turns), places.astype(np.float32)
            motion = Motion(dataset.skeleton(clip), rotations, places, facts["fps"])
            version = dataset.layout.version
            features[span] = encode_motion(motion, dataset.reference_rotations, version).features
    return features


def _recorded(dataset: Dataset) -> list[Clip]:
    return [clip for clip in dataset.clips if not clip.mirrored]


# ---- what runs on the GPU ----


def times(job: Path, arguments: argparse.Namespace) -> None:
    """Print milliseconds of a step: the bundled recipe alone, and the laboratory's networks side by side."""
    device = torch.device(arguments.device)
    options = train_options(
        "tptn",
        steps=10_000,
        batch=arguments.batch,
        splices=50,
        stages=(),
        score_seconds=0.0,
        precision=arguments.precision,
    )
    run = TrainingRun(
        Dataset(unpack(job, "free")),
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
        rows.append(
            [f"bundled recipe, {arguments.batch} x 96: {name}", f"{_seconds(work, device, 4) / 16 * 1e3:.2f}"]
        )
        print(rows[-1], flush=True)
    run.blocks.close()
    sets = [[name] for name in arguments.alone]
    works = [(names, arguments.batches[0]) for names in sets]
    for names, batch in works + [(arguments.names, batch) for batch in arguments.batches]:
        try:
            seconds = _together(job, arguments, names, batch, arguments.steps)
        except RuntimeError as error:
            traceback.print_exc(limit=-4)
            print(f"{', '.join(names)}: {error}", flush=True)
            continue
        what = ", ".join(names) if len(names) == 1 else f"{len(names)} networks"
        what = f"{what}, {arguments.seeds} seeds, {batch} windows each"
        rows.append([what, f"{2e3 * seconds / arguments.steps:.2f}"])
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
    job: Path, arguments: argparse.Namespace, names: Sequence[str], batch: int, steps: int
) -> float:
    """Train networks side by side, and return the seconds of the second half of their steps."""
    device = torch.device(arguments.device)
    dataset = select(unpack(job, "paper"), "D_L")
    stacks = []
    for each in map(variant, names):
        options = options_of(Plan(job, budget="long", steps=steps), each, 0)
        options = with_changes(options, {"batch": batch, "precision": arguments.precision})
        stacks.append(stack(dataset, [replace(options, seed=i) for i in range(arguments.seeds)], device))
    ticks = {0.0: time.perf_counter()}

    def progress(share: float) -> None:
        ticks[share] = time.perf_counter()

    train_together(dataset, stacks, device, progress)
    return ticks[1.0] - ticks[0.5]


def laboratory(job: Path, arguments: argparse.Namespace) -> None:
    """Train the paper's networks with all seeds together, and note what is to be tested."""
    plan = _plan(job, arguments.selection, arguments.device, arguments.steps)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    tasks = [(variant(name), seed) for seed in seeds for name in arguments.names]
    made = train_all(plan, tasks, print, lambda share: None, arguments.minutes)
    facts = {"selection": made.selection, "steps": made.steps, "tasks": [[v.name, seed] for v, seed in tasks]}
    with (job / "trained.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(facts) + "\n")
    print(f"{made.folder}: {made.steps} steps", flush=True)


def _plan(job: Path, selection: str, device: str, steps: int | None = None) -> Plan:
    data = unpack(job, "paper")
    return Plan(data, selection, "long", steps, job / "results", job / "models", 120, device)


def tests(job: Path, arguments: argparse.Namespace) -> None:
    """Test all that the laboratory has trained, in processes of their own."""
    lines = [json.loads(line) for line in (job / "trained.jsonl").read_text("utf-8").splitlines()]
    works = [
        (_plan(job, line["selection"], arguments.device, line["steps"]), name, seed)
        for line in lines
        for name, seed in line["tasks"]
    ]
    with ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("spawn")) as pool:
        made = [pool.submit(_tested, *work) for work in works]
        for number, each in enumerate(as_completed(made), 1):
            fault = each.exception()
            print(f"{number} of {len(works)}: {fault or each.result()}", flush=True)


def _tested(plan: Plan, name: str, seed: int) -> str:
    """Test a network, and return its first loss beside that on a processor, which differs by dropout alone."""
    file = run_one(plan, variant(name), seed, lambda text: None, lambda share: None, trained=True)
    log = model_file(plan, variant(name), seed).with_suffix(".run") / "log.jsonl"
    loss = json.loads(log.read_text("utf-8").splitlines()[0])["total"]
    dataset, device = select(plan.data, plan.selection), torch.device("cpu")
    options = with_changes(options_of(replace(plan, steps=1), variant(name), seed), {"precision": "float32"})
    alone = stack(dataset, [options], device)
    train_together(dataset, [alone], device, lambda share: None)
    return f"{file}: first loss {loss:.1f}, on a processor {float(alone.log[0][2]['total']):.1f}"


def bundled(job: Path, arguments: argparse.Namespace) -> None:
    """Train the bundled recipe from random weights; `calibrate` finishes the model, on any machine."""
    options = train_options(
        "tptn",
        minutes=arguments.minutes,
        batch=arguments.batch,
        precision=arguments.precision,
        splices=arguments.splices,
        half=True,
        score_seconds=0.0,
        checkpoint_seconds=1e9,
        log_every=50,
    )

    def said(event: TrainEvent) -> None:
        while arguments.after and event.text.endswith("spliced transitions") and not arguments.after.exists():
            time.sleep(0.2)
        if event.kind == "note" or (event.kind == "log" and event.step % 1000 == 0):
            print(event.kind, event.step, round(event.seconds), event.text or event.losses, flush=True)

    data = unpack(job, "free")
    train(data, job / "bundled.safetensors", options, device=arguments.device, on_event=said)


def calibrate(job: Path, arguments: argparse.Namespace) -> None:
    """Add the sampling presets, which take processors minutes, to what `bundled` wrote."""
    judge, frames = training_judge(Dataset(unpack(job, "free"))), 300
    path = job / "bundled.safetensors"
    model = load_model(path)
    model = with_presets(model, "reference_gain", calibrated_gains(model, judge, frames))
    model = with_presets(model, "noise_alone", calibrated_noise(model, judge, frames))
    save_model(path, model, half=True)


def run_all(job: Path, arguments: argparse.Namespace) -> None:
    """Do everything within the given minutes, and keep copying what is there to the output folder."""
    end = time.monotonic() + 60.0 * arguments.minutes
    output, ready = arguments.output, job / "ready"
    output.mkdir(parents=True, exist_ok=True)
    ready.unlink(missing_ok=True)
    for name in ("paper", "free"):
        unpack(job, name)
    more = ["--device", arguments.device, "--seeds", str(arguments.seeds), "--names", *arguments.names]

    def begin(name: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, __file__, name, str(job), *words]
        print(f"{arguments.minutes - (end - time.monotonic()) / 60.0:.1f} min: {name}", flush=True)
        return subprocess.Popen(command, stdout=(output / f"{name}.txt").open("ab"), stderr=subprocess.STDOUT)

    for_bundled = arguments.minutes - arguments.laboratory - SPARE_MINUTES
    options = ["--minutes", str(for_bundled), "--splices", "2000", "--after", str(ready)]
    bundled_run = begin("bundled", *options, *more[:2])
    lasts = ("--steps", str(arguments.steps)) if arguments.steps else ("--minutes", str(arguments.laboratory))
    made = begin("laboratory", "D_L", *lasts, "--first-seed", str(arguments.first_seed), *more)
    _wait(made, end, job, output)
    ready.touch()
    tested = begin("tests", "--device", "cpu", "--jobs", str(max(1, (os.cpu_count() or 2) // 2)))
    for process in (bundled_run, tested):
        _wait(process, end, job, output)
    for process in (bundled_run, made, tested):
        process.send_signal(signal.SIGTERM)  # a training writes its model then
    for process in (bundled_run, made, tested):
        process.wait()
    _copy(job, output)


def _wait(process: subprocess.Popen[bytes], end: float, job: Path, output: Path) -> None:
    """Wait for a process until a time, and copy results meanwhile."""
    while process.poll() is None and time.monotonic() < end:
        time.sleep(5.0)
        _copy(job, output)


def _copy(job: Path, output: Path) -> None:
    """Copy results, models and logs to the output folder; each file there is whole at any time."""
    part = output / ".part"
    with tarfile.open(part, "w:gz") as archive:
        for path in sorted([*job.glob("results/*/*/*.json"), *job.glob("models/*/*/*.run/log.jsonl")]):
            archive.add(path, path.relative_to(job))
        archive.add(job / "trained.jsonl", "trained.jsonl") if (job / "trained.jsonl").exists() else None
    os.replace(part, output / "results.tar.gz")
    for path in (job / "bundled.safetensors", job / "bundled.run" / "log.jsonl"):
        if path.exists():
            shutil.copy(path, part)
            os.replace(part, output / f"bundled{path.suffix}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    packing = commands.add_parser("pack")
    packing.add_argument("paper", type=Path)
    packing.add_argument("free", type=Path)
    packing.add_argument("-o", "--output", type=Path, required=True)
    works = {
        "all": run_all,
        "times": times,
        "laboratory": laboratory,
        "tests": tests,
        "bundled": bundled,
        "calibrate": calibrate,
    }
    made = {name: commands.add_parser(name) for name in works}
    for name, each in made.items():
        each.set_defaults(run=works[name])
        each.add_argument("job", type=Path)
        each.add_argument("--device", default="cuda")
        each.add_argument("--precision", default="float32")
        each.add_argument("--seeds", type=int, default=5)
        each.add_argument("--names", nargs="+", default=PAPER_NETWORKS)
    made["times"].add_argument("--steps", type=int, default=40)
    made["times"].add_argument("--batches", type=int, nargs="+", default=[4])
    made["times"].add_argument("--alone", nargs="+", default=["TPTN"], help="networks to time alone")
    made["laboratory"].add_argument("selection")
    made["tests"].add_argument("--jobs", type=int, default=12)
    for name in ("times", "bundled"):
        made[name].add_argument("--batch", type=int, default=32)
    made["bundled"].add_argument("--splices", type=int, help="2000, in proportion fewer below 30 minutes")
    made["bundled"].add_argument("--after", type=Path, help="train once this file is there")
    made["all"].add_argument("output", type=Path)
    made["all"].add_argument("--laboratory", type=float, default=4.0, help="minutes of its training")
    for name in ("all", "laboratory"):
        made[name].add_argument("--first-seed", type=int, default=0)
        made[name].add_argument("--steps", type=int, help="of the laboratory, in place of minutes")
    for name in ("all", "laboratory", "bundled"):
        made[name].add_argument("--minutes", type=float, required=name != "laboratory")
    arguments = parser.parse_args()
    if arguments.command == "pack":
        pack(arguments.paper, arguments.output / "paper")
        pack(arguments.free, arguments.output / "free")
    else:
        arguments.run(arguments.job, arguments)


if __name__ == "__main__":
    main()
