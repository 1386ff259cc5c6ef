"""What setup.py and the sdist say of the C kernels, and where the version stands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import motionkit

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "motionkit"
SETUP = (ROOT / "setup.py").read_text("utf-8")


def test_sources_name_all_c_files() -> None:
    named = set(re.findall(r'"(\w+/\w+\.[ch])"', SETUP))
    there = {path.relative_to(SOURCE).as_posix() for end in "ch" for path in SOURCE.rglob(f"*.{end}")}
    assert named == there


@pytest.mark.parametrize("address", ["", "https://example.org/someone/motionkit"])
def test_a_package_index_sees_no_link_that_leads_nowhere(address: str) -> None:
    environment = {**os.environ, "MOTIONKIT_URL": address + "/" if address else ""}
    words = [sys.executable, "-W", "ignore", "setup.py", "--long-description"]
    shown = subprocess.run(
        words, cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout
    targets = re.findall(r"\]\(([^)\s]+)\)", shown)
    assert "motionkit learns how people move from a folder of BVH files" in shown
    if not address:
        assert targets == [] and "docs/commands.md" in shown
        return
    assert f"{address}/raw/main/docs/running-cartwheel.gif" in targets
    for target in targets:
        kind, _, name = target.removeprefix(f"{address}/").partition("/main/")
        assert kind in ("raw", "blob") and (ROOT / name.partition("#")[0]).exists(), target


def test_every_version_is_the_packages() -> None:
    """The version stands in motionkit/version.py; what cannot read it there says the same."""
    version = motionkit.__version__
    texts = {
        name: (ROOT / name).read_text("utf-8") for name in ("CITATION.cff", "CHANGELOG.md", "docs/install.md")
    }
    add_on = (ROOT / "integrations" / "blender" / "motionkit_blender.py").read_text("utf-8")
    assert re.findall(r"^version: (\S+)$", texts["CITATION.cff"], re.MULTILINE) == [version]
    assert re.search(r"^## (\S+)", texts["CHANGELOG.md"], re.MULTILINE)[1] == version  # type: ignore[index]
    assert f"motionkit, version {version}\n" in texts["docs/install.md"]
    assert f'"version": ({version.replace(".", ", ")})' in add_on
    assert 'version = {attr = "motionkit.version.__version__"}' in (ROOT / "pyproject.toml").read_text(
        "utf-8"
    )
