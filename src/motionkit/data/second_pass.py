"""The second pass: motions are encoded relative to the mean rotations of all, and the arrays are written."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.data.checking import MAX_TYPES
from motionkit.data.dataset import FORMAT, Clip, ClipData, mirror_clip
from motionkit.data.first_pass import FPS, Prepared
from motionkit.data.folder import ArrayWriter
from motionkit.data.labels import mirrored_type
from motionkit.data.level import floor_tilts, levelled, performer
from motionkit.data.options import PreprocessOptions
from motionkit.data.phases import PhaseRule, phase_rules, phase_track
from motionkit.data.smoothing import smooth, smooth_rotations
from motionkit.data.splits import decide_splits, hashed, hold_out_validation
from motionkit.data.twins import mirrored_types
from motionkit.data.workers import Map
from motionkit.errors import DatasetError
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.features.encode import encode_motion, identity_reference_rotations
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.features.normalize import RunningMoments, Scaling, feature_scaling, trajectory_scaling
from motionkit.features.reference import REFERENCE_COUNT
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import mean_rotation
from motionkit.motion.skeleton import JOINT_COUNT, MIRROR_JOINTS, canonical_skeleton
from motionkit.version import __version__


def write_arrays(
    prepared: list[Prepared],
    staging: Path,
    options: PreprocessOptions,
    each: Map,
    progress: Callable[[str, int, int], None] | None,
) -> tuple[dict[str, Any], dict[str, dict[str, float]]]:
    """Write the arrays of a dataset to a folder; returns its manifest and the table of its types."""
    given = options.reference_rotations
    if options.layout == "expmap-root-1":  # the paper's features have plain exponential maps
        given = identity_reference_rotations()
    reference_rotations = _references(prepared) if given is None else given.astype(np.float32)
    types = tuple(sorted({kind for p in prepared for run in p.runs for _, _, kind in run.spans}))
    twin_types = mirrored_types(types, _all_poses(prepared))
    splits = decide_splits(prepared, options.mirror, twin_types, "test" in options.held_out)
    if "validation" in options.held_out:
        hold_out_validation(prepared, splits)
    total = sum(end - start for p in prepared for start, end, *_ in p.runs)
    if len(types) > MAX_TYPES:
        raise DatasetError(f"{len(types)} motion types, expected at most {MAX_TYPES}")
    layout = feature_layout(options.layout)
    moments, trajectory_moments = RunningMoments(FEATURE_COUNT), RunningMoments(TRAJECTORY_COUNT)
    clips: list[Clip] = []
    bodies: list[list[list[float]]] = []
    row = 0
    levels = options.level and options.smooth
    tilts = floor_tilts((_performer(p), p.footfalls) for p in prepared if p.runs) if levels else {}
    items = [
        (p, reference_rotations, options.layout, options.smooth, tilts.get(_performer(p), np.zeros(2)))
        for p in prepared
        if p.runs
    ]
    for item, *_, tilt in items:
        item.report.cleaning["tilt"] = [round(float(slope), 4) for slope in tilt]
    indices = [i for i, p in enumerate(prepared) if p.runs]
    with _array_writers(staging, total) as writers:
        for done, (index, encoded) in enumerate(zip(indices, each(_encode_file, items), strict=True), 1):
            item = prepared[index]
            if item.body not in bodies:
                bodies.append(item.body)
            for r, (run, data) in enumerate(zip(item.runs, encoded, strict=True)):
                start, end, spans, split, subject = run
                frames = end - start
                kinds = np.concatenate([np.full(b - a, types.index(kind), np.int16) for a, b, kind in spans])
                for name, values in zip(
                    ("features", "contacts", "ground", "types"), (*data, kinds), strict=True
                ):
                    writers[name].append(values)
                name = f"{item.report.name}:{r}" if len(item.runs) > 1 else item.report.name
                clip = Clip(
                    name, row, frames, splits.get((index, r), split), subject, bodies.index(item.body)
                )
                twins = _with_twin(clip, spans, twin_types, options.mirror)
                clips.extend(twins)
                _add_moments(twins, data, kinds, layout, moments, trajectory_moments)
                row += frames
                item.report.clips += 1
                item.report.frames += frames
            if progress:
                progress("encoding", done, len(items))
        features, kinds = writers["features"].close(), writers["types"].close()
        rules = _write_phases(writers["phases"], features, kinds, clips, options.layout)
        for name in ("contacts", "ground", "phases"):
            writers[name].close()
    manifest = {
        "format": FORMAT,
        "motionkit": __version__,
        "fps": FPS,
        "layout": options.layout,
        "types": list(types),
        "smoothed": options.smooth,
        "phase_seconds": {types[kind]: round(rule.frames / FPS, 3) for kind, rule in sorted(rules.items())},
        "phase_events": {types[kind]: rule.event for kind, rule in sorted(rules.items())},
        **({"mirrored_types": found} if (found := _found_by_motion(twin_types)) else {}),
        "bodies": bodies,
        "characters": _characters(prepared, options.own_bodies),
        "references": reference_rotations.tolist(),
        "feature_scaling": _plain(feature_scaling(moments, layout)),
        "trajectory_scaling": _plain(trajectory_scaling(trajectory_moments)),
        "clips": [asdict(clip) for clip in clips],
        "files": [asdict(p.report) for p in prepared],
    }
    return manifest, _type_table(clips, kinds, types, twin_types)


def _performer(item: Prepared) -> str:
    return performer((run.subject for run in item.runs), np.array(item.own_body))


def _all_poses(prepared: list[Prepared]) -> dict[str, np.ndarray]:
    """Poses of each type in all files."""
    parts: dict[str, list[np.ndarray]] = defaultdict(list)
    for item in prepared:
        for kind, poses in item.poses.items():
            parts[kind].append(poses)
    return {kind: np.concatenate(found) for kind, found in parts.items()}


def _found_by_motion(twin_types: Mapping[str, str]) -> dict[str, str]:
    """The types whose mirror image is a type that no name tells."""
    return {kind: other for kind, other in twin_types.items() if other != mirrored_type(kind)}


def _write_phases(
    phases: ArrayWriter, features: np.ndarray, types: np.ndarray, clips: list[Clip], layout: str
) -> dict[int, PhaseRule]:
    """Write the phase column, clip by clip in row order; returns the rule of each type with a phase."""
    rows = {clip.start: slice(clip.start, clip.start + clip.frames) for clip in clips}.values()

    def shown() -> Iterator[tuple[Array, np.ndarray]]:
        for r in rows:
            yield np.array(features[r]), np.array(types[r])

    rules = phase_rules(shown(), layout)
    for poses, kinds in shown():
        phases.append(phase_track(poses, kinds, rules, layout))
    return rules


def _characters(prepared: list[Prepared], own_bodies: bool) -> dict[str, list[list[float]]]:
    """The body (23, 3) in cm of each performer named in the labels, from the performer's first file.

    Without such names, the distinct bodies that the dataset keeps.
    """
    out: dict[str, list[list[float]]] = {}
    for item in prepared:
        for run in item.runs:
            if run.subject:
                out.setdefault(f"subject-{run.subject}", _rounded(item.own_body))
    if not out and own_bodies:
        kept: list[list[list[float]]] = []
        for item in prepared:
            if item.runs and _rounded(item.own_body) not in kept:
                kept.append(_rounded(item.own_body))
        out = {f"body-{i}": body for i, body in enumerate(kept, 1)}
    return out


def _rounded(body: list[list[float]]) -> list[list[float]]:
    return [[round(x, 3) for x in row] for row in body]


def _references(prepared: list[Prepared]) -> Array:
    """Mean rotation of each joint over the data and its mirror image, so that twins have mirrored means."""
    moment = np.sum([p.moment for p in prepared if p.moment is not None], axis=0)
    flip = np.diag([1.0, 1.0, -1.0, -1.0])
    moment = moment + flip @ moment[list(MIRROR_JOINTS)] @ flip
    reference_rotations = mean_rotation(moment).astype(np.float32)
    assert reference_rotations.shape == (JOINT_COUNT, 4)
    return reference_rotations


@contextmanager
def _array_writers(folder: Path, rows: int) -> Iterator[dict[str, ArrayWriter]]:
    """A writer for each array of the dataset, with this many rows; all are closed at the end."""
    kinds: dict[str, tuple[tuple[int, ...], type]] = {
        "features": ((rows, FEATURE_COUNT), np.float32),
        "contacts": ((rows, 4), np.uint8),
        "ground": ((rows, 3), np.float32),
        "types": ((rows,), np.int16),
        "phases": ((rows,), np.float32),
    }
    writers: dict[str, ArrayWriter] = {}
    try:
        for name, (shape, dtype) in kinds.items():
            writers[name] = ArrayWriter(folder, name, shape, dtype)
        yield writers
    finally:
        for writer in writers.values():
            writer.abandon()


def _encode_file(
    item: tuple[Prepared, Array, str, bool, Array],
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Features, contacts and ground of each run, encoded from the whole recording so that ends have neighbours."""
    prepared, reference_rotations, layout, smoothed, tilt = item
    with np.load(prepared.motion_file, allow_pickle=False) as arrays:
        rotations, root = arrays["rotations"], arrays["root"]
    for start, end, *_ in prepared.runs if smoothed else ():
        # Run by run, so that frames cut out between runs have no effect.
        rotations[start:end] = smooth_rotations(rotations[start:end])
        root[start:end] = smooth(root[start:end])
    skeleton = canonical_skeleton(np.array(prepared.body, np.float32))
    motion = levelled(Motion(skeleton, rotations, root, FPS), tilt)
    encoded = encode_motion(motion, reference_rotations, layout)
    return [
        (
            encoded.features[start:end],
            encoded.contacts[start:end].astype(np.uint8),
            encoded.ground[start:end],
        )
        for start, end, *_ in prepared.runs
    ]


