"""Fills the marked figures of README.md from docs/scoreboard.md and docs/scaling.md; run it after either has changed.

python docs/make_readme.py

A figure stands between its name and an empty comment, both of HTML, which a reader does not see.
"""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parent
README = DOCS.parent / "README.md"
MARK = re.compile(r"<!-- (\w+) -->.*?<!-- -->", re.DOTALL)


def rows(page: str) -> list[list[str]]:
    """The cells of every row of every table of a page in docs."""
    lines = (DOCS / page).read_text("utf-8").splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]


def targets(scoreboard: list[list[str]]) -> dict[str, float]:
    """What was measured for each target."""
    names = {
        "visible",
        "accuracy",
        "variety",
        "stability",
        "reconstruction",
        "paths",
        "response",
        "smoothness",
    }
    return {row[1]: float(row[2]) for row in scoreboard if row[0] in names and row[2]}


def frame_time(scaling: list[list[str]], way: str) -> float:
    """Median milliseconds of a frame of one character."""
    return next(float(row[2]) for row in scaling if row[:2] == ["1", way])


def shown_words(shares: dict[str, float], seeds: int) -> str:
    """How often types were shown, in words."""
    rarely = [f"{kind} {round(share * seeds)} times" for kind, share in shares.items() if share < 1.0]
    if not rarely:
        return "every type is shown every time"
    return f"{len(shares) - len(rarely)} are shown every time, {', '.join(rarely)}"


def figures() -> dict[str, str]:
    """The text of every mark."""
    scoreboard, scaling = rows("scoreboard.md"), rows("scaling.md")
    found = targets(scoreboard)
    asked = "accuracy of "
    shares = {name.removeprefix(asked): value for name, value in found.items() if name.startswith(asked)}
    seeds = re.search(r"^- seeds: (\d+)$", (DOCS / "scoreboard.md").read_text("utf-8"), re.MULTILINE)
    assert seeds is not None
    paths = {name: value for name, value in found.items() if name.endswith(": mean distance, cm")}
    mixed = [value for name, value in paths.items() if "→" in name or "corner" in name]
    plain = [value for name, value in paths.items() if value not in mixed]
    return {
        "types": str(len(shares)),
        "seeds": seeds[1],
        "shown": shown_words(shares, int(seeds[1])),
        "paths": f"{min(plain):.2f} to {max(plain):.2f}",
        "mixed": f"{max(mixed):.1f}",
        "response": f"{found['mean response time to a change of speed, s']:.2f}",
        "frame": f"{frame_time(scaling, 'stream, C, 16 bits, foot locking'):.2f}",
        "sliding": f"{found['foot sliding of the raw network / real (afs)']:.2f}",
        "held": f"{found['foot sliding / real (afs)']:.2f}",
        "ssim": f"{found['ssim-window against the nearest clip']:.2f}",
    }


def filled(text: str) -> str:
    """The text with every mark filled; raises KeyError for a mark without a figure."""
    values = figures()
    return MARK.sub(lambda mark: f"<!-- {mark[1]} -->{values[mark[1]]}<!-- -->", text)


if __name__ == "__main__":
    README.write_text(filled(README.read_text("utf-8")), encoding="utf-8")
