"""Visible faults: leaps of knees, flipped bodies, floating and sunken feet and hands, falls that are none.

Measured on each type alone, as `synthesize TYPE` makes it by default, beside the raw network and the recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from motionkit.lab.scoreboard.limits import REAL_SHARE
from motionkit.lab.scoreboard.report import Goal, Section, all_of, at_most
from motionkit.lab.scoreboard.roles import bears_on_hands
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.body import Body
from motionkit.metrics.body_movement import angular_speed, geodesic_movement
from motionkit.metrics.flight import FREE_FALL, Flight, flights
from motionkit.metrics.leaps import fastest_turn, leaps
from motionkit.metrics.touch import FALL_ERROR, GROUPS, hover_share, lowest_points, planted_share, touching
from motionkit.metrics.value import MetricValue
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.tables import Cell, Table
from motionkit.training.verdict.rolling import Progress, Take

LEAP_LIMIT = 0.1  # leaps a minute, in any type but gaits
FLIP = 60.0  # degrees that the hips turn from one frame to the next in a body that flips
PLANTED = (0.8, 1.2)  # planted share relative to the recordings
HOVER_MORE = 0.02  # largest share of hovering frames above that of the recordings
DEPTH = 3.0  # cm below the ground that a joint may be, or as deep as recorded
HANDS_NEAR = 3.0  # cm; difference to recorded hands where hands bear the body
TRUNK = tuple(JOINT_NAMES.index(name) for name in ("LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"))
ARMS = tuple(
    JOINT_NAMES.index(side + name)
    for side in ("Left", "Right")
    for name in ("Shoulder", "Arm", "ForeArm", "Hand")
)
LEAST_FRAMES = 8  # of a recording to measure


def visible_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: each type alone against its recordings."""
    takes = trial.alone(progress)
    default = {kind: [take.default for take in found] for kind, found in takes.items()}
    raw = {kind: [take.raw for take in found] for kind, found in takes.items()}
    real = {
        kind: [s.body for s in trial.real.of_type(kind) if len(s.body) >= LEAST_FRAMES]
        for kind in trial.recorded_types
    }
    gaits = {kind for kind in default if trial.model.kind(kind).steered}
    handstands = [kind for kind in default if bears_on_hands(trial.real, kind)]
    tables, goals = [], []
    by_type = {
        kind: [ranged for take in found for ranged in take.performed()] for kind, found in takes.items()
    }
    for part in (_leaps(default, raw, real, gaits), _touch(by_type, real), _lowest(default, raw, real, handstands),
                 _flights(default, raw, real), _gaits(default, real, gaits)):  # fmt: skip
        tables.append(part[0])
        goals += part[1]
    settings = trial.settings
    notes = [
        f"{settings.seeds} roll-outs of {settings.accuracy_seconds:g} s per type, as synthesize makes them by default; "
        "raw: the same with feet not locked; recorded: all recordings of the type; metrics: docs/metrics.md, the "
        "ground at y = 0 for all",
        "planted and hovering: where the type is shown, without the stands and run-ups that synthesis adds",
        f"flipped: roll-outs whose hips turn by more than {FLIP:g} degrees from one frame to the next",
        f"free fall: share of the flights of 0.2 s whose acceleration is within {FALL_ERROR:g} m/s^2 of "
        f"{FREE_FALL:g} m/s^2",
    ]
    return Section("visible", "Visible faults", tables, goals, notes)


Bodies = dict[str, list[Body]]
Part = tuple[Table, list[Goal]]


