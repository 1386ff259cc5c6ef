"""Smoothness of transitions that no clip contains: does a joint turn, or the body brake, faster than in recordings?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import cycle

import numpy as np

from motionkit.control.script import TypePart
from motionkit.control.speeds import acceleration_limit as limit_of_model
from motionkit.lab.scoreboard.limits import REAL_SHARE, acceleration_limit, accelerations, turn_limit
from motionkit.lab.scoreboard.report import Goal, Section, at_least, at_most
from motionkit.lab.scoreboard.roles import Roles, find_roles
from motionkit.lab.scoreboard.starts import FAST, LOW, PART_SECONDS, starts_and_stops
from motionkit.lab.scoreboard.trial import Trial
from motionkit.lab.scoreboard.visible import DEPTH, fastest_joint, flips, value_of
from motionkit.metrics.leaps import leaps
from motionkit.metrics.touch import lowest_points
from motionkit.tables import Cell, Table
from motionkit.training.verdict.rolling import Plan, Progress, Take, grouped

AT_LIMIT = 0.98  # share of the limit of acceleration above which the limit counts as reached
LASTING_SECONDS = 3.0  # seconds of types without a natural length


def sequences(roles: Roles) -> list[tuple[str, ...]]:
    """Return sequences of a model's types that no clip holds: between gaits, performances, strikes and dances.

    Types that the model lacks are left out, and types it has many of are spread over the sequences.
    """
    gaits = roles.gaits
    run, walk, idle = gaits.run or gaits.walk, gaits.walk or gaits.run, gaits.stand
    once, strike = _cycled(roles.performances), _cycled(roles.strikes)
    lasting = _cycled(roles.lasting)
    plans = (
        (run, next(once), next(once), next(strike)),
        (run, next(once), next(once), run),
        (walk, next(once), next(once), walk),
        (next(strike), next(once), next(lasting), next(lasting)),
        (run, next(lasting), walk, idle),
    )
    found = []
    for plan in plans:
        kinds = [kind for kind in plan if kind is not None]
        sequence = tuple(kind for i, kind in enumerate(kinds) if i == 0 or kind != kinds[i - 1])
        if len(sequence) > 1 and sequence not in found:
            found.append(sequence)
    return found


def _cycled(kinds: tuple[str, ...]) -> Iterator[str | None]:
    """Types in turn, again and again; None for ever without any."""
    return cycle(kinds or (None,))


def smoothness_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: fastest joint, acceleration and lowest joint of each sequence, against recordings."""
    model, settings = trial.model, trial.settings
    known = [s for s in sequences(find_roles(trial)) if set(s) <= set(trial.recorded_types)]
    if not known:
        note = "not measured: the dataset has recordings of fewer than two types of the model"
        return Section("smoothness", "Transitions", notes=[note])
    plans = [
        Plan(tuple(TypePart(k, model.phase_seconds(k) or LASTING_SECONDS) for k in sequence), seed)
        for sequence in known
        for seed in trial.seeds(settings.repeats)
    ]
    takes = grouped(trial.roll(plans, lambda share: progress(0.7 * share)), settings.repeats)
    found = [_measured(trial, sequence, mine) for sequence, mine in zip(known, takes, strict=True)]
    columns = (
        "sequence", "fastest joint, degrees/s", "joint", "real, degrees/s", "raw / real", "acceleration, m/s^2",
        "real acceleration", "frames at the limit", "lowest joint, cm", "raw lowest joint, cm",
        "leaps a minute", "flipped",
    )  # fmt: skip
    tables = [Table("Transitions that no clip contains", columns, [row for row, _ in found])]
    goals = [goal for _, of_sequence in found for goal in of_sequence]
    notes = [
        f"{settings.repeats} characters per sequence, as synthesize makes them by default; raw: feet not locked; the "
        f"worst value of each; each type lasts its own length or {LASTING_SECONDS:g} s",
        f"real: the fastest joint is slower in {REAL_SHARE:.1%} of the recorded frames of the sequence's types; the "
        "largest recorded values are not used",
        f"acceleration: of the root over the ground, between velocities over 0.2 s; real: {REAL_SHARE:.1%} of the "
        "frames of the sequence's types are below it; finishing holds the root below the same limit of the model's own "
        f"recordings, and frames at the limit is the share that it holds (within {1 - AT_LIMIT:.0%})",
    ]
    if section := starts_and_stops(trial, lambda share: progress(0.7 + 0.3 * share)):
        tables.append(section[0])
        goals += section[1]
        notes.append(
            f"low toes that slide: of toes less than {LOW:g} cm above a standing one, the share that moves faster than "
            f"{FAST:g} cm/s; {settings.repeats} characters stand, go and stand for {PART_SECONDS:g} s each; recorded: "
            "the mean over recordings of these types"
        )
    return Section("smoothness", "Transitions", tables, goals, notes)


def _measured(
    trial: Trial, sequence: tuple[str, ...], takes: Sequence[Take]
) -> tuple[tuple[Cell, ...], list[Goal]]:
    """The row and the goals of a sequence."""
    bodies, raw = [take.default for take in takes], [take.raw for take in takes]
    fastest, joint = fastest_joint(bodies)
    brakes = max(float(accelerations(b).max()) for b in bodies)
    limit, most = turn_limit(trial.real, sequence), acceleration_limit(trial.real, sequence)
    assert limit is not None, "sequences are of recorded types"
    model_limit = limit_of_model(trial.model, sequence)
    at_limit = (
        None
        if model_limit is None
        else float(np.mean([(accelerations(b) > AT_LIMIT * model_limit).mean() for b in bodies]))
    )
    lowest, raw_lowest = (
        min(value_of(lowest_points(b.positions)[-1]) for b in each) for each in (bodies, raw)
    )
    leaping = sum(value_of(leaps(b.positions)) for b in bodies) / len(bodies)
    name = " → ".join(sequence)
    goals = [
        at_most(f"{name}: fastest joint / real", fastest / limit, 1.0),
        at_least(f"{name}: lowest joint, cm", lowest, -DEPTH),
    ]
    if most is not None:
        goals.append(at_most(f"{name}: acceleration / real", brakes / most, 1.0))
    row = (
        name, fastest, joint, limit, fastest_joint(raw)[0] / limit, brakes, most, at_limit, lowest, raw_lowest,
        leaping, sum(map(flips, bodies)),
    )  # fmt: skip
    return row, goals
