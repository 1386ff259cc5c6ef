"""Path following (paper 5.2): distance from each path, and the speed and braking of bodies that follow it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, spans
from motionkit.control.path import METRE, SHAPES, Path2D, PathPart, make_path, shape_path
from motionkit.control.speeds import other_speeds, part_speeds
from motionkit.control.steering import usual_gaits
from motionkit.lab.scoreboard.limits import REAL_SHARE, acceleration_limit, accelerations
from motionkit.lab.scoreboard.report import Goal, Section, all_of, at_least, at_most
from motionkit.lab.scoreboard.roles import find_roles
from motionkit.lab.scoreboard.starts import LOW
from motionkit.lab.scoreboard.trial import Trial
from motionkit.lab.scoreboard.visible import flips, value_of
from motionkit.metrics.body import STANDING_TOE, Body
from motionkit.metrics.ground import TOES, ground_speed
from motionkit.metrics.leaps import leaps
from motionkit.metrics.pace import PACE_SECONDS
from motionkit.metrics.touch import hover_share, planted_share, touching
from motionkit.metrics.trajectory import trajectory_distance
from motionkit.metrics.value import MetricValue
from motionkit.models.model import MotionModel
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.floor import foot_positions
from motionkit.tables import Cell, Table
from motionkit.training.verdict.rolling import Progress, Walk, grouped, roll_paths

SPEED_SHARE = 0.15  # largest difference from the requested speed, as a share of it
STANDING_SPEED = 0.15  # m/s; a root slower than this stands
STOP_SECONDS, STOP_SHARE = 2.0, 0.75  # seconds of a stop on a path, and the least share of them to stand


@dataclass(frozen=True)
class PathTrial:
    """A path, its target in cm, m/s asked for in its first parts, and seconds to stand somewhere on the way."""

    name: str
    path: Path2D
    target: float
    speeds: tuple[float, ...] = ()
    stop_seconds: float = 0.0


def path_trials(
    walking: str, running: str, performance: str | None = None, hops: tuple[str, ...] = ()
) -> list[PathTrial]:
    """Return the paths of the scoreboard at usual speeds.

    A performance is shown in the middle of a run, if there is one; types that hop along come before and after a run.
    """
    corner = SHAPES["pentagram"](6.0 * METRE)[:3]
    trials = [
        PathTrial(f"line 10 m, {walking}", shape_path("line", 10.0, [walking], None), 0.8),
        PathTrial(f"circle r = 3 m, {walking}", shape_path("circle", 3.0, [walking], None), 0.8),
        PathTrial(f"circle r = 6 m, {running}", shape_path("circle", 6.0, [running], None), 2.0),
        PathTrial(f"figure-eight r = 2 m, {walking}", shape_path("figure-eight", 2.0, [walking], None), 0.8),
        PathTrial(f"pentagram corner (144°), {running}", make_path([PathPart(corner, running)]), 2.0),
        PathTrial(f"square (90°), {running}", shape_path("square", 5.0, [running], None), 1.0),
        PathTrial(f"zigzag (135°), {running}", make_path([PathPart(_zigzag(135.0), running)]), 1.5),
        PathTrial(f"U-turn, {walking}", shape_path("u-turn", 6.0, [walking], None), 0.8),
    ]
    if performance is not None:
        trials.append(_mixed((running, 6), (performance, 3), (running, 6)))
    if hops:
        first, last = hops[-1], hops[0]
        ends = ((first, 4), (last, 4)) if first != last else ((first, 4),)
        trials.append(_mixed(*ends, (running, 6), *ends[::-1]))
    return trials


def _zigzag(degrees: float, side: float = 4.0 * METRE, sides: int = 5) -> Array:
    """Corners (sides + 1, 2) of a path that turns by some degrees to the left and to the right in turn."""
    headings = np.radians(degrees) * (np.arange(sides) % 2)
    steps = side * np.stack([np.sin(headings), np.cos(headings)], axis=-1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def _mixed(*parts: tuple[str, float]) -> PathTrial:
    """Return a straight path of several types, each with a length in metres."""
    ends = METRE * np.cumsum([0.0, *(metres for _, metres in parts)])
    stretches = [
        PathPart(np.array([[0.0, start], [0.0, end]], np.float32), kind)
        for (kind, _), start, end in zip(parts, ends[:-1], ends[1:], strict=True)
    ]
    return PathTrial(" → ".join(kind for kind, _ in parts), make_path(stretches), 2.0)


def speed_trials(walking: str, running: str, standing: str | None = None) -> list[PathTrial]:
    """Return paths from 0.3 to 5 m/s, one that brakes, and one with a stop for a model that can stand."""
    trials = []
    for speed, kind in (
        (0.3, walking),
        (0.7, walking),
        (1.3, walking),
        (2.0, running),
        (3.5, running),
        (5.0, running),
    ):
        length = max(4.0, 5.0 * speed)
        path = shape_path("line", length, [kind], speed)
        trials.append(PathTrial(f"line {length:g} m at {speed:g} m/s, {kind}", path, 2.0, (speed,)))
    circle = shape_path("circle", 6.0, [running], 5.0)
    trials.append(PathTrial(f"circle r = 6 m at 5 m/s, {running}", circle, 5.0, (5.0,)))
    parts = [
        PathPart(np.array([[0.0, 0.0], [0.0, 8.0 * METRE]]), running, 3.6 * METRE),
        PathPart(np.array([[0.0, 14.0 * METRE]]), walking, 1.0 * METRE),
    ]
    trials.append(PathTrial(f"{running} at 3.6 m/s → {walking} at 1 m/s", make_path(parts), 2.0, (3.6, 1.0)))
    if standing is None:
        return trials
    stop = [
        PathPart(np.array([[0.0, 0.0], [0.0, 5.0 * METRE]]), walking, 1.3 * METRE, STOP_SECONDS),
        PathPart(np.array([[0.0, 10.0 * METRE]]), walking, 1.3 * METRE),
    ]
    name = f"{walking}, stop for {STOP_SECONDS:g} s, {walking}"
    trials.append(PathTrial(name, make_path(stop), 2.0, (1.3,), STOP_SECONDS))
    return trials


def steered_types(model: MotionModel) -> tuple[str, str] | None:
    """Return the types to walk and to run paths with; a model that has one of them does both with it.

    None for a model without gaits.
    """
    gaits = usual_gaits(model)
    walking, running = gaits.walk or gaits.run, gaits.run or gaits.walk
    return None if walking is None or running is None else (walking, running)


def paths_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: distance from each path, how often its end was reached, speed, braking and feet."""
    model, settings = trial.model, trial.settings
    gaits = steered_types(model)
    if gaits is None:
        return Section(
            "paths", "Path following", notes=["not measured: the model has no gait to follow a path with"]
        )
    roles = find_roles(trial)
    usual = path_trials(*gaits, next(iter(roles.performances), None), roles.hops)
    requested = speed_trials(*gaits, roles.gaits.stand)
    tasks = [(t.path, seed) for t in (*usual, *requested) for seed in trial.seeds(settings.repeats)]
    walks = roll_paths(model, tasks, settings.noise, trial.each, progress)
    groups = grouped(walks, settings.repeats)
    first, goals = _distances(trial, usual, groups[: len(usual)])
    second, more = _speeds(trial, requested, groups[len(usual) :])
    notes = [
        f"{settings.repeats} characters per path, as follow-path makes them by default; raw: feet not locked; "
        "distance: from the root to the nearest point of the path (path-mean, path-max), over all frames until the "
        "end; mean over characters, and the largest; slip: mean speed over the ground of toes less than "
        f"{LOW:g} cm above a standing one; recorded: all recordings of the path's types; "
        "motion matching: over the training clips, feet locked",
        "speed: mean over each part without its first and last second, against the one that follow-path goes at, which "
        "for a gait is no slower or faster than its recordings look right; acceleration: largest of the root over the "
        f"ground, between velocities over 0.2 s, against what {REAL_SHARE:.1%} of the recorded frames of the path's "
        "types stay below; steps: planted toes that begin, a second; leaning: of the line from ankles to neck towards "
        "the inside of the curve, mean; needed: the lean at which gravity balances the curve",
    ]
    return Section("paths", "Path following", [first, second], goals + more, notes)


