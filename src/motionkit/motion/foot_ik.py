"""Feet that stay where they touch: locks at contacts, eased in and out, reached by two-bone legs.

Works on a whole motion of the canonical joints. While a foot is in contact its toe is held at one place
on the floor; the knee bends to let it, and the hips come down where the leg is too short.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_between, quat_inverse, quat_multiply, quat_normalize, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES

EASE_FRAMES = 8
MIN_LOCK_FRAMES = 4
# Contacts switch on above the first and off below the second probability, so that they do not flicker.
CONTACT_ON, CONTACT_OFF = 0.6, 0.4
MAX_SLIDE = 16.0  # cm; a foot that slides further while "in contact" is not held back any more
MAX_REACH = 0.999  # of the length of the straight leg
TOE_HEIGHT = 2.5  # cm; no toe goes below this height (a standing one is recorded at 1.8 to 3.6)
# A toe that moves along the ground is off it: by so many times its way in a frame, up to so many cm.
# Of the recorded toes a quarter are lower, at any speed.
CLEARANCE, MAX_CLEARANCE = 2.7, 5.0
LIFT_FRAMES = 2  # a foot is up so many frames before it has to be, and begins to rise as many earlier


@dataclass(frozen=True)
class _Leg:
    hip: int
    knee: int
    ankle: int
    toe: int
    contacts: tuple[int, int]


def _leg(side: str, contacts: tuple[int, int]) -> _Leg:
    hip, knee, ankle, toe = (JOINT_NAMES.index(side + n) for n in ("UpLeg", "Leg", "Foot", "ToeBase"))
    return _Leg(hip, knee, ankle, toe, contacts)


LEGS = (_leg("Left", (0, 1)), _leg("Right", (2, 3)))


def lock_feet(motion: Motion, contacts: Tensor) -> Motion:
    """The motion with its feet held still while they touch the floor.

    Args:
        motion: T frames on the canonical joints, cm, the floor at height zero.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe.
    """
    if len(motion) < 2:
        return motion
    _, positions = motion_kinematics(motion)
    shifts = [_toe_shifts(positions[:, leg.toe], contacts[:, list(leg.contacts)]) for leg in LEGS]
    targets = [positions[:, leg.ankle] + shift for leg, shift in zip(LEGS, shifts, strict=True)]
    motion = _lower_hips(motion, positions, targets)
    for leg, target in zip(LEGS, targets, strict=True):
        # Twice: the plane of a nearly straight leg is only known once it is bent.
        motion = _reach(_reach(motion, leg, target), leg, target)
    return motion


def locked_spans(contacts: Tensor) -> list[tuple[int, int]]:
    """Stretches (start, end) in which a foot is in contact, from probabilities (T, 2) of ankle and toe."""
    level = contacts.max(dim=-1).values.tolist()
    spans, start = [], None
    for t, value in enumerate([*level, 0.0]):
        if start is None and value > CONTACT_ON:
            start = t
        elif start is not None and value < CONTACT_OFF:
            if t - start >= MIN_LOCK_FRAMES:
                spans.append((start, t))
            start = None
    return spans


def _still_spans(toe: Tensor, spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Spans cut where the foot has slid further than a lock may hold it back: it then takes a new place.

    The frames in which it goes over are left out, so that it does not jump.
    """
    out = []
    for start, end in spans:
        first = start
        for t in range(start, end):
            if float((toe[t] - toe[first])[[0, 2]].norm()) > MAX_SLIDE:
                out.append((first, t - EASE_FRAMES))
                first = t
        out.append((first, end))
    return [(start, end) for start, end in out if end > start]


def _toe_shifts(toe: Tensor, contacts: Tensor) -> Tensor:
    """How far (T, 3) the foot has to move at each frame: fully while locked, fading over the frames around."""
    frames = len(toe)
    pulls, strength = torch.zeros(frames, 3, dtype=torch.float64), torch.zeros(frames, 1, dtype=torch.float64)
    weights = torch.zeros(frames, 1, dtype=torch.float64)
    for start, end in _still_spans(toe, locked_spans(contacts)):
        lock = toe[start:end].median(dim=0).values
        shift = torch.zeros_like(pulls)
        shift[start:end] = lock - toe[start:end]
        # Outside the lock the shift at its edge fades away.
        shift[:start], shift[end:] = shift[start].clone(), shift[end - 1].clone()
        distance = torch.zeros(frames, dtype=torch.float64)
        distance[:start] = torch.arange(start, 0, -1)
        distance[end:] = torch.arange(1, frames - end + 1)
        x = (1.0 - distance / EASE_FRAMES).clamp(0.0, 1.0)
        share = (x * x * (3.0 - 2.0 * x))[:, None]
        # Frames between two near locks are shared by them; within a lock it alone counts.
        weight = share / (1.0 - share + 1e-9)
        pulls, weights = pulls + weight * shift, weights + weight
        strength = torch.maximum(strength, share)
    total = (strength * pulls / weights.clamp(min=1e-12)).to(toe.dtype)
    total[:, 1] += _lift(toe + total)
    return total


