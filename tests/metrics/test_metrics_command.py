from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from motionkit.cli.main import main
from motionkit.cli.metrics import command
from motionkit.motion.bvh import motion_to_bvh, read_bvh, write_bvh
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton
from motionkit.rig.canonical import load_canonical

from .conftest import swaying


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    paths = str(tmp_path / "truth.bvh"), str(tmp_path / "made.bvh")
    write_bvh(paths[0], swaying(frames=90))
    write_bvh(paths[1], swaying(frames=70, seed=3))
    return paths


def test_table_of_a_pair(files: tuple[str, str]) -> None:
    result = CliRunner().invoke(command, list(files))
    assert result.exit_code == 0
    for word in ("ground truth", "generated", "ratio", "bm-euler", "ssim-window", "mpjpe", "path-coverage"):
        assert word in result.output
    assert "ground truth has 90 frames, generated 70; compared over the first 70" in result.output
    assert "afs: foot_height_cm 10.85, toe_height_cm 1.55" in result.output


def test_one_file_gives_what_one_can(files: tuple[str, str]) -> None:
    result = CliRunner().invoke(command, [files[0]])
    assert result.exit_code == 0
    assert (
        "bm-geodesic" in result.output and "ssim" not in result.output and "ground truth" not in result.output
    )


def test_json(files: tuple[str, str]) -> None:
    result = CliRunner().invoke(command, [*files, "--json", "--toe-height", "2", "--floor", "1.5"])
    out = json.loads(result.stdout)
    rows = {row["id"]: row for row in out["metrics"]}
    assert out["frames"] == 70 and out["generated"] == files[1]
    assert rows["afs"]["parameters"] == {"foot_height_cm": 10.85, "toe_height_cm": 2.0, "floor_cm": 1.5}
    assert rows["ssim-channel"]["ground_truth"] == 1.0


def test_the_file_against_itself(files: tuple[str, str]) -> None:
    out = json.loads(CliRunner().invoke(command, [files[0], files[0], "--json"]).stdout)
    rows = {row["id"]: row["value"] for row in out["metrics"]}
    assert rows["ssim-window"] == pytest.approx(1.0) and rows["mpjpe"] == 0.0 and rows["path-mean"] == 0.0


def test_rate_and_scale_can_be_overridden(files: tuple[str, str]) -> None:
    out = json.loads(CliRunner().invoke(command, [files[0], "--fps", "120", "--json"]).stdout)
    assert out["frames"] == 45
    result = CliRunner().invoke(command, [files[0], "--scale", "0.1"])
    assert "legs of 8.34 cm; give the right scale" in result.output


@pytest.mark.parametrize(
    ("factor", "unit"), [(0.01, "metres"), (10.0, "millimetres"), (0.45 / 2.54, "CMU units")]
)
def test_the_unit_of_a_file_of_the_23_joints_is_detected(tmp_path: Path, factor: float, unit: str) -> None:
    rows = {}
    for name, scale in (("cm", 1.0), ("other", factor)):
        write_bvh(tmp_path / f"{name}.bvh", swaying(frames=30), scale)
        out = json.loads(CliRunner().invoke(command, [str(tmp_path / f"{name}.bvh"), "--json"]).stdout)
        rows[name] = {row["id"]: row["value"] for row in out["metrics"]}
    assert f"other.bvh: 1 unit = {1 / factor:.4g} cm (detected from leg length: {unit})" in out["notes"]
    for name in ("afs", "jerk", "floor-height"):
        assert rows["other"][name] == pytest.approx(rows["cm"][name], rel=1e-2, abs=1e-2)


def test_notes_on_two_files_of_one_name_can_be_told_apart(tmp_path: Path) -> None:
    for number, folder in enumerate(("truth", "made")):
        write_bvh(tmp_path / folder / "x.bvh", swaying(frames=30), 0.01 + 0.09 * number)
    out = (
        CliRunner().invoke(command, [str(tmp_path / folder / "x.bvh") for folder in ("truth", "made")]).output
    )
    assert "note: ground truth: 1 unit = 100 cm" in out and "note: generated motion: 1 unit = 10 cm" in out


