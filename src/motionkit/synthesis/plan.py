"""What a user asks for: motion types one after another, each for a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.errors import ControlError
from motionkit.features.control import TRAJECTORY_COUNT, blend_types
from motionkit.models.checkpoint import MotionModel
from motionkit.synthesis.rollout import Controller, FrameControls, progress_at

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
    words = [word.strip() for word in text.split(",")]
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


def type_track(model: MotionModel, parts: list[TypePart]) -> Tensor:
    """The type id (T,) of every frame of the parts; raises ControlError for an unknown type."""
    ids = [model.type_id(part.type) for part in parts]
    counts = [max(1, round(part.seconds * model.fps)) for part in parts]
    return torch.cat([torch.full((count,), i) for i, count in zip(ids, counts, strict=True)])


def crowd_controller(
    model: MotionModel, plans: list[list[TypePart]], batch: int, behind: list[int], choice: int = 0
) -> Controller:
    """What is asked of a crowd: characters take the plans in turn, and go on with the last frame of theirs.

    Args:
        behind: for each plan the frames of its first performance that lie behind already.
        choice: picks among the recorded tracks of a type.
    """
    longest = max(len(type_track(model, plan)) for plan in plans)

    def whole(values: Tensor) -> Tensor:
        return torch.cat([values, values[-1:].expand(longest - len(values), *values.shape[1:])])

    weights = torch.stack([whole(plan_weights(model, plan)) for plan in plans], 1)
    pairs = list(zip(plans, behind, strict=True))
    progress = torch.stack([whole(plan_progress(model, plan, first)) for plan, first in pairs], 1)
    tracks = [plan_tracks(model, plan, first, choice) for plan, first in pairs]
    trajectory, given = (torch.stack([whole(t[i]) for t in tracks], 1) for i in (0, 1))
    turn = torch.arange(batch) % len(plans)

    def controls(frame: int, ground: Tensor) -> FrameControls:
        now = min(frame, longest - 1)
        return FrameControls(weights[now, turn], trajectory[now, turn], given[now, turn], progress[now, turn])

    return controls


def plan_weights(model: MotionModel, parts: list[TypePart]) -> Tensor:
    """Blended type weights (T, N) of the parts: 40 frames at each change."""
    return blend_types(type_track(model, parts), len(model.types))


def plan_progress(model: MotionModel, parts: list[TypePart], first_frame: int = 0) -> Tensor:
    """Progress (T,) through performances of the parts' types, negative for types without a phase.

    Args:
        first_frame: frames of the first part's performance that lie behind already.
    """
    out: list[float] = []
    for number, part in enumerate(parts):
        frames = max(1, round(part.seconds * model.fps))
        length = model.phase_seconds(part.type) * model.fps
        skipped = first_frame if number == 0 else 0
        out.extend(progress_at(frame + skipped, length) for frame in range(frames))
    return torch.tensor(out)


def plan_tracks(
    model: MotionModel, parts: list[TypePart], first_frame: int = 0, choice: int = 0
) -> tuple[Tensor, Tensor]:
    """Trajectory numbers (T, 24) of recorded performances, and where they count (T,), for types that have them.

    A cartwheel to the left is as good as one to the right, and a model that knows both does neither;
    the trajectory of a recorded one decides. choice picks among the tracks of a type.
    """
    trajectory, given = [], []
    for number, part in enumerate(parts):
        frames = max(1, round(part.seconds * model.fps))
        tracks = model.tracks.get(part.type)
        given.append(torch.full((frames,), float(bool(tracks))))
        if not tracks:
            trajectory.append(torch.zeros(frames, TRAJECTORY_COUNT))
            continue
        track = tracks[choice % len(tracks)]
        behind = first_frame if number == 0 else 0
        trajectory.append(track[(torch.arange(frames) + behind) % len(track)])
    return torch.cat(trajectory), torch.cat(given)
