"""The t-test of a user study: answers of raters -> the paper's tables 4 and 5."""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.files import read_json
from motionkit.lab.statistics import Figure, figure, upper_tail

FORMAT = "motionkit-study-1"
SCORES = range(1, 6)


class NothingToTest(MotionkitError):
    """Two samples that are too small, or without any spread."""


@dataclass(frozen=True)
class Score:
    """How raters liked what one model made: means of sequences, their mean, deviation, and number."""

    name: str
    values: tuple[float, ...]

    @property
    def mean(self) -> float:
        """The mean over sequences."""
        return _figure(self.values).mean

    @property
    def deviation(self) -> float:
        """The standard deviation over sequences."""
        return _figure(self.values).spread


def _figure(values: Sequence[float]) -> Figure:
    found = figure(values)
    assert found is not None, "a model without answers has no score"
    return found


@dataclass(frozen=True)
class Comparison:
    """A t-test of one model against another: t, one-sided p, and degrees of freedom."""

    rival: Score
    t: float
    p: float
    freedom: int


def read_answers(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the answers in files that `experiment study` pages saved, one rater's each.

    Raises:
        MotionkitError: a file is none, or has the same answers as another; a score is not one of 1 to 5, or is given
            twice; a rater is not a text.
    """
    out: list[dict[str, Any]] = []
    for path in paths:
        answers = read_json(path, "the answers of a study", MotionkitError)
        if not isinstance(answers, dict) or answers.get("format") != FORMAT:
            raise MotionkitError(f"{path}: not the answers of a study, expected the format {FORMAT!r}")
        groups = answers.get("answers")
        if not isinstance(groups, list) or not groups:
            raise MotionkitError(f"{path}: no answers, expected a list of them")
        for entry in groups:
            score = entry.get("score") if isinstance(entry, dict) else None
            if isinstance(score, bool) or score not in SCORES:
                raise MotionkitError(f"{path}: the score {score!r:.40}, expected a number from 1 to 5")
            if not all(isinstance(entry.get(key), str) for key in ("group", "model")):
                raise MotionkitError(
                    f"{path}: an answer without its group or model: {json.dumps(entry)[:80]}"
                )
        _check_rater(path, answers)
        if answers in out:
            raise MotionkitError(
                f"{path}: the same answers as in {paths[out.index(answers)]}; name each rater's file once"
            )
        out.append(answers)
    return out


def _check_rater(path: Path, answers: dict[str, Any]) -> None:
    """Raise MotionkitError for answers that are given twice, or a rater that is not a text."""
    if not isinstance(answers.get("rater", ""), str):  # answers of before have none
        raise MotionkitError(f"{path}: the rater {answers['rater']!r:.40}, expected a text")
    counts = Counter((entry["group"], entry["model"]) for entry in answers["answers"])
    for (group, model), count in counts.items():
        if count > 1:
            raise MotionkitError(f"{path}: {count} answers about {model!r} in {group!r}, expected one")


def unequal_samples(answers: Sequence[dict[str, Any]]) -> str | None:
    """Say how many answers the groups have of each model, if these differ; None if all have as many."""
    groups = sorted({entry["group"] for each in answers for entry in each["answers"]})
    models = sorted({entry["model"] for each in answers for entry in each["answers"]})
    counts = Counter((entry["model"], entry["group"]) for each in answers for entry in each["answers"])
    if len({counts[model, group] for model in models for group in groups}) == 1:
        return None
    words = [f"{model} {', '.join(str(counts[model, group]) for group in groups)}" for model in models]
    return f"answers differ in number; in the groups {', '.join(groups)}: {'; '.join(words)}"


def scores(answers: Sequence[dict[str, Any]]) -> dict[str, Score]:
    """Return each model's mean score per sequence over all raters (the paper's samples)."""
    collected: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for each in answers:
        for entry in each["answers"]:
            collected[entry["model"]][entry["group"]].append(entry["score"])
    return {
        model: Score(model, tuple(sum(v) / len(v) for _, v in sorted(groups.items())))
        for model, groups in collected.items()
    }


def compare(first: Score, rival: Score) -> Comparison:
    """Test whether the first model's mean is larger, by Student's t of two samples of equal variance.

    Raises:
        NothingToTest: a model has fewer than two sequences, or no score of either differs from its others.
    """
    m, n = len(first.values), len(rival.values)
    if min(m, n) < 2:
        raise NothingToTest(f"a t-test needs 2 sequences of each model, found {m} and {n}")
    freedom = m + n - 2
    pooled = ((m - 1) * first.deviation**2 + (n - 1) * rival.deviation**2) / freedom
    if pooled == 0.0:
        raise NothingToTest(
            f"all scores of {first.name} are the same, and all of {rival.name}: nothing to test"
        )
    t = (first.mean - rival.mean) / math.sqrt(pooled * (1.0 / m + 1.0 / n))
    return Comparison(rival, t, upper_tail(t, freedom), freedom)
