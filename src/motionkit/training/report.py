"""Reports of a run in progress: events for the caller, and log.jsonl in the run's folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motionkit.training.progress import Progress
from motionkit.training.scores import TypeScore

# Clips of roll-outs that a run writes to its folder (scores.py, view/preview.py).
SAMPLES = ("samples/*-predicted.bvh", "samples/*-true.bvh", "preview/*-step-*.bvh")


@dataclass(frozen=True)
class TrainEvent:
    """A report of a run.

    Attributes:
        kind: "stage" before and after the steps, "step" after every step, "log" after some steps, "score",
            "checkpoint", "note", or "stop" after Ctrl-C or SIGTERM.
        text: of a note or a stop; of a stage what is done, such as "making spliced transitions".
        share: finished share of the run, or of the stage, 0 to 1.
    """

    kind: str
    step: int
    seconds: float
    losses: dict[str, float]
    scores: tuple[TypeScore, ...] = ()
    text: str = ""
    share: float = 0.0


class RunReport:
    """Sends the events of a run and writes its log, if it is to report at all: only the first process of a run does."""

    def __init__(
        self, folder: Path, progress: Progress, on_event: Callable[[TrainEvent], None] | None, writes: bool
    ) -> None:
        self.folder, self.progress = folder, progress
        self.on_event, self.writes = on_event, writes
        self._logs = True  # false once writing log.jsonl has failed

    def clear(self) -> None:
        """Remove files of an earlier run, which would be taken for this run's; others' clips stay."""
        stale = [self.folder / "checkpoint.safetensors"]
        stale += [file for pattern in SAMPLES for file in self.folder.glob(pattern)]
        with suppress(OSError):  # a folder that cannot be written is reported later
            if (self.folder / "log.jsonl").exists():
                (self.folder / "log.jsonl").open("w").close()
            for file in stale:
                file.unlink(missing_ok=True)

    def note(self, text: str) -> None:
        """Report a line of text."""
        self.emit("note", text)

    def stage(self, name: str) -> Callable[[float], None]:
        """Begin a stage before or after the steps, and return what reports its finished share, 0 to 1."""

        def tell(share: float) -> None:
            self.emit("stage", name, share)

        tell(0.0)
        return tell

    def attempt(self, what: str, work: Callable[[], None]) -> bool:
        """Do optional work; an error becomes a note instead of ending hours of training. Returns whether it worked."""
        try:
            work()
        except Exception as fault:
            why = " ".join(str(fault).split()) or type(fault).__name__
            self.note(f"{what} failed, the run continues: {why}")
            return False
        return True

    def emit(
        self, kind: str, text: str = "", share: float | None = None, scores: tuple[TypeScore, ...] = ()
    ) -> None:
        """Report an event of a kind of TrainEvent, and log it if it has numbers."""
        if not self.writes:
            return
        at = self.progress
        line: dict[str, Any] = {"kind": kind, "step": at.step, "seconds": round(at.seconds, 2)}
        if kind == "log":
            self._log(line | {"rate": at.rate} | at.losses)
        if kind == "score":
            self._log(line | {"scores": {s.type: s.to_dict() for s in scores}})
        if self.on_event:
            share = at.share if share is None else share
            self.on_event(TrainEvent(kind, at.step, at.seconds, at.losses, scores, text, share))

    def _log(self, line: dict[str, Any]) -> None:
        """Add a line to log.jsonl. After an error, such as a full disk, the run continues without the log."""
        if not self._logs:
            return
        try:
            with (self.folder / "log.jsonl").open("a", encoding="utf-8", newline="\n") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as fault:
            self._logs = False
            self.note(f"cannot write log.jsonl ({fault.strerror or fault}); the run continues without it")
