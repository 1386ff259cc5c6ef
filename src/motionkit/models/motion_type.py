"""A motion type of a model: start poses, reference clips, gait and sampling preset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np

from motionkit.arrays import Array
from motionkit.features.reference import PoseEmbedding
from motionkit.motion.rotations import rotate_ground
from motionkit.motion.skeleton import JOINT_COUNT

MOVEMENT_FRAMES = 120  # frames over which ReferenceClip.movement is averaged
# Quantile of recorded speeds cut off at both ends of a speed range, share by which the range is widened, and least
# margin to both sides as a share of the usual speed.
SPEED_SHARE, SPEED_MARGIN, LEAST_MARGIN = 0.02, 0.1, 0.25
RUN_SPEED = 200.0  # cm/s above which a gait is a run; chosen between recorded walks and runs
JUMP_OF_PHASE = 0.1  # change of phase in a frame above which another strike or jump begins
# Velocity alone steers a type that stands still, or keeps one direction in similar poses, as gaits do. Speed is that of
# the root over the ground, steadiness the mean velocity as a share of the mean speed, movement the speed of the joints
# relative to the root. Spread is that of poses around their mean (RMS over joints). On CMU motion, gaits have a spread
# of 12 to 18 cm, ducking under obstacles 24, hops 23, balancing 18.
GAIT_SPEED, GAIT_STEADINESS, GAIT_SPREAD = 30.0, 0.8, 20.0  # least cm/s; least share; largest cm
STANDING_SPEED, STANDING_MOVEMENT, STANDING_SPREAD = 15.0, 10.0, 10.0  # largest cm/s; cm/s; cm


@dataclass(frozen=True, eq=False)
class StartPose:
    """Recorded frames to start from: features (T, 276) unnormalised, contacts (T, 4), ground (T, 3)."""

    features: Array
    contacts: Array
    ground: Array


@dataclass(frozen=True)
class Gait:
    """How a type moves over the ground.

    Attributes:
        speed: mean, in cm/s.
        facing: angle in radians from the heading of the body to its direction of travel; pi walks backwards.
        cycle_seconds: mean length of a performance, strike or jump; 0 for types without a phase.
    """

    speed: float
    facing: float
    cycle_seconds: float = 0.0

    @property
    def runs(self) -> bool:
        """Whether it is faster than a walk."""
        return self.speed > RUN_SPEED


@dataclass(frozen=True)
class SamplingPreset:
    """How frames of a type are drawn; docs/results-log.md has the measurements behind the numbers.

    Attributes:
        reference_gain: factor on the reference pose. Networks fall short of sharp movements, so strikes, jumps and
            flips need more than 1.
        velocity_blend: share of the last frame's velocity that is kept, which makes sampled motion smoother.
        slip_correction: share of foot sliding to subtract from the root's velocity. Types whose references were
            recorded on another trajectory slide most. A gait with a large share changes speed slowly.
        noise_scale: factor on the sampling temperature. A standing body needs noise to sway; noise only shakes a body
            that follows a reference.
        noise_alone: the factor without reference recordings, for types that only noise keeps moving: they have neither
            trajectory nor phase. None takes noise_scale.
    """

    reference_gain: float = 1.0
    velocity_blend: float = 0.0
    slip_correction: float = 0.0
    noise_scale: float = 1.0
    noise_alone: float | None = None

    @property
    def without_references(self) -> SamplingPreset:
        """The preset without reference recordings."""
        return self if self.noise_alone is None else replace(self, noise_scale=self.noise_alone)


@dataclass(frozen=True, eq=False)
class ReferenceClip:
    """A recording of one type, the source of reference poses (features/reference.py).

    Attributes:
        poses: (L + 30, 24) pose embeddings of its frames, and of 30 frames more for the look-ahead of references.
        ground: (L, 3) root x, z (cm) and heading (radians).
        phases: (L,) phase of a performance, strike or jump in [0, 1), negative outside.
    """

    poses: Array
    ground: Array
    phases: Array

    def __len__(self) -> int:
        return len(self.ground)

    @property
    def performed(self) -> bool:
        """Whether the clip is one performance from beginning to end."""
        return bool((self.phases >= 0.0).all()) and bool((np.diff(self.phases) > 0.0).all())

    @cached_property
    def recorded(self) -> int:
        """How many of its poses are recorded; the last of them is held after a recording's end."""
        moves = np.flatnonzero((np.diff(self.poses, axis=0) != 0.0).any(axis=1))
        return int(moves[-1]) + 2 if len(moves) else 1

    @cached_property
    def pace(self) -> float:
        """Mean change of the pose embedding per frame, above 0."""
        return 1e-6 + float(np.linalg.norm(np.diff(self.poses[: len(self) + 1], axis=0), axis=1).mean())

    @cached_property
    def movement(self) -> Array:
        """Change of the pose embedding per frame (L,), averaged over the next MOVEMENT_FRAMES, fewer at the end."""
        steps = np.linalg.norm(self.poses[1 : len(self) + 1] - self.poses[: len(self)], axis=1)
        sums = np.pad(steps.cumsum(), (1, 0))
        frames = np.arange(len(self))
        ends = np.minimum(frames + MOVEMENT_FRAMES, len(self))
        return (sums[ends] - sums[frames]) / (ends - frames)


