"""Looks at a folder of BVH files before training: what each clip is, how much there is of each type, what looks wrong.

Nothing here goes by the names of types: a clip is compared with the others of its type, by poses, speed and flights.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.data.cleaning import clean
from motionkit.data.events import jumps_of
from motionkit.data.glitches import find_leaps
from motionkit.data.labels import Segment, SourceFile, find_sources
from motionkit.data.level import floor_tilts, footfalls, performer
from motionkit.data.repeat import FEW_SECONDS as REPEATED_BELOW
from motionkit.data.repeat import LEAST_FRAMES
from motionkit.errors import MotionkitError
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.retarget import RetargetReport, retarget_file
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import JOINT_COUNT

FPS = 60.0
MIN_FRAMES = 16  # of a labelled stretch
FEW_SECONDS = 10.0  # of a type; it is learnt badly from less
# A type leaves the ground if this share of its clips does; the others are then suspect.
MOST = 0.6
# A type falls into two groups if their centres are this many times as far apart as clips are from their own centre,
# and at least so far (cm per joint); likewise a clip is like another type if it is so much nearer to its centre.
APART, FAR = 2.5, 6.0
NEARER = 0.5
SPEED_SCALE = 10.0  # cm/s over the ground that count as 1 cm per joint


@dataclass(frozen=True)
class ClipFacts:
    """What one file is.

    Attributes:
        name: the file, below the folder.
        types: motion types of its labelled stretches.
        seconds: length of these stretches.
        fps: the file's own rate.
        rig: number of joints and the name of the first one.
        unit: the unit, and how it was determined.
        up: the axis that points up.
        floor: cm by which the motion had to be raised to stand on the floor.
        glitches: repaired pops, and leaps that cut the clip.
        tilt: slopes (2,) of the floor along x and z that the performer's clips show, in cm per cm.
        notes: missing joints, rest-pose differences and the like.
        fault: why the file cannot be used; empty if it can.
    """

    name: str
    types: tuple[str, ...] = ()
    seconds: float = 0.0
    fps: float = 0.0
    rig: str = ""
    unit: str = ""
    up: str = "Y"
    floor: float = 0.0
    glitches: int = 0
    tilt: tuple[float, float] = (0.0, 0.0)
    notes: tuple[str, ...] = ()
    fault: str = ""


@dataclass(frozen=True)
class TypeFacts:
    """What there is of one type: clips, seconds, mean speed over the ground (cm/s), share of clips with flights."""

    name: str
    clips: int
    seconds: float
    speed: float
    flights: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """All files and types of a folder, and the label table used, if any."""

    clips: tuple[ClipFacts, ...]
    types: tuple[TypeFacts, ...]
    labels: Path | None
    warnings: tuple[str, ...] = field(default=())


@dataclass(frozen=True, eq=False)
class _Shown:
    """One stretch of a type: clip, seconds, speed, whether it leaves the ground, where its poses are (D,), split."""

    clip: str
    seconds: float
    speed: float
    flies: bool
    place: Array
    split: str


@dataclass(frozen=True, eq=False)
class _Standing:
    """Where the toes of a clip stand, (F, 3) each, and whose they are."""

    performer: str
    footfalls: tuple[Array, ...]


def diagnose(
    folders: Sequence[str | Path],
    labels: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Diagnosis:
    """Look at BVH files and folders of them.

    Args:
        labels: label table; found beside the files by default, else types are folder and file names.
        progress: called with the number of files done and of all files.

    Raises:
        DatasetError: there are no BVH files, or the label table is invalid.
    """
    sources, table = find_sources([Path(folder) for folder in folders], labels)
    clips: list[ClipFacts] = []
    standing: list[_Standing | None] = []
    shown: dict[str, list[_Shown]] = defaultdict(list)
    for done, source in enumerate(sources, 1):
        facts, stretches, stands = _look(source)
        clips.append(facts)
        standing.append(stands)
        for kind, stretch in stretches:
            shown[kind].append(stretch)
        if progress:
            progress(done, len(sources))
    types = tuple(_type_facts(kind, shown) for kind in sorted(shown))
    rigs = sorted({clip.rig for clip in clips if clip.rig})
    warnings = [f"{len(rigs)} different rigs: {', '.join(rigs[:6])}"] if len(rigs) > 1 else []
    clips = _with_tilts(clips, standing)
    tilted = [clip for clip in clips if any(clip.tilt)]
    if tilted:
        steepest = 100.0 * max(math.hypot(*clip.tilt) for clip in tilted)
        warnings.append(
            f"the floor under {_listed([clip.name for clip in tilted])} rises by up to {steepest:.1f} cm a metre; "
            "preprocess levels it"
        )
    return Diagnosis(tuple(clips), types, table, tuple(warnings))


def _with_tilts(clips: list[ClipFacts], standing: list[_Standing | None]) -> list[ClipFacts]:
    """The clips with the tilt of the floor under their performers."""
    tilts = floor_tilts((stands.performer, stands.footfalls) for stands in standing if stands is not None)
    return [
        clip if stands is None else replace(clip, tilt=tuple(tilts[stands.performer].round(4).tolist()))
        for clip, stands in zip(clips, standing, strict=True)
    ]


def _look(source: SourceFile) -> tuple[ClipFacts, list[tuple[str, _Shown]], _Standing | None]:
    """The facts of a file, its stretches by type, and where its toes stand."""
    if source.skip_reason:
        return ClipFacts(source.name, fault=source.skip_reason), [], None
    try:
        fps = next((s.fps for s in source.segments if s.fps), None)
        motion, rig = retarget_file(source.path, fps=fps)
        cleaned, cleaning = clean(motion)
    except MotionkitError as error:
        return ClipFacts(source.name, fault=str(error)), [], None
    whole = resample(cleaned, FPS)
    leaps = find_leaps(motion_kinematics(whole)[1])
    stretches = []
    for segment in source.segments:
        part = _cut(whole, segment, cleaning.lead_in, motion.fps)
        if len(part) >= MIN_FRAMES:
            stretches.append((segment.type, _describe(source.name, part, segment.split)))
    seconds = sum(stretch.seconds for _, stretch in stretches)
    fault = "" if stretches else f"{source.path}: no labelled stretch of at least {MIN_FRAMES} frames"
    facts = ClipFacts(
        source.name,
        tuple(dict.fromkeys(segment.type for segment in source.segments)),
        seconds,
        motion.fps,
        f"{rig.source_joints} joints, {next(iter(rig.mapped.values()), '')}",
        rig.scale_source,
        _up(rig),
        cleaning.floor_shift,
        len(cleaning.pops) + len(leaps),
        notes=(*((f"no {', '.join(rig.missing)}",) if rig.missing else ()), *rig.notes, *cleaning.notes),
        fault=fault,
    )
    whose = performer((segment.subject for segment in source.segments), rig.body)
    return facts, stretches, _Standing(whose, footfalls(whole)) if stretches else None


def _up(rig: RetargetReport) -> str:
    """The file's up axis, from the note that retargeting leaves where it is not +Y."""
    return next((note.split()[2] for note in rig.notes if note.startswith("up axis ")), "Y")


