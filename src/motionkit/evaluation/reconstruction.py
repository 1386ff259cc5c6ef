"""Reconstruction of held-out clips (the paper's tables): roll out a clip from its first frames and its controls."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array
from motionkit.control.speeds import acceleration_limit
from motionkit.control.synthesize import SynthesisOptions, finish_motions
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.evaluation.body import Body, body_of
from motionkit.evaluation.real import RealMotion
from motionkit.evaluation.report import Goal, Section, Table
from motionkit.evaluation.rolling import Progress, Take
from motionkit.evaluation.sequence_controls import SequenceControls
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.evaluation.trial import Trial
from motionkit.features.control import Controls
from motionkit.features.decode import decode_motion
from motionkit.inference.rollout import RolloutState, run
from motionkit.inference.start import INIT_FRAMES
from motionkit.metrics.report import evaluate_motion, placed_like
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion

SHORTEST_REST = 30  # frames a clip needs after its first INIT_FRAMES
METRICS = ("bm-euler", "afs", "afs-ground", "ssim-channel", "ssim-window", "mpjpe", "path-mean")
MATCH_FRAMES = (0, 10, 20, 30)  # frames before the roll-out whose poses the nearest clip must match
# The recording itself, delayed by this many frames: a scale for the other scores.
DELAYS = {"3 frames late": 3, "20 frames late": 20}
ALONE = "without references"
VARIANTS = ("ground truth", "model", "raw network", ALONE, *DELAYS, "last frame", "nearest clip")
TARGET_SLIDING, TARGET_RAW_SLIDING = 0.6, 1.3  # relative to the recordings; the paper's own is 1.29


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A held-out clip: its main type, data, motion on the default body, and how many frames to roll out.

    initial is the number of frames that are given.
    """

    type: str
    data: ClipData
    motion: Motion
    frames: int
    initial: int = INIT_FRAMES

    @property
    def rest(self) -> Motion:
        """The recorded motion of the frames to roll out."""
        return self.motion.cut(self.initial, self.initial + self.frames)


def held_out_clips(
    model: MotionModel, dataset: Dataset, longest: float, split: str = "test"
) -> list[HeldOut]:
    """Return the clips of a split that are long enough and whose types the model has, rolled out for `longest` s."""
    out = []
    limit = round(longest * model.fps)
    for clip in dataset.select(split):
        if clip.frames < INIT_FRAMES + SHORTEST_REST:
            continue
        data = dataset.read(clip)
        frames = min(limit, clip.frames - INIT_FRAMES)
        # The type of most of the frames to roll out.
        kinds = data.types[INIT_FRAMES : INIT_FRAMES + frames]
        if set(dataset.types[k] for k in np.unique(data.types).tolist()) <= set(model.types):
            kind = dataset.types[int(np.bincount(kinds).argmax())]
            out.append(HeldOut(kind, data, _motion(model, dataset, data), frames))
    return out


def _motion(model: MotionModel, dataset: Dataset, data: ClipData) -> Motion:
    return decode_motion(
        data.features,
        model.character("default"),
        dataset.fps,
        data.ground[0],
        dataset.reference_rotations,
        dataset.layout.version,
    )


def roll_like(
    model: MotionModel,
    dataset: Dataset,
    clips: list[HeldOut],
    settings: EvaluationSettings,
    progress: Progress,
) -> list[Take]:
    """Roll out every clip from its first frames with its own types, trajectory and phase (SequenceControls)."""
    frames = max(clip.frames for clip in clips)
    asked = [SequenceControls(model, dataset.types, clip.data, clip.initial) for clip in clips]

    def controls(frame: int, ground: Array) -> Controls:
        return Controls.concatenated([ask(frame, ground[i : i + 1]) for i, ask in enumerate(asked)])

    state = RolloutState(model, len(clips), settings.noise, settings.first_seed)
    state.start(
        [c.data.features[: c.initial] for c in clips],
        [c.data.contacts[: c.initial] for c in clips],
        np.stack([ask.weights[0] for ask in asked]),
        np.stack([c.data.ground[c.initial - 1] for c in clips]),
    )
    rollout = run(state, frames, controls, lambda frame: progress(frame / frames))
    skeleton = model.character("default")
    takes = []
    for index, clip in enumerate(clips):
        # The way is given, as on a path: feet that are locked do not change it.
        mine, options = rollout.first(clip.frames), SynthesisOptions(raw=True)
        most = acceleration_limit(model, asked[index].shown)
        held, raw = finish_motions(model, mine, index, skeleton, options, most)
        assert raw is not None, "the options ask for it"
        takes.append(Take(body_of(held), body_of(raw)))
    return takes


