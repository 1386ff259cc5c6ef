"""BVH files with faults that do not hide what was meant are read, and a note says what was settled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import BvhError
from motionkit.motion.bvh import BvhFile, read_bvh
from motionkit.reading import reading

FRAME = "Frame Time: 0.008333333\n"


def without_rows(text: str) -> str:
    return text[: text.index(FRAME) + len(FRAME)]


def with_values(text: str, change: Callable[[np.ndarray], list[str]]) -> str:
    head = without_rows(text)
    return (
        head
        + "\n".join(change(np.array([row.split() for row in text[len(head) :].split("\n") if row])))
        + "\n"
    )


def spoilt(word: str, beside: str = "") -> Callable[[str], str]:
    """The second frame's root height is no number; its neighbours say 90.0 and 90.2. So is perhaps the x beside it."""

    def change(values: np.ndarray) -> list[str]:
        values = values.astype("U16")
        values[1, 1] = word
        values[1, 0] = beside or values[1, 0]
        return [" ".join(row) for row in values]

    return lambda text: with_values(text, change)


SPINE = "\t\tCHANNELS 3 Zrotation Yrotation Xrotation"
OTHER = "ROOT Other\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n}\nMOTION"
# What is done to a good file of three frames, the note, and how many frames are read.
SETTLED = {
    "more rows": (lambda text: text.replace("Frames: 3", "Frames: 2"), "3 frames instead of the declared 2", 3),
    "fewer rows": (lambda text: text.replace("Frames: 3", "Frames: 9"), "3 frames instead of the declared 9", 3),
    "last row cut": (lambda text: text.rstrip().rsplit(" ", 3)[0], "1 cut frame at the end left out", 2),
    "nan": (spoilt("nan"), "1 value without a number filled from neighbouring frames", 3),
    "ind": (spoilt("-1.#IND00"), "1 value without a number filled from neighbouring frames", 3),
    "both infinities": (spoilt("inf", "-inf"), "2 values without a number filled from neighbouring frames", 3),
    "decimal commas": (
        lambda text: with_values(text, lambda v: [" ".join(row).replace(".", ",") for row in v]),
        "36 numbers with a decimal comma",
        3,
    ),
    "comments": (lambda text: "# exported\n" + text.replace(FRAME, FRAME + "// rows\n"), "2 comment lines left out", 3),
    "wrapped": (
        lambda text: with_values(text, lambda v: [" ".join(part) for row in v for part in (row[:5], row[5:])]),
        "3 frames put together from 6 lines",
        3,
    ),
    "no frames": (lambda text: without_rows(text).replace("Frames: 3", "Frames: 0"), "1 frame of the rest pose", 1),
    "no motion": (lambda text: text[: text.index("MOTION")], "1 frame of the rest pose", 1),
    "zero declared": (lambda text: text.replace("Frames: 3", "Frames: 0"), "3 frames instead of the declared 0", 3),
    "scale": (
        lambda text: with_values(
            text.replace(SPINE, SPINE.replace("3", "6") + " Xscale Yscale Zscale", 1),
            lambda v: [" ".join([*row[:9], "1", "1", "1", *row[9:]]) for row in v],
        ),
        "3 scale channels left out",
        3,
    ),
    "six numbers": (
        lambda text: text.replace("OFFSET 0.0 0.0 0.0", "OFFSET 0.0 0.0 0.0 0.0 9.0 0.0", 1),
        "1 OFFSET of six numbers cut to the first three",
        3,
    ),
    "second root": (
        lambda text: with_values(text.replace("MOTION", OTHER), lambda v: [" ".join([*row, "45"]) for row in v]),
        "1 joint of the other root Other left out",
        3,
    ),
}  # fmt: skip


def read_noting(path: Path) -> tuple[BvhFile, list[str]]:
    heard: list[str] = []
    with reading(on_note=heard.append):
        return read_bvh(path), heard


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("kind", SETTLED)
def test_settled_and_noted_or_refused(tmp_path: Path, broken_folder: Path, good_text: str, kind: str) -> None:
    change, note, frames = SETTLED[kind]
    good, path = read_bvh(broken_folder / "good.bvh"), tmp_path / "clip.bvh"
    path.write_text(change(good_text))
    bvh, heard = read_noting(path)
    assert len(heard) == 1 and heard[0].startswith("clip.bvh: read with ") and note in heard[0]
    assert len(bvh.values) == frames and bvh.channels == good.channels
    assert bvh.skeleton.names == good.skeleton.names
    if kind not in ("no frames", "no motion"):
        np.testing.assert_allclose(bvh.values, good.values[:frames], atol=1e-9)
    else:
        assert not bvh.values.any()
    hierarchy = bvh.hierarchy
    assert hierarchy is None or hierarchy.split() == good.hierarchy.split()
    with pytest.raises(BvhError), reading(strict=True):
        read_bvh(path)


def test_what_is_filled(tmp_path: Path, good_text: str) -> None:
    """Angles take the shorter way round, a channel without a number is zero, and a file without numbers is refused."""
    path = tmp_path / "clip.bvh"

    def written(*columns: list[str]) -> None:
        rows = np.array(columns, "U9").T
        rest = [["0"] * (12 - len(columns))] * 3
        path.write_text(
            with_values(good_text, lambda v: [" ".join([*a, *b]) for a, b in zip(rows, rest, strict=True)])
        )

    written(["0", "nan", "4"], ["nan"] * 3, ["1"] * 3, ["170", "nan", "-170"])
    bvh, heard = read_noting(path)
    assert bvh.values[:, 0].tolist() == [0, 2, 4] and not bvh.values[:, 1].any()
    assert abs(bvh.values[1, 3]) == pytest.approx(180)
    assert "2 values without a number" in heard[0] and "1 channel without any number set to zero" in heard[0]
    written(*[["nan"] * 3] * 7)
    with pytest.raises(BvhError, match="value 1 of frame 0 is nan"):
        read_noting(path)


def test_places_in_the_world_are_refused(tmp_path: Path, good_text: str) -> None:
    """Position channels of a segment that hold its place in the world would tear the body apart."""
    six = "CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation"
    text = good_text.replace(SPINE.strip(), six, 1)
    rows = {
        at: [" ".join([*"000", *"000", *at, *"000000"])] * 3 for at in (("0", "9", "1"), ("300", "99", "1"))
    }
    path = tmp_path / "clip.bvh"
    for at, block in rows.items():
        block = [f"301 90 0 {row.split(' ', 3)[3]}" for row in block]
        path.write_text(without_rows(text) + "\n".join(block) + "\n")
        if at[0] == "0":
            assert len(read_bvh(path).values) == 3
        else:
            with pytest.raises(BvhError, match="position channels of Spine hold places in the world"):
                read_bvh(path)
