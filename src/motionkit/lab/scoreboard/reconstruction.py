"""Reconstruction of held-out clips (the paper's tables): roll out a clip from its first frames and its controls."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.control.character_start import last_poses
from motionkit.control.recording_choice import frames_behind
from motionkit.control.reference_player import ReferencePlayer
from motionkit.control.speeds import acceleration_limit
from motionkit.control.synthesize import SynthesisOptions, finished, unfinished
from motionkit.data.dataset import ClipData, Dataset
from motionkit.features.control import Controls, blend_types, future_trajectory
from motionkit.inference.rollout import RolloutState, run
from motionkit.inference.start import INIT_FRAMES
from motionkit.lab.floors import last_frame, motion_matching, nearest_clip
from motionkit.lab.held_out import (
    LEAST_REST,
    Continue,
    HeldOut,
    compared,
    decoded,
    held_out,
    in_references,
)
from motionkit.lab.scoreboard.report import Goal, Section, at_most
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.lab.scoreboard.trial import Trial
from motionkit.lab.statistics import weighted_mean
from motionkit.metrics.body import Body, body_of
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.tables import Table
from motionkit.training.verdict.rolling import Progress, Take

METRICS = ("bm-euler", "afs", "afs-ground", "ssim-channel", "ssim-window", "mpjpe", "path-mean")
# The recording itself, delayed by this many frames: a scale for the other scores.
DELAYS = {"3 frames late": 3, "20 frames late": 20}
ALONE = "without references"
FLOORS = ("last frame", "nearest clip", "motion matching")
VARIANTS = ("ground truth", "model", "raw network", ALONE, *DELAYS, *FLOORS)
TARGET_SLIDING, TARGET_RAW_SLIDING = 0.6, 1.3  # relative to the recordings; the paper's own is 1.29


Means = dict[
    tuple[str, str], dict[str, float]
]  # by type or "all", and variant: metric to its mean over frames


class SequenceControls:
    """Asks one character for what a recording does after its first frames; a Controller for a batch of one.

    The trajectory is where the recording lies on the ground, as a path is (paper section 5.2): it leads a body
    beside it back. Types other than gaits get reference clips, which follow it as closely as they do in synthesis.
    """

    def __init__(self, model: MotionModel, types: tuple[str, ...], data: ClipData, initial: int) -> None:
        """Take the names of the recording's types, its data, and how many of its frames are given."""
        self.model, self.types, self.data, self.initial = model, types, data, initial
        places = np.array([model.type_id(kind) if kind in model.types else 0 for kind in types])
        self.weights = blend_types(places[data.types], len(model.types))
        # The recording's trajectory says when it rests.
        self.player, self.kind = ReferencePlayer(model, rests=True), ""
        self.near: Array | None = last_poses(model, data.features[:initial])

    @property
    def types_used(self) -> list[str]:
        """The recording's types that the model has."""
        return [name for i in np.unique(self.data.types) if (name := self.types[i]) in self.model.types]

    def __call__(self, frame: int, ground: Array) -> Controls:
        at = np.array([min(self.initial + frame, len(self.data.types) - 1)])
        trajectory = future_trajectory(self.data.ground, at, ground)
        kind = self.types[self.data.types[at[0]]]
        if kind not in self.model.types or self.model.kind(kind).steered:
            controls = replace(Controls.of_types(self.weights[at]), trajectory=trajectory)
            return replace(controls, phase=self.data.phases[at]).with_mask(1.0)
        if kind != self.kind:
            self._begin(kind, trajectory[0])
        controls = self.player.play(1, trajectory)
        phase = controls.phase if controls.reference_gain.any() else self.data.phases[at]
        return replace(controls, type_weights=self.weights[at], phase=phase).with_mask(1.0)

    def _begin(self, kind: str, trajectory: Array) -> None:
        """Begin reference clips of a type; the first go on from the frames that were given."""
        behind = 0 if self.near is None else frames_behind(self.model, kind, self.near)
        self.player.begin(kind, self.near, behind, trajectory)
        self.kind, self.near = kind, None


def held_out_clips(
    model: MotionModel, dataset: Dataset, longest: float, split: str = "test"
) -> list[HeldOut]:
    """Return the clips of a split that are long enough and whose types the model has, rolled out for `longest` s."""
    found = held_out(dataset, round(longest * model.fps), split, (INIT_FRAMES,))
    return [
        clip
        for clip in found
        if {dataset.types[k] for k in np.unique(clip.data.types).tolist()} <= set(model.types)
    ]