def _lift(toe: Tensor) -> Tensor:
    """How much higher (T,) a toe (T, 3) has to be, to stay off a floor that it moves along.

    At the ends of a lock the toe comes down and leaves the floor, as a foot does at the ends of a step.
    """
    way = torch.diff(toe[:, [0, 2]], dim=0).norm(dim=-1)
    # The longer of the ways to a frame and from it.
    way = torch.maximum(F.pad(way, (1, 0)), F.pad(way, (0, 1)))
    least = TOE_HEIGHT + (CLEARANCE * way).clamp(max=MAX_CLEARANCE)
    missing = (least - toe[:, 1]).clamp(min=0.0)
    return _eased_most(missing, missing[:, None], LIFT_FRAMES)[:, 0]


def _eased_most(size: Tensor, values: Tensor, half: int) -> Tensor:
    """Of values (T, k) the one of largest size (T,) within half frames around each, smoothed over as many.

    So the smoothed ones nowhere fall short of what is needed.
    """
    kernel = torch.hann_window(2 * half + 3, periodic=False, dtype=values.dtype)[1:-1]
    kernel = (kernel / kernel.sum())[None, None]
    _, largest = F.max_pool1d(size[None, None], 2 * half + 1, stride=1, padding=half, return_indices=True)
    padded = F.pad(values[largest[0, 0]].T[:, None], (half, half), mode="replicate")
    return F.conv1d(padded, kernel)[:, 0].T


def _lower_hips(motion: Motion, positions: Tensor, targets: list[Tensor]) -> Motion:
    """Move the root towards feet its legs cannot reach, smoothly over time."""
    need = torch.zeros_like(motion.root_positions)
    for leg, target in zip(LEGS, targets, strict=True):
        lengths = motion.skeleton.offsets[[leg.knee, leg.ankle]].norm(dim=-1).sum()
        reach = target - positions[:, leg.hip]
        distance = reach.norm(dim=-1, keepdim=True)
        missing = (distance - MAX_REACH * lengths).clamp(min=0.0)
        already = (positions[:, leg.ankle] - positions[:, leg.hip]).norm(dim=-1, keepdim=True)
        # A leg that was straight before stays so; only what the lock adds is taken from the hips.
        missing = torch.minimum(missing, (distance - already).clamp(min=0.0))
        move = reach / distance.clamp(min=1e-6) * missing
        need = torch.where(missing > need.norm(dim=-1, keepdim=True), move, need)
    eased = _eased_most(need.norm(dim=-1), need, EASE_FRAMES)
    return replace(motion, root_positions=motion.root_positions + eased)


def _reach(motion: Motion, leg: _Leg, target: Tensor) -> Motion:
    """Bend one leg so that its ankle comes to target (T, 3); the foot keeps its orientation in the world."""
    rotations, positions = motion_kinematics(motion)
    hip, knee, ankle = (positions[:, j] for j in (leg.hip, leg.knee, leg.ankle))
    thigh, shin = (knee - hip).norm(dim=-1), (ankle - knee).norm(dim=-1)
    reach = (target - hip).norm(dim=-1)
    reach = torch.minimum(torch.maximum(reach, (thigh - shin).abs() + 0.5), (thigh + shin) * MAX_REACH)
    # Where nothing is asked for, nothing changes, a fully straight leg included.
    still = (target - ankle).norm(dim=-1, keepdim=True) < 1e-3
    bend_now = _interior_angle(thigh, shin, (ankle - hip).norm(dim=-1))
    bend_then = _interior_angle(thigh, shin, reach)
    axis = torch.linalg.cross(hip - knee, ankle - knee)
    # A straight leg has no plane; its knee bends about the thigh's own sideways axis.
    sideways = quat_rotate(rotations[:, leg.hip], torch.tensor([1.0, 0.0, 0.0]).expand_as(axis))
    flat = axis.norm(dim=-1, keepdim=True) < 1e-2 * (thigh * shin)[:, None]
    axis = F.normalize(torch.where(flat, -sideways, axis), dim=-1)
    opened = _about(axis, bend_then - bend_now)
    new_ankle = knee + quat_rotate(opened, ankle - knee)
    swing = quat_between(new_ankle - hip, target - hip)
    thigh_turn = quat_multiply(swing, rotations[:, leg.hip])
    shin_turn = quat_multiply(swing, quat_multiply(opened, rotations[:, leg.knee]))
    parent = motion.skeleton.parents[leg.hip]
    local = motion.local_rotations.clone()
    new = {
        leg.hip: quat_multiply(quat_inverse(rotations[:, parent]), thigh_turn),
        leg.knee: quat_multiply(quat_inverse(thigh_turn), shin_turn),
        leg.ankle: quat_multiply(quat_inverse(shin_turn), rotations[:, leg.ankle]),
    }
    for joint, turn in new.items():
        local[:, joint] = torch.where(still, local[:, joint], quat_normalize(turn))
    return replace(motion, local_rotations=local)


def _interior_angle(a: Tensor, b: Tensor, opposite: Tensor) -> Tensor:
    """The angle (T,) between sides a and b of a triangle."""
    return torch.acos(((a * a + b * b - opposite * opposite) / (2 * a * b)).clamp(-1.0, 1.0))


def _about(axis: Tensor, angle: Tensor) -> Tensor:
    """Rotations (T, 4) by angle about unit axes."""
    half = 0.5 * angle[:, None]
    return torch.cat([torch.cos(half), torch.sin(half) * axis], dim=-1)
