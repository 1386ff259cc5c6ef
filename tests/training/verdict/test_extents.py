from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.metrics.body import Body, body_of
from motionkit.training.verdict.extents import MEASURES, Extent, extents_of, what_is_off
from synthetic_motions import make_walk

BY_NAME = {measure.does: measure for measure in MEASURES}


@pytest.mark.parametrize(
    ("does", "recorded", "within", "words"),
    [
        ("feet rise", (116, 134), {83: False, 95: True, 160: False}, "to 83 cm; in the clips to 116 to 134 cm"),
        ("it goes", (1.2, 1.2), {0.3: False, 1.0: True, 1.5: False}, "at 0.30 m/s; in the clips at 1.20 m/s"),
        ("feet sink", (0, 0), {9: False, 7: True}, "by 9 cm into the floor; in the clips by 0 cm into the floor"),
    ],
)  # fmt: skip
def test_values_are_compared_with_the_clips_and_told_in_words(
    does: str, recorded: tuple[float, float], within: dict[float, bool], words: str
) -> None:
    extent = Extent(BY_NAME[does], *recorded)
    assert {value: extent.excess(value) == 0.0 for value in within} == within
    assert extent.excess(float("nan")) == float("inf")
    assert extent.described(next(iter(within))) == f"{does} {words}"


def _raised(body: Body) -> Body:
    return replace(body, positions=body.positions + np.array([0.0, 40.0, 0.0], np.float32))


@pytest.mark.parametrize(
    ("spoilt", "off"),
    [
        (lambda walk: walk, {""}),
        (_raised, {"hands rise to", "hips rise to", "feet rise to", "hips sink to", "it is in the air for"}),
        (lambda walk: body_of(make_walk(300, speed=300.0)), {"it goes at 3.00 m/s"}),
    ],
)
def test_what_is_off_is_what_most_roll_outs_miss(spoilt, off: set[str]) -> None:
    walk = body_of(make_walk(300))
    said = what_is_off(extents_of([walk, walk.cut(60, 300)]), [walk, spoilt(walk), spoilt(walk)])
    assert any(said.startswith(words) for words in off) and bool(said) == (off != {""})
