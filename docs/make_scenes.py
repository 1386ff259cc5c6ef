"""Writes the pictures of docs/experiments.md: what the paper's figures 1, 6, 7a and 8 show, made by the bundled model.

python docs/make_scenes.py [FOLDER]     # needs Pillow (the extra "view")

They are the pictures of `motionkit experiment scenes`, smaller and of few colours. The contact sheets that `experiment
long` left in experiments/long are copied beside them in the same way.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

from motionkit.lab.paper.long_rollouts import sheet_name
from motionkit.lab.paper.scenes import chosen_scenes, make_scene, picture_name
from motionkit.models.bundled import load_bundled_model
from motionkit.view.strobe import StrobePicture

FIGURES = ("1", "6", "7a", "8")
SIZE = 1200, 480
COLORS = 160
LONG = Path(__file__).resolve().parents[1] / "experiments" / "long"
SHEET = 1100  # width of a contact sheet


def main(folder: str = str(Path(__file__).resolve().parent)) -> None:
    """Make all pictures, of seed 0."""
    model = load_bundled_model()
    for scene in chosen_scenes(FIGURES):
        drawn = StrobePicture(make_scene(model, scene, 0).view).draw().resize(SIZE, Image.Resampling.LANCZOS)
        _save(drawn, Path(folder) / picture_name(scene.figure, scene.name))
    for sheet in sorted(LONG.glob("*/sheet.png")):
        drawn = Image.open(sheet).convert("RGB")
        small = drawn.resize((SHEET, drawn.height * SHEET // drawn.width), Image.Resampling.LANCZOS)
        _save(small, Path(folder) / sheet_name(sheet.parent.name))


def _save(picture: Image.Image, path: Path) -> None:
    picture.quantize(COLORS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main(*sys.argv[1:])
