"""docs/experiments.md, written from the results in a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motionkit.files import atomic_write
from motionkit.lab.paper.bodies import BODIES_HEADER, bodies_row, slopes
from motionkit.lab.paper.claims import claims_table
from motionkit.lab.paper.findings import findings
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

The paper's experiments on free motion: `motionkit experiment` trains its network, every variant and the networks of
other papers alike, rolls them out on test sequences, and writes these tables. This page is written by
`motionkit experiment tables` from the results in `experiments/results`; no figure on it is typed in.

```text
motionkit preprocess cmu/ --labels docs/free-cmu-labels.csv --layout expmap-root-1 --own-bodies --raw -o datasets/paper
motionkit experiment run all --data datasets/paper --seeds 3 # continues where it was stopped
motionkit experiment tables
```

**How to read them.** Each cell is the mean over seeds, ± the standard deviation over seeds where there are two or
more, and in brackets the paper's figure, which was measured on the paper's own data after its own training (2000
epochs; table 3 on the data of PFNN). The command above takes the default budget and all frames of the test sequences;
those of the tables below stand beside their budgets. Bold is a best value that is better by more than the spread over
seeds; with one seed nothing is bold. BM is best where it is nearest to the recorded one. Networks are drawn at full
sigma, from 87 initial frames (30 where a sequence is short), with the types, trajectory and skeleton of the test
sequence, without foot IK, reference poses, velocity blending or corrections.
Metrics are those of [metrics.md](metrics.md): `bm-euler`, `afs`, `ssim-channel`, `mpjpe`, `path-mean`.
The table of the shipped model has it with all that surrounds it: reference poses, sampling presets, corrections and
foot locks, and follows the trajectory where it lies on the ground; it leaves out test sequences that are mirror
images of training clips.
`fid-pose` and diversity work on windows of a second, described by mean and deviation of the pose embedding.
"""


SCENES = """## The paper's figures 1 and 5 to 9

`motionkit experiment scenes --seeds 3` makes what these figures show, with any model (`--model`). The paper gives its
paths as pictures alone: types and shapes are those of the paper, lengths are chosen to suit the recordings, so the
distances are of like paths and not of the same. Each distance is the mean over frames from the root's place on the
ground to the nearest point of the path, ± the standard deviation over seeds. Feet are not held; in the paper they are
unless it says otherwise, as it does of figure 9. The shipped model uses its reference poses. `python
docs/make_scenes.py` draws the pictures below.
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
    return parts


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
network's own prediction, fed back, and frames are drawn at full sigma. Each roll-out is measured in four parts: the
distance of its poses to the nearest pose in the training clips of the type (root mean square over joints, in the
heading frame), how far the feet swing about their mean place under the body, and the speed over the ground, beside
those of the held-out recording. It holds where no part is {apart:g} times as far from the training clips as the
recording is, its feet swing between half and {apart:g} times as far, and it goes no faster than the fastest five
seconds of its type in the training clips. `motionkit experiment long MODEL` makes them, and `motionkit train
datasets/paper --preset tptn-paper --budget medium --batch 8 --minutes 200 --trajectory-drift 0.15 --from-scratch` a
model for it, of all types. The paper has noise on the frames and says nothing of its control signals (section 4.3).
The networks of `experiment run` lie in experiments/checkpoints; those of D_L know no dance (`--type`).
"""


def long_section(models: Sequence[dict[str, Any]], beside: Path) -> list[str]:
    """Return the section of long roll-outs: a table for each model, and the contact sheet beside the page."""
    parts = [LONG.format(apart=APART)] if models else []
    for each in models:
        rows = tuple(long_row(facts) for facts in each["rollouts"])
        title = f"{each['model']}, {each['steps']} training steps in its last run"
        parts.append(markdown(Table(title, LONG_HEADER, rows)))
        if each.get("note"):
            parts.append(f"{each['note']}\n")
        held = sum(facts["holds"] for facts in each["rollouts"])
        parts.append(f"{held} of {len(rows)} roll-outs of {each['model']} hold.\n")
        sheet = sheet_name(each["model"])
        if (beside / sheet).exists():
            parts.append(f"![Roll-outs of {each['model']}, a pose every second]({sheet})\n")
    return parts


