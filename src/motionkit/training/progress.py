"""The progress of a run, and its learning rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from motionkit.training.options import TrainOptions

PAPER_FRAMES = 2000 * 60_962 * 300  # frames of the paper's training: epochs x windows x frames per window


@dataclass
class Progress:
    """Steps and seconds of a run so far, and the losses of the last step by name."""

    options: TrainOptions
    step: int = 0
    seconds: float = 0.0
    losses: dict[str, float] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """The finished share of the run, 0 to 1."""
        shares = [0.0]
        if self.options.steps:
            shares.append(self.step / self.options.steps)
        if self.options.minutes:
            shares.append(self.seconds / (60.0 * self.options.minutes))
        return min(1.0, max(shares))

    @property
    def cycle(self) -> int:
        """The number of cycles of the learning rate that have ended."""
        return int(self.options.optimizer.cycles * self.share + 1e-9)

    @property
    def rate(self) -> float:
        """The learning rate of a step: linear warm-up, then in each cycle a cosine down to final_rate times the peak.

        The schedule "halving" halves the rate at every quarter of a cycle, as the paper does every 500 of 2000 epochs.
        """
        options = self.options.optimizer
        warm = min(1.0, (self.step + 1) / max(1, options.warmup))
        share = options.cycles * self.share % 1.0 if self.share < 1.0 else 1.0
        if options.schedule == "halving":
            return options.rate * warm * 0.5 ** min(3, math.floor(4.0 * share))
        cosine = 0.5 * (1.0 + math.cos(math.pi * share))
        return options.rate * warm * (options.final_rate + (1.0 - options.final_rate) * cosine)


def beside_the_paper(options: TrainOptions, cuts: int) -> list[str]:
    """Return a line that compares a run with the paper's (section 4.3), if its windows are cut as in the paper."""
    if not cuts or not options.steps:
        return []
    batch, window = options.optimizer.batch, options.sampler.window
    share = 100.0 * options.steps * batch * window / PAPER_FRAMES
    return [
        f"{cuts} windows; {options.steps} steps of {batch} x {window} frames are "
        f"{options.steps * batch / cuts:.2f} epochs and {share:.3g} % of the "
        f"paper's frames; rate {options.optimizer.rate:g}, halved every {-(-options.steps // 4)} steps "
        "(paper: 0.0001, every 500 of 2000 epochs)"
    ]
