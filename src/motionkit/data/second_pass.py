"""The second pass: encode all motions relative to their mean rotations, and write the arrays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.data.checking import ARRAY_KINDS
from motionkit.data.dataset import FORMAT, MIRRORED, Clip, ClipData, mirror_clip
from motionkit.data.first_pass import FPS, Prepared, Run
from motionkit.data.folder import ArrayWriter
from motionkit.data.labels import mirrored_type
from motionkit.data.level import floor_tilts, levelled, performer
from motionkit.data.mirror_types import mirrored_types
from motionkit.data.options import PreprocessOptions
from motionkit.data.phases import PhaseRule, phase_rules, phase_track
from motionkit.data.smoothing import smooth, smooth_rotations
from motionkit.data.splits import decide_splits, hashed, hold_out_validation
from motionkit.data.workers import Map
from motionkit.errors import DatasetError
from motionkit.features.control import MOST_TYPES, TRAJECTORY_COUNT, future_trajectory
from motionkit.features.encode import encode_motion, identity_reference_rotations
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.features.normalize import RunningMoments, Scaling, feature_scaling, trajectory_scaling
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import mean_rotation
from motionkit.motion.skeleton import JOINT_COUNT, MIRROR_JOINTS, canonical_skeleton
from motionkit.version import __version__


@dataclass(frozen=True, eq=False)
class _Plan:
    """Decisions that need all files, made before the first file is encoded.

    Attributes:
        references: (23, 4) reference rotations, which exponential maps are relative to.
        splits: split of each (file, run) that the labels leave undecided.
        tilts: (2,) slopes of each performer's floor; empty if floors are not levelled.
    """

    options: PreprocessOptions
    references: Array
    types: tuple[str, ...]
    mirror_types: dict[str, str]
    splits: dict[tuple[int, int], str]
    tilts: dict[str, Array]


def _plan(files: list[Prepared], options: PreprocessOptions) -> _Plan:
    """Choose reference rotations, types, splits and tilts; raises DatasetError for too many types."""
    rotations = options.reference_rotations
    if options.layout == "expmap-root-1":  # the paper's exponential maps are relative to the identity
        rotations = identity_reference_rotations()
    references = _references(files) if rotations is None else rotations.astype(np.float32)
    types = tuple(sorted({kind for p in files for run in p.runs for _, _, kind in run.spans}))
    if len(types) > MOST_TYPES:
        raise DatasetError(f"{len(types)} motion types, expected at most {MOST_TYPES}")
    mirror_types = mirrored_types(types, _all_poses(files))
    splits = decide_splits(files, options.mirror, mirror_types, "test" in options.held_out)
    if "validation" in options.held_out:
        hold_out_validation(files, splits)
    levels = options.level and options.smooth
    tilts = floor_tilts((_performer(p), p.footfalls) for p in files) if levels else {}
    return _Plan(options, references, types, mirror_types, splits, tilts)


class _Clips:
    """The clips written so far, their bodies, and the moments of the training clips."""

    def __init__(self, plan: _Plan) -> None:
        self.plan = plan
        self.clips: list[Clip] = []
        self.bodies: list[list[list[float]]] = []
        self.rows = 0
        self.features, self.trajectories = RunningMoments(FEATURE_COUNT), RunningMoments(TRAJECTORY_COUNT)

    def add(self, run: Run, name: str, split: str, body: list[list[float]], data: ClipData) -> None:
        """Add a run as a clip, and its mirrored clip if it gets one."""
        if body not in self.bodies:
            self.bodies.append(body)
        frames = run.end - run.start
        clip = Clip(name, self.rows, frames, split, run.subject, self.bodies.index(body))
        self.rows += frames
        for each in _with_mirrored(clip, run.spans, self.plan.mirror_types, self.plan.options.mirror):
            self.clips.append(each)
            if each.split == "train":
                self._add_moments(data, each.mirrored)

    def _add_moments(self, data: ClipData, mirrored: bool) -> None:
        if mirrored:
            count = len(self.plan.types)
            layout = feature_layout(self.plan.options.layout)
            data = mirror_clip(data, layout, np.arange(count), np.zeros(count, bool))
        self.features.add(data.features)
        self.trajectories.add(future_trajectory(data.ground, np.arange(len(data.types))))


def write_arrays(
    prepared: list[Prepared],
    staging: Path,
    options: PreprocessOptions,
    each: Map,
    progress: Callable[[str, int, int], None] | None,
) -> tuple[dict[str, Any], dict[str, dict[str, float]]]:
    """Write the arrays of a dataset to a folder; returns its manifest and its table of types."""
    files = [p for p in prepared if p.runs]
    plan = _plan(files, options)
    written = _Clips(plan)
    common = plan.references, plan.types, options
    items = [(p, plan.tilts.get(_performer(p), np.zeros(2)), *common) for p in files]
    for item, tilt, *_ in items:
        item.report.cleaning["tilt"] = [round(float(slope), 4) for slope in tilt]
    rows = sum(run.end - run.start for p in files for run in p.runs)
    with _array_writers(staging, rows) as writers:
        for done, encoded in enumerate(each(_encode_file, items), 1):
            item = files[done - 1]
            for number, (run, data) in enumerate(zip(item.runs, encoded, strict=True)):
                for name in ("features", "contacts", "ground", "types"):
                    writers[name].append(getattr(data, name))
                name = f"{item.report.name}:{number}" if len(item.runs) > 1 else item.report.name
                split = plan.splits.get((done - 1, number), run.split)
                written.add(run, name, split, item.body, data)
                item.report.clips += 1
                item.report.frames += run.end - run.start
            if progress:
                progress("encoding", done, len(items))
        features, kinds = writers["features"].close(), writers["types"].close()
        rules = _write_phases(writers["phases"], features, kinds, written.clips, options.layout)
        for name in ("contacts", "ground", "phases"):
            writers[name].close()
    return _manifest(prepared, written, rules), _type_table(
        written.clips, kinds, plan.types, plan.mirror_types
    )


def _manifest(prepared: list[Prepared], written: _Clips, rules: dict[int, PhaseRule]) -> dict[str, Any]:
    plan = written.plan
    return {
        "format": FORMAT,
        "motionkit": __version__,
        "fps": FPS,
        "layout": plan.options.layout,
        "types": list(plan.types),
        "smoothed": plan.options.smooth,
        "levelled": plan.options.level and plan.options.smooth,
        "phase_seconds": {plan.types[k]: round(rule.frames / FPS, 3) for k, rule in sorted(rules.items())},
        "phase_events": {plan.types[k]: rule.event for k, rule in sorted(rules.items())},
        **({"mirrored_types": found} if (found := _found_by_motion(plan.mirror_types)) else {}),
        "bodies": written.bodies,
        "characters": _characters(prepared, plan.options.own_bodies),
        "references": plan.references.tolist(),
        "feature_scaling": _plain(feature_scaling(written.features, feature_layout(plan.options.layout))),
        "trajectory_scaling": _plain(trajectory_scaling(written.trajectories)),
        "clips": [asdict(clip) for clip in written.clips],
        "files": [asdict(p.report) for p in prepared],
    }


def _performer(item: Prepared) -> str:
    return performer((run.subject for run in item.runs), np.array(item.own_body))


def _all_poses(prepared: list[Prepared]) -> dict[str, np.ndarray]:
    """Poses of each type in all files."""
    parts: dict[str, list[np.ndarray]] = defaultdict(list)
    for item in prepared:
        for kind, poses in item.poses.items():
            parts[kind].append(poses)
    return {kind: np.concatenate(found) for kind, found in parts.items()}


def _found_by_motion(mirror_types: Mapping[str, str]) -> dict[str, str]:
    """The types whose mirror image was found by motion, because its name does not follow from the type's name."""
    return {kind: other for kind, other in mirror_types.items() if other != mirrored_type(kind)}


