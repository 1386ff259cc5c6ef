"""Held-out sequences and their continuation by a model: the shared protocol of scoreboard and paper."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.features.control import Controls
from motionkit.features.decode import decode_motion, integrate_ground
from motionkit.inference.noise import default_noise
from motionkit.inference.rollout import RolloutState, run
from motionkit.inference.start import INIT_FRAMES
from motionkit.metrics.report import evaluate_motion
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import Skeleton

INITIAL = (INIT_FRAMES, 30)  # numbers of initial frames: the paper's, and 30 for sequences too short for it
LEAST_REST = 30  # fewest frames to generate
SAME = (
    0.02  # difference of pose embeddings up to which poses are the same, but for the 16 bits of a model file
)

# A function of a sequence and its number that returns features (T, 276) of the frames to generate.
Continue = Callable[["HeldOut", int], Array]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A held-out sequence.

    Attributes:
        initial: number of initial frames, which are given.
        frames: number of frames to generate after them.
        kind: the most frequent type of these frames.
    """

    clip: Clip
    data: ClipData
    initial: int
    frames: int
    kind: str


def held_out(
    dataset: Dataset, longest: int, split: str = "test", initials: tuple[int, ...] = INITIAL
) -> list[HeldOut]:
    """Return the clips of a split that are long enough, with at most `longest` frames to generate.

    Of `initials`, numbers of initial frames, that is taken which is the first to leave LEAST_REST frames.
    """
    out = []
    for clip in dataset.select(split):
        initial = next((count for count in initials if clip.frames >= count + LEAST_REST), None)
        if initial is not None:
            data, frames = dataset.read(clip), min(longest, clip.frames - initial)
            most = int(np.bincount(data.types[initial : initial + frames]).argmax())
            out.append(HeldOut(clip, data, initial, frames, dataset.types[most]))
    return out


def in_references(model: MotionModel, dataset: Dataset, clips: Sequence[Clip]) -> list[str]:
    """Return the names of clips whose recording, or its mirror image, is among a model's reference clips.

    A reference clip is known by its first, middle and last pose.
    """
    marks = [
        (reference.poses[places], places)
        for kind in model.types.values()
        for reference in kind.reference_clips
        for places in [np.array([0, (len(reference) - 1) // 2, len(reference) - 1])]
    ]

    def holds(clip: Clip) -> bool:
        shown = model.pose_embedding.of(dataset.read(clip).features)
        for poses, places in marks:
            for start in np.flatnonzero(np.abs(shown - poses[0]).max(axis=1) < SAME):
                found = shown[np.minimum(start + places, len(shown) - 1)]
                if np.abs(found - poses).max() < SAME:
                    return True
        return False

    return [each.name for each in clips if holds(each) or holds(dataset.image(each))]


def compared(
    motion: Motion, truth: Motion, metrics: Collection[str]
) -> dict[str, tuple[float | None, float | None]]:
    """Return metrics by id, each as (value of the motion, value of the recorded one); None if there is no value."""
    return {
        row.id: (row.motion.value, row.ground_truth.value if row.ground_truth else None)
        for row in evaluate_motion(motion, truth).rows
        if row.id in metrics
    }


def decoded(dataset: Dataset, sequence: HeldOut, features: Array, body: Skeleton | None = None) -> Motion:
    """Return the motion of generated features (T, 276), continuing from the initial frames.

    The body is the performer's own by default.
    """
    first, layout = sequence.initial, dataset.layout.version
    before = np.concatenate([sequence.data.features[first - 1 : first], features])
    ground = integrate_ground(before, sequence.data.ground[first - 1], dataset.fps, layout)[1]
    body = body or dataset.skeleton(sequence.clip)
    return decode_motion(
        features, body, dataset.fps, ground.astype(np.float32), dataset.reference_rotations, layout
    )


def continued(
    model: MotionModel,
    sequence: HeldOut,
    body: Skeleton,
    controls: Controls,
    frames: int,
    seed: int,
    progress: Callable[[int], None] | None = None,
) -> Array:
    """Return features (T, 276) that a model generates after the initial frames, sampled as in the paper.

    The skeleton control signal is that of `body`; controls are asked for every frame of the sequence, initial frames
    included, or one frame of them for all.
    """
    first, data = sequence.initial, sequence.data
    last = len(controls.type_weights) - 1

    def at(frame: int) -> Controls:
        return controls.at(slice(frame, frame + 1)) if last else controls

    state = RolloutState(model, 1, default_noise(model), seed)
    state.controls.set_skeletons([body])
    state.start(
        data.features[None, :first],
        data.contacts[None, :first],
        controls.type_weights[:1],
        data.ground[first - 1 : first],
        controls=lambda t, ground: at(t),
    )
    return run(state, frames, lambda t, ground: at(first - 1 + t), progress).features[0]
