"""Live characters in numpy."""

from __future__ import annotations

from motionkit.inference.character import CharacterStream
from motionkit.inference.rollout import RolloutState
from motionkit.inference.step_weights import pack
from oracle.draw import NumpyDraw
from oracle.pose import NumpyPose
from oracle.step import numpy_step


def draw_in_numpy(state: RolloutState) -> None:
    """Let a state draw its frames in numpy from now on."""
    old = state.drawing
    state.drawing = NumpyDraw(state.model, old.frame, old.presets, old.state, old.noise)


def step_in_numpy(state: RolloutState) -> None:
    """Let a state step its packed network in numpy; it is to be started afterwards."""
    state.network = numpy_step(pack(state.model.network), state.batch)


def pose_in_numpy(stream: CharacterStream) -> None:
    """Let characters be drawn and posed in numpy from now on."""
    draw_in_numpy(stream.state)
    model = stream.model
    stream.poser = NumpyPose(model.config.layout, model.reference_rotations, stream.body)  # type: ignore[assignment]
