"""Training windows, balanced over types, from recordings and spliced transitions.

Every window has its own random generator, seeded by (seed, step, place in the batch). So a resumed run, and a run on
several processes, sees the same windows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from motionkit.arrays import Array
from motionkit.data.dataset import Dataset, no_training_clips
from motionkit.errors import DatasetError
from motionkit.features.control import TRAJECTORY_OFFSETS, ControlLayout
from motionkit.training.losses import Batch
from motionkit.training.splices import Span, Splice, make_splices, type_spans
from motionkit.training.windows import SamplerOptions, WindowMaker

LEAST_CUT = 60  # frames of the shortest window at the end of a clip (cut_windows)
# Frames to read beyond a window: the last target, and the trajectories of the last frame and of that target.
BEYOND = TRAJECTORY_OFFSETS[-1] + 2


def window_generator(
    seed: int, step: int, place: int, purpose: int = 0, device: torch.device | str = "cpu"
) -> torch.Generator:
    """Return the random generator of one window of a step, the same in every process."""
    words = np.random.SeedSequence([seed, step, place, purpose]).generate_state(2, np.uint32)
    return torch.Generator(device).manual_seed(int(words[0]) << 31 | int(words[1]))


class WindowSampler:
    """Samples windows of normalised features with their controls from a dataset's training clips."""

    def __init__(
        self,
        dataset: Dataset,
        options: SamplerOptions,
        seed: int = 0,
        kept: tuple[str, ...] = (),
        controls: str = "extended",
    ) -> None:
        """Index the training clips; kept types together get options.kept_share of the windows."""
        self.dataset, self.options, self.seed, self.kept = dataset, options, seed, kept
        self.clips = dataset.select("train")
        if not self.clips:
            raise no_training_clips(dataset.folder)
        self.controls = ControlLayout(dataset.types, controls)
        self.windows = WindowMaker(dataset, self.controls)
        self.spans = type_spans(self._tracks())
        self.splices: list[Splice] = []
        self.splice_spans: dict[int, list[Span]] = {}
        self._weigh()

    def _tracks(self) -> list[Array]:
        """Type ids (T,) of each clip."""
        return [self.dataset.clip_types(clip) for clip in self.clips]

    def _weigh(self) -> None:
        """Set the probability of each type, or the list of cut windows, which are equally probable."""
        self._check_drawn("--type-weights", self.options.type_weights)
        frames = {kind: sum(map(len, spans)) for kind, spans in self.spans.items()}
        self.probabilities = type_probabilities(self.dataset, frames, self.options, self.kept)
        self.cuts = cut_windows(self._tracks(), self.options, len(self.dataset.types))

    def _check_drawn(self, name: str, value: object) -> None:
        """Raise DatasetError for an option of windows that are drawn by type where they are cut at intervals."""
        if value and self.options.interval:
            raise DatasetError(f"{name} needs windows drawn by type; tptn-paper cuts them at intervals")

    def use(self, options: SamplerOptions) -> None:
        """Use other options from now on; the spliced transitions stay."""
        if options != self.options:
            self.options = options
            self._weigh()

    def make_splices(self, progress: Callable[[float], None] | None = None) -> None:
        """Make the spliced transitions, which the seed determines; progress is called with the finished share."""
        count = self.options.splices
        self._check_drawn("--splices", count)
        self.splices = make_splices(self.dataset, self.spans, self.probabilities, count, self.seed, progress)
        self.splice_spans = type_spans([each.data.types for each in self.splices])

    def batch(self, step: int, size: int, first: int = 0, count: int | None = None) -> Batch:
        """Return windows first to first + count of the batch of a step, which has `size` windows."""
        count = size if count is None else count
        windows = [self._window(window_generator(self.seed, step, first + i)) for i in range(count)]
        arrays = {name: np.stack([w[name] for w in windows]) for name in windows[0]}
        return Batch(**{name: torch.from_numpy(array) for name, array in arrays.items()})

    def _window(self, generator: torch.Generator) -> dict[str, Array]:
        options, T = self.options, self.options.window
        where, at, place, trajectory_draw = torch.rand(4, generator=generator, dtype=torch.float64).tolist()
        if self.cuts:
            number, start = self.cuts[int(where * len(self.cuts))]
            clip = self.clips[number]
            data, body = self.dataset.read(clip, start, start + T + BEYOND), clip.body
            return self.windows.make(data, body, options, trajectory_draw, generator)
        kind = int(torch.multinomial(self.probabilities, 1, generator=generator))
        spliced = self.splice_spans.get(kind) if where < options.splice_share else None
        spans = spliced or self.spans[kind]
        sizes = torch.tensor([len(s) for s in spans], dtype=torch.float64)
        span = spans[int(torch.multinomial(sizes, 1, generator=generator))]
        first = span.start + int(at * len(span)) - int(place * T)
        if spliced:
            splice = self.splices[span.source]
            start = max(0, min(first, len(splice.data.types) - T - 1))
            data, body = splice.data.cut(start, start + T + BEYOND), splice.body
        else:
            clip = self.clips[span.source]
            start = max(0, min(first, clip.frames - T - 1))
            data, body = self.dataset.read(clip, start, start + T + BEYOND), clip.body
        return self.windows.make(data, body, options, trajectory_draw, generator)


def type_probabilities(
    dataset: Dataset, frames: dict[int, int], options: SamplerOptions, kept: Sequence[str] = ()
) -> Tensor:
    """Probability (N,) of each type to be drawn for a window.

    Args:
        kept: types that together get options.kept_share.

    Raises:
        DatasetError: if options.type_weights names an unknown type, or excludes all types.
    """
    recorded = torch.zeros(len(dataset.types), dtype=torch.float64)
    for kind, count in frames.items():
        recorded[kind] = count
    weights = torch.where(recorded > 0, recorded ** (1.0 - options.balance), 0.0)
    for name in dataset.phase_seconds:
        weights[dataset.types.index(name)] *= options.phase_weight
    for name, times in options.type_weights.items():
        if name not in dataset.types:
            known = ", ".join(dataset.types)
            raise DatasetError(f"--type-weights: unknown type {name!r}, expected some of {known}")
        weights[dataset.types.index(name)] *= times
    if not bool(weights.sum() > 0):
        raise DatasetError("--type-weights: all types have weight 0, expected at least one above 0")
    old = torch.tensor([name in kept for name in dataset.types])
    for group, share in ((old, options.kept_share), (~old, 1.0 - options.kept_share)):
        if kept and bool(weights[group].sum() > 0):
            weights[group] *= share / weights[group].sum()
    return weights / weights.sum()


def cut_windows(tracks: Sequence[Array], options: SamplerOptions, types: int) -> list[tuple[int, int]]:
    """Clip and first frame of each of the paper's windows (section 4.3, steps 1 to 4), by type ids (T,) of each clip.

    There are none without options.interval. Windows at the end of a clip are shorter, down to LEAST_CUT frames, because
    most free clips are shorter than 300.
    """
    if not options.interval:
        return []
    frames = np.bincount(np.concatenate(tracks), minlength=types).astype(np.float64)
    share = frames / frames.sum() * np.count_nonzero(frames)  # the paper's r_r / r_e
    intervals = options.interval * np.maximum(share, 1e-3) ** options.balance
    cuts = []
    for number, track in enumerate(tracks):
        last = max(0, len(track) - 1 - min(options.window, LEAST_CUT))
        place = 0.0
        while place <= last:
            cuts.append((number, int(place)))
            place += intervals[track[int(place)]]
    return cuts