def _leaps(default: Bodies, raw: Bodies, real: Bodies, gaits: set[str]) -> Part:
    rows: list[tuple[Cell, ...]] = []
    all_flipped = 0
    rates: dict[str, float] = {}
    for kind, bodies in default.items():
        fastest, joint = fastest_joint(bodies)
        recorded = fastest_joint(real[kind])[0] if real[kind] else None
        flipped = sum(flips(body) for body in bodies)
        all_flipped += flipped
        rates[kind] = _mean(leaps, bodies)
        recorded_rate = _mean(leaps, real[kind]) if real[kind] else None
        leaping = sum(value_of(leaps(body.positions)) > 0.0 for body in bodies)
        rows.append(
            (
                kind,
                rates[kind],
                leaping,
                _mean(leaps, raw[kind]),
                recorded_rate,
                flipped,
                fastest,
                joint,
                recorded,
            )
        )
    columns = (
        "type", "leaps a minute", "roll-outs with leaps", "raw", "recorded", "flipped", "fastest joint, degrees/s",
        "joint", "recorded fastest joint",
    )  # fmt: skip
    walking = [rates[kind] for kind in rates if kind in gaits]
    worst = max(rates, key=lambda kind: rates[kind]) if rates else ""
    goals = [
        Goal("leaps of knees and elbows a minute in gaits", max(walking, default=None), "0", None, 0.0),
        at_most(
            "leaps of knees and elbows a minute, worst type",
            rates.get(worst),
            LEAP_LIMIT,
            worst if rates and rates[worst] > 0.0 else "",
        ),
        Goal("roll-outs whose body flips in one frame", float(all_flipped), "0", None, 0.0),
    ]
    return Table("Leaps and turns", columns, rows), goals


def fastest_joint(bodies: Sequence[Body]) -> tuple[float, str]:
    """Return the fastest turn of a joint over all bodies in degrees per second, and the joint."""
    found = max((fastest_turn(b.rotations, b.fps) for b in bodies), key=value_of)
    return value_of(found), str(found.parameters["joint"])


def flips(body: Body) -> bool:
    """Whether the hips of a body turn by more than FLIP degrees in one frame."""
    return bool((geodesic_movement(body.rotations[:, :1]) > FLIP).any())


def _touch(by_type: dict[str, list[Take]], real: Bodies) -> Part:
    rows: list[tuple[Cell, ...]] = []
    unplanted, hovering = [], []
    kinds = [kind for kind in by_type if real[kind]]
    for kind in kinds:
        bodies = [take.default for take in by_type[kind]], [take.raw for take in by_type[kind]]
        planted = _mean(planted_share, real[kind])
        hover = _mean(hover_share, real[kind])
        mine, mine_raw = (_mean(planted_share, each) for each in bodies)
        hovers, hovers_raw = (_mean(hover_share, each) for each in bodies)
        ratio = mine / planted if planted else None
        rows.append(
            (kind, planted, ratio, mine_raw / planted if planted else None, hover, hovers, hovers_raw)
        )
        if ratio is not None and not PLANTED[0] <= ratio <= PLANTED[1]:
            unplanted.append(kind)
        if hovers > hover + HOVER_MORE:
            hovering.append(kind)
    columns = (
        "type", "planted, recorded", "planted / recorded", "raw planted / recorded", "hovers, recorded", "hovers",
        "raw hovers",
    )  # fmt: skip
    limits = f"planted {PLANTED[0]:g} to {PLANTED[1]:g} times as long as recorded: share of types"
    goals = [
        all_of(limits, kinds, unplanted),
        all_of(f"hovers at most {HOVER_MORE:.0%} more than recorded: share of types", kinds, hovering),
    ]
    return Table("Planted and hovering", columns, rows), goals


def _lowest(default: Bodies, raw: Bodies, real: Bodies, handstands: list[str]) -> Part:
    rows: list[tuple[Cell, ...]] = []
    deep, goals = [], []
    kinds = [kind for kind in default if real[kind]]
    for kind in kinds:
        mine, recorded, network = (_lowest_points(bodies[kind]) for bodies in (default, real, raw))
        rows.append((kind, *(v for pair in zip(mine, recorded, strict=True) for v in pair), network[-1]))
        if mine[-1] < min(-DEPTH, _usual_depth(real[kind])):
            deep.append(kind)
    columns = ("type", *(name for group in GROUPS for name in (group, f"{group}, recorded")), "body, raw")
    what = (
        f"no joint more than {DEPTH:g} cm below the ground, or deeper than usual recordings: share of types"
    )
    goals.append(all_of(what, kinds, deep))
    for kind in handstands:
        if kind in kinds:
            apart = _hands(default[kind]) - _hands(real[kind])
            name = f"lowest hands in {kind} − recorded, cm"
            goals.append(Goal(name, apart, f"within {HANDS_NEAR:g}", -HANDS_NEAR, HANDS_NEAR))
    return Table("Lowest joints, cm above the ground", columns, rows), goals


