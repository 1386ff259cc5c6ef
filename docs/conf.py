"""How Sphinx makes the site out of these pages.

    pip install -e ".[docs]"
    python -m sphinx -W --keep-going docs docs/_build/html

The pages are Markdown as a code host shows it; what differs in the site is changed while it is built: pages of the
repository's root are taken in, links to what is no page lose their target, the API and the gallery are generated.
"""

from __future__ import annotations

import inspect
import re
import sys
from fnmatch import fnmatch
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
exclude_patterns = ["README.md", "_build", "_generated/static", "sheets"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = "motionkit"
html_static_path = ["_static", "_generated/static"]
html_css_files = ["site.css"]
html_copy_source = False
autodoc_typehints = "none"
napoleon_use_ivar = True
templates_path: list[str] = []

GENERATED = DOCS / "_generated"
(GENERATED / "static").mkdir(parents=True, exist_ok=True)
# Pages of the root that are taken in, and their names in the site.
ROOT_PAGES = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}
# Pages that code makes: elsewhere than in the site links lead to the code.
MADE_BY = {"make_gallery.py": "gallery.md", "conf.py": "api.md"}
LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s]+)\)")
# Pages that no section lists by hand: those of these names are tutorials, all others are how-to.
TUTORIALS = ("my-*", "experiments*")
UNKNOWN_LANGUAGES = {"csv": "text"}
# The picture of the demo, in whose place the site has the demo itself.
DEMO_PICTURE = "![The page, light and dark](demo.png)"
DEMO = '<iframe class="demo" src="_static/demo/index.html" title="The demo" allow="clipboard-write; gamepad"></iframe>'


def title(page: Path) -> str:
    """The first heading of a page."""
    return next(line[2:] for line in page.read_text("utf-8").splitlines() if line.startswith("# "))


def site_links(text: str, folder: Path, base: str) -> str:
    """The links of a page as the site has them.

    Args:
        text: Markdown.
        folder: where the page lies in the repository.
        base: from the page's place in the site to docs/: "" or "../".
    """

    def changed(found: re.Match[str]) -> str:
        label, target = found[1], found[2]
        if re.match(r"[a-z]+:|#", target):
            return found[0]
        name, hash_, fragment = target.partition("#")
        place = (folder / name).resolve()
        if place.parent == ROOT and place.name in ROOT_PAGES:
            return f"{label}({base}_generated/{ROOT_PAGES[place.name]}{hash_}{fragment})"
        if place.suffix == ".md" and label == f"[{place.name}]" and place.is_file():
            label = f"[{title(place)}]"  # a site has no files
        if place.parent == DOCS and place.name in MADE_BY:
            return f"{label}({base}_generated/{MADE_BY[place.name]})"
        if place in (ROOT / "README.md", DOCS / "README.md", DOCS):
            return f"{label}({base}index.md)"
        if DOCS in place.parents and place.suffix == ".md":
            return f"{label}({base}{place.relative_to(DOCS).as_posix()}{hash_}{fragment})"
        if DOCS in place.parents and place.is_file():
            return f"{label}({base}{place.relative_to(DOCS).as_posix()})"
        return label.removeprefix("!")[1:-1]  # code and folders are not part of the site

    return LINK.sub(changed, text)


def unlisted(tutorials: bool) -> list[str]:
    """Pages of docs that are in no list of pages yet."""
    listed = {
        word
        for page in DOCS.glob("[a-z]*.md")
        for word in re.findall(r"^[\w/-]+$", page.read_text("utf-8"), re.M)
    }
    names = sorted(page.stem for page in DOCS.glob("[a-z]*.md"))
    new = [name for name in names if name not in listed | {"index"}]
    return [name for name in new if any(fnmatch(name, pattern) for pattern in TUTORIALS) == tutorials]


def read_page(app: Any, name: str, source: list[str]) -> None:
    """Change a page's text before it is parsed."""
    if name.startswith("_generated/"):
        return
    text = site_links(source[0], DOCS, "")
    if app.config.motionkit_gallery:
        text = text.replace(DEMO_PICTURE, DEMO)
    for language, known in UNKNOWN_LANGUAGES.items():
        text = text.replace(f"```{language}\n", f"```{known}\n")
    if name in ("tutorials", "how-to") and (more := unlisted(name == "tutorials")):
        text += "\n```{toctree}\n" + "\n".join(more) + "\n```\n"
    source[0] = text


def write(name: str, text: str) -> None:
    """Write a generated page if it has changed, so that what has not is not built again."""
    path = GENERATED / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def generate(app: Any) -> None:
    """Write the pages that are made of code."""
    for source, name in ROOT_PAGES.items():
        write(name, site_links((ROOT / source).read_text("utf-8"), ROOT, "../"))
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
