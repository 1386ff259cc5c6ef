"""Makes a model of a trained network: adds scaling, bodies, start poses, reference clips and sampling presets."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from motionkit.arrays import Array, spans
from motionkit.data.dataset import Clip, Dataset
from motionkit.features.reference import REFERENCE_OFFSETS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import (
    Gait,
    MotionKind,
    MotionType,
    ReferenceClip,
    SamplingPreset,
    StartPose,
    is_steered,
)
from motionkit.models.weights import NetworkWeights
from motionkit.motion.skeleton import canonical_skeleton

START_FRAMES = 30  # the paper's number of initial frames for synthesis
STARTS_PER_TYPE = 3  # start poses of a type
# A standing body keeps the stance of its start pose, so standing types have more of them, spread evenly over the share
# of stretches nearest to the type's mean pose.
STANCES, STANCE_SHARE = 20, 0.85
# Total seconds of a type's reference clips, and the most if a part of every recording takes longer than that.
REFERENCE_SECONDS, MOST_SECONDS = 80.0, 300.0
LONGEST_REFERENCE, SHORTEST_REFERENCE = 10.0, 1.0  # seconds of one reference clip
# A recording whose lowest joint is more than ALOFT cm above the floor for more than LONGEST_LEAP seconds climbs.
ALOFT, LONGEST_LEAP = 10.0, 0.8
# A reference clip is cut where the body comes to rest: no later frame moves more than this share of the type's mean.
REST = 0.35


# Velocity blending restores movement that a network smooths away. Larger values overshoot when a body turns or brakes.
BLEND = 0.3
STEP_BLEND = 0.2  # velocity blending of gaits and jumps, whose feet slide with larger values
# Reference gains are calibrated at the end of a run; a run that is stopped earlier keeps the default.
GAIT = SamplingPreset(velocity_blend=STEP_BLEND, slip_correction=0.15, noise_scale=0.2)
STANDING = replace(GAIT, noise_scale=0.7)
PERFORMANCE = SamplingPreset(velocity_blend=BLEND, slip_correction=0.2, noise_scale=0.2)
STRIKE = SamplingPreset(velocity_blend=BLEND, slip_correction=0.3, noise_scale=0.2)
JUMP = SamplingPreset(velocity_blend=STEP_BLEND, slip_correction=0.2, noise_scale=0.2)
OTHER = SamplingPreset(velocity_blend=BLEND, slip_correction=0.45, noise_scale=0.2)


def bundle_model(
    network: NetworkWeights,
    dataset: Dataset,
    card: dict[str, Any],
    references: bool = True,
    kept: Mapping[str, MotionType] | None = None,
) -> MotionModel:
    """The model of a network that was trained on a dataset.

    A network with the paper's controls gets neither reference clips nor sampling presets.

    Args:
        references: whether the network was trained with reference poses.
        kept: types that are copied unchanged from the initial model.
    """
    kept = kept or {}
    gaits = measure_gaits(dataset)
    plain = network.config.controls == "paper"
    describe = _plain_type if plain else _motion_type
    return MotionModel(
        network,
        {
            kind: kept[kind] if kind in kept else describe(dataset, kind, gaits.get(kind))
            for kind in dataset.types
        },
        dataset.fps,
        dataset.scaling,
        dataset.trajectory_scaling,
        dataset.reference_rotations,
        dataset.pose_embedding,
        {"default": canonical_skeleton().offsets} | dataset.characters,
        references,
        card,
        dataset.own_bodies,
    )


def _plain_type(dataset: Dataset, kind: str, gait: Gait | None) -> MotionType:
    return MotionType(tuple(start_poses_of(dataset, kind)), gait=gait)


def _motion_type(dataset: Dataset, kind: str, gait: Gait | None) -> MotionType:
    clips = tuple(recorded_references(dataset, kind))
    steered = is_steered(clips, dataset.pose_embedding, dataset.fps)
    plain = MotionType((), clips, gait, steered=steered)
    plain = replace(plain, start_poses=tuple(start_poses_of(dataset, kind, plain.kind is MotionKind.STANCE)))
    return replace(plain, preset=sampling_preset(plain, dataset.phase_events.get(kind)))


def sampling_preset(known: MotionType, event: str | None) -> SamplingPreset:
    """The preset of a type whose phase follows "kick", "punch", "jump" or a whole stretch (""); None is no phase."""
    if known.kind.steered:
        return STANDING if known.kind is MotionKind.STANCE else GAIT
    if event is None:
        return OTHER
    return {"": PERFORMANCE, "jump": JUMP}.get(event, STRIKE)


def start_poses_of(dataset: Dataset, kind: str, standing: bool = False) -> list[StartPose]:
    """Start poses of a type: first frames of its training stretches, those nearest to its mean pose first.

    A start pose comes from the beginning of a stretch, because a cartwheel cannot start in its middle. The nearest are
    taken, because a stretch of running may begin in a crouch under an obstacle. A type without a training clip takes
    the first clip's frames. One that stands still has up to STANCES start poses.
    """
    number = dataset.types.index(kind)
    columns = dataset.layout.blocks["joint_positions"]
    stretches: list[tuple[Clip, int, int]] = []
    total, count = np.zeros(columns.stop - columns.start, np.float32), 0
    for clip in dataset.select("train"):
        mine = np.flatnonzero(dataset.clip_types(clip) == number)
        if len(mine):
            data = dataset.read(clip)
            begins = mine
            if dataset.phase_events.get(kind):
                # A strike or jump starts where its phase does.
                begins = mine[(data.phases[mine] >= 0.0) & (data.phases[mine] < 0.02)]
            poses = data.features[mine][:, columns]
            total, count = total + poses.sum(axis=0), count + len(poses)
            if len(begins):
                # Only up to the clip's first change of type.
                mine = mine[mine >= begins[0]]
                unbroken = int((mine == mine[0] + np.arange(len(mine))).sum())
                stretches.append((clip, int(mine[0]), min(unbroken, START_FRAMES)))
    if not stretches:
        clip = dataset.select("train")[0]
        stretches, count = [(clip, 0, min(clip.frames, START_FRAMES))], 1
    longest = max(frames for _, _, frames in stretches)
    ranked = []
    for clip, first, frames in stretches:
        if frames == longest:
            data = dataset.read(clip, first, first + frames)
            far = float(np.linalg.norm(data.features[:, columns].mean(axis=0) - total / count))
            ranked.append((far, clip, StartPose(data.features, data.contacts, data.ground)))
    ranked.sort(key=lambda entry: (entry[0], entry[1].name))
    if not standing:
        return [start for _, _, start in ranked[:STARTS_PER_TYPE]]
    # A mirrored clip has the same first row as its recording. It counts as another stance only if there are few.
    recordings: dict[int, StartPose] = {}
    for _, clip, start in ranked:
        recordings.setdefault(clip.start, start)
    starts = [start for _, _, start in ranked] if len(recordings) < STANCES else list(recordings.values())
    nearer = min(max(STARTS_PER_TYPE, round(STANCE_SHARE * len(starts))), len(starts))
    return [starts[i] for i in np.unique(np.linspace(0, nearer - 1, STANCES).round().astype(int))]


def recorded_references(dataset: Dataset, kind: str) -> list[ReferenceClip]:
    """Reference clips of a type, up to REFERENCE_SECONDS in all; none without training clips.

    For types with a phase, clips with the most frames of it come first. For other types, clips that move about as much
    as the type's mean come first, because recordings begin and end with standing. If some recordings do not fit, every
    recording contributes once before any mirrored clip, and the total may grow to MOST_SECONDS. Recordings of bodies
    that climb are left out: without the stairs they would walk on air.
    """
    fps = dataset.fps
    longest, room = round(LONGEST_REFERENCE * fps), round(REFERENCE_SECONDS * fps)
    performed = dataset.phase_events.get(kind) == ""
    found: list[tuple[str, ReferenceClip]] = []
    recordings: dict[
        str, int
    ] = {}  # first row by clip name; a mirrored clip has the same row as its recording
    for clip, start, end, _ in dataset.stretches(kind=kind):
        whole = dataset.read(clip, start, end + REFERENCE_OFFSETS[-1])
        poses = dataset.pose_embedding.of(whole.features)
        beyond = end - start + REFERENCE_OFFSETS[-1] - len(poses)
        poses = np.pad(poses, ((0, beyond), (0, 0)), mode="edge")
        step = end - start if performed else longest
        for first in range(0, end - start, step):
            last = min(first + step, end - start)
            if _climbs(dataset, whole.features[first:last]):
                continue
            ahead = poses[first : last + REFERENCE_OFFSETS[-1]]
            found.append(
                (clip.name, ReferenceClip(ahead, whole.ground[first:last], whole.phases[first:last]))
            )
            recordings[clip.name] = clip.start
    if not found:
        return []
    found = _not_too_short(found, fps)
    if kind in dataset.phase_events:
        # All frames of a performance are in its phase, so the longest performance comes first.
        found.sort(key=lambda entry: (-int((entry[1].phases >= 0.0).sum()), entry[0]))
        ordered = [reference_clip for _, reference_clip in found]
    else:
        usual = sum(float(reference_clip.movement.sum()) for _, reference_clip in found) / sum(
            len(o) for _, o in found
        )
        found = [(name, before_rest(reference_clip, REST * usual)) for name, reference_clip in found]
        found = _not_too_short(found, fps)
        ordered = typical_first(found)
        kept = {id(reference_clip) for reference_clip in _with_room(ordered, room)}
        kept_recordings = {recordings[name] for name, reference_clip in found if id(reference_clip) in kept}
        every = {recordings[name] for name, _ in found}
        if len(kept_recordings) < len(every):
            ordered = typical_first([(str(recordings[name]), each) for name, each in found])
            one_of_each = sum(map(len, ordered[: len(every)])) / fps
            room = round(min(max(REFERENCE_SECONDS, one_of_each), MOST_SECONDS) * fps)
    return _with_room(ordered, room)


def _climbs(dataset: Dataset, features: Array) -> bool:
    """Whether a body stands on something unknown: all joints are above the floor for longer than in any leap."""
    columns = dataset.layout.columns
    heights = [i for i, each in enumerate(columns) if (each.block, each.component) == ("joint_positions", 1)]
    aloft = spans(features[:, heights].min(axis=1) > ALOFT)
    return max((end - start for start, end in aloft), default=0) > LONGEST_LEAP * dataset.fps


def _with_room(ordered: Sequence[ReferenceClip], room: int) -> list[ReferenceClip]:
    """The first reference clips that together reach `room` frames."""
    out: list[ReferenceClip] = []
    frames = 0
    for reference_clip in ordered:
        if frames < room:
            out.append(reference_clip)
            frames += len(reference_clip)
    return out


def _not_too_short(found: list[tuple[str, ReferenceClip]], fps: float) -> list[tuple[str, ReferenceClip]]:
    """The reference clips of at least SHORTEST_REFERENCE seconds, or all if none has them."""
    return [entry for entry in found if len(entry[1]) >= SHORTEST_REFERENCE * fps] or found


def before_rest(reference_clip: ReferenceClip, least: float) -> ReferenceClip:
    """A reference clip up to its last frame that moves at least this much; the whole clip if no frame does."""
    moving = np.flatnonzero(reference_clip.movement >= least)
    end = int(moving[-1]) + 1 if len(moving) else len(reference_clip)
    return ReferenceClip(
        reference_clip.poses[: end + REFERENCE_OFFSETS[-1]],
        reference_clip.ground[:end],
        reference_clip.phases[:end],
    )


def typical_first(found: list[tuple[str, ReferenceClip]]) -> list[ReferenceClip]:
    """Reference clips in a new order: the most typical one of each recording, then the second of each.

    The more typical its mean movement is for the type, the earlier a clip comes.
    """
    movements = [float(reference_clip.movement.mean()) for _, reference_clip in found]
    frames = [len(reference_clip) for _, reference_clip in found]
    mean = sum(m * n for m, n in zip(movements, frames, strict=True)) / max(1, sum(frames))
    # Rounded, because a clip and its mirror image differ in last digits only; the recording comes first.
    far = [round(abs(math.log((movement + 1e-6) / (mean + 1e-6))), 4) for movement in movements]
    ranked: list[tuple[int, float, str, int]] = []
    before = Counter[str]()
    for i in sorted(range(len(found)), key=far.__getitem__):
        name = found[i][0]
        ranked.append((before[name], far[i], name, i))
        before[name] += 1
    return [found[i][1] for *_, i in sorted(ranked)]


def measure_gaits(dataset: Dataset) -> dict[str, Gait]:
    """The gait of each type: mean speed over the ground, and the angle from the facing direction to that of travel.

    The angle is zero for types without a steady direction, and pi for walking backwards.
    """
    gaits = {}
    for kind, (frames, distance, x, z) in ground_movement(dataset).items():
        steady = math.hypot(x, z) > 0.8 * distance
        facing = math.atan2(x, z) if steady else 0.0
        gaits[kind] = Gait(
            round(distance / frames, 2), round(facing, 3), dataset.phase_seconds.get(kind, 0.0)
        )
    return gaits


def ground_movement(dataset: Dataset) -> dict[str, tuple[float, float, float, float]]:
    """Sums over the training frames of each type: frames, speed, sideways and forward velocity (cm/s)."""
    sums = {kind: np.zeros(4, np.float64) for kind in dataset.types}
    block = dataset.layout.blocks["root_xz_velocity"]
    for clip in dataset.select("train"):
        velocity = dataset.read(clip).features[:, block].astype(np.float64)
        kinds = dataset.clip_types(clip)
        for i in np.unique(kinds).tolist():
            mine = velocity[kinds == i]
            sums[dataset.types[i]] += [len(mine), np.linalg.norm(mine, axis=-1).sum(), *mine.sum(axis=0)]
    rows = {kind: found.tolist() for kind, found in sums.items() if found[0]}
    return {kind: (frames, distance, x, z) for kind, (frames, distance, x, z) in rows.items()}
