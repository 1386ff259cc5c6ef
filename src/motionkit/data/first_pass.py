"""The first pass over BVH files: read, retarget, clean, resample, and cut into stretches of labelled frames."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from motionkit.data.cleaning import CleaningReport, clean, cut_at_leaps, find_leaps
from motionkit.data.folder import MOTIONS
from motionkit.data.labels import Segment, SourceFile, beyond_end
from motionkit.data.level import footfalls
from motionkit.data.mirror_types import type_poses
from motionkit.data.options import PreprocessOptions
from motionkit.data.workers import Map
from motionkit.errors import DatasetError, MotionkitError
from motionkit.files import read_bytes
from motionkit.motion.bvh_text import MAX_BYTES
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.reading import reading
from motionkit.rig.retarget import RetargetReport, retarget_file

FPS = 60.0
MIN_CLIP_FRAMES = 16
NO_STRETCH = f"no stretch of it has {MIN_CLIP_FRAMES} frames at {FPS:g} fps"


@dataclass
class FileReport:
    """The result for one file.

    Attributes:
        skipped: why the file is not used; "" if it is.
        leaps: number of discontinuities at which the motion was cut.
        starts: first frame of each clip in the cleaned motion at FPS.
        notes: what was repaired to read it.
    """

    name: str
    clips: int = 0
    frames: int = 0
    skipped: str = ""
    fault: bool = False
    mapping: dict[str, Any] = field(default_factory=dict)
    cleaning: dict[str, Any] = field(default_factory=dict)
    leaps: int = 0
    starts: tuple[int, ...] = ()
    sha256: str = ""
    labels: str = ""
    notes: tuple[str, ...] = ()


class Run(NamedTuple):
    """A stretch of a file at 60 fps without gaps, which becomes a clip.

    spans are (first frame, end, type); split and subject are "" if the labels have none.
    """

    start: int
    end: int
    spans: tuple[tuple[int, int, str], ...]
    split: str
    subject: str

    @property
    def main_type(self) -> str:
        """The type of the longest span."""
        return max(self.spans, key=lambda span: span[1] - span[0])[2]


@dataclass(frozen=True, eq=False)
class Prepared:
    """The first pass's result for a file; the motion itself is in motion_file.

    Attributes:
        body: offsets (23, 3) in cm of the motion's skeleton.
        own_body: the same with the performer's bone lengths.
        moment: (23, 4, 4) sum of the outer products of the quaternions, for the mean rotations.
        footfalls: (F, 3) places in cm where each toe stands.
    """

    report: FileReport
    motion_file: str
    runs: tuple[Run, ...]
    body: list[list[float]]
    own_body: list[list[float]]
    moment: np.ndarray | None
    poses: dict[str, np.ndarray] = field(default_factory=dict)
    footfalls: tuple[np.ndarray, ...] = ()


def read_files(
    sources: list[SourceFile],
    staging: Path,
    options: PreprocessOptions,
    each: Map,
    progress: Callable[[str, int, int], None] | None,
) -> list[Prepared]:
    """Prepare all files; raises DatasetError if none is usable, or with options.strict if one is not."""
    (staging / MOTIONS).mkdir()
    items = [(source, str(staging / MOTIONS / f"{i}.npz"), options) for i, source in enumerate(sources)]
    prepared = []
    for done, result in enumerate(each(prepare_file, items), 1):
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


@dataclass(frozen=True, eq=False)
class Reading:
    """A file's motion, retargeted to the canonical joints and cleaned.

    Attributes:
        motion: at FPS, without the frames that cleaning cut off.
        fps, frames: rate and length of the file itself.
        leaps: first frame of the motion after each discontinuity.
        notes: what was repaired to read the file.
    """

    motion: Motion
    rig: RetargetReport
    cleaning: CleaningReport
    fps: float
    frames: int
    leaps: list[int]
    notes: tuple[str, ...] = ()

    def place(self, segment: Segment, whole: bool = True) -> tuple[int, int]:
        """First and last frame (exclusive) of the motion in a segment, which counts frames of the file.

        Frames that are partly outside the segment are left out if whole; otherwise ends are rounded to the nearest.
        """
        begin, end = ((at - self.cleaning.lead_in) * FPS / self.fps for at in (segment.start, segment.end))
        first = math.ceil(begin - 1e-6) if whole else round(begin)
        last = math.floor(end + 1e-6) if whole else round(end)
        first, last = max(0, first), len(self.motion) if segment.end < 0 else min(last, len(self.motion))
        return first, max(first, last)


def read_source(source: SourceFile, options: PreprocessOptions, plant: bool = True) -> Reading:
    """Read, retarget (plant as there), clean and resample a file; raises BvhError or SkeletonError."""
    fps = next((s.fps for s in source.segments if s.fps), options.fps)
    notes: list[str] = []
    with reading(strict=options.strict or None, on_note=notes.append):
        motion, rig = retarget_file(source.path, options.scale, fps, options.own_bodies, plant, source.clip)
    cleaned, cleaning = clean(motion)
    whole = resample(cleaned, FPS)
    leaps = find_leaps(motion_kinematics(whole)[1])
    return Reading(whole, rig, cleaning, motion.fps, len(motion), leaps, tuple(notes))


def file_hash(path: Path) -> str:
    """The SHA-256 of a file of motion, by which a dataset knows it; raises MotionkitError like read_bytes."""
    return hashlib.sha256(read_bytes(path, MAX_BYTES)).hexdigest()


def prepare_file(item: tuple[SourceFile, str, PreprocessOptions]) -> Prepared:
    """Prepare one file and write its motion to motion_file."""
    source, motion_file, options = item
    report = FileReport(source.name)
    if source.skip_reason:
        report.skipped = source.skip_reason
        return Prepared(report, motion_file, (), [], [], None)
    try:
        found = read_source(source, options)
        report.labels = beyond_end(source.segments, found.frames)
        report.sha256 = file_hash(source.path)
    except MotionkitError as error:
        report.skipped, report.fault = str(error), True
        return Prepared(report, motion_file, (), [], [], None)
    motion, rig, report.notes = found.motion, found.rig, found.notes
    report.mapping = {
        "source_joints": rig.source_joints,
        "missing": list(rig.missing),
        "scale": rig.scale,
        "scale_source": rig.scale_source,
        "leg_length": rig.leg_length,
        "notes": list(rig.notes),
    }
    report.cleaning = asdict(found.cleaning)
    report.leaps = len(found.leaps)
    runs = runs_of(source.segments, found)
    if not runs:
        report.skipped = f"{source.path}: no labelled stretch of at least {MIN_CLIP_FRAMES} frames at 60 fps"
        return Prepared(report, motion_file, (), [], [], None)
    report.starts = tuple(run.start for run in runs)
    np.savez(motion_file, rotations=motion.local_rotations, root=motion.root_positions)
    rows = np.concatenate([np.arange(start, end) for start, end, *_ in runs])
    quats = motion.local_rotations.astype(np.float64)[rows]
    moment = np.einsum("tja,tjb->jab", quats, quats)
    body, own_body = motion.skeleton.offsets.tolist(), rig.body.tolist()
    spans = [span for run in runs for span in run.spans]
    poses, falls = type_poses(motion, spans), footfalls(motion)
    return Prepared(report, motion_file, runs, body, own_body, moment, poses, falls)


def runs_of(segments: Sequence[Segment], found: Reading) -> tuple[Run, ...]:
    """Stretches of a motion without gaps and discontinuities, of at least MIN_CLIP_FRAMES frames.

    Adjacent segments stay together, so that the model learns real transitions between types.
    """
    runs: list[Run] = []
    for segment in segments:
        for start, end in cut_at_leaps(*found.place(segment), found.leaps):
            before = runs[-1] if runs else None
            whose = (segment.split, segment.subject)
            goes_on = before and before.end >= start - 1 and start not in found.leaps
            if before and goes_on and (before.split, before.subject) == whose:
                spans = (*before.spans, (before.end, end, segment.type))
                runs[-1] = before._replace(end=end, spans=spans)
            else:
                runs.append(Run(start, end, ((start, end, segment.type),), segment.split, segment.subject))
    return tuple(run for run in runs if run.end - run.start >= MIN_CLIP_FRAMES)
