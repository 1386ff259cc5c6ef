"""What every test room shares: a time limit for each test, and small motions and files to work on."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat
from motionkit.motion.skeleton import Skeleton, canonical_skeleton

HERE = Path(__file__).parent
SECONDS_PER_TEST = 60
SECONDS_PER_SLOW_TEST = 900


@pytest.fixture(autouse=True)
def time_limit(request: pytest.FixtureRequest) -> Iterator[None]:
    """A test that hangs fails instead; SIGALRM reaches pure Python loops and blocking calls."""
    if not hasattr(signal, "SIGALRM"):
        yield
        return
    seconds = SECONDS_PER_SLOW_TEST if request.node.get_closest_marker("slow") else SECONDS_PER_TEST

    def stop(*_: object) -> None:
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
    """The folder of small BVH files with one fault each, and one good.bvh they were made from."""
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
        generator = torch.Generator().manual_seed(seed)
        seconds = torch.arange(frames, dtype=torch.float64)[:, None, None] / fps
        shape = (1, len(skeleton), 3)
        rates = 0.2 + torch.rand(shape, generator=generator, dtype=torch.float64)
        phases = 6.28 * torch.rand(shape, generator=generator, dtype=torch.float64)
        heights = swing * torch.randn(shape, generator=generator, dtype=torch.float64)
        turns = expmap_to_quat(heights * torch.sin(6.28 * rates * seconds + phases))
        places = torch.stack(
            [50.0 * seconds[:, 0, 0], 95.0 + torch.sin(9.0 * seconds[:, 0, 0]), 0.0 * seconds[:, 0, 0]],
            dim=-1,
        )
        return Motion(skeleton, turns.float(), places.float(), fps)

    return make