@dataclass(frozen=True)
class Followed:
    """How the characters of one trial did.

    Attributes:
        mean: mean distance from the path in cm, over characters.
        raw: the mean distance of the raw network output.
        seconds: mean time until the end, or until a character gave up.
        coverage: least share of the path that a character covered.
        flight: longest time in seconds in which nothing touched the ground.
    """

    mean: float
    largest: float
    raw: float
    finished: int
    seconds: float
    coverage: float
    flight: float


def _followed(trial: PathTrial, walks: Sequence[Walk]) -> Followed:
    default, raw = (
        [trajectory_distance(body.positions[:, 0, [0, 2]], trial.path.points) for body in bodies]
        for bodies in zip(*((walk.take.default, walk.take.raw) for walk in walks), strict=True)
    )
    return Followed(
        float(np.mean([distance.mean for distance in default])),
        max(distance.max for distance in default),
        float(np.mean([distance.mean for distance in raw])),
        sum(walk.finished for walk in walks),
        float(np.mean([walk.take.default.seconds for walk in walks])),
        min(distance.coverage for distance in default),
        max(_longest_flight(walk.take.default) for walk in walks),
    )


def _longest_flight(body: Body) -> float:
    return max((end - start for start, end in spans(~touching(body.positions))), default=0) / body.fps