def _write_phases(
    phases: ArrayWriter, features: np.ndarray, types: np.ndarray, clips: list[Clip], layout: str
) -> dict[int, PhaseRule]:
    """Write the phases, clip by clip in row order; returns the rule of each type with a phase."""
    rows = {clip.start: slice(clip.start, clip.start + clip.frames) for clip in clips}.values()

    def clips_of_rows() -> Iterator[tuple[Array, np.ndarray]]:
        for r in rows:
            yield np.array(features[r]), np.array(types[r])

    rules = phase_rules(clips_of_rows(), layout)
    for poses, kinds in clips_of_rows():
        phases.append(phase_track(poses, kinds, rules, layout))
    return rules


def _characters(prepared: list[Prepared], own_bodies: bool) -> dict[str, list[list[float]]]:
    """Offsets (23, 3) in cm of each performer named in the labels, from the performer's first file.

    If no performer is named and bodies are kept, the distinct bodies of the files.
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
    """Mean rotations (23, 4) over the data and its mirror image, so that left and right joints have mirrored means."""
    moment = np.sum([p.moment for p in prepared if p.moment is not None], axis=0)
    flip = np.diag([1.0, 1.0, -1.0, -1.0])
    moment = moment + flip @ moment[list(MIRROR_JOINTS)] @ flip
    reference_rotations = mean_rotation(moment).astype(np.float32)
    assert reference_rotations.shape == (JOINT_COUNT, 4)
    return reference_rotations


@contextmanager
def _array_writers(folder: Path, rows: int) -> Iterator[dict[str, ArrayWriter]]:
    """A writer for each array of the dataset, with this many rows; all are closed when the block ends."""
    writers: dict[str, ArrayWriter] = {}
    try:
        for name, (columns, dtype, *_) in ARRAY_KINDS.items():
            writers[name] = ArrayWriter(folder, name, (rows, *columns), dtype)
        yield writers
    finally:
        for writer in writers.values():
            writer.abandon()


def _encode_file(item: tuple[Prepared, Array, Array, tuple[str, ...], PreprocessOptions]) -> list[ClipData]:
    """The data of each run of a file, smoothed, levelled and encoded.

    The whole recording is encoded at once, so that velocities at the ends of a run have neighbouring frames.
    """
    prepared, tilt, references, types, options = item
    with np.load(prepared.motion_file, allow_pickle=False) as arrays:
        rotations, root = arrays["rotations"], arrays["root"]
    for start, end, *_ in prepared.runs if options.smooth else ():
        # Run by run, so that frames between runs, which are left out, have no effect.
        rotations[start:end] = smooth_rotations(rotations[start:end])
        root[start:end] = smooth(root[start:end])
    skeleton = canonical_skeleton(np.array(prepared.body, np.float32))
    motion = levelled(Motion(skeleton, rotations, root, FPS), tilt)
    encoded = encode_motion(motion, references, options.layout)
    kinds = [
        np.concatenate([np.full(b - a, types.index(kind), np.int64) for a, b, kind in run.spans])
        for run in prepared.runs
    ]
    return [
        ClipData.plain(encoded.features[a:b], encoded.contacts[a:b], encoded.ground[a:b], of_run)
        for (a, b, *_), of_run in zip(prepared.runs, kinds, strict=True)
    ]


def _with_mirrored(
    clip: Clip, spans: Sequence[tuple[int, int, str]], mirror_types: Mapping[str, str], mirror: bool
) -> list[Clip]:
    """The clip, and its mirrored clip if it gets one."""
    base = asdict(clip)
    image = {**base, "name": clip.name + MIRRORED, "mirrored": True}
    if clip.split == "mirror":
        trains, tests = {**base, "split": "train"}, {**image, "split": "test"}
        recording = clip.name.rpartition(":")[0] or clip.name  # all runs of a file go the same way
        if hashed(recording)[0] % 2:
            trains, tests = {**image, "split": "train"}, {**base, "split": "test"}
        return [Clip(**trains), Clip(**tests)]
    # If the data lacks the type of the other side, the mirror image has no correct label.
    known = all(mirror_types[kind] in mirror_types for _, _, kind in spans)
    if clip.split == "train" and mirror and known:
        return [clip, Clip(**image)]
    return [clip]


def _plain(scaling: Scaling) -> dict[str, list[float]]:
    return {"mean": scaling.mean.tolist(), "std": scaling.std.tolist()}


def _type_table(
    clips: list[Clip], types_array: np.ndarray, types: Sequence[str], mirror_types: Mapping[str, str]
) -> dict[str, dict[str, float]]:
    """For each type: numbers of clips, of mirrored and of held-out clips, and seconds recorded in each split."""
    held_out, splits = ("validation", "test"), ("train", "validation", "test")
    table: dict[str, dict[str, float]] = {
        kind: {"clips": 0, "mirrored": 0}
        | {f"{split}_clips": 0 for split in held_out}
        | {f"{split}_seconds": 0.0 for split in splits}
        for kind in types
    }
    trained: set[int] = set()  # first rows of counted clips: a clip and its mirrored clip are one recording
    for clip in clips:
        counted = clip.start in trained
        if clip.split == "train":
            trained.add(clip.start)
        kinds, counts = np.unique(types_array[clip.start : clip.start + clip.frames], return_counts=True)
        for kind, count in zip(kinds, counts, strict=True):
            name = types[kind]
            if clip.mirrored:
                mirror = mirror_types[name]
                row = table[mirror if mirror in table else name]
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
