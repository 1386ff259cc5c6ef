"""Metrics of motion prediction: MPJPE, L2P and L2Q (Harvey et al. 2020), and NPSS (Gopalakrishnan et al. 2019)."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.similarity import expmap_pair
from motionkit.metrics.value import MetricValue, need
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion

_NO_POWER = 1e-12  # share of the largest power of a recorded signal below which a signal has none


def mean_position_error(generated: Array, reference: Array) -> MetricValue:
    """MPJPE in cm (paper, equation MPJPE) of positions (T, J, 3), relative to the root, the first joint; headings stay.

    Raises:
        MotionkitError: the shapes differ, or there are no frames.
    """
    if generated.shape != reference.shape:
        raise MotionkitError(f"MPJPE needs equal shapes, found {generated.shape} and {reference.shape}")
    need(len(generated), 1, "MPJPE needs")
    generated, reference = generated.astype(np.float64), reference.astype(np.float64)
    error = (generated - generated[:, :1]) - (reference - reference[:, :1])
    return MetricValue(
        "mpjpe", float(np.linalg.norm(error, axis=-1).mean()), "cm", {"joints": float(error.shape[1])}
    )


def position_distance(motion: Motion, truth: Motion) -> MetricValue:
    """L2P in cm: Euclidean distance between the vectors of all joints' world positions, averaged over frames.

    Harvey et al. divide positions by their standard deviations in the training set; here they are in cm.

    Raises:
        MotionkitError: the motions differ in length.
    """
    _same_length(motion, truth)
    places = [motion_kinematics(each)[1].astype(np.float64) for each in (motion, truth)]
    gaps = (places[0] - places[1]).reshape(len(motion), -1)
    return MetricValue("l2p", float(np.linalg.norm(gaps, axis=1).mean()), "cm")


def rotation_distance(motion: Motion, truth: Motion) -> MetricValue:
    """L2Q: Euclidean distance between the vectors of all joints' world quaternions, averaged over frames.

    A quaternion and its negative are the same rotation; the nearer one is compared.

    Raises:
        MotionkitError: the motions differ in length.
    """
    _same_length(motion, truth)
    mine, theirs = (motion_kinematics(each)[0].astype(np.float64) for each in (motion, truth))
    signs = np.where((mine * theirs).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    gaps = (mine - signs * theirs).reshape(len(motion), -1)
    return MetricValue("l2q", float(np.linalg.norm(gaps, axis=1).mean()), "")


def power_spectrum_similarity(motion: Motion, truth: Motion) -> MetricValue:
    """NPSS: earth mover's distance between normalised power spectra of joint angles, weighted by the true power.

    Each column of the exponential maps is a signal over the whole sequence. Equal spectra give 0.

    Raises:
        MotionkitError: the motions differ in length.
    """
    _same_length(motion, truth)
    made, real = map(_power, expmap_pair(motion, truth))
    return MetricValue("npss", power_distance(made, real), "")


def power_distance(made: Array, real: Array) -> float:
    """Return the earth mover's distance between normalised powers (..., F, C) at frequencies, weighted by the real.

    A signal without power rests at zero: all its power counts as that of frequency 0.
    """
    weights = real.sum(axis=-2)
    least = _NO_POWER * float(weights.max(initial=0.0))
    first, second = (np.cumsum(_shares(each, least), axis=-2) for each in (made, real))
    moved = np.abs(first - second).sum(axis=-2)
    return float((moved * weights).sum() / max(float(weights.sum()), 1e-12))


def _shares(powers: Array, least: float) -> Array:
    """The shares of powers (..., F, C) at the frequencies; totals of at most `least` count as none."""
    totals = powers.sum(axis=-2, keepdims=True)
    resting = np.zeros_like(powers)
    resting[..., 0, :] = 1.0
    return np.where(totals > least, powers / np.maximum(totals, 1e-300), resting)


def _power(signals: Array) -> Array:
    """Power (T, C) of signals (T, C) at all frequencies, the negative ones too, as in the paper's programs."""
    return np.square(np.abs(np.fft.fft(signals.astype(np.float64), axis=0)))


def _same_length(motion: Motion, truth: Motion) -> None:
    if len(motion) != len(truth):
        raise MotionkitError(f"expected motions of one length, found {len(motion)} and {len(truth)} frames")
