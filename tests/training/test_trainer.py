from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file
from safetensors.torch import save_file

from motionkit.data.dataset import Dataset
from motionkit.errors import DatasetError, ModelError, MotionkitError
from motionkit.models.checkpoint import load_model
from motionkit.training import trainer
from motionkit.training.losses import WEIGHTS
from motionkit.training.options import Stage, TrainOptions
from motionkit.training.presets import train_options
from motionkit.training.processes import resolve_device
from motionkit.training.report import TrainEvent
from motionkit.training.trainer import train

pytestmark = pytest.mark.thorough

TERMS = ("gauss", "smooth", "contact", "fk", "consistency", "trajectory", "total", "gradient")


def log_of(model: Path) -> list[dict]:
    text = (model.with_suffix(".run") / "log.jsonl").read_text()
    return [json.loads(line) for line in text.splitlines()]


def losses_of(model: Path) -> list[dict[str, float]]:
    return [{t: line[t] for t in TERMS} for line in log_of(model) if line["kind"] == "log"]


def weights_of(model: Path) -> dict[str, np.ndarray]:
    return load_model(model).network.arrays


def averages_of(model: Path) -> dict[str, np.ndarray]:
    """The running average in the checkpoint of a run."""
    tensors = load_file(model.with_suffix(".run") / "checkpoint.safetensors")
    return {name[len("average.") :]: value for name, value in tensors.items() if name.startswith("average.")}


def same_weights(a: Path, b: Path) -> bool:
    one, two = weights_of(a), weights_of(b)
    return one.keys() == two.keys() and all(np.array_equal(one[n], two[n]) for n in one)


def stop_after(step: int, how: int = signal.SIGINT):
    """An on_event that sends this process a signal once a step is logged."""

    def on_event(event: TrainEvent) -> None:
        if event.kind == "log" and event.step == step:
            os.kill(os.getpid(), how)

    return on_event


# ---- the run ----


