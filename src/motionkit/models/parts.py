"""Body parts as tuples of joints; the same network works with one, two, four or five parts."""

from __future__ import annotations

from dataclasses import dataclass

from motionkit.errors import ModelError
from motionkit.motion.skeleton import JOINT_NAMES


@dataclass(frozen=True)
class BodyPart:
    """A body part: one stream of the network.

    Attributes:
        joints: canonical joint indices, the shared ones first.
        contacts: which of the four foot contacts are inputs (left foot, left toe, right foot, right toe).
    """

    name: str
    joints: tuple[int, ...]
    contacts: tuple[int, ...] = ()


@dataclass(frozen=True)
class Partition:
    """Body parts, and the joints that all of them share (the paper's overlapped data)."""

    parts: tuple[BodyPart, ...]
    shared: tuple[int, ...]


def _side(side: str, names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(side + name for name in names)


_LEG = ("UpLeg", "Leg", "Foot", "ToeBase")
_ARM = ("Shoulder", "Arm", "ForeArm", "Hand")
_SPINE = ("LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")
_LEFT_FOOT, _RIGHT_FOOT = (0, 1), (2, 3)


def _part(name: str, names: tuple[str, ...], contacts: tuple[int, ...] = ()) -> BodyPart:
    return BodyPart(name, tuple(JOINT_NAMES.index(n) for n in ("Hips", *names)), contacts)


def _limbs(with_spine: bool) -> tuple[BodyPart, ...]:
    spine = _SPINE if with_spine else ()
    return (
        _part("left arm", spine + _side("Left", _ARM)),
        _part("right arm", spine + _side("Right", _ARM)),
        _part("left leg", spine + _side("Left", _LEG), _LEFT_FOOT),
        _part("right leg", spine + _side("Right", _LEG), _RIGHT_FOOT),
    )


_LEGS = _side("Left", _LEG) + _side("Right", _LEG)
_ARMS = _side("Left", _ARM) + _side("Right", _ARM)
_ROOT = (0,)
_SPINE_JOINTS = tuple(JOINT_NAMES.index(name) for name in ("Hips", *_SPINE))

# Partitions of the paper's ablation: whole body, two parts, four that share the root or the spine, five.
PARTITIONS: dict[str, Partition] = {
    "one": Partition((_part("body", _LEGS + _SPINE + _ARMS, _LEFT_FOOT + _RIGHT_FOOT),), _ROOT),
    "two": Partition(
        (_part("upper", _SPINE + _ARMS), _part("lower", _LEGS, _LEFT_FOOT + _RIGHT_FOOT)),
        _ROOT,
    ),
    "four-root": Partition(_limbs(with_spine=True), _ROOT),
    "four-spine": Partition(_limbs(with_spine=True), _SPINE_JOINTS),
    "five": Partition((*_limbs(with_spine=False), _part("spine", _SPINE)), _ROOT),
}


def partition(name: str) -> Partition:
    """Return a partition by name. Raises ModelError if it is unknown."""
    if name not in PARTITIONS:
        raise ModelError(f"body partition {name!r} is unknown, expected one of {', '.join(PARTITIONS)}")
    return PARTITIONS[name]
