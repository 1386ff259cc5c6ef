"""Synthesis of whole motions from motion types: the library call behind `motionkit synthesize`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.control.character_start import CharacterStart, character_start
from motionkit.control.keys import Key, check_keys
from motionkit.control.lead_ins import with_final_rest, with_lead_ins
from motionkit.control.meet import KeyedController, meet_keys
from motionkit.control.plan import Plan, plan_keys, plan_types
from motionkit.control.planned_controls import CrowdController
from motionkit.control.script import TypePart
from motionkit.control.speeds import acceleration_limit
from motionkit.errors import ControlError
from motionkit.finish.finish import Finish, Unfinished
from motionkit.free_memory import check_memory
from motionkit.inference.noise import Noise, default_noise
from motionkit.inference.rollout import Controller, Rollout, RolloutState, rollout_motion, run
from motionkit.inference.start import clip_motion
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion, resample
from motionkit.motion.skeleton import JOINT_COUNT, Skeleton, leg_length
from motionkit.names import listed
from motionkit.rig.soles import body_soles
from motionkit.seeds import check_seed

MAX_FRAMES = 500_000  # of all characters together, at the higher of model and file rate; takes 4 GB of memory
# Share of foot sliding that the root of a gait follows; chosen. With all of it, the speed of walks varies twice as much
# as recorded.
GAIT_HOLD = 0.7


@dataclass(frozen=True, eq=False)
class Synthesis:
    """One synthesized motion.

    Attributes:
        motion: the motion on the character's skeleton at the requested rate, finished if options.ik is set.
        contacts: (T, 4) predicted contacts at the model's rate.
        types: the planned parts.
        raw: the motion before finishing, if options.raw is set.
        unfinished: the motion before finishing, with its contacts, to finish it on a rig instead; None with keys.
        cyclic: whether the motion is a closed cycle (mk.loop), which stays closed on a rig.
    """

    motion: Motion
    contacts: Array
    types: tuple[TypePart, ...]
    raw: Motion | None = None
    unfinished: Unfinished | None = None
    cyclic: bool = False


@dataclass(frozen=True)
class SynthesisOptions:
    """Options of synthesis, with the defaults of the command.

    noise None takes the model's default noise, and fps None its rate. ik finishes the motion, raw also keeps the motion
    before finishing, and keys are keys to meet.

    character holds names of bodies, separated by commas, which the motions take in turn.

    Raises ControlError for a count below 1, an invalid seed, or a noise that is no Noise.
    """

    count: int = 1
    seed: int = 0
    noise: Noise | None = None
    character: str = "default"
    init: str | Path | Motion | None = None
    ik: bool = True
    fps: float | None = None
    raw: bool = False
    keys: tuple[Key, ...] = ()

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ControlError(f"expected at least 1 motion, found {self.count}")
        check_seed(self.seed)
        if self.noise is not None and not isinstance(self.noise, Noise):
            raise ControlError(f"expected noise such as mk.Noise('mean'), found {self.noise!r}")

    @property
    def characters(self) -> list[str]:
        """The names in character."""
        return listed(self.character)


@dataclass(frozen=True, eq=False)
class SynthesisResult:
    """All motions of a call, and the duration of the roll-out in seconds."""

    motions: tuple[Synthesis, ...]
    seconds: float

    @property
    def motion(self) -> Motion:
        """The first motion, for calls that make only one."""
        return self.motions[0].motion

    @property
    def types(self) -> Sequence[TypePart]:
        """The types of the first motion."""
        return self.motions[0].types

    @property
    def unfinished(self) -> Unfinished | None:
        """What the first motion was finished from."""
        return self.motions[0].unfinished

    @property
    def frames(self) -> int:
        """Frames of all motions at the model's rate."""
        return sum(len(s.contacts) for s in self.motions)


def synthesize(
    model: MotionModel,
    parts: Sequence[TypePart] | Sequence[Sequence[TypePart]],
    options: SynthesisOptions | None = None,
    progress: Callable[[int], None] | None = None,
) -> SynthesisResult:
    """Synthesize motion types one after another; the same seed gives the same motion.

    Performances are whole, from standing or a run-up to standing (control/lead_ins.py).

    All characters run in one batch with successive seeds; each moves as it would alone with its seed. parts is one list
    for all characters, or several lists that they take in turn. options.character may hold several names, separated by
    commas, which they also take in turn.

    Raises:
        ControlError: for an unknown type or character, a count below one, or more than MAX_FRAMES.
    """
    options = options or SynthesisOptions()
    sequences = _sequences(model, parts, options)
    names = options.characters
    skeletons = [model.character(name) for name in names]
    init = None if options.init is None else clip_motion(model, options.init)
    bodies, starts, plans = [], [], []
    for i in range(options.count):
        sequence = sequences[i % len(sequences)]
        begins = (with_lead_ins(model, sequence) if init is None else sequence)[0].type
        bodies.append(model.moved_skeleton(names[i % len(names)]))
        starts.append(character_start(model, begins, bodies[-1], init, options.seed + i))
        sequence = with_lead_ins(model, sequence, None if init is None else starts[-1].start_state)
        plans.append(
            with_final_rest(model, plan_types(model, sequence, starts[-1].start_state), options.seed + i)
        )
    state = _begun(model, options, bodies, starts, plans)
    crowd = CrowdController(model, plans, options.seed, state.frame)
    controller: Controller = crowd
    if options.keys:
        share = model.body_scale(names[0])
        if any(model.body_scale(name) != share for name in names[: options.count]):
            raise ControlError("keys take bodies with legs of one length; make the motions one by one")
        for each in starts:
            # Gaps of in-betweening may be shorter than those that users' keys may have.
            check_keys(options.keys, share * each.start.ground[0, :2], earliest=1.0 / model.fps)
        keyed = [plan_keys(plan, options.keys) for plan in plans]
        controller = KeyedController(model, crowd, keyed, starts, share)
    limits = [acceleration_limit(model, [part.type for part in plan.parts]) for plan in plans]
    started = time.perf_counter()
    rollout = run(state, max(len(plan.track) for plan in plans), controller, progress)
    seconds = time.perf_counter() - started
    motions = []
    for i, plan in enumerate(plans):
        mine = rollout.first(len(plan.track))
        skeleton, most = skeletons[i % len(skeletons)], limits[i]
        hold = model.root_hold(plan.weights, GAIT_HOLD)
        drawn = unfinished(model, mine, i, skeleton, most, hold)
        motion, raw = finished(model, drawn, skeleton, options)
        motions.append(Synthesis(motion, mine.contacts[i], plan.parts, raw, None if options.keys else drawn))
    return SynthesisResult(tuple(motions), seconds)


