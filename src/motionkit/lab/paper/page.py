"""docs/experiments.md and docs/experiments-tables.md, written from the results in a folder.

The page says what was run and what is learnt; the file of tables beside it holds every table of every budget.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motionkit.files import write_together
from motionkit.lab.paper.bodies import BODIES_HEADER, bodies_row, slopes
from motionkit.lab.paper.claims import claims_table, counts
from motionkit.lab.paper.findings import by_budget, findings
from motionkit.lab.paper.long_rollouts import APART, LONG_HEADER, long_row, sheet_name
from motionkit.lab.paper.scenes import picture_name
from motionkit.lab.paper.tables import (
    Results,
    budget_lines,
    latex,
    markdown,
    missing,
    protocol_folders,
    tables,
)
from motionkit.lab.statistics import figure
from motionkit.tables import Table

HEAD = """# Experiments

`motionkit experiment` repeats the paper's experiments on free motion: it trains the paper's network, every variant and
the networks of other papers alike, rolls them out on test sequences and measures them.

```text
motionkit preprocess cmu/ --labels docs/free-cmu-labels.csv --layout expmap-root-1 --own-bodies --raw -o datasets/paper
motionkit experiment run all --data datasets/paper --seeds 3 # continues where it was stopped
motionkit experiment tables
```

The last command writes this page from the results in `experiments/results`, and every table of every budget into
[{tables}]({tables}). No figure is typed in.

**How to read it.** The paper's figures come from its own data, after its own training of 2000 epochs (table 3 from the
data of PFNN). A cell is the mean over seeds, ± the standard deviation over seeds, with the paper's figure in brackets.
Bold is a best value that is better by more than the spread over seeds. Networks draw each frame at full sigma, from 87
initial frames (30 where a sequence is short), with the types, trajectory and skeleton of the test sequence. They have
no foot locking, reference poses, velocity blending or corrections. [metrics.md](metrics.md) defines the metrics: BM is
`bm-euler`, which is best where it is nearest to the recorded one, then `afs`, `ssim-channel`, `mpjpe` and `path-mean`.
BM of drawn frames grows with sigma, so it says little of the movement; BM by mean does. A network without contact loss
(w/o-F) has untrained contact outputs: its contacts are labelled by height and speed of the feet it draws, as recordings
are. Roll-outs are kept beside results; `motionkit experiment measure` adds a metric to finished runs.
"""

TABLES_HEAD = """# Tables of the experiments

