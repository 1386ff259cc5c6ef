"""`motionkit demo`: what it writes and says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from motionkit.cli.main import cli
from motionkit.models.bundled import BUNDLED_MODEL

pytestmark = pytest.mark.thorough


def test_a_folder_with_the_page_is_written(tmp_path: Path) -> None:
    words = ["demo", "-o", str(tmp_path / "site"), "--model", str(BUNDLED_MODEL), "--json"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["bytes"] == {file.name: file.stat().st_size for file in (tmp_path / "site").iterdir()}
    assert told["folder"] == str(tmp_path / "site")


def test_the_same_model_gives_the_same_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert CliRunner().invoke(cli, ["demo", "-o", str(tmp_path / name)]).exit_code == 0
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_a_file_as_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "site").write_text("mine", "utf-8")
    done = CliRunner().invoke(cli, ["demo", "-o", str(tmp_path / "site")])
    assert done.exit_code == 2 and "is a file" in done.output
