"""Which types of a model work: the verdicts of quickstart as a section of the scoreboard."""

from __future__ import annotations

from motionkit.lab.scoreboard.report import Goal, Section
from motionkit.lab.scoreboard.trial import Trial
from motionkit.training.verdict.rolling import Progress
from motionkit.training.verdict.types import (
    VerdictSettings,
    quick_verdicts,
    training_summary,
    verdict_notes,
    verdict_table,
)


def types_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: a verdict for each type."""
    of_trial = trial.settings
    settings = VerdictSettings(
        of_trial.seeds, of_trial.accuracy_seconds, of_trial.repeats, of_trial.first_seed, of_trial.noise
    )
    verdicts = quick_verdicts(trial.model, trial.judge, settings, progress, trial.each)
    goals = [
        Goal(f"{v.type} works", float(v.works), "yes", 1.0, None, "; ".join(v.reasons)) for v in verdicts
    ]
    notes = [training_summary(trial.model), *verdict_notes()]
    return Section("types", "Does each type work?", [verdict_table(verdicts)], goals, notes)
