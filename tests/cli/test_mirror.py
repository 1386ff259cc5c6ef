"""The mirror command: files, folders, exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from motionkit.cli.main import main
from motionkit.export.formats import read_motion, write_motion
from motionkit.motion.bvh import read_bvh
from synthetic_motions import make_walk

BROKEN = Path(__file__).parents[1] / "broken_bvh"

RIG = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT lLeg
  {
    OFFSET 10 -5 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 -80 0
    }
  }
  JOINT rLeg
  {
    OFFSET -10 -5 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 -80 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.05
1 90 3 4 5 6 7 8 9 10 11 12
2 91 4 5 6 7 8 9 10 11 12 13
"""


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the command as the console script does, and return its exit code."""
    monkeypatch.setattr(sys, "argv", ["motionkit", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_the_output_may_be_an_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip, made, other = (tmp_path / name for name in ("a.bvh", "b.bvh", "c.bvh"))
    clip.write_text(RIG)
    assert run(monkeypatch, "mirror", clip, "-o", made) == run(monkeypatch, "mirror", clip, other) == 0
    assert made.read_bytes() == other.read_bytes()
    assert run(monkeypatch, "mirror", clip, made, "-o", other) == 2
    assert "one place to write to" in capsys.readouterr().err
    assert run(monkeypatch, "mirror", clip, "-", "--json") == 2
    said = capsys.readouterr()
    assert "--json cannot be combined with standard output" in said.err and not said.out


def test_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = tmp_path / "in.bvh", tmp_path / "out.bvh"
    source.write_text(RIG)
    assert run(monkeypatch, "mirror", source, target, "--json") == 0
    taken = (
        "2 frames at 20 fps; unit: no human rig; taken as centimetres; +Y up; 3 joints, no known human rig"
    )
    assert json.loads(capsys.readouterr().out) == {
        "file": str(source),
        "output": str(target),
        "taken": taken,
    }
    np.testing.assert_array_equal(read_bvh(target).values[0], [-1, 90, 3, -4, -5, 6, -10, -11, 12, -7, -8, 9])


def test_a_folder_with_a_broken_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "in"
    (source / "deep").mkdir(parents=True)
    (source / "deep" / "z.bvh").write_text(RIG)
    write_motion(source / "walk.glb", make_walk(30))
    (source / "bad.BVH").write_bytes((BROKEN / "nan.bvh").read_bytes())
    assert run(monkeypatch, "mirror", source, tmp_path / "out") == 1
    out, err = capsys.readouterr()
    assert "2 of 3 files written" in out
    assert "bad.BVH" in err and "Traceback" not in err
    made = sorted(str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*.*"))
    assert made == ["deep/z.bvh", "walk.bvh"]


def test_from_bvh_to_another_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_motion(tmp_path / "a.bvh", make_walk(30))
    assert run(monkeypatch, "mirror", tmp_path / "a.bvh", tmp_path / "a.npz") == 0
    assert len(read_motion(tmp_path / "a.npz")) == 30


def test_a_rig_without_sides_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "in.bvh"
    source.write_text(RIG.replace("lLeg", "front").replace("rLeg", "back"))
    assert run(monkeypatch, "mirror", source, tmp_path / "out.bvh") == 1
    err = capsys.readouterr().err
    assert "in.bvh" in err and "Hips, front, back" in err
    assert not (tmp_path / "out.bvh").exists()


def test_a_missing_source_is_wrong_usage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, "mirror", tmp_path / "no.bvh", tmp_path / "out.bvh") == 2


@pytest.mark.parametrize("command", ["mirror", "view"])
def test_help_imports_no_torch(command: str) -> None:
    code = (
        f"import sys; from motionkit.cli.main import cli; cli(['{command}', '--help'], standalone_mode=False)"
    )
    code += "; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_without_a_target_the_file_is_named_after_the_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    source = tmp_path / "clips" / "kick.bvh"
    source.parent.mkdir()
    source.write_text(RIG)
    assert run(monkeypatch, "mirror", source) == run(monkeypatch, "mirror", source) == 0
    made = [Path("kick-mirrored.bvh"), Path("kick-mirrored-2.bvh")]
    assert "wrote kick-mirrored.bvh: " in capsys.readouterr().out
    assert made[0].read_bytes() == made[1].read_bytes() != source.read_bytes()
