"""How every model is tested: test sequences rolled out from their first frames with their own control signals.

Paper section 5.3. No foot IK, no reference poses, no corrections: frames are what the network predicts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.errors import MotionkitError
from motionkit.experiments.datasets import LEAST_TEST, is_dance
from motionkit.features.control import Controls, blend_types, future_trajectory, types_ahead
from motionkit.features.decode import decode_motion, integrate_ground
from motionkit.inference.noise import default_noise
from motionkit.inference.rollout import RolloutState, run
from motionkit.metrics.body_movement import body_movement
from motionkit.metrics.distribution import diversity, frechet_distance, window_features
from motionkit.metrics.report import evaluate_motion
from motionkit.metrics.value import MetricValue
from motionkit.models.model import MotionModel
from motionkit.models.parts import partition
from motionkit.motion.motion import Motion

INITIAL = (87, 30)  # the paper's numbers of initial frames; 30 for sequences too short for 87
LONGEST = 240  # frames that are made of a sequence; the paper makes whole ones, and 600 for its user study
METRICS = (
    "bm-euler",
    "bm-geodesic",
    "afs",
    "ssim-channel",
    "ssim-window",
    "mpjpe",
    "path-mean",
    "skate-ratio",
    "jerk",
    "l2p",
    "l2q",
    "npss",
)
LOWER = tuple(sorted({j for j in partition("two").parts[1].joints}))
UPPER = tuple(j for j in range(23) if j not in LOWER or j == 0)

# Continues a test sequence: its data, the number of initial frames, the number of frames to make.
Continue = Callable[["TestSequence", int], tuple[Array, float]]


@dataclass(frozen=True, eq=False)
class TestSequence:
    """A test sequence.

    Attributes:
        clip: which recording it is.
        data: its frames.
        initial: how many of them are given.
        frames: how many are to be made after them.
        kind: the type of most of these.
    """

    clip: Clip
    data: ClipData
    initial: int
    frames: int
    kind: str

    @property
    def dance(self) -> bool:
        """Whether it is a dance."""
        return is_dance(self.kind)


def sequences_of(dataset: Dataset, longest: int = LONGEST) -> list[TestSequence]:
    """Return the test sequences of a data set, cut to so many made frames."""
    out = []
    for clip in dataset.select("test"):
        data = dataset.read(clip)
        initial = next((n for n in INITIAL if clip.frames >= n + LEAST_TEST - INITIAL[-1]), INITIAL[-1])
        frames = min(longest, clip.frames - initial)
        kinds = np.bincount(data.types[initial : initial + frames])
        out.append(TestSequence(clip, data, initial, frames, dataset.types[int(kinds.argmax())]))
    return out


def sequence_controls(dataset: Dataset, sequence: TestSequence, model: MotionModel) -> Controls:
    """Return the control signals (T, ...) of a test sequence: its own types and trajectory."""
    data = sequence.data
    places = np.array([model.type_id(name) for name in dataset.types])
    weights = blend_types(places[data.types], len(model.types))
    trajectory = future_trajectory(data.ground, np.arange(len(data.types)))
    asked = Controls.of_types(weights).with_mask(1.0)
    return Controls(**vars(asked) | {"trajectory": trajectory, "types_ahead": types_ahead(weights)})


def model_continues(model: MotionModel, dataset: Dataset, seed: int) -> Continue:
    """Return what a model makes of a test sequence, drawn as the paper draws, on the performer's own body."""

    def continues(sequence: TestSequence, number: int) -> tuple[Array, float]:
        asked, first = sequence_controls(dataset, sequence, model), sequence.initial
        state = RolloutState(model, 1, default_noise(model), seed * 1009 + number)
        state.controls.set_skeletons([dataset.skeleton(sequence.clip)])
        state.start(
            sequence.data.features[None, :first],
            sequence.data.contacts[None, :first],
            asked.type_weights[:1],
            sequence.data.ground[first - 1 : first],
            controls=lambda t, ground: asked.at(slice(t, t + 1)),
        )
        began = time.perf_counter()
        made = run(state, sequence.frames, lambda t, ground: asked.at(slice(first - 1 + t, first + t)))
        return made.features[0], time.perf_counter() - began

    return continues


