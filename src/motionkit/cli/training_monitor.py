"""Output of `train` while it runs: a bar, losses, roll-out scores, and a growing preview."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import stderr_console
from motionkit.names import duration

if TYPE_CHECKING:
    from rich.live import Live

    from motionkit.training.options import TrainOptions
    from motionkit.training.report import TrainEvent
    from motionkit.view.preview import Preview

PREVIEW_KINDS = (".html", ".png")
_BAR = 30  # width in columns


def check_preview(path: Path | None) -> None:
    """Raise UsageError for a preview that is neither a page nor a sheet."""
    if path is not None and path.suffix.lower() not in PREVIEW_KINDS:
        raise click.UsageError(f"--preview {path}: expected a file named .html or .png")


class TrainingMonitor:
    """Shows the events of a run: a bar on a terminal, plain lines elsewhere, score tables and previews in both."""

    def __init__(
        self,
        quiet: bool,
        options: TrainOptions,
        preview: Path | None,
        samples: Path,
        warnings: Sequence[str] = (),
        losses: bool = True,
    ) -> None:
        """Warnings are printed when training begins, so that a run that cannot begin prints only its error.

        losses=False hides losses and scores, which mean little to people new to training.
        """
        self.losses = losses
        self.quiet, self.steps, self.warnings = quiet, options.steps, list(warnings)
        self.preview: Preview | None = None
        if preview is not None:
            from motionkit.view.preview import Preview

            self.preview = Preview(preview, samples)
        self.first_process = os.environ.get("RANK", "0") == "0"
        self.console = stderr_console()
        self.live: Live | None = None
        self.began: TrainEvent | None = None  # the first step; not the run's first in a resumed run
        self.last_stage = "", -1  # stage and quarter of the last line about a stage
        self.stopping = ""

    def __enter__(self) -> TrainingMonitor:
        if sys.stderr.isatty() and not self.quiet and self.first_process:
            from rich.live import Live

            from motionkit.cli.console import PlainConsole

            # Lines that the terminal wraps could not be erased.
            self.console = PlainConsole(sys.stderr, soft_wrap=False)
            self.live = Live(console=self.console, refresh_per_second=4, transient=True)
            self.live.start()
        return self

    def __exit__(self, *details: object) -> None:
        if self.live is not None:
            self.live.stop()

    def __call__(self, event: TrainEvent) -> None:
        while self.warnings:
            self.console.print(f"warning: {self.warnings.pop(0)}")
        if event.kind == "score" and self.preview and (fault := self.preview.grow(event.step)):
            self.console.print(fault)
        if self.quiet:
            return
        if event.kind == "stop":
            self._stop(event)
        elif event.kind == "stage":
            self._stage(event.text, event.share)
        elif event.kind == "note":
            self.console.print(event.text)
        elif event.kind == "score":
            if self.losses:
                self.console.print(score_table(event))
        elif event.kind in ("step", "log"):
            self.began = self.began or event
            if self.live is not None:
                self.live.update(self._status(event))
            elif event.kind == "log":
                terms = " ".join(f"{name} {value:.3f}" for name, value in event.losses.items())
                self.console.print(
                    f"{self._progress_text(event)}: {terms}" if self.losses else self._progress_text(event)
                )

    def _stop(self, event: TrainEvent) -> None:
        """Report a signal at once. It may have interrupted a print, so bypass Python's buffers."""
        self.stopping = event.text
        os.write(2, f"{os.linesep if self.live else ''}{event.text}{os.linesep}".encode())

    def _stage(self, name: str, share: float) -> None:
        percent = round(100 * share)
        if self.live is not None:
            self.live.update(f"{name} {_bar(share)} {percent} %")
        elif (name, percent // 25) != self.last_stage:
            self.last_stage = name, percent // 25
            self.console.print(f"{name}: {percent} %")

    def _progress_text(self, event: TrainEvent) -> str:
        """Steps done, and the speed since this process began and what it leaves of time."""
        total = f" of {self.steps}" if self.steps else ""
        done = f"step {event.step}{total}, {event.share:.0%}"
        began = self.began
        # At first it is too early to measure.
        if began is None or event.seconds <= began.seconds or event.share <= began.share:
            return done
        seconds = event.seconds - began.seconds
        left = seconds * (1.0 - event.share) / (event.share - began.share)
        rate = (event.step - began.step) / seconds
        speed = f"{rate:.2f} steps/s" if rate < 10 else f"{rate:.0f} steps/s"
        return f"{done}, {speed}, {duration(left)} left"

    def _status(self, event: TrainEvent) -> Any:
        from rich.console import Group

        lines = [f"{_bar(event.share)} {self._progress_text(event)}"]
        if self.losses:
            lines.append(", ".join(f"{name} {value:.2f}" for name, value in event.losses.items()))
        return Group(*lines, *([self.stopping] if self.stopping else []))


def _bar(share: float) -> str:
    done = round(_BAR * min(max(share, 0.0), 1.0))
    return "━" * done + "╺" * (_BAR - done)


def score_table(event: TrainEvent) -> Any:
    """The roll-out scores as a table."""
    from motionkit.cli.console import make_table

    rows = [
        (
            score.type,
            f"{score.joint_speed:.2f}",
            f"{score.pose_distance:.1f}",
            f"{score.slide:.2f}",
            f"{score.height[0]:.0f} to {score.height[1]:.0f}",
        )
        for score in event.scores
    ]
    columns = ("type", "joint speed", "pose distance cm", "slide", "root height cm")
    title = f"roll-outs at step {event.step} (joint speed and foot slide relative to recordings)"
    return make_table(columns, rows, title=title)
