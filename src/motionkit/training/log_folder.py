"""Numbers of a run for other programs: a CSV table, and TensorBoard's event files where TensorBoard is installed."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motionkit.errors import OverwriteError

if TYPE_CHECKING:
    from motionkit.training.report import TrainEvent

TABLE = "log.csv"
BEGINS = b"step,seconds,"


class LogFolder(AbstractContextManager["LogFolder"]):
    """Writes the losses and scores of a run; called with its events.

    log.csv has a row for each logged step: step, seconds and the losses by name. A resumed run adds rows to it.
    TensorBoard gets the same losses, and the scores of each type. After an error, such as a full disk, the run
    continues without the table.
    """

    def __init__(
        self, folder: str | Path, resumed: bool = False, on_note: Callable[[str], None] = warnings.warn
    ) -> None:
        """Make the folder; on_note is called with what cannot be written. Raises OSError if it cannot be made."""
        self.folder, self._on_note, self._writes = Path(folder), on_note, True
        self.folder.mkdir(parents=True, exist_ok=True)
        self._board = _board(self.folder)
        self._adds = resumed  # otherwise the first row replaces the table of an earlier run

    def __call__(self, event: TrainEvent) -> None:
        """Write the numbers of an event, if it has any."""
        if event.kind == "log":
            row = {"step": event.step, "seconds": round(event.seconds, 2), **event.losses}
            try:
                if self._writes:
                    self._add_row(row)
            except OSError as fault:
                self._writes = False
                self._on_note(
                    f"cannot write {TABLE} ({fault.strerror or fault}); the run continues without it"
                )
            self._show({f"loss/{name}": value for name, value in event.losses.items()}, event.step)
        for score in event.scores if event.kind == "score" else ():
            values = {
                "joint-speed": score.joint_speed,
                "pose-distance": score.pose_distance,
                "slide": score.slide,
            }
            self._show({f"{name}/{score.type}": value for name, value in values.items()}, event.step)

    def _add_row(self, row: dict[str, Any]) -> None:
        path = self.folder / TABLE
        fresh = not self._adds or not path.exists() or not path.stat().st_size
        with path.open("w" if fresh else "a", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            if fresh:
                writer.writeheader()
            writer.writerow(row)
        self._adds = True

    def _show(self, values: dict[str, float], step: int) -> None:
        for name, value in values.items() if self._board is not None else ():
            self._board.add_scalar(name, value, step)

    def __exit__(self, *details: object) -> None:
        if self._board is not None:
            self._board.close()


def _board(folder: Path) -> Any:
    """TensorBoard's writer; None where TensorBoard is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder))


def check_table(folder: Path, resumed: bool = False) -> None:
    """Raise OverwriteError if the folder has a log.csv of another run or program; a resumed run adds to its own."""
    path = folder / TABLE
    if path.is_file():
        with path.open("rb") as file:
            begins = file.read(len(BEGINS))
        if begins == BEGINS and not resumed:
            raise OverwriteError(f"{path}: exists; choose another folder, or replace it with --force")
        if begins not in (b"", BEGINS):
            raise OverwriteError(
                f"{path}: was not written by motionkit; choose another folder, or replace it with --force"
            )
