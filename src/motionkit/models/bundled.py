"""Loads the model that comes with motionkit."""

from __future__ import annotations

from pathlib import Path

from motionkit.arrays import Array
from motionkit.errors import ModelError
from motionkit.models.checkpoint import load_model
from motionkit.models.model import MotionModel

BUNDLED = "bundled"  # name of the bundled model in place of a path
MODEL_REFERENCES = "own"
BUNDLED_MODEL = Path(__file__).resolve().parent.parent / "assets" / "motionkit-free.safetensors"


def load_bundled_model() -> MotionModel:
    """Return the bundled model. Raises ModelError if the installation lacks it."""
    if not BUNDLED_MODEL.is_file():
        raise ModelError(
            f"{BUNDLED_MODEL}: the bundled model is missing from this installation; give --model"
        )
    return load_model(BUNDLED_MODEL)


def open_model(path: str | Path | None = None, reference: str = "auto") -> MotionModel:
    """Open a model file; None and "bundled" open the bundled model.

    Args:
        reference: "auto", or "none" to leave out its reference recordings.

    Raises:
        ModelError: the file is not a model.
    """
    model = load_bundled_model() if path is None or str(path) == BUNDLED else load_model(path)
    return model.with_reference(reference)


def reference_rotations(references: str | Path, layout: str) -> Array | None:
    """The reference rotations (23, 4) of a model for a dataset; None if the dataset must compute its own.

    That is so for "own", and for the bundled model if its layout is another one.

    Raises:
        ModelError: the file is not a model, or a model of another layout.
    """
    if str(references) == MODEL_REFERENCES:
        return None
    model = open_model(references)
    if model.config.layout == layout:
        return model.reference_rotations
    if str(references) == BUNDLED:
        return None
    raise ModelError(f"{references}: expected a model of layout {layout}, found {model.config.layout}")
