"""The network's Gaussians -> the next frame of every character, by draw_frames of frame_kernel.c."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motionkit.arrays import Floats
from motionkit.inference.frame_arrays import FrameArrays, PresetArrays
from motionkit.inference.frame_kernel import DrawArrays, FrameSpace, Prediction, bind_draw, blended_columns
from motionkit.inference.noise import Noise, NoiseState
from motionkit.inference.step import NetworkStep
from motionkit.inference.stepping import TorchStep
from motionkit.models.model import MotionModel


class FrameDraw:
    """Draws the next frames of B characters in place.

    Attributes:
        space: what the model's features mean.
        frame, presets, state: what is read and changed.
    """

    def __init__(
        self, model: MotionModel, frame: FrameArrays, presets: PresetArrays, state: NoiseState, noise: Noise
    ) -> None:
        layout, scaling = model.config.layout, model.scaling
        self.space = FrameSpace(layout, model.fps, scaling.mean, scaling.std, blended_columns(layout))
        self.frame, self.presets, self.state = frame, presets, state
        self._noise = noise
        self._network: NetworkStep | TorchStep | None = None  # that the call is bound to
        self._call: Callable[[], None] | None = None

    @property
    def noise(self) -> Noise:
        """How frames are drawn; may be changed between any two."""
        return self._noise

    @noise.setter
    def noise(self, noise: Noise) -> None:
        self._noise, self._network = noise, None

    def draw(self, network: NetworkStep | TorchStep) -> None:
        """Draw the frame that a network has just predicted."""
        network.log_sigma += self.presets.log_noise_scale
        if self._network is not network or self._call is None:
            self._network, self._call = network, self.bind(self.arrays(network))
        if self.noise.kind != "mean":
            self.state.renew()
        self._call()

    def arrays(self, network: NetworkStep | TorchStep) -> DrawArrays:
        """All that frames of a network are drawn from."""
        prediction = Prediction(network.mean, network.log_sigma, network.contact_logits)
        return DrawArrays(prediction, self.space, self.state, self.presets, self.frame)

    def bind(self, arrays: DrawArrays) -> Callable[[], None]:
        """What draws a frame from the arrays."""
        return bind_draw(arrays, self.noise)

    @property
    def drawn_noise(self) -> Floats:
        """The noise in the present frame (B, 276), in standard deviations of the predicted Gaussians."""
        if self.noise.kind == "mean":
            return np.zeros_like(self.frame.x)
        return self.state.second * np.float32(self.noise.temperature) * np.exp(self.presets.log_noise_scale)
