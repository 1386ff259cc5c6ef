"""A network's weights as plain arrays, for model files and inference without torch.

Shape legend: P parts, N inputs of a part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, Floats
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT, feature_layout
from motionkit.models.config import ModelConfig, PredictorConfig
from motionkit.models.parts import partition


@dataclass(frozen=True, eq=False)
class NetworkWeights:
    """The parameters of a network.

    Attributes:
        arrays: float32 parameters by their names in the network.
    """

    config: PredictorConfig
    control_size: int
    arrays: dict[str, Floats]

    def __getitem__(self, name: str) -> Floats:
        return self.arrays[name]

    def get(self, name: str) -> Floats | None:
        """Return a parameter, or None if the configuration does not have it."""
        return self.arrays.get(name)


def part_columns(config: ModelConfig) -> tuple[Array, Array]:
    """Return each part's input columns (P, N), and whether they belong to shared joints (P, N).

    Columns count the 276 features, then the 4 contacts, then one column of zeros for padding.
    """
    layout = feature_layout(config.layout)
    body = partition(config.variant.partition)
    rows, shared = [], []
    for part in body.parts:
        joints = list(body.shared) + [j for j in part.joints if j not in body.shared]
        columns = [c for joint in joints for c in layout.joint_columns(joint)]
        common = len(body.shared) * 12
        columns += [FEATURE_COUNT + contact for contact in part.contacts]
        rows.append(columns)
        shared.append([True] * common + [False] * (len(columns) - common))
    size = max(len(row) for row in rows)
    zero = FEATURE_COUNT + CONTACT_COUNT
    gather = np.array([row + [zero] * (size - len(row)) for row in rows])
    return gather, np.array([row + [False] * (size - len(row)) for row in shared])


def embedding_mask(config: ModelConfig) -> Floats:
    """Return a mask (P, kernel N, motion width): the first channels see only shared joints, and none sees padding."""
    gather, shared = part_columns(config)
    mask = np.ones((*gather.shape, config.width - config.embedding.control_width), np.float32)
    mask[:, :, : config.embedding.shared_channels] = shared[:, :, None]
    mask *= (gather < FEATURE_COUNT + CONTACT_COUNT)[:, :, None]
    return np.tile(mask, (1, config.kernel, 1))


def foot_parts(config: ModelConfig) -> list[int]:
    """Return the parts with a foot; their features are the input of the Foot-MLP."""
    return [i for i, part in enumerate(partition(config.variant.partition).parts) if part.contacts]