def roll_like(
    model: MotionModel,
    dataset: Dataset,
    clips: list[HeldOut],
    settings: EvaluationSettings,
    progress: Progress,
) -> list[Take]:
    """Roll out every clip from its first frames with its own types, trajectory and phase (SequenceControls)."""
    frames = max(clip.frames for clip in clips)
    recordings = [SequenceControls(model, dataset.types, clip.data, clip.initial) for clip in clips]

    def controls(frame: int, ground: Array) -> Controls:
        return Controls.concatenated([ask(frame, ground[i : i + 1]) for i, ask in enumerate(recordings)])

    state = RolloutState(model, len(clips), settings.noise, settings.first_seed)
    state.start(
        [c.data.features[: c.initial] for c in clips],
        [c.data.contacts[: c.initial] for c in clips],
        np.stack([ask.weights[0] for ask in recordings]),
        np.stack([c.data.ground[c.initial - 1] for c in clips]),
    )
    rollout = run(state, frames, controls, lambda frame: progress(frame / frames))
    skeleton = model.character("default")
    takes = []
    for index, clip in enumerate(clips):
        # The trajectory is given, as on a path: feet that are locked do not change it.
        mine, options = rollout.first(clip.frames), SynthesisOptions(raw=True)
        most = acceleration_limit(model, recordings[index].types_used)
        locked, raw = finished(model, unfinished(model, mine, index, skeleton, most), skeleton, options)
        assert raw is not None, "the options ask for it"
        takes.append(Take(body_of(locked), body_of(raw)))
    return takes


