"""Writes docs/running-cartwheel.gif: what the first command of the README makes, as `motionkit view -o` draws it.

python docs/make_film.py     # needs the extra "view"
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).resolve().parent
FILM = DOCS / "running-cartwheel.gif"
TYPES = "running,cartwheel"


def main() -> None:
    """Synthesize, and draw."""
    with tempfile.TemporaryDirectory() as folder:
        motion = Path(folder) / "running-cartwheel.bvh"
        for words in (
            ["synthesize", "--types", TYPES, "-o", str(motion)],
            ["view", str(motion), "-o", str(FILM), "--width", "440"],
        ):
            subprocess.run([sys.executable, "-m", "motionkit", *words], check=True)
    print(f"{FILM.name}: {FILM.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
