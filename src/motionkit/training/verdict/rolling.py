"""Roll-outs for the scoreboard, by the calls that users make: `synthesize`, `follow_path` and live characters.

Every roll-out is kept as users get it by default, with feet locked, and as the network's raw output.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from motionkit.arrays import spans
from motionkit.control.drive import Driver, together
from motionkit.control.follow import follow_path
from motionkit.control.path import Path2D
from motionkit.control.script import TypePart
from motionkit.control.steering import commanded
from motionkit.control.synthesize import Synthesis, SynthesisOptions, synthesize
from motionkit.data.workers import Map
from motionkit.inference.character import CharacterStream
from motionkit.inference.noise import Noise
from motionkit.metrics.body import Body, body_of
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion

BATCH = 24  # characters that are rolled out together, by one process

# Called with the share of the work that is done (0 to 1).
Progress = Callable[[float], None]

T = TypeVar("T")


@dataclass(frozen=True)
class Plan:
    """The types one character performs in turn, and its seed."""

    parts: tuple[TypePart, ...]
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Take:
    """One roll-out: as users get it by default, with feet locked, and as the network's raw output.

    ranges are frames (start, end) that show the requested types, not the standing and run-ups that synthesis adds.
    """

    default: Body
    raw: Body
    ranges: tuple[tuple[int, int], ...] = ()

    def performed(self) -> list[Take]:
        """Return the ranges that show the requested types; all of it if they are not known."""
        return [self.cut(start, end) for start, end in self.ranges] or [self]

    def cut(self, start: int, end: int) -> Take:
        """Return frames start to end (exclusive)."""
        return Take(self.default.cut(start, end), self.raw.cut(start, end))


@dataclass(frozen=True, eq=False)
class Walk:
    """A path followed by one character: the take, whether the end was reached, and the path's part in each frame."""

    take: Take
    finished: bool
    part_frames: tuple[int, ...]


def grouped(takes: Sequence[T], size: int) -> list[Sequence[T]]:
    """Return what was rolled out in groups of so many, such as those of one type."""
    return [takes[i : i + size] for i in range(0, len(takes), size)]


def commanded_plans(
    model: MotionModel, kinds: Iterable[str], seeds: Sequence[int], seconds: float
) -> list[Plan]:
    """Return plans that command each of kinds for some seconds after a neutral type, type by type and seed by seed."""
    return [Plan(commanded(model, kind, seconds, seed), seed) for kind in kinds for seed in seeds]


def roll_plans(
    model: MotionModel,
    plans: Sequence[Plan],
    noise: Noise | None = None,
    each: Map = map,
    progress: Progress | None = None,
) -> list[Take]:
    """Roll out each plan with one character, as `synthesize` does with its seed; `each` is a map over batches."""
    batches = _batches(plans)
    tasks = [(model, batch, noise or Noise()) for batch in batches]
    out: list[Take] = []
    for takes in each(_roll_batch, tasks):
        out += takes
        if progress:
            progress(len(out) / len(plans))
    return out


def _batches(plans: Sequence[Plan]) -> list[list[Plan]]:
    """Plans in order, in batches of at most BATCH whose seeds count up by one."""
    out: list[list[Plan]] = []
    for plan in plans:
        if out and len(out[-1]) < BATCH and plan.seed == out[-1][-1].seed + 1:
            out[-1].append(plan)
        else:
            out.append([plan])
    return out


def _roll_batch(task: tuple[MotionModel, list[Plan], Noise]) -> list[Take]:
    model, plans, noise = task
    options = SynthesisOptions(len(plans), plans[0].seed, noise, raw=True)
    made = synthesize(model, [plan.parts for plan in plans], options)
    return [_take(each, plan) for each, plan in zip(made.motions, plans, strict=True)]


def _take(made: Synthesis, plan: Plan) -> Take:
    assert made.raw is not None, "the options ask for it"
    requested = [each.type in {part.type for part in plan.parts} for each in made.types]
    lengths = [max(1, round(each.seconds * made.motion.fps)) for each in made.types]
    ranges = spans(np.repeat(requested, lengths)[: len(made.motion)])
    return Take(body_of(made.motion), body_of(made.raw), tuple(ranges))


def roll_paths(
    model: MotionModel,
    paths: Sequence[tuple[Path2D, int]],
    noise: Noise | None = None,
    each: Map = map,
    progress: Progress | None = None,
) -> list[Walk]:
    """Follow each path with one character, as `follow_path` does with the seed beside it."""
    out = []
    for walk in each(_follow, [(model, path, seed, noise or Noise()) for path, seed in paths]):
        out.append(walk)
        if progress:
            progress(len(out) / len(paths))
    return out


def _follow(task: tuple[MotionModel, Path2D, int, Noise]) -> Walk:
    model, path, seed, noise = task
    found = follow_path(model, path, SynthesisOptions(1, seed, noise, raw=True))
    assert found.raw is not None, "the options ask for it"
    return Walk(Take(body_of(found.motion), body_of(found.raw)), found.finished, found.part_frames)


@dataclass(frozen=True, eq=False)
class Driven:
    """A live character: the type it starts in, and a function that may change its driver's wish before a frame."""

    type: str
    steer: Callable[[int, Driver], None]


def roll_live(
    model: MotionModel,
    characters: Sequence[Driven],
    frames: int,
    noise: Noise | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Take]:
    """Drive characters for some frames as `play` does; character i has seed + i."""
    variants = []
    for number, ik in enumerate((True, False)):

        def report(share: float, number: int = number) -> None:
            if progress:
                progress((number + share) / 2)

        variants.append(_live_bodies(model, characters, frames, noise or Noise(), seed, ik, report))
    return [Take(*bodies) for bodies in zip(*variants, strict=True)]


def _live_bodies(
    model: MotionModel,
    characters: Sequence[Driven],
    frames: int,
    noise: Noise,
    seed: int,
    ik: bool,
    progress: Progress,
) -> list[Body]:
    stream = CharacterStream(model, len(characters), noise, seed, ik)
    drivers = []
    for index, character in enumerate(characters):
        stream.reset(index, type=character.type)
        drivers.append(Driver(model, character.type))
    rotations, roots = [], []
    for frame in range(frames):
        ground = stream.ground
        controls = []
        for index, (character, driver) in enumerate(zip(characters, drivers, strict=True)):
            character.steer(frame, driver)
            controls.append(driver(frame, ground[index : index + 1]))
        made = stream.step(together(controls))
        rotations.append(made.rotations.copy())
        roots.append(made.root_positions.copy())
        progress((frame + 1) / frames)
    skeleton = model.character("default")
    return [
        body_of(Motion(skeleton, turns, places, model.fps))
        for turns, places in zip(np.stack(rotations, axis=1), np.stack(roots, axis=1), strict=True)
    ]
