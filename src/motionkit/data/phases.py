"""The phase of performances: flips, strikes (kicks and punches) and jumps.

The paper has no such signal. A run continues from its last poses, but a cartwheel or a kick begins from standing, and
the poses do not say when. The phase does: it rises from 0 at the beginning to 1 at the end (docs/network.md). Two
kinds of types have a phase. In types that turn the body over, each labelled stretch is one performance. In types
of strikes or jumps, each strike or jump is one. A left strike covers the first half of the phase and a right one the
second half, so the phase also tells the side.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from motionkit.arrays import Array
from motionkit.data.events import KINDS, SIDED, Event, find_events
from motionkit.features.decode import decode_rotations
from motionkit.features.layout import feature_layout
from motionkit.motion.rotations import quat_rotate

NO_PHASE = -1.0
# Vertical component of the hips' up axis; a stretch with a frame below it turns the body over.
_INVERTED = -0.3
# The phase of a type follows an event that covers this share of its frames and occurs in this share of its stretches.
_COVER, _SHARE = 0.2, 0.5
# If stretches have fewer frames than this and at least this many events each on average, each stretch is a performance.
_SHORT, _SEVERAL = 180, 2.0


@dataclass(frozen=True)
class PhaseRule:
    """What one cycle of a type's phase spans, an event or "" for a whole stretch, and the mean frames of a cycle."""

    event: str
    frames: float

    @property
    def sided(self) -> bool:
        """Whether the first half of the phase is a left strike and the second half a right one."""
        return self.event in SIDED


def turns_over(features: Array, layout: str) -> bool:
    """Whether the hips are upside down in any frame of unnormalised features (T, 276)."""
    root = decode_rotations(features, None, layout)[:, 0]
    up = quat_rotate(root, np.array([0.0, 1.0, 0.0], np.float32))
    return bool((up[:, 1] < _INVERTED).any())


def type_stretches(types: np.ndarray) -> list[tuple[int, int, int]]:
    """Stretches (start, end, type id) of equal type ids (T,)."""
    edges = [0, *(np.flatnonzero(np.diff(types)) + 1).tolist(), len(types)]
    return [(a, b, int(types[a])) for a, b in pairwise(edges)]


@dataclass(frozen=True)
class PhaseStretch:
    """Facts about one stretch of a type: its frames, whether the body turns over, and its events."""

    frames: int
    turns: bool
    events: dict[str, list[Event]]


def phase_stretch(features: Array, layout: str) -> PhaseStretch:
    """The facts about a stretch, from its unnormalised features (T, 276)."""
    events = find_events(features, feature_layout(layout))
    return PhaseStretch(len(features), turns_over(features, layout), events)


def phase_rules(clips: Iterable[tuple[Array, np.ndarray]], layout: str) -> dict[int, PhaseRule]:
    """Phase rules by type id, of types that have a phase, from features (T, 276) and type ids (T,) of each clip."""
    stretches: dict[int, list[PhaseStretch]] = defaultdict(list)
    for features, types in clips:
        for start, end, kind in type_stretches(types):
            stretches[kind].append(phase_stretch(features[start:end], layout))
    rules = {kind: phase_rule(mine) for kind, mine in stretches.items()}
    return {kind: rule for kind, rule in rules.items() if rule is not None}


def phase_rule(stretches: Sequence[PhaseStretch]) -> PhaseRule | None:
    """The phase rule of a type with these stretches; None if it has no phase."""
    frames = [s.frames for s in stretches]
    whole = PhaseRule("", float(np.mean(frames)))
    if 2 * sum(s.turns for s in stretches) > len(stretches):
        return whole
    for event in KINDS:
        found = [e for s in stretches for e in s.events[event]]
        lengths = [e.end - e.start for e in found]
        share = np.mean([bool(s.events[event]) for s in stretches])
        if 2 * sum(e.stride for e in found) > len(found):  # running: its flights are no jumps
            continue
        if not found or sum(lengths) < _COVER * sum(frames) or share < _SHARE:
            continue
        if np.mean(frames) < _SHORT and len(found) >= _SEVERAL * len(stretches):
            return whole
        return PhaseRule(event, float(np.mean(lengths)) * (2.0 if event in SIDED else 1.0))
    return None


def phase_track(features: Array, types: np.ndarray, rules: dict[int, PhaseRule], layout: str) -> np.ndarray:
    """Phase (T,) in [0, 1) of the performances of a clip, NO_PHASE elsewhere."""
    out = np.full(len(types), NO_PHASE, np.float32)
    for start, end, kind in type_stretches(types):
        rule = rules.get(kind)
        if rule is None:
            continue
        if not rule.event:
            out[start:end] = np.arange(end - start, dtype=np.float32) / (end - start)
            continue
        for event in find_events(features[start:end], feature_layout(layout))[rule.event]:
            # Where two events overlap, the later one wins.
            progress = np.arange(event.end - event.start, dtype=np.float32) / (event.end - event.start)
            if rule.sided:
                progress = 0.5 * progress + (0.5 if event.right else 0.0)
            out[start + event.start : start + event.end] = progress
    return out


def mirror_phases(phases: Array, sided: Array) -> Array:
    """Phases (T,) of the mirror image: where the flags sided (T,) are true, the left and right halves swap."""
    other = np.where(phases < 0.5, phases + 0.5, phases - 0.5)
    return np.where(sided & (phases >= 0), other, phases)
