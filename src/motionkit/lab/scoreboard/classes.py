"""What a classifier trained on the recordings takes roll-outs for: accuracy, Frechet distance, multimodality."""

from __future__ import annotations

from motionkit.lab.classifier import WIDTH, classified, described, recorded_windows, train_classifier
from motionkit.lab.scoreboard.report import Section
from motionkit.lab.scoreboard.trial import Trial
from motionkit.tables import Cell, Table
from motionkit.training.verdict.rolling import Progress

NOTES = [
    f"a classifier with {WIDTH} hidden values is trained on the training clips and their mirror images; windows are a "
    "second long. Its accuracy on held-out recordings is the most that roll-outs can be expected to have",
    "accuracy: share of windows taken for their type; Frechet distance: of the hidden values, to those of the training "
    "clips; multimodality: distance of windows of two motions of the same type",
]


def classes_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: the roll-outs of each type alone beside held-out recordings. Needs torch."""
    classifier = train_classifier(trial.dataset)
    progress(0.2)
    takes = trial.alone(lambda share: progress(0.2 + 0.7 * share))
    made = {kind: [described(take.default) for take in mine] for kind, mine in takes.items()}
    recorded = {
        kind: [described(stretch.body) for stretch in trial.real.of_type(kind, trial.real.held_out)]
        for kind in takes
    }
    training = list(recorded_windows(trial.dataset, "train").values())
    sides = [classified(classifier, motions, training) for motions in (made, recorded)]
    rows: list[tuple[Cell, ...]] = [("all", *(side[name].value for name in sides[0] for side in sides))]
    for kind in takes:
        of_kind = [classified(classifier, {kind: motions[kind]}, []) for motions in (made, recorded)]
        both = {name: [side[name].value for side in of_kind] for name in ("class-accuracy", "multimodality")}
        rows.append((kind, *both["class-accuracy"], None, None, *both["multimodality"]))
    columns = (
        "type", "accuracy", "held-out recordings", "Frechet distance", "held-out recordings", "multimodality",
        "held-out recordings",
    )  # fmt: skip
    progress(1.0)
    return Section("classes", "A classifier", [Table("Roll-outs and recordings", columns, rows)], [], NOTES)
