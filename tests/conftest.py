"""Shared by all tests: workers, a time limit per test, and small motions and files."""

from __future__ import annotations

import os
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat
from motionkit.motion.skeleton import Skeleton, canonical_skeleton
from motionkit.training.options import TrainOptions
from motionkit.training.presets import train_options
from motionkit.training.trainer import train
from motionkit.training.verdict.real import RealMotion
from synthetic_motions import write_clips

HERE = Path(__file__).parent
SECONDS_PER_TEST = 180
SECONDS_PER_SLOW_TEST = 900


# ---- workers (pytest -n) ----

MOST_WORKERS = 8  # each holds torch and the models, up to 1 GB
# Files that take longest go first, so that no worker is left with one of them at the end.
LONG_FILES = (
    "play/test_browser.py",
    "docs/test_blocks.py",
    "play/test_demo.py",
    "training/test_trainer.py",
    "inference/test_determinism.py",
    "export/test_onnx_export.py",
    "view/test_viewer.py",
    "test_without_torch.py",
)


def pytest_configure(config: pytest.Config) -> None:
    """Give each worker one thread of torch and BLAS, since workers share the cores; let Ctrl-C reach the tests.

    A shell starts what it runs in the background with SIGINT ignored, and the commands of tests would inherit that.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if getattr(config.option, "numprocesses", None):
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """The workers of -n auto: one for each core that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, MOST_WORKERS)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give a worker whole files, in which tests share a browser, a server or a model."""
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # which would begin with the files of most tests
    return LoadFileScheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest; the order within files and of the others stays."""
    ranks = {HERE / name: rank for rank, name in enumerate(LONG_FILES)}
    assert all(path.is_file() for path in ranks), "a file of LONG_FILES is not there"
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


# ---- fixtures ----


@pytest.fixture(autouse=True)
def time_limit(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that hangs; SIGALRM interrupts Python loops and blocking calls."""
    if not hasattr(signal, "SIGALRM"):
        yield
        return
    seconds = SECONDS_PER_SLOW_TEST if request.node.get_closest_marker("slow") else SECONDS_PER_TEST

    began, more = time.process_time(), iter(range(3))

    def stop(_: int, frame: FrameType | None) -> None:
        # Where others use the processors too, a test that works may take four times as long.
        if time.process_time() - began < 0.5 * seconds and next(more, None) is not None:
            signal.alarm(seconds)
            return
        # Warn too: a library may catch the error as one of its own and continue.
        where = "".join(traceback.format_stack(frame)[-12:])
        warnings.warn(f"{request.node.nodeid} was stopped after {seconds} s in\n{where}", stacklevel=1)
        raise TimeoutError(f"test ran for more than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture
def broken_folder() -> Path:
    """The folder of small BVH files with one fault each, and the good.bvh they derive from."""
    return HERE / "broken_bvh"


@pytest.fixture
def good_text(broken_folder: Path) -> str:
    """The text of a small BVH file without faults: 3 joints, 12 channels, 3 frames."""
    return (broken_folder / "good.bvh").read_text()


@pytest.fixture
def make_motion() -> Callable[..., Motion]:
    """A function that makes a smooth random motion: make_motion(frames, fps, seed, skeleton, swing)."""

    def make(
        frames: int = 120,
        fps: float = 60.0,
        seed: int = 0,
        skeleton: Skeleton | None = None,
        swing: float = 0.5,
    ) -> Motion:
        skeleton = skeleton or canonical_skeleton()
        random = np.random.default_rng(seed)
        seconds = np.arange(frames)[:, None, None] / fps
        shape = (1, len(skeleton), 3)
        rates = 0.2 + random.random(shape)
        phases = 6.28 * random.random(shape)
        heights = swing * random.standard_normal(shape)
        turns = expmap_to_quat(heights * np.sin(6.28 * rates * seconds + phases))
        places = np.stack(
            [50.0 * seconds[:, 0, 0], 95.0 + np.sin(9.0 * seconds[:, 0, 0]), 0.0 * seconds[:, 0, 0]],
            axis=-1,
        )
        return Motion(skeleton, turns.astype(np.float32), places.astype(np.float32), fps)

    return make


@pytest.fixture(scope="session")
def clips_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of eight small BVH files of six types, with a labels.csv; not to be written to."""
    return write_clips(tmp_path_factory.mktemp("clips"))


@pytest.fixture(scope="session")
def dataset_folder(clips_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset folder made from clips_folder; not to be written to."""
    folder = tmp_path_factory.mktemp("dataset") / "motion"
    preprocess([clips_folder], folder, PreprocessOptions(jobs=1))
    return folder


@pytest.fixture(scope="session")
def dataset(dataset_folder: Path) -> Dataset:
    """The dataset made from clips_folder, opened."""
    return Dataset(dataset_folder)


@pytest.fixture(scope="session")
def real(dataset: Dataset) -> RealMotion:
    """The recordings of the small dataset."""
    return RealMotion(dataset)


@pytest.fixture(scope="session")
def paper_folder(clips_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of clips_folder as the paper's networks take it; not to be written to."""
    folder = tmp_path_factory.mktemp("paper") / "motion"
    options = PreprocessOptions(jobs=1, layout="expmap-root-1", own_bodies=True, smooth=False)
    preprocess([clips_folder], folder, options)
    return folder


@pytest.fixture(scope="session")
def tiny_options() -> Callable[..., TrainOptions]:
    """A function that makes the options of a run of one or two seconds: tiny_options(steps=3, ...)."""

    def make(
        preset: str = "tiny", steps: int | None = 4, minutes: float | None = None, **changes: object
    ) -> TrainOptions:
        values: dict = {
            "batch": 4,
            "warmup": 2,
            "precision": "float32",
            "log_every": 1,
            "score_seconds": 0.0,
            "window": 32,
            "splices": 6,
            "period": 1,  # make windows for one step at a time, so that a run may stop after any step
        }
        return train_options(preset, steps, minutes, **(values | changes))

    return make


@pytest.fixture
def unscored(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs end without roll-outs for gains and scores, which take longer than all else of a short run."""
    monkeypatch.setattr("motionkit.training.outcome.calibrated_gains", lambda *_, **__: {})
    monkeypatch.setattr("motionkit.training.outcome.score_rollouts", lambda *_, **__: ())


@pytest.fixture
def briefly_calibrated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs end with one roll-out of each type at two gains; the whole search takes longer than all else."""
    monkeypatch.setattr("motionkit.training.calibration.REPEATS", 1)
    monkeypatch.setattr("motionkit.training.calibration.GAINS", (1.0, 2.0))


@pytest.fixture(scope="session")
def tiny_model_file(
    dataset_folder: Path,
    tiny_options: Callable[..., TrainOptions],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """A model file after a few steps of the tiny preset; it moves, but badly."""
    path = tmp_path_factory.mktemp("model") / "tiny.safetensors"
    train(dataset_folder, path, tiny_options(steps=20, method="adamw"), device="cpu")
    return path


@pytest.fixture(scope="session")
def tiny_model(tiny_model_file: Path) -> MotionModel:
    """The model in tiny_model_file."""
    return load_model(tiny_model_file)
