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
from motionkit.lab.paper.rollout_sheets import KINDS, sheet_file
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

`motionkit experiment` trains the paper's network (TPTN), its variants and the networks of other papers alike on free
motion, and tests them on held-out clips. [{tables}]({tables}) has every figure; both pages are
written from results.
"""

RUN = """## Run it

```text
motionkit preprocess cmu/ --labels docs/free-cmu-labels.csv --layout expmap-root-1 --own-bodies --raw -o datasets/paper
motionkit experiment run all --data datasets/paper --seeds 3 # continues where it was stopped
motionkit experiment tables
```

Results and roll-outs go to `experiments/results`; for data of your own give both commands another `--results`, and
`tables` another `-o` ([CONTRIBUTING.md](../CONTRIBUTING.md#add-a-data-set)). `motionkit experiment measure` adds a
metric to finished runs.
"""

LIMITS = """Networks draw each frame at full sigma, from 87 initial frames (30 where a sequence is short), with the
types, trajectory and skeleton of the test sequence, without foot locking, reference poses, velocity blending or
corrections. A cell of the tables is the mean over seeds, ± the standard deviation, with the paper's figure in brackets
(its own data, 2000 epochs; table 3: PFNN's data). Bold is a best value that is better by more than the spread. The
columns are `bm-euler` (BM, best nearest to the recorded one), `afs`, `ssim-channel`, `mpjpe` and `path-mean` of
[metrics.md](metrics.md). BM of drawn frames grows with sigma, so it says little of the movement; BM by mean does. w/o-F
is fed contacts that are labelled by height and speed of its feet. When these results were made, LearnedMM
searched every 20 frames only, and PFNN was told of the first contacts only, so their error is of more than one frame;
the consistency loss, and losses of LearnedMM and HTSS, also counted frames beyond the end of short clips.
"""

TABLES_HEAD = """# Tables of the experiments

Every table of `motionkit experiment tables`; [{page}]({page}) says how to read them and what is learnt. The shipped
model is measured as it ships, with reference poses, sampling presets, corrections and foot locking. It follows the
trajectory where it lies on the ground, and test sequences that are mirror images of its training clips are left out.
`fid-pose` and diversity work on windows of a second, described by mean and deviation of the pose embedding. Of the
derivatives that by the features fed in is small even for the best linear predictor, because the trajectory is given;
that by the trajectory nears 1 as a network learns, and begins there where the head adds what it is given.
"""

ROLLOUTS = """## The paper's figures 10 and 11

Mean roll-outs of the first seed, without foot locking: a held-out jump backwards and a held-out twist. `motionkit
experiment figures --data datasets/paper` draws them where roll-outs were kept.
"""

NOT_DRAWN = """Figure 12 needs PFNN's data, which is not free. The input that fails in section 5.5, a twist by EBTN, is
a row of the tables by type in [experiments-tables.md](experiments-tables.md).
"""

SCENES = """## The paper's figures 1 and 5 to 9

`motionkit experiment scenes --seeds 3` makes what these figures show, with any model (`--model`). Types and shapes are
those of the paper; lengths, which it does not give, suit the recordings. Distances are means over frames of the root
from the path, ± the standard deviation over seeds. Feet are not locked; in the paper they are, except in figure 9. The
shipped model uses its reference poses. `python docs/make_scenes.py` draws the pictures.
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
    sheets = [(number, sheet_file(number)) for number in KINDS if (folder / sheet_file(number)).exists()]
    pictures = [f"![Figure {number}: {KINDS[number]}]({file})\n" for number, file in sheets]
    return [*parts, *([ROLLOUTS, *pictures] if pictures else []), NOT_DRAWN]


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

Twenty seconds from 30 initial frames of test clips (the paper's section 5.2): types are given, the network is fed its
own trajectory, and frames are drawn at full sigma. A roll-out holds where, in each of four parts, its poses are at most
{apart:g} times as far from the nearest training pose of the type as the held-out recording is, its feet swing between
half and {apart:g} times as far, and it goes no faster than the fastest five seconds of its type.
`motionkit experiment long MODEL` makes them, and `motionkit train datasets/paper --preset tptn-paper --budget medium
--batch 8 --minutes 200 --trajectory-drift 0.15 --from-scratch` a model for it. Networks of D_L know no dance
(`--type`).
"""


def long_section(models: Sequence[dict[str, Any]], beside: Path | None = None) -> list[str]:
    """Return the section of long roll-outs: how many of each model hold.

    With the folder of the page also a table and the note of each model, and the contact sheet that lies there.
    """
    if not models:
        return []
    holding = [sum(facts["holds"] for facts in each["rollouts"]) for each in models]
    rows = [(m["model"], f"{n} of {len(m['rollouts'])}") for m, n in zip(models, holding, strict=True)]
    parts = [LONG.format(apart=APART), markdown(Table("Roll-outs that hold", ("model", "hold"), rows))]
    if beside is None:
        return parts
    for each in models:
        facts = tuple(long_row(facts) for facts in each["rollouts"])
        title = f"{each['model']}, {each['steps']} training steps in its last run"
        parts.append(markdown(Table(title, LONG_HEADER, facts)))
        sheet = sheet_name(each["model"])
        if (beside / sheet).exists():
            parts.append(f"![Roll-outs of {each['model']}, a pose every second]({sheet})\n")
        if each.get("note"):
            parts.append(f"{each['note']}\n")
    return parts


BODIES = """## Skeleton control

The control signal c^s holds the performer's body in its rest pose (paper section 3). Here one recording is continued
with the bodies of {count} performers in that signal, all else equal. The body is measured in the predicted joint
positions, in cm, after the initial frames have left the receptive field; steps are the largest distance between the
ankles in a second. `motionkit experiment bodies MODEL` makes the table.
"""


def bodies_section(models: Sequence[dict[str, Any]], with_tables: bool = True) -> list[str]:
    """Return the section of the skeleton control signal: how far each model follows it, and a table for each."""
    if not models:
        return []
    shares_of_models = [slopes(each["performers"]) for each in models]
    rows = [
        (f"{m['model']}, {m['type']}, {m['seeds']} seeds", *(f"{share:.2f}" for share in shares.values()))
        for m, shares in zip(models, shares_of_models, strict=True)
    ]
    title = "How much of a difference between performers is made (least squares; 1 is all)"
    parts = [BODIES.format(count=len(models[0]["performers"]))]
    parts.append(markdown(Table(title, ("model", *shares_of_models[0]), rows)))
    for each in models if with_tables else ():
        title = f"{each['model']}, {each['steps']} training steps in its last run: {each['type']}"
        performers = tuple(bodies_row(row) for row in each["performers"])
        parts.append(markdown(Table(title, BODIES_HEADER, performers)))
    return parts


LEARNT = """Each variant is compared with TPTN seed by seed on held-out clips, because the same seed sees the same
windows (but of w/o-OS, which cuts others). A cell is the variant's figure minus TPTN's, t of a two-sided paired t-test
over seeds, and its p, corrected by Holm over the variants of the column; bold is p below 0.05. Less is better in

- **likelihood**: the negative log-likelihood per frame;
- **error**: the error of the mean one frame ahead, each block of features as a share of that of repeating the last
  frame;
- **open loop**: the distance of joints over a second of roll-outs by mean, in cm.

BM or AFS of roll-outs by mean decides whether bodies move less or feet slide. A claim **agrees** or **does not agree**
where a measure tells and none tells otherwise; else it **cannot be told**. Networks with ten seeds got the last five
after the first had been read, so chance may decide one of them more easily than p says. Verdicts hold for the training
below. There Muon trains the matrices within the layers of part transformers, nine tenths of their weights, and AdamW
all else: also LSTMs and the networks of other papers, so that differences from these are of the optimizer, too.
"""
SUMMARY_TABLES = "Networks of other papers, and floors"


@dataclass(frozen=True)
class Extras:
    """What stands on the page beside the tables: the results of scenes, long roll-outs and bodies, by model."""

    scenes: tuple[dict[str, Any], ...] = ()
    long: tuple[dict[str, Any], ...] = ()
    bodies: tuple[dict[str, Any], ...] = ()


def page(results: Results, extras: Extras | None = None, path: Path = Path("docs/experiments.md")) -> str:
    """Return the page at a path: the budget with most training on the small data set, and results of single models."""
    extras = extras or Extras()
    main = _most_trained(results)
    here = [result for result in results if result["folder"] == main]
    parts = [HEAD.format(tables=tables_path(path).name), *_claims(here), *_what_was_run(here)]
    others = [f"`{folder}`" for folder in protocol_folders(results) if folder != main]
    parts += [f"The same was run in {', '.join(others)}.\n"] if others else []
    parts += ["## What this can tell\n", LIMITS, *_findings(here, results)]
    parts += [markdown(table) for table in tables(here) if table.title.startswith(SUMMARY_TABLES)]
    parts += [*scenes_section(extras.scenes, path.parent), *long_section(extras.long)]
    return "\n".join([*parts, *bodies_section(extras.bodies, with_tables=False), RUN])


def tables_page(
    results: Results, extras: Extras | None = None, path: Path = Path("docs/experiments.md")
) -> str:
    """Return the file of tables beside the page: all data sets and budgets; arguments as of page."""
    extras = extras or Extras()
    parts = [TABLES_HEAD.format(page=path.name), *_claims(results), *_what_was_run(results)]
    parts += ["## What this can tell\n", *_findings(results, results)]
    parts += ["## Tables\n", *(markdown(table) for table in tables(results))]
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
    parts = ["## What was trained\n", *(f"- {line}" for line in budget_lines(results)), ""]
    for folder in protocol_folders(results):
        lacking = missing(results, folder)
        if not any(r.get("parameters") for r in results if r["folder"] == folder):
            parts.append(f"No network has been trained in `{folder}` yet.\n")
        elif lacking:
            parts.append(f"Not run yet in `{folder}`: {', '.join(lacking)}.\n")
    return parts


def _claims(results: Results) -> list[str]:
    """The section of verdicts; nothing where no result is of the paper's small data set, which its claims are of."""
    parts = []
    for folder in protocol_folders(results):
        here = [result for result in results if result["folder"] == folder]
        if here[0]["data"] == "D_L":
            table = claims_table(here, f"The paper's claims: `{folder}`")
            parts += [markdown(table), f"{counts(here)}\n"] if table.rows else []
    return ["## Verdicts\n", *parts, LEARNT] if parts else []


def _findings(here: Results, results: Results) -> list[str]:
    return [*(f"- {line}" for line in (*findings(here), *by_budget(results))), ""]


def write_page(
    results: Results, path: Path, latex_path: Path | None = None, extras: Extras | None = None
) -> None:
    """Write the page, its tables beside it, and these in LaTeX if a path is given, all whole or none."""
    texts = {path: page(results, extras, path), tables_path(path): tables_page(results, extras, path)}
    if latex_path is not None:
        texts[latex_path] = "\n".join(latex(table) for table in tables(results))
    write_together({target: text.encode() for target, text in texts.items()})