def _with_twin(
    clip: Clip, spans: Sequence[tuple[int, int, str]], twin_types: Mapping[str, str], mirror: bool
) -> list[Clip]:
    """The clip and, if it has one, its mirrored twin."""
    base = asdict(clip)
    twin = {**base, "name": clip.name + " (mirrored)", "mirrored": True}
    if clip.split == "mirror":
        trains, tests = {**base, "split": "train"}, {**twin, "split": "test"}
        if hashed(clip.name)[0] % 2:
            trains, tests = {**twin, "split": "train"}, {**base, "split": "test"}
        return [Clip(**trains), Clip(**tests)]
    # The mirror image of a one-sided type has no correct label if the data lacks the other side.
    known = all(twin_types[kind] in twin_types for _, _, kind in spans)
    if clip.split == "train" and mirror and known:
        return [clip, Clip(**twin)]
    return [clip]


def _add_moments(
    clips: list[Clip],
    data: tuple[np.ndarray, np.ndarray, np.ndarray],
    kinds: np.ndarray,
    layout: Any,
    moments: RunningMoments,
    trajectory_moments: RunningMoments,
) -> None:
    features, contacts, ground = data
    plain = ClipData(
        features,
        contacts.astype(np.float32),
        ground,
        kinds.astype(np.int64),
        np.zeros(len(kinds), np.float32),
        np.zeros((len(kinds), REFERENCE_COUNT), np.float32),
    )
    for clip in clips:
        if clip.split != "train":
            continue
        shown = plain
        if clip.mirrored:
            count = int(kinds.max()) + 1
            shown = mirror_clip(plain, layout, np.arange(count), np.zeros(count, bool))
        moments.add(shown.features)
        trajectory_moments.add(future_trajectory(shown.ground, np.arange(clip.frames)))