def reconstruction_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: the model beside ground truth and baselines, per type and overall."""
    model, dataset, settings = trial.model, trial.dataset, trial.settings
    title = "Reconstruction of held-out clips"
    clips = held_out_clips(model, dataset, settings.reconstruction_seconds, settings.split)
    if not clips:
        return Section("reconstruction", title, notes=[_why_none(model, dataset, settings.split)])
    means = _measured(trial, clips, progress)
    groups = ["all", *sorted({clip.kind for clip in clips})]
    rows = [
        (group, variant, *(means.get((group, variant), {}).get(m) for m in METRICS))
        for group in groups
        for variant in VARIANTS
        if variant != ALONE or trial.without_references is not None
    ]
    counts = []
    for group in groups:
        frames = [clip.frames for clip in clips if group in ("all", clip.kind)]
        counts.append((group, len(frames), sum(frames) / model.fps))
    tables = [
        Table("Metrics per type", ("type", "motion", *METRICS), rows),
        Table("Held-out clips", ("type", "clips", "seconds compared"), counts),
    ]
    known = in_references(model, dataset, [clip.clip for clip in clips])
    return Section("reconstruction", title, tables, _goals(means), _notes(settings, known))


def _measured(trial: Trial, clips: list[HeldOut], progress: Progress) -> Means:
    """The means of all variants over the clips, each clip rolled out as often as the settings repeat."""
    repeated = clips * trial.settings.repeats
    takes = _takes(trial, repeated, lambda share: progress(0.5 * share))
    training = [trial.dataset.clips[number] for number in trial.real.training]
    data = trial.dataset
    floors = dict(
        zip(FLOORS, (last_frame(data), nearest_clip(data, training), motion_matching(data)), strict=True)
    )
    found: dict[tuple[str, str], dict[str, list[tuple[float, float]]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for number, clip in enumerate(repeated):
        recorded = data.motion(clip.clip, clip.data, trial.model.character("default"))
        candidates = {name: made[number] for name, made in takes.items()}
        if number < len(clips):
            candidates |= _baselines(trial, clip, recorded, floors)
        truth = recorded.cut(clip.initial, clip.initial + clip.frames)
        for variant, candidate in candidates.items():
            for metric, (made, real) in compared(candidate, truth, METRICS).items():
                for group in (clip.kind, "all"):
                    if made is not None:
                        found[group, variant][metric].append((made, clip.frames))
                    if variant == "model" and real is not None:
                        found[group, "ground truth"][metric].append((real, clip.frames))
        progress(0.5 + 0.5 * (number + 1) / len(repeated))
    return {key: {m: weighted_mean(values) for m, values in each.items()} for key, each in found.items()}


def _takes(trial: Trial, clips: list[HeldOut], progress: Progress) -> dict[str, list[Motion]]:
    """What the model makes of each clip, as users get it, raw, and without reference recordings where it has some."""
    model, bare = trial.model, trial.without_references
    takes = roll_like(model, trial.dataset, clips, trial.settings, lambda share: progress(0.6 * share))
    out = {
        "model": [as_motion(model, take.default) for take in takes],
        "raw network": [as_motion(model, take.raw) for take in takes],
    }
    if bare is not None:
        alone = roll_like(
            bare, trial.dataset, clips, trial.settings, lambda share: progress(0.6 + 0.4 * share)
        )
        out[ALONE] = [as_motion(model, take.default) for take in alone]
    return out


def _baselines(
    trial: Trial, clip: HeldOut, recorded: Motion, floors: dict[str, Continue]
) -> dict[str, Motion]:
    """The recording itself, delayed, and the floors."""
    body = trial.model.character("default")
    out = {
        name: recorded.cut(clip.initial - delay, clip.initial - delay + clip.frames)
        for name, delay in DELAYS.items()
    }
    return out | {name: decoded(trial.dataset, clip, make(clip, 0), body) for name, make in floors.items()}


def _notes(settings: EvaluationSettings, known: list[str]) -> list[str]:
    seen = f"too good, because the model has recordings of these clips as references: {', '.join(known)}"
    return [
        *([seen] if known else []),
        f"{settings.repeats} roll-outs per held-out clip start from its first {INIT_FRAMES} frames, use its types, "
        "phase and trajectory, which is asked for where it lies on the ground, as a path is, and last at most "
        f"{settings.reconstruction_seconds:g} s; metrics (docs/metrics.md) are means over frames, in cm, and in "
        "degrees per frame at 60 fps",
        "frames late: the recording itself, delayed by this many frames",
        "baselines: the last given frame, held; the continuation of the training clip whose half second before is "
        "nearest; motion matching over the training clips for the same types and trajectory",
        "model: as synthesize makes motion by default, feet locked; raw network: feet not locked; without references: "
        "with --reference none; sliding (afs) of all is measured from the floor of the recording, afs-ground above "
        "y = 0",
    ]


def _why_none(model: MotionModel, dataset: Dataset, split: str) -> str:
    """Why a split has no clip to measure, in words."""
    least = INIT_FRAMES + LEAST_REST
    clips = dataset.select(split)
    if not clips:
        return f"not measured: the dataset has no {split} clips; preprocess holds some out where types have several"
    long = [clip for clip in clips if clip.frames >= least]
    if not long:
        return f"not measured: none of the {len(clips)} {split} clips has {least} frames"
    present = {dataset.types[kind] for clip in long for kind in np.unique(dataset.clip_types(clip)).tolist()}
    unknown = ", ".join(sorted(present - set(model.types)))
    return f"not measured: the {len(long)} {split} clips hold types that the model does not have: {unknown}"


def as_motion(model: MotionModel, body: Body) -> Motion:
    return Motion(model.character("default"), body.rotations, body.positions[:, 0], body.fps)


def _goals(means: Means) -> list[Goal]:
    truth, model, raw = (
        means.get(("all", variant), {}) for variant in ("ground truth", "model", "raw network")
    )

    def ratio(metric: str, of: dict[str, float]) -> float | None:
        base = truth.get(metric)
        return of[metric] / base if base and metric in of else None

    above = "foot sliding of the raw network / real, heights above y = 0 (afs-ground)"
    goals = [
        Goal("body movement / real (bm-euler)", ratio("bm-euler", model), "0.95 to 1.05", 0.95, 1.05),
        at_most("foot sliding / real (afs)", ratio("afs", model), TARGET_SLIDING),
        at_most("foot sliding of the raw network / real (afs)", ratio("afs", raw), TARGET_RAW_SLIDING),
        at_most(above, ratio("afs-ground", raw), TARGET_RAW_SLIDING),
    ]
    for metric in ("ssim-channel", "ssim-window", "mpjpe", "path-mean"):
        more = metric.startswith("ssim")
        for name, the in (("nearest clip", "the nearest clip"), ("motion matching", "motion matching")):
            limit = means.get(("all", name), {}).get(metric)
            target = f"{'>' if more else '<'} {name}" + ("" if limit is None else f", {limit:.3g}")
            limits = (limit, None) if more else (None, limit)
            goals.append(Goal(f"{metric} against {the}", model.get(metric), target, *limits))
    return goals
