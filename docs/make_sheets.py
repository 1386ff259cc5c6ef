"""Writes the contact sheets in docs/sheets: every type and paths, as the commands make them by default.

python docs/make_sheets.py [MODEL] [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

from motionkit.control.follow import follow_path
from motionkit.control.script import parse_types
from motionkit.control.synthesize import synthesize
from motionkit.lab.scoreboard.paths import path_trials
from motionkit.models.bundled import BUNDLED, open_model
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.motion import Motion
from motionkit.view.contact_sheet import write_contact_sheet

SECONDS = 6.0
EACH = 6  # motions on a sheet of types
PATHS = 5  # the last ones of the scoreboard's, those with corners and changes of type
POSES, WIDTH = 10, 1100


def type_motions(model: MotionModel) -> list[tuple[str, Motion]]:
    """Six seconds of every type; what is performed once, between two walks."""
    performed = {name for name in model.types if model.kind(name) is MotionKind.PERFORMANCE}
    out = []
    for kind in model.types:
        once = f"walking:1.5,{kind}:{model.phase_seconds(kind):.2f},walking:1.5"
        text = once if kind in performed else f"{kind}:{SECONDS}"
        parts = parse_types(text, SECONDS, model.phase_seconds)
        made = synthesize(model, [parts])
        out.append((", ".join(part.type for part in parts), made.motions[0].motion))
    return out


def main(model: str = BUNDLED, folder: str = str(Path(__file__).resolve().parent / "sheets")) -> None:
    loaded = open_model(model)
    Path(folder).mkdir(parents=True, exist_ok=True)
    types = type_motions(loaded)
    for first in range(0, len(types), EACH):
        some = types[first : first + EACH]
        write_contact_sheet(Path(folder) / f"types-{first // EACH + 1}.png", some, POSES, WIDTH)
    # The sheets' font has no arrows.
    names = [(trial.name.replace(" →", ","), trial) for trial in path_trials("walking", "running")[-PATHS:]]
    paths = [(name, follow_path(loaded, trial.path).motion) for name, trial in names]
    write_contact_sheet(Path(folder) / "paths.png", paths, POSES, WIDTH)


if __name__ == "__main__":
    main(*sys.argv[1:])
