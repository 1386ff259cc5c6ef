from __future__ import annotations

import numpy as np
import pytest

from motionkit.control.blending import Pause
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.data.splice import HEAD, TAIL, splice_clips
from motionkit.features.decode import decode_motion
from motionkit.features.reference import PAUSE, REFERENCE_OFFSETS
from motionkit.models.motion_type import ReferenceClip
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.skeleton import FOOT_JOINTS


def clip_of(dataset: Dataset, name: str, mirrored: bool = False) -> Clip:
    return next(c for c in dataset.clips if name in c.name and c.mirrored == mirrored)


def splice(
    dataset: Dataset, first: str, second: str, seed: int = 0, mirrored: bool = False, pause: int = 0
) -> ClipData:
    a, b = clip_of(dataset, first), clip_of(dataset, second, mirrored)
    pick = np.random.default_rng(seed).integers
    return splice_clips(dataset, (a, 0, a.frames), (b, 0, b.frames), 30, pick, pause)


@pytest.mark.parametrize(
    ("first", "second", "pause", "faster", "harder"),
    [
        ("walk_02", "wheel_01", 0, 1.001, 1.95),
        ("idle_01", "run_01", 0, 1.07, 3.1),
        ("hop_left", "hop_left", 0, 1.001, 1.18),
        ("wheel_01", "wheel_01", PAUSE, 1.001, 1.67),
    ],
)
def test_the_joined_motion_is_smooth(
    dataset: Dataset, first: str, second: str, pause: int, faster: float, harder: float
) -> None:
    """Joints are at most so many times as fast, and accelerate so many times as hard, as in the two clips."""
    data = splice(dataset, first, second, pause=pause)
    motion = decode_motion(
        data.features, dataset.skeleton(dataset.clips[0]), 60.0, data.ground[0], dataset.reference_rotations
    )
    positions = motion_kinematics(motion)[1]
    honest = []
    for name in (first, second):
        clip = clip_of(dataset, name)
        own = dataset.read(clip)
        honest.append(
            motion_kinematics(
                decode_motion(
                    own.features, dataset.skeleton(clip), 60.0, own.ground[0], dataset.reference_rotations
                )
            )[1]
        )
    for order, most in ((1, faster), (2, harder)):
        made = np.linalg.norm(np.diff(positions, n=order, axis=0), axis=-1).max()
        real = max(float(np.linalg.norm(np.diff(p, n=order, axis=0), axis=-1).max()) for p in honest)
        assert float(made) < most * real


def test_types_change_at_the_join(dataset: Dataset) -> None:
    data = splice(dataset, "walk_02", "wheel_01")
    walking, cartwheel = dataset.types.index("walking"), dataset.types.index("cartwheel")
    assert set(data.types.tolist()) == {walking, cartwheel}
    assert int((np.diff(data.types) != 0).sum()) == 1
    assert int(data.types[0]) == walking and int(data.types[-1]) == cartwheel


def test_a_pause_shows_what_players_ask_for(dataset: Dataset) -> None:
    """Between two performances: reference poses as the player leads them, no phase, and no way of its own."""
    data = splice(dataset, "wheel_01", "wheel_01", pause=PAUSE)
    clip = clip_of(dataset, "wheel_01")
    whole = dataset.read(clip)
    poses = np.pad(
        dataset.pose_embedding.of(whole.features), ((0, REFERENCE_OFFSETS[-1]), (0, 0)), mode="edge"
    )
    played = ReferenceClip(poses, whole.ground, whole.phases)
    asked, _, ended = Pause(played, played, 0).next(PAUSE)
    assert ended
    begin = TAIL + 1
    paused = slice(begin, begin + PAUSE)
    assert np.allclose(data.reference[paused], asked, atol=3e-6)
    assert (data.phases[paused] == -1.0).all()
    assert np.array_equal(data.phases[paused.stop : paused.stop + 20], whole.phases[:20])
    assert data.phases[begin - 1] == whole.phases[-1]
    assert np.array_equal(data.ground[paused, :2], np.repeat(whole.ground[-1:, :2], PAUSE, axis=0))


def test_after_a_pause_the_body_speeds_up_evenly(dataset: Dataset) -> None:
    """From a stand to the 5 cm a frame of the run, by as much at every frame."""
    data = splice(dataset, "idle_01", "run_01", pause=PAUSE)
    steps = np.linalg.norm(np.diff(data.ground[TAIL + 1 : TAIL + PAUSE + 2, :2], axis=0), axis=-1)
    assert np.allclose(np.diff(steps)[:-1], 5.0 / PAUSE, atol=0.005)
    assert steps[0] == pytest.approx(0.5, abs=0.01) and steps[-1] == pytest.approx(5.0, abs=0.06)


def test_lengths_agree_and_are_bounded(dataset: Dataset) -> None:
    data = splice(dataset, "walk_02", "wheel_01")
    frames = len(data.types)
    assert all(len(v) == frames for v in (data.features, data.contacts, data.ground))
    assert frames == TAIL + HEAD


def test_a_mirrored_clip_can_follow(dataset: Dataset) -> None:
    data = splice(dataset, "hop_left", "hop_left", mirrored=True)
    names = [dataset.types[i] for i in np.unique(data.types).tolist()]
    assert sorted(names) == ["jumping-l", "jumping-r"]


def test_the_same_seed_makes_the_same_splice(dataset: Dataset) -> None:
    a, b = splice(dataset, "walk_02", "run_01", 3), splice(dataset, "walk_02", "run_01", 3)
    assert np.array_equal(a.features, b.features) and np.array_equal(a.ground, b.ground)


@pytest.mark.parametrize(("frames", "joined"), [(12, 21), (16, 19), (24, 32)])
def test_short_stretches_can_be_joined(dataset: Dataset, frames: int, joined: int) -> None:
    a, b = clip_of(dataset, "walk_02"), clip_of(dataset, "idle_01")
    pick = np.random.default_rng(0).integers
    data = splice_clips(dataset, (a, 50, 50 + frames), (b, 10, 10 + frames), 20, pick)
    assert np.isfinite(data.features).all()
    assert len(data.types) == joined


def test_feet_do_not_slide_into_their_new_places(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """From a wide stride to a stand: feet in contact stay or step, where they slid without locks."""

    def slid() -> float:
        """Mean speed in cm a frame of toes labelled as in contact, in the half second after the join."""
        found = []
        for seed in range(4):
            data = splice(dataset, "walk_02", "idle_01", seed)
            motion = decode_motion(
                data.features, dataset.skeleton(dataset.clips[0]), 60.0, data.ground[0], dataset.reference_rotations
            )  # fmt: skip
            join = int((np.diff(data.types) != 0).argmax()) + 1
            toes = motion_kinematics(motion)[1][join : join + 30, [FOOT_JOINTS[1], FOOT_JOINTS[3]]][
                ..., [0, 2]
            ]
            steps = np.linalg.norm(np.diff(toes, axis=0), axis=-1)
            found.append(float((steps * data.contacts[join + 1 : join + 30, 1::2]).mean()))
        return float(np.mean(found))

    planted = slid()
    monkeypatch.setattr("motionkit.data.splice.lock_feet", lambda motion, contacts: motion)
    assert planted < 0.35 * slid()