def _cut(motion: Motion, segment: Segment, lead_in: int, fps: float) -> Motion:
    """The frames of a segment, which counts the file's own frames, in a motion at FPS without the lead-in."""
    first = max(0, round((segment.start - lead_in) * FPS / fps))
    last = len(motion) if segment.end < 0 else round((segment.end - lead_in) * FPS / fps)
    return motion.cut(min(first, len(motion)), max(first, min(last, len(motion))))


def _describe(name: str, motion: Motion, split: str) -> _Shown:
    layout = feature_layout(DEFAULT_LAYOUT)
    features = encode_motion(motion, quat_identity((JOINT_COUNT,)), DEFAULT_LAYOUT).features
    poses = features[:, layout.blocks["joint_positions"]]
    velocity = features[:, layout.blocks["root_xz_velocity"]].mean(axis=0)
    # In cm per joint: where the joints are, how far they go from there, and how the body moves over the ground.
    scale = np.float32(JOINT_COUNT**-0.5)
    place = np.concatenate([poses.mean(axis=0) * scale, poses.std(axis=0) * scale, velocity / SPEED_SCALE])
    return _Shown(
        name,
        len(motion) / FPS,
        float(np.linalg.norm(np.diff(motion.root_positions[:, [0, 2]], axis=0), axis=1).mean()) * FPS,
        bool(jumps_of(features, layout)),
        place,
        split,
    )


