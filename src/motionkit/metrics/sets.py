"""Metrics of sets of motions: how the generated ones are distributed compared with the recorded ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.features.reference import fit_pose_embedding
from motionkit.metrics.distribution import diversity, frechet_distance, window_features
from motionkit.metrics.report import MetricRow
from motionkit.metrics.value import FRAME_RATE, MetricValue, measured
from motionkit.motion.motion import Motion, resample
from motionkit.rig.canonical import load_canonical

EMBEDDED_IN: dict[str, float | str] = {"features": "pose embedding of the ground truth"}


def set_metrics(truths: Iterable[Motion], made: Iterable[Motion]) -> tuple[MetricRow, ...]:
    """Measure "fid-pose" and "diversity" of sets of motions on the canonical joints, in cm.

    The pose embedding is fitted to the ground truth (features/reference.py). So values are comparable between models
    that are measured against the same recordings. Motions are taken one by one; features of the ground truth stay in
    memory.

    Returns:
        Rows whose ground truth is the set of recordings. If a set has fewer than two windows, rows have a reason
        instead of a value.
    """
    recorded = list(_features(truths))
    frames = np.concatenate(recorded)
    embedding = fit_pose_embedding(frames, np.ones(len(frames), np.float32), feature_layout(DEFAULT_LAYOUT))
    real, drawn = (
        np.concatenate([window_features(each, embedding) for each in features])
        for features in (recorded, _features(made))
    )
    distance = _value("fid-pose", lambda: frechet_distance(drawn, real))
    return (
        MetricRow(distance, MetricValue("fid-pose", 0.0, "", distance.parameters)),
        MetricRow(
            _value("diversity", lambda: diversity(drawn)), _value("diversity", lambda: diversity(real))
        ),
    )


def set_metrics_of_files(
    pairs: Sequence[tuple[Path, Path]],
    scales: tuple[float | None, float | None] = (None, None),
    rates: tuple[float | None, float | None] = (None, None),
    skip: int = 0,
    given: int = 0,
    frames: Sequence[int] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[MetricRow, ...]:
    """Measure sets of files of any rig, in pairs (ground truth, generated); arguments as for evaluate_files.

    frames are those of each pair that are compared, all by default. progress is called with the number of files read,
    up to twice the number of pairs.
    """
    starts = skip + given, skip

    def motions(side: int) -> Iterator[Motion]:
        for number, pair in enumerate(pairs, side * len(pairs) + 1):
            whole = resample(load_canonical(pair[side], scales[side], rates[side])[0], FRAME_RATE)
            end = len(whole) if frames is None else starts[side] + frames[number - side * len(pairs) - 1]
            yield whole.cut(starts[side], end)
            progress(number)

    return set_metrics(motions(0), motions(1))


def _features(motions: Iterable[Motion]) -> Iterator[Array]:
    return (encode_motion(resample(each, FRAME_RATE)).features for each in motions)


def _value(name: str, measure: Callable[[], MetricValue]) -> MetricValue:
    (value,) = measured(measure, {name: ""})
    return value if value.value is None else replace(value, parameters=value.parameters | EMBEDDED_IN)
