"""Controls for a reference player: of frames of a clip, of a pause, or of a type without recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.control.blending import Crossfade, recorded_poses, recorded_trajectory
from motionkit.features.control import Controls, straight_trajectory
from motionkit.features.reference import PAUSE
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, ReferenceClip, Rhythm

# Share of the recorded trajectory in a requested one; chosen. Recorded feet stand along the recorded trajectory, and
# the root-slip correction (inference/slip_correction.py) follows the feet.
RECORDED_SHARE = 0.5


class ReferenceControls:
    """Makes controls of one type with reference poses, phases and trajectories of the playing recording."""

    def __init__(self, model: MotionModel, recorded_share: float = RECORDED_SHARE) -> None:
        """Take recorded_share, the share of the recorded trajectory in a requested one."""
        self.model, self.recorded_share = model, recorded_share

    def of_clip(
        self,
        kind: str,
        clip: ReferenceClip,
        frames: Array,
        left: Crossfade | None,
        trajectories: Array | None,
    ) -> Controls:
        """Controls (T, ...) at frames (T,) of a clip.

        Args:
            left: cross-fade from the clip before, if any.
            trajectories: (T, 24) requested trajectories, if any.
        """
        reference = recorded_poses(clip, frames)
        if left is not None:
            reference = left.fading(frames, reference, recorded_poses)
        controls = replace(self._with_reference(kind, reference), phase=clip.phases[frames])
        trajectory = self._trajectory(kind, clip, frames, left, trajectories)
        return controls if trajectory is None else replace(controls, trajectory=trajectory).with_mask(1.0)

    def of_pause(self, kind: str, reference: Array, recorded: Array, trajectories: Array | None) -> Controls:
        """Controls (T, ...) of a pause with reference poses (T, 72), recorded and requested trajectories (T, 24)."""
        controls = self._with_reference(kind, reference)
        if trajectories is None and self.model.kind(kind) is not MotionKind.PERFORMANCE:
            return controls
        return replace(controls, trajectory=recorded if trajectories is None else trajectories).with_mask(1.0)

    def of_clock(self, kind: str, at: int, count: int, trajectories: Array | None) -> Controls:
        """Controls (count, ...) of a type without recordings, from frame `at` on, with the phase from a clock."""
        rhythm = rhythm_of(self.model, kind)
        phase = np.full(count, -1.0, np.float32) if rhythm is None else rhythm.phases(at, count)
        free = replace(self._of_type(kind, count), phase=phase)
        velocity = self.model.types[kind].velocity
        if trajectories is None and velocity is not None:
            trajectories = np.tile(straight_trajectory(velocity, self.model.fps), (count, 1))
        return free if trajectories is None else replace(free, trajectory=trajectories).with_mask(1.0)

    def _with_reference(self, kind: str, reference: Array) -> Controls:
        """Controls (T, ...) of a type with reference poses (T, 72), at the type's gain; 0 if the model uses none."""
        free = self._of_type(kind, len(reference))
        gain = self.model.types[kind].preset.reference_gain if self.model.uses_references else 0.0
        return replace(free, reference=reference, reference_gain=free.reference_gain + np.float32(gain))

    def _of_type(self, kind: str, count: int) -> Controls:
        """Controls (count, ...) of a type alone."""
        return Controls.of_types(np.tile(self.model.type_weights(kind), (count, 1)))

    def _trajectory(
        self,
        kind: str,
        clip: ReferenceClip,
        frames: Array,
        left: Crossfade | None,
        trajectories: Array | None,
    ) -> Array | None:
        """Trajectories (T, 24) at frames of a clip; None for none."""
        gait = self.model.kind(kind) is MotionKind.GAIT and self.model.uses_references
        if trajectories is None and not (clip.performed or gait):
            return None
        if trajectories is not None and not self.recorded_share:
            return trajectories
        # Without a request, the recorded trajectory decides on the side of a cartwheel or the speed of a walk.
        recorded = recorded_trajectory(clip, frames)
        if trajectories is not None:
            return lerp(trajectories, recorded, self.recorded_share)
        return recorded if left is None else left.fading(frames, recorded, recorded_trajectory)


def rhythm_of(model: MotionModel, kind: str) -> Rhythm | None:
    """The rhythm of performances, strikes or jumps without recordings; None for types without a phase."""
    length = round(model.phase_seconds(kind) * model.fps)
    return (model.types[kind].rhythm or Rhythm(length, length + PAUSE)) if length else None