@dataclass(frozen=True)
class Rhythm:
    """How jumps or performances follow one another: frames of the phase, and from one beginning to the next."""

    frames: float
    period: int

    def phases(self, begin: int, count: int) -> Array:
        """Phases (count,) of the frames from `begin` on; negative between two jumps or performances."""
        phase = np.arange(begin, begin + count) % self.period / self.frames
        return np.where(phase < 1.0, phase, -1.0).astype(np.float32)


def recorded_rhythm(clips: Sequence[ReferenceClip]) -> Rhythm | None:
    """The usual rhythm of the jumps in reference clips, from the median phase rate and the median period.

    It is None without jumps, and for strikes, where each side takes half of the phase.
    """
    rates, periods = [], []
    for clip in clips:
        step = np.diff(clip.phases)
        within = (clip.phases[1:] >= 0.0) & (clip.phases[:-1] >= 0.0) & (np.abs(step) < JUMP_OF_PHASE)
        rates += step[within & (step > 0.0)].tolist()
        begins = clip.phases[1:][(clip.phases[1:] >= 0.0) & ~within]
        if (np.abs(begins - 0.5) < 0.5 * JUMP_OF_PHASE).any():
            return None
        if len(begins):
            periods.append(len(clip) / len(begins))
    if not rates or not periods:
        return None
    return Rhythm(round(1.0 / float(np.median(rates)), 1), round(float(np.median(periods))))


def recorded_speeds(clips: Sequence[ReferenceClip], fps: float) -> tuple[float, float] | None:
    """Slowest and fastest speed in cm/s of a type, from its recordings; None without any.

    Speeds are means over a second. The slowest and fastest of them, beginnings, ends and outliers, are cut off. If all
    recordings have nearly the same speed, the range still reaches LEAST_MARGIN to both sides.
    """
    second = round(fps)
    displacements = [
        clip.ground[second:, :2] - clip.ground[:-second, :2] for clip in clips if len(clip) > second
    ]
    if not displacements:
        return None
    speeds = np.linalg.norm(np.concatenate(displacements), axis=-1) * fps / second
    slow, usual, fast = np.quantile(speeds, [SPEED_SHARE, 0.5, 1.0 - SPEED_SHARE]).tolist()
    return (
        min(slow * (1.0 - SPEED_MARGIN), usual * (1.0 - LEAST_MARGIN)),
        max(fast * (1.0 + SPEED_MARGIN), usual * (1.0 + LEAST_MARGIN)),
    )


class MotionKind(Enum):
    """Kind of a motion type, which decides how it is controlled; MotionType.kind finds it from the type's data."""

    GAIT = "gait"  # steered by velocity: walks and runs
    STANCE = "stance"  # standing still
    PERFORMANCE = "performance"  # one movement from beginning to end, such as a cartwheel
    EVENTS = "events"  # strikes or jumps, each with a phase of its own
    FREE = "free"  # dances and the like: moved by reference poses, or by noise without them

    @property
    def steered(self) -> bool:
        """Whether velocity alone steers the type, without reference poses."""
        return self in (MotionKind.GAIT, MotionKind.STANCE)

    @property
    def phased(self) -> bool:
        """Whether its movements have a phase."""
        return self in (MotionKind.PERFORMANCE, MotionKind.EVENTS)


