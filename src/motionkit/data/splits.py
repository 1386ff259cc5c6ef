"""Divides clips into training, validation and test where the labels do not."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

from motionkit.data.first_pass import Prepared, Run

TEST_SHARE = 0.15  # share of a type's clips that are held out for the test
# Share of a type's files that are held out for validation, at least one; none if the type has fewer files than this.
VALIDATION_SHARE, VALIDATION_FILES = 0.1, 4
Taken = Callable[[Run, tuple[int, int]], bool]  # whether a run with its (file, run) is meant


def decide_splits(
    prepared: Sequence[Prepared], mirror: bool, mirror_types: Mapping[str, str], test: bool
) -> dict[tuple[int, int], str]:
    """Choose a split for each (file, run) without one.

    With `test`, some files of each type are held out whole for the test. The file of a type with no other file,
    not even one whose split the labels name, gets the split "mirror": its clips train and their mirror images test, or
    the reverse for about half of such types (paper section 3). If the mirror image belongs to another type, the file
    trains.
    """
    files = _files_of_types(prepared, lambda run, key: not run.split)
    every = _files_of_types(prepared, lambda run, key: True)
    trains = _training_files(prepared, lambda run, key: run.split in ("", "train"))
    held: set[int] = set()
    for kind in sorted(files) if test else ():
        order = sorted(files[kind], key=lambda i: hashed(f"{prepared[i].report.name}{files[kind][i][0][1]}"))
        count = max(1, round(TEST_SHARE * len(order))) if len(order) > 1 else 0
        _hold_out(order, count, held, trains)
    out: dict[tuple[int, int], str] = {}
    for kind in sorted(files):
        for i, keys in files[kind].items():
            out.update(dict.fromkeys(keys, "test" if i in held else "train"))
        if test and len(every[kind]) == 1:
            (keys,) = files[kind].values()
            kinds = {kind for i, r in keys for _, _, kind in prepared[i].runs[r].spans}
            same = all(mirror_types[kind] == kind for kind in kinds)
            out.update(dict.fromkeys(keys, "mirror" if mirror and same else "train"))
    return out


def _hold_out(order: Sequence[int], count: int, held: set[int], trains: Mapping[str, set[int]]) -> None:
    """Add files to the held-out ones, in order, until `count` of them are held; each type keeps a training file."""
    missing = count - len(held.intersection(order))
    for i in order:
        last = any(i in files and not files - held - {i} for files in trains.values())
        if missing > 0 and i not in held and not last:
            held.add(i)
            missing -= 1


def _training_files(prepared: Sequence[Prepared], taken: Taken) -> dict[str, set[int]]:
    """The files of each type, those included where it is only a short part of a run."""
    files: dict[str, set[int]] = defaultdict(set)
    for i, item in enumerate(prepared):
        for r, run in enumerate(item.runs):
            for _, _, kind in run.spans if taken(run, (i, r)) else ():
                files[kind].add(i)
    return files


def _files_of_types(
    prepared: Sequence[Prepared], taken: Taken
) -> dict[str, dict[int, list[tuple[int, int]]]]:
    """The (file, run) that are taken, by type and file: parts of one take are alike, so they stay together."""
    files: dict[str, dict[int, list[tuple[int, int]]]] = defaultdict(lambda: defaultdict(list))
    for i, item in enumerate(prepared):
        for r, run in enumerate(item.runs):
            if taken(run, (i, r)):
                files[run.main_type][i].append((i, r))
    return files


def hold_out_validation(prepared: Sequence[Prepared], splits: dict[tuple[int, int], str]) -> None:
    """Move some training clips of each type to validation, by changing splits.

    All training clips of a file move together, and each type keeps a training file. A hash of the names picks the
    files, so their order does not matter. If the labels name validation clips, nothing moves.
    """
    if any(run.split == "validation" for item in prepared for run in item.runs):
        return

    def taken(run: Run, key: tuple[int, int]) -> bool:
        return (run.split or splits[key]) == "train"

    files, trains = _files_of_types(prepared, taken), _training_files(prepared, taken)
    held: set[int] = set()
    for kind in sorted(files):
        if len(files[kind]) < VALIDATION_FILES:
            continue
        order = sorted(files[kind], key=lambda i: hashed(f"validation {kind} {prepared[i].report.name}"))
        _hold_out(order, max(1, round(VALIDATION_SHARE * len(order))), held, trains)
    for i, keys in ((i, keys) for each in files.values() for i, keys in each.items()):
        if i in held:
            splits.update(dict.fromkeys(keys, "validation"))


def hashed(text: str) -> bytes:
    """The SHA-256 of a text, which picks clips independently of their order."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).digest()
