"""frame_kernel.c and foot_kernel.c from Python: what is around the network's step, where a C compiler was at hand.

numpy does the same in rollout.py, pose.py and foot_lock.py; the tests hold both together. The kernels read and
write the arrays of those who bind them, which are to stay where they are.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, Structure, byref, c_double, c_float, c_int64, c_void_p, pointer
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference import foot_lock, height_correction, slip_correction
from motionkit.motion import leg_ik
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT, PARENTS, STANDING_HEIGHTS
from motionkit.native import load_library

if TYPE_CHECKING:
    from motionkit.inference.pose import PoseDecoder

VERSION = 13  # of frame_kernel.c


class _Draw(Structure):
    _fields_ = (
        *((n, c_int64) for n in "features contacts yaw xz sixd gaussian_stride logit_stride".split()),
        ("feet", c_int64 * 4),
        ("floor", c_double),
        *((n, c_double * 4) for n in ("reaches", "shares")),
        *((n, c_double) for n in ("ease", "stiffness", "enough", "limit")),
        *(
            (n, c_void_p)
            for n in (
                "mean log_sigma logits scaling_mean scaling_std fresh noise smooth blended "
                "velocity_blend slip_correction before"
            ).split()
        ),
        *((n, c_float) for n in "rho fresh_share smoothing noise_share temperature fps".split()),
        *((n, c_void_p) for n in "x seen denormalised ground".split()),
    )


_FEET_SETTINGS = (leg_ik.LOCK, leg_ik.TOE, leg_ik.HOLD)
_FEET_NUMBERS = (
    *(f.name for settings in _FEET_SETTINGS for f in fields(settings)),
    *("bent", "thigh_share", "alike", "straightening", "backwards", "steep"),
)


_FEET_STATE = (
    "hold carry slip feet moving locked age step anchor shift released toes stands lift drop".split()
)


class _Feet(Structure):
    _fields_ = (
        *((n, c_int64 * 2) for n in ("hip", "knee", "ankle", "toe")),
        *((n, c_float) for n in _FEET_NUMBERS),
        *((n, c_void_p) for n in _FEET_STATE),
    )


class _HeightCorrection(Structure):
    _fields_ = (
        *((n, c_int64 * 4) for n in ("joints", "columns")),
        ("standing", c_float * 4),
        *((n, c_float) for n in "reach pace doubt deepest lift".split()),
        ("rise", c_void_p),
    )


class _Pose(Structure):
    _fields_ = (
        *((n, c_int64) for n in "features root joints height sixd".split()),
        ("parents", c_int64 * JOINT_COUNT),
        ("height_correction", _HeightCorrection),
        *((n, c_void_p) for n in "references offsets scale frame contacts ground".split()),
        *((n, c_void_p) for n in "rotations root_places positions".split()),
        ("feet", POINTER(_Feet)),
    )


@cache
def frame_library() -> ctypes.CDLL | None:
    """The shared library, None where the installation has none that fits."""
    library = load_library(Path(__file__).resolve().parent / "_frame_kernel", "frame_kernel_version", VERSION)
    if library is not None:
        library.draw_frames.argtypes = [POINTER(_Draw), c_int64]
        library.pose_frames.argtypes = [POINTER(_Pose), c_int64]
        library.draw_frames.restype = library.pose_frames.restype = None
    return library


@dataclass(frozen=True, eq=False)
class PredictionArrays:
    """What the network predicts of the next frame: mean and log_sigma (N, 276) normalised, contact logits (N, 4)."""

    mean: Floats
    log_sigma: Floats
    logits: Floats


@dataclass(frozen=True, eq=False)
class NoiseArrays:
    """White noise (N, 276), None without noise, and the states (N, 276) of the two filters it goes through."""

    fresh: Floats | None
    first: Floats
    second: Floats


@dataclass(frozen=True, eq=False)
class BlendArrays:
    """Columns (276,) whose velocity is blended, by what shares (N, 1), slip correction (N, 1), last frame (N, 276)."""

    columns: Floats
    velocity_blend: Floats
    slip_correction: Floats
    before: Floats


@dataclass(frozen=True, eq=False)
class FrameArrays:
    """The frame drawn: x (N, 276) normalised, contacts (N, 4), features (N, 276), ground (N, 3)."""

    x: Floats
    contacts: Floats
    features: Floats
    ground: Floats


@dataclass(frozen=True, eq=False)
class DrawArrays:
    """What RolloutState draws frames with: from the network, constants, and state; rows are characters."""

    prediction: PredictionArrays
    scaling: tuple[Floats, Floats]  # mean and standard deviation (276,)
    noise: NoiseArrays
    blend: BlendArrays
    frame: FrameArrays


def bind_draw(library: ctypes.CDLL, words: Structure, arrays: DrawArrays) -> Callable[[], None]:
    """What draws the next frame of all characters, by the words of draw_words for the same arrays."""
    return _call(library.draw_frames, words, len(arrays.frame.x), arrays)


def draw_words(
    arrays: DrawArrays,
    columns: tuple[int, int, int, NDArray[np.intp]],
    noise: tuple[float, float, float, float, float],
    fps: float,
) -> Structure:
    """How draw_frames is told of the arrays, which it keeps no hold of.

    Args:
        columns: of the root's yaw velocity, of the first of its ground velocities, of its rotation if that is two
            matrix columns, else -1, and of the foot joints (4, 3).
        noise: Noise.filters and the temperature.
    """
    made, filters, frame = arrays.prediction, arrays.noise, tuple(vars(arrays.frame).values())
    strides = [array.strides[0] // 4 for array in (made.mean, made.logits)]
    followed = (filters.first, filters.second, *vars(arrays.blend).values())
    whole = (*arrays.scaling, *followed, *frame)
    assert all(array.flags.c_contiguous and array.dtype == np.float32 for array in whole)
    assert made.log_sigma.strides == made.mean.strides
    *root, feet = columns
    four = c_double * 4
    return _Draw(
        FEATURE_COUNT, CONTACT_COUNT, *root, *strides,
        (c_int64 * 4)(*feet[:, 0].tolist()), slip_correction.FLOOR,
        four(*slip_correction.REACHES), four(*leg_ik.FOOT_SHARES),
        leg_ik.HOLD.ease, slip_correction.STIFFNESS, leg_ik.HOLD.enough, slip_correction.LIMIT,
        *(_address(v) for v in (*vars(made).values(), *arrays.scaling, filters.fresh, *followed)),
        *noise, fps,
        *(_address(v) for v in frame),
    )  # fmt: skip


class PoseKernel:
    """PoseDecoder, BodyKinematics, HeightCorrection and FootLock of N characters in one call."""

    def __init__(
        self,
        library: ctypes.CDLL,
        decoder: PoseDecoder,
        offsets: Floats,
        scale: Floats,
        rises: height_correction.HeightCorrection,
        feet: foot_lock.FootLock | None,
    ) -> None:
        """offsets (N, 23, 3) in cm, scale (N,), rises, and feet, None to leave them alone, are read at each call."""
        count = len(offsets)
        self._library, self._decoder, self._rises, self._feet = library, decoder, rises, feet
        self._bodies = (offsets, scale)
        self._posed = tuple(
            np.zeros((count, *n), np.float32) for n in ((JOINT_COUNT, 4), (3,), (JOINT_COUNT, 3))
        )
        self._frame: tuple[Floats, ...] = ()
        self._run: Callable[[], None] | None = None

    def pose(self, features: Floats, contacts: Floats, ground: Floats) -> tuple[Floats, Floats, Floats]:
        """Rotations (N, 23, 4), root positions (N, 3) and positions (N, 23, 3) of a frame.

        Args:
            features: (N, 276) unnormalised.
            contacts: (N, 4) probabilities.
            ground: (N, 3) root x, z and heading, before scaling.
        """
        frame = (features, contacts, ground)
        if self._run is None or any(a is not b for a, b in zip(frame, self._frame, strict=True)):
            self._frame, self._run = frame, self._bind(frame)
        self._run()
        rotations, root, positions = self._posed
        return rotations.copy(), root.copy(), positions.copy()

    def _bind(self, frame: tuple[Floats, ...]) -> Callable[[], None]:
        arrays = (*self._bodies, *frame, *self._posed)
        words = pose_words(self._decoder, arrays, self._rises, self._feet)
        kept = (self._decoder, arrays, self._rises, self._feet)
        return _call(self._library.pose_frames, words, len(self._posed[0]), kept)


def pose_words(
    decoder: PoseDecoder,
    arrays: tuple[Floats, ...],
    rises: height_correction.HeightCorrection,
    feet: foot_lock.FootLock | None,
) -> Structure:
    """How pose_frames is told of a decoder, of its arrays and of the state of the feet, which it keeps no hold of.

    Args:
        arrays: offsets, scale; features, contacts, ground; rotations, root positions and positions to write, as in
            PoseKernel.
    """
    arrays = (decoder.reference_rotations, *arrays)
    assert all(array.flags.c_contiguous and array.dtype == np.float32 for array in arrays)
    return _Pose(
        FEATURE_COUNT, decoder.root.start, decoder.joints.start, decoder.height, decoder.continuous,
        (c_int64 * JOINT_COUNT)(*PARENTS), _height_correction(rises),
        *(_address(array) for array in arrays),
        None if feet is None else pointer(_feet(feet)),
    )  # fmt: skip


def _height_correction(rises: height_correction.HeightCorrection) -> _HeightCorrection:
    four, f = c_int64 * 4, height_correction
    numbers = (f.REACH, f.PACE, f.DOUBT, f.DEEPEST, f.LIFT, _address(rises.rise))
    joints, columns = four(*FOOT_JOINTS), four(*rises.columns.tolist())
    return _HeightCorrection(joints, columns, (c_float * 4)(*STANDING_HEIGHTS), *numbers)


def _feet(feet: foot_lock.FootLock) -> _Feet:
    numbers = [value for settings in _FEET_SETTINGS for value in vars(settings).values()]
    numbers += [leg_ik.BENT, leg_ik.THIGH_SHARE, leg_ik.ALIKE]
    numbers += [leg_ik.STRAIGHTENING, leg_ik.BACKWARDS, leg_ik.STEEP]
    state = [getattr(feet, name) for name in _FEET_STATE]
    joints = leg_ik.LEG_JOINTS.tolist()
    return _Feet(*((c_int64 * 2)(*pair) for pair in joints), *numbers, *(_address(array) for array in state))


def _call(function: Callable, words: Structure, rows: int, kept: object) -> Callable[[], None]:
    """A call of the library for all rows; what the words point to is kept alive with it."""
    where, count = byref(words), c_int64(rows)

    def call() -> None:
        function(where, count)

    call.keeps = (words, kept)  # type: ignore[attr-defined]
    return call


def _address(array: NDArray | None) -> int | None:
    return None if array is None else array.ctypes.data
