"""Feet held still while they touch, frame by frame: only the past is known. foot_kernel.c does it.

motion/foot_ik.py does the same to a finished motion, where a lock can begin before its contact. Here a foot is caught
where it is shown when its contact begins, braked over a few frames, held, and let go over a few frames; the knee bends
to let it, and the hips come down where the leg is too short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats


@dataclass(frozen=True, eq=False)
class RootHold:
    """How the feet of N characters hold their roots.

    Attributes:
        hold: (N,) share of the sliding of feet in contact that is taken out of the root's way over the ground; may be
            changed between frames.
        carry: (N, 2) how far the root has been moved by that, x and z in cm; slip: (N, 2) in the last frame, back.
        feet: (N, 4, 3) foot joints of the last frame before they were moved; moving: (N,) whether there was one.
        drop: (N,) how far the hips have come down.
    """

    hold: Floats
    carry: Floats
    slip: Floats
    feet: Floats
    moving: NDArray[np.bool_]
    drop: Floats


@dataclass(frozen=True, eq=False)
class Plants:
    """The left and the right foot of N characters.

    Attributes:
        locked: (N, 2) whether the foot is held; age: (N, 2) frames since it was caught or let go.
        step: (N, 2) how high the toe of a foot that steps rises, else 0.
        anchor: (N, 2, 2) x, z of a caught toe.
        shift: (N, 2, 2) from the predicted to the shown toe; released: that shift when the foot was let go.
        toes: (N, 2, 2) predicted x, z of the last frame.
        stands: (N, 2) whether the toe is in contact; lift: (N, 2) how far it is moved up or down.
    """

    locked: NDArray[np.bool_]
    age: Floats
    step: Floats
    anchor: Floats
    shift: Floats
    released: Floats
    toes: Floats
    stands: NDArray[np.bool_]
    lift: Floats


class FootLock:
    """The state of the feet of N characters."""

    def __init__(self, count: int) -> None:
        def zeros(*shape: int) -> Floats:
            return np.zeros((count, *shape), np.float32)

        moving, locked, stands = np.zeros(count, bool), np.zeros((count, 2), bool), np.zeros((count, 2), bool)
        self.root = RootHold(
            np.ones(count, np.float32), zeros(2), zeros(2), zeros(4, 3), moving, drop=zeros()
        )
        anchor, shift, released, toes = (zeros(2, 2) for _ in range(4))
        self.plants = Plants(locked, zeros(2), zeros(2), anchor, shift, released, toes, stands, lift=zeros(2))

    @property
    def arrays(self) -> dict[str, NDArray]:
        """All arrays by name."""
        return {**vars(self.root), **vars(self.plants)}

    def reset(self, index: int) -> None:
        """Forget one character's past; how much its feet hold the root stays."""
        for name, array in self.arrays.items():
            if name != "hold":
                array[index] = 0
