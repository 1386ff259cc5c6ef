"""Starts and stops: do feet slide where a standing body begins to go, or where a body stops?"""

from __future__ import annotations

import numpy as np

from motionkit.control.script import TypePart
from motionkit.lab.scoreboard.report import Goal, at_most
from motionkit.lab.scoreboard.roles import find_roles
from motionkit.lab.scoreboard.trial import Trial
from motionkit.metrics.body import STANDING_TOE, Body
from motionkit.metrics.ground import TOES, ground_speed
from motionkit.motion.floor import foot_positions
from motionkit.tables import Table
from motionkit.training.verdict.rolling import Plan, Progress, grouped

PART_SECONDS = 2.0
# A toe slides that is less than so many cm above a standing one and moves faster than so many cm/s.
LOW, FAST = 1.5, 15.0


def sliding_toes(body: Body) -> tuple[int, int]:
    """Return how many low toes of a body slide, over all frames, and how many there are."""
    toes = foot_positions(body.positions)[:, list(TOES)].astype(np.float64)
    low = toes[1:, :, 1] < STANDING_TOE + LOW
    slides = low & (ground_speed(toes) * body.fps > FAST)
    return int(slides.sum()), int(low.sum())


def starts_and_stops(trial: Trial, progress: Progress) -> tuple[Table, list[Goal]] | None:
    """Measure bodies that stand, go and stand again, by every gait; None for a model that cannot stand or go."""
    gaits = find_roles(trial).gaits
    known = trial.recorded_types
    going = [kind for kind in dict.fromkeys((gaits.walk, gaits.run, gaits.back)) if kind in known]
    if gaits.stand not in known or not going:
        return None
    idle, repeats = str(gaits.stand), trial.settings.repeats
    plans = [
        Plan(tuple(TypePart(kind, PART_SECONDS) for kind in (idle, str(gait), idle)), seed)
        for gait in going
        for seed in trial.seeds(repeats)
    ]
    takes = trial.roll(plans, progress)
    rows, goals = [], []
    for gait, mine in zip(going, grouped(takes, repeats), strict=True):
        stands, goes = ([s.body for s in trial.real.of_type(kind)] for kind in (idle, str(gait)))
        real = sliding_share(stands, goes, stands)
        default, raw = (sliding_share([getattr(take, name) for take in mine]) for name in ("default", "raw"))
        name = f"{idle} → {gait} → {idle}"
        rows.append((name, default, raw, real))
        if real:
            goals.append(at_most(f"{name}: low toes that slide / real", default / real, 1.0))
    columns = ("sequence", "low toes that slide", "raw", "recorded")
    return Table("Starts and stops", columns, rows), goals


def sliding_share(*parts: list[Body]) -> float:
    """Return the share of low toes that slide in parts of equal length, each with the mean of its bodies a frame."""
    rates = []
    for bodies in parts:
        counts = np.array([sliding_toes(body) for body in bodies]).sum(axis=0)
        rates.append(counts / sum(map(len, bodies)))
    sliding, low = np.sum(rates, axis=0)
    return float(sliding / low) if low else 0.0