@pytest.mark.parametrize(
    "arguments",
    [
        ["--align-start"],
        ["--generated-fps", "30"],
        ["--toe-height", "0"],
        ["--skate-speed", "nan"],
        ["--floor", "inf"],
        ["--skip", "-1"],
        ["--given", "87"],
    ],
)
def test_wrong_usage_exits_with_2(files: tuple[str, str], arguments: list[str]) -> None:
    assert CliRunner().invoke(command, [files[0], *arguments]).exit_code == 2


def test_faults_are_one_line_without_a_traceback(
    files: tuple[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bad = tmp_path / "bad.bvh"
    bad.write_text("HIERARCHY\nROOT Hips\n{\n")
    for arguments, code, text in (
        ((files[0], str(bad)), 1, "bad.bvh:"),
        ((files[0], files[1], "--skip", "70"), 1, "to measure, found"),
        ((files[0], str(tmp_path / "none.bvh")), 2, "does not exist"),
        ((files[0], str(tmp_path)), 2, "both be files or both be folders"),
    ):
        monkeypatch.setattr(sys, "argv", ["motionkit", "metrics", *arguments])
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        assert stopped.value.code == code and text in err and out == ""
        if code == 1:
            assert len(err.strip().splitlines()) == 1


def test_help_comes_without_torch() -> None:
    look = "import sys, motionkit.cli.metrics; sys.exit('torch' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", look], timeout=60).returncode == 0


def test_a_file_of_the_23_joints_keeps_its_proportions(files: tuple[str, str]) -> None:
    motion, notes = load_canonical(files[0])
    assert motion.skeleton.names == JOINT_NAMES and notes == []
    assert motion.skeleton.offsets == pytest.approx(swaying().skeleton.offsets, abs=1e-5)
    assert load_canonical(files[0], scale=2.0)[0].root_positions[0, 1] == pytest.approx(184.0, abs=1e-3)


def test_joints_in_another_order_are_sorted(tmp_path: Path) -> None:
    motion = swaying(frames=20)
    skeleton = motion.skeleton
    order = [0, *range(9, 23), *range(1, 9)]  # the spine before the legs
    place = {old: new for new, old in enumerate(order)}
    other = Skeleton(
        tuple(skeleton.names[j] for j in order),
        tuple(place.get(skeleton.parents[j], -1) for j in order),
        skeleton.offsets[order],
        {place[j]: end for j, end in skeleton.end_sites.items()},
    )
    path = tmp_path / "sorted.bvh"
    shuffled = type(motion)(other, motion.local_rotations[:, order], motion.root_positions, 60.0)
    write_bvh(path, motion_to_bvh(shuffled))
    assert read_bvh(path).skeleton.names[1] == "LowerBack"
    read, _ = load_canonical(path)
    assert read.skeleton.names == JOINT_NAMES and read.skeleton.same_hierarchy(skeleton)
    dots = np.abs((read.local_rotations.astype(np.float64) * motion.local_rotations).sum(-1))
    assert float(dots.min()) > 1 - 1e-6


def test_another_rig_is_mapped_and_said(files: tuple[str, str], tmp_path: Path) -> None:
    motion = swaying(frames=90)
    skeleton = motion.skeleton
    thumb = Skeleton(
        (*skeleton.names, "RThumb"),
        (*skeleton.parents, skeleton.index("RightHand")),
        np.concatenate([skeleton.offsets, np.array([[-3.0, 0.0, 3.0]], np.float32)]),
        skeleton.end_sites,
    )
    rotations = np.concatenate([motion.local_rotations, quat_identity((90, 1), np.float64)], axis=1)
    path = str(tmp_path / "thumb.bvh")
    write_bvh(path, type(motion)(thumb, rotations, motion.root_positions, 60.0))
    result = CliRunner().invoke(command, [files[0], path, "--json"])
    out = json.loads(result.stdout)
    assert "23 joints found by name" in out["taken"][1]
    rows = {row["id"]: row["value"] for row in out["metrics"]}
    assert rows["mpjpe"] == pytest.approx(0.0, abs=0.05)
    assert rows["ssim-window"] == pytest.approx(1.0, abs=1e-3)


def test_a_page_of_both_files(
    files: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(command, [*files, "--view", "--json"])
    assert result.exit_code == 0 and json.loads(result.stdout)["view"] == "truth-made.html"
    page = (tmp_path / "truth-made.html").read_text("utf-8")
    assert '"name":"truth ground truth"' in page and '"name":"made generated"' in page