def _type_facts(kind: str, shown: dict[str, list[_Shown]]) -> TypeFacts:
    mine = shown[kind]
    seconds = sum(stretch.seconds for stretch in mine)
    flights = sum(stretch.flies for stretch in mine) / len(mine)
    warnings = []
    if all(stretch.split in ("test", "validation") for stretch in mine):
        warnings.append("all its clips are held out, so that there is none to learn from")
    elif len(mine) == 1:
        warnings.append("one clip only, which will be memorized; give it several")
    if seconds < LEAST_FRAMES / FPS:
        warnings.append(f"{seconds:.1f} s in all, expected at least {LEAST_FRAMES / FPS:g} s to learn from")
    elif seconds < REPEATED_BELOW:
        warnings.append(
            f"{seconds:.1f} s in all; training repeats steps and poses, but more would be learnt better"
        )
    elif seconds < FEW_SECONDS:
        warnings.append(f"{seconds:.1f} s in all; more would be learnt better")
    grounded = [stretch.clip for stretch in mine if not stretch.flies]
    if flights >= MOST and grounded:
        warnings.append(f"most clips leave the ground, but not {_listed(grounded)}")
    groups = two_groups(np.stack([stretch.place for stretch in mine])) if len(mine) >= 4 else None
    if groups is not None:
        warnings.append(
            f"its clips fall into two groups: {_listed([mine[i].clip for i in groups])} differ from the others"
        )
    warnings += _misplaced(kind, shown)
    speed = sum(stretch.speed * stretch.seconds for stretch in mine) / max(seconds, 1e-6)
    return TypeFacts(kind, len(mine), seconds, speed, flights, tuple(warnings))


def two_groups(places: Array) -> list[int] | None:
    """The smaller of two groups of clips that lie far apart, as indices; None for clips that belong together.

    Args:
        places: (N, D) where each clip's poses are.
    """
    spread = np.linalg.norm(places[:, None] - places, axis=-1)
    ends = np.unravel_index(int(spread.argmax()), spread.shape)
    centres = places[list(ends)]
    for _ in range(20):
        nearest = np.linalg.norm(places[:, None] - centres, axis=-1).argmin(axis=1)
        if len(np.unique(nearest)) < 2:
            return None
        centres = np.stack([places[nearest == side].mean(axis=0) for side in (0, 1)])
    within = float(np.linalg.norm(places - centres[nearest], axis=1).mean())
    apart = float(np.linalg.norm(centres[0] - centres[1]))
    if apart < FAR or apart < APART * within:
        return None
    small = int((nearest == 1).sum() < (nearest == 0).sum())
    return np.flatnonzero(nearest == small).tolist()


def _misplaced(kind: str, shown: dict[str, list[_Shown]]) -> list[str]:
    """A line for each other type that clips of this one are like, more than like their own."""
    centres = {
        name: np.mean([stretch.place for stretch in stretches], axis=0)
        for name, stretches in shown.items()
        if name != kind and len(stretches) > 1
    }
    mine = shown[kind]
    if len(mine) < 3 or not centres:
        return []
    found: dict[str, list[str]] = defaultdict(list)
    for number, stretch in enumerate(mine):
        others = np.mean([each.place for i, each in enumerate(mine) if i != number], axis=0)
        own = float(np.linalg.norm(stretch.place - others))
        nearest = min(centres, key=lambda name: float(np.linalg.norm(stretch.place - centres[name])))
        if own > FAR and float(np.linalg.norm(stretch.place - centres[nearest])) < NEARER * own:
            found[nearest].append(stretch.clip)
    return [f"{_listed(clips)} move like {other!r}" for other, clips in found.items()]


def _listed(clips: list[str]) -> str:
    rest = f" and {len(clips) - 3} more" if len(clips) > 3 else ""
    return ", ".join(dict.fromkeys(clips[:3])) + rest
