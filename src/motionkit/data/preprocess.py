"""Folders of BVH files to a dataset folder, in two passes of constant memory.

The first pass reads, retargets, cleans and resamples each file and computes the mean rotation of every joint. The
second pass encodes the files relative to these means and writes the arrays. Both distribute files over processes.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motionkit import __version__
from motionkit.arrays import Array
from motionkit.data.checking import MAX_TYPES
from motionkit.data.cleaning import clean
from motionkit.data.dataset import FORMAT, Clip, ClipData, mirror_clip
from motionkit.data.folder import MANIFEST, MOTIONS, ArrayWriter, may_replace, put_in_place, staging_folder
from motionkit.data.glitches import cut_at_leaps, find_leaps
from motionkit.data.labels import Segment, SourceFile, beyond_end, find_sources, mirrored_type
from motionkit.data.level import floor_tilts, footfalls, levelled, performer
from motionkit.data.phases import PhaseRule, phase_rules, phase_track
from motionkit.data.smoothing import smooth, smooth_rotations
from motionkit.data.twins import mirrored_types, type_poses
from motionkit.data.workers import Map, worker_processes
from motionkit.errors import DatasetError, MotionkitError
from motionkit.features.control import TRAJECTORY_COUNT, future_trajectory
from motionkit.features.encode import encode_motion, identity_reference_rotations
from motionkit.features.layout import DEFAULT_LAYOUT, FEATURE_COUNT, feature_layout
from motionkit.features.normalize import RunningMoments, Scaling, feature_scaling, trajectory_scaling
from motionkit.features.reference import REFERENCE_COUNT
from motionkit.files import MAX_TEXT_BYTES, read_bytes
from motionkit.motion.bvh_text import MAX_BYTES
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.retarget import retarget_file
from motionkit.motion.rotations import mean_rotation
from motionkit.motion.skeleton import JOINT_COUNT, MIRROR_JOINTS, canonical_skeleton

FPS = 60.0
MIN_CLIP_FRAMES = 16
TEST_SHARE = 0.15  # of the clips of a type, if the labels have no split
# Of the files with training clips of a type, at least one; a type of fewer files spares none.
VALIDATION_SHARE, VALIDATION_FILES = 0.1, 4


@dataclass(frozen=True, eq=False)
class PreprocessOptions:
    """The options of preprocess; the command's help describes them.

    reference_rotations (23, 4) are those of the model that training is to begin from; by default the mean rotations
    of the data itself. held_out names the splits that clips are taken for, where labels do not say.
    """

    labels: Path | None = None
    fps: float | None = None
    scale: float | None = None
    mirror: bool = True
    own_bodies: bool = False
    layout: str = DEFAULT_LAYOUT
    jobs: int = 0
    strict: bool = False
    smooth: bool = True
    level: bool = True
    reference_rotations: Array | None = None
    held_out: tuple[str, ...] = ("validation", "test")


@dataclass
class FileReport:
    """The result for one file; skipped is why it was not used, fault whether the file is invalid."""

    name: str
    clips: int = 0
    frames: int = 0
    skipped: str = ""
    fault: bool = False
    mapping: dict[str, Any] = field(default_factory=dict)
    cleaning: dict[str, Any] = field(default_factory=dict)
    leaps: int = 0
    sha256: str = ""
    labels: str = ""  # what is wrong with them


@dataclass
class PreprocessReport:
    """The result of preprocess(); notes are about leftovers of an interrupted run, and labels that look wrong."""

    folder: Path
    labels: Path | None
    files: list[FileReport]
    types: dict[str, dict[str, float]]
    clips: int
    seconds: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Prepared:
    """The first pass's result for a file; the arrays are in motion_file.

    body is the skeleton of the motion; own_body has the performer's bone lengths; poses are some of each type;
    footfalls, (F, 3) for each toe, are where it stands.
    """

    report: FileReport
    motion_file: str
    runs: tuple[
        tuple[int, int, tuple[tuple[int, int, str], ...], str, str], ...
    ]  # start, end, spans, split, subject
    body: list[list[float]]
    own_body: list[list[float]]
    moment: np.ndarray | None
    poses: dict[str, np.ndarray] = field(default_factory=dict)
    footfalls: tuple[np.ndarray, ...] = ()


def preprocess(
    folders: Sequence[str | Path],
    output: str | Path,
    options: PreprocessOptions | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> PreprocessReport:
    """Make a dataset folder from BVH files, atomically.

    Args:
        folders: folders (or files) to read.
        output: dataset folder to write; an old dataset there is replaced, other files in it are kept.
        options: the defaults if None.
        progress: called with a stage name, the number of files done and of all files.

    Raises:
        DatasetError: no file is usable, a file is inside output, or, with strict, a file is unusable.
    """
    options = options or PreprocessOptions()
    output = Path(output)
    target = Path(os.path.realpath(output))  # write through a link, do not replace it
    if not may_replace(target):
        raise DatasetError(f"{output}: exists and is not a dataset folder; choose another folder")
    sources, table = find_sources([Path(f) for f in folders], options.labels)
    for path in [*map(Path, folders), *(source.path for source in sources)]:
        if Path(os.path.realpath(path)).is_relative_to(target):
            raise DatasetError(f"{path}: is inside the output folder {output}; choose another output folder")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with staging_folder(target) as (staging, notes):
            with _processes(options.jobs, len(sources)) as each:
                prepared = _pass_one(sources, staging, options, each, progress)
                manifest, report = _pass_two(prepared, staging, options, each, progress)
            _write_manifest(staging / MANIFEST, manifest)
            _drop_motions(prepared, staging)
            os.chmod(staging, 0o755)
            put_in_place(staging, target)
        doubts = [f"warning: {file.name}: {file.labels}" for file in report.files if file.labels]
        report.folder, report.labels, report.notes = output, table, (*notes, *doubts)
        return report
    except OSError as error:
        raise DatasetError(f"{output}: cannot be written ({error.strerror or error})") from None
    except BrokenProcessPool:
        raise DatasetError(
            f"{output}: a worker process was killed (out of memory?); try fewer --jobs"
        ) from None


def _write_manifest(path: Path, manifest: dict[str, Any]) -> None:
    """Write the manifest; raises DatasetError if Dataset could not read it."""
    try:
        text = json.dumps(manifest, allow_nan=False)
    except ValueError:
        raise DatasetError(f"{path.name}: the data gives values that are not finite") from None
    if len(text) > MAX_TEXT_BYTES:
        raise DatasetError(
            f"{path.name}: larger than {MAX_TEXT_BYTES >> 20} MB; make several smaller datasets"
        )
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _drop_motions(prepared: list[_Prepared], staging: Path) -> None:
    for item in prepared:
        Path(item.motion_file).unlink(missing_ok=True)
    (staging / MOTIONS).rmdir()


# With fewer files per process, starting a process takes longer than it saves.
_FILES_PER_PROCESS = 40


@contextmanager
def _processes(jobs: int, files: int) -> Iterator[Map]:
    """A map over files; one pool of processes serves both passes if it is worth starting."""
    wanted = jobs if jobs > 0 else min(os.cpu_count() or 1, files // _FILES_PER_PROCESS)
    with worker_processes(wanted) as each:
        yield each


# ---- pass one: read, map, clean, resample, cut ----


def _pass_one(
    sources: list[SourceFile],
    staging: Path,
    options: PreprocessOptions,
    each: Map,
    progress: Callable[[str, int, int], None] | None,
) -> list[_Prepared]:
    (staging / MOTIONS).mkdir()
    items = [(source, str(staging / MOTIONS / f"{i}.npz"), options) for i, source in enumerate(sources)]
    prepared = []
    for done, result in enumerate(each(_prepare_file, items), 1):
        if options.strict and result.report.fault:
            raise DatasetError(f"{result.report.skipped} (stopped by --strict)")
        prepared.append(result)
        if progress:
            progress("reading", done, len(items))
    if not any(p.runs for p in prepared):
        reasons = Counter(p.report.skipped for p in prepared)
        raise DatasetError(
            f"none of the {len(prepared)} files is usable; most common reason: {reasons.most_common(1)[0][0]}"
        )
    return prepared


def _prepare_file(item: tuple[SourceFile, str, PreprocessOptions]) -> _Prepared:
    source, motion_file, options = item
    report = FileReport(source.name)
    nothing: tuple = ()
    if source.skip_reason:
        report.skipped = source.skip_reason
        return _Prepared(report, motion_file, nothing, [], [], None)
    try:
        fps = options.fps or next((s.fps for s in source.segments if s.fps), None)
        motion, mapping = retarget_file(source.path, options.scale, fps, options.own_bodies, plant=True)
        report.labels = beyond_end(source.segments, len(motion))
        motion, cleaning = clean(motion)
        native_fps = motion.fps
        motion = resample(motion, FPS)
        report.sha256 = hashlib.sha256(read_bytes(source.path, MAX_BYTES)).hexdigest()
    except MotionkitError as error:
        report.skipped, report.fault = str(error), True
        return _Prepared(report, motion_file, nothing, [], [], None)
    report.mapping = {
        "source_joints": mapping.source_joints,
        "missing": list(mapping.missing),
        "scale": mapping.scale,
        "scale_source": mapping.scale_source,
        "leg_length": mapping.leg_length,
        "notes": list(mapping.notes),
    }
    report.cleaning = asdict(cleaning)
    leaps = find_leaps(motion_kinematics(motion)[1])
    report.leaps = len(leaps)
    runs = _runs(source.segments, cleaning.lead_in, native_fps, len(motion), leaps)
    if not runs:
        report.skipped = f"{source.path}: no labelled stretch of at least {MIN_CLIP_FRAMES} frames at 60 fps"
        return _Prepared(report, motion_file, nothing, [], [], None)
    np.savez(motion_file, rotations=motion.local_rotations, root=motion.root_positions)
    rows = np.concatenate([np.arange(start, end) for start, end, *_ in runs])
    quats = motion.local_rotations.astype(np.float64)[rows]
    moment = np.einsum("tja,tjb->jab", quats, quats)
    body, own_body = motion.skeleton.offsets.tolist(), mapping.body.tolist()
    spans = [span for run in runs for span in run[2]]
    poses, falls = type_poses(motion, spans), footfalls(motion)
    return _Prepared(report, motion_file, runs, body, own_body, moment, poses, falls)


def _runs(segments: Sequence[Segment], lead_in: int, fps: float, frames: int, leaps: list[int]) -> tuple:
    """Stretches of 60 fps frames without gaps and leaps, each with its typed spans, split and subject.

    Adjacent segments stay together, so that the model learns from real transitions.
    """
    out: list[tuple[int, int, list[tuple[int, int, str]], str, str]] = []
    for segment in segments:
        first = max(0, int(np.ceil((segment.start - lead_in) * FPS / fps - 1e-6)))
        last = frames if segment.end < 0 else int(np.floor((segment.end - lead_in) * FPS / fps + 1e-6))
        for start, end in cut_at_leaps(first, min(frames, last), leaps):
            if out and out[-1][1] >= start - 1 and out[-1][3] == segment.split and start not in leaps:
                start = out[-1][1]
                out[-1][2].append((start, end, segment.type))
                out[-1] = (out[-1][0], end, *out[-1][2:])
            else:
                out.append((start, end, [(start, end, segment.type)], segment.split, segment.subject))
    return tuple(
        (a, b, tuple(spans), split, subject)
        for a, b, spans, split, subject in out
        if b - a >= MIN_CLIP_FRAMES
    )


# ---- splits ----


def _decide_splits(
    prepared: list[_Prepared], mirror: bool, twin_types: Mapping[str, str], test: bool
) -> dict[tuple[int, int], str]:
    """Choose a split for each (file, run) without one; with test, whole clips of each type are held out for testing.

    A type with a single clip gets "mirror": the clip is for training and its mirror image for testing, or, for about
    half of such clips, the reverse (paper section 3). The mirror image of a one-sided type has another type, so its
    single clip is for training.
    """
    open_runs: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for i, item in enumerate(prepared):
        for r, (_, _, spans, split, _) in enumerate(item.runs):
            if not split:
                longest = max(spans, key=lambda s: s[1] - s[0])
                open_runs[longest[2]].append((i, r))
    out: dict[tuple[int, int], str] = {}
    if not test:
        return {key: "train" for keys in open_runs.values() for key in keys}
    for kind in sorted(open_runs):
        keys = sorted(open_runs[kind], key=lambda k: _hashed(f"{prepared[k[0]].report.name}{k[1]}"))
        if len(keys) == 1:
            i, r = keys[0]
            same = all(twin_types[shown] == shown for _, _, shown in prepared[i].runs[r][2])
            out[keys[0]] = "mirror" if mirror and same else "train"
            continue
        held = max(1, round(TEST_SHARE * len(keys)))
        out.update({key: "test" if n < held else "train" for n, key in enumerate(keys)})
    return out


def _hold_out_validation(prepared: list[_Prepared], splits: dict[tuple[int, int], str]) -> None:
    """Take clips for validation out of the training clips, type by type; changes splits.

    All training clips of a type in one file go together, because parts of one take are alike. Files are picked by a
    hash of their names, so the choice does not change with the order of files or with other types. Nothing is done if
    the labels name validation clips.
    """
    if any(run[3] == "validation" for item in prepared for run in item.runs):
        return
    files: dict[str, dict[int, list[tuple[int, int]]]] = defaultdict(lambda: defaultdict(list))
    for i, item in enumerate(prepared):
        for r, (_, _, spans, split, _) in enumerate(item.runs):
            if (split or splits[i, r]) == "train":
                longest = max(spans, key=lambda s: s[1] - s[0])
                files[longest[2]][i].append((i, r))
    for kind in sorted(files):
        if len(files[kind]) < VALIDATION_FILES:
            continue
        order = sorted(files[kind], key=lambda i: _hashed(f"validation {kind} {prepared[i].report.name}"))
        for i in order[: max(1, round(VALIDATION_SHARE * len(order)))]:
            splits.update(dict.fromkeys(files[kind][i], "validation"))


def _hashed(text: str) -> bytes:
    """A number that depends on a text alone, to pick clips by."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).digest()


