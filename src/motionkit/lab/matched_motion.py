"""Paths and live commands answered by motion matching: what users would take instead of a network (Clavet 2016)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motionkit.arrays import Array
from motionkit.control.drive import Driver
from motionkit.control.follow import PATIENCE, PathFollower
from motionkit.control.path import Path2D
from motionkit.control.plan import plan_path
from motionkit.data.dataset import Dataset
from motionkit.features.decode import decode_motion, integrate_ground
from motionkit.finish.finish import Finish, finish
from motionkit.lab.floors import Matching
from motionkit.metrics.body import Body, body_of
from motionkit.models.model import MotionModel
from motionkit.rig.soles import body_soles
from motionkit.training.verdict.rolling import Driven

# Takes a frame and the ground (3,); returns the requested type and trajectory (24,), or None at the end.
Request = Callable[[int, Array], tuple[str, Array] | None]


class MatchedMotion:
    """Plays a dataset's training clips by motion matching, finished as a model's motions.

    The types must be types of training clips. Speeds and trajectories are those that the model gets.
    """

    def __init__(self, model: MotionModel, dataset: Dataset) -> None:
        self.model, self.dataset, self.matching = model, dataset, Matching(dataset)

    def knows(self, *kinds: str | None) -> bool:
        """Whether the training clips have all of some types."""
        return set(kinds) <= {self.dataset.types[number] for number in np.unique(self.matching.library.types)}

    def along(self, path: Path2D) -> Body:
        """Follow a path."""
        plan = plan_path(self.model, path)
        follower = PathFollower(self.model, plan)

        def request(frame: int, ground: Array) -> tuple[str, Array] | None:
            controls = follower(frame, ground[None])
            if follower.finished:
                return None
            return path.parts[follower.parts[-1]].type, controls.trajectory[0]

        heading = np.arctan2(*path.tangents[0]) - follower.route.facings[0]
        frames = round((PATIENCE * plan.seconds + 3.0) * self.model.fps)
        return self._played(request, frames, path.parts[0].type, np.array([*path.points[0], heading]))

    def live(self, character: Driven, frames: int) -> Body:
        """Answer the wishes of a live character that gives a trajectory at all times."""
        driver = Driver(self.model, character.type)

        def request(frame: int, ground: Array) -> tuple[str, Array]:
            character.steer(frame, driver)
            controls = driver(frame, ground[None])
            return driver.type, controls.trajectory[0]

        return self._played(request, frames, character.type, np.zeros(3))

    def _played(self, request: Request, frames: int, kind: str, begins: Array) -> Body:
        matching, library, layout = self.matching, self.matching.library, self.dataset.layout.version
        ground = [begins]
        rows = [int(np.flatnonzero(library.types == self.dataset.types.index(kind))[0])]
        matching.begin()
        for frame in range(frames):
            goal = request(frame, ground[-1])
            if goal is None:
                break
            number = self.dataset.types.index(goal[0])
            rows.append(matching.next(frame, library.features[rows[-1]], number, goal[1]))
            ground.append(
                integrate_ground(library.features[rows[-2:]], ground[-1], self.model.fps, layout)[1]
            )
        body = self.model.character("default")
        track = np.stack(ground).astype(np.float32)
        reference = self.dataset.reference_rotations
        motion = decode_motion(library.features[rows], body, self.model.fps, track[0], reference, layout)
        return body_of(finish(motion, library.contacts[rows], Finish(soles=body_soles(body))))
