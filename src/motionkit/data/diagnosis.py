"""Describes a folder of BVH files before training: facts of each clip, amounts of each type, and warnings.

Names of types are not interpreted. A clip is compared with the others of its type by poses, speed and flights.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.data.events import frames_in_the_air
from motionkit.data.first_pass import FPS, MIN_CLIP_FRAMES, NO_STRETCH, read_source, runs_of
from motionkit.data.labels import BEYOND_END, SourceFile, beyond_end, find_sources, mirrored_type
from motionkit.data.level import floor_tilts, footfalls, performer
from motionkit.data.options import PreprocessOptions
from motionkit.data.phases import PhaseStretch, phase_rule, phase_stretch
from motionkit.data.repeat import FEW_SECONDS as REPEATED_BELOW
from motionkit.data.repeat import LEAST_FRAMES
from motionkit.data.workers import processes_for, worker_processes
from motionkit.errors import MotionkitError
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_COUNT
from motionkit.rig.retarget import RetargetReport

FEW_SECONDS = 10.0  # a type with less motion gets a warning
# If this share of a type's clips leave the ground, the others get a warning.
MOST = 0.6
# Two groups of clips are separate if their centres are APART times further apart than clips are from their own centre,
# and at least FAR (cm per joint).
APART, FAR = 2.5, 6.0
GROUPED = 6  # fewest clips of a type that are searched for two groups
# A clip looks like another type if the distance to that type's centre is below this share of the distance to its own
# type's centre, and the latter exceeds FAR.
NEARER = 0.5
POSE_FRAMES = 3  # a file with as many frames or fewer is a pose
POSE = "a pose, too short to train on"  # the note on it
HELD_OUT = ("validation", "test")
SPEED_SCALE = 10.0  # cm/s over the ground that weigh as much as 1 cm per joint


@dataclass(frozen=True)
class ClipFacts:
    """Facts about one file.

    Attributes:
        seconds: length of these stretches.
        rig: number of joints and the name of the first one.
        unit: the unit, and how it was determined.
        floor: cm by which the motion was raised to stand on the floor.
        glitches: number of repaired pops, and of discontinuities at which the clip is cut.
        tilt: slopes (2,) of the performer's floor along x and z, in cm per cm.
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
    """Facts about one type.

    Attributes:
        clips, seconds: number of its stretches, and their length.
        flights: share of the clips that leave the ground.
        in_the_air: share of the time spent in flights of at least a sixth of a second.
        unlearnable: why training cannot learn the type, and what to do; empty if it can.
        warnings: what looks wrong, unlearnable included.
    """

    name: str
    clips: int
    seconds: float
    speed: float
    flights: float
    in_the_air: float
    unlearnable: str = ""
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """Facts about all files and types of a folder, what looks wrong with it, and skipped files with the reason."""

    clips: tuple[ClipFacts, ...]
    types: tuple[TypeFacts, ...]
    labels: Path | None
    warnings: tuple[str, ...] = field(default=())
    skipped: tuple[str, ...] = ()

    @property
    def lines(self) -> list[str]:
        """All warnings and notes, as lines to print."""
        types = [(kind, line) for kind in self.types for line in kind.warnings]
        notes = [f"note: {kind.name}: {line}" for kind in self.types for line in kind.notes]
        warnings = [*self.warnings, *(f"{kind.name}: {line}" for kind, line in types)]
        return [*(f"warning: {line}" for line in warnings), *notes]


@dataclass(frozen=True, eq=False)
class _Stretch:
    """One stretch of a type in a clip: its split in the labels, kicks, punches and jumps, and seconds in the air.

    speed is over the ground in cm/s; place (D,) describes poses and velocity, in cm per joint.
    """

    clip: str
    seconds: float
    speed: float
    flying: float
    place: Array
    split: str
    moves: PhaseStretch

    @property
    def trains(self) -> bool:
        return self.split not in HELD_OUT


Standing = tuple[str, tuple[Array, ...]]  # performer, and footfalls (F, 3) of each toe in a clip


