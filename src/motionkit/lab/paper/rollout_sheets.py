"""What networks made of the same held-out sequence, below the recorded one: the paper's figures 10 and 11."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from motionkit.lab.held_out import decoded, held_out
from motionkit.lab.paper.kept_rollouts import read_rollouts, rollouts_file
from motionkit.lab.paper.runs import kept_runs
from motionkit.motion.motion import Motion
from motionkit.view.contact_sheet import write_contact_sheet

KINDS = {"10": "jumping-b", "11": "twist"}  # figure: the type that it shows
NETWORKS = ("TPTN", "MVAE", "HTSS", "NeuralLayering")  # of the paper's figures; the first seed of each
POSES = 8


def sheet_file(number: str) -> str:
    """Return the name of a figure's picture."""
    return f"figure-{number}-{KINDS[number]}.png"


def write_sheets(data: Path, results: Path, folder: Path) -> Iterator[Path]:
    """Draw a contact sheet for each figure and each folder of results, of mean roll-outs, and yield its path.

    A network without kept roll-outs is left out, and a figure whose type is not tested.

    Raises:
        MotionkitError: a result or its roll-outs are damaged, or were made from other clips; or Pillow is missing.
    """
    rows: dict[Path, list[tuple[str, Motion]]] = {}
    for file, result, dataset in kept_runs(data, results):
        if result["name"] not in NETWORKS or result["seed"]:
            continue
        sequences = held_out(dataset, result["longest"])
        made = read_rollouts(rollouts_file(file), dataset, sequences)["mean"]
        for number, kind in KINDS.items():
            for sequence, features in zip(sequences, made, strict=True):
                if sequence.kind == kind:
                    first, end = sequence.initial, sequence.initial + sequence.frames
                    sheet = rows.setdefault(
                        folder / file.parent.relative_to(results) / sheet_file(number),
                        [("recorded", decoded(dataset, sequence, sequence.data.features[first:end]))],
                    )
                    sheet.append((result["name"], decoded(dataset, sequence, features)))
                    break
    for path, sheet in rows.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        sheet[1:] = sorted(sheet[1:], key=lambda row: NETWORKS.index(row[0]))
        write_contact_sheet(path, sheet, POSES)
        yield path
