"""What a user asks for: motion types one after another, each for a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from motionkit.arrays import Array
from motionkit.control.momentum import carried_over
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.standing import Present, Stances, comes_to_stand, settling
from motionkit.errors import ControlError
from motionkit.features.control import Controls, blend_types, types_ahead
from motionkit.features.reference import PAUSE
from motionkit.inference.rollout import Controller
from motionkit.models.model import MotionModel
from motionkit.names import nfc

DEFAULT_SECONDS = 4.0
MAX_SECONDS = 3600.0


@dataclass(frozen=True)
class TypePart:
    """A motion type for some seconds."""

    type: str
    seconds: float


def parse_types(
    text: str, seconds: float | None = None, usual: Callable[[str], float] | None = None
) -> list[TypePart]:
    """Parts from "running,cartwheel" or "running:4,cartwheel:3".

    Args:
        seconds: the whole length, shared by the parts that name none.
        usual: tells how long a type usually takes, zero for any time; without seconds, a part that
            names none takes so long, or 4 s.

    Raises:
        ControlError: for a part without a type, or a time that is no positive number.
    """
    words = [nfc(word.strip()) for word in text.split(",")]
    if not any(words):
        raise ControlError("expected motion types such as running,cartwheel, found none")
    timed: list[tuple[str, float | None]] = []
    for word in words:
        name, _, time = word.partition(":")
        if not name:
            raise ControlError(f"expected type or type:seconds, found {word!r}")
        timed.append((name.strip(), _seconds(time, word) if time else None))
    free = [name for name, time in timed if time is None]
    given = sum(time for _, time in timed if time is not None)
    if seconds is not None and free:
        share = (seconds - given) / len(free)
        if share <= 0:
            raise ControlError(f"the parts alone take {given:g} s, more than the {seconds:g} s asked for")
    elif seconds is not None:
        # Every part says its time: stretch them to the whole.
        return [TypePart(name, time * seconds / given) for name, time in timed if time is not None]
    else:
        natural = usual or (lambda name: 0.0)
        return [TypePart(name, time or natural(name) or DEFAULT_SECONDS) for name, time in timed]
    return [TypePart(name, share if time is None else time) for name, time in timed]


def _seconds(text: str, word: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ControlError(f"expected seconds after the colon, found {word!r}") from None
    if not 0 < value <= MAX_SECONDS:
        raise ControlError(f"expected between 0 and {MAX_SECONDS:g} seconds, found {word!r}")
    return value


def type_track(model: MotionModel, parts: Sequence[TypePart]) -> Array:
    """The type id (T,) of every frame of the parts; raises ControlError for an unknown type."""
    ids = [model.type_id(part.type) for part in parts]
    counts = [_frames(model, part) for part in parts]
    return np.repeat(ids, counts)


def whole_performances(model: MotionModel, parts: Sequence[TypePart], behind: int = 0) -> list[TypePart]:
    """The parts with whole performances: what is left of their time goes to the next part.

    A body whose type changes while it is upside down has no way to go on but to flip over. The last part keeps its
    time, and so does one that is shorter than a performance. A performance after another begins after a pause, and gets
    the time of the pause besides where it would lack it.

    Args:
        behind: frames of the first part's performance that have been shown already.
    """
    out, left, ended = [], 0.0, False
    pause, frame = PAUSE / model.fps, 1.0 / model.fps
    for number, part in enumerate(parts):
        seconds, left = round(part.seconds * model.fps) / model.fps + left, 0.0
        length = model.phase_seconds(part.type) if _turns_over(model, part.type) else 0.0
        first = length - (behind / model.fps if number == 0 else 0.0)
        if length and ended:
            first += pause
            seconds = first if first - pause - frame < seconds < first else seconds
        ended = bool(length) and seconds > first - frame
        if length and first > 0.0 and number + 1 < len(parts) and seconds > first:
            again = length + pause
            whole = round((first + again * int((seconds - first) / again)) * model.fps) / model.fps
            seconds, left = whole, seconds - whole
        out.append(TypePart(part.type, seconds))
    return out


def _turns_over(model: MotionModel, kind: str) -> bool:
    known = model.types.get(kind)
    return known is not None and known.performed


def crowd_controller(
    model: MotionModel,
    plans: list[list[TypePart]],
    near: list[Array],
    behind: list[int],
    choice: int = 0,
    speeds: Sequence[float] | None = None,
    present: Present | None = None,
) -> Controller:
    """Controls of a crowd: characters take the plans in turn, and repeat the last frame of theirs.

    Args:
        near: for each character the pose embeddings of its last start frames (last_poses).
        behind: for each character the frames of its first performance that the start frames have shown.
        choice: picks among reference clips; each character makes a choice of its own.
        speeds: of the characters over the ground in cm/s, if they are known.
        present: the last frames of the characters, whose stances show how to go on where they come to a stand.
    """
    turn = [i % len(plans) for i in range(len(near))]
    asked = [
        plan_controls(model, plans[t], near[i], behind[i], choice + i, speeds[i] if speeds else None)
        for i, t in enumerate(turn)
    ]
    together = Controls.side_by_side(asked)
    last = len(together.phase) - 1
    stances = Stances(model, together, [_stands(model, plans[t]) for t in turn], present)

    def controls(frame: int, ground: Array) -> Controls:
        stances.at(frame)
        return together.at(min(frame, last))

    return controls


def _stands(model: MotionModel, parts: Sequence[TypePart]) -> list[tuple[str, int, int | None]]:
    """The parts of standing after other ones: type, first frame, and the frame after the last, None at the end."""
    out: list[tuple[str, int, int | None]] = []
    runs = [
        (kind, sum(_frames(model, part) for part in run)) for kind, run in groupby(parts, lambda p: p.type)
    ]
    before, begin = None, 0
    for number, (kind, frames) in enumerate(runs):
        if comes_to_stand(model, before, kind):
            out.append((kind, begin, begin + frames if number + 1 < len(runs) else None))
        before, begin = kind, begin + frames
    return out


def _frames(model: MotionModel, part: TypePart) -> int:
    return max(1, round(part.seconds * model.fps))


def plan_weights(model: MotionModel, parts: Sequence[TypePart]) -> Array:
    """Type weights (T, N) of the parts, blended over 40 frames at each change."""
    return blend_types(type_track(model, parts), len(model.types))


def plan_controls(
    model: MotionModel,
    parts: Sequence[TypePart],
    near: Array,
    behind: int = 0,
    choice: int = 0,
    speed: float | None = None,
) -> Controls:
    """Controls (T, ...) of the parts one after another, with reference poses.

    Args:
        near: (S, 24) pose embeddings of the frames before (last_poses).
        behind: frames of the first part's performance that have been shown already.
        choice: picks among the reference clips of the types.
        speed: of the body over the ground in cm/s, if it is known.
    """
    player = ReferencePlayer(model, choice)
    asked = []
    for number, part in enumerate(parts):
        before, paused = player.speed, player.ends and _turns_over(model, part.type)
        settles = comes_to_stand(model, parts[number - 1].type if number else None, part.type)
        if number == 0:
            player.begin(part.type, near, behind, speed=speed)
        else:
            player.begin(part.type, paused=paused, settles=settles)
        clip, at = player.clip, player.at
        controls = player.play(_frames(model, part))
        if settles:
            controls = settling(controls, before, model.fps)
        elif before is not None and clip is not None and not paused:
            controls = carried_over(controls, clip.ground[at:], before, model.fps)
        asked.append(controls)
    weights = plan_weights(model, parts)
    ahead = types_ahead(weights) if model.plain else None
    return replace(Controls.concatenated(asked), type_weights=weights, types_ahead=ahead)
