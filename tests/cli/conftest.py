from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from motionkit.cli.main import main


def page_data(page: Path) -> dict:
    """The data in a viewer file."""
    text = page.read_text("utf-8").split('<script type="application/json" id="data">')[1]
    return json.loads(text.split("</script>")[0])


@dataclass(frozen=True)
class Outcome:
    """The result of a command: exit code, standard output, standard error."""

    code: int
    out: str
    err: str

    def failed_with(self, *words: str) -> bool:
        """Whether it failed as on bad data: exit code 1, one line on stderr, nothing on stdout."""
        lines = self.err.strip().splitlines()
        clean = self.code == 1 and not self.out and len(lines) == 1 and lines[0].startswith("error: ")
        return clean and all(word in self.err for word in words)


@pytest.fixture
def motionkit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Outcome]:
    """A function that runs the command in an empty folder, tmp_path: motionkit("metrics", file)."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["motionkit", *map(str, words)])
        capsys.readouterr()
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        said = capsys.readouterr()
        return Outcome(code, said.out, said.err)

    return run
