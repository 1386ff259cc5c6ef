"""The control signals of a recorded sequence: its types, phases and trajectory, asked of a body wherever it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.opening import last_poses
from motionkit.control.recording_choice import frames_behind
from motionkit.control.reference_player import ReferencePlayer
from motionkit.data.dataset import ClipData
from motionkit.features.control import Controls, blend_types, future_trajectory
from motionkit.models.model import MotionModel


class SequenceControls:
    """Asks one character for what a recording does after its first frames; a Controller for a batch of one.

    The trajectory is where the recording lies on the ground, as a path is (paper section 5.2): a body beside it is
    asked back. Types other than gaits are shown reference clips, which go that way as closely as they do in synthesis.
    """

    def __init__(self, model: MotionModel, types: tuple[str, ...], data: ClipData, initial: int) -> None:
        """Take the names of the recording's types, its data, and how many of its frames are given."""
        self.model, self.types, self.data, self.initial = model, types, data, initial
        places = np.array([model.type_id(kind) if kind in model.types else 0 for kind in types])
        self.weights = blend_types(places[data.types], len(model.types))
        # The recording's trajectory says when it rests.
        self.player, self.kind = ReferencePlayer(model, rests=True), ""
        self.near: Array | None = last_poses(model, data.features[:initial])

    @property
    def shown(self) -> list[str]:
        """The recording's types that the model has."""
        return [name for i in np.unique(self.data.types) if (name := self.types[i]) in self.model.types]

    def __call__(self, frame: int, ground: Array) -> Controls:
        at = np.array([min(self.initial + frame, len(self.data.types) - 1)])
        trajectory = future_trajectory(self.data.ground, at, ground)
        kind = self.types[self.data.types[at[0]]]
        if kind not in self.model.types or self.model.kind(kind).steered:
            asked = replace(Controls.of_types(self.weights[at]), trajectory=trajectory)
            return replace(asked, phase=self.data.phases[at]).with_mask(1.0)
        if kind != self.kind:
            self._begin(kind, trajectory[0])
        asked = self.player.play(1, trajectory)
        phase = asked.phase if asked.reference_gain.any() else self.data.phases[at]
        return replace(asked, type_weights=self.weights[at], phase=phase).with_mask(1.0)

    def _begin(self, kind: str, trajectory: Array) -> None:
        """Begin reference clips of a type; the first go on from the frames that were given."""
        behind = 0 if self.near is None else frames_behind(self.model, kind, self.near)
        self.player.begin(kind, self.near, behind, trajectory)
        self.kind, self.near = kind, None
