"""The view command."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from motionkit.cli.main import main

from .test_mirror import RIG


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the command as the console script does, and return its exit code."""
    monkeypatch.setattr(sys, "argv", ["motionkit", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_a_sheet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    clip, sheet = tmp_path / "clip.bvh", tmp_path / "sheet.png"
    clip.write_text(RIG)
    assert run(monkeypatch, "view", clip, clip, "-o", sheet, "--poses", 2, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["output"] == str(sheet)
    assert [c["frames"] for c in result["clips"]] == [2, 2]
    assert sheet.read_bytes().startswith(b"\x89PNG")


def test_other_endings_are_wrong_usage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG)
    assert run(monkeypatch, "view", clip, "-o", tmp_path / "sheet.jpg") == 2
    assert ".png" in capsys.readouterr().err


def test_a_broken_clip_leaves_no_sheet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG.replace("Frames: 2", "Frames: 3"))
    assert run(monkeypatch, "view", clip, "-o", tmp_path / "sheet.png") == 1
    assert "clip.bvh" in capsys.readouterr().err
    assert not (tmp_path / "sheet.png").exists()


def test_without_pillow_one_line_tells_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG)
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert run(monkeypatch, "view", clip, "-o", tmp_path / "sheet.png") == 1
    err = capsys.readouterr().err.strip()
    assert err.count("\n") == 0 and 'pip install "motionkit[view]"' in err
