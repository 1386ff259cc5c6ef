"""docs/experiments.md, written from the results in a folder."""

from __future__ import annotations

from pathlib import Path

from motionkit.experiments.tables import (
    Results,
    budget_lines,
    figure_of,
    latex,
    markdown,
    missing,
    tables,
)
from motionkit.files import atomic_write

HEAD = """# Experiments

The paper's experiments on free motion: `motionkit experiment` trains its network, every variant and the networks of
other papers alike, rolls them out on test sequences, and writes these tables. This page is written by
`motionkit experiment tables` from the results in `experiments/results`; nothing on it is typed in.

```text
motionkit preprocess cmu/ --labels docs/free-cmu-labels.csv --layout expmap-root-1 --own-bodies --raw -o datasets/paper
motionkit experiment run all --data datasets/paper --seeds 3 # continues where it was stopped
motionkit experiment tables
```

**How to read them.** Each cell is the mean over seeds, ± the standard deviation over seeds where there are two or more,
and in brackets the paper's figure, which was measured on the paper's own data, after 2000 epochs. Bold is a best value
that is better by more than the spread over seeds; with one seed nothing is bold. BM is best where it is nearest to the
recorded one. Networks are drawn at full sigma, from 87 initial frames (30 where a sequence is short), with the types,
trajectory and skeleton of the test sequence, without foot IK, reference poses, velocity blending or corrections.
Metrics are those of [metrics.md](metrics.md): `bm-euler`, `afs`, `ssim-channel`, `mpjpe`, `path-mean`.
`fid-pose` and diversity work on windows of a second, described by mean and deviation of the pose embedding.
"""


def page(results: Results) -> str:
    """Return docs/experiments.md."""
    parts = [HEAD, "## What was run\n", *(f"- {line}" for line in budget_lines(results)), ""]
    for folder in sorted({result["folder"] for result in results}):
        lacking = missing(results, folder)
        if lacking:
            parts.append(f"Not run yet in `{folder}`: {', '.join(lacking)}.\n")
    parts += ["## What can be said\n", *(f"- {line}" for line in findings(results)), "", "## Tables\n"]
    return "\n".join([*parts, *(markdown(table) for table in tables(results))])


def findings(results: Results) -> list[str]:
    """Say of each of the paper's claims what these results say, with the spread; by rule, from the figures."""
    lines = []
    for folder in sorted({result["folder"] for result in results}):
        here = [result for result in results if result["folder"] == folder]
        for rival, claim in (
            ("EBTN", "two parts against the whole body"),
            ("w/o-FFL", "the fusion layer"),
            ("w/o-CL", "the consistency loss"),
            ("motion matching", "the network against motion matching"),
            ("last frame", "the network against holding the last frame"),
        ):
            said = _compared(here, rival)
            if said:
                lines.append(f"`{folder}`, {claim}: {said}.")
    return lines or ["Nothing yet: no results of TPTN beside another."]


def _compared(results: Results, rival: str) -> str:
    mine = [r for r in results if r["name"] == "TPTN"]
    theirs = [r for r in results if r["name"] == rival]
    if not mine or not theirs:
        return ""
    words = []
    for metric, name in (("mpjpe", "MPJPE"), ("afs", "AFS"), ("ssim-channel", "SSIM")):
        a, b = figure_of(mine, metric), figure_of(theirs, metric)
        if a is None or b is None:
            continue
        sign = -1.0 if metric == "ssim-channel" else 1.0
        gap = sign * (b.mean - a.mean)
        fixed = rival in ("motion matching", "last frame")  # no seeds: the same every time
        seeds = a.seeds if fixed else min(a.seeds, b.seeds)
        if seeds < 2:
            verdict = "one seed, too little to say"
        elif abs(gap) <= max(a.spread, b.spread):
            verdict = "within the spread"
        else:
            verdict = "TPTN is better" if gap > 0 else f"{rival} is better"
        words.append(f"{name} {a.mean:.3g} against {b.mean:.3g} ({verdict})")
    return ", ".join(words)


def write_page(results: Results, path: Path, latex_path: Path | None = None) -> None:
    """Write the page, and all tables in LaTeX if a path is given, each whole or not at all."""
    with atomic_write(path, "w") as out:
        out.write(page(results))
    if latex_path is not None:
        with atomic_write(latex_path, "w") as out:
            out.write("\n".join(latex(table) for table in tables(results)))