class NearestClip:
    """A baseline: the continuation of the training clip whose poses match the first frames best."""

    def __init__(self, model: MotionModel, dataset: Dataset, real: RealMotion) -> None:
        self.model, self.dataset, self.real = model, dataset, real

    def continues(self, clip: HeldOut, body: Body) -> Motion:
        """Return training motion as long as the roll-out, moved and turned to continue the clip's first frames."""
        recent = [INIT_FRAMES - 1 - back for back in MATCH_FRAMES]
        wanted = body.poses()[recent]
        best: tuple[float, int, int] = (float("inf"), 0, 0)
        for number, found in self.real.training.items():
            # A clip that ends early holds its last frame. At least one second must remain.
            usable = len(found) - round(self.real.fps)
            if usable <= MATCH_FRAMES[-1]:
                continue
            poses = found.poses()
            at = np.arange(MATCH_FRAMES[-1], usable)
            cost = sum(
                np.linalg.norm(poses[at - b] - w, axis=-1) for b, w in zip(MATCH_FRAMES, wanted, strict=True)
            )
            assert isinstance(cost, np.ndarray)
            place = int(cost.argmin())
            best = min(best, (float(cost[place]), number, int(at[place])))
        source: Clip = self.dataset.clips[best[1]]
        motion = _motion(self.model, self.dataset, self.dataset.read(source))
        last = len(motion) - 1
        rows = np.minimum(np.arange(clip.frames + 1) + best[2], last)
        cut = Motion(motion.skeleton, motion.local_rotations[rows], motion.root_positions[rows], motion.fps)
        before = clip.motion.cut(INIT_FRAMES - 1, INIT_FRAMES + clip.frames)
        return placed_like(cut, before).cut(1, clip.frames + 1)


def _frozen(clip: HeldOut) -> Motion:
    """Return the last given frame, held."""
    still = clip.motion.cut(INIT_FRAMES - 1, INIT_FRAMES)
    return Motion(
        still.skeleton,
        still.local_rotations.repeat(clip.frames, axis=0),
        still.root_positions.repeat(clip.frames, axis=0),
        still.fps,
    )


