"""Response: seconds from a command until the motion shows it (the responsiveness of Starke et al. 2020).

Characters are driven as a user drives them: a Driver turns the wish of the moment into controls. A command has been
answered at the first frame from which its condition holds for HELD_SECONDS. Velocities are read from windows
around a frame; the answer counts from the end of the window, so that no look ahead makes it seem sooner.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array
from motionkit.control.drive import Driver, Wish
from motionkit.evaluation.body import SPEED_SPAN, Body, spans
from motionkit.evaluation.report import Cell, Goal, Section, Table
from motionkit.evaluation.rolling import Progress, roll_controlled
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.inference.rollout import FrameControls
from motionkit.models.checkpoint import MotionModel

BEFORE_SECONDS, AFTER_SECONDS = 2.0, 4.0
HELD_SECONDS = 0.25
DIRECTION_LIMIT = math.radians(15.0)
SPEED_SHARE = 0.15
TARGET_SECONDS = 0.5
STEADY_SECONDS = 1 / 3  # over which a speed is taken: a step's own ups and downs are no answer
DEFAULT_SPEED = 1.3  # m/s of a type whose speed the model does not know

# Called with the motion from the command on; (T,) whether each frame answers it.
Answer = Callable[[Body], Array]


@dataclass(frozen=True, eq=False)
class Command:
    """One change of wish: what is wanted before and after it, what answers it, and seconds that looks ahead."""

    name: str
    group: str
    before: Wish
    after: Wish
    answers: Answer
    looks_ahead: float = SPEED_SPAN / 2


# What shows a type at once: speed over the ground (m/s), and its part along the facing.
_SHOWS: dict[str, Answer] = {
    "idle": lambda body: body.speed < 0.25,
    "walking": lambda body: (body.speed > 0.4) & (body.speed < 2.0) & (body.velocity[:, 1] > 0.0),
    "running": lambda body: (body.speed > 1.8) & (body.velocity[:, 1] > 0.0),
    "b-walking": lambda body: body.velocity[:, 1] < -0.3,
}


def commands(model: MotionModel) -> list[Command]:
    """The commands of the scoreboard, those with types the model knows."""

    def ahead(kind: str, angle: float = 0.0, share: float = 1.0) -> Wish:
        gait = model.gaits.get(kind)
        speed = share * (100.0 * DEFAULT_SPEED if gait is None else gait.speed)
        velocity = (0.0, 0.0) if kind == "idle" else (speed * math.sin(angle), speed * math.cos(angle))
        return Wish(velocity, None if gait is None or kind == "idle" else angle - gait.facing, kind)

    changes = [
        ("idle", "walking"),
        ("walking", "idle"),
        ("walking", "running"),
        ("running", "walking"),
        ("running", "idle"),
        ("idle", "b-walking"),
    ]
    out = [Command(f"{a} → {b}", "type", ahead(a), ahead(b), _SHOWS[b]) for a, b in changes]
    for kind in ("walking", "running"):
        for name, angle in (("left", math.pi / 2), ("right", -math.pi / 2)):
            answer = _goes_towards(angle)
            out.append(Command(f"{kind}, 90° {name}", "direction", ahead(kind), ahead(kind, angle), answer))
        for first, then in ((0.8, 1.2), (1.2, 0.8)):
            before, after = ahead(kind, share=first), ahead(kind, share=then)
            wanted = math.hypot(*(after.velocity or (0.0, 0.0))) / 100.0
            name = f"{kind}, {first:.0%} → {then:.0%} of its speed"
            ahead_by = (SPEED_SPAN + STEADY_SECONDS) / 2
            out.append(Command(name, "speed", before, after, _goes_at(wanted), ahead_by))
    return [c for c in out if {c.before.type, c.after.type} <= set(model.types)]


def _goes_towards(angle: float) -> Answer:
    def answers(body: Body) -> Array:
        # Back from facing to the world: velocity turned by the heading.
        left, forward = np.moveaxis(body.velocity, -1, 0)
        way = body.heading + np.arctan2(left, forward)
        off = np.remainder(way - angle + math.pi, 2 * math.pi) - math.pi
        return (np.abs(off) < DIRECTION_LIMIT) & (body.speed > 0.3)

    return answers


def _goes_at(speed: float) -> Answer:
    def answers(body: Body) -> Array:
        width = round(body.fps * STEADY_SECONDS) // 2 * 2 + 1
        padded = np.pad(body.speed, width // 2, mode="edge")
        smooth = sliding_window_view(padded, width).mean(axis=-1)
        return np.abs(smooth / speed - 1.0) < SPEED_SHARE

    return answers


def response_seconds(answered: Array, fps: float) -> float | None:
    """Seconds until flags (T,) hold for HELD_SECONDS, None if they never do."""
    held = round(HELD_SECONDS * fps)
    return next((start / fps for start, end in spans(answered) if end - start >= held), None)


class _Commanded:
    """A character whose wish changes at one frame; a Controller."""

    def __init__(self, model: MotionModel, command: Command) -> None:
        self.driver, self.command = Driver(model, command.before.type), command
        self.change = round(BEFORE_SECONDS * model.fps)
        self.driver.set_wish(command.before)

    def __call__(self, frame: int, ground: Array) -> FrameControls:
        if frame == self.change:
            self.driver.set_wish(self.command.after)
        return self.driver(frame, ground)


def response_section(model: MotionModel, settings: EvaluationSettings, progress: Progress) -> Section:
    """The section of the scoreboard: seconds to each answer; no answer at all counts as AFTER_SECONDS."""
    wanted = [c for c in commands(model) for _ in range(settings.few)]
    if not wanted:
        return Section("response", "Response", [], [], ["the model has none of the types that are driven"])
    frames = round((BEFORE_SECONDS + AFTER_SECONDS) * model.fps)
    performed = roll_controlled(
        model,
        [c.before.type or "" for c in wanted],
        [_Commanded(model, c) for c in wanted],
        frames,
        settings.noise,
        settings.seed,
        progress,
    )
    change = round(BEFORE_SECONDS * model.fps)
    held = round(HELD_SECONDS * model.fps)
    rows: list[tuple[Cell, ...]] = []
    groups: dict[str, list[float]] = {}
    for number in range(0, len(wanted), settings.few):
        command = wanted[number]
        seconds: list[float] = []
        unanswered = already = 0
        for made in performed[number : number + settings.few]:
            flags = command.answers(made.body)
            if bool(flags[change - held : change].all()):
                already += 1
                continue
            answer = response_seconds(flags[change:], model.fps)
            unanswered += answer is None
            seconds.append(AFTER_SECONDS if answer is None else answer + command.looks_ahead)
        groups.setdefault(command.group, []).extend(seconds)
        mean = sum(seconds) / len(seconds) if seconds else None
        rows.append((command.group, command.name, mean, max(seconds, default=None), unanswered, already))
    goals = [
        Goal(
            f"response to a change of {group}, s",
            sum(seconds) / len(seconds) if seconds else None,
            f"≤ {TARGET_SECONDS:g}",
            None,
            TARGET_SECONDS,
        )
        for group, seconds in groups.items()
    ]
    columns = ("change of", "command", "seconds, mean", "slowest", "never answered", "so already")
    notes = [
        f"{settings.few} characters a command, driven by the live Driver for {BEFORE_SECONDS:g} s before; answered: "
        f"from the first frame from which it holds for {HELD_SECONDS:g} s; never counts as {AFTER_SECONDS:g} s; who "
        "did so already before the command does not count",
        "type: idle below 0.25 m/s, walking 0.4 to 2 m/s ahead, running above 1.8 m/s ahead, b-walking 0.3 m/s "
        "backwards; direction: root within 15° of the asked way; speed: within 15 % of the asked, over 1/3 s",
    ]
    return Section("response", "Response", [Table("Seconds to an answer", columns, rows)], goals, notes)
