"""Divides clips into training, validation and test where the labels do not."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence

from motionkit.data.first_pass import Prepared

TEST_SHARE = 0.15  # share of a type's clips that are held out for the test
# Share of a type's files that are held out for validation, at least one; none if the type has fewer files than this.
VALIDATION_SHARE, VALIDATION_FILES = 0.1, 4


def decide_splits(
    prepared: Sequence[Prepared], mirror: bool, mirror_types: Mapping[str, str], test: bool
) -> dict[tuple[int, int], str]:
    """Choose a split for each (file, run) without one.

    With `test`, some clips of each type are held out for the test. A type's single clip gets the split "mirror": the
    clip trains and its mirror image tests, or the reverse for about half of such clips (paper section 3). If the
    mirror image belongs to another type, the single clip trains.
    """
    open_runs: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for i, item in enumerate(prepared):
        for r, run in enumerate(item.runs):
            if not run.split:
                open_runs[run.main_type].append((i, r))
    out: dict[tuple[int, int], str] = {}
    if not test:
        return {key: "train" for keys in open_runs.values() for key in keys}
    for kind in sorted(open_runs):
        keys = sorted(open_runs[kind], key=lambda k: hashed(f"{prepared[k[0]].report.name}{k[1]}"))
        if len(keys) == 1:
            i, r = keys[0]
            same = all(mirror_types[kind] == kind for _, _, kind in prepared[i].runs[r].spans)
            out[keys[0]] = "mirror" if mirror and same else "train"
            continue
        count = max(1, round(TEST_SHARE * len(keys)))
        out.update({key: "test" if n < count else "train" for n, key in enumerate(keys)})
    return out


def hold_out_validation(prepared: Sequence[Prepared], splits: dict[tuple[int, int], str]) -> None:
    """Move some training clips of each type to validation, by changing splits.

    All training clips of a type in one file move together, because parts of one take are alike. A hash of the names
    picks the files, so their order and other types do not matter. If the labels name validation clips, nothing moves.
    """
    if any(run.split == "validation" for item in prepared for run in item.runs):
        return
    files: dict[str, dict[int, list[tuple[int, int]]]] = defaultdict(lambda: defaultdict(list))
    for i, item in enumerate(prepared):
        for r, run in enumerate(item.runs):
            if (run.split or splits[i, r]) == "train":
                files[run.main_type][i].append((i, r))
    for kind in sorted(files):
        if len(files[kind]) < VALIDATION_FILES:
            continue
        order = sorted(files[kind], key=lambda i: hashed(f"validation {kind} {prepared[i].report.name}"))
        for i in order[: max(1, round(VALIDATION_SHARE * len(order)))]:
            splits.update(dict.fromkeys(files[kind][i], "validation"))


def hashed(text: str) -> bytes:
    """The SHA-256 of a text, which picks clips independently of their order."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).digest()
