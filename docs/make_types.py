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

- **type**: `b-walking` is walking backwards; `jumping-b`, `-l`, `-r` are jumps on both legs, the left one, the right
  one; `kicking` is karate, `w-kicking` a jump kick; `twist` is a jump with a twist, `duck` a run under something;
  `exercise` is jumping jacks, squats and stretches, `martial-arts` karate kata.
- **kind**: *stands* and *gait* are steered by speed; a *performance* is shown from beginning to end; *strikes* are
  several punches, kicks or jumps, each with a phase; all others are *continuous* and last as long as asked.
- **speed** over the ground in cm/s; **seconds** of one performance, strike or jump.
- **recordings**: seconds of reference recordings in the file; **gain** on them
  ([rollout.md](rollout.md#what-the-network-sees)).
- **velocity blend**: share of the last velocity that is kept; **noise**: factor on the temperature.
- **slip correction**: share of the [root-slip correction](rollout.md#root-slip-correction).

| type | kind | speed | seconds | recordings | gain | velocity blend | noise | slip correction |
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
    return "strikes" if known.kind is MotionKind.EVENTS else "continuous"


def page_text() -> str:
    """The text of the page, with the section written anew."""
    model, lines = load_bundled_model(), []
    for name, known in model.types.items():
        recorded = sum(len(clip) for clip in known.reference_clips) / model.fps
        speed = known.gait.speed if known.gait else 0.0
        length = f"{seconds:.2f}" if (seconds := model.phase_seconds(name)) else ""
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