def test_the_loss_falls_and_the_model_file_is_whole(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    path = tmp_path / "m.safetensors"
    result = train(dataset_folder, path, tiny_options(steps=30), device="cpu")
    assert (result.model, result.steps, result.finished) == (path, 30, True)
    totals = [line["total"] for line in losses_of(path)]
    assert sum(totals[-5:]) < 0.9 * sum(totals[:5])
    model = load_model(path)
    assert model.type_names == Dataset(dataset_folder).types
    assert model.card["steps"] == 30 and model.card["options"]["preset"] == "tiny"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.run", "m.safetensors"]
    assert sorted(p.name for p in (tmp_path / "m.run").iterdir()) == ["checkpoint.safetensors", "log.jsonl"]


# Total loss at steps 1, 5 and 10 of the run below, in float32 on a CPU. Other processors and releases of torch sum in
# another order, which changes these by less than 0.1 % over ten steps. A change to the network, its inputs, the losses
# or the windows changes them by more. If it is intended, write the new values here.
GOLDEN = {1: 376.024, 5: 383.395, 10: 274.281}


def test_golden_loss_curve(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path = tmp_path / "m.safetensors"
    # Dropout is off, because torch may change its random stream between releases. All other options are given,
    # so that the curve does not depend on the defaults.
    config = {
        "input_dropout": 0.0, "deep_dropout": 0.0, "spatial_dropout": 0.0, "head_leak": 0.8, "head_momentum": False,
        "control_embedding": 24,
    }  # fmt: skip
    sampler = {
        "window": 32, "balance": 0.75, "phase_weight": 1.0, "splices": 0, "splice_share": 0.0,
        "trajectory_dropout": 0.5, "reference_dropout": 0.35, "reference_gaps": 0.0, "lead_share": 0.5,
        "lead_frames": 30, "noise": 0.05,
    }  # fmt: skip
    weights = {"gauss": 1.0, "smooth": 10.0, "contact": 5.0, "fk": 5.0, "consistency": 1.0, "trajectory": 1.0}
    options = tiny_options(
        steps=10,
        config=config,
        weights=weights,
        method="adamw",
        rate=1e-3,
        outlier=1e9,
        beta_nll=0.0,
        slip_weight=10.0,
        step_weight=0.0,
        share=0.0,
        stages=(),
        **sampler,
    )
    train(dataset_folder, path, options, device="cpu")
    totals = {line["step"]: line["total"] for line in log_of(path)}
    for step, value in GOLDEN.items():
        assert totals[step] == pytest.approx(value, rel=2e-3), step


# The same for the settings that `motionkit train` uses by default: stages, scheduled sampling and spliced transitions.
GOLDEN_SHIPPED = {1: 2758.23, 16: 2370.75, 32: 2268.41}


def test_golden_loss_curve_of_the_shipped_settings(dataset_folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    options = train_options(
        "tptn",
        steps=32,
        batch=5,
        window=24,
        splices=6,
        precision="float32",
        log_every=1,
        score_seconds=0.0,
        config={"input_dropout": 0.0},  # shipped: 0.1; torch may change its random stream between releases
    )
    train(dataset_folder, path, options, device="cpu")
    totals = {line["step"]: line["total"] for line in log_of(path)}
    for step, value in GOLDEN_SHIPPED.items():
        assert totals[step] == pytest.approx(value, rel=2e-3), step


@pytest.mark.usefixtures("briefly_calibrated")
def test_log_lines(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path = tmp_path / "m.safetensors"
    seen: list[TrainEvent] = []
    options = tiny_options(steps=4, log_every=2, score_seconds=0.2)
    train(dataset_folder, path, options, device="cpu", on_event=seen.append)
    lines = log_of(path)
    assert [(line["kind"], line["step"]) for line in lines] == [("log", 2), ("log", 4), ("score", 4)]
    assert set(lines[0]) == {"kind", "step", "seconds", "rate", *TERMS}
    assert set(lines[2]["scores"]) == set(Dataset(dataset_folder).types)
    score = lines[2]["scores"]["walking"]
    assert set(score) == {"type", "joint_speed", "pose_distance", "slide", "height"}
    shown = [e.kind for e in seen if e.kind not in ("note", "stage", "step")]
    assert shown == ["log", "log", "checkpoint", "score"]
    assert load_model(path).card["scores"]["walking"] == score
    samples = sorted(p.name for p in (path.with_suffix(".run") / "samples").iterdir())
    assert "walking-predicted.bvh" in samples and "walking-true.bvh" in samples


def test_the_same_seed_trains_the_same_model(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(dataset_folder, tmp_path / f"{name}.safetensors", tiny_options(seed=seed), device="cpu")
    a, b, c = (tmp_path / f"{name}.safetensors" for name in "abc")
    assert losses_of(a) == losses_of(b) != losses_of(c)
    assert same_weights(a, b)


@pytest.mark.usefixtures("briefly_calibrated")
def test_scoring_does_not_change_the_run(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    plain, scored = tmp_path / "plain.safetensors", tmp_path / "scored.safetensors"
    train(dataset_folder, plain, tiny_options(), device="cpu")
    train(dataset_folder, scored, tiny_options(score_minutes=0.0, score_seconds=0.1), device="cpu")
    assert [line["kind"] for line in log_of(scored)].count("score") > 2
    assert losses_of(plain) == losses_of(scored)
    assert same_weights(plain, scored)


def test_minutes_end_a_run(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    options = tiny_options(steps=None, minutes=0.01, splices=0)
    result = train(dataset_folder, tmp_path / "m.safetensors", options, device="cpu")
    assert result.finished and 0.6 <= result.seconds < 10.0


def test_a_model_in_half_precision(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    for half in (False, True):
        train(dataset_folder, tmp_path / f"{half}.safetensors", tiny_options(half=half), device="cpu")
    whole, small = tmp_path / "False.safetensors", tmp_path / "True.safetensors"
    assert small.stat().st_size < 0.6 * whole.stat().st_size
    for name, value in weights_of(whole).items():
        assert np.allclose(weights_of(small)[name], value, atol=2e-3), name


def test_bfloat16_is_close_to_float32(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    for precision in ("float32", "bfloat16"):
        path = tmp_path / f"{precision}.safetensors"
        train(dataset_folder, path, tiny_options(steps=3, precision=precision), device="cpu")
    a, b = (losses_of(tmp_path / f"{p}.safetensors")[0]["total"] for p in ("float32", "bfloat16"))
    assert a == pytest.approx(b, rel=0.03)


# ---- stopping and resuming ----


def test_a_resumed_run_equals_an_unbroken_one(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    whole, broken = tmp_path / "whole.safetensors", tmp_path / "broken.safetensors"
    train(dataset_folder, whole, tiny_options(steps=6), device="cpu")
    # The learning rate depends on the number of steps, so the broken run gets the same number.
    result = train(dataset_folder, broken, tiny_options(steps=6), device="cpu", on_event=stop_after(3))
    assert (result.steps, result.finished) == (3, False)
    torch.rand(100)  # the resumed process has another random state
    result = train(dataset_folder, broken, tiny_options(steps=6), resume=True, device="cpu")
    assert (result.steps, result.finished) == (6, True)
    assert losses_of(broken) == losses_of(whole)
    assert same_weights(whole, broken)


@pytest.mark.parametrize("stop", [1, 4, 5])
def test_a_run_resumes_within_a_block(dataset_folder: Path, tmp_path: Path, tiny_options, stop: int) -> None:
    """Stages begin within the run, and windows are run on the predictions of the weights at their block's start."""
    stages = (Stage(0.0, {"share": 0.5}), Stage(0.4, {"balance": 0.0, "step_weight": 20.0}))
    options = tiny_options(steps=9, period=3, stages=stages)
    whole, broken = tmp_path / "whole.safetensors", tmp_path / "broken.safetensors"
    train(dataset_folder, whole, options, device="cpu")
    result = train(dataset_folder, broken, options, device="cpu", on_event=stop_after(stop))
    assert (result.steps, result.finished) == (stop, False)
    train(dataset_folder, broken, options, resume=True, device="cpu")
    assert losses_of(broken) == losses_of(whole)
    assert same_weights(whole, broken)


def test_a_finished_run_goes_on_with_another_cycle(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    """Twice the steps in two cycles: the first half, with its stages and blocks, is a run of one cycle."""
    stages = (Stage(0.0, {"share": 0.5}), Stage(0.4, {"balance": 0.0, "step_weight": 20.0}))
    whole, later = tmp_path / "whole.safetensors", tmp_path / "later.safetensors"
    two = tiny_options(steps=10, period=3, stages=stages, cycles=2)
    train(dataset_folder, whole, two, device="cpu")
    train(dataset_folder, later, tiny_options(steps=5, period=3, stages=stages), device="cpu")
    first = averages_of(later)
    train(dataset_folder, later, two, device="cpu", resume=True, on_event=stop_after(7))
    train(dataset_folder, later, two, device="cpu", resume=True)
    assert losses_of(later) == losses_of(whole)
    assert same_weights(whole, later)
    second, made = averages_of(later), weights_of(later)
    for name, value in first.items():
        assert np.allclose(made[name], (value + second[name]) / 2.0, atol=1e-7), name
    assert any(np.abs(value - second[name]).max() > 1e-4 for name, value in first.items())


def test_a_run_can_start_from_a_model(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    train(dataset_folder, first, tiny_options(steps=20, rate=1e-3), device="cpu")
    train(dataset_folder, second, tiny_options(steps=1, rate=1e-6, init=str(first)), device="cpu")
    for name, value in weights_of(first).items():
        assert np.allclose(weights_of(second)[name], value, atol=1e-4), name
    with pytest.raises(ModelError, match="expected the preset the model was trained with"):
        train(dataset_folder, second, tiny_options(steps=1, preset="ebtn", init=str(first)), device="cpu")


def test_step_except_leaves_types_out_of_the_step_loss(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    kinds = Dataset(dataset_folder).types
    path = tmp_path / "m.safetensors"

    def fk_loss(**options) -> float:
        train(dataset_folder, path, tiny_options(steps=1, **options), device="cpu")
        return losses_of(path)[-1]["fk"]

    plain, all_types, none = (
        fk_loss(),
        fk_loss(step_weight=50.0),
        fk_loss(step_weight=50.0, step_except=tuple(kinds)),
    )
    assert none == pytest.approx(plain, rel=1e-6) and all_types > 1.01 * plain
    # Not every type is in the windows of one step.
    one_less = [fk_loss(step_weight=50.0, step_except=(kind,)) for kind in kinds]
    assert all(plain < each <= all_types for each in one_less) and min(one_less) < all_types
    with pytest.raises(DatasetError, match="--step-except: unknown type 'flying'"):
        fk_loss(step_weight=1.0, step_except=("flying",))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_after_a_whole_step(
    dataset_folder: Path, tmp_path: Path, tiny_options, how: int
) -> None:
    """Here the signal comes in the middle of a step, from another thread."""
    path = tmp_path / "m.safetensors"
    before = signal.getsignal(how)
    seen: list[TrainEvent] = []

    def later(event: TrainEvent) -> None:
        seen.append(event)
        if event.kind == "log" and event.step == 2:
            threading.Timer(0.005, os.kill, (os.getpid(), how)).start()

    result = train(dataset_folder, path, tiny_options(steps=100_000), device="cpu", on_event=later)
    assert not result.finished and 2 <= result.steps < 1000
    assert load_model(path).card["steps"] == result.steps
    assert max(e.step for e in seen if e.kind == "log") == result.steps
    assert any("--resume" in e.text for e in seen if e.kind == "note")
    assert signal.getsignal(how) == before, "the earlier handler is restored"


def test_two_signals_at_once_are_one_and_a_later_one_ends_the_run(
    dataset_folder: Path, tmp_path: Path, tiny_options, monkeypatch: pytest.MonkeyPatch
) -> None:
    """timeout signals a process and its group; who presses Ctrl-C again does not want to wait."""
    path = tmp_path / "m.safetensors"

    def twice(event: TrainEvent) -> None:
        if event.kind == "log" and event.step == 2:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)

    assert train(dataset_folder, path, tiny_options(steps=1000), device="cpu", on_event=twice).steps == 2
    monkeypatch.setattr(trainer, "TWICE", -1.0)
    with pytest.raises(KeyboardInterrupt):
        train(dataset_folder, path, tiny_options(steps=1000), device="cpu", on_event=twice)


def test_a_run_stopped_anywhere_resumes_as_if_unbroken(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    whole, broken = tmp_path / "whole.safetensors", tmp_path / "broken.safetensors"
    train(dataset_folder, whole, tiny_options(steps=12), device="cpu")
    for attempt in range(13):
        clocks: list[threading.Timer] = []

        def interrupt(event: TrainEvent, clocks: list = clocks, wait: float = 0.004 * (attempt % 5)) -> None:
            if event.kind == "log" and event.step < 12 and not clocks:
                clocks.append(threading.Timer(wait, os.kill, (os.getpid(), signal.SIGINT)))
                clocks[0].start()

        options = tiny_options(steps=12)
        result = train(dataset_folder, broken, options, resume=attempt > 0, device="cpu", on_event=interrupt)
        assert result.finished == (result.steps == 12)
        if result.finished:
            break
    assert result.finished and attempt > 2
    assert losses_of(broken) == losses_of(whole)
    assert same_weights(whole, broken)


def test_checkpoints_are_written_during_a_run(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    seen: list[TrainEvent] = []
    options = tiny_options(steps=4, checkpoint_seconds=0.0)
    train(dataset_folder, tmp_path / "m.safetensors", options, device="cpu", on_event=seen.append)
    assert [e.step for e in seen if e.kind == "checkpoint"] == [1, 2, 3, 4, 4]


def test_a_finished_run_can_be_continued(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path = tmp_path / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=2), device="cpu")
    result = train(dataset_folder, path, tiny_options(steps=4, log_every=1), resume=True, device="cpu")
    assert result.steps == 4
    assert [line["step"] for line in log_of(path)] == [1, 2, 3, 4]


def test_resuming_with_other_settings_is_refused(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path = tmp_path / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=1), device="cpu")
    with pytest.raises(
        ModelError, match=r"started with optimizer.batch 4 \(now 8\); resume it with the same"
    ):
        train(dataset_folder, path, tiny_options(steps=2, batch=8), resume=True, device="cpu")
    with pytest.raises(ModelError, match=r"started with sampler\.window 32 \(now 48\)"):
        train(dataset_folder, path, tiny_options(steps=2, window=48), resume=True, device="cpu")


def test_resuming_with_other_clips_is_refused(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path = tmp_path / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=1), device="cpu")
    fewer = Dataset(dataset_folder)
    fewer.clips = fewer.clips[1:]
    with pytest.raises(DatasetError, match="other training clips"):
        train(fewer, path, tiny_options(steps=2), resume=True, device="cpu")
    assert train(dataset_folder, path, tiny_options(steps=2), resume=True, device="cpu").steps == 2


def test_no_checkpoint_to_resume_from(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    with pytest.raises(DatasetError, match="no checkpoint to resume from"):
        train(dataset_folder, tmp_path / "m.safetensors", tiny_options(), resume=True, device="cpu")


def damage(path: Path, how: str) -> None:
    data = path.read_bytes()
    if how == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif how == "text":
        path.write_text("not a checkpoint\n" * 100)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "foreign":
        save_file({"x": torch.zeros(2)}, path)
    elif how == "bare":
        save_file({"x": torch.zeros(2)}, path, metadata={"run": '{"format": "motionkit-run-1"}'})
    elif how == "list":
        save_file({"x": torch.zeros(2)}, path, metadata={"run": "[]"})


@pytest.mark.parametrize("how", ["truncated", "text", "empty", "foreign", "bare", "list"])
def test_a_damaged_checkpoint(dataset_folder: Path, tmp_path: Path, tiny_options, how: str) -> None:
    path = tmp_path / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=1, splices=0), device="cpu")
    checkpoint = tmp_path / "m.run" / "checkpoint.safetensors"
    damage(checkpoint, how)
    with pytest.raises(ModelError) as caught:
        train(dataset_folder, path, tiny_options(steps=2, splices=0), resume=True, device="cpu")
    assert str(checkpoint) in str(caught.value) and "\n" not in str(caught.value)


def test_a_checkpoint_of_another_preset(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path = tmp_path / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=1, splices=0), device="cpu")
    with pytest.raises(ModelError, match="started with config"):
        options = tiny_options(steps=2, splices=0, config={"ffn": 64})
        train(dataset_folder, path, options, resume=True, device="cpu")


# ---- settings ----


def test_a_run_needs_steps_or_minutes() -> None:
    with pytest.raises(MotionkitError, match="--steps or --minutes"):
        TrainOptions()


def test_train_options_of_presets() -> None:
    assert train_options("tptn", steps=5).optimizer.rate == 1e-3
    paper = train_options("tptn-paper", steps=5)
    assert (paper.optimizer.rate, paper.optimizer.batch, paper.sampler.window) == (1e-4, 56, 300)
    assert paper.losses.weights == WEIGHTS and paper.losses.beta_nll == 0.0
    assert paper.sampler.splices == 0 and paper.sampler.controls.trajectory_dropout == 0.0
    assert train_options("tptn-paper", steps=5, splices=20, window=64).sampler.splices == 20
    changed = train_options("tiny", minutes=1.0, window=64, splices=3, rate=2e-3, batch=8)
    assert (changed.sampler.window, changed.sampler.splices) == (64, 3)
    assert (changed.optimizer.rate, changed.optimizer.batch, changed.seed) == (2e-3, 8, 0)
    with pytest.raises(TypeError, match="windows"):
        train_options("tiny", steps=1, windows=64)
    with pytest.raises(ModelError, match="preset 'nope' is unknown"):
        train_options("nope", steps=1)


def test_a_preset_of_another_layout_says_how_to_preprocess(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    with pytest.raises(DatasetError, match="run preprocess with --layout expmap-root-1"):
        train(dataset_folder, tmp_path / "m.safetensors", tiny_options(preset="tptn-paper"), device="cpu")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["gpu", "cuda:99", "cuda:x", ""])
def test_missing_devices(name: str) -> None:
    with pytest.raises(MotionkitError, match="device"):
        resolve_device(name)


def test_available_devices() -> None:
    assert resolve_device("cpu") == torch.device("cpu")
    assert resolve_device("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")


def test_the_model_folder_is_made_before_training(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    path = tmp_path / "new" / "folder" / "m.safetensors"
    train(dataset_folder, path, tiny_options(steps=1), run_folder=tmp_path / "run", device="cpu")
    assert path.is_file() and (tmp_path / "run" / "checkpoint.safetensors").is_file()


def test_an_impossible_folder_is_an_error_before_training(
    dataset_folder: Path, tmp_path: Path, tiny_options
) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises((MotionkitError, OSError)):
        train(dataset_folder, tmp_path / "file" / "m.safetensors", tiny_options(steps=10**9), device="cpu")


# ---- several processes ----

PROCESS = """
import sys, torch
from pathlib import Path
from motionkit.training.presets import train_options
from motionkit.training.trainer import train
import os, signal

torch.set_num_threads(1)
dataset, output, steps, dropout, stop, resume = sys.argv[1:]
config = {} if dropout == "on" else {"input_dropout": 0.0, "deep_dropout": 0.0, "spatial_dropout": 0.0}
options = train_options(
    "tiny", steps=int(steps), batch=4, warmup=2, precision="float32", log_every=1,
    score_seconds=0.0, window=32, splices=4, config=config, period=1,
)
def on_event(event):
    if event.kind == "log" and event.step == int(stop):
        os.kill(os.getpid(), signal.SIGTERM)
train(dataset, Path(output), options, resume=resume == "yes", device="cpu", on_event=on_event)
"""


def processes(script: Path, count: int, *words: object) -> None:
    """Run PROCESS in several processes that find each other as under torchrun."""
    script.write_text(PROCESS)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    common = {
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
        "WORLD_SIZE": str(count),
        "OMP_NUM_THREADS": "1",
    }
    running = [
        subprocess.Popen(
            [sys.executable, str(script), *map(str, words)],
            env=os.environ | common | {"RANK": str(rank), "LOCAL_RANK": str(rank)},
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(count)
    ]
    try:
        for process in running:
            errors = process.communicate(timeout=150)[1]
            assert process.returncode == 0, errors
    finally:
        for process in running:
            process.kill()
            process.wait()


def close_losses(a: Path, b: Path, tolerance: float) -> bool:
    one, two = losses_of(a), losses_of(b)
    assert len(one) == len(two) > 0
    return all(
        x[t] == pytest.approx(y[t], rel=tolerance) for x, y in zip(one, two, strict=True) for t in TERMS
    )


def test_two_processes_train_as_one_does(dataset_folder: Path, tmp_path: Path, tiny_options) -> None:
    one, two = tmp_path / "one.safetensors", tmp_path / "two.safetensors"
    processes(tmp_path / "run.py", 2, dataset_folder, two, 5, "off", 0, "no")
    config = {"input_dropout": 0.0, "deep_dropout": 0.0, "spatial_dropout": 0.0}
    train(dataset_folder, one, tiny_options(steps=5, splices=4, config=config), device="cpu")
    assert close_losses(one, two, 1e-3)
    a, b = weights_of(one), weights_of(two)
    for name in a:
        assert np.allclose(a[name], b[name], atol=2e-4), name


@pytest.mark.slow
def test_two_processes_stop_together_and_resume_as_unbroken(dataset_folder: Path, tmp_path: Path) -> None:
    """Dropout differs between the processes and is the same after a resume. One process gets the signal."""
    whole, broken = tmp_path / "whole.safetensors", tmp_path / "broken.safetensors"
    processes(tmp_path / "run.py", 2, dataset_folder, whole, 6, "on", 0, "no")
    processes(tmp_path / "run.py", 2, dataset_folder, broken, 6, "on", 3, "no")
    assert load_model(broken).card["steps"] < 6
    processes(tmp_path / "run.py", 2, dataset_folder, broken, 6, "on", 0, "yes")
    assert close_losses(whole, broken, 1e-5)


@pytest.mark.slow
def test_torchrun_on_the_command(dataset_folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    command = [
        sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2",
        "-m", "motionkit", "train", str(dataset_folder), "-o", str(path), "--preset", "tiny", "--steps", "2",
        "--batch", "4", "--window", "32", "--splices", "2", "--device", "cpu", "--json",
    ]  # fmt: skip
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=os.environ | {"OMP_NUM_THREADS": "1"}
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["steps"] == 2, "only one process prints"
    assert load_model(path).card["steps"] == 2
