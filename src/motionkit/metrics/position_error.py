"""Mean per joint position error (MPJPE), relative to the root."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.metrics.value import MetricValue, need


def mean_position_error(generated: Array, reference: Array) -> MetricValue:
    """MPJPE in cm (paper, equation MPJPE), from positions relative to the root; headings are not aligned.

    Args:
        generated, reference: (T, J, 3) global positions in cm, the root first.

    Raises:
        MotionkitError: the shapes differ, or there are no frames.
    """
    if generated.shape != reference.shape:
        raise MotionkitError(
            f"MPJPE needs equal shapes, found {tuple(generated.shape)} and {tuple(reference.shape)}"
        )
    need(len(generated), 1, "MPJPE needs")
    generated, reference = generated.astype(np.float64), reference.astype(np.float64)
    error = (generated - generated[:, :1]) - (reference - reference[:, :1])
    return MetricValue(
        "mpjpe", float(np.linalg.norm(error, axis=-1).mean()), "cm", {"joints": float(error.shape[1])}
    )
