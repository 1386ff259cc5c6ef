"""The table of the 276 feature columns and their meaning (paper section 3).

docs/network.md explains the split into 6 + 66 + 66 + 69 + 69. Each of the 23 joints has 12 columns; all body parts
share those of the root.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ModelError
from motionkit.motion.skeleton import JOINT_COUNT, JOINT_NAMES, MIRROR_JOINTS

FEATURE_COUNT = 276
CONTACT_COUNT = 4
LAYOUTS = ("sixd-root-1", "expmap-root-1")
DEFAULT_LAYOUT = "sixd-root-1"

# Signs that mirror the components of each kind of quantity at the plane x = 0.
_VECTOR = (-1.0, 1.0, 1.0)
_AXIAL = (1.0, -1.0, -1.0)
_SIXD = (1.0, -1.0, -1.0, -1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Column:
    """One column: its block, its joint, its component within the joint, and its sign when mirrored."""

    block: str
    joint: int
    component: int
    mirror_sign: float


@dataclass(frozen=True, eq=False)
class FeatureLayout:
    """The columns of one version of the features.

    Attributes:
        version: name of the version, which model files store.
        columns: the 276 columns, in order.
        blocks: slice of columns by block name.
    """

    version: str
    columns: tuple[Column, ...]
    blocks: dict[str, slice]

    @property
    def root_is_sixd(self) -> bool:
        """Whether the root's rotation is two matrix columns (6 values), not an exponential map (3 values)."""
        return self.version == "sixd-root-1"

    @property
    def root_height(self) -> int:
        """The column of the root's height above the floor."""
        return self._places["joint_positions", 0, 1]

    def indices(
        self, block: str, joints: Sequence[int], components: Sequence[int] = (0, 1, 2)
    ) -> list[list[int]]:
        """For each joint, the columns of its components in a block."""
        return [[self._places[block, joint, k] for k in components] for joint in joints]

    def joint_columns(self, joint: int) -> list[int]:
        """The 12 columns of a joint, in order."""
        return [index for index, column in enumerate(self.columns) if column.joint == joint]

    def block_columns(self, block: str, joints: Collection[int]) -> list[int]:
        """The columns of some joints in a block, in order."""
        return [
            i for i, column in enumerate(self.columns) if column.block == block and column.joint in joints
        ]

    def mirror_map(self) -> tuple[Array, Array]:
        """Column indices (276,) and signs (276,): mirrored = features[..., indices] * signs."""
        return self._mirror_map

    @cached_property
    def _places(self) -> dict[tuple[str, int, int], int]:
        return {(c.block, c.joint, c.component): index for index, c in enumerate(self.columns)}

    @cached_property
    def _mirror_map(self) -> tuple[Array, Array]:
        indices = [self._places[c.block, MIRROR_JOINTS[c.joint], c.component] for c in self.columns]
        return np.array(indices), np.array([c.mirror_sign for c in self.columns], np.float32)


def _block(name: str, joints: range | list[int], signs: tuple[float, ...]) -> list[Column]:
    return [Column(name, joint, k, sign) for joint in joints for k, sign in enumerate(signs)]


@cache
def feature_layout(version: str = DEFAULT_LAYOUT) -> FeatureLayout:
    """The layout of a version.

    "expmap-root-1" is the paper's: the root's rotation is an exponential map, its position (0, y, 0).
    In "sixd-root-1" the root's rotation is two matrix columns, which do not jump when the body turns over. To keep
    276 columns, it omits the root's x and z position, which are zero, and its sideways velocity, which
    root_xz_velocity has too.

    Raises:
        ModelError: the version is unknown.
    """
    if version not in LAYOUTS:
        raise ModelError(f"unknown feature layout {version!r}, expected one of {', '.join(LAYOUTS)}")
    continuous = version == "sixd-root-1"
    others = range(1, JOINT_COUNT)
    parts = [
        _block("root_yaw_velocity", [0], (-1.0,)),
        _block("root_xz_velocity", [0], (-1.0, 1.0)),
        _block("root_rotation", [0], _SIXD if continuous else _AXIAL),
        _block("joint_rotations", others, _AXIAL),
        _block("joint_angular_velocities", others, _AXIAL),
        _root_vector("joint_positions", (1,) if continuous else (0, 1, 2))
        + _block("joint_positions", others, _VECTOR),
        _root_vector("joint_velocities", (1, 2) if continuous else (0, 1, 2))
        + _block("joint_velocities", others, _VECTOR),
    ]
    columns: list[Column] = []
    blocks: dict[str, slice] = {}
    for part in parts:
        blocks[part[0].block] = slice(len(columns), len(columns) + len(part))
        columns.extend(part)
    assert len(columns) == FEATURE_COUNT
    return FeatureLayout(version, tuple(columns), blocks)


def _root_vector(name: str, components: tuple[int, ...]) -> list[Column]:
    return [Column(name, 0, k, _VECTOR[k]) for k in components]


def contact_mirror() -> Array:
    """Indices (4,) that swap the contacts of left and right foot."""
    return np.array([2, 3, 0, 1])


def column_names(version: str = DEFAULT_LAYOUT) -> list[str]:
    """Names of the 276 columns, such as joint_positions.LeftFoot.1, for logs and exports."""
    return [f"{c.block}.{JOINT_NAMES[c.joint]}.{c.component}" for c in feature_layout(version).columns]
