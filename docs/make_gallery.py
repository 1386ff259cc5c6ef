"""Writes the gallery: a loop of every type, of paths and of transitions, each with the command that made it.

    python docs/make_gallery.py FOLDER

The site's build runs it. The loops are made here, by the bundled model, and play in the page: all share one copy of the
player and of the body, and each is a frame that is filled when it comes into sight.
"""

from __future__ import annotations

import html
import json
import shlex
import sys
import tempfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from motionkit.cli.main import cli
from motionkit.models.bundled import BUNDLED_MODEL, load_bundled_model
from motionkit.models.motion_type import MotionKind
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.rig.upright import in_metres
from motionkit.view.figure_data import MotionView, figure_data, rig_data
from motionkit.view.viewer import page_asset

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 4  # of a type that goes on as long as one likes
PATHS = (
    ("Circle, running", "circle --types running"),
    ("Figure-eight, walking", "figure-eight --types walking"),
    ("Square, walking", "square --types walking"),
)
TRANSITIONS = (
    ("Walk, cartwheel, walk", "walking:2,cartwheel,walking:2"),
    ("Run, stop, dance", "running:2,idle:1,dance-salsa:4"),
    ("Kick, punch, backflip", "kicking:2,punching:2,backflip"),
)
RIGS = (
    ("Walk and punch on the rig of a CMU file", "walking:2,punching:2", "examples/data/49_06.bvh"),
    ("Salsa on the rig of another person", "dance-salsa:4", "examples/data/16_05.bvh"),
)
HEAD = """# Gallery

Made by the bundled model while this site was built, nothing chosen by hand: each loop is what its command writes. A
click pauses, dragging looks around.
"""


@dataclass(frozen=True)
class Loop:
    """A loop: its name, its section, and the words after `motionkit` that make it."""

    name: str
    section: str
    words: str

    @property
    def key(self) -> str:
        return "".join(letter if letter.isalnum() else "-" for letter in self.name.lower())


def loops() -> list[Loop]:
    """All loops, types first."""
    types = load_bundled_model().types
    made = [Loop(name, "Types", f"synthesize --types {_asked(name, kind)}") for name, kind in types.items()]
    made += [Loop(name, "Transitions", f"synthesize --types {words}") for name, words in TRANSITIONS]
    made += [Loop(name, "Own rigs", f"synthesize --types {words} --rig {rig}") for name, words, rig in RIGS]
    return made + [Loop(name, "Paths", f"follow-path {words}") for name, words in PATHS]


def _asked(name: str, kind: Any) -> str:
    return name if kind.kind is MotionKind.PERFORMANCE else f"{name}:{SECONDS}"


def make_gallery(folder: Path) -> None:
    """Write gallery.md and static/gallery/*.js into a folder; loops of the same model and code are kept."""
    scripts = folder / "static" / "gallery"
    scripts.mkdir(parents=True, exist_ok=True)
    every, page, stamp = loops(), page_asset("view.html"), scripts / "made-of.txt"
    made_of = sha256(BUNDLED_MODEL.read_bytes() + page.encode() + Path(__file__).read_bytes()).hexdigest()
    (folder / "gallery.md").write_text(_page(every), "utf-8")
    if stamp.exists() and stamp.read_text("utf-8") == made_of:
        return
    rig: dict[str, Any] = {}
    for loop in every:
        shown = _make(loop)
        rig = rig or rig_data(in_metres(shown.motion).motion)
        data = {name: value for name, value in figure_data(shown).items() if rig.get(name) != value}
        (scripts / f"{loop.key}.js").write_text(
            f"loopData({json.dumps(loop.key)}, {_text(data)});\n", "utf-8"
        )
    (scripts / "player.js").write_text(f"const PAGE = {_text(page)}, RIG = {_text(rig)};\n{PLAYER}", "utf-8")
    stamp.write_text(made_of, "utf-8")


def _text(value: Any) -> str:
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def _make(loop: Loop) -> MotionView:
    """The motion that a loop's command writes."""
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "loop.bvh"
        done = CliRunner().invoke(
            cli, [*shlex.split(loop.words.replace("examples/", f"{ROOT}/examples/")), "-o", str(file)]
        )
        if done.exit_code != 0:
            raise RuntimeError(f"motionkit {loop.words}: {done.output or done.exception}")
        return MotionView(loop.name, bvh_to_motion(read_bvh(file)))


def _page(every: list[Loop]) -> str:
    lines = [HEAD]
    for section in dict.fromkeys(loop.section for loop in every):
        lines += [f"## {section}", "", '<div class="loops">']
        for loop in every:
            if loop.section == section:
                lines.append(
                    f'<div class="loop"><iframe class="screen" data-loop="{loop.key}" title="{html.escape(loop.name)}, '
                    f'a loop" loading="lazy"></iframe><h3>{html.escape(loop.name)}</h3>'
                    f"<pre>motionkit {html.escape(loop.words)}</pre></div>"
                )
        lines += ["</div>", ""]
    lines += ['<script src="../_static/gallery/player.js"></script>', ""]
    return "\n".join(lines)


# Fills the frames that are in sight, and empties those that are not: a browser draws in a few of them at a time only.
PLAYER = """
const waiting = new Map();
window.loopData = (key, data) => waiting.get(key)?.(data);
const here = document.currentScript.src.replace(/[^/]*$/, "");
const clips = {};
const clip = (key) => (clips[key] ??= new Promise((done) => {
  waiting.set(key, done);
  document.head.append(Object.assign(document.createElement("script"), { src: `${here}${key}.js` }));
}));
const dark = matchMedia("(prefers-color-scheme: dark)");
const theme = () => {
  const chosen = document.body.dataset.theme;
  return chosen === "light" || chosen === "dark" ? chosen : dark.matches ? "dark" : "light";
};
async function fill(frame) {
  const motion = { ...RIG, ...(await clip(frame.dataset.loop)) };
  if (!frame.inSight) return;
  const data = JSON.stringify({ title: motion.name, bare: true, theme: theme(), motions: [motion] });
  frame.srcdoc = PAGE.replace("__DATA__", () => data.replaceAll("<", "\\\\u003c"));
}
const sight = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (target.inSight === isIntersecting) continue;
    target.inSight = isIntersecting;
    if (isIntersecting) fill(target);
    else target.srcdoc = "";
  }
}, { threshold: 0.15 });
const frames = document.querySelectorAll("iframe[data-loop]");
frames.forEach((frame) => sight.observe(frame));
const again = () => frames.forEach((frame) => frame.inSight && fill(frame));
new MutationObserver(again).observe(document.body, { attributeFilter: ["data-theme"] });
"""

if __name__ == "__main__":
    make_gallery(Path(sys.argv[1]))
