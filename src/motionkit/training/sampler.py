"""Training windows, balanced over types, from recordings and spliced transitions.

Every window has its own random generator, seeded by (seed, step, place in the batch). A resumed run, and a run on
several processes, therefore sees the same windows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from motionkit.arrays import Array
from motionkit.data.dataset import ClipData, Dataset, no_training_clips
from motionkit.data.phases import type_stretches
from motionkit.data.splice import splice_clips
from motionkit.errors import DatasetError
from motionkit.features.control import (
    TRAJECTORY_COUNT,
    TRAJECTORY_OFFSETS,
    ControlLayout,
    Controls,
    blend_types,
    control_vector,
    future_trajectory,
    skeleton_signal,
    types_ahead,
)
from motionkit.features.layout import FEATURE_COUNT
from motionkit.features.reference import BEFORE_EVENT, PAUSE, event_begins, reference_map
from motionkit.motion.skeleton import canonical_skeleton
from motionkit.training.losses import Batch

GAP_FRAMES = 30  # of the shortest gap in reference poses; the longest is twice as long
LEAST_CUT = 60  # frames of the shortest cut window, of clips that have as many
MIN_SPAN = 12  # frames; shorter stretches of a type are not used for splices
STRAIGHT = 0.95  # of its way, that a window gets on by: it goes straight


@dataclass(frozen=True)
class ControlSampling:
    """How often windows go without some of their controls, or with wrong ones, so that the network learns to cope."""

    trajectory_dropout: float = 0.5  # share of windows without a trajectory
    # Standard deviation of a factor on the length of a window's trajectory. A network that is fed its own trajectory,
    # and has only seen true ones, hands on whatever speed it is given, a little higher every time. Only windows that go
    # straight have it: a gait keeps its speed, but the way of a dance is where its next step shows.
    trajectory_drift: float = 0.0
    # Share of windows without reference poses; before and after a change of type it is sampled separately.
    reference_dropout: float = 0.5
    reference_gaps: float = 0.25  # share of windows that lack reference poses for half a second to a second
    lead_share: float = 0.5  # share of windows whose type changes before the motion does
    lead_frames: int = 30  # by at most this many frames


@dataclass(frozen=True)
class SamplerOptions:
    """How windows are sampled."""

    window: int = 96  # frames per window (paper: 300)
    balance: float = 0.75  # 0: types as often as recorded; 1: all equally often (paper)
    # Factor for types with a phase, such as flips; the paper favours hard types too.
    phase_weight: float = 3.0
    type_weights: dict[str, float] = field(default_factory=dict)  # factors for single types
    splices: int = 2000  # spliced transitions made before training
    splice_share: float = 0.4  # share of windows from spliced transitions
    controls: ControlSampling = field(default_factory=ControlSampling)
    # Frames between the windows that are cut from every clip, and drawn alike (paper: 4); longer where a type has many
    # frames and shorter where it has few, by balance. 0 draws windows type by type instead.
    interval: float = 0.0
    noise: float = 0.01  # standard deviation of the noise on normalised inputs (paper: 0.05)
    # Share of windows of the types that the model a run begins from has, and the dataset has not; 0 drops those types.
    kept_share: float = 0.0


@dataclass(frozen=True)
class Span:
    """A stretch of one type in a source: a clip or a spliced transition."""

    source: int
    start: int
    end: int


def window_generator(
    seed: int, step: int, place: int, purpose: int = 0, device: torch.device | str = "cpu"
) -> torch.Generator:
    """Return the random generator of one window of one step, the same in every process."""
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
        """Index the training clips.

        Args:
            kept: types of the dataset that together have options.kept_share of the windows.
            controls: the kind of control signals (features/control.py).
        """
        self.dataset, self.options, self.seed, self.kept = dataset, options, seed, kept
        self.clips = dataset.select("train")
        if not self.clips:
            raise no_training_clips(dataset.folder)
        self.controls = ControlLayout(dataset.types, controls)
        self.reference_map = reference_map(dataset.pose_embedding, dataset.scaling)
        self.skeletons = [skeleton_signal(canonical_skeleton(body)) for body in dataset.bodies]
        self.spans = self._index([dataset.clip_types(clip) for clip in self.clips])
        self.splices: list[ClipData] = []
        self.splice_spans: dict[int, list[Span]] = {}
        self.splice_bodies: list[int] = []
        self.probabilities = self._probabilities()
        self.cuts = self._cut_windows() if options.interval else []

    def _index(self, type_tracks: list[Array]) -> dict[int, list[Span]]:
        spans: dict[int, list[Span]] = {}
        for source, types in enumerate(type_tracks):
            for start, end, kind in type_stretches(types):
                spans.setdefault(kind, []).append(Span(source, start, end))
        return spans

    def _probabilities(self) -> Tensor:
        frames = torch.zeros(len(self.dataset.types), dtype=torch.float64)
        for kind, spans in self.spans.items():
            frames[kind] = sum(s.end - s.start for s in spans)
        weights = torch.where(frames > 0, frames ** (1.0 - self.options.balance), 0.0)
        for name in self.dataset.phase_seconds:
            weights[self.dataset.types.index(name)] *= self.options.phase_weight
        for name, times in self.options.type_weights.items():
            if name not in self.dataset.types:
                known = ", ".join(self.dataset.types)
                raise DatasetError(f"--type-weights: unknown type {name!r}, expected some of {known}")
            weights[self.dataset.types.index(name)] *= times
        if not bool(weights.sum() > 0):
            raise DatasetError("--type-weights: all types have weight 0, expected at least one above 0")
        old = torch.tensor([name in self.kept for name in self.dataset.types])
        for group, share in ((old, self.options.kept_share), (~old, 1.0 - self.options.kept_share)):
            if self.kept and bool(weights[group].sum() > 0):
                weights[group] *= share / weights[group].sum()
        return weights / weights.sum()

    def use(self, options: SamplerOptions) -> None:
        """Sample the coming windows by other options. The spliced transitions stay."""
        if options != self.options:
            self.options = options
            self.probabilities = self._probabilities()
            self.cuts = self._cut_windows() if options.interval else []

    def _cut_windows(self) -> list[tuple[int, int]]:
        """Clip and first frame of the paper's windows (section 4.3, steps 1 to 4).

        Windows at the end of a clip are shorter, down to LEAST_CUT frames: most free clips are shorter than 300.
        """
        frames = np.zeros(len(self.dataset.types))
        tracks = [self.dataset.clip_types(clip) for clip in self.clips]
        for types in tracks:
            frames += np.bincount(types, minlength=len(frames))
        share = frames / frames.sum() * np.count_nonzero(frames)  # the paper's r_r / r_e
        intervals = self.options.interval * np.maximum(share, 1e-3) ** self.options.balance
        cuts = []
        for number, types in enumerate(tracks):
            last = max(0, len(types) - 1 - min(self.options.window, LEAST_CUT))
            place = 0.0
            while place <= last:
                cuts.append((number, int(place)))
                place += intervals[types[int(place)]]
        return cuts

    def make_splices(self, progress: Callable[[float], None] | None = None) -> None:
        """Make the spliced transitions: ends of training stretches joined to starts of others, the same for a seed.

        progress is called with the share that is done, 0 to 1.
        """
        generator = torch.Generator().manual_seed(self.seed + 7_919)
        usable = {k: [s for s in v if s.end - s.start >= MIN_SPAN] for k, v in self.spans.items()}
        usable = {k: v for k, v in usable.items() if v}
        weights = torch.zeros_like(self.probabilities)
        for kind in usable:
            weights[kind] = self.probabilities[kind]

        def pick(count: int) -> int:
            return int(torch.randint(count, (), generator=generator))

        bodies = []
        count = self.options.splices if bool(weights.sum() > 0) else 0
        for made in range(count):
            if progress:
                progress(made / count)
            before, after = (int(torch.multinomial(weights, 1, generator=generator)) for _ in range(2))
            # Half of the performances, strikes and jumps follow another of their type, as reference players ask for.
            again = made % 2 == 1 and self.dataset.types[after] in self.dataset.phase_seconds
            first = _random_span(usable[after if again else before], generator)
            second = _random_span(usable[after], generator)
            clip_a, clip_b = self.clips[first.source], self.clips[second.source]
            if clip_a.body != clip_b.body:
                continue
            if again:
                second = self._from_event(second, pick)
            decay = 20 + pick(21)
            spliced = splice_clips(
                self.dataset,
                (clip_a, first.start, first.end),
                (clip_b, second.start, second.end),
                decay,
                pick,
                PAUSE if again else 0,
            )
            self.splices.append(spliced)
            bodies.append(clip_a.body)
        self.splice_bodies = bodies
        self.splice_spans = self._index([data.types for data in self.splices])

    def _from_event(self, span: Span, pick: Callable[[int], int]) -> Span:
        """The rest of a stretch from shortly before one of its strikes or jumps; a whole performance."""
        phases = self.dataset.read(self.clips[span.source], span.start, span.end).phases
        begins = event_begins(phases)
        begins = begins[begins < len(phases) - MIN_SPAN]
        if not len(begins):
            return span
        begin = int(begins[pick(len(begins))])
        return replace(span, start=span.start + max(0, begin - BEFORE_EVENT))

    def batch(self, step: int, size: int, first: int = 0, count: int | None = None) -> Batch:
        """Return windows first to first + count of the batch of the given size at a step."""
        count = size if count is None else count
        windows = [self._window(window_generator(self.seed, step, first + i)) for i in range(count)]
        arrays = {name: np.stack([w[name] for w in windows]) for name in windows[0]}
        return Batch(**{name: torch.from_numpy(array) for name, array in arrays.items()})

    def _window(self, generator: torch.Generator) -> dict[str, Array]:
        options = self.options
        uniform = torch.rand(4, generator=generator, dtype=torch.float64).tolist()
        if self.cuts:
            number, start = self.cuts[int(uniform[0] * len(self.cuts))]
            clip = self.clips[number]
            data = self.dataset.read(clip, start, start + options.window + 62)
            return self._assemble(data, clip.body, uniform[3], generator)
        kind = int(torch.multinomial(self.probabilities, 1, generator=generator))
        spliced = self.splice_spans.get(kind) if uniform[0] < options.splice_share else None
        spans = spliced or self.spans[kind]
        sizes = torch.tensor([s.end - s.start for s in spans], dtype=torch.float64)
        span = spans[int(torch.multinomial(sizes, 1, generator=generator))]
        anchor = span.start + int(uniform[1] * (span.end - span.start))
        place = int(uniform[2] * options.window)
        if spliced:
            data, body = self.splices[span.source], self.splice_bodies[span.source]
            start = max(0, min(anchor - place, len(data.types) - options.window - 1))
            data = data.cut(start, start + options.window + 62)
        else:
            clip = self.clips[span.source]
            body = clip.body
            start = max(0, min(anchor - place, clip.frames - options.window - 1))
            data = self.dataset.read(clip, start, start + options.window + 62)
        return self._assemble(data, body, uniform[3], generator)

    def _assemble(self, data: ClipData, body: int, u: float, generator: torch.Generator) -> dict[str, Array]:
        options, T = self.options, self.options.window
        frames = min(T, len(data.types) - 1)
        x = self.dataset.scaling.normalize(data.features[: frames + 1])
        trajectory = future_trajectory(data.ground, np.arange(frames + 1))
        types = data.types
        if torch.rand((), generator=generator) < options.controls.lead_share:
            lead = int(torch.randint(options.controls.lead_frames + 1, (), generator=generator))
            types = np.pad(types[lead:], (0, lead), mode="edge") if lead < len(types) else types
        all_weights = blend_types(types, len(self.dataset.types))
        weights = all_weights[:frames]
        reference_gain = self._with_reference(data.types[:frames], generator)
        noise = torch.randn(frames, FEATURE_COUNT, generator=generator).numpy()
        inputs = x[:frames] + noise * options.noise
        asked = Controls(
            weights,
            self._drifted(trajectory[:frames], data.ground[: frames + 1], generator),
            np.full(frames, float(u >= options.controls.trajectory_dropout), np.float32),
            data.phases[:frames],
            data.reference[:frames],
            reference_gain,
            np.ones(frames, np.float32),
            types_ahead(all_weights)[:frames] if self.controls.kind == "paper" else None,
        )
        scaling = self.dataset.trajectory_scaling
        controls = control_vector(
            self.controls, self.skeletons[body], asked, inputs, scaling, self.reference_map, alone=False
        )
        # A short window has the same weight as a full one.
        mask = np.full(frames, T / frames, np.float32)
        window = {
            "inputs": inputs,
            "targets": x[1:],
            "contacts": data.contacts[:frames],
            "next_contacts": data.contacts[1 : frames + 1],
            "controls": controls,
            "trajectory": self.dataset.trajectory_scaling.normalize(trajectory[1:]),
            "mask": mask,
        }
        padded = {name: _pad(value, T) for name, value in window.items()}
        padded["offsets"] = self.dataset.bodies[body]
        return padded

    def _drifted(self, trajectory: Array, ground: Array, generator: torch.Generator) -> Array:
        """Trajectories (T, 24) of a window, longer or shorter by one factor where the options ask for it.

        Args:
            ground: (T + 1, 3) root x, z (cm) and heading (radians).
        """
        drift = self.options.controls.trajectory_drift
        if drift == 0.0:
            return trajectory
        change = drift * float(torch.randn((), generator=generator))
        if not _straight(ground):
            return trajectory
        factor = np.ones(TRAJECTORY_COUNT, np.float32)
        factor[: 2 * len(TRAJECTORY_OFFSETS)] += change
        return trajectory * factor

    def _with_reference(self, types: Array, generator: torch.Generator) -> Array:
        """Return the reference gain (T,), 0 or 1: one value before the first change of type, one after it, and gaps."""
        options = self.options.controls
        before, after = (torch.rand(2, generator=generator) >= options.reference_dropout).float().tolist()
        unchanged = np.logical_and.accumulate(types == types[0])
        gain = np.where(unchanged, np.float32(before), np.float32(after))
        if torch.rand((), generator=generator) < options.reference_gaps:
            begins, frames = torch.rand(2, generator=generator).tolist()
            first = int(begins * len(types))
            gain[first : first + GAP_FRAMES + int(frames * GAP_FRAMES)] = 0.0
        return gain


def _random_span(spans: Sequence[Span], generator: torch.Generator) -> Span:
    """One of some stretches."""
    # Long stretches hold more motion, but only their ends are joined: the square root is a compromise.
    sizes = torch.tensor([(s.end - s.start) ** 0.5 for s in spans])
    return spans[int(torch.multinomial(sizes, 1, generator=generator))]


def _straight(ground: Array) -> bool:
    """Whether a way (T, 3) of root x, z (cm) and heading gets on by nearly all of its length."""
    steps = np.diff(ground[:, :2], axis=0)
    return bool(np.linalg.norm(steps.sum(axis=0)) >= STRAIGHT * np.linalg.norm(steps, axis=1).sum())


def _pad(values: Array, frames: int) -> Array:
    """Return values (T, ...) padded with zeros to the given number of frames."""
    if len(values) == frames:
        return values
    return np.pad(values, [(0, frames - len(values)), *[(0, 0)] * (values.ndim - 1)])
