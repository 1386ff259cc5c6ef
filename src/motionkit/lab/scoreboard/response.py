"""Response time: seconds from a command until the motion shows it (the responsiveness of Starke et al. 2020).

Characters are driven as in live control: a Driver turns the current wish into controls. The response is the first
frame from which the command's condition holds for LASTING_SECONDS. Velocities are measured over windows around a
frame. The response counts from the end of the window, so that looking ahead cannot shorten it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array, spans
from motionkit.control.drive import Driver, Wish
from motionkit.control.steering import usual_gaits
from motionkit.lab.scoreboard.report import Section, all_of, at_most
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.body import Body
from motionkit.metrics.pace import PACE_SECONDS
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.tables import Cell, Table
from motionkit.training.verdict.rolling import Driven, Progress, grouped, roll_live

BEFORE_SECONDS, AFTER_SECONDS = 2.0, 4.0
LASTING_SECONDS = 0.25
DIRECTION_LIMIT = math.radians(15.0)
SPEED_SHARE = 0.15
TARGET_SECONDS = 0.5
STEADY_AFTER = 2.0  # seconds after a change of speed; from then on the speed counts as steady
STEADY_SHARE = 0.05
STEADY_SECONDS = 1 / 3  # over which a speed is averaged, because it varies within a step

# Takes a body and returns flags (T,): whether each frame meets the command.
Answer = Callable[[Body], Array]


@dataclass(frozen=True, eq=False)
class Command:
    """A change of wish.

    Attributes:
        name, group: the command, and the kind of change: type, direction or speed.
        before, after: the wish before and after the command.
        answers: the condition that the motion must meet.
        looks_ahead: seconds by which the condition looks ahead.
        speed: m/s that are to be kept after a change of speed.
    """

    name: str
    group: str
    before: Wish
    after: Wish
    answers: Answer
    looks_ahead: float = PACE_SECONDS / 2
    speed: float | None = None


def _is_standing(body: Body) -> Array:
    return body.speed < 0.25


def _walks(body: Body) -> Array:
    return (body.speed > 0.4) & (body.speed < 2.0) & (body.velocity[:, 1] > 0.0)


def _runs(body: Body) -> Array:
    return (body.speed > 1.8) & (body.velocity[:, 1] > 0.0)


def _goes_back(body: Body) -> Array:
    return body.velocity[:, 1] < -0.3


def commands(model: MotionModel) -> list[Command]:
    """Return the commands of the scoreboard for the gaits that the model has."""
    gaits = usual_gaits(model)

    def ahead(kind: str, angle: float = 0.0, share: float = 1.0) -> Wish:
        each = model.types[kind]
        if each.kind is MotionKind.STANCE or each.gait is None:
            return Wish((0.0, 0.0), None, kind)
        speed = share * each.gait.speed
        return Wish((speed * math.sin(angle), speed * math.cos(angle)), angle - each.gait.facing, kind)

    idle, walk, run, back = gaits.stand, gaits.walk, gaits.run, gaits.back
    changes = [
        (idle, walk, _walks),
        (walk, idle, _is_standing),
        (walk, run, _runs),
        (run, walk, _walks),
        (run, idle, _is_standing),
        (idle, back, _goes_back),
    ]
    out = [
        Command(f"{a} → {b}", "type", ahead(a), ahead(b), shows)
        for a, b, shows in changes
        if a is not None and b is not None
    ]
    for kind in (walk, run):
        if kind is None:
            continue
        for name, angle in (("left", math.pi / 2), ("right", -math.pi / 2)):
            answer = _goes_towards(angle)
            out.append(Command(f"{kind}, 90° {name}", "direction", ahead(kind), ahead(kind, angle), answer))
        for first, then in ((0.8, 1.2), (1.2, 0.8)):
            before, after = ahead(kind, share=first), ahead(kind, share=then)
            goal = math.hypot(*(after.velocity or (0.0, 0.0))) / 100.0
            name = f"{kind}, {first:.0%} → {then:.0%} of its speed"
            ahead_by = (PACE_SECONDS + STEADY_SECONDS) / 2
            out.append(Command(name, "speed", before, after, _goes_at(goal), ahead_by, goal))
    return out


def _goes_towards(angle: float) -> Answer:
    def answers(body: Body) -> Array:
        # The direction of the velocity in the world.
        left, forward = np.moveaxis(body.velocity, -1, 0)
        direction = body.heading + np.arctan2(left, forward)
        off = np.remainder(direction - angle + math.pi, 2 * math.pi) - math.pi
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
    """Return the seconds until flags (T,) hold for LASTING_SECONDS; None if they never do."""
    lasting = round(LASTING_SECONDS * fps)
    return next((start / fps for start, end in spans(answered) if end - start >= lasting), None)


def _commanded(model: MotionModel, command: Command) -> Driven:
    """A live character whose wish changes at one frame."""
    change = round(BEFORE_SECONDS * model.fps)

    def steer(frame: int, driver: Driver) -> None:
        if frame in (0, change):
            driver.set_wish(command.before if frame == 0 else command.after)

    return Driven(command.before.type or "", steer)


def response_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: the response time of each command; no response counts as AFTER_SECONDS."""
    model, settings = trial.model, trial.settings
    changes = commands(model)
    if not changes:
        note = "not measured: the model has no gaits to be commanded"
        return Section("response", "Response time", notes=[note])
    frames = round((BEFORE_SECONDS + AFTER_SECONDS) * model.fps)
    characters = [_commanded(model, command) for command in changes for _ in range(settings.repeats)]
    takes = roll_live(model, characters, frames, settings.noise, settings.first_seed, progress)
    rows: list[tuple[Cell, ...]] = []
    groups: dict[str, list[float]] = {}
    kept: list[float] = []
    compared: dict[str, bool] = {}
    for command, mine in zip(changes, grouped(takes, settings.repeats), strict=True):
        seconds, unanswered, already = _responses(command, [take.default for take in mine])
        raw, _, _ = _responses(command, [take.raw for take in mine])
        groups.setdefault(command.group, []).extend(seconds)
        off = _speed_off(command, [take.default for take in mine])
        kept += off
        slowest, mean, matched = max(seconds, default=None), _mean(seconds), None
        if trial.matched.knows(command.before.type, command.after.type):
            body = trial.matched.live(_commanded(model, command), frames)
            matched = _mean(_responses(command, [body])[0])
        if mean is not None and matched is not None:
            compared[command.name] = mean <= matched
        rows.append((
            command.group, command.name, mean, slowest, _mean(raw), unanswered, already, _mean(off), matched,
        ))  # fmt: skip
    goals = [
        at_most(f"mean response time to a change of {group}, s", _mean(seconds), TARGET_SECONDS)
        for group, seconds in groups.items()
    ]
    if kept:
        what = f"speed that is kept from {STEADY_AFTER:g} s after a change of it: off by"
        goals.append(at_most(what, _mean(kept), STEADY_SHARE, number_format=".0%"))
    if compared:
        slower = [name for name, sooner in compared.items() if not sooner]
        goals.append(
            all_of("answered as soon as by motion matching: share of commands", list(compared), slower)
        )
    columns = (
        *("change of", "command", "mean, s", "slowest, s", "raw mean, s", "no response", "met before"),
        "speed off by",
        "motion matching, s",
    )
    notes = [
        f"{settings.repeats} characters per command, driven as play drives them by default, from {BEFORE_SECONDS:g} s "
        f"before it; response: the first frame from which the condition holds for {LASTING_SECONDS:g} s; no response "
        f"counts as {AFTER_SECONDS:g} s; characters that met the condition before the command are left out",
        "conditions: standing below 0.25 m/s, a walk 0.4 to 2 m/s forwards, a run above 1.8 m/s forwards, going back "
        "0.3 m/s backwards; direction: root within 15° of the commanded one; speed: within 15 % of the commanded one, "
        "averaged over 1/3 s",
        f"speed off by: the mean speed from {STEADY_AFTER:g} s after the command against the commanded one; motion "
        "matching: one character, over the training clips, for the same trajectories and types",
    ]
    return Section(
        "response", "Response time", [Table("Response time per command", columns, rows)], goals, notes
    )


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _speed_off(command: Command, bodies: list[Body]) -> list[float]:
    """Return the share by which each body's mean speed is off the commanded one once it is kept."""
    if command.speed is None:
        return []
    kept = [body.cut(round((BEFORE_SECONDS + STEADY_AFTER) * body.fps), len(body)) for body in bodies]
    return [abs(float(body.speed.mean()) / command.speed - 1.0) for body in kept if len(body)]


def _responses(command: Command, bodies: list[Body]) -> tuple[list[float], int, int]:
    """Return the response times in seconds, how many never answered, and how many met the condition before."""
    seconds: list[float] = []
    unanswered = already = 0
    for body in bodies:
        change, lasting = round(BEFORE_SECONDS * body.fps), round(LASTING_SECONDS * body.fps)
        flags = command.answers(body)
        if bool(flags[change - lasting : change].all()):
            already += 1
            continue
        answer = response_seconds(flags[change:], body.fps)
        unanswered += answer is None
        seconds.append(AFTER_SECONDS if answer is None else answer + command.looks_ahead)
    return seconds, unanswered, already
