"""What a finished run made of the test sequences, kept beside its result, so that metrics can be added to it later.

All columns but the velocities of joints, which no metric reads, in 16 bits: about half a megabyte for D_L.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Floats
from motionkit.data.dataset import Dataset
from motionkit.errors import MotionkitError
from motionkit.features.layout import FEATURE_COUNT, FeatureLayout
from motionkit.files import atomic_write, check_regular
from motionkit.lab.held_out import HeldOut

OUTPUTS = ("sample", "mean")  # one seeded sample of every frame, and the predicted means
MOST_BYTES = 256 * 2**20
LEVELS = 32767  # steps from 0 to the largest value of a column


def rollouts_file(result: Path) -> Path:
    """Return where the roll-outs of a result are kept."""
    return result.with_suffix(".npz")


def keep_rollouts(path: Path, dataset: Dataset, made: Mapping[str, Sequence[Floats]]) -> None:
    """Write unnormalised features (T, 276) of the test sequences, for each of OUTPUTS.

    Raises:
        MotionkitError: the network predicted numbers that are not finite.
    """
    columns = _kept(dataset.layout)
    arrays: dict[str, Any] = {"frames": np.array([len(each) for each in made[OUTPUTS[0]]], np.int64)}
    for output in OUTPUTS:
        values = dataset.scaling.normalize(np.concatenate(made[output]))[:, columns]
        if not np.isfinite(values).all():
            raise MotionkitError(
                f"{path}: the roll-out failed: the network predicts numbers that are not finite"
            )
        scale = np.maximum(np.abs(values).max(axis=0), 1e-9) / LEVELS
        arrays |= {
            output: np.round(values / scale).astype(np.int16),
            f"{output}-scale": scale.astype(np.float32),
        }
    with atomic_write(path, "wb") as out:
        np.savez_compressed(out, **arrays)


def read_rollouts(path: Path, dataset: Dataset, sequences: Sequence[HeldOut]) -> dict[str, list[Floats]]:
    """Return the features (T, 276) of each of OUTPUTS that keep_rollouts wrote, with no velocities of joints.

    Raises:
        MotionkitError: the file is none, or not of these sequences.
    """
    columns = _kept(dataset.layout)
    check_regular(path, MOST_BYTES, "the roll-outs of an experiment")
    try:
        with np.load(path) as found:
            arrays = dict(found)
        frames = [each.frames for each in sequences]
        if arrays["frames"].tolist() != frames or any(
            arrays[output].shape != (sum(frames), len(columns)) for output in OUTPUTS
        ):
            raise MotionkitError(f"{path}: the roll-outs of other sequences; delete it and run it again")
        out = {}
        for output in OUTPUTS:
            whole = np.zeros((sum(frames), FEATURE_COUNT), np.float32)
            whole[:, columns] = arrays[output] * arrays[f"{output}-scale"]
            out[output] = np.split(dataset.scaling.denormalize(whole), np.cumsum(frames)[:-1])
        return out
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile):
        raise MotionkitError(
            f"{path}: not the roll-outs of an experiment; delete it and run it again"
        ) from None


def _kept(layout: FeatureLayout) -> list[int]:
    left_out = ("joint_angular_velocities", "joint_velocities")
    return [i for i, column in enumerate(layout.columns) if column.block not in left_out]
