"""The data sets of the experiments, defined here once: which clips of a dataset folder train and which test.

The paper's D_L has 39 training and 9 test sequences with its first 15 motion types. Of these the free data has 13:
there is no second whirlwind kick and no Chinese classical dance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from motionkit.data.dataset import Clip, Dataset
from motionkit.errors import DatasetError
from motionkit.files import read_json
from motionkit.names import counted

PAPER_TYPES = (
    "idle", "walking", "running", "jumping-l", "jumping-r", "jumping-b", "b-walking", "kicking", "punching",
    "w-kicking", "side-somersault", "twist", "cartwheel",
)  # fmt: skip
TRAIN_PER_TYPE = 3  # 3 x 13 types: the paper's 39 sequences
LEAST_TEST = 60  # frames of a test sequence: 30 to begin with, and as many to compare
USER_SETS = "sets"  # folder of a dataset folder with data sets that users define
LOCOMOTION = ("idle", "walking", "running", "b-walking", "duck", "jumping-b")  # what PFNN was made for
PFNN_TESTS = 5  # sequences held out in the paper's comparison with PFNN


@dataclass(frozen=True)
class Selection:
    """A data set: its name, what it is, and the choice of its clips."""

    name: str
    text: str
    choose: Callable[[Dataset], tuple[list[Clip], list[Clip]]]


def select(folder: Path, name: str) -> Dataset:
    """Open a dataset folder with the clips of a data set only; all but "all-mirrored" train without mirror images.

    Raises:
        DatasetError: if the data set is unknown, or has no training or test clips here.
    """
    dataset = Dataset(folder)
    if name in SELECTIONS and (folder / USER_SETS / f"{name}.json").exists():
        raise DatasetError(
            f"{folder / USER_SETS / name}.json: {name} is a data set of motionkit; give it another name"
        )
    train, test = (SELECTIONS.get(name) or user_selection(folder, name)).choose(dataset)
    if not train or not test:
        expected = f"test clips have at least {LEAST_TEST} frames"
        if name == "D_L":
            expected = f"its types are {', '.join(PAPER_TYPES)}; the data set all takes any"
        raise DatasetError(
            f"{folder}: no {'test' if train else 'training'} clips for the data set {name}: {expected}"
        )
    dataset.clips = tuple(
        [replace(c, split="train") for c in train] + [replace(c, split="test") for c in test]
    )
    return dataset


def described(dataset: Dataset, name: str) -> str:
    """Say in words what a data set trains on; the dataset is one of select."""
    clips = dataset.select("train")
    kinds = {kind for clip in clips for kind in frames_of(dataset, clip)}
    mirrored = sum(clip.mirrored for clip in clips)
    text = "" if name in SELECTIONS else f"{user_selection(dataset.folder, name).text}: "
    images = f" and {counted(mirrored, 'mirror image')}" if mirrored else ""
    many = counted(len(clips) - mirrored, "training sequence")
    return (
        f"{text}{many}{images} of {counted(len(kinds), 'type')} of the folder {dataset.folder.resolve().name}"
    )


def user_selection(folder: Path, name: str) -> Selection:
    """Return a data set that a user has defined: NAME.json in the folder sets of a dataset folder.

    Its fields, all optional, are "text"; "types", the only ones of its clips; "test", patterns of the names of its test
    clips in place of the dataset's own; and "mirrored", whether mirror images train too.

    Raises:
        DatasetError: there is no such file, or it holds something else.
    """
    files = folder / USER_SETS
    known = [*SELECTIONS, *sorted(path.stem for path in files.glob("*.json"))]
    if name not in known:
        raise DatasetError(
            f"unknown data set {name!r:.60}, expected one of {', '.join(known)}, or {files}/NAME.json"
        )
    path = files / f"{name}.json"
    found = read_json(path, "a data set", DatasetError)
    fields = {"text": str, "types": list, "test": list, "mirrored": bool}
    if not isinstance(found, dict) or not all(isinstance(found[key], fields.get(key, ())) for key in found):
        raise DatasetError(
            f'{path}: expected {{"text": "...", "types": [...], "test": [...], "mirrored": true}}'
        )

    def choose(dataset: Dataset) -> tuple[list[Clip], list[Clip]]:
        train, test = (_plain(dataset, split) for split in ("train", "test"))
        unknown = [kind for kind in found.get("types", []) if kind not in dataset.types]
        if unknown:
            raise DatasetError(
                f"{path}: unknown type {unknown[0]!r:.60}, expected some of {', '.join(dataset.types)}"
            )
        if "test" in found:
            whole = [*train, *test]
            matching = [[clip for clip in whole if fnmatch(clip.name, str(p))] for p in found["test"]]
            for pattern, clips in zip(found["test"], matching, strict=True):
                if not clips:
                    raise DatasetError(
                        f"{path}: no clip matches {pattern!r:.60}; a name is, for example, {whole[0].name}"
                    )
            test = [clip for clip in whole if any(clip in clips for clips in matching)]
            train = [clip for clip in whole if clip not in test]
        if "types" in found:
            train, test = (_only(dataset, clips, found["types"].__contains__) for clips in (train, test))
        if found.get("mirrored"):
            train += _images(dataset, train)
        return train, _long(test)

    return Selection(name, found.get("text", "a data set of one's own"), choose)


def frames_of(dataset: Dataset, clip: Clip) -> dict[str, int]:
    """Return the number of frames of each type in a clip."""
    ids, counts = np.unique(dataset.clip_types(clip), return_counts=True)
    return {dataset.types[i]: int(n) for i, n in zip(ids, counts, strict=True)}


def _plain(dataset: Dataset, split: str) -> list[Clip]:
    """Clips of a split without mirror images; a recording trains if its image does, where a type has one recording."""
    trained = {clip.start for clip in dataset.select("train")}
    plain = [clip for clip in dataset.clips if not clip.mirrored]
    if split == "train":
        return [clip for clip in plain if clip.start in trained]
    return [clip for clip in plain if clip.split == split and clip.start not in trained]


def _only(dataset: Dataset, clips: list[Clip], allowed: Callable[[str], bool]) -> list[Clip]:
    return [clip for clip in clips if all(allowed(kind) for kind in frames_of(dataset, clip))]


def _long(clips: list[Clip]) -> list[Clip]:
    return [clip for clip in clips if clip.frames >= LEAST_TEST]


def _images(dataset: Dataset, clips: list[Clip]) -> list[Clip]:
    """The mirror images of clips, except where the data lacks the type of the other side: they would have no label."""
    known = dataset.image_known
    return [dataset.image(clip) for clip in clips if known[dataset.clip_types(clip)].all()]


def _with_mirrors(dataset: Dataset, train: list[Clip], test: list[Clip], types: set[str]) -> list[Clip]:
    """Test clips with, for each type they lack, the longest mirror image of a training clip (paper section 3)."""
    tested = {kind for clip in test for kind in frames_of(dataset, clip)}
    out = list(test)
    images = _images(dataset, _long(train))
    for kind in sorted(types - tested):
        having = [clip for clip in images if kind in frames_of(dataset, clip)]
        if having:
            out.append(max(having, key=lambda clip: frames_of(dataset, clip)[kind]))
    return out


def _of_types(dataset: Dataset, allowed: Callable[[str], bool]) -> tuple[list[Clip], list[Clip]]:
    """Training and long enough test clips that show allowed types only."""
    train, test = (_only(dataset, _plain(dataset, split), allowed) for split in ("train", "test"))
    return train, _long(test)


def _d_l(dataset: Dataset) -> tuple[list[Clip], list[Clip]]:
    """Per type the three training clips that show most of it, those with transitions first; test clips of all types."""
    pool, tests = _of_types(dataset, PAPER_TYPES.__contains__)
    train: list[Clip] = []
    for kind in PAPER_TYPES:
        having = [clip for clip in pool if kind in frames_of(dataset, clip) and clip not in train]
        having.sort(
            key=lambda clip: (-len(frames_of(dataset, clip)), -frames_of(dataset, clip)[kind], clip.name)
        )
        train += having[:TRAIN_PER_TYPE]
    # Some types have fewer than three clips: the longest of the others fill up.
    rest = sorted((clip for clip in pool if clip not in train), key=lambda clip: (-clip.frames, clip.name))
    train += rest[: TRAIN_PER_TYPE * len(PAPER_TYPES) - len(train)]
    return train, _covering(dataset, _with_mirrors(dataset, train, tests, set(PAPER_TYPES)))


def _covering(dataset: Dataset, clips: list[Clip]) -> list[Clip]:
    """Choose clips until every type is shown, each time the clip with the most types that are still missing."""
    missing = {kind for clip in clips for kind in frames_of(dataset, clip)}
    out: list[Clip] = []
    while missing:
        best = max(
            clips, key=lambda c: (len(missing & set(frames_of(dataset, c))), min(c.frames, 600), c.name)
        )
        out.append(best)
        missing -= set(frames_of(dataset, best))
    return out


def _all(dataset: Dataset) -> tuple[list[Clip], list[Clip]]:
    train, tests = _of_types(dataset, dataset.types.__contains__)
    return train, _with_mirrors(dataset, train, tests, set(dataset.types))


def _all_mirrored(dataset: Dataset) -> tuple[list[Clip], list[Clip]]:
    """As _all, and the mirror images of training clips but those that are tested on, or whose original is."""
    train, test = _all(dataset)
    tested = {(clip.start, clip.frames) for clip in test}
    return [*train, *_images(dataset, [c for c in train if (c.start, c.frames) not in tested])], test


def is_dance(kind: str) -> bool:
    """Return whether a dataset labels motion of this type as a dance: dance-salsa, Tango dancing, breakdance."""
    return "danc" in kind.lower()


def _no_dances(dataset: Dataset) -> tuple[list[Clip], list[Clip]]:
    types = {kind for kind in dataset.types if not is_dance(kind)}
    train, tests = _of_types(dataset, types.__contains__)
    return train, _with_mirrors(dataset, train, tests, types)


def _locomotion(dataset: Dataset) -> tuple[list[Clip], list[Clip]]:
    train, tests = _of_types(dataset, LOCOMOTION.__contains__)
    return train, sorted(tests, key=lambda clip: (-min(clip.frames, 600), clip.name))[:PFNN_TESTS]


SELECTIONS = {
    each.name: each
    for each in (
        Selection("D_L", "39 training sequences of 13 types, and test sequences of all of them", _d_l),
        Selection("all", "all training and test sequences", _all),
        Selection(
            "all-mirrored",
            "all training sequences and their mirror images, and all test sequences",
            _all_mirrored,
        ),
        Selection("no-dances", "all sequences without dances", _no_dances),
        Selection(
            "locomotion",
            "gaits alone and five test sequences, as the paper's comparison with PFNN",
            _locomotion,
        ),
    )
}
