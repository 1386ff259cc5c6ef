"""Everything but training works without torch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough

SAMPLE = Path(__file__).resolve().parents[1] / "examples" / "data"
# A module that is None in sys.modules is one that cannot be imported.
RUN = """
import sys
sys.modules["torch"] = None
from motionkit.cli.main import main
sys.argv = ["motionkit", *sys.argv[1:]]
main()
"""


def run(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run a command in a process without torch."""
    command = [sys.executable, "-c", RUN, *map(str, words)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    ("words", "made"),
    [
        (["synthesize", "--types", "running:0.5,cartwheel:0.5", "-o", "a.bvh"], "a.bvh"),
        (["synthesize", "--types", "idle:0.5", "--init", SAMPLE / "16_45.bvh", "-o", "a.bvh"], "a.bvh"),
        (["follow-path", "line", "--size", 1, "-o", "a.bvh"], "a.bvh"),
        (["metrics", SAMPLE / "16_45.bvh", SAMPLE / "16_46.bvh"], ""),
        (["mirror", SAMPLE / "16_45.bvh", "a.bvh"], "a.bvh"),
        (["view", SAMPLE / "16_45.bvh", "-o", "a.html", "--no-open"], "a.html"),
        (["view", SAMPLE / "16_45.bvh", "-o", "a.png"], "a.png"),
        (["export", "--model", "tiny", "--onnx", "a.onnx"], "a.onnx"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_commands(tmp_path: Path, words: list, made: str, tiny_model_file: Path) -> None:
    done = run(tmp_path, *(tiny_model_file if word == "tiny" else word for word in words))
    assert done.returncode == 0, done.stderr
    assert not made or (tmp_path / made).exists()


def test_preprocess_and_evaluate(tmp_path: Path, clips_folder: Path) -> None:
    assert run(tmp_path, "preprocess", clips_folder, "-o", "ds", "--jobs", 1).returncode == 0
    sections = "visible,reconstruction,smoothness"
    done = run(
        tmp_path, "evaluate", "bundled", "ds", "--quick", "--seeds", 1, "--only", sections, "-o", "a.md"
    )
    assert done.returncode == 0, done.stderr
    assert "walking" in (tmp_path / "a.md").read_text()


def test_training_says_what_to_install(tmp_path: Path) -> None:
    done = run(tmp_path, "train", tmp_path)
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr == "error: training needs torch: pip install 'motionkit[train]'\n"


def test_live_characters_and_the_server_are_imported_without_torch(tmp_path: Path) -> None:
    look = (
        "import sys, motionkit.play.server, motionkit.control.drive, motionkit.lab.scoreboard.board, "
        "motionkit.view.viewer, motionkit.export.onnx_export; sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", look], timeout=60).returncode == 0
