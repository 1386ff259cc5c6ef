"""The dataset folder: memory-mapped arrays beside a JSON manifest.

manifest.json   clips, types, splits, skeleton, scaling, references, what was done to each file
features.npy    (N, 276) float32, unnormalised
contacts.npy    (N, 4) uint8
ground.npy      (N, 3) float32: root x, z (cm), heading (radians)
types.npy       (N,) int16, index into the manifest's types
phases.npy      (N,) float32: progress through a flip, strike or jump (data/phases.py), -1 elsewhere
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.data.events import SIDED
from motionkit.data.folder import ARRAYS, MANIFEST, set_aside
from motionkit.data.labels import mirrored_type
from motionkit.data.phases import mirror_phases
from motionkit.errors import DatasetError
from motionkit.features.guide import GUIDE_COUNT, GUIDE_OFFSETS, PoseOutline, fit_outline, guide_signal
from motionkit.features.layout import FeatureLayout, contact_mirror, feature_layout
from motionkit.features.normalize import Scaling
from motionkit.motion.skeleton import Skeleton, canonical_skeleton

FORMAT = 1
# Outlines are fitted to about so many frames; 0 counts all alike, 1 all types alike.
OUTLINE_FRAMES, OUTLINE_BALANCE = 200_000, 0.75


@dataclass(frozen=True)
class Clip:
    """Frames start to start + frames of the arrays: consecutive motion of one recording.

    A mirrored clip names the same rows and is reflected as it is read.
    """

    name: str
    start: int
    frames: int
    split: str
    subject: str
    body: int
    mirrored: bool = False


@dataclass(frozen=True, eq=False)
class ClipData:
    """One clip in full: features (T, 276), contacts (T, 4), ground (T, 3), type ids and phases (T,), guide (T, 72)."""

    features: Tensor
    contacts: Tensor
    ground: Tensor
    types: Tensor
    phases: Tensor
    guide: Tensor

    def cut(self, start: int, end: int) -> ClipData:
        """Frames start to end (exclusive)."""
        return ClipData(**{name: value[start:end] for name, value in vars(self).items()})


class Dataset:
    """A dataset folder, opened for reading; nothing is loaded until a clip is asked for."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        path = self.folder / MANIFEST
        if not path.exists():
            former = (
                ""
                if self.folder.exists()
                else "".join(f"; {p} is a former one" for p in set_aside(self.folder))
            )
            raise DatasetError(
                f"{self.folder}: not a dataset folder (no manifest.json); make one with preprocess{former}"
            )
        try:
            self.manifest: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise DatasetError(f"{path}: cannot be read ({error})") from None
        if not isinstance(self.manifest, dict) or self.manifest.get("format") != FORMAT:
            found = self.manifest.get("format") if isinstance(self.manifest, dict) else None
            raise DatasetError(f"{path}: dataset format {found!r}, expected {FORMAT}")
        try:
            self.types: tuple[str, ...] = tuple(self.manifest["types"])
            self.fps: float = self.manifest["fps"]
            self.clips = tuple(Clip(**values) for values in self.manifest["clips"])
            self.layout: FeatureLayout = feature_layout(self.manifest["layout"])
        except (KeyError, TypeError) as error:
            raise DatasetError(f"{path}: the manifest is damaged ({error})") from None
        self._arrays = {name: self._open(name) for name in ARRAYS}

    def _open(self, name: str) -> np.ndarray:
        path = self.folder / f"{name}.npy"
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise DatasetError(f"{path}: cannot be read ({str(error).splitlines()[0]})") from None
        rows = max((clip.start + clip.frames for clip in self.clips), default=0)
        if array.ndim == 0 or len(array) < rows:
            raise DatasetError(f"{path}: expected {rows} rows, found {array.shape[0] if array.ndim else 0}")
        return array

    @cached_property
    def scaling(self) -> Scaling:
        """Per-column scaling of the features, over the training clips."""
        return _scaling(self.manifest["feature_scaling"])

    @cached_property
    def trajectory_scaling(self) -> Scaling:
        """Per-column scaling of the trajectory numbers."""
        return _scaling(self.manifest["trajectory_scaling"])

    @cached_property
    def references(self) -> Tensor:
        """(23, 4) rotations the exponential maps are relative to."""
        return torch.tensor(self.manifest["references"], dtype=torch.float32)

    @cached_property
    def outline(self) -> PoseOutline:
        """What outlines of poses are made with: the directions in which training poses differ, rare types' more."""
        clips = [clip for clip in self.select("train") if not clip.mirrored]
        rows = np.concatenate([np.arange(clip.start, clip.start + clip.frames) for clip in clips])
        rows = rows[:: 1 + len(rows) // OUTLINE_FRAMES]
        types = torch.from_numpy(self._arrays["types"][rows].astype(np.int64))
        weights = torch.bincount(types).double()[types] ** -OUTLINE_BALANCE
        return fit_outline(torch.from_numpy(self._arrays["features"][rows]), weights, self.layout)

    @cached_property
    def bodies(self) -> tuple[Tensor, ...]:
        """(23, 3) offsets of every body in the data; clips index it."""
        return tuple(torch.tensor(body, dtype=torch.float32) for body in self.manifest["bodies"])

    @cached_property
    def characters(self) -> dict[str, Tensor]:
        """(23, 3) offsets of the performers the labels name."""
        return {
            name: torch.tensor(body, dtype=torch.float32)
            for name, body in self.manifest["characters"].items()
        }

    @property
    def phase_seconds(self) -> dict[str, float]:
        """How long a performance of each type with a phase takes on average."""
        return self.manifest["phase_seconds"]

    @property
    def phase_events(self) -> dict[str, str]:
        """What the phase of a type follows: "kick", "punch", "jump", or "" for whole stretches."""
        return self.manifest.get("phase_events", dict.fromkeys(self.phase_seconds, ""))

    @cached_property
    def sided_types(self) -> Tensor:
        """(N,) whether the halves of a type's phase are left and right."""
        return torch.tensor([self.phase_events.get(name) in SIDED for name in self.types])

    def skeleton(self, clip: Clip) -> Skeleton:
        """The skeleton a clip's features are on."""
        return canonical_skeleton(self.bodies[clip.body])

    @cached_property
    def mirrored_type_ids(self) -> Tensor:
        """For each type the id of the type its mirror image shows."""
        names = [mirrored_type(name) for name in self.types]
        return torch.tensor(
            [self.types.index(n) if n in self.types else i for i, n in enumerate(names)], dtype=torch.long
        )

    def select(self, split: str) -> list[Clip]:
        """The clips of a split, "train" or "test"."""
        return [clip for clip in self.clips if clip.split == split]

    def clip_types(self, clip: Clip) -> Tensor:
        """Type ids (T,) of a clip without reading its features."""
        rows = slice(clip.start, clip.start + clip.frames)
        types = torch.from_numpy(self._arrays["types"][rows].astype(np.int64))
        return self.mirrored_type_ids[types] if clip.mirrored else types

    def read(self, clip: Clip, start: int = 0, end: int | None = None) -> ClipData:
        """Frames start to end of a clip, mirrored where the clip says so."""
        stop = clip.frames if end is None else min(end, clip.frames)
        rows = slice(clip.start + start, clip.start + stop)
        # Guides look ahead of the last frame.
        beyond = clip.start + min(stop + GUIDE_OFFSETS[-1], clip.frames)
        poses = torch.from_numpy(np.array(self._arrays["features"][rows.start : beyond]))
        features = poses[: rows.stop - rows.start]
        contacts = torch.from_numpy(self._arrays["contacts"][rows].astype(np.float32))
        ground = torch.from_numpy(np.array(self._arrays["ground"][rows]))
        types = torch.from_numpy(self._arrays["types"][rows].astype(np.int64))
        phases = torch.from_numpy(np.array(self._arrays["phases"][rows]))
        none = torch.zeros(len(features), GUIDE_COUNT)
        data = ClipData(features, contacts, ground, types, phases, none)
        if clip.mirrored:
            data = mirror_clip(data, self.layout, self.mirrored_type_ids, self.sided_types)
            columns, signs = self.layout.mirror_map()
            poses = poses[:, columns] * signs
        guide = guide_signal(self.outline.of(poses), torch.arange(len(features)))
        return replace(data, guide=guide)


def mirror_clip(
    data: ClipData, layout: FeatureLayout, mirrored_type_ids: Tensor, sided_types: Tensor
) -> ClipData:
    """The mirror image, but for the guide.

    In features it is a permutation with signs, since references are symmetric.
    """
    columns, signs = layout.mirror_map()
    ground = data.ground * torch.tensor([-1.0, 1.0, -1.0])
    return ClipData(
        data.features[:, columns] * signs,
        data.contacts[:, contact_mirror()],
        ground,
        mirrored_type_ids[data.types],
        mirror_phases(data.phases, sided_types[data.types]),
        data.guide,
    )


def _scaling(values: dict[str, list[float]]) -> Scaling:
    return Scaling(torch.tensor(values["mean"]), torch.tensor(values["std"]))