def _lowest_points(bodies: list[Body]) -> list[float]:
    """Return the lowest of each of GROUPS over all bodies, in cm."""
    return [
        min(map(value_of, points))
        for points in zip(*(lowest_points(b.positions) for b in bodies), strict=True)
    ]


def _usual_depth(bodies: list[Body]) -> float:
    """Return the height in cm that the lowest joint is above in nearly all recorded frames: single ones are faults."""
    return float(
        np.quantile(np.concatenate([b.positions[..., 1].min(axis=1) for b in bodies]), 1.0 - REAL_SHARE)
    )


def _hands(bodies: list[Body]) -> float:
    """Return the mean of the lowest height of each hand in each motion, in cm."""
    return float(np.mean([body.hand_heights.min(axis=0) for body in bodies]))


def _flights(default: Bodies, raw: Bodies, real: Bodies) -> Part:
    rows: list[tuple[Cell, ...]] = []
    mine_all: list[Flight] = []
    real_all: list[Flight] = []
    for kind, bodies in default.items():
        mine, network, recorded = (_all_flights(found) for found in (bodies, raw[kind], real[kind]))
        if mine or recorded:
            worst = max(mine, key=lambda flight: abs(flight.error)).acceleration if mine else None
            rows.append((kind, len(mine), _free(mine), worst, _free(network), len(recorded), _free(recorded)))
        mine_all += mine
        real_all += recorded
    columns = (
        "type", "flights", "free fall", "worst, m/s^2", "raw free fall", "recorded flights", "recorded free fall",
    )  # fmt: skip
    least = _free(real_all)
    target = None if least is None else f"≥ {least:.2f}, as recorded"
    goal = Goal("share of flights in free fall", _free(mine_all), target or "", least)
    return Table("Flights", columns, rows), [goal] if target else []


def _all_flights(bodies: list[Body]) -> list[Flight]:
    return [flight for body in bodies for flight in flights(body.positions, ~touching(body.positions))]


def _free(found: list[Flight]) -> float | None:
    """Return the share of flights that fall freely; None without flights."""
    return sum(abs(flight.error) <= FALL_ERROR for flight in found) / len(found) if found else None


def _gaits(default: Bodies, real: Bodies, gaits: set[str]) -> Part:
    rows: list[tuple[Cell, ...]] = []
    for kind in default:
        if kind not in gaits or not real[kind]:
            continue
        cells: list[Cell] = [kind]
        for joints in (TRUNK, ARMS):
            mine, recorded = (
                _mean_of([angular_speed(b.rotations, joints, b.fps) for b in bodies], bodies)
                for bodies in (default[kind], real[kind])
            )
            cells += [recorded, mine / recorded if recorded else None]
        rows.append(tuple(cells))
    columns = ("type", "trunk recorded, rad/s", "trunk / recorded", "arms recorded, rad/s", "arms / recorded")
    return Table("Trunk and arms of gaits", columns, rows), []


def value_of(measured: MetricValue) -> float:
    """Return the value of a metric that has one or raises."""
    assert measured.value is not None, "these metrics have a value or raise"
    return measured.value


def _mean(measure: Callable[..., MetricValue], bodies: list[Body]) -> float:
    """Return the mean of a metric of positions, each motion weighted by its length."""
    return _mean_of([value_of(measure(body.positions)) for body in bodies], bodies)


def _mean_of(values: list[float], bodies: list[Body]) -> float:
    return float(np.average(values, weights=[len(body) for body in bodies]))
