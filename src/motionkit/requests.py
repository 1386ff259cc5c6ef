"""Checks and prepares the requests of mk.synthesize, mk.follow_path and their commands, before any frame is made.

Keywords that both pass on to SynthesisOptions have their defaults there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from motionkit.control import follow, synthesize
from motionkit.control.keys import ORIGIN, Key, check_keys, check_length, read_keys
from motionkit.control.lead_ins import natural_seconds
from motionkit.control.path import Path2D, check_shape_options, read_path, shape_path
from motionkit.control.plan import plan_path, plan_types
from motionkit.control.script import TypePart, parse_types
from motionkit.control.speeds import check_speeds, doubtful_parts, hurried_keys, other_speeds
from motionkit.control.steering import walking_type
from motionkit.control.synthesize import SynthesisOptions, SynthesisResult
from motionkit.errors import ControlError
from motionkit.models.bundled import open_model
from motionkit.models.model import MotionModel
from motionkit.names import nfc

if TYPE_CHECKING:
    from motionkit.control.follow import FollowResult
    from motionkit.editing.loop import Loop
    from motionkit.inference.noise import Noise
    from motionkit.motion.motion import Motion

PATH_ENDINGS = (".json", ".csv")


class MotionWords(TypedDict, total=False):
    """Keywords that mk.synthesize and mk.follow_path share."""

    model: MotionModel | str | Path | None
    seed: int
    noise: Noise | None
    reference: str
    character: str
    init: str | Path | Motion | None
    ik: bool
    fps: float | None


class SynthesisWords(MotionWords, total=False):
    """Keywords of mk.synthesize."""

    seconds: float | None
    count: int
    keys: str | Path | Sequence[Key]


class PathWords(MotionWords, total=False):
    """Keywords of mk.follow_path."""

    types: str | None
    size: float | None
    speed: float | None
    strict: bool


@dataclass(frozen=True, eq=False)
class SynthesisRequest:
    """Motions to synthesize.

    Attributes:
        model: its reference recordings are removed if the request says so.
        plans: for each character a list of types; reused in turn.
        options: synthesis options.
        size: size of the rig that the keys are for, relative to the model's body.
    """

    model: MotionModel
    plans: Sequence[list[TypePart]]
    options: SynthesisOptions
    size: float = 1.0

    def on_rig(self, size: float) -> SynthesisRequest:
        """The same request with its keys in the world of a rig of a size relative to the model's body."""
        keys = tuple(key.scaled(1.0 / size) for key in self.options.keys)
        return replace(self, options=replace(self.options, keys=keys), size=size)

    @property
    def name(self) -> str:
        """A file name made from the types."""
        return "-".join(part.type for plan in self.plans for part in plan)[:80]

    @property
    def frames(self) -> int:
        """Length of the longest motion in frames at the model's rate. Raises ControlError if one is too short."""
        lengths = [len(plan_types(self.model, plan).track) for plan in self.plans]
        synthesize.check_size(min(lengths) / self.model.fps, self.model.fps, self.options)
        return max(lengths)

    @property
    def cut_short(self) -> list[str]:
        """A line for each type that has less time than its flip, strike or jump takes."""
        parts = {part for plan in self.plans for part in plan}
        return [
            f"{part.type} takes {seconds:.2f} s, found {part.seconds:g} s, in which it is cut off"
            for part in sorted(parts, key=lambda part: (part.type, part.seconds))
            if part.seconds < (seconds := self.model.phase_seconds(part.type)) - 1e-6
        ]

    @property
    def doubtful(self) -> list[str]:
        """Lines for what may not look right: types cut short, and gaits that keys hurry."""
        keys, start = self.options.keys, ORIGIN if self.options.init is None else None
        hurried = [hurried_keys(self.model, plan, keys, start, self.size) for plan in self.plans]
        return self.cut_short + [line for lines in hurried for line in lines]

    def run(self, progress: Callable[[int], None] | None = None) -> SynthesisResult:
        """Synthesize; progress is called with the number of frames done."""
        return synthesize.synthesize(self.model, self.plans, self.options, progress)

    def longer(self, times: int) -> SynthesisRequest:
        """The same request with the seconds of each type multiplied."""
        plans = [[replace(part, seconds=times * part.seconds) for part in plan] for plan in self.plans]
        return replace(self, plans=plans)

    def loops(
        self, seconds: float | None, progress: Callable[[int], None] | None = None
    ) -> tuple[SynthesisResult, list[Loop]]:
        """Closed cycles of about the given length instead of motions; raises like editing.loop.find_loops."""
        from motionkit.editing.loop import find_loops

        return find_loops(
            lambda times: self.longer(times).run(progress), [plan[0].type for plan in self.plans], seconds
        )


def _opened(model: MotionModel | str | Path | None, reference: str) -> MotionModel:
    """The model of a file, the bundled one, or one that is open already; with its reference recordings or none."""
    if isinstance(model, MotionModel):
        return model.with_reference(reference)
    return open_model(model, reference)