def _plain(scaling: Scaling) -> dict[str, list[float]]:
    return {"mean": scaling.mean.tolist(), "std": scaling.std.tolist()}


def _type_table(
    clips: list[Clip], types_array: np.ndarray, types: Sequence[str], twin_types: Mapping[str, str]
) -> dict[str, dict[str, float]]:
    """For each type: number of clips, mirrored, validation and test clips, and seconds of recordings in each split."""
    table = {
        k: {
            "clips": 0,
            "mirrored": 0,
            "validation_clips": 0,
            "test_clips": 0,
            "train_seconds": 0.0,
            "validation_seconds": 0.0,
            "test_seconds": 0.0,
        }
        for k in types
    }
    trained: set[int] = set()  # first rows of counted clips: a clip and its twin are one recording
    for clip in clips:
        counted = clip.start in trained
        if clip.split == "train":
            trained.add(clip.start)
        kinds, counts = np.unique(types_array[clip.start : clip.start + clip.frames], return_counts=True)
        for kind, count in zip(kinds, counts, strict=True):
            name = types[kind]
            if clip.mirrored:
                shown = twin_types[name]
                row = table[shown if shown in table else name]
                row["mirrored"] += 1
            else:
                row = table[name]
                row["clips"] += 1
            if clip.split != "train":
                row[f"{clip.split}_clips"] += 1
                row[f"{clip.split}_seconds"] += float(count) / FPS
            elif not counted:
                row["train_seconds"] += float(count) / FPS
    return table