BODIES = """## Skeleton control

The control signal c^s holds the joints of the performer's body in its rest pose (paper section 3). Here one recording
is continued with the bodies of {count} performers in that signal, and with the same initial frames, types, trajectory
and seeds. The network predicts joint positions beside rotations, so what it takes the body to be is measured in
them, after the initial frames have left its receptive field; steps are the largest distance between the ankles in a
second. Beside it stand the performer's own recordings of the type, all in cm. `motionkit experiment bodies MODEL` makes
the table.
"""


def bodies_section(models: Sequence[dict[str, Any]]) -> list[str]:
    """Return the section of the skeleton control signal: a table for each model, and how far it is followed."""
    parts = [BODIES.format(count=len(models[0]["performers"]))] if models else []
    for each in models:
        shown = each["performers"]
        trained = f"{each['model']}, {each['steps']} training steps in its last run"
        title = f"{trained}: {each['type']}, {each['seeds']} seeds"
        parts.append(markdown(Table(title, BODIES_HEADER, tuple(bodies_row(row) for row in shown))))
        words = ", ".join(f"{name} {slope:.2f}" for name, slope in slopes(shown).items())
        parts.append(
            f"How much of a difference between performers is made (least squares; 1 is all): {words}.\n"
        )
    return parts


LEARNT = """A claim of the paper **agrees** or **does not agree** where its metric differs by more than twice the spread
over seeds, that of TPTN where the variant has one seed; else it **cannot be said**. Of sixteen claims some agree by
chance. BM is better the nearer it is to the recorded one, unless the claim is that the
variant moves less. The verdicts are computed, and hold for the training that the networks had here; the lines below
the tables say how little that is.
"""


@dataclass(frozen=True)
class Extras:
    """What stands on the page beside the tables: the results of scenes, long roll-outs and bodies, by model."""

    scenes: tuple[dict[str, Any], ...] = ()
    long: tuple[dict[str, Any], ...] = ()
    bodies: tuple[dict[str, Any], ...] = ()


def page(results: Results, extras: Extras | None = None, beside: Path = Path("docs")) -> str:
    """Return docs/experiments.md, with the pictures of scenes that lie beside it in a folder."""
    extras = extras or Extras()
    parts = [HEAD, "## What was run\n", *(f"- {line}" for line in budget_lines(results)), ""]
    for folder in protocol_folders(results):
        lacking = missing(results, folder)
        if not any(r.get("parameters") for r in results if r["folder"] == folder):
            parts.append(f"No network has been trained in `{folder}` yet.\n")
        elif lacking:
            parts.append(f"Not run yet in `{folder}`: {', '.join(lacking)}.\n")
    parts += ["## What is learnt\n", LEARNT]
    for folder in protocol_folders(results):
        here = [result for result in results if result["folder"] == folder]
        # They are of the small data set, and so are the figures beside them.
        if here[0]["data"] == "D_L":
            table = claims_table(here, f"The paper's claims: `{folder}`")
            parts += [markdown(table)] if table.rows else []
    parts += [*(f"- {line}" for line in findings(results)), "", "## Tables\n"]
    parts += [markdown(table) for table in tables(results)]
    parts += [*scenes_section(extras.scenes, beside), *long_section(extras.long, beside)]
    return "\n".join([*parts, *bodies_section(extras.bodies)])


def write_page(
    results: Results, path: Path, latex_path: Path | None = None, extras: Extras | None = None
) -> None:
    """Write the page, and all tables in LaTeX if a path is given, each whole or not at all."""
    with atomic_write(path, "w") as out:
        out.write(page(results, extras, path.parent))
    if latex_path is not None:
        with atomic_write(latex_path, "w") as out:
            out.write("\n".join(latex(table) for table in tables(results)))
