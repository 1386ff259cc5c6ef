"""A path followed by motion matching: what users would take instead of a network (Clavet 2016)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionkit.control.follow import PATIENCE, PathFollower
from motionkit.control.path import Path2D
from motionkit.control.plan import plan_path
from motionkit.data.dataset import Dataset
from motionkit.features.decode import decode_motion, integrate_ground
from motionkit.finish.finish import Finish, finish
from motionkit.lab.floors import Matching
from motionkit.metrics.body import Body, body_of
from motionkit.models.model import MotionModel


def matched_paths(model: MotionModel, dataset: Dataset, paths: Sequence[Path2D]) -> list[Body]:
    """Follow each path by motion matching over a dataset's training clips.

    Speeds and trajectories are those that the model gets on the path, and feet are locked as in its motions. The paths'
    types must be types of the dataset.
    """
    matching = Matching(dataset)
    return [_matched(model, dataset, matching, path) for path in paths]


def _matched(model: MotionModel, dataset: Dataset, matching: Matching, path: Path2D) -> Body:
    plan, library, layout = plan_path(model, path), matching.library, dataset.layout.version
    follower = PathFollower(model, plan)
    kinds = [dataset.types.index(part.type) for part in path.parts]
    heading = np.arctan2(*path.tangents[0]) - follower.route.facings[0]
    ground = [np.array([*path.points[0], heading])]
    matching.begin()
    rows = [int(np.flatnonzero(library.types == kinds[0])[0])]
    for frame in range(round((PATIENCE * plan.seconds + 3.0) * model.fps)):
        asked = follower(frame, ground[-1][None])
        if follower.finished:
            break
        kind = kinds[int(path.part_at(follower.place.arc))]
        rows.append(matching.next(frame, library.features[rows[-1]], kind, asked.trajectory[0]))
        ground.append(integrate_ground(library.features[rows[-2:]], ground[-1], model.fps, layout)[1])
    body = model.character("default")
    track = np.stack(ground).astype(np.float32)
    motion = decode_motion(
        library.features[rows], body, model.fps, track[0], dataset.reference_rotations, layout
    )
    return body_of(finish(motion, library.contacts[rows], Finish()))
