"""Models with other reference clips or sampling presets than they came with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind, ReferenceClip


def with_clips(
    model: MotionModel, clips: Mapping[str, Sequence[ReferenceClip]], gaits: bool = False
) -> MotionModel:
    """The model with these reference clips, and none for other types; those that have some are gaits or not."""
    return model.with_types(
        {
            name: {
                "reference_clips": tuple(clips.get(name, ())),
                "steered": gaits if name in clips and kind.kind is not MotionKind.STANCE else kind.steered,
            }
            for name, kind in model.types.items()
        }
    )


def with_presets(model: MotionModel, field: str, values: Mapping[str, float]) -> MotionModel:
    """The model with these values of one field of the sampling presets, 0 for other types.

    Velocity blending and root-slip correction are off where they are not the field.
    """
    off = {"velocity_blend": 0.0, "slip_correction": 0.0}
    return model.with_types(
        {
            name: {"preset": replace(kind.preset, **(off | {field: values.get(name, 0.0)}))}
            for name, kind in model.types.items()
        }
    )


def with_preset(model: MotionModel, **values: float) -> MotionModel:
    """The model with some fields of all sampling presets changed."""
    return model.with_types(
        {name: {"preset": replace(kind.preset, **values)} for name, kind in model.types.items()}
    )
