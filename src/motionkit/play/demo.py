"""Writes the folder of `motionkit demo`: a page that runs a model in the browser, for any file server."""

from __future__ import annotations

import hashlib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.control.script import TypePart
from motionkit.control.synthesize import synthesize
from motionkit.errors import MotionkitError
from motionkit.export.figure import make_figure
from motionkit.export.page_model import page_model
from motionkit.files import check_foreign, write_together
from motionkit.inference.character import model_first_type
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.play.figures import standing_rig
from motionkit.play.frames import rounded
from motionkit.play.on_rig import rig_tables, with_soles
from motionkit.view.figure_data import CM
from motionkit.view.viewer import fill_page, page_asset

CHECKED = 1.0  # s of motion that a model must make without a fault before its page is written
NAMES = ("index.html", "motionkit.wasm", "model.bin", "three-LICENSE.txt", "sw.js")


def write_demo(folder: str | Path, model: MotionModel, force: bool = False) -> dict[str, int]:
    """Write page, model and kernels into a folder, together; it is created if needed, and other files are kept.

    Args:
        folder: where to write.
        model: what the page runs.
        force: replace files of these names that motionkit did not write.

    Returns:
        Size in bytes of each file, by name.

    Raises:
        ModelError: the kernels cannot run the network, or it predicts no motion.
        OverwriteError: a file is in the way that motionkit did not write.
        MotionkitError: the folder cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise MotionkitError(f"{folder}: is a file, expected a folder to write into")
    if not force:
        page_file, worker = folder / "index.html", folder / "sw.js"
        check_foreign([page_file, worker] if page_file.exists() else [folder / name for name in NAMES])
    packed = page_model(with_soles(model))  # refuses what the kernels cannot run
    motion = synthesize(model, [TypePart(model_first_type(model), CHECKED)]).motion
    page = fill_page("demo.html", _page_data(model, motion))
    made = {
        "index.html": page.encode(),  # first, since it marks the others as ours
        "motionkit.wasm": (files("motionkit") / "assets" / "web" / "motionkit.wasm").read_bytes(),
        "model.bin": packed,
        "three-LICENSE.txt": page_asset("three-LICENSE.txt").encode(),
    }
    digest = hashlib.sha256(b"".join(made.values())).hexdigest()
    made["sw.js"] = page_asset("demo-sw.js").replace("__VERSION__", digest[:16]).encode()
    write_together({folder / name: data for name, data in made.items()})
    return {name: len(data) for name, data in made.items()}


def _page_data(model: MotionModel, motion: Motion) -> dict[str, Any]:
    """The body of the page, the axes of its bones in files, its pose at the start of a motion, and tables of rigs."""
    figure = make_figure(motion)
    bone = {"axes": rounded(figure.axes, 6), "height": rounded(figure.rest[0, 1], 6)}
    body = standing_rig(model.character("default")) | {"bone": bone}
    root = motion.root_positions[0] * np.array([0.0, CM, 0.0])
    first = {"root": rounded(root, 6), "rotations": rounded(motion.local_rotations[0].ravel(), 6)}
    return {"bodies": {"default": body}, "first": first, "rigs": rig_tables()}
