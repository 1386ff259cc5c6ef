"""Puts a trained network together with all it needs to run: scaling, bodies, and frames to start from."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

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
STARTS_PER_TYPE = 3
# A standing body keeps the stance it begins in: there are more of these, evenly from the nearer share of all.
STANCES, STANCE_SHARE = 20, 0.85
# Reference clips of a type: seconds in all, and at most where it takes more to show a part of every recording; of the
# longest and the shortest clip.
REFERENCE_SECONDS, MOST_SECONDS = 80.0, 300.0
LONGEST_REFERENCE, SHORTEST_REFERENCE = 10.0, 1.0
# A reference clip ends where the body comes to rest: where less than this share of the type's usual motion follows.
REST = 0.35


# Velocity blending makes up for what a network smooths away; more than this overshoots where a body turns or brakes.
BLEND = 0.3
STEP_BLEND = 0.2  # of gaits and hops, whose feet slide with more
# Reference gains are found at the end of a run; one that is stopped before may answer more than a finished one does.
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
    """The model of a network trained on a dataset, with or without reference poses.

    A network with the paper's controls gets neither reference clips nor sampling presets.

    Args:
        kept: types taken as they are, because the model that training began from knows them.
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
    """How frames of a type are drawn.

    Args:
        event: what its phase follows: "kick", "punch", "jump", "" for whole performances, None for no phase.
    """
    if known.kind.steered:
        return STANDING if known.kind is MotionKind.STANCE else GAIT
    if event is None:
        return OTHER
    return {"": PERFORMANCE, "jump": JUMP}.get(event, STRIKE)


def start_poses_of(dataset: Dataset, kind: str, stands: bool = False) -> list[StartPose]:
    """A few starts of a type: the first frames of training stretches, nearest to its usual pose first.

    The beginnings of stretches, because a cartwheel has to be started from its start; the nearest ones,
    because a run that begins in a crouch under an obstacle is no good start for running. A type without
    a training clip, which a model cannot know, takes any clip's frames.

    Args:
        stands: whether the type is standing still, which has more of them, and others than the nearest.
    """
    wanted = dataset.types.index(kind)
    columns = dataset.layout.blocks["joint_positions"]
    stretches: list[tuple[Clip, int, int]] = []
    total, count = np.zeros(columns.stop - columns.start, np.float32), 0
    for clip in dataset.select("train"):
        mine = np.flatnonzero(dataset.clip_types(clip) == wanted)
        if len(mine):
            data = dataset.read(clip)
            begins = mine
            if dataset.phase_events.get(kind):
                # A strike or jump is started from its own beginning, at the beginning of the phase.
                begins = mine[(data.phases[mine] >= 0.0) & (data.phases[mine] < 0.02)]
            shown = data.features[mine][:, columns]
            total, count = total + shown.sum(axis=0), count + len(shown)
            if len(begins):
                # Only up to where the clip first goes over to another type.
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
    if not stands:
        return [start for _, _, start in ranked[:STARTS_PER_TYPE]]
    # A mirror image begins where its recording does, and is another stance only where there are few.
    recordings: dict[int, StartPose] = {}
    for _, clip, start in ranked:
        recordings.setdefault(clip.start, start)
    starts = [start for _, _, start in ranked] if len(recordings) < STANCES else list(recordings.values())
    nearer = min(max(STARTS_PER_TYPE, round(STANCE_SHARE * len(starts))), len(starts))
    return [starts[i] for i in np.unique(np.linspace(0, nearer - 1, STANCES).round().astype(int))]


def recorded_references(dataset: Dataset, kind: str) -> list[ReferenceClip]:
    """Reference clips of a type: performances the longest first, others from many recordings; none without clips.

    Of types made of strikes or jumps those parts come first that show most of them, of others those that move
    about as much as the type does in the mean: recordings begin and end with standing. Where there is no room for all
    recordings, mirror images wait until every recording has been taken once, and there is more room.
    """
    wanted, fps = dataset.types.index(kind), dataset.fps
    longest, room = round(LONGEST_REFERENCE * fps), round(REFERENCE_SECONDS * fps)
    performed = dataset.phase_events.get(kind) == ""
    found: list[tuple[str, ReferenceClip]] = []
    recordings: dict[str, int] = {}  # where the recording of a clip begins: a mirror image has the same
    for clip, start, end, type_id in dataset.stretches():
        if type_id != wanted:
            continue
        whole = dataset.read(clip, start, end + REFERENCE_OFFSETS[-1])
        poses = dataset.pose_embedding.of(whole.features)
        beyond = end - start + REFERENCE_OFFSETS[-1] - len(poses)
        poses = np.pad(poses, ((0, beyond), (0, 0)), mode="edge")
        step = end - start if performed else longest
        for first in range(0, end - start, step):
            last = min(first + step, end - start)
            ahead = poses[first : last + REFERENCE_OFFSETS[-1]]
            found.append(
                (clip.name, ReferenceClip(ahead, whole.ground[first:last], whole.phases[first:last]))
            )
            recordings[clip.name] = clip.start
    if not found:
        return []
    found = _not_too_short(found, fps)
    if kind in dataset.phase_events:
        # Of a performance all frames are in its phase: the longest shows most.
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
        shown = {recordings[name] for name, reference_clip in found if id(reference_clip) in kept}
        every = {recordings[name] for name, _ in found}
        if len(shown) < len(every):
            ordered = typical_first([(str(recordings[name]), each) for name, each in found])
            one_of_each = sum(map(len, ordered[: len(every)])) / fps
            room = round(min(max(REFERENCE_SECONDS, one_of_each), MOST_SECONDS) * fps)
    return _with_room(ordered, room)


def _with_room(ordered: Sequence[ReferenceClip], room: int) -> list[ReferenceClip]:
    """The first reference clips, until they fill so many frames."""
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
    """A reference clip up to where less than so much movement follows to its end; whole, if it never moves more."""
    moving = np.flatnonzero(reference_clip.movement >= least)
    end = int(moving[-1]) + 1 if len(moving) else len(reference_clip)
    return ReferenceClip(
        reference_clip.poses[: end + REFERENCE_OFFSETS[-1]],
        reference_clip.ground[:end],
        reference_clip.phases[:end],
    )


def typical_first(found: list[tuple[str, ReferenceClip]]) -> list[ReferenceClip]:
    """Reference clips by recording, reordered: the most typical part of each recording, then the second of each."""
    movements = [float(reference_clip.movement.mean()) for _, reference_clip in found]
    frames = [len(reference_clip) for _, reference_clip in found]
    mean = sum(m * n for m, n in zip(movements, frames, strict=True)) / max(1, sum(frames))
    far = [abs(math.log((movement + 1e-6) / (mean + 1e-6))) for movement in movements]
    ranked: list[tuple[int, float, str, int]] = []
    before = Counter[str]()
    for i in sorted(range(len(found)), key=far.__getitem__):
        name = found[i][0]
        ranked.append((before[name], far[i], name, i))
        before[name] += 1
    return [found[i][1] for *_, i in sorted(ranked)]


def measure_gaits(dataset: Dataset) -> dict[str, Gait]:
    """Mean speed of each type over the ground, and the angle from where it faces to where it goes.

    The angle is zero for types that go no steady direction; walking backwards has half a turn.
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
    """Sums over the training frames of each type that has some: frames, speed, sideways and forward velocity (cm/s)."""
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
