"""How every model is tested: test sequences rolled out from their first frames with their own control signals.

Paper section 5.3. No foot IK, no reference poses, no corrections: frames are what the network predicts.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import ClipData, Dataset
from motionkit.errors import MotionkitError
from motionkit.features.control import Controls, blend_types, future_trajectory, types_ahead
from motionkit.lab.classifier import Classifier, classified, described, train_classifier
from motionkit.lab.held_out import Continue, HeldOut, compared, decoded
from motionkit.lab.paper.datasets import is_dance
from motionkit.lab.statistics import rounded, weighted_mean
from motionkit.metrics.body import body_of
from motionkit.metrics.body_movement import body_movement
from motionkit.metrics.distribution import diversity, frechet_distance, window_features
from motionkit.metrics.value import MetricValue
from motionkit.models.model import MotionModel
from motionkit.models.parts import partition
from motionkit.motion.motion import Motion

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
    "jerk-peak",
    "jerk-area",
    "location-mean",
    "location-20",
    "location-50",
    "trajectory-50",
    "l2p",
    "l2q",
    "npss",
)
LOWER = tuple(sorted({j for j in partition("two").parts[1].joints}))
UPPER = tuple(j for j in range(23) if j not in LOWER or j == 0)


def sequence_controls(dataset: Dataset, sequence: HeldOut, model: MotionModel) -> Controls:
    """Return the control signals (T, ...) of a test sequence: its own types and trajectory."""
    places = np.array([model.type_id(name) for name in dataset.types])
    return recorded_controls(sequence.data, places, len(model.types))


def recorded_controls(data: ClipData, places: Array, count: int | None = None) -> Controls:
    """Return the control signals (T, ...) of a recording: its own types and trajectory.

    places are those of its type ids among the network's types, of which there are `count`, by default as many.
    """
    weights = blend_types(places[data.types], len(places) if count is None else count)
    trajectory = future_trajectory(data.ground, np.arange(len(data.types)))
    controls = Controls.of_types(weights).with_mask(1.0)
    return Controls(**vars(controls) | {"trajectory": trajectory, "types_ahead": types_ahead(weights)})


def truth_of(dataset: Dataset, sequence: HeldOut) -> Motion:
    """Return the recorded motion of the frames to make."""
    first = sequence.initial
    return decoded(dataset, sequence, sequence.data.features[first : first + sequence.frames])


def measure(
    dataset: Dataset, continues: Continue, sequences: list[HeldOut], progress: Callable[[float], None]
) -> dict[str, Any]:
    """Measure what continues the test sequences.

    Returns:
        Values per sequence, and for the groups "all", "dance" and "non-dance" their means over frames.
    """
    rows, made_windows, true_windows = [], [], []
    by_type: dict[str, list[Array]] = {}
    true_classes = []
    for number, sequence in enumerate(sequences):
        features = continues(sequence, number)
        motion, truth = decoded(dataset, sequence, features), truth_of(dataset, sequence)
        windows = described(body_of(motion)), described(body_of(truth))
        values = _values(motion, truth)
        values["class-accuracy"] = [_classified_as(dataset, sequence.kind, each) for each in windows]
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
        by_type.setdefault(sequence.kind, []).append(windows[0])
        true_classes.append(windows[1])
        progress((number + 1) / len(sequences))
    together, truths = np.concatenate(made_windows), np.concatenate(true_windows)
    groups: dict[str, object] = {
        name: means([r for r, s in zip(rows, sequences, strict=True) if of(s)])
        for name, of in (
            ("all", lambda s: True),
            ("dance", lambda s: is_dance(s.kind)),
            ("non-dance", lambda s: not is_dance(s.kind)),
        )
        if any(of(s) for s in sequences)
    }
    distribution = {
        "fid-pose": _of_sets(lambda: frechet_distance(together, truths)),
        "diversity": _of_sets(lambda: diversity(together)),
        "diversity-gt": _of_sets(lambda: diversity(truths)),
    }

    def of_classes(name: str) -> float | None:
        return _of_sets(lambda: classified(_classifier(dataset), by_type, true_classes)[name])

    distribution |= {name: of_classes(name) for name in ("class-accuracy", "fid-class")}
    return {"groups": groups, "distribution": distribution, "sequences": rows}


def _classified_as(dataset: Dataset, kind: str, windows: Array) -> float | None:
    """The share of windows that the dataset's classifier takes for a type; None without one, or without windows."""
    return _of_sets(lambda: classified(_classifier(dataset), {kind: [windows]}, [])["class-accuracy"])


@lru_cache(1)
def _classifier(dataset: Dataset) -> Classifier:
    """The classifier of a dataset; the runs of a command have the same one."""
    return train_classifier(dataset)


def _of_sets(measured: Callable[[], MetricValue]) -> float | None:
    """A metric of sets; None where they are too small."""
    try:
        return _rounded(measured().value)
    except MotionkitError:
        return None


def _values(motion: Motion, truth: Motion) -> dict[str, list[float | None]]:
    """Return metric id to [made, recorded]; null where it cannot be measured."""
    found = compared(motion, truth, METRICS)
    out = {metric: [_rounded(made), _rounded(real)] for metric, (made, real) in found.items()}
    for name, joints in (("bm-upper", UPPER), ("bm-lower", LOWER)):
        pair = (
            body_movement(each.local_rotations[:, list(joints)], "euler").value for each in (motion, truth)
        )
        out[name] = [_rounded(value) for value in pair]
    return out


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else rounded(value, 6)


def means(rows: list[dict]) -> dict[str, list[float | None]]:
    """Return means over frames of [made, recorded] of each metric, over the rows of sequences that have both.

    Metrics that recordings do not have at all are means of what was made.
    """
    out: dict[str, list[float | None]] = {}
    for metric in rows[0]["values"]:
        found = [(*r["values"][metric], r["frames"]) for r in rows]
        compared = any(real is not None for _, real, _ in found)
        found = [each for each in found if each[0] is not None and (each[1] is not None or not compared)]
        made, real = ([(each[side], each[2]) for each in found if each[side] is not None] for side in (0, 1))
        out[metric] = [_rounded(weighted_mean(each)) if each else None for each in (made, real)]
    return out
