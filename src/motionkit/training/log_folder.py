"""Numbers of a run for other programs: a CSV table, and TensorBoard's event files where TensorBoard is installed."""

from __future__ import annotations

import csv
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from motionkit.training.report import TrainEvent

TABLE = "log.csv"


class LogFolder(AbstractContextManager["LogFolder"]):
    """Writes the losses and scores of a run; called with its events.

    log.csv has a row for each logged step: step, seconds and the losses by name. A resumed run adds rows to it.
    TensorBoard gets the same losses, and the scores of each type.
    """

    def __init__(self, folder: str | Path) -> None:
        """Make the folder. Raises OSError if it cannot be made."""
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self._board = _board(self.folder)

    def __call__(self, event: TrainEvent) -> None:
        """Write the numbers of an event, if it has any."""
        if event.kind == "log":
            self._add_row({"step": event.step, "seconds": round(event.seconds, 2), **event.losses})
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
        fresh = not path.exists() or not path.stat().st_size
        with path.open("a", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            if fresh:
                writer.writeheader()
            writer.writerow(row)

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
