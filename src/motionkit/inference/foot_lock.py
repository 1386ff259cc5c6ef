"""State of foot locking for live characters, frame by frame; foot_kernel.c computes it (numpy form: tests/oracle).

finish/feet.py locks the feet of a whole motion, where a lock can begin before its contact. Here only the past is known.
When a contact begins, the foot slows down over a few frames and stays; when the contact ends, it is released over a
few frames. The knee bends to follow, and the hips come down where the leg is too short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats


@dataclass(frozen=True, eq=False)
class RootHold:
    """How foot sliding corrects the roots of N characters.

    Attributes:
        hold: (N,) share of foot sliding to subtract from the root's path; may change between frames.
        carry: (N, 2) total shift of the root so far, x and z in cm.
        slip: (N, 2) sliding in the last frame; the root moves back by it.
        feet: (N, 4, 3) foot joints of the last frame before locking.
        moving: (N,) whether there is a last frame.
        drop: (N,) how far the hips are lowered.
    """

    hold: Floats
    carry: Floats
    slip: Floats
    feet: Floats
    moving: NDArray[np.bool_]
    drop: Floats


@dataclass(frozen=True, eq=False)
class Plants:
    """Locks of the left and the right foot of N characters.

    Attributes:
        locked: (N, 2) whether the foot is locked.
        age: (N, 2) frames since it was locked or released.
        step: (N, 2) height of the present step; 0 without one.
        anchor: (N, 2, 2) x, z at which the toe is locked.
        shift: (N, 2, 2) from the predicted to the shown toe.
        released: (N, 2, 2) that shift when the foot was released.
        toes: (N, 2, 2) predicted x, z of the last frame.
        stands: (N, 2) whether the toe is in contact.
        lift: (N, 2) vertical shift of the toe.
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
    """The foot-lock state of N characters."""

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
        """Forget the past of one character; root.hold stays."""
        for name, array in self.arrays.items():
            if name != "hold":
                array[index] = 0