def _distances(
    trial: Trial, trials: list[PathTrial], groups: list[Sequence[Walk]]
) -> tuple[Table, list[Goal]]:
    rows: list[tuple[Cell, ...]] = []
    goals: list[Goal] = []
    compared: list[str] = []
    further: list[str] = []
    sliding: list[str] = []
    unfinished: list[str] = []
    for each, walks in zip(trials, groups, strict=True):
        found, slips = _followed(each, walks), slip([walk.take.default for walk in walks])
        matched: tuple[float | None, float | None] = (None, None)
        if trial.matched.knows(*(part.type for part in each.path.parts)):
            other = trial.matched.along(each.path)
            away = trajectory_distance(other.positions[:, 0, [0, 2]], each.path.points).mean
            slips_matched = slip([other])
            matched = away, slips_matched
            compared.append(each.name)
            further += [each.name] if found.mean > away or found.finished < len(walks) else []
            sliding += [each.name] if slips > slips_matched else []
        ends = f"{found.finished} of {len(walks)}"
        rows.append((
            each.name, found.mean, found.largest, found.raw, ends, found.seconds, found.coverage, found.flight, slips,
            _recorded_slip(trial, each.path), *matched,
        ))  # fmt: skip
        unfinished += [each.name] if found.finished < len(walks) else []
        note = "" if found.finished == len(walks) else f"finished {ends}"
        goals.append(at_most(f"{each.name}: mean distance, cm", found.mean, each.target, note))
    # Whoever stands still stays near its path.
    goals.append(all_of("paths that all characters follow to the end", [t.name for t in trials], unfinished))
    if compared:
        goals.append(all_of("as near to the path as motion matching: share of paths", compared, further))
        goals.append(
            all_of("slip of low toes as slow as in motion matching: share of paths", compared, sliding)
        )
    columns = (
        "path",
        "mean distance, cm",
        "largest distance, cm",
        "raw mean distance, cm",
        "finished",
        "seconds",
        "least coverage",
        "longest flight, s",
        "slip, cm/s",
        "recorded: slip, cm/s",
        "motion matching: mean distance, cm",
        "motion matching: slip, cm/s",
    )
    return Table("Distance from the path", columns, rows), goals


def _recorded_slip(trial: Trial, path: Path2D) -> float | None:
    kinds = sorted({part.type for part in path.parts})
    recordings = [each.body for kind in kinds for each in trial.real.of_type(kind)]
    return slip(recordings) if recordings else None


def _speeds(trial: Trial, trials: list[PathTrial], groups: list[Sequence[Walk]]) -> tuple[Table, list[Goal]]:
    rows: list[tuple[Cell, ...]] = []
    goals: list[Goal] = []
    for each, walks in zip(trials, groups, strict=True):
        bodies = [walk.take.default for walk in walks]
        speeds = [_part_speeds(walk, len(each.speeds)) for walk in walks]
        means = [float(np.mean(found)) for found in zip(*speeds, strict=True)]
        limit = acceleration_limit(trial.real, {part.type for part in each.path.parts})
        most = max(float(accelerations(body).max()) for body in bodies)
        lean, needed = (float(np.mean(found)) for found in zip(*map(leaning, bodies), strict=True))
        stood = min(_standing_seconds(body) for body in bodies) if each.stop_seconds else None
        rows.append((
            each.name,
            ", ".join(f"{speed:.2f}" for speed in means),
            sum(walk.finished for walk in walks) == len(walks),
            most,
            limit,
            stood,
            float(np.mean([steps_a_second(body) for body in bodies])),
            _mean(planted_share, bodies),
            _mean(hover_share, bodies),
            _mean(leaps, bodies),
            sum(map(flips, bodies)),
            lean,
            needed,
        ))  # fmt: skip
        planned = (part_speeds(trial.model, each.path) / METRE).tolist()[: len(each.speeds)]
        # Of each character, because one that is too slow does not make up for another that is too fast.
        apart = [
            np.mean([abs(found / speed - 1.0) for found in of_part])
            for of_part, speed in zip(zip(*speeds, strict=True), planned, strict=True)
        ]
        off = float(max(apart))
        note = "; ".join(other_speeds(trial.model, each.path))
        goals.append(at_most(f"{each.name}: speed off by", off, SPEED_SHARE, note, ".0%"))
        if stood is not None:
            least = STOP_SHARE * each.stop_seconds
            goals.append(at_least(f"{each.name}: stands, s", stood, least))
        if limit is not None:
            goals.append(at_most(f"{each.name}: acceleration / real", most / limit, 1.0))
    columns = (
        "path", "speed, m/s", "finished", "acceleration, m/s^2", "real acceleration", "stands, s", "steps a second",
        "planted", "hovers", "leaps a minute", "flipped", "leaning, degrees", "needed, degrees",
    )  # fmt: skip
    return Table("Speeds and braking", columns, rows), goals


