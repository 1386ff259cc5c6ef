"""A trained model: its network, its motion types, and everything needed to run them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import ControlError
from motionkit.features.control import ControlLayout
from motionkit.features.normalize import Scaling
from motionkit.features.reference import PoseEmbedding, ReferenceMap, reference_map
from motionkit.models.config import PredictorConfig
from motionkit.models.motion_type import (
    MotionKind,
    MotionType,
    recorded_rhythm,
    recorded_speeds,
    recorded_velocity,
)
from motionkit.models.weights import NetworkWeights
from motionkit.motion.skeleton import Skeleton, canonical_skeleton, leg_length
from motionkit.names import nfc, unknown_name
from motionkit.rig.soles import LiveSoles

REFERENCE_CHOICES = ("auto", "none")


@dataclass(frozen=True, eq=False)
class MotionModel:
    """A network with everything needed to run it.

    Attributes:
        types: the motion types by name, in the order of the type signal.
        scaling, trajectory_scaling: scalings of the 276 features and the 24 trajectory numbers.
        reference_rotations: (23, 4) rotations to which the exponential maps of the features are relative.
        characters: rest-pose offsets (23, 3) in cm by name; "default" is always there.
        uses_references: whether the network was trained with reference poses.
        own_bodies: whether it was trained on performers with their own bodies.
        soles: of characters with a mesh, by name, for live motion.
        card: data, settings, duration and scores of the training; for people, not needed to run.
    """

    network: NetworkWeights
    types: dict[str, MotionType]
    fps: float
    scaling: Scaling
    trajectory_scaling: Scaling
    reference_rotations: Array
    pose_embedding: PoseEmbedding
    characters: dict[str, Array]
    uses_references: bool = False
    card: dict[str, Any] = field(default_factory=dict)
    own_bodies: bool = False
    soles: dict[str, LiveSoles] = field(default_factory=dict)

    @property
    def type_names(self) -> tuple[str, ...]:
        """Names of the motion types, in the order of the type signal."""
        return tuple(self.types)

    @property
    def config(self) -> PredictorConfig:
        """The network's configuration."""
        return self.network.config

    @property
    def controls(self) -> ControlLayout:
        """The layout of a control vector."""
        return ControlLayout(self.type_names, self.config.controls)

    @property
    def plain(self) -> bool:
        """Whether roll-outs are those of the paper: frames as sampled, and the predicted trajectory fed back."""
        return self.config.controls == "paper"

    @property
    def shows_bodies(self) -> bool:
        """Whether the network takes a character's skeleton as input and moves that skeleton."""
        return self.plain or self.own_bodies

    @property
    def reference_map(self) -> ReferenceMap:
        """Maps reference poses to the reference signal of the network."""
        return reference_map(self.pose_embedding, self.scaling)

    def type_id(self, name: str) -> int:
        """The index of a motion type; raises ControlError, with the nearest name, for an unknown one."""
        if name in self.types:
            return self.type_names.index(name)
        raise ControlError(unknown_name("motion type", name, self.type_names))

    def type_weights(self, name: str) -> Array:
        """Type weights (N,) of one motion type; raises ControlError for an unknown one."""
        weights = np.zeros(len(self.types), np.float32)
        weights[self.type_id(name)] = 1.0
        return weights

    def kind(self, name: str) -> MotionKind:
        """The kind of a motion type; FREE for one that the model does not have."""
        return self.types[name].kind if name in self.types else MotionKind.FREE

    def phase_seconds(self, kind: str) -> float:
        """Length in seconds of a performance, strike or jump of a type; 0 for types without a phase."""
        return self.types[kind].phase_seconds(self.fps) if kind in self.types else 0.0

    def speed_range(self, kind: str) -> tuple[float, float] | None:
        """Slowest and fastest speed in cm/s of a gait, from its recordings; None for other types."""
        return self._speed_ranges.get(kind)

    @cached_property
    def _speed_ranges(self) -> dict[str, tuple[float, float] | None]:
        """The speed range of each gait; cached, because live characters need it in every frame."""
        return {
            name: known.speeds or recorded_speeds(known.reference_clips, self.fps)
            for name, known in self.types.items()
            if known.kind is MotionKind.GAIT
        }

    def root_hold(self, type_weights: Array, gaits: float = 1.0) -> Array:
        """Share (...) of foot sliding to subtract from the root's path, by type weights (..., N); of gaits another one.

        It is 0 for a standing body: its feet shuffle while it sways, and the correction would carry it away.
        """
        moving = self._moving if gaits == 1.0 else np.where(self._gaits, np.float32(gaits), self._moving)
        # A matrix product would not do: its last digits depend on the other characters' rows.
        return (type_weights * moving).sum(axis=-1)

    @cached_property
    def _moving(self) -> Array:
        """1 for each type (N,), but 0 for standing; cached, because live characters need it in every frame."""
        return np.array([each.kind is not MotionKind.STANCE for each in self.types.values()], np.float32)

    @cached_property
    def _gaits(self) -> Array:
        """Whether each type (N,) is a gait."""
        return np.array([each.kind is MotionKind.GAIT for each in self.types.values()])

    def presets(self, name: str) -> Array:
        """One field (N,) of the sampling presets of all types, such as "noise_scale"."""
        return np.array([getattr(kind.preset, name) for kind in self.types.values()], np.float32)

    def with_types(self, changes: Mapping[str, Mapping[str, Any]]) -> MotionModel:
        """The model with some fields of some types changed: with_types({"walking": {"gait": None}})."""
        types = {name: replace(kind, **changes.get(name, {})) for name, kind in self.types.items()}
        return replace(self, types=types)

    def with_reference(self, choice: str) -> MotionModel:
        """Return the model unchanged ("auto"), or without its reference recordings ("none").

        Without recordings, performances and strikes keep their length, and jumps their rhythm, so that a clock can
        count their phase. Gaits and jumps keep their usual velocity. Other types get enough noise to move as much as
        recorded.

        Raises:
            ControlError: for another choice.
        """
        if choice not in REFERENCE_CHOICES:
            raise ControlError(unknown_name("reference", choice, REFERENCE_CHOICES))
        if choice == "auto":
            return self
        changes: dict[str, dict[str, Any]] = {}
        for name, kind in self.types.items():
            performed = kind.kind is MotionKind.PERFORMANCE
            rhythm = None if performed else recorded_rhythm(kind.reference_clips)
            changes[name] = {"reference_clips": (), "rhythm": rhythm, "speeds": self.speed_range(name)}
            changes[name]["preset"] = kind.preset.without_references
            if rhythm is not None or kind.kind is MotionKind.GAIT:
                changes[name]["velocity"] = recorded_velocity(kind.reference_clips, self.fps)
            if kind.gait is not None:
                seconds = self.phase_seconds(name) if rhythm is None else rhythm.frames / self.fps
                changes[name]["gait"] = replace(kind.gait, cycle_seconds=seconds)
        return replace(self.with_types(changes), uses_references=False)

    def character(self, name: str) -> Skeleton:
        """A character's skeleton; raises ControlError for an unknown name."""
        if nfc(name) not in self.characters:
            raise ControlError(unknown_name("character", name, tuple(self.characters)))
        return canonical_skeleton(self.characters[nfc(name)])

    def moved_skeleton(self, name: str) -> Skeleton:
        """The skeleton that the network moves for a character: its own if shows_bodies, else the default."""
        skeleton = self.character(name)
        return skeleton if self.shows_bodies else self.character("default")

    def body_scale(self, name: str) -> float:
        """Leg length of a character relative to that of its moved_skeleton; 1 if shows_bodies."""
        return leg_length(self.character(name)) / leg_length(self.moved_skeleton(name))