Every table of `motionkit experiment tables`; [{page}]({page}) says how to read them and what is learnt. The shipped
model is measured as it ships, with reference poses, sampling presets, corrections and foot locking. It follows the
trajectory where it lies on the ground, and test sequences that are mirror images of its training clips are left out.
`fid-pose` and diversity work on windows of a second, described by mean and deviation of the pose embedding. Of the
derivatives that by the features fed in is small even for the best linear predictor, because the trajectory is given;
that by the trajectory nears 1 as a network learns, and begins there where the head adds what it is given.
"""

NOT_DRAWN = """**Figures 10 to 12 are not drawn.** What figure 10 shows, feet that slide, is AFS in the tables; figure
11, motions beside recordings, is the page of `motionkit experiment study`; figure 12, a path by PFNN
and by TPTN, needs PFNN's data, which is not free (`--set locomotion` is the nearest). The control input
that fails in section 5.5, a twist by EBTN, is a row of the tables by type in
[experiments-tables.md](experiments-tables.md); runs made or measured anew also have the share of it
that a classifier of the types takes for a twist. Responsiveness is measured of the shipped model
([evaluation.md](evaluation.md#response)), not of `tptn-paper`.
"""

SCENES = """## The paper's figures 1 and 5 to 9

`motionkit experiment scenes --seeds 3` makes what these figures show, with any model (`--model`). Types and shapes are
those of the paper; it gives its paths as pictures alone, so lengths are chosen to suit the recordings. Each distance is
the mean over frames from the root's place on the ground to the nearest point of the path, ± the standard deviation over
seeds. Feet are not locked; in the paper they are, except in figure 9. The shipped model uses its reference poses.
`python docs/make_scenes.py` draws the pictures.
"""


def scenes_section(scenes: Sequence[dict[str, Any]], folder: Path) -> list[str]:
    """Return the section of scenes: a table with a column for each model, and the pictures beside the page."""
    if not scenes:
        return []
    rows = []
    for number, scene in enumerate(scenes[0]["scenes"]):
        cells = [scene_cell(each["scenes"][number]) for each in scenes]
        paper = "" if scene["paper"] is None else f"{scene['paper']:g}"
        rows.append((scene["figure"], scene["text"], *cells, paper))
    names = [f"{each['model']}, {each['steps']} training steps in its last run (cm/frame)" for each in scenes]
    table = Table("Distances from paths", ("figure", "what it shows", *names, "paper"), tuple(rows))
    notes = [f"{each['model']}: {each['note']}\n" for each in scenes if each.get("note")]
    parts = [SCENES, markdown(table), *notes]
    for scene in scenes[0]["scenes"]:
        file = picture_name(scene["figure"], scene["name"])
        if (folder / file).exists():
            parts.append(f"![Figure {scene['figure']}: {scene['text']}]({file})\n")
    return [*parts, NOT_DRAWN]


def scene_cell(scene: dict[str, Any]) -> str:
    """Return a scene's distance over seeds, and how many did not reach the end of the path."""
    found = figure(scene["distances"])
    if found is None:
        return "made"
    spread = f" ± {found.spread:.3f}" if found.seeds > 1 else ""
    short = len(scene["distances"]) - scene["finished"]
    return f"{found.mean:.3f}{spread}" + (
        f"; {short} of {found.seeds} did not reach the end" if short else ""
    )


LONG = """## Long roll-outs

Twenty seconds from 30 initial frames of test clips (the paper's section 5.2): types are given, the trajectory is the
network's own prediction, fed back, and frames are drawn at full sigma. A roll-out holds where, in each of four parts,
its poses are at most {apart:g} times as far from the nearest pose in the training clips of the type as the held-out
recording is, its feet swing about their mean place under the body between half and {apart:g} times as far, and it goes
no faster than the fastest five seconds of its type in the training clips. `motionkit experiment long MODEL` makes them,
and `motionkit train datasets/paper --preset tptn-paper --budget medium --batch 8 --minutes 200 --trajectory-drift 0.15
--from-scratch` a model for it, of all types. Networks of D_L know no dance (`--type`).
"""


def long_section(models: Sequence[dict[str, Any]], beside: Path | None = None) -> list[str]:
    """Return the section of long roll-outs: how many of each model hold.

    With the folder of the page also a table for each model, and the contact sheet that lies there.
    """
    parts = [LONG.format(apart=APART)] if models else []
    for each in models:
        if beside is not None:
            rows = tuple(long_row(facts) for facts in each["rollouts"])
            title = f"{each['model']}, {each['steps']} training steps in its last run"
            parts.append(markdown(Table(title, LONG_HEADER, rows)))
            sheet = sheet_name(each["model"])
            if (beside / sheet).exists():
                parts.append(f"![Roll-outs of {each['model']}, a pose every second]({sheet})\n")
        held = sum(facts["holds"] for facts in each["rollouts"])
        parts.append(f"{held} of {len(each['rollouts'])} roll-outs of {each['model']} hold.\n")
        if each.get("note"):
            parts.append(f"{each['note']}\n")
    return parts


BODIES = """## Skeleton control

The control signal c^s holds the joints of the performer's body in its rest pose (paper section 3). Here one recording
is continued with the bodies of {count} performers in that signal, all else equal. What the network takes the body to be
is measured in the joint positions that it predicts, in cm, after the initial frames have left its receptive field;
steps are the largest distance between the ankles in a second. `motionkit experiment bodies MODEL` makes the table.
"""


def bodies_section(models: Sequence[dict[str, Any]], with_tables: bool = True) -> list[str]:
    """Return the section of the skeleton control signal: a table for each model, and how far it is followed."""
    parts = [BODIES.format(count=len(models[0]["performers"]))] if models else []
    for each in models:
        shown = each["performers"]
        trained = f"{each['model']}, {each['steps']} training steps in its last run"
        title = f"{trained}: {each['type']}, {each['seeds']} seeds"
        if with_tables:
            parts.append(markdown(Table(title, BODIES_HEADER, tuple(bodies_row(row) for row in shown))))
        words = ", ".join(f"{name} {slope:.2f}" for name, slope in slopes(shown).items())
        parts.append(
            f"How much of a difference between performers is made by {title} (least squares; 1 is all): {words}.\n"
        )
    return parts


LEARNT = """Seeds are paired: the same seed sees the same windows, so each network is compared with TPTN seed by seed,
on held-out clips. A cell is the variant's figure minus TPTN's, t of a two-sided paired t-test over seeds, and its p,
corrected by Holm over all variants with that measure; bold is p below 0.05. **likelihood** is the negative
log-likelihood per frame; **error** that of the mean one frame ahead, each block of features as a share of the error of
repeating the last frame; **open loop** the distance of joints in roll-outs of a second by mean, in cm. Whether bodies
move less or feet slide is decided by BM or AFS of the roll-outs by mean, since BM of samples measures sigma above all.
A claim **agrees** or **does not agree** where a measure tells and none tells otherwise; else it **cannot be told**.
The verdicts hold for the training that the networks had here.
"""
SHOWN = ("Networks of other papers, and floors", "One frame ahead", "A second in open loop")


@dataclass(frozen=True)
class Extras:
    """What stands on the page beside the tables: the results of scenes, long roll-outs and bodies, by model."""

    scenes: tuple[dict[str, Any], ...] = ()
    long: tuple[dict[str, Any], ...] = ()
    bodies: tuple[dict[str, Any], ...] = ()


def page(results: Results, extras: Extras | None = None, path: Path = Path("docs/experiments.md")) -> str:
    """Return the page: the budget with most training on the small data set, scenes, and what holds for long.

    Args:
        results: of all data sets and budgets.
        extras: what stands there besides.
        path: where the page is to lie, with the pictures of scenes beside it.
    """
    extras = extras or Extras()
    main = _most_trained(results)
    here = [result for result in results if result["folder"] == main]
    parts = [HEAD.format(tables=tables_path(path).name), *_what_was_run(here)]
    others = [f"`{folder}`" for folder in protocol_folders(results) if folder != main]
    parts += [f"The same was run in {', '.join(others)}.\n"] if others else []
    parts += [*_what_is_learnt(here), *(f"- {line}" for line in by_budget(results)), ""]
    parts += [markdown(table) for table in tables(here) if table.title.startswith(SHOWN)]
    parts += [*scenes_section(extras.scenes, path.parent), *long_section(extras.long)]
    return "\n".join([*parts, *bodies_section(extras.bodies, with_tables=False)])


def tables_page(
    results: Results, extras: Extras | None = None, path: Path = Path("docs/experiments.md")
) -> str:
    """Return the file of tables beside the page: all data sets and budgets; arguments as of page."""
    extras = extras or Extras()
    parts = [TABLES_HEAD.format(page=path.name), *_what_was_run(results), *_what_is_learnt(results)]
    parts += [
        *(f"- {line}" for line in by_budget(results)),
        "",
        "## Tables\n",
        *(markdown(table) for table in tables(results)),
    ]
    parts += [*long_section(extras.long, path.parent), *bodies_section(extras.bodies)]
    return "\n".join(parts)


def tables_path(path: Path) -> Path:
    """Return where the tables of a page lie."""
    return path.with_name(f"{path.stem}-tables{path.suffix}")


def _most_trained(results: Results) -> str:
    """Return the folder with most training, of those with held-out errors and of the small data set if any are."""

    def training(folder: str) -> tuple[bool, bool, int]:
        here = [result for result in results if result["folder"] == folder]
        steps = max(r["budget"]["steps"] if "budget" in r else 0 for r in here)
        return any("held-out" in r for r in here), here[0]["data"] == "D_L", steps

    return max(protocol_folders(results), key=training)


def _what_was_run(results: Results) -> list[str]:
    parts = ["## What was run\n", *(f"- {line}" for line in budget_lines(results)), ""]
    for folder in protocol_folders(results):
        lacking = missing(results, folder)
        if not any(r.get("parameters") for r in results if r["folder"] == folder):
            parts.append(f"No network has been trained in `{folder}` yet.\n")
        elif lacking:
            parts.append(f"Not run yet in `{folder}`: {', '.join(lacking)}.\n")
    return parts


def _what_is_learnt(results: Results) -> list[str]:
    parts = ["## What is learnt\n", LEARNT]
    for folder in protocol_folders(results):
        here = [result for result in results if result["folder"] == folder]
        # They are of the small data set, and so are the figures beside them.
        if here[0]["data"] == "D_L":
            table = claims_table(here, f"The paper's claims: `{folder}`")
            parts += [markdown(table), f"{counts(here)}\n"] if table.rows else []
    return [*parts, *(f"- {line}" for line in findings(results))]


def write_page(
    results: Results, path: Path, latex_path: Path | None = None, extras: Extras | None = None
) -> None:
    """Write the page, its tables beside it, and these in LaTeX if a path is given, all whole or none."""
    texts = {path: page(results, extras, path), tables_path(path): tables_page(results, extras, path)}
    if latex_path is not None:
        texts[latex_path] = "\n".join(latex(table) for table in tables(results))
    write_together({target: text.encode() for target, text in texts.items()})
