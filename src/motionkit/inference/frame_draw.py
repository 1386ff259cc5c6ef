"""Samples the next frame of every character from the network's Gaussians, by draw_frames of frame_kernel.c."""

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
        space: meaning of the normalised features.
        frame, presets, state: arrays that a draw reads and changes.
    """

    def __init__(
        self, model: MotionModel, frame: FrameArrays, presets: PresetArrays, state: NoiseState, noise: Noise
    ) -> None:
        layout, scaling = model.config.layout, model.scaling
        self.space = FrameSpace(layout, model.fps, scaling.mean, scaling.std, blended_columns(layout))
        self.frame, self.presets, self.state = frame, presets, state
        self._noise = noise
        self._network: NetworkStep | TorchStep | None = None  # network of the bound call
        self._call: Callable[[], None] | None = None

    @property
    def noise(self) -> Noise:
        """How frames are drawn; may change between frames."""
        return self._noise

    @noise.setter
    def noise(self, noise: Noise) -> None:
        self._noise, self._network = noise, None

    def draw(self, network: NetworkStep | TorchStep) -> None:
        """Sample the frame that a network has just predicted."""
        network.log_sigma += self.presets.log_noise_scale
        if self._network is not network or self._call is None:
            self._network, self._call = network, self.bind(self.arrays(network))
        if self.noise.kind != "mean":
            self.state.renew()
        self._call()

    def arrays(self, network: NetworkStep | TorchStep) -> DrawArrays:
        """The arrays from which frames of a network are drawn."""
        prediction = Prediction(network.mean, network.log_sigma, network.contact_logits)
        return DrawArrays(prediction, self.space, self.state, self.presets, self.frame)

    def bind(self, arrays: DrawArrays) -> Callable[[], None]:
        """Return a function that draws a frame from the arrays."""
        return bind_draw(arrays, self.noise)

    @property
    def drawn_noise(self) -> Floats:
        """The noise in the present frame (B, 276), in standard deviations of the predicted Gaussians."""
        if self.noise.kind == "mean":
            return np.zeros_like(self.frame.x)
        return self.state.second * np.float32(self.noise.temperature) * np.exp(self.presets.log_noise_scale)