def diagnose(
    folders: Sequence[str | Path],
    labels: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    jobs: int = 1,
) -> Diagnosis:
    """Describe BVH files and folders of them; types are those of a label table, by default one beside the files.

    Without any, types come from folder and file names. progress is called with the number of files done and of all.
    jobs is the number of processes; 0 chooses it by cores and files.

    Raises:
        DatasetError: there are no BVH files, or the label table is invalid.
    """
    sources, table = find_sources([Path(folder) for folder in folders], labels)
    clips: list[ClipFacts] = []
    skipped = [f"{source.name}: {source.skip_reason}" for source in sources if source.skip_reason]
    standing: list[Standing | None] = []
    by_type: dict[str, list[_Stretch]] = defaultdict(list)
    listed = [source for source in sources if not source.skip_reason]
    with worker_processes(processes_for(len(listed), jobs)) as each:
        for facts, stretches, footfalls in each(_look, listed):
            clips.append(facts)
            standing.append(footfalls)
            for kind, stretch in stretches:
                by_type[kind].append(stretch)
            if progress:
                progress(len(clips), len(listed))
    sides = {kind: _one_side(stretches) for kind, stretches in by_type.items()}
    types = tuple(_type_facts(kind, by_type, sides) for kind in sorted(by_type))
    rigs = sorted({clip.rig for clip in clips if clip.rig})
    warnings = [f"{len(rigs)} different rigs: {'; '.join(rigs[:6])}"] if len(rigs) > 1 else []
    clips = _with_tilts(clips, standing)
    tilted = [clip for clip in clips if any(clip.tilt)]
    if tilted:
        steepest = 100.0 * max(math.hypot(*clip.tilt) for clip in tilted)
        warnings.append(
            f"the floor under {_listed([clip.name for clip in tilted])} rises by up to {steepest:.1f} cm a metre; "
            "preprocess levels it"
        )
    named = {kind for clip in clips if not clip.fault and POSE not in clip.notes for kind in clip.types}
    warnings += [f"{kind}: {NO_STRETCH}; give it longer clips" for kind in sorted(named - by_type.keys())]
    warnings += [
        f"{clip.name}: {note}" for clip in clips for note in clip.notes if note.startswith(BEYOND_END)
    ]
    return Diagnosis(tuple(clips), types, table, tuple(warnings), tuple(skipped))


def _with_tilts(clips: list[ClipFacts], standing: list[Standing | None]) -> list[ClipFacts]:
    """The clips with their floor's tilt filled in."""
    tilts = floor_tilts(filter(None, standing))
    return [
        clip if footfalls is None else replace(clip, tilt=tuple(tilts[footfalls[0]].round(4).tolist()))
        for clip, footfalls in zip(clips, standing, strict=True)
    ]


def _look(source: SourceFile) -> tuple[ClipFacts, list[tuple[str, _Stretch]], Standing | None]:
    """The facts of a file, its stretches by type, and its footfalls."""
    try:
        reading = read_source(source, PreprocessOptions(), plant=False)
    except MotionkitError as error:
        return ClipFacts(source.name, fault=str(error)), [], None
    rig, cleaning = reading.rig, reading.cleaning
    stretches = []
    for segment in source.segments:
        part = reading.motion.cut(*reading.place(segment, whole=False))
        if len(part) >= MIN_CLIP_FRAMES:
            stretches.append((segment.type, _describe(source.name, part, segment.split)))
    missing = f"no {', '.join(rig.missing)}" if rig.missing else ""
    facts = ClipFacts(
        source.name,
        tuple(dict.fromkeys(segment.type for segment in source.segments)),
        sum(stretch.seconds for _, stretch in stretches),
        reading.fps,
        f"{rig.source_joints} joints below {next(iter(rig.mapped.values()), '')}",
        rig.scale_source,
        _up(rig),
        cleaning.floor_shift,
        len(cleaning.pops) + len(reading.leaps),
        notes=(
            *filter(None, (beyond_end(source.segments, reading.frames), missing)),
            *(note.partition(": ")[2] for note in reading.notes),
            *rig.notes,
            *cleaning.notes,
        ),
    )
    if reading.frames <= POSE_FRAMES:
        return replace(facts, notes=(POSE, *facts.notes)), [], None
    if not runs_of(source.segments, reading):
        fault = f"{source.path}: no labelled stretch of at least {MIN_CLIP_FRAMES} frames"
        return replace(facts, fault=fault), [], None
    whose = performer((segment.subject for segment in source.segments), rig.body)
    return facts, stretches, (whose, footfalls(reading.motion))


def _up(rig: RetargetReport) -> str:
    """The file's up axis, from the note that retargeting makes if it is not +Y."""
    return next((note.split()[2] for note in rig.notes if note.startswith("up axis ")), "Y")


def _describe(name: str, motion: Motion, split: str) -> _Stretch:
    layout = feature_layout(DEFAULT_LAYOUT)
    features = encode_motion(motion).features
    poses = features[:, layout.blocks["joint_positions"]]
    velocity = features[:, layout.blocks["root_xz_velocity"]].mean(axis=0)
    # In cm per joint: mean and deviation of the joint positions, and the root's velocity over the ground.
    scale = np.float32(JOINT_COUNT**-0.5)
    place = np.concatenate([poses.mean(axis=0) * scale, poses.std(axis=0) * scale, velocity / SPEED_SCALE])
    return _Stretch(
        name,
        len(motion) / FPS,
        float(np.linalg.norm(np.diff(motion.root_positions[:, [0, 2]], axis=0), axis=1).mean()) * FPS,
        frames_in_the_air(features, layout) / FPS,
        place,
        split,
        phase_stretch(features, DEFAULT_LAYOUT),
    )