def synthesis_request(
    types: str | Sequence[str],
    *,
    seconds: float | None = None,
    keys: str | Path | Sequence[Key] = (),
    model: MotionModel | str | Path | None = None,
    reference: str = "auto",
    **options: Any,
) -> SynthesisRequest:
    """The request of mk.synthesize, with the same arguments; options are fields of SynthesisOptions.

    Raises:
        ControlError: an unknown type, keys that cannot be reached, or a file without keys.
    """
    model = _opened(model, reference)
    texts = [types] if isinstance(types, str) else list(types)
    if not texts:
        raise ControlError("expected at least one motion type, found none")
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise ControlError(f"expected a length above 0 s, found {seconds:g}")
    plans = [parse_types(text, seconds, partial(natural_seconds, model)) for text in texts]
    for plan in plans:
        for part in plan:
            model.type_id(part.type)
    start = ORIGIN if options.get("init") is None else None  # checked once the clip is read
    met = read_keys(keys, model, start) if isinstance(keys, (str, Path)) else check_keys(keys, start)
    check_length(met, min(sum(part.seconds for part in plan) for plan in plans))
    synthesis = SynthesisOptions(**options, keys=met)
    named = {"list of types": len(plans), "character": len(synthesis.characters)}
    for what, least in named.items():
        if 1 < synthesis.count < least:
            expected = f"a count of {least} or more, one for each {what}"
            raise ControlError(f"expected {expected}, found {synthesis.count}")
    count = max(synthesis.count, *named.values())
    return SynthesisRequest(model, plans, replace(synthesis, count=count))


def loop_wish(types: str | Sequence[str], seconds: float | None) -> float | None:
    """The length of loops in seconds: the one given, or that of their types, such as "walking:2"; None for any.

    Raises:
        ControlError: a loop is of several types, or they have different lengths.
        MotionkitError: no loop can be so long.
    """
    from motionkit.editing.loop import check_seconds

    texts = [types] if isinstance(types, str) else types
    times = set()
    for text in texts:
        first, *others = parse_types(text)
        if others:
            raise ControlError(f"a loop takes one motion type, such as walking, found {text!r}")
        times |= {first.seconds} if ":" in text else set()
    if seconds is None and len(times) > 1:
        found = ", ".join(f"{time:g}" for time in sorted(times))
        raise ControlError(f"expected one length in seconds for all loops, found {found}")
    seconds = seconds if seconds is not None else next(iter(times), None)
    check_seconds(seconds)
    return seconds


@dataclass(frozen=True, eq=False)
class PathRequest:
    """A path to follow, in the world of the written motion, with the model and its options.

    Attributes:
        size: size of the body that is written, a character or a rig, relative to the one that the model moves.
    """

    model: MotionModel
    path: Path2D
    options: SynthesisOptions
    size: float = 1.0

    def on_rig(self, size: float, strict: bool = False) -> PathRequest:
        """The same request for a rig of a size relative to the character.

        Raises ControlError with strict for a speed outside the range of a gait's recordings.
        """
        request = replace(self, size=self.size * size)
        if strict:
            check_speeds(self.model, request.moved, request.size)
        return request

    @property
    def moved(self) -> Path2D:
        """The path in the world of the body that the model moves."""
        return self.path if self.size == 1.0 else self.path.scaled(1.0 / self.size)

    @property
    def doubtful(self) -> list[str]:
        """Lines for what may not look right: speeds that are not kept, and parts too short for their type."""
        given = self.model, self.moved, self.size
        return other_speeds(*given) + doubtful_parts(*given)

    @property
    def seconds(self) -> float:
        """Duration of the path at the requested speeds."""
        return plan_path(self.model, self.moved).seconds

    def run(self, progress: Callable[[float], None] | None = None) -> FollowResult:
        """Follow the path; progress is called with the fraction done."""
        return follow.follow_path(self.model, self.moved, self.options, progress)


def is_path_file(path: str | Path) -> bool:
    """Whether a path is a file rather than a named shape, which has no ending."""
    return Path(path).suffix != "" or Path(path).is_file()


def path_request(
    path: Path2D | str | Path,
    *,
    types: str | None = None,
    size: float | None = None,
    speed: float | None = None,
    strict: bool = False,
    model: MotionModel | str | Path | None = None,
    reference: str = "auto",
    **options: Any,
) -> PathRequest:
    """The request of mk.follow_path, with the same arguments; options are fields of SynthesisOptions.

    Raises:
        ControlError: a path that cannot be read; an unknown type or shape; options of named shapes for another path;
            with strict, a speed outside the range of a gait's recordings.
    """
    model = _opened(model, reference)
    if isinstance(path, Path2D) or is_path_file(path):
        target = path if isinstance(path, Path2D) else read_path(path)
        check_shape_options(types, size, speed)
    else:
        kinds = [nfc(word.strip()) for word in (walking_type(model) if types is None else types).split(",")]
        if not all(kinds):
            raise ControlError(f"expected types such as running,cartwheel, found {types!r}")
        target = shape_path(str(path), size, kinds, speed)
    request = PathRequest(model, target, SynthesisOptions(**options))
    return request.on_rig(model.body_scale(request.options.character), strict)
