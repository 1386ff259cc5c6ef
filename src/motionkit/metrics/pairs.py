"""Measures many files or pairs of files, and computes their means."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.metrics.report import MetricReport, MetricRow
from motionkit.names import visible
from motionkit.reading import reading, report_note
from motionkit.rig.read_file import endings_text, motion_files

Pair = tuple[Path, Path | None]  # ground truth, generated
CSV_COLUMNS = (
    "ground_truth", "generated", "frames", "metric", "unit", "value", "ground_truth_value", "ratio", "reason",
)  # fmt: skip


@dataclass(frozen=True)
class PairResult:
    """The report of a pair, or the error message if the pair could not be measured."""

    ground_truth: Path
    generated: Path | None
    report: MetricReport | None = None
    error: str = ""

    @property
    def name(self) -> str:
        """The name of the measured file."""
        return (self.generated or self.ground_truth).name

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        files = {
            "ground_truth": str(self.ground_truth),
            "generated": None if self.generated is None else str(self.generated),
        }
        return {**files, **({"error": self.error} if self.report is None else self.report.as_dict())}


@dataclass(frozen=True)
class MeanRow:
    """Mean of one metric over many pairs; None if no pair has a value on both sides, or their rates differ.

    lowest and highest are the extremes over the measured files, None if their rates differ. count is the number of
    files with a value, and reason says why there is no mean.
    """

    id: str
    unit: str
    value: float | None
    ground_truth: float | None
    lowest: float | None
    highest: float | None
    count: int
    reason: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, without the id."""
        return {k: v for k, v in asdict(self).items() if k != "id" and not (k == "reason" and v is None)}


def find_pairs(ground_truth: Path, generated: Path | None) -> tuple[list[Pair], list[Path]]:
    """List the files of motion below one folder, or pair those below two folders by their relative paths.

    Endings may differ, unless several files of a folder have the same name but for it.

    Returns:
        The pairs, and the files of either folder without a counterpart in the other.

    Raises:
        MotionkitError: there is nothing to measure.
    """
    truths = _by_name(ground_truth)
    if not truths:
        raise MotionkitError(f"{ground_truth}: no {endings_text()} files found")
    if generated is None:
        return [(path, None) for paths in truths.values() for path in paths], []
    made = _by_name(generated)
    pairs: list[Pair] = []
    for name, paths in truths.items():
        others = made.get(name, [])
        alone = len(paths) == len(others) == 1
        for path in paths:
            pairs += [(path, o) for o in others if alone or o.suffix.lower() == path.suffix.lower()]
    if not pairs:
        raise MotionkitError(f"{ground_truth} and {generated}: no two files of motion have the same name")
    paired = {path for pair in pairs for path in pair}
    every = [path for found in (truths, made) for paths in found.values() for path in paths]
    return pairs, [path for path in every if path not in paired]


def _by_name(folder: Path) -> dict[Path, list[Path]]:
    """The files of motion below a folder by their relative paths without endings."""
    found: dict[Path, list[Path]] = {}
    for path in motion_files(folder):
        found.setdefault(path.relative_to(folder).with_suffix(""), []).append(path)
    return found


def names_of_pairs(results: Sequence[PairResult], folder: Path | None = None) -> list[str]:
    """A name for each pair: its measured file's, or the path below `folder` where several files have that name.

    A file that is measured against several others is named with each of them.
    """
    often = Counter(result.name for result in results)
    names = [r.name if often[r.name] == 1 else _below(folder, r.generated or r.ground_truth) for r in results]
    often = Counter(names)
    return [
        name if often[name] == 1 or r.generated is None else f"{name} against {r.ground_truth}"
        for name, r in zip(names, results, strict=True)
    ]


def _below(folder: Path | None, path: Path) -> str:
    """The path relative to a folder that contains it, else the path as given."""
    return str(path.relative_to(folder) if folder is not None and path.is_relative_to(folder) else path)