def reconstruction_section(trial: Trial, progress: Progress) -> Section:
    """Measure the section: the model beside ground truth and baselines, per type and overall."""
    model, dataset, settings = trial.model, trial.dataset, trial.settings
    clips = held_out_clips(model, dataset, settings.reconstruction_seconds, settings.split)
    if not clips:
        return Section(
            "reconstruction",
            "Reconstruction of held-out clips",
            notes=[_why_none(model, dataset, settings.split)],
        )
    repeated = clips * settings.repeats
    bare = trial.without_references
    rolled = {"model": roll_like(model, dataset, repeated, settings, lambda share: progress(0.3 * share))}
    if bare is not None:
        rolled[ALONE] = roll_like(
            bare, dataset, repeated, settings, lambda share: progress(0.3 + 0.2 * share)
        )
    nearest = NearestClip(model, dataset, trial.real)
    sums: dict[tuple[str, str], dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for number, clip in enumerate(repeated):
        take = rolled["model"][number]
        candidates = {"model": as_motion(model, take.default), "raw network": as_motion(model, take.raw)}
        if ALONE in rolled:
            candidates[ALONE] = as_motion(model, rolled[ALONE][number].default)
        if number < len(clips):
            candidates |= {
                name: clip.motion.cut(INIT_FRAMES - delay, INIT_FRAMES - delay + clip.frames)
                for name, delay in DELAYS.items()
            }
            candidates["last frame"] = _frozen(clip)
            candidates["nearest clip"] = nearest.continues(clip, body_of(clip.motion.cut(0, INIT_FRAMES)))
        for variant, candidate in candidates.items():
            report = evaluate_motion(candidate, clip.rest)
            for row in report.rows:
                if row.id not in METRICS or row.motion.value is None or row.ground_truth is None:
                    continue
                for group in (clip.type, "all"):
                    sums[group, variant][row.id].append((row.motion.value, float(clip.frames)))
                    if variant == "model" and row.ground_truth.value is not None:
                        sums[group, "ground truth"][row.id].append(
                            (row.ground_truth.value, float(clip.frames))
                        )
        progress(0.5 + 0.5 * (number + 1) / len(repeated))
    groups = ["all", *sorted({clip.type for clip in clips})]
    means = {key: {m: _mean(values) for m, values in found.items()} for key, found in sums.items()}
    rows = [
        (group, variant, *(means.get((group, variant), {}).get(m) for m in METRICS))
        for group in groups
        for variant in VARIANTS
        if variant != ALONE or ALONE in rolled
    ]
    columns = ("type", "motion", *METRICS)
    counts = [
        (group, sum(c.type == group or group == "all" for c in clips), _seconds(clips, group, model.fps))
        for group in groups
    ]
    tables = [
        Table("Metrics per type", columns, rows),
        Table("Held-out clips", ("type", "clips", "seconds compared"), counts),
    ]
    notes = [
        f"{settings.repeats} roll-outs per held-out clip start from its first {INIT_FRAMES} frames, use its types, "
        "phase and trajectory, which is asked for where it lies on the ground, as a path is, and last at most "
        f"{settings.reconstruction_seconds:g} s; metrics (docs/metrics.md) are means over frames, in cm, and in "
        "degrees per frame at 60 fps",
        "frames late: the recording itself, delayed by this many frames",
        "baselines: the last given frame, held, and the continuation of the training clip whose half second before is "
        "nearest",
        "model: as synthesize makes motion by default, feet locked; raw network: feet not locked; without references: "
        "with --reference none; sliding (afs) of all is measured from the floor of the recording, afs-ground above "
        "y = 0",
    ]
    return Section("reconstruction", "Reconstruction of held-out clips", tables, _goals(means), notes)


def _why_none(model: MotionModel, dataset: Dataset, split: str) -> str:
    """Why a split has no clip to measure, in words."""
    least = INIT_FRAMES + SHORTEST_REST
    clips = dataset.select(split)
    if not clips:
        return f"not measured: the dataset has no {split} clips; preprocess holds some out where types have several"
    long = [clip for clip in clips if clip.frames >= least]
    if not long:
        return f"not measured: none of the {len(clips)} {split} clips has {least} frames"
    held = {dataset.types[kind] for clip in long for kind in np.unique(dataset.clip_types(clip)).tolist()}
    unknown = ", ".join(sorted(held - set(model.types)))
    return f"not measured: the {len(long)} {split} clips hold types that the model does not have: {unknown}"


def as_motion(model: MotionModel, body: Body) -> Motion:
    return Motion(model.character("default"), body.rotations, body.positions[:, 0], body.fps)


def _goals(means: dict[tuple[str, str], dict[str, float]]) -> list[Goal]:
    truth, model, raw, near = (
        means.get(("all", variant), {})
        for variant in ("ground truth", "model", "raw network", "nearest clip")
    )

    def ratio(metric: str, of: dict[str, float]) -> float | None:
        base = truth.get(metric)
        return of[metric] / base if base and metric in of else None

    goals = [
        Goal("body movement / real (bm-euler)", ratio("bm-euler", model), "0.95 to 1.05", 0.95, 1.05),
        Goal("foot sliding / real (afs)", ratio("afs", model), f"≤ {TARGET_SLIDING:g}", None, TARGET_SLIDING),
        Goal(
            "foot sliding of the raw network / real (afs)",
            ratio("afs", raw),
            f"≤ {TARGET_RAW_SLIDING:g}",
            None,
            TARGET_RAW_SLIDING,
        ),
        Goal(
            "foot sliding of the raw network / real, heights above y = 0 (afs-ground)",
            ratio("afs-ground", raw),
            f"≤ {TARGET_RAW_SLIDING:g}",
            None,
            TARGET_RAW_SLIDING,
        ),
        Goal("SSIM (ssim-window)", model.get("ssim-window"), "≥ 0.992", 0.992),
    ]
    for metric, more in (
        ("ssim-channel", True),
        ("ssim-window", True),
        ("mpjpe", False),
        ("path-mean", False),
    ):
        limit = near.get(metric)
        target = f"{'>' if more else '<'} nearest clip" + ("" if limit is None else f", {limit:.3g}")
        limits = (limit, None) if more else (None, limit)
        goals.append(Goal(f"{metric} against the nearest clip", model.get(metric), target, *limits))
    return goals


def _mean(values: list[tuple[float, float]]) -> float:
    return sum(v * w for v, w in values) / sum(w for _, w in values)


def _seconds(clips: list[HeldOut], group: str, fps: float) -> float:
    return sum(c.frames for c in clips if group in ("all", c.type)) / fps
