"""examples/motionkit.ipynb runs from its first cell to its last, and shows what it says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from motionkit.motion.bvh import read_bvh

pytestmark = pytest.mark.thorough

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "motionkit.ipynb"


def test_it_is_kept_without_results() -> None:
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    assert all(not cell.get("outputs") and not cell.get("execution_count") for cell in cells)


def test_it_runs(tmp_path: Path) -> None:
    for needed in ("matplotlib", "ipykernel", "nbformat"):
        pytest.importorskip(needed)
    nbclient = pytest.importorskip("nbclient")
    import nbformat

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=150, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    shown: list[dict[str, Any]] = [
        output["data"] for cell in notebook.cells for output in cell.get("outputs", []) if "data" in output
    ]
    players = [data["text/html"] for data in shown if "text/html" in data]
    assert len(players) == 2 and all(player.startswith("<iframe srcdoc=") for player in players)
    assert sum("image/png" in data for data in shown) == 3
    assert len(read_bvh(tmp_path / "walk-cartwheel-salsa.bvh").values) > 400
