"""How Sphinx makes the site out of these pages.

    pip install -e ".[docs]"
    python -m sphinx -W --keep-going docs docs/_build/html

The pages are Markdown as a code host shows it. What differs in the site is changed while it is built. Links to what
is no page lead to the repository, if MOTIONKIT_URL is its address, or lose their target. The tables of the first page
become the menu. The API and the gallery are generated.
"""

from __future__ import annotations

import inspect
import os
import re
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS))

from docutils.nodes import SkipNode  # noqa: E402
from latex2mathml.converter import convert  # noqa: E402

import motionkit  # noqa: E402
from motionkit.models.bundled import load_bundled_model  # noqa: E402
from motionkit.play.demo import write_demo  # noqa: E402

project = "motionkit"
author = "the motionkit authors"
copyright = f"2026, {author}"
version = release = motionkit.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"  # browsers draw MathML: no script, and nothing from elsewhere
# Pages for people who change the code, and what scripts wrote: they are read in the repository.
REPOSITORY_PAGES = ("architecture.md", "results-log.md", "scoreboard.md", "experiments-tables.md")
exclude_patterns = [*REPOSITORY_PAGES, "_build", "_generated/static", "sheets"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = "motionkit"
html_static_path = ["_static", "_generated/static"]
html_css_files = ["site.css"]
html_copy_source = False
smartquotes_action = "qe"  # no dashes: --option stays as it is typed
autodoc_typehints = "none"
napoleon_use_ivar = True
templates_path: list[str] = []

GENERATED = DOCS / "_generated"
(GENERATED / "static").mkdir(parents=True, exist_ok=True)
REPOSITORY = os.environ.get("MOTIONKIT_URL", "").rstrip("/")
# Pages that code makes: elsewhere than in the site links lead to the code.
MADE_BY = {"make_gallery.py": "gallery.md", "conf.py": "api.md"}
LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s]+)\)")
ROW = re.compile(r"^\| \[[^\]]*\]\(([\w/-]+)\.md\)", re.M)  # of a table of pages
UNKNOWN_LANGUAGES = {"csv": "text"}
# The picture of the demo, in whose place the site has the demo itself.
DEMO_PICTURE = "![The page, light and dark](demo.png)"
DEMO = '<iframe class="demo" src="_static/demo/index.html" title="The demo" allow="clipboard-write; gamepad"></iframe>'


def title(page: Path) -> str:
    """The first heading of a page."""
    return next(line[2:] for line in page.read_text("utf-8").splitlines() if line.startswith("# "))


def site_links(text: str) -> str:
    """The links of a page as the site has them."""

    def changed(found: re.Match[str]) -> str:
        label, target = found[1], found[2]
        if re.match(r"[a-z]+:|#", target):
            return found[0]
        name, hash_, fragment = target.partition("#")
        place = (DOCS / name).resolve()
        if place.parent == DOCS and place.name in MADE_BY:
            return f"{label}(_generated/{MADE_BY[place.name]})"
        if place.name in REPOSITORY_PAGES or DOCS not in place.parents or not place.is_file():
            return repository_link(label.removeprefix("!")[1:-1], place)
        if place.suffix == ".md" and label == f"[{place.name}]":
            label = f"[{title(place)}]"  # a site has no files
        return f"{label}({place.relative_to(DOCS).as_posix()}{hash_}{fragment})"

    return LINK.sub(changed, text)


def repository_link(label: str, place: Path) -> str:
    """A link to what is no page of the site; words, where the address of the repository is not known."""
    path = place.relative_to(ROOT).as_posix()
    label = f"`{path}`" if label == place.name else label
    return f"[{label}]({REPOSITORY}/blob/main/{path})" if REPOSITORY else label


def menu(text: str) -> str:
    """The hidden tables of contents of the first page: a part for each of its sections that is a table of pages."""
    lines = []
    for section in text.split("\n## ")[1:]:
        if names := ROW.findall(section):
            caption = section.partition("\n")[0]
            lines += ["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *names, "```"]
    return "\n".join([*lines, ""])


def read_page(app: Any, name: str, source: list[str]) -> None:
    """Change a page's text before it is parsed."""
    if name.startswith("_generated/"):
        return
    text = site_links(source[0])
    if app.config.motionkit_gallery:
        text = text.replace(DEMO_PICTURE, DEMO)
    for language, known in UNKNOWN_LANGUAGES.items():
        text = text.replace(f"```{language}\n", f"```{known}\n")
    source[0] = text + (menu(text) if name == "index" else "")


def write(name: str, text: str) -> None:
    """Write a generated page if it has changed, so that what has not is not built again."""
    path = GENERATED / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def generate(app: Any) -> None:
    """Write the pages that are made of code, and remove those of former builds."""
    for page in GENERATED.glob("*.md"):
        if page.name not in MADE_BY.values():
            page.unlink()
    write("api.md", api_page())
    if app.config.motionkit_gallery:
        from make_gallery import make_gallery

        make_gallery(GENERATED)
        write_demo(GENERATED / "static" / "demo", load_bundled_model())
    else:
        write("gallery.md", "# Gallery\n\nLeft out of this build.\n")


def api_page() -> str:
    """The public names of `import motionkit as mk`, from their docstrings."""
    functions, classes, lacking = [], [], []
    for name in sorted(set(motionkit.__all__) - {"__version__"}, key=str.lower):
        try:
            found = getattr(motionkit, name)
        except motionkit.MotionkitError:  # an extra that this build does without
            lacking.append(name)
            continue
        (classes if inspect.isclass(found) else functions).append(name)
    lines = [
        "# Python API",
        "",
        "`import motionkit as mk` imports nothing else; each name brings its module when it is first used. This",
        "page is made of the docstrings.",
        "",
    ]
    for title, directive, names in (
        ("Functions", "autofunction", functions),
        ("Classes", "autoclass", classes),
    ):
        lines += [f"## {title}", ""]
        for name in names:
            lines += ["```{eval-rst}", f".. {directive}:: motionkit.{name}"]
            if directive == "autoclass":
                lines += ["   :members:", "   :member-order: bysource"]
            lines += ["```", ""]
    if lacking:
        listed = ", ".join(f"`{name}`" for name in lacking)
        lines += [
            "## With torch",
            "",
            f"This site was built without torch, which {listed} need to be described.",
            "",
        ]
    return "\n".join(lines)


def write_formula(page: Any, node: Any) -> None:
    """Write a formula in the text as MathML."""
    page.body.append(convert(node.astext()))
    raise SkipNode


def write_block_formula(page: Any, node: Any) -> None:
    """Write a formula with lines of its own as MathML."""
    page.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
    raise SkipNode


def setup(app: Any) -> None:
    """Connect the above to Sphinx; `-D motionkit_gallery=0` leaves gallery and demo out."""
    app.add_config_value("motionkit_gallery", True, "env", types=(bool, int, str))
    app.add_html_math_renderer("mathml", (write_formula, None), (write_block_formula, None))
    app.connect("builder-inited", generate)
    app.connect("source-read", read_page)
