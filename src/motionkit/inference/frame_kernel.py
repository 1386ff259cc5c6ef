"""Python bindings of frame_kernel.c and foot_kernel.c: sampling, root corrections, kinematics and foot locking.

The kernels keep the addresses of their arrays, so the arrays must not move in memory.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, Structure, byref, c_double, c_float, c_int64, c_void_p, pointer
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.finish.feet import FLOOR_FADE
from motionkit.finish.soles import NEAR, TIP
from motionkit.inference import height_correction, slip_correction
from motionkit.inference.foot_lock import FootLock
from motionkit.inference.frame_arrays import BodyArrays, FrameArrays, PresetArrays, SoleArrays
from motionkit.inference.noise import Noise, NoiseState
from motionkit.motion import leg_ik
from motionkit.motion.ankles import ANKLES
from motionkit.motion.rotations import quat_multiply
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT, PARENTS, STANDING_HEIGHTS
from motionkit.native import load_library
from motionkit.rig.soles import MOST_POINTS

VERSION = 16  # of frame_kernel.c


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
    *("usual_roll", "most_roll"),
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


class _Soles(Structure):
    _fields_ = (
        ("most", c_int64),
        *((n, c_float) for n in "near fade tip pace".split()),
        *((n, c_void_p) for n in "points counts floor rise bend drop".split()),
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
        ("soles", POINTER(_Soles)),
    )


@cache
def frame_library() -> ctypes.CDLL:
    """Return the shared library. Raises MotionkitError if this installation has none of this version."""
    library = load_library(Path(__file__).resolve().parent / "_frame_kernel", "frame_kernel_version", VERSION)
    library.draw_frames.argtypes = [POINTER(_Draw), c_int64]
    library.pose_frames.argtypes = [POINTER(_Pose), c_int64]
    library.rises.argtypes = [POINTER(_HeightCorrection), c_int64, c_int64, c_void_p, c_void_p, c_void_p]
    library.draw_frames.restype = library.pose_frames.restype = library.rises.restype = None
    return library


# ---- drawing a frame ----


def blended_columns(layout: str) -> Floats:
    """Share of velocity_blend per feature (276,): 0 for heights, because the floor stops a fall at once."""
    columns = feature_layout(layout).columns
    upright = [c.block in ("joint_positions", "joint_velocities") and c.component == 1 for c in columns]
    return 1.0 - np.array(upright, np.float32)


@dataclass(frozen=True, eq=False)
class Prediction:
    """The predicted next frame: mean and log_sigma (B, 276), normalised, and contact logits (B, 4)."""

    mean: Floats
    log_sigma: Floats
    contact_logits: Floats


@dataclass(frozen=True, eq=False)
class FrameSpace:
    """The meaning of a model's normalised features.

    Attributes:
        layout: version of the columns.
        fps: frames per second.
        mean, std: (276,) of the features.
        blended: (276,) blended_columns.
    """

    layout: str
    fps: float
    mean: Floats
    std: Floats
    blended: Floats


@dataclass(frozen=True, eq=False)
class DrawArrays:
    """Inputs and outputs of drawing a frame of B characters."""

    prediction: Prediction
    space: FrameSpace
    noise: NoiseState
    presets: PresetArrays
    frame: FrameArrays


def draw_words(arrays: DrawArrays, noise: Noise) -> Structure:
    """Return the struct of draw_frames: noise filters, and addresses of the arrays, which it does not keep alive."""
    made, space, state, presets, frame = vars(arrays).values()
    strides = [array.strides[0] // 4 for array in (made.mean, made.contact_logits)]
    followed = (
        state.first, state.second, space.blended, presets.velocity_blend, presets.slip_correction, frame.before,
    )  # fmt: skip
    drawn = (frame.x, frame.contacts, frame.features, frame.ground)
    whole = (space.mean, space.std, *followed, *drawn)
    assert all(array.flags.c_contiguous and array.dtype == np.float32 for array in whole)
    assert made.log_sigma.strides == made.mean.strides
    layout, feet = feature_layout(space.layout), slip_correction.foot_columns(space.layout)
    blocks = layout.blocks
    sixd = blocks["root_rotation"].start if layout.root_is_sixd else -1
    fresh = None if noise.kind == "mean" else state.fresh
    four = c_double * 4
    return _Draw(
        FEATURE_COUNT, CONTACT_COUNT, blocks["root_yaw_velocity"].start, blocks["root_xz_velocity"].start, sixd,
        *strides, (c_int64 * 4)(*feet[:, 0].tolist()), slip_correction.FLOOR,
        four(*slip_correction.REACHES), four(*leg_ik.FOOT_SHARES),
        leg_ik.HOLD.ease, slip_correction.STIFFNESS, leg_ik.HOLD.enough, slip_correction.LIMIT,
        *(_address(v) for v in (*vars(made).values(), space.mean, space.std, fresh, *followed)),
        *noise.filters, noise.temperature, space.fps,
        *(_address(v) for v in drawn),
    )  # fmt: skip


def bind_draw(arrays: DrawArrays, noise: Noise) -> Callable[[], None]:
    """Return a function that draws the next frame of all characters."""
    return _call(frame_library().draw_frames, draw_words(arrays, noise), len(arrays.frame.x), arrays)


# ---- posing a frame ----


def reference_products(reference_rotations: Floats) -> Floats:
    """Matrices (22, 4, 4) of the joints below the root: a row quaternion q times one is (reference rotation) q."""
    rows = quat_multiply(reference_rotations[1:, None].astype(np.float32), np.eye(4, dtype=np.float32))
    return np.ascontiguousarray(rows)


class PoseKernel:
    """Poses frames of N characters, with root-height correction and foot locking."""

    def __init__(self, layout: str, reference_rotations: Floats, body: BodyArrays) -> None:
        """Take reference_rotations (23, 4), and the arrays of body, which each call reads and changes."""
        count = len(body.offsets)
        self.layout, self.body = layout, body
        self.references = reference_products(reference_rotations)
        self.posed = tuple(
            np.zeros((count, *n), np.float32) for n in ((JOINT_COUNT, 4), (3,), (JOINT_COUNT, 3))
        )
        self._frame: tuple[Floats, ...] = ()
        self._run: Callable[[], None] | None = None

    def pose(self, features: Floats, contacts: Floats, ground: Floats) -> tuple[Floats, Floats, Floats]:
        """Local rotations (N, 23, 4), root positions (N, 3) and positions (N, 23, 3) of a frame.

        Args:
            features: (N, 276) unnormalised.
            contacts: (N, 4) probabilities.
            ground: (N, 3) root x, z and heading, before scaling.
        """
        frame = (features, contacts, ground)
        if self._run is None or any(a is not b for a, b in zip(frame, self._frame, strict=True)):
            kept = (self.references, self.body, self.posed, frame)
            words = self.words(*frame)
            self._frame, self._run = frame, _call(frame_library().pose_frames, words, len(features), kept)
        self._run()
        rotations, root, positions = self.posed
        return rotations.copy(), root.copy(), positions.copy()

    def words(self, features: Floats, contacts: Floats, ground: Floats) -> Structure:
        """Return the struct of pose_frames: addresses of the frame and the bodies, which it does not keep alive."""
        body, columns = self.body, feature_layout(self.layout)
        arrays = (self.references, body.offsets, body.scale, features, contacts, ground, *self.posed)
        assert all(array.flags.c_contiguous and array.dtype == np.float32 for array in arrays)
        blocks = columns.blocks
        return _Pose(
            FEATURE_COUNT, blocks["root_rotation"].start, blocks["joint_rotations"].start, columns.root_height,
            columns.root_is_sixd, (c_int64 * JOINT_COUNT)(*PARENTS),
            _height_correction(self.layout, body.rise), *(_address(array) for array in arrays),
            None if body.feet is None else pointer(_feet(body.feet)), pointer(_soles(body.soles)),
        )  # fmt: skip


def rises(layout: str, features: Floats, heights: Floats) -> Floats:
    """Rise (T,) of the root by the root-height correction in a whole motion, in cm of the canonical body.

    Args:
        features: (T, 276) unnormalised.
        heights: (T, 23) joint heights by forward kinematics before the correction, in cm of the canonical body.
    """
    inputs = [np.ascontiguousarray(array, np.float32) for array in (features, heights)]
    out, state = np.zeros(len(features), np.float32), np.zeros(1, np.float32)
    words = _height_correction(layout, state)
    frame_library().rises(byref(words), len(out), FEATURE_COUNT, *map(_address, (*inputs, out)))
    return out


def _height_correction(layout: str, rise: Floats) -> _HeightCorrection:
    four, f = c_int64 * 4, height_correction
    numbers = (f.REACH, f.PACE, f.DOUBT, f.DEEPEST, f.LIFT, _address(rise))
    joints, columns = four(*FOOT_JOINTS), four(*slip_correction.foot_columns(layout)[:, 1].tolist())
    return _HeightCorrection(joints, columns, (c_float * 4)(*STANDING_HEIGHTS), *numbers)


def _feet(feet: FootLock) -> _Feet:
    numbers = [value for settings in _FEET_SETTINGS for value in vars(settings).values()]
    numbers += [leg_ik.BENT, leg_ik.THIGH_SHARE, leg_ik.ALIKE]
    numbers += [leg_ik.STRAIGHTENING, leg_ik.BACKWARDS, leg_ik.STEEP]
    numbers += [ANKLES.usual_roll, ANKLES.most_roll]
    state, joints = feet.arrays, leg_ik.LEG_JOINTS.tolist()
    places = [_address(state[name]) for name in _FEET_STATE]
    return _Feet(*((c_int64 * 2)(*pair) for pair in joints), *numbers, *places)


def _soles(soles: SoleArrays) -> _Soles:
    return _Soles(MOST_POINTS, NEAR, FLOOR_FADE, TIP, leg_ik.SOLE_PACE, *map(_address, vars(soles).values()))


def _call(function: Callable, words: Structure, rows: int, kept: object) -> Callable[[], None]:
    """Return a call of the library for all rows, which keeps alive what the struct points to."""
    where, count = byref(words), c_int64(rows)

    def call() -> None:
        function(where, count)

    call.keeps = (words, kept)  # type: ignore[attr-defined]
    return call


def _address(array: NDArray | None) -> int | None:
    return None if array is None else array.ctypes.data