def _mean(measure: Callable[..., MetricValue], bodies: list[Body]) -> float:
    return float(np.mean([value_of(measure(body.positions)) for body in bodies]))


def _part_speeds(walk: Walk, parts: int) -> list[float]:
    """Return the mean speed of the root in m/s on each part, without its first and last second where it is longer."""
    body, out, start = walk.take.default, [], 0
    for frames in walk.part_frames[:parts]:
        edge = min(round(body.fps), frames // 3)
        part = body.positions[start + edge : max(start + edge + 2, start + frames - edge), 0, :][:, [0, 2]]
        steps = np.linalg.norm(np.diff(part, axis=0), axis=-1)
        out.append(float(steps.mean()) * body.fps / 100.0 if len(steps) else 0.0)
        start += frames
    return out


def slip(bodies: Sequence[Body]) -> float:
    """Return the mean speed of low toes over the ground in cm/s, over all frames of some bodies; 0 without any."""
    found = []
    for body in bodies:
        toes = foot_positions(body.positions)[:, list(TOES)].astype(np.float64)
        found.append((ground_speed(toes) * body.fps)[toes[1:, :, 1] < STANDING_TOE + LOW])
    speeds = np.concatenate([np.zeros(0), *found])
    return float(speeds.mean()) if len(speeds) else 0.0


def _standing_seconds(body: Body) -> float:
    """Return the longest time for which the root stands, in seconds, without the first and last second."""
    edge = round(body.fps)
    still = body.speed[edge:-edge] < STANDING_SPEED
    return max((end - start for start, end in spans(still)), default=0) / body.fps


def steps_a_second(body: Body) -> float:
    """Return how often a second a toe is put down; one that stands in the first frame does not count."""
    contacts = foot_contacts(body.positions, body.fps)
    return sum(start > 0 for toe in (1, 3) for start, _ in spans(contacts[:, toe] > 0.5)) / body.seconds


def leaning(body: Body) -> tuple[float, float]:
    """Return the mean lean towards the inside of a curve, and the lean that balances it, in degrees; zeros if straight.

    The lean is that of the line from between the ankles to the neck, at right angles to the way of the root.
    """
    velocity = body.velocity
    sine, cosine = np.sin(body.heading), np.cos(body.heading)
    local = np.stack(
        [velocity[:, 0] * cosine + velocity[:, 1] * sine, velocity[:, 1] * cosine - velocity[:, 0] * sine], -1
    )
    speed = np.maximum(np.linalg.norm(local, axis=-1), 1e-6)
    angle = np.unwrap(np.arctan2(local[:, 0], local[:, 1]))
    edge = max(1, round(PACE_SECONDS * body.fps / 2))  # where the velocity is that of the frames inside
    inside = angle[edge:-edge]
    rate = float(
        (inside[-1] - inside[0]) * body.fps / max(1, len(inside) - 1)
    )  # radians a second, to the left
    if abs(rate) < 0.05:
        return 0.0, 0.0
    left = np.stack([local[:, 1], -local[:, 0]], axis=-1) / speed[:, None]
    feet = 0.5 * (body.positions[:, 3] + body.positions[:, 7])
    trunk = body.positions[:, 12] - feet
    aside = (trunk[:, [0, 2]] * left).sum(axis=-1)
    lean = np.degrees(np.arctan2(aside, trunk[:, 1])).mean() * np.sign(rate)
    return float(lean), float(np.degrees(np.arctan2(abs(rate) * speed.mean(), 9.81)))
