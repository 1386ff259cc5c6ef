"""The built pages that come with the package: made from the sources beside them, whole, and licensed."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest

from motionkit.view.viewer import page_asset

WEB = Path(__file__).resolve().parents[2] / "web"
PAGES = [path.parent.name for path in sorted((WEB / "src").glob("*/main.js"))]


def source_hash() -> str:
    """What web/build.mjs writes into every page it builds."""
    files = [path for path in (WEB / "src").rglob("*") if path.is_file()]
    files += [WEB / "build.mjs", WEB / "package-lock.json"]
    names = {path.relative_to(WEB).as_posix(): path for path in files}
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(f"{name}\n".encode() + names[name].read_bytes() + b"\n")
    return digest.hexdigest()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_built_from_its_source(name: str) -> None:
    built = re.search(r'name="source-sha256" content="(\w+)"', page_asset(f"{name}.html"))
    assert built and built[1] == source_hash(), "out of date: cd web && npm ci && npm run build"


@pytest.mark.parametrize("name", PAGES)
def test_a_page_loads_nothing_from_elsewhere(name: str) -> None:
    page = page_asset(f"{name}.html")
    assert not re.search(r"<(script|link|img|iframe)[^>]*\s(src|href)=(?!.data:)", page)
    assert "three.js authors" in page_asset("three-LICENSE.txt") and "MIT" in page[:400]


def test_the_lock_file_names_no_hosts() -> None:
    text = (WEB / "package-lock.json").read_text("utf-8")
    assert "://" not in text and '"integrity"' in text
