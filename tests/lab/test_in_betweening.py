"""The protocol of LaFAN1 on files of its rig: who is tested, and what fills the gaps."""

from __future__ import annotations

from pathlib import Path

import pytest

import motionkit as mk
from motionkit.errors import MotionkitError
from motionkit.lab.in_betweening import in_between, performers
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import write_bvh
from motionkit.motion.motion import resample
from motionkit.rig.to_rig import to_rig
from synthetic_motions import make_walk


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk of two performers, in the names and the rig of LaFAN1."""
    made = tmp_path_factory.mktemp("lafan1")
    motion = resample(to_rig(make_walk(220), mk.read_rig("@lafan1")), 30.0)
    for name in ("walk1_subject1", "walk2_subject5"):
        write_bvh(made / f"{name}.bvh", motion)
    return made


def test_the_fifth_performer_is_tested(folder: Path, tmp_path: Path) -> None:
    training, test = performers(folder)
    assert [[path.stem for path in each] for each in (training, test)] == [
        ["walk1_subject1"],
        ["walk2_subject5"],
    ]
    with pytest.raises(MotionkitError, match=r"walk1_subject1\.bvh"):
        performers(tmp_path)


def test_every_way_fills_every_gap(
    folder: Path, tiny_model: MotionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.lab.in_betweening.GAPS", (5, 15))
    rows = list(in_between(folder, tiny_model, tiny_model.type_names[0], most=1))
    ways = ["zero velocity", "interpolation", "recording, mapped there and back", "model"]
    assert [(gap, way, count) for gap, way, count, _ in rows] == [(g, w, 1) for g in (5, 15) for w in ways]
    found = {(gap, way): [value.value for value in values] for gap, way, _, values in rows}
    for gap in (5, 15):
        assert found[gap, "recording, mapped there and back"] == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
        assert found[gap, "zero velocity"][1] > found[gap, "interpolation"][1] > 0.01  # L2Q
        assert 0.01 < found[gap, "model"][1] < 5.0
