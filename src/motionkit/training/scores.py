"""Scores of roll-outs by type, because losses do not show how a model moves in closed loop.

Each type starts from its own start pose and has reference poses as in synthesis. The scores compare its roll-out with
the type's recordings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motionkit.arrays import Array, distances_between
from motionkit.control.character_start import StartState, last_poses
from motionkit.control.plan import plan_types
from motionkit.control.planned_controls import CrowdController
from motionkit.control.script import TypePart
from motionkit.data.dataset import Dataset
from motionkit.errors import MotionkitError
from motionkit.features.control import Controls
from motionkit.features.decode import decode_motion, root_height
from motionkit.features.layout import FEATURE_COUNT, FeatureLayout
from motionkit.files import safe_name
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import Rollout, RolloutState, rollout_motion, run, start_batch
from motionkit.inference.start import on_body, type_start
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import StartPose
from motionkit.motion.bvh import write_bvh
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT

LOW_TOE = 5.0  # cm below which a toe is low; the toe joint of a standing body is at 4.1
MAX_REAL_FRAMES = 1200  # recorded frames per type that are compared


@dataclass(frozen=True)
class TypeScore:
    """Scores of the roll-out of one type.

    Attributes:
        joint_speed: mean angular speed of the joints divided by the recorded one (0: frozen, 1: as recorded).
        pose_distance: mean distance per joint in cm to the nearest pose of the type's training clips.
        slide: horizontal speed of low toes divided by the recorded one.
        height: lowest and highest root height in cm.
    """

    type: str
    joint_speed: float
    pose_distance: float
    slide: float
    height: tuple[float, float]

    def to_dict(self) -> dict:
        """Return rounded plain values, for logs."""
        numbers = {k: round(v, 3) for k, v in asdict(self).items() if isinstance(v, float)}
        return {"type": self.type, **numbers, "height": [round(x, 1) for x in self.height]}


def score_rollouts(
    model: MotionModel,
    dataset: Dataset,
    frames: int,
    samples: Path | None = None,
    on_fault: Callable[[str], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[TypeScore, ...]:
    """Return the scores of one roll-out of every type.

    Args:
        samples: folder for one predicted and one recorded BVH file per type; None writes none.
        on_fault: called with a line if a sample cannot be written; without it the error is raised.
    """
    rollout = rollout_types(model, frames)
    scores = []
    for i, kind in enumerate(model.types):
        real = _real_frames(dataset, i)
        if len(real):
            scores.append(_score(kind, rollout.features[i], real, dataset.layout))
        if progress:
            progress((i + 1) / len(model.types))
    if samples is not None:
        try:
            _write_samples(model, dataset, rollout, samples)
        except (MotionkitError, OSError) as fault:
            if on_fault is None:
                raise
            on_fault(f"cannot write samples: {fault}")
    return tuple(scores)


def rollout_types(model: MotionModel, frames: int, seed: int = 0) -> Rollout:
    """Roll out all types side by side, each from its first start poses."""
    body = model.moved_skeleton("default")
    on_bodies = [on_body(model, type_start(model, name), body) for name in model.types]
    starts = [StartPose(each.features[0], each.contacts[0], each.ground) for each in on_bodies]
    return roll_out(model, tuple(model.types), starts, frames / model.fps, seed)[0]


def roll_out(
    model: MotionModel, names: tuple[str, ...], starts: list[StartPose], seconds: float, seed: int
) -> tuple[Rollout, Array]:
    """Roll out one character for each type name and start pose; returns also the phases (N, T) asked for."""
    state = RolloutState(model, len(names), Noise(), seed)
    features, contacts = start_batch(starts)
    state.start(features, contacts, np.stack([model.type_weights(name) for name in names]))
    behind = features.shape[1]
    plans = [
        plan_types(model, [TypePart(name, seconds)], StartState(last_poses(model, seen), behind))
        for name, seen in zip(names, features, strict=True)
    ]
    controller, phases = CrowdController(model, plans, seed), list[Array]()

    def controls(frame: int, ground: Array) -> Controls:
        signals = controller(frame, ground)
        phases.append(signals.phase)
        return signals

    made = run(state, round(seconds * model.fps), controls)
    return made, np.stack(phases, 1).astype(np.float32)


def _real_frames(dataset: Dataset, kind: int) -> Array:
    """At most MAX_REAL_FRAMES training frames of a type, evenly spread, because clips begin with standing."""
    clips = [(clip, np.flatnonzero(dataset.clip_types(clip) == kind)) for clip in dataset.select("train")]
    every = 1 + sum(len(rows) for _, rows in clips) // MAX_REAL_FRAMES
    parts = [dataset.read(clip).features[rows[::every]] for clip, rows in clips if len(rows)]
    return np.concatenate(parts) if parts else np.zeros((0, FEATURE_COUNT), np.float32)


def _score(kind: str, made: Array, real: Array, layout: FeatureLayout) -> TypeScore:
    positions = layout.blocks["joint_positions"]
    distance = (
        distances_between(made[::4, positions], real[:, positions]).min(axis=1).mean() / JOINT_COUNT**0.5
    )
    height = root_height(made, layout.version)
    return TypeScore(
        kind,
        float(_joint_speed(made, layout) / np.maximum(_joint_speed(real, layout), 1e-3)),
        float(distance),
        float(_slide(made, layout) / np.maximum(_slide(real, layout), 0.5)),
        (float(height.min()), float(height.max())),
    )


def _joint_speed(features: Array, layout: FeatureLayout) -> Array:
    turns = features[:, layout.blocks["joint_angular_velocities"]]
    return np.linalg.norm(turns.reshape(len(features), JOINT_COUNT - 1, 3), axis=-1).mean()


def _slide(features: Array, layout: FeatureLayout) -> Array:
    """Return the mean horizontal speed of toes near the floor in cm/s."""
    toes = FOOT_JOINTS[1::2]
    heights = features[:, np.concatenate(layout.indices("joint_positions", toes, (1,)))]
    speeds = np.linalg.norm(features[:, layout.indices("joint_velocities", toes, (0, 2))], axis=-1)
    low = (heights < LOW_TOE).astype(np.float32)
    return (speeds * low).sum() / np.maximum(low.sum(), 1.0)


def _write_samples(model: MotionModel, dataset: Dataset, rollout: Rollout, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    skeleton = model.character("default")
    for i, kind in enumerate(model.types):
        name = safe_name(kind)
        write_bvh(folder / f"{name}-predicted.bvh", rollout_motion(model, rollout, i, skeleton))
        clip = next((c for c in dataset.select("train") if bool((dataset.clip_types(c) == i).any())), None)
        if clip is not None:
            data = dataset.read(clip)
            real = data.features[dataset.clip_types(clip) == i]
            motion = decode_motion(
                real, skeleton, dataset.fps, None, dataset.reference_rotations, dataset.layout.version
            )
            write_bvh(folder / f"{name}-true.bvh", motion)
