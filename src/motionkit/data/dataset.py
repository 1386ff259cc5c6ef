"""The dataset folder: memory-mapped arrays and a JSON manifest.

manifest.json   clips, types, splits, bodies, scaling, reference rotations, a report on each file
features.npy    (N, 276) float32, unnormalised
contacts.npy    (N, 4) uint8
ground.npy      (N, 3) float32: root x, z (cm), heading (radians)
types.npy       (N,) int16, index into the manifest's types
phases.npy      (N,) float32: phase of a flip, strike or jump (data/phases.py), -1 elsewhere
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.data.checking import check_manifest, check_range, open_array, same_length
from motionkit.data.events import SIDED
from motionkit.data.folder import ARRAYS, MANIFEST, set_aside
from motionkit.data.labels import mirrored_type
from motionkit.data.phases import NO_PHASE, mirror_phases, type_stretches
from motionkit.errors import DatasetError
from motionkit.features.decode import decode_motion
from motionkit.features.layout import FeatureLayout, contact_mirror, feature_layout
from motionkit.features.normalize import Scaling
from motionkit.features.reference import (
    REFERENCE_COUNT,
    REFERENCE_OFFSETS,
    PoseEmbedding,
    fit_pose_embedding,
    reference_signal,
)
from motionkit.files import read_json
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import MIRROR_JOINTS, Skeleton, canonical_skeleton
from motionkit.names import nfc

FORMAT = 1
MIRRORED = " (mirrored)"  # ends the name of a mirrored clip
SAME_BODY = 1e-3  # cm; offsets that differ by less belong to one body
# Frames that the pose embedding is fitted to. Balance 0 weights all frames equally, 1 all types equally.
EMBEDDING_FRAMES, EMBEDDING_BALANCE = 200_000, 0.75


@dataclass(frozen=True)
class Clip:
    """Rows start to start + frames of the arrays: consecutive frames of one recording.

    A mirrored clip shares the rows of its original and is mirrored as it is read.
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
    """The data of a clip.

    Attributes:
        features: (T, 276) unnormalised.
        contacts: (T, 4) labels.
        ground: (T, 3) root x, z (cm) and heading (radians).
        types: (T,) type ids.
        phases: (T,) in [0, 1), -1 without a phase.
        reference: (T, 72) reference poses.
    """

    features: Array
    contacts: Array
    ground: Array
    types: Array
    phases: Array
    reference: Array

    @staticmethod
    def plain(features: Array, contacts: Array, ground: Array, types: Array) -> ClipData:
        """The data of a clip without phases and reference poses."""
        phases = np.full(len(types), NO_PHASE, np.float32)
        reference = np.zeros((len(types), REFERENCE_COUNT), np.float32)
        return ClipData(features, contacts, ground, types, phases, reference)

    def cut(self, start: int, end: int) -> ClipData:
        """Frames start to end (exclusive)."""
        return ClipData(**{name: value[start:end] for name, value in vars(self).items()})

    def followed_by(self, other: ClipData) -> ClipData:
        """These frames, and those of another clip after them."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return ClipData(*map(np.concatenate, pairs))


class Dataset:
    """A dataset folder opened for reading; clips are loaded on demand."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        path = self.folder / MANIFEST
        if not path.exists():
            former = (
                ""
                if self.folder.exists()
                else "".join(f"; {p} is an older one" for p in set_aside(self.folder))
            )
            raise DatasetError(
                f"{self.folder}: not a dataset folder (no manifest.json); make one with preprocess{former}"
            )
        opened = _identity(path)
        self.manifest: dict[str, Any] = read_json(path, "the manifest of a dataset", DatasetError)
        if not isinstance(self.manifest, dict) or self.manifest.get("format") != FORMAT:
            found = self.manifest.get("format") if isinstance(self.manifest, dict) else None
            raise DatasetError(f"{path}: dataset format {str(found)[:40]!r}, expected {FORMAT}")
        check_manifest(path, self.manifest, Clip)
        self.manifest |= _names_composed(self.manifest)
        self.types: tuple[str, ...] = tuple(self.manifest["types"])
        self.fps: float = self.manifest["fps"]
        # Offsets (23, 3) in cm of every body; Clip.body is an index into them.
        self.bodies: tuple[Array, ...] = tuple(np.array(body, np.float32) for body in self.manifest["bodies"])
        # The manifest gives mirror images the bodies of their recordings.
        clips = [Clip(**values) for values in self.manifest["clips"]]
        self.clips = tuple(
            replace(clip, body=self._mirrored_body(clip.body)) if clip.mirrored else clip for clip in clips
        )
        self.layout: FeatureLayout = feature_layout(self.manifest["layout"])
        rows = max((clip.start + clip.frames for clip in self.clips), default=0)
        self._arrays = {name: open_array(self._path(name), name, rows) for name in ARRAYS}
        same_length(self.folder, self._arrays)
        if _identity(path) != opened:
            raise DatasetError(f"{self.folder}: was replaced while it was being opened; try again")
        # Features are ten times as large; they are checked as they are read.
        for name in ("contacts", "ground", "types", "phases"):
            most = len(self.types) - 1 if name == "types" else None
            check_range(self._path(name), name, self._arrays[name], most=most)

    def copy(self) -> Dataset:
        """The dataset with the same arrays, to which append adds without a change to this one."""
        made = copy.copy(self)
        made._arrays = dict(self._arrays)
        return made

    def append(
        self,
        types: Sequence[str],
        recordings: Sequence[ClipData],
        phase_seconds: Mapping[str, float],
        bodies: Sequence[int] | None = None,
    ) -> None:
        """Add types and training clips in memory; the folder does not change.

        Args:
            types: new names; their ids follow the dataset's own.
            recordings: the new clips; their reference poses are dropped.
            phase_seconds: seconds of a performance of each new type, 0 for a type without a phase.
            bodies: index into self.bodies for each recording; the canonical body by default.
        """
        self.types = (*self.types, *types)
        if bodies is None:
            bodies = [self._body(canonical_skeleton().offsets)] * len(recordings)
        start = len(self._arrays["types"])
        for number, (data, body) in enumerate(zip(recordings, bodies, strict=True)):
            name, frames = f"{self.types[int(data.types[0])]} {number}", len(data.types)
            clip = Clip(name, start, frames, "train", "", body)
            self.clips, start = (*self.clips, clip), start + frames
        for name, rows in self._arrays.items():
            added = np.concatenate([getattr(data, name) for data in recordings]).astype(rows.dtype)
            self._arrays[name] = np.concatenate([rows, added])
        seconds = {name: value for name, value in phase_seconds.items() if value}
        self.manifest = self.manifest | {
            "phase_seconds": self.phase_seconds | seconds,
            "phase_events": self.phase_events | dict.fromkeys(seconds, ""),
        }
        for name in ("sided_types", "mirrored_type_ids", "pose_embedding"):
            self.__dict__.pop(name, None)

    def image(self, clip: Clip) -> Clip:
        """The mirror image of a clip, on the mirrored body; of a mirror image, the recording."""
        name = clip.name.removesuffix(MIRRORED) if clip.mirrored else clip.name + MIRRORED
        return replace(clip, name=name, body=self._mirrored_body(clip.body), mirrored=not clip.mirrored)

    def _mirrored_body(self, body: int) -> int:
        """The index of the mirror image of a body, whose sides may have bones of other lengths."""
        return self._body(self.bodies[body][list(MIRROR_JOINTS)] * np.array([-1.0, 1.0, 1.0], np.float32))

    def _body(self, offsets: Array) -> int:
        """The index of a body with offsets (23, 3) in cm; adds the body if no clip has it."""
        apart = np.abs(np.stack(self.bodies) - offsets).max(axis=(1, 2))
        if apart.min() > SAME_BODY:
            self.bodies = (*self.bodies, offsets)
            return len(self.bodies) - 1
        return int(apart.argmin())

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.npy"

    def _features(self, start: int, end: int) -> Array:
        """Rows start to end (exclusive) of the features; raises DatasetError for values out of range."""
        rows = np.array(self._arrays["features"][start:end])
        check_range(self._path("features"), "features", rows, start)
        return rows

    @cached_property
    def scaling(self) -> Scaling:
        """Per-column scaling of the features, from the training clips."""
        return _scaling(self.manifest["feature_scaling"])

    @cached_property
    def trajectory_scaling(self) -> Scaling:
        """Per-column scaling of the trajectory values."""
        return _scaling(self.manifest["trajectory_scaling"])

    @cached_property
    def reference_rotations(self) -> Array:
        """Reference rotations (23, 4), which the exponential maps are relative to."""
        return np.array(self.manifest["references"], np.float32)

    @cached_property
    def pose_embedding(self) -> PoseEmbedding:
        """The pose embedding, fitted to training poses; rare types have more weight."""
        train = self.select("train")
        if not train:
            raise no_training_clips(self.folder)
        clips = [clip for clip in train if not clip.mirrored] or train
        rows = np.concatenate([np.arange(clip.start, clip.start + clip.frames) for clip in clips])
        rows = rows[:: 1 + len(rows) // EMBEDDING_FRAMES]
        types = self._arrays["types"][rows].astype(np.int64)
        weights = np.bincount(types).astype(np.float64)[types] ** -EMBEDDING_BALANCE
        features = self._arrays["features"][rows]
        check_range(self._path("features"), "features", features)
        return fit_pose_embedding(features, weights, self.layout)

    @cached_property
    def characters(self) -> dict[str, Array]:
        """Offsets (23, 3) in cm of each performer named in the labels."""
        return {name: np.array(body, np.float32) for name, body in self.manifest["characters"].items()}

    @cached_property
    def own_bodies(self) -> bool:
        """Whether performers keep their own bone lengths; otherwise all clips share one body."""
        body = canonical_skeleton().offsets
        return not all(np.allclose(offsets, body, atol=SAME_BODY) for offsets in self.bodies)

    @property
    def phase_seconds(self) -> dict[str, float]:
        """Mean duration of a performance in seconds, for each type with a phase."""
        return self.manifest["phase_seconds"]

    @property
    def phase_events(self) -> dict[str, str]:
        """For each type with a phase, what one cycle spans: "kick", "punch", "jump", or "" for a whole stretch."""
        return self.manifest.get("phase_events", dict.fromkeys(self.phase_seconds, ""))

    @cached_property
    def sided_types(self) -> Array:
        """Flags (N,): whether the first half of a type's phase is a left strike and the second a right one."""
        return np.array([self.phase_events.get(name) in SIDED for name in self.types], bool)

    def motion(self, clip: Clip, data: ClipData, body: Skeleton | None = None) -> Motion:
        """The motion of frames that read() returned, at the place where they were recorded, on a body if given."""
        return decode_motion(
            data.features,
            body or self.skeleton(clip),
            self.fps,
            data.ground[0],
            self.reference_rotations,
            self.layout.version,
        )

    def skeleton(self, clip: Clip) -> Skeleton:
        """The skeleton of a clip."""
        return canonical_skeleton(self.bodies[clip.body])

    @cached_property
    def mirrored_type_ids(self) -> Array:
        """Type ids (N,) of the mirror image of each type; of the type itself if the data lacks the other side."""
        names = self._image_types()
        return np.array(
            [self.types.index(n) if n in self.types else i for i, n in enumerate(names)], np.int64
        )

    @property
    def image_known(self) -> Array:
        """Flags (N,): whether the data has the type of each type's mirror image."""
        return np.array([name in self.types for name in self._image_types()], bool)

    def _image_types(self) -> list[str]:
        found = self.manifest.get("mirrored_types", {})
        return [found.get(name) or mirrored_type(name) for name in self.types]

    def select(self, split: str) -> list[Clip]:
        """The clips of a split, "train", "validation" or "test"."""
        return [clip for clip in self.clips if clip.split == split]

    def stretches(
        self, split: str | None = "train", kind: str | None = None
    ) -> Iterator[tuple[Clip, int, int, str]]:
        """Yield each stretch of one type in a split, or in all clips: clip, first frame, end frame (exclusive), type.

        kind leaves out the stretches of other types.
        """
        for clip in self.clips if split is None else self.select(split):
            for start, end, number in type_stretches(self.clip_types(clip)):
                if kind in (None, self.types[number]):
                    yield clip, start, end, self.types[number]

    def check_layout(self, layout: str, needing: str) -> None:
        """Raise DatasetError if the features have another layout; needing begins the reason in the message."""
        if self.layout.version != layout:
            raise DatasetError(
                f"{self.folder}: layout {self.layout.version}, but {needing} {layout}: run preprocess with "
                f"--layout {layout}"
            )

    def encoded_alike(self, references: Array) -> bool:
        """Whether reference rotations (23, 4) are those of the dataset; last digits differ between processors."""
        # A quaternion and its negative are the same rotation.
        turned = 1.0 - np.abs((self.reference_rotations * references).sum(-1))
        return float(turned.max()) <= 1e-4

    def digest(self, split: str = "train") -> str:
        """A hash of what training depends on: the files, frames and types of a split's clips, and how they are encoded.

        It has no computed numbers, whose last bits differ between processors; encoded_alike compares those.
        """
        files = {file["name"]: file for file in self.manifest.get("files", [])}
        smoothed = self.manifest.get("smoothed", False)
        facts = [self.types, self.layout.version, self.manifest["fps"], smoothed]
        # Earlier releases wrote neither levelled nor starts; what is usual leaves their hash as it was.
        facts += ["not levelled"] if smoothed and self.manifest.get("levelled") is False else []
        digest = hashlib.sha256(json.dumps(facts).encode())
        for clip in self.select(split):
            recording = clip.name.removesuffix(MIRRORED)  # a file, and the clip's number if it has several
            name, number = (recording, "0") if recording in files else recording.rpartition(":")[::2]
            file = files.get(name, {})
            first = {str(n): start for n, start in enumerate(file.get("starts", ()))}.get(number)
            own = [file.get("sha256", ""), clip.frames, clip.body, clip.mirrored, *([first] if first else [])]
            digest.update(json.dumps(own).encode())
            types = self._arrays["types"][clip.start : clip.start + clip.frames]
            digest.update(np.ascontiguousarray(types).tobytes())
        return digest.hexdigest()

    def clip_types(self, clip: Clip) -> Array:
        """Type ids (T,) of a clip without reading its features."""
        rows = slice(clip.start, clip.start + clip.frames)
        types = self._arrays["types"][rows].astype(np.int64)
        return self.mirrored_type_ids[types] if clip.mirrored else types

    def read(self, clip: Clip, start: int = 0, end: int | None = None) -> ClipData:
        """Frames start to end (exclusive) of a clip, mirrored if the clip is."""
        stop = clip.frames if end is None else min(end, clip.frames)
        rows = slice(clip.start + start, clip.start + stop)
        # Reference poses look ahead, beyond the last frame.
        beyond = clip.start + min(stop + REFERENCE_OFFSETS[-1], clip.frames)
        poses = self._features(rows.start, beyond)
        features = poses[: rows.stop - rows.start]
        contacts = self._arrays["contacts"][rows].astype(np.float32)
        ground = np.array(self._arrays["ground"][rows])
        types = self._arrays["types"][rows].astype(np.int64)
        phases = np.array(self._arrays["phases"][rows])
        none = np.zeros((len(features), REFERENCE_COUNT), np.float32)
        data = ClipData(features, contacts, ground, types, phases, none)
        if clip.mirrored:
            data = mirror_clip(data, self.layout, self.mirrored_type_ids, self.sided_types)
            columns, signs = self.layout.mirror_map()
            poses = poses[:, columns] * signs
        reference = reference_signal(self.pose_embedding.of(poses), np.arange(len(features)))
        return replace(data, reference=reference)


def no_training_clips(folder: Path) -> DatasetError:
    """The error for a dataset whose clips are all held out."""
    return DatasetError(
        f"{folder}: no training clips; the split column of labels.csv holds all of them out: mark some as train and "
        "run preprocess again"
    )


def mirror_clip(
    data: ClipData, layout: FeatureLayout, mirrored_type_ids: Array, sided_types: Array
) -> ClipData:
    """Mirror a clip, except for its reference poses.

    Features only change columns and signs, because the reference rotations are symmetric.
    """
    columns, signs = layout.mirror_map()
    ground = data.ground * np.array([-1.0, 1.0, -1.0], np.float32)
    return ClipData(
        data.features[:, columns] * signs,
        data.contacts[:, contact_mirror()],
        ground,
        mirrored_type_ids[data.types],
        mirror_phases(data.phases, sided_types[data.types]),
        data.reference,
    )


def _names_composed(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest's entries with names of types and characters, converted to NFC."""
    out: dict[str, Any] = {"types": [nfc(name) for name in manifest["types"]]}
    for key in ("phase_seconds", "phase_events", "characters"):
        if key in manifest:
            out[key] = {nfc(name): value for name, value in manifest[key].items()}
    opposites = manifest.get("mirrored_types", {})
    return out | {"mirrored_types": {nfc(name): nfc(other) for name, other in opposites.items()}}


def _identity(path: Path) -> tuple[int, ...]:
    """A key of a file that changes when the file is replaced."""
    try:
        facts = path.stat()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from None
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns


def _scaling(values: dict[str, list[float]]) -> Scaling:
    return Scaling(np.array(values["mean"], np.float32), np.array(values["std"], np.float32))
