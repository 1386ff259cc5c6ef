"""Short recordings are repeated: seamlessly, in step, and only where a type goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.data.dataset import Dataset
from motionkit.data.options import PreprocessOptions
from motionkit.data.phases import NO_PHASE
from motionkit.data.preprocess import preprocess
from motionkit.data.repeat import REPEATED_SECONDS, repeat_short_types
from motionkit.features.decode import decode_motion
from motionkit.motion.bvh import write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.skeleton import JOINT_NAMES
from synthetic_motions import make_cartwheel, make_dance, make_idle, make_walk

KNEES = [JOINT_NAMES.index(f"{side}Leg") for side in ("Left", "Right")]


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of one cycle of a walk, half a cycle of another, half a second of standing, a flip, a dance, a walk."""
    folder = tmp_path_factory.mktemp("short")
    clips = {
        "cycle": make_walk(64, turn=0.0),
        "half": make_walk(40, turn=0.0),
        "stands": make_idle(30),
        "wheel": make_cartwheel(100),
        "dance": make_dance(400),
        "long": make_walk(300, speed=90.0),
    }
    for name, motion in clips.items():
        (folder / "clips" / name).mkdir(parents=True)
        write_bvh(folder / "clips" / name / f"{name}.bvh", motion)
    preprocess([folder / "clips"], folder / "data", PreprocessOptions(jobs=1, held_out=()))
    return folder / "data"


def positions(dataset: Dataset, kind: str) -> Array:
    """Joints (T, 23, 3) of the first training clip of a type."""
    clip = next(c for c in dataset.select("train") if dataset.types[int(dataset.clip_types(c)[0])] == kind)
    data = dataset.read(clip)
    references, layout = dataset.reference_rotations, dataset.layout.version
    motion = decode_motion(
        data.features, dataset.skeleton(clip), dataset.fps, data.ground[0], references, layout
    )
    return motion_kinematics(motion)[1]


def test_types_with_few_seconds_go_on(short: Path) -> None:
    before, after = Dataset(short), Dataset(short)
    assert sorted(repeat_short_types(after)) == ["cycle", "half", "stands"], "no flip, and no long dance"
    for kind in ("cycle", "half", "stands"):
        shown, made = positions(before, kind), positions(after, kind)
        assert len(made) == REPEATED_SECONDS * after.fps > 9 * len(shown)
        for order, slack in ((1, 1.3), (2, 2.0)):
            most, usual = (np.linalg.norm(np.diff(p, n=order, axis=0), axis=-1).max() for p in (made, shown))
            assert most < slack * usual + 0.2, (kind, order)
    assert len(Dataset(short).clips) == len(after.clips), (
        "in the place of the short clips, and in memory only"
    )
    clip = next(c for c in after.select("train") if c.name.startswith("cycle "))
    assert (after.read(clip).phases == NO_PHASE).all()


@pytest.mark.parametrize("kind", ["cycle", "half"])
def test_a_repeated_walk_keeps_its_speed_and_both_its_steps(short: Path, kind: str) -> None:
    dataset = Dataset(short)
    shown = positions(dataset, kind)
    repeat_short_types(dataset)
    made = positions(dataset, kind)
    far, seconds = (np.linalg.norm(made[-1, 0, [0, 2]] - made[0, 0, [0, 2]]), len(made) / dataset.fps)
    assert far / seconds == pytest.approx(120.0, rel=0.05)
    ahead = made[:, KNEES, 2] - made[:, :1, 2]
    swings = [int((np.diff(np.sign(side - side.mean())) > 0).sum()) for side in ahead.T]
    assert swings[0] == pytest.approx(seconds, abs=1) and swings[1] == pytest.approx(seconds, abs=1)
    assert np.ptp(ahead[:, 0]) == pytest.approx(np.ptp(ahead[:, 1]), rel=0.1), "no limp"
    assert np.ptp(made[:, 0, 1]) < np.ptp(shown[:, 0, 1]) + 1.0, "and it does not sink"


def test_a_long_recording_of_which_the_mirror_image_trains_is_left_as_it_is(
    short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = Dataset(short)
    mirrored = tuple(clip for clip in dataset.clips if "long" in clip.name and clip.mirrored)
    monkeypatch.setattr(dataset, "clips", mirrored)
    assert len(mirrored) == 1 and repeat_short_types(dataset) == () and dataset.clips == mirrored
