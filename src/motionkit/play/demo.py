"""Writes the folder of `motionkit demo`: a page that runs a model in the browser, for any file server."""

from __future__ import annotations

import hashlib
from importlib.resources import files
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.export.page_model import page_model
from motionkit.files import atomic_write
from motionkit.models.model import MotionModel
from motionkit.play.figures import standing_rig
from motionkit.view.viewer import fill_page, page_asset


def write_demo(folder: str | Path, model: MotionModel) -> dict[str, int]:
    """Write page, model and kernels into a folder; the folder is created if needed, and other files are kept.

    Returns:
        Size in bytes of each file, by name.

    Raises:
        ModelError: the kernels cannot run the network.
        MotionkitError: the folder cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise MotionkitError(f"{folder}: is a file, expected a folder to write into")
    page = fill_page("demo.html", {"bodies": {"default": standing_rig(model.character("default"))}})
    made = {
        "motionkit.wasm": (files("motionkit") / "assets" / "web" / "motionkit.wasm").read_bytes(),
        "model.bin": page_model(model),
        "three-LICENSE.txt": page_asset("three-LICENSE.txt").encode(),
        "index.html": page.encode(),
    }
    digest = hashlib.sha256(b"".join(made.values())).hexdigest()
    made["sw.js"] = page_asset("demo-sw.js").replace("__VERSION__", digest[:16]).encode()
    for name, data in made.items():
        with atomic_write(folder / name, "wb") as file:
            file.write(data)
    return {name: len(data) for name, data in made.items()}
