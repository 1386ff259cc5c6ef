"""The preview of a training run: a page or sheet of roll-outs that grows with every evaluation."""

from __future__ import annotations

from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.view.write import write_view

LISTED_ROUNDS = 4  # evaluations; if there are more, the first and the last ones are shown


class Preview:
    """A page or sheet with the recordings and the roll-outs of each evaluation."""

    def __init__(self, file: Path, samples: Path) -> None:
        self.file, self.samples = file, samples
        self.rounds: list[tuple[int, list[Path]]] = []

    def grow(self, step: int) -> str:
        """Rewrite the preview with the samples of a step; returns what failed, else an empty string."""
        kept = self.samples.parent / "preview"
        try:
            kept.mkdir(parents=True, exist_ok=True)
            copies = []
            for made in sorted(self.samples.glob("*-predicted.bvh")):
                copy = kept / f"{made.stem.removesuffix('-predicted')}-step-{step}.bvh"
                copy.write_bytes(made.read_bytes())
                copies.append(copy)
            self.rounds.append((step, copies))
            rounds = self.rounds[:1] + self.rounds[1:][1 - LISTED_ROUNDS :]
            files = [file for _, made in rounds for file in made] + sorted(self.samples.glob("*-true.bvh"))
            files.sort(key=_type_and_step)
            motions = [bvh_to_motion(read_bvh(file)) for file in files]
            write_view(self.file, *motions, names=[file.stem for file in files])
        except (MotionkitError, OSError) as error:
            return f"the preview failed, the run continues: {error}"
        return ""


def _type_and_step(file: Path) -> tuple[str, int]:
    """Sort key that groups files by type: the recording, then roll-outs by step."""
    if file.stem.endswith("-true"):
        return file.stem.removesuffix("-true"), -1
    kind, _, step = file.stem.rpartition("-step-")
    return kind, int(step)
