"""Live characters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.errors import ControlError
from motionkit.features.control import Controls
from motionkit.inference.character import CharacterFrame, CharacterStream
from motionkit.inference.noise import Noise
from motionkit.models.model import MotionModel
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.skeleton import PARENTS


def asked(model: MotionModel, kinds: list[str]) -> Controls:
    weights = np.eye(len(model.types), dtype=np.float32)[[model.type_id(kind) for kind in kinds]]
    return Controls.of_types(weights)


def frames(stream: CharacterStream, controls: Controls, count: int) -> list[CharacterFrame]:
    return [stream.step(controls) for _ in range(count)]


def stacked(made: list[CharacterFrame], name: str) -> Array:
    return np.stack([getattr(frame, name) for frame in made])


def test_a_frame_is_one_pose_on_the_characters_own_bones(tiny_model: MotionModel) -> None:
    tall = {**tiny_model.characters, "tall": 1.2 * tiny_model.characters["default"]}
    model = replace(tiny_model, characters=tall)
    stream = CharacterStream(model, 3, characters=("default", "tall"))
    offsets = np.stack([model.character(n).offsets for n in ("default", "tall", "default")])
    for frame in frames(stream, asked(model, ["walking", "idle", "running"]), 30):
        shapes = [tuple(getattr(frame, n).shape) for n in ("positions", "rotations", "root_positions")]
        assert shapes == [(3, 23, 3), (3, 23, 4), (3, 3)]
        _, positions = forward_kinematics(frame.rotations, frame.root_positions, offsets, PARENTS)
        assert np.abs(positions - frame.positions).max() < 2e-2
        assert np.abs(np.linalg.norm(frame.rotations, axis=-1) - 1.0).max() < 1e-5
        assert np.allclose(frame.root_positions[:, [0, 2]], frame.ground[:, :2])


def test_it_is_what_synthesize_makes(tiny_model: MotionModel) -> None:
    """Same start, same controls, no noise: the same motion as by the whole-motion call."""
    free = replace(tiny_model, uses_references=False)
    whole = synthesize(free, parse_types("walking:0.5"), SynthesisOptions(ik=False, noise=Noise("mean")))
    stream = CharacterStream(tiny_model, noise=Noise("mean"), ik=False)
    stream.reset(0, type="walking")
    made = frames(stream, asked(tiny_model, ["walking"]), 30)
    motion = whole.motions[0].motion
    assert np.allclose(stacked(made, "root_positions")[:, 0], motion.root_positions, atol=1e-2)
    agree = np.abs((stacked(made, "rotations")[:, 0] * motion.local_rotations).sum(-1))
    assert np.abs(agree - 1.0).max() < 1e-4


@pytest.mark.parametrize(
    ("index", "place", "said"),
    [
        (-1, (0.0, 0.0, 0.0), "from 0 to 1, found -1"),
        (2, (0.0, 0.0, 0.0), "found 2"),
        (0, (np.nan, 0.0, 0.0), "finite"),
    ],
)
def test_a_reset_that_cannot_be_changes_nothing(
    tiny_model: MotionModel, index: int, place: tuple[float, float, float], said: str
) -> None:
    stream = CharacterStream(tiny_model, 2, noise=Noise("mean"), ik=False)
    before = stream.ground
    with pytest.raises(ControlError, match=said):
        stream.reset(index, type="walking", place=place)
    assert np.array_equal(stream.ground, before)


def test_reset_touches_one_character_only(tiny_model: MotionModel) -> None:
    controls = asked(tiny_model, ["walking", "walking"])
    a, b = (CharacterStream(tiny_model, 2, noise=Noise("mean"), ik=False) for _ in range(2))
    for stream in (a, b):
        frames(stream, controls, 9)
    b.reset(0, type="walking", place=(100.0, -50.0, 1.0))
    first, second = frames(a, controls, 20), frames(b, controls, 20)
    assert np.allclose(stacked(first, "positions")[:, 1], stacked(second, "positions")[:, 1], atol=1e-3)
    fresh = CharacterStream(tiny_model, 1, noise=Noise("mean"), ik=False)
    fresh.reset(0, type="walking", place=(100.0, -50.0, 1.0))
    anew = frames(fresh, asked(tiny_model, ["walking"]), 20)
    assert np.allclose(stacked(second, "positions")[:, 0], stacked(anew, "positions")[:, 0], atol=5e-2)
    start = anew[0].ground[0]
    assert float(np.linalg.norm(start[:2] - np.array([100.0, -50.0], np.float32))) < 10.0


def test_a_larger_character_goes_further_in_its_own_world(tiny_model: MotionModel) -> None:
    tall = {**tiny_model.characters, "tall": 1.5 * tiny_model.characters["default"]}
    model = replace(tiny_model, characters=tall)
    stream = CharacterStream(model, 2, noise=Noise("mean"), ik=False, characters=("default", "tall"))
    for index, name in enumerate(("default", "tall")):
        stream.reset(index, name, "walking", (30.0 * (1.0, 1.5)[index], 0.0, 0.0))
    controls = asked(model, ["walking", "walking"])
    trajectory = np.tile(np.linspace(-60.0, 60.0, 24, dtype=np.float32), (2, 1))
    trajectory[1, :12] *= 1.5
    controls = replace(controls, trajectory=trajectory, trajectory_mask=np.ones(2, np.float32))
    for frame in frames(stream, controls, 20):
        assert np.allclose(1.5 * frame.root_positions[0], frame.root_positions[1], atol=0.05)
        assert np.allclose(frame.rotations[0], frame.rotations[1], atol=1e-3)


def test_what_nobody_knows(tiny_model: MotionModel) -> None:
    stream = CharacterStream(tiny_model)
    with pytest.raises(ControlError, match="unknown character 'giant'"):
        stream.reset(0, "giant")
    with pytest.raises(ControlError, match="did you mean 'walking'"):
        stream.reset(0, type="walkin")
    with pytest.raises(ControlError, match="count of at least 1"):
        CharacterStream(tiny_model, 0)


def test_noise_may_be_changed_between_two_frames(tiny_model: MotionModel) -> None:
    streams = [CharacterStream(tiny_model, noise=Noise("mean"), seed=s) for s in (1, 2)]

    def step() -> list[Array]:
        return [stream.step(asked(tiny_model, ["walking"])).positions for stream in streams]

    assert np.array_equal(*step()), "the mean is the mean"
    for stream in streams:
        stream.state.noise = Noise("sample", 1.0)
    step()
    assert not np.array_equal(*step())
