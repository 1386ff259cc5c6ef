"""Divides clips into training, validation and test where the labels do not."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

from motionkit.data.first_pass import Prepared, Run

TEST_SHARE = 0.15  # share of a type's clips that are held out for the test
# Share of a type's files that are held out for validation, at least one; none if the type has fewer files than this.
VALIDATION_SHARE, VALIDATION_FILES = 0.1, 4


def decide_splits(
    prepared: Sequence[Prepared], mirror: bool, mirror_types: Mapping[str, str], test: bool
) -> dict[tuple[int, int], str]:
    """Choose a split for each (file, run) without one.

    With `test`, the runs of some files of each type are held out for the test. The file of a type with no other file,
    not even one whose split the labels name, gets the split "mirror": its clips train and their mirror images test, or
    the reverse for about half of such types (paper section 3). If the mirror image belongs to another type, the file
    trains.
    """
    files = _files_of_types(prepared, lambda run, key: not run.split)
    every = _files_of_types(prepared, lambda run, key: True)
    out: dict[tuple[int, int], str] = {}
    for kind in sorted(files):
        order = sorted(files[kind], key=lambda i: hashed(f"{prepared[i].report.name}{files[kind][i][0][1]}"))
        count = max(1, round(TEST_SHARE * len(order))) if test and len(order) > 1 else 0
        for n, i in enumerate(order):
            out.update(dict.fromkeys(files[kind][i], "test" if n < count else "train"))
        if test and len(every[kind]) == 1:
            keys = files[kind][order[0]]
            kinds = {kind for i, r in keys for _, _, kind in prepared[i].runs[r].spans}
            same = all(mirror_types[kind] == kind for kind in kinds)
            out.update(dict.fromkeys(keys, "mirror" if mirror and same else "train"))
    return out


def _files_of_types(
    prepared: Sequence[Prepared], taken: Callable[[Run, tuple[int, int]], bool]
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

    All training clips of a type in one file move together. A hash of the names picks the files, so their order and
    other types do not matter. If the labels name validation clips, nothing moves.
    """
    if any(run.split == "validation" for item in prepared for run in item.runs):
        return
    files = _files_of_types(prepared, lambda run, key: (run.split or splits[key]) == "train")
    for kind in sorted(files):
        if len(files[kind]) < VALIDATION_FILES:
            continue
        order = sorted(files[kind], key=lambda i: hashed(f"validation {kind} {prepared[i].report.name}"))
        for i in order[: max(1, round(VALIDATION_SHARE * len(order)))]:
            splits.update(dict.fromkeys(files[kind][i], "validation"))


def hashed(text: str) -> bytes:
    """The SHA-256 of a text, which picks clips independently of their order."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).digest()