@dataclass(frozen=True, eq=False)
class MotionType:
    """One motion type of a model.

    Attributes:
        reference_clips: recordings for reference poses; of performances the longest first.
        gait: how it moves over the ground; None if not measured.
        steered: whether velocity alone steers it (is_steered).
        rhythm: recorded_rhythm of jumps; None with recordings and for other types.
        speeds: recorded_speeds of a gait; None with recordings and for other types.
        velocity: recorded_velocity of a gait or of jumps; None with recordings and for other types.
    """

    start_poses: tuple[StartPose, ...] = ()
    reference_clips: tuple[ReferenceClip, ...] = ()
    gait: Gait | None = None
    preset: SamplingPreset = field(default_factory=SamplingPreset)
    steered: bool = False
    rhythm: Rhythm | None = None
    speeds: tuple[float, float] | None = None
    velocity: tuple[float, float] | None = None

    @cached_property
    def kind(self) -> MotionKind:
        """The kind of the type, from its recordings, or without them from rhythm and gait."""
        if self.steered:
            standing = self.gait is not None and self.gait.speed < STANDING_SPEED
            return MotionKind.STANCE if standing else MotionKind.GAIT
        if self.reference_clips and self.reference_clips[0].performed:
            return MotionKind.PERFORMANCE
        if self.reference_clips:
            phased = any(bool((clip.phases >= 0.0).any()) for clip in self.reference_clips)
        else:
            phased = self.rhythm is not None or (self.gait is not None and self.gait.cycle_seconds > 0.0)
        return MotionKind.EVENTS if phased else MotionKind.FREE

    @property
    def moves_by_noise(self) -> bool:
        """Whether only noise keeps the type moving, because it has no recordings, phase or trajectory."""
        return self.kind is MotionKind.FREE and not self.reference_clips

    def phase_seconds(self, fps: float) -> float:
        """Length in seconds of its first performance, or the mean length of a strike or jump; 0 without a phase."""
        if self.kind is MotionKind.PERFORMANCE:
            return len(self.reference_clips[0]) / fps
        return 0.0 if self.gait is None else self.gait.cycle_seconds


def is_steered(clips: Sequence[ReferenceClip], embedding: PoseEmbedding, fps: float) -> bool:
    """Whether velocity alone steers a type, from its reference clips: a steady gait, or standing still.

    It is False for types with a phase, and without clips. embedding is the map that made their poses.
    """
    if not clips or any(bool((clip.phases >= 0.0).any()) for clip in clips):
        return False
    velocity = np.concatenate([facing_velocity(clip, fps) for clip in clips])
    speed = float(np.linalg.norm(velocity, axis=1).mean())
    steadiness = float(np.linalg.norm(velocity.mean(axis=0))) / max(speed, 1e-6)
    standing = speed < STANDING_SPEED
    # This early return covers most types, because poses take the longest.
    if not standing and (speed <= GAIT_SPEED or steadiness <= GAIT_STEADINESS):
        return False
    # A map that keeps lengths in the space of poses, with only as many columns as the embedding has.
    to_poses = np.linalg.pinv(embedding.matrix.astype(np.float64))
    lengths = np.linalg.qr(to_poses.T)[1].T / JOINT_COUNT**0.5
    poses = [clip.poses[: len(clip)] @ lengths for clip in clips]
    whole = np.concatenate(poses)
    spread = float(np.sqrt(np.square(whole - whole.mean(axis=0)).sum(axis=1).mean()))
    if standing:
        steps = np.concatenate([np.linalg.norm(np.diff(p, axis=0), axis=1) for p in poses])
        return spread < STANDING_SPREAD and float(steps.mean()) * fps < STANDING_MOVEMENT
    return spread < GAIT_SPREAD


def recorded_velocity(clips: Sequence[ReferenceClip], fps: float) -> tuple[float, float] | None:
    """Mean velocity of the root over a second, x and z in cm/s in the heading frame; None without long enough clips.

    x is 0, because the side to which clips drift is chance.
    """
    second = round(fps)
    moves = [
        rotate_ground(-clip.ground[:-second, 2], clip.ground[second:, :2] - clip.ground[:-second, :2])
        for clip in clips
        if len(clip) > second
    ]
    return (0.0, float(np.concatenate(moves)[:, 1].mean()) * fps / second) if moves else None


def facing_velocity(clip: ReferenceClip, fps: float) -> Array:
    """Root velocity (L - 1, 2) in cm/s in the heading frame."""
    steps = np.diff(clip.ground[:, :2], axis=0) * fps
    return rotate_ground(-clip.ground[1:, 2], steps)