# ---- pass two: encode and write ----


def _pass_two(
    prepared: list[_Prepared],
    staging: Path,
    options: PreprocessOptions,
    each: Map,
    progress: Callable[[str, int, int], None] | None,
) -> tuple[dict[str, Any], PreprocessReport]:
    given = options.reference_rotations
    if options.layout == "expmap-root-1":  # the paper's features have plain exponential maps
        given = identity_reference_rotations()
    reference_rotations = _references(prepared) if given is None else given.astype(np.float32)
    types = tuple(sorted({kind for p in prepared for run in p.runs for _, _, kind in run[2]}))
    twin_types = mirrored_types(types, _all_poses(prepared))
    splits = _decide_splits(prepared, options.mirror, twin_types, "test" in options.held_out)
    if "validation" in options.held_out:
        _hold_out_validation(prepared, splits)
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
    report = PreprocessReport(
        staging,
        None,
        [p.report for p in prepared],
        _type_table(clips, kinds, types, twin_types),
        len(clips),
        total / FPS,
    )
    return manifest, report


def _performer(item: _Prepared) -> str:
    return performer((subject for *_, subject in item.runs), np.array(item.own_body))


def _all_poses(prepared: list[_Prepared]) -> dict[str, np.ndarray]:
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


def _characters(prepared: list[_Prepared], own_bodies: bool) -> dict[str, list[list[float]]]:
    """The body (23, 3) in cm of each performer named in the labels, from the performer's first file.

    Without such names, the distinct bodies that the dataset keeps.
    """
    out: dict[str, list[list[float]]] = {}
    for item in prepared:
        for *_, subject in item.runs:
            if subject:
                out.setdefault(f"subject-{subject}", _rounded(item.own_body))
    if not out and own_bodies:
        kept: list[list[list[float]]] = []
        for item in prepared:
            if item.runs and _rounded(item.own_body) not in kept:
                kept.append(_rounded(item.own_body))
        out = {f"body-{i}": body for i, body in enumerate(kept, 1)}
    return out


def _rounded(body: list[list[float]]) -> list[list[float]]:
    return [[round(x, 3) for x in row] for row in body]


def _references(prepared: list[_Prepared]) -> Array:
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
    item: tuple[_Prepared, Array, str, bool, Array],
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
        if hashlib.sha256(clip.name.encode("utf-8", "surrogateescape")).digest()[0] % 2:
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
