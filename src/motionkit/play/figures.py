"""Body meshes for the page, made on first request."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import Skeleton
from motionkit.view.asset import BODIES
from motionkit.view.figure_data import CM, rig_data

WAIT_SECONDS = 3.0  # wait for a mesh; connections must be answered within ten seconds


def standing_rig(skeleton: Skeleton, character: dict[str, Any] | None = None) -> dict[str, Any]:
    """The rig and mesh of a body (in cm) in its rest pose, for the page; character is a user's, in its place."""
    turns = quat_identity((1, len(skeleton)))
    motion = Motion(skeleton, turns, np.zeros((1, 3), np.float32), 60.0)
    return rig_data(motion.scaled(CM), body=None if character else BODIES[0]) | {"hero": character}


class Figures:
    """Body meshes as JSON. Each is made once, in its own thread, because it takes about half a second."""

    def __init__(
        self, bodies: Sequence[Skeleton], characters: Mapping[int, dict[str, Any]] | None = None
    ) -> None:
        """characters are users' characters in place of the meshes of some bodies, by their numbers."""
        self._bodies, self._characters = bodies, characters or {}
        self._made: dict[int, asyncio.Task[bytes]] = {}
        self._one = asyncio.Semaphore(1)

    def begin(self, number: int) -> asyncio.Task[bytes] | None:
        """Start a mesh unless it was started before; None if there is no such body."""
        if not 0 <= number < len(self._bodies):
            return None
        if number not in self._made:
            self._made[number] = asyncio.get_running_loop().create_task(self._make(number))
        return self._made[number]

    async def get(self, number: int) -> bytes | None:
        """The mesh of a body, by index; empty bytes if it is not ready in time, None if there is no such body."""
        task = self.begin(number)
        if task is None:
            return None
        await asyncio.wait([task], timeout=WAIT_SECONDS)
        return task.result() if task.done() else b""

    async def _make(self, number: int) -> bytes:
        async with self._one:
            return await asyncio.to_thread(_figure_text, self._bodies[number], self._characters.get(number))


def _figure_text(skeleton: Skeleton, character: dict[str, Any] | None) -> bytes:
    return json.dumps(standing_rig(skeleton, character), separators=(",", ":")).encode()