def _type_facts(
    kind: str, by_type: dict[str, list[_Stretch]], sides: dict[str, tuple[str, str]]
) -> TypeFacts:
    """The facts of a type; sides has the result of _one_side for every type."""
    mine = by_type[kind]
    seconds = sum(stretch.seconds for stretch in mine)
    flights = sum(stretch.flying > 0.0 for stretch in mine) / len(mine)
    unlearnable = _unlearnable(mine)
    warnings = [unlearnable] if unlearnable else _too_little([stretch for stretch in mine if stretch.trains])
    grounded = [stretch.clip for stretch in mine if not stretch.flying]
    if flights >= MOST and grounded:
        warnings.append(f"most clips leave the ground, but not {_listed(grounded)}")
    groups = two_groups(np.stack([stretch.place for stretch in mine])) if len(mine) >= GROUPED else None
    if groups is not None:
        others = [mine[i].clip for i in groups]
        verb = "differs" if len(set(others)) == 1 else "differ"
        warnings.append(f"its clips fall into two groups: {_listed(others)} {verb} from the others")
    warnings += _misplaced(kind, by_type)
    speed = sum(stretch.speed * stretch.seconds for stretch in mine) / max(seconds, 1e-6)
    in_the_air = sum(stretch.flying for stretch in mine) / max(seconds, 1e-6)
    notes = () if unlearnable else _sided(kind, sides)
    return TypeFacts(
        kind, len(mine), seconds, speed, flights, in_the_air, unlearnable, tuple(warnings), notes
    )


def _unlearnable(mine: list[_Stretch]) -> str:
    """Why a type with these stretches cannot be learnt, and what to do; "" if it can be."""
    training = [stretch.seconds for stretch in mine if stretch.trains]
    if not training:
        return (
            "it cannot be learnt: the split column of labels.csv holds out all its clips; mark some as train"
        )
    longest, needed = max(training), LEAST_FRAMES / FPS
    if longest < needed:
        return (
            f"it cannot be learnt: its clips are too short, at most {longest:.2g} s, and {needed:g} s are needed; "
            "give it longer clips"
        )
    return ""


def _too_little(training: list[_Stretch]) -> list[str]:
    """Warnings for a type with few training clips or seconds."""
    out = []
    if len(training) == 1:
        out.append("one clip only, so training would copy it; give it several")
    seconds = sum(stretch.seconds for stretch in training)
    if seconds < REPEATED_BELOW:
        out.append(f"{seconds:.1f} s in all, which is little; give it {FEW_SECONDS:.0f} s or more")
    elif seconds < FEW_SECONDS:
        out.append(f"{seconds:.1f} s in all; more clips train better")
    return out


def _one_side(mine: list[_Stretch]) -> tuple[str, str]:
    """A type's strike ("kick" or "punch") and its side if all strikes share one side; else two empty strings."""
    rule = phase_rule([stretch.moves for stretch in mine])
    if rule is None or not rule.sided:
        return "", ""
    found = {strike.right for stretch in mine for strike in stretch.moves.events[rule.event]}
    return (rule.event, "right" if found.pop() else "left") if len(found) == 1 else ("", "")


def _sided(kind: str, sides: dict[str, tuple[str, str]]) -> tuple[str, ...]:
    """A note for a type that strikes with one side only, which mirrored clips will teach on both sides.

    There is none if another type strikes with the other side.
    """
    strike, side = sides[kind]
    other = (strike, "left" if side == "right" else "right")
    if not strike or mirrored_type(kind) != kind or other in sides.values():
        return ()
    plural = "kicks are" if strike == "kick" else "punches are"
    return (
        f"all its {plural} of the {side} side, and mirrored clips teach the other side too; "
        "--no-mirror of quickstart and preprocess keeps to one",
    )


def two_groups(places: Array) -> list[int] | None:
    """Indices of the smaller group if places (N, D) of the clips of a type form two groups far apart; else None."""
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


def _misplaced(kind: str, by_type: dict[str, list[_Stretch]]) -> list[str]:
    """A warning for each other type that clips of this one resemble more than their own."""
    centres = {
        name: np.mean([stretch.place for stretch in stretches], axis=0)
        for name, stretches in by_type.items()
        if name != kind and len(stretches) > 1
    }
    mine = by_type[kind]
    if len(mine) < 3 or not centres:
        return []
    found: dict[str, list[str]] = defaultdict(list)
    for number, stretch in enumerate(mine):
        others = np.mean([each.place for i, each in enumerate(mine) if i != number], axis=0)
        distance = float(np.linalg.norm(stretch.place - others))
        nearest = min(centres, key=lambda name: float(np.linalg.norm(stretch.place - centres[name])))
        if distance > FAR and float(np.linalg.norm(stretch.place - centres[nearest])) < NEARER * distance:
            found[nearest].append(stretch.clip)
    return [
        f"{_listed(clips)} {'moves' if len(set(clips)) == 1 else 'move'} like {other!r}"
        for other, clips in found.items()
    ]


def _listed(clips: list[str]) -> str:
    rest = f" and {len(clips) - 3} more" if len(clips) > 3 else ""
    return ", ".join(dict.fromkeys(clips[:3])) + rest
