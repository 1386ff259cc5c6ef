"""The page of a user study (paper section 5.4): blind, shuffled clips beside the recording, ranked and rated."""

from __future__ import annotations

import base64
import html
import json
import random
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.files import atomic_write, files_below
from motionkit.lab.paper.ttest import FORMAT
from motionkit.rig.canonical import load_canonical
from motionkit.view.figure_data import MotionView
from motionkit.view.viewer import viewer_page

RECORDING = "recording"
ASPECTS = (
    "the type of motion is the recording's",
    "poses are natural",
    "movement is smooth, without jitter",
    "feet do not slide or sink",
    "the way over the ground is the recording's",
)


def write_study(folder: Path, output: Path, seed: int = 0) -> int:
    """Write the page of the groups in a folder, and return how many there are.

    Args:
        folder: one folder per group, with recording.bvh and a BVH file per model.

    Raises:
        MotionkitError: there are no groups, one lacks its recording, two have different models, or two files of a
            group have the same name.
    """
    groups = sorted(path for path in folder.iterdir() if path.is_dir() and not _hidden(path, folder))
    if not groups:
        raise MotionkitError(
            f"{folder}: no groups, expected folders with {RECORDING}.bvh and a BVH file per model"
        )
    shuffled = random.Random(seed)
    sections, orders = [], {}
    models: list[str] | None = None
    for group in groups:
        files = _files(group)
        names = sorted(set(files) - {RECORDING})
        if RECORDING not in files or not names:
            raise MotionkitError(f"{group}: expected {RECORDING}.bvh and at least one model's BVH file")
        if models is not None and names != models:
            raise MotionkitError(f"{group}: has {', '.join(names)}, the groups before {', '.join(models)}")
        models = names
        order = shuffled.sample(names, len(names))
        orders[group.name] = order
        sections.append(_section(group.name, files, order))
    page = _PAGE.replace("__GROUPS__", "\n".join(sections))
    # A rater who looks at the page's source reads no names.
    hidden = base64.b64encode(json.dumps(orders).encode()).decode()
    facts = json.dumps({"format": FORMAT, "orders": hidden, "aspects": list(ASPECTS)})
    with atomic_write(output, "w") as out:
        out.write(page.replace("__FACTS__", facts))
    return len(groups)


def _files(group: Path) -> dict[str, Path]:
    """The BVH files of a group by name, the recording's in lower case; hidden files are not seen."""
    out: dict[str, Path] = {}
    for path in files_below(group, ".bvh"):
        if _hidden(path, group):
            continue
        name = RECORDING if path.stem.lower() == RECORDING else path.stem
        if name in out:
            raise MotionkitError(f"{path}: has the name of {out[name]}; each model of a group is one file")
        out[name] = path
    return out


def _hidden(path: Path, folder: Path) -> bool:
    """Whether a path below a folder is hidden or in a hidden folder, as .git is."""
    return any(part.startswith(".") for part in path.relative_to(folder).parts)


def _section(name: str, files: dict[str, Path], order: list[str]) -> str:
    letters = [chr(ord("A") + i) for i in range(len(order))]
    clips = [("recording", files[RECORDING]), *zip(letters, (files[n] for n in order), strict=True)]
    frames = []
    for title, path in clips:
        view = viewer_page([MotionView(title, load_canonical(path)[0])], title, bare=True)
        escaped = html.escape(view, quote=True)
        frames.append(
            f'<figure><iframe loading="lazy" srcdoc="{escaped}"></iframe><figcaption>{title}</figcaption></figure>'
        )
    ranks = "".join(f"<option>{i + 1}</option>" for i in range(len(order)))
    scores = "".join(f"<option>{i}</option>" for i in range(1, 6))
    rows = "".join(
        f"<tr><th>{text}</th>"
        + "".join(
            f'<td><select data-rank="{i}" data-clip="{c}"><option></option>{ranks}</select></td>'
            for c in range(len(order))
        )
        + "</tr>"
        for i, text in enumerate(ASPECTS)
    )
    overall = "".join(
        f'<td><select data-score data-clip="{c}"><option></option>{scores}</select></td>'
        for c in range(len(order))
    )
    head = "".join(f"<th>{letter}</th>" for letter in letters)
    return (
        f'<section data-group="{html.escape(name, quote=True)}"><div class="clips">{"".join(frames)}</div>'
        f"<table><tr><th>Rank (1 is best): </th>{head}</tr>{rows}"
        f"<tr><th>Overall, from 1 (poor) to 5 (good)</th>{overall}</tr></table></section>"
    )


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Study of synthesized motion</title><style>
body{font:16px/1.5 system-ui,sans-serif;margin:1.5rem auto;max-width:1200px;padding:0 1rem;color:#222}
.clips{display:grid;grid-template-columns:repeat(auto-fit,minmax(220px,1fr));gap:.6rem}
figure{margin:0}iframe{width:100%;height:260px;border:1px solid #ccc}figcaption{text-align:center;font-weight:600}
section{margin:2rem 0;padding-bottom:1rem;border-bottom:1px solid #ccc}table{margin-top:.8rem;border-collapse:collapse}
th{text-align:left;font-weight:400;padding:.15rem .8rem .15rem 0}.missing{outline:2px solid #c44e24}
</style></head><body>
<h1>Study of synthesized motion</h1>
<p>Each group shows a recording and, in random order and without their names, what several programs made of its first
frames. A click on a clip plays or pauses it. Rank the programs in each row, then score each from 1 to 5.</p>
__GROUPS__
<p><label>Your name or initials <input id="rater" maxlength="40"></label>
<button id="save">Save answers</button> <span id="said" role="status"></span></p>
<script>
const facts = __FACTS__;
document.getElementById("save").addEventListener("click", () => {
  let missing = 0;
  for (const box of document.querySelectorAll("select")) {
    box.classList.toggle("missing", !box.value);
    missing += !box.value;
  }
  const said = document.getElementById("said");
  const rater = document.getElementById("rater").value.trim();
  if (!rater) { said.textContent = "your name or initials are missing"; return; }
  if (missing) { said.textContent = missing === 1 ? "1 box is empty" : missing + " boxes are empty"; return; }
  const answers = [];
  const orders = JSON.parse(new TextDecoder().decode(Uint8Array.from(atob(facts.orders), c => c.charCodeAt(0))));
  for (const section of document.querySelectorAll("section")) {
    const group = section.dataset.group;
    orders[group].forEach((model, clip) => {
      const ranks = facts.aspects.map((_, i) =>
        Number(section.querySelector(`[data-rank="${i}"][data-clip="${clip}"]`).value));
      const score = Number(section.querySelector(`[data-score][data-clip="${clip}"]`).value);
      answers.push({group, model, score, ranks});
    });
  }
  const text = JSON.stringify({format: facts.format, rater, aspects: facts.aspects, answers}, null, 1);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], {type: "application/json"}));
  link.download = `answers-${rater.replace(/[^\\p{L}\\p{N}_-]+/gu, "-")}.json`;
  link.click();
  said.textContent = "saved " + link.download;
});
</script></body></html>
"""
