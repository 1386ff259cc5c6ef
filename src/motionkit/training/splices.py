"""Makes the spliced transitions of a run: ends of training stretches joined to starts of others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.data.phases import type_stretches
from motionkit.data.splice import splice_clips
from motionkit.features.reference import BEFORE_EVENT, PAUSE, event_begins

MIN_SPAN = 12  # frames of the shortest stretch that is spliced


@dataclass(frozen=True)
class Span:
    """Frames start to end (exclusive) of one type in a source, which is a clip or a spliced transition."""

    source: int
    start: int
    end: int

    def __len__(self) -> int:
        return self.end - self.start


def type_spans(tracks: Sequence[Array]) -> dict[int, list[Span]]:
    """The stretches of each type id, from the type ids (T,) of each source."""
    spans: dict[int, list[Span]] = {}
    for source, types in enumerate(tracks):
        for start, end, kind in type_stretches(types):
            spans.setdefault(kind, []).append(Span(source, start, end))
    return spans


@dataclass(frozen=True, eq=False)
class Splice:
    """A spliced transition; body is an index into the dataset's bodies."""

    data: ClipData
    body: int


def make_splices(
    dataset: Dataset,
    spans: dict[int, list[Span]],
    chances: Tensor,
    count: int,
    seed: int,
    progress: Callable[[float], None] | None = None,
) -> list[Splice]:
    """Make spliced transitions, which the seed determines.

    Draws of two clips with different bodies are skipped, so there may be fewer than `count`.

    Args:
        spans: stretches of the dataset's training clips by type id.
        chances: (N,) probability of each type to be drawn.
    """
    generator = torch.Generator().manual_seed(seed + 7_919)
    usable = {k: [s for s in v if len(s) >= MIN_SPAN] for k, v in spans.items()}
    usable = {k: v for k, v in usable.items() if v}
    weights = torch.zeros_like(chances)
    for kind in usable:
        weights[kind] = chances[kind]

    def pick(count: int) -> int:
        return int(torch.randint(count, (), generator=generator))

    clips, out = dataset.select("train"), []
    for made in range(count if bool(weights.sum() > 0) else 0):
        if progress:
            progress(made / count)
        before, after = (int(torch.multinomial(weights, 1, generator=generator)) for _ in range(2))
        # Half of the performances, strikes and jumps follow one of the same type, as in synthesis of several in a row.
        again = made % 2 == 1 and dataset.types[after] in dataset.phase_seconds
        first = _random_span(usable[after if again else before], generator)
        second = _random_span(usable[after], generator)
        clip_a, clip_b = clips[first.source], clips[second.source]
        if clip_a.body != clip_b.body:
            continue
        if again:
            second = from_event(dataset, clip_b, second, pick)
        decay = 20 + pick(21)
        ends = (clip_a, first.start, first.end), (clip_b, second.start, second.end)
        data = splice_clips(dataset, *ends, decay, pick, PAUSE if again else 0)
        out.append(Splice(data, clip_a.body))
    return out


def _random_span(spans: Sequence[Span], generator: torch.Generator) -> Span:
    """A random stretch, drawn by the square root of its length."""
    # A compromise: long stretches hold more motion, but only their ends are joined.
    sizes = torch.tensor([len(s) ** 0.5 for s in spans])
    return spans[int(torch.multinomial(sizes, 1, generator=generator))]


def from_event(dataset: Dataset, clip: Clip, span: Span, pick: Callable[[int], int]) -> Span:
    """The rest of a stretch from BEFORE_EVENT frames before a random strike or jump; the whole stretch without one."""
    phases = dataset.read(clip, span.start, span.end).phases
    begins = event_begins(phases)
    begins = begins[begins < len(phases) - MIN_SPAN]
    if not len(begins):
        return span
    begin = int(begins[pick(len(begins))])
    return replace(span, start=span.start + max(0, begin - BEFORE_EVENT))