def decoded(dataset: Dataset, sequence: TestSequence, features: Array) -> Motion:
    """Return the motion of made features (T, 276) after the initial frames, on the performer's own body."""
    first, layout = sequence.initial, dataset.layout.version
    before = np.concatenate([sequence.data.features[first - 1 : first], features])
    ground = integrate_ground(before, sequence.data.ground[first - 1], dataset.fps, layout)[1]
    body = dataset.skeleton(sequence.clip)
    return decode_motion(
        features, body, dataset.fps, ground.astype(np.float32), dataset.reference_rotations, layout
    )


def truth_of(dataset: Dataset, sequence: TestSequence) -> Motion:
    """Return the recorded motion of the frames to make."""
    first = sequence.initial
    return decoded(dataset, sequence, sequence.data.features[first : first + sequence.frames])


def measure(
    dataset: Dataset, continues: Continue, sequences: list[TestSequence], progress: Callable[[float], None]
) -> tuple[dict[str, object], float]:
    """Measure what continues the test sequences.

    Returns:
        Values per sequence, and for the groups "all", "dance" and "non-dance" their means over frames; and the
        seconds a frame took.
    """
    rows, made_windows, true_windows = [], [], []
    seconds = 0.0
    for number, sequence in enumerate(sequences):
        features, took = continues(sequence, number)
        seconds += took
        motion, truth = decoded(dataset, sequence, features), truth_of(dataset, sequence)
        values = _values(motion, truth)
        rows.append(
            {
                "sequence": sequence.clip.name,
                "type": sequence.kind,
                "initial": sequence.initial,
                "frames": sequence.frames,
                "values": values,
            }
        )
        recorded = sequence.data.features[sequence.initial : sequence.initial + sequence.frames]
        made_windows.append(window_features(features, dataset.pose_embedding))
        true_windows.append(window_features(recorded, dataset.pose_embedding))
        progress((number + 1) / len(sequences))
    together, truths = np.concatenate(made_windows), np.concatenate(true_windows)
    groups: dict[str, object] = {
        name: means([r for r, s in zip(rows, sequences, strict=True) if of(s)])
        for name, of in (
            ("all", lambda s: True),
            ("dance", lambda s: s.dance),
            ("non-dance", lambda s: not s.dance),
        )
        if any(of(s) for s in sequences)
    }
    distribution = {
        "fid-pose": _of_sets(lambda: frechet_distance(together, truths)),
        "diversity": _of_sets(lambda: diversity(together)),
        "diversity-gt": _of_sets(lambda: diversity(truths)),
    }
    frames = sum(sequence.frames for sequence in sequences)
    return {"groups": groups, "distribution": distribution, "sequences": rows}, seconds / frames


def _of_sets(measured: Callable[[], MetricValue]) -> float | None:
    """A metric of sets; None where they are too small."""
    try:
        return _rounded(measured().value)
    except MotionkitError:
        return None


def _values(motion: Motion, truth: Motion) -> dict[str, list[float | None]]:
    """Return metric id to [made, recorded]; null where it cannot be measured."""
    report = evaluate_motion(motion, truth)
    out: dict[str, list[float | None]] = {}
    for row in report.rows:
        if row.id in METRICS:
            true = None if row.ground_truth is None else row.ground_truth.value
            out[row.id] = [_rounded(row.motion.value), _rounded(true)]
    for name, joints in (("bm-upper", UPPER), ("bm-lower", LOWER)):
        pair = (
            body_movement(each.local_rotations[:, list(joints)], "euler").value for each in (motion, truth)
        )
        out[name] = [_rounded(value) for value in pair]
    return out


def _rounded(value: float | None) -> float | None:
    """Six figures: more depends on the machine."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.6g}")


def means(rows: list[dict]) -> dict[str, list[float | None]]:
    """Return means over frames of [made, recorded] of each metric, from rows of sequences."""
    out: dict[str, list[float | None]] = {}
    for metric in rows[0]["values"]:
        pair: list[float | None] = []
        for side in (0, 1):
            known = [
                (r["values"][metric][side], r["frames"])
                for r in rows
                if r["values"][metric][side] is not None
            ]
            total = sum(frames for _, frames in known)
            pair.append(_rounded(sum(v * n for v, n in known) / total) if total else None)
        out[metric] = pair
    return out
