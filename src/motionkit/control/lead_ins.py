"""Lead-ins and ends: performances are whole, from standing or a run-up to standing; strikes and jumps end whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionkit.control.character_start import StartState
from motionkit.control.memory import AFTER_EVENT
from motionkit.control.momentum import forward_speeds
from motionkit.control.plan import Plan, plan_types
from motionkit.control.planned_controls import plan_controls
from motionkit.control.script import TypePart
from motionkit.control.steering import steered_type, usual_gaits
from motionkit.features.reference import PAUSE
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import RUN_SPEED, MotionKind

# Seconds of standing before a performance, of a run-up, of the least and usual standing at the end; chosen. Strikes
# and jumps get more, because the first may take longer than the mean.
IDLE_BEFORE, RUN_UP, LEAST_REST, REST, REST_OF_EVENTS = 0.5, 0.75, 0.5, 1.0, 1.5
# Share of the speed at which a performance was begun that the body must have; a slower one needs a run-up.
FAST_ENOUGH = 0.6


def natural_seconds(model: MotionModel, names: Sequence[str]) -> list[float]:
    """Natural seconds of each of some types one after another; 0 for types without a length of their own.

    A performance includes its run-up, and the last one the standing at the end.
    """
    out = []
    for number, name in enumerate(names):
        seconds = model.phase_seconds(name)
        if seconds and _has_lead_ins(model):
            seconds += _before(model, _lead_in(model, names[number - 1] if number else None, name))
            if number == len(names) - 1:
                seconds += REST if model.kind(name) is MotionKind.PERFORMANCE else REST_OF_EVENTS
        out.append(seconds)
    return out


def with_lead_ins(
    model: MotionModel, parts: Sequence[TypePart], start_state: StartState | None = None
) -> list[TypePart]:
    """Add stands and run-ups to the parts with performances, within their seconds.

    A motion that begins with a performance, strike or jump begins standing, or running where the performance was
    recorded at a run; so does any performance that the body is too slow for. Only whole performances are shown. Then
    the next part begins, or the body stands. Parts shorter than all this stay as they are.

    Args:
        start_state: what the clip shows that the motion continues; None if it begins with a start pose.

    Raises:
        ControlError: for an unknown type.
    """
    if not _has_lead_ins(model):
        return list(parts)
    idle = str(usual_gaits(model).stand)
    out: list[TypePart] = []
    left, slack = 0.0, 0.5 / model.fps  # sums of seconds are rounded: a whole performance may lack a little
    for number, part in enumerate(parts):
        seconds, left = round(part.seconds * model.fps) / model.fps + left, 0.0
        lead_in = _lead_in(model, out[-1].type if out else None, part.type, start_state)
        before, length = _before(model, lead_in), model.phase_seconds(part.type)
        if model.kind(part.type) is not MotionKind.PERFORMANCE or seconds < before + length:
            fits = bool(lead_in) and seconds >= before + length
            out += [TypePart(lead_in, before)] if fits else []
            out.append(TypePart(part.type, seconds - before if fits else seconds))
            continue
        last = number + 1 == len(parts)
        again = _lead_in(model, part.type, part.type)
        period = length + (_before(model, again) or PAUSE / model.fps)
        spare = seconds - before - length - (LEAST_REST if last else 0.0)
        more = max(0, int((spare + slack) / period))
        rest = seconds - before - length - more * period
        if last and rest < LEAST_REST - slack and (lead_in or out):
            # Too short to stand.
            if lead_in:
                before += rest
            else:
                out[-1] = TypePart(out[-1].type, out[-1].seconds + rest)
            rest = 0.0
        out += [TypePart(lead_in, before)] if lead_in else []
        if again:
            out += [TypePart(part.type, length), TypePart(again, RUN_UP)] * more + [
                TypePart(part.type, length)
            ]
        else:
            out.append(TypePart(part.type, length + more * period))
        if not last:
            left = rest
        elif rest:
            out.append(TypePart(idle, rest))
    return out


def with_final_rest(model: MotionModel, plan: Plan, choice: int = 0) -> Plan:
    """Let the body stand after the last strike or jump that ends before the end of a plan.

    Args:
        choice: picks among the reference clips, as in plan_controls.
    """
    last = plan.segments[-1]
    if not _has_lead_ins(model) or model.kind(last.type) is not MotionKind.EVENTS:
        return plan
    phase = plan_controls(model, plan, choice).phase[last.first :]
    # A phase ends where it becomes negative, or where the next one follows at once.
    ends = np.flatnonzero((phase[:-1] >= 0.0) & (phase[1:] < phase[:-1])) + 1 + AFTER_EVENT
    ends = ends[ends <= last.count - round(LEAST_REST * model.fps)]
    if not len(ends):
        return plan
    seconds = float(ends[-1]) / model.fps
    rest = TypePart(str(usual_gaits(model).stand), last.seconds - seconds)
    return plan_types(model, [*plan.parts[:-1], TypePart(last.type, seconds), rest], plan.start_state)


def _has_lead_ins(model: MotionModel) -> bool:
    """Whether a model can stand and has recordings to follow."""
    return model.uses_references and usual_gaits(model).stand is not None


def _before(model: MotionModel, lead_in: str) -> float:
    """Seconds that a type takes before a performance."""
    if not lead_in:
        return 0.0
    return RUN_UP if model.kind(lead_in) is MotionKind.GAIT else IDLE_BEFORE


def _lead_in(model: MotionModel, before: str | None, kind: str, start_state: StartState | None = None) -> str:
    """The type that leads to a performance, strike or jump: standing, a run, or none.

    Strikes and jumps can begin at any speed (RecordingChoice), so they only need standing at the beginning.

    Args:
        before: the type before it; None at the beginning.
        start_state: what the clip shows that the motion continues, if any.
    """
    begins = before is None and start_state is None
    if model.kind(kind) is not MotionKind.PERFORMANCE:
        return str(usual_gaits(model).stand) if begins and model.kind(kind) is MotionKind.EVENTS else ""
    clips = model.types[kind].reference_clips
    start_speed = float(np.median([forward_speeds(clip.ground, model.fps)[0] for clip in clips]))
    runs = start_speed > RUN_SPEED
    if begins:
        return steered_type(model, (0.0, start_speed), 0.0) if runs else str(usual_gaits(model).stand)
    if before is not None:
        gait = model.types[before].gait
        speed = 0.0 if gait is None or before == kind else gait.speed
    else:
        assert start_state is not None
        speed = start_speed if start_state.behind or start_state.speed is None else start_state.speed
    return steered_type(model, (0.0, start_speed), 0.0) if runs and speed < FAST_ENOUGH * start_speed else ""