def evaluate_pairs(
    pairs: Sequence[Pair],
    evaluate: Callable[[Path, Path | None], MetricReport],
    each: Callable[..., Iterator[Any]] = map,
) -> Iterator[PairResult]:
    """Yield the result of each pair; a pair that cannot be measured has an error instead of a report.

    each is a function like map, such as that of data.workers; processes need an `evaluate` that can be pickled.
    """
    for result, notes in each(partial(_evaluated, evaluate), list(pairs)):
        for note in notes:
            report_note(note)
        yield result


def _evaluated(
    evaluate: Callable[[Path, Path | None], MetricReport], pair: Pair
) -> tuple[PairResult, list[str]]:
    """The result of a pair, and the notes on its files."""
    notes: list[str] = []
    with reading(on_note=notes.append):
        try:
            return PairResult(*pair, evaluate(*pair)), notes
        except MotionkitError as error:
            return PairResult(*pair, error=str(error)), notes


def mean_rows(results: Sequence[PairResult]) -> list[MeanRow]:
    """The mean of each metric over the pairs that have a value, on both sides; every pair has the same weight.

    Jerk has neither mean nor extremes over files whose jerk is measured at different rates, because it grows with the
    rate.
    """
    reports = [result.report for result in results if result.report is not None]
    return [
        _mean_row([row for report in reports for row in report.rows if row.id == first.id])
        for first in (reports[0].rows if reports else ())
    ]


def _mean_row(of_pairs: Sequence[MetricRow]) -> MeanRow:
    """The mean of one metric, of which there is a row for each pair."""
    name, unit = of_pairs[0].id, of_pairs[0].motion.unit
    values = [row.motion.value for row in of_pairs if row.motion.value is not None]
    rates = {float(row.motion.parameters["fps"]) for row in of_pairs if "fps" in row.motion.parameters}
    if len(rates) > 1:
        *lower, highest = [f"{rate:g}" for rate in sorted(rates)]
        reason = f"values at {', '.join(lower)} and {highest} fps do not compare"
        return MeanRow(name, unit, None, None, None, None, len(values), reason)
    both = [
        (row.motion.value, None if row.ground_truth is None else row.ground_truth.value)
        for row in of_pairs
        if row.motion.value is not None and (row.ground_truth is None or row.ground_truth.value is not None)
    ]
    return MeanRow(
        name,
        unit,
        _mean([value for value, _ in both]),
        _mean([truth for _, truth in both if truth is not None]),
        min(values, default=None),
        max(values, default=None),
        len(values),
        None if both else _no_mean(of_pairs),
    )


def _no_mean(of_pairs: Sequence[MetricRow]) -> str:
    """Why no pair has a value on both sides: their common reason, or that they have several."""
    if len({reason for row in of_pairs for reason in row.reasons()}) == 1:
        return of_pairs[0].reasons()[0]
    return f"no {'pair has a value on both sides' if of_pairs[0].ground_truth else 'file has a value'}"


def pairs_as_dict(results: Sequence[PairResult], sets: Sequence[MetricRow] = ()) -> dict[str, Any]:
    """Plain values for JSON: all pairs, their means by metric, and the metrics of all files together."""
    means = {row.id: row.as_dict() for row in mean_rows(results)}
    pairs = [result.as_dict() for result in results]
    return {"pairs": pairs, "mean": means, "sets": [row.as_dict() for row in sets]}


def csv_text(results: Sequence[PairResult], sets: Sequence[MetricRow] = ()) -> str:
    """CSV with one row per metric and pair; rows of sets have no file names."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for result in results:
        if result.report is None:
            continue
        names = visible(result.ground_truth), "" if result.generated is None else visible(result.generated)
        for row in result.report.rows:
            writer.writerow([*names, result.report.frames, *_csv_values(row)])
    for row in sets:
        writer.writerow(["", "", "", *_csv_values(row)])
    return text.getvalue()


def _csv_values(row: MetricRow) -> tuple[object, ...]:
    truth = None if row.ground_truth is None else row.ground_truth.value
    return row.id, row.motion.unit, row.motion.value, truth, row.ratio, row.motion.reason


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