def _begun(
    model: MotionModel,
    options: SynthesisOptions,
    bodies: list[Skeleton],
    starts: Sequence[CharacterStart],
    plans: Sequence[Plan],
) -> RolloutState:
    """Start a roll-out from the first frames of each character."""
    state = RolloutState(model, options.count, options.noise or default_noise(model), options.seed)
    state.controls.set_skeletons(bodies)
    frames = [each.start for each in starts]
    state.start(
        [start.features[0] for start in frames],
        [start.contacts[0] for start in frames],
        np.stack([plan.weights[0] for plan in plans]),
        np.concatenate([start.ground for start in frames]),
        [each.length for each in starts],
    )
    return state


def check_size(seconds: float, model_fps: float, options: SynthesisOptions) -> None:
    """Raise MotionkitError for more motion than memory holds, or less than two frames of the file."""
    rate = options.fps or model_fps
    least = 1.0 / rate + 1.0 / model_fps  # as resample counts frames
    if seconds < least - 1e-9:
        raise ControlError(
            f"expected at least 2 frames, {least:.2g} s at {rate:g} fps, found {seconds:.2g} s"
        )
    fps = max(model_fps, rate)
    most = MAX_FRAMES / options.count / fps
    if seconds > most:
        raise ControlError(
            f"{seconds:.0f} s of motion for each of {options.count} at {fps:g} fps are "
            f"{seconds * fps * options.count:,.0f} frames, expected at most {MAX_FRAMES:,}: {most:.0f} s for each"
        )
    check_memory(round(seconds * fps * options.count), JOINT_COUNT, fps * options.count)


def _sequences(
    model: MotionModel, parts: Sequence[TypePart] | Sequence[Sequence[TypePart]], options: SynthesisOptions
) -> list[list[TypePart]]:
    """Return the lists of parts that characters take in turn; raises ControlError if they cannot be synthesized."""
    sequences: list[list[TypePart]] = []
    alone: list[TypePart] = []
    for part in parts:
        if isinstance(part, TypePart):
            alone.append(part)
        else:
            sequences.append(list(part))
    sequences = sequences or [alone]
    check_size(max(sum(part.seconds for part in each) for each in sequences), model.fps, options)
    for part in (part for each in sequences for part in each):
        model.type_id(part.type)
    if options.keys and len(sequences) > 1:
        raise ControlError("keys are met by characters with the same types; give one list of types")
    return sequences


def unfinished(
    model: MotionModel,
    rollout: Rollout,
    index: int,
    skeleton: Skeleton,
    most: float | None = None,
    hold: Array | float = 0.0,
) -> Unfinished:
    """Decode one character of a roll-out into a motion before finishing.

    The motion is on the skeleton of the character if the network takes skeletons as input, else on the default body.

    Args:
        skeleton: skeleton of the character.
        most: limit of the root's acceleration over the ground in m/s^2 (acceleration_limit); None for no limit.
        hold: share (T,), or one for all frames, of foot sliding to subtract from the root's path; 0 keeps the path.
    """
    motion = rollout_motion(model, rollout, index, _moved(model, skeleton))
    size = leg_length(skeleton) / leg_length(motion.skeleton)
    settings = Finish(hold=hold, most=most, size=size, soles=body_soles(motion.skeleton))
    return Unfinished(motion, rollout.contacts[index], settings)


def finished(
    model: MotionModel, drawn: Unfinished, skeleton: Skeleton, options: SynthesisOptions
) -> tuple[Motion, Motion | None]:
    """Finish a motion on its skeleton, at the rate of the options; also returns it unfinished if options.raw is set."""
    raw = _at_rate(on_character(drawn.motion, skeleton), options) if options.raw else None
    if options.keys:
        before = None if options.init is None else on_character(clip_motion(model, options.init), skeleton)
        body = on_character(drawn.motion, skeleton)
        motion = meet_keys(body, drawn.contacts, options.keys, options.ik, before)
    else:
        motion = on_character(drawn.finished() if options.ik else drawn.motion, skeleton)
    return _at_rate(motion, options), raw


def _at_rate(motion: Motion, options: SynthesisOptions) -> Motion:
    return motion if options.fps is None else resample(motion, options.fps)


def _moved(model: MotionModel, skeleton: Skeleton) -> Skeleton:
    """The skeleton that the network moves for a character with this skeleton."""
    return skeleton if model.shows_bodies else model.character("default")


def on_character(motion: Motion, skeleton: Skeleton) -> Motion:
    """Put the rotations on another body, and scale the root's path by its leg length."""
    share = leg_length(skeleton) / leg_length(motion.skeleton)
    return replace(motion, skeleton=skeleton, root_positions=motion.root_positions * share)
