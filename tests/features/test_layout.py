from __future__ import annotations

import numpy as np
import pytest

from motionkit.errors import ModelError
from motionkit.features.layout import (
    FEATURE_COUNT,
    LAYOUTS,
    column_names,
    contact_mirror,
    feature_layout,
)
from motionkit.motion.skeleton import JOINT_COUNT

EXPECTED_BLOCKS = {
    "expmap-root-1": (1, 2, 3, 66, 66, 69, 69),
    "sixd-root-1": (1, 2, 6, 66, 66, 67, 68),
}


@pytest.mark.parametrize("version", LAYOUTS)
def test_blocks_cover_the_276_columns_without_gap_or_overlap(version: str) -> None:
    layout = feature_layout(version)
    covered = [column for block in layout.blocks.values() for column in range(block.start, block.stop)]
    assert covered == list(range(276)) and FEATURE_COUNT == 276
    assert tuple(b.stop - b.start for b in layout.blocks.values()) == EXPECTED_BLOCKS[version]


@pytest.mark.parametrize("version", LAYOUTS)
def test_each_joint_owns_twelve_columns(version: str) -> None:
    layout = feature_layout(version)
    owned = [layout.joint_columns(joint) for joint in range(JOINT_COUNT)]
    assert all(len(columns) == 12 for columns in owned)
    assert sorted(c for columns in owned for c in columns) == list(range(276))


@pytest.mark.parametrize("version", LAYOUTS)
def test_column_names_are_unique(version: str) -> None:
    assert len(set(column_names(version))) == 276
    assert "joint_positions.LeftFoot.1" in column_names(version)


@pytest.mark.parametrize("version", LAYOUTS)
def test_mirroring_columns_twice_changes_nothing(version: str) -> None:
    columns, signs = feature_layout(version).mirror_map()
    x = np.random.default_rng(0).standard_normal((5, 276), np.float32)
    once = x[:, columns] * signs
    assert not np.array_equal(once, x)
    assert np.array_equal(once[:, columns] * signs, x)


def test_contact_mirror_is_its_own_inverse_and_swaps_sides() -> None:
    swap = contact_mirror()
    assert swap.tolist() == [2, 3, 0, 1]
    assert np.array_equal(swap[swap], np.arange(4))


def test_unknown_version_is_a_model_error() -> None:
    with pytest.raises(ModelError, match=r"sixd-root-9.*expected one of sixd-root-1, expmap-root-1"):
        feature_layout("sixd-root-9")
