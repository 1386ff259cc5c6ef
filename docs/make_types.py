"""Writes the section "Types" of docs/model-card.md from the bundled model; run it after the model has changed.

python docs/make_types.py
"""

from __future__ import annotations

import re
from pathlib import Path

from motionkit.models.bundled import load_bundled_model
from motionkit.models.motion_type import MotionKind, MotionType

PAGE = Path(__file__).resolve().parent / "model-card.md"
SECTION = re.compile(r"^## Types\n.*?(?=^## )", re.MULTILINE | re.DOTALL)
HEAD = """## Types

The table is read from the model file by `python docs/make_types.py`.

- **kind**: speed alone steers *stands* and *gait*, on paths and by keys, without recordings; a *performance* is shown
  from beginning to end; *strikes* have a phase for each strike or jump; all others go on for as long as asked.
- **speed** over the ground in cm/s; **seconds** of one performance, strike or jump.
- **recordings**: seconds of reference recordings in the file; **gain** on them
  ([rollout.md](rollout.md#what-the-network-sees)).
- **blend**: share of the last velocity that is kept; **noise**: factor on the temperature.
- **slip**: share of the [root-slip correction](rollout.md#root-slip-correction).

| type | kind | speed | seconds | recordings | gain | blend | noise | slip |
|---|---|---|---|---|---|---|---|---|
"""


def kind_of(known: MotionType) -> str:
    """How a type is controlled, in one word."""
    if known.kind is MotionKind.STANCE:
        return "stands"
    if known.steered:
        return "gait"
    if known.kind is MotionKind.PERFORMANCE:
        return "performance"
    return "strikes" if known.kind is MotionKind.EVENTS else "goes on"


def page_text() -> str:
    """The text of the page, with the section written anew."""
    model, lines = load_bundled_model(), []
    for name, known in model.types.items():
        recorded = sum(len(clip) for clip in known.reference_clips) / model.fps
        speed = known.gait.speed if known.gait else 0.0
        length = f"{known.gait.cycle_seconds:.1f}" if known.gait and known.gait.cycle_seconds else ""
        preset = known.preset
        numbers = (preset.reference_gain, preset.velocity_blend, preset.noise_scale, preset.slip_correction)
        cells = [
            name,
            kind_of(known),
            f"{speed:.0f}",
            length,
            f"{recorded:.0f}",
            *map("{:g}".format, numbers),
        ]
        lines.append("| " + " | ".join(cells) + " |\n")
    return SECTION.sub(lambda _: HEAD + "".join(lines) + "\n", PAGE.read_text("utf-8"))


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
