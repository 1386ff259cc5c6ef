"""Every Python and console block in README.md and docs runs, page by page, in a folder that has the files it names."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import motionkit as mk
from motionkit.cli.main import cli
from motionkit.control.path import SHAPES
from motionkit.models.bundled import load_bundled_model
from motionkit.models.checkpoint import save_model
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import read_bvh, write_bvh
from rig.test_character import write as write_character
from rig.test_gltf_rig import character
from synthetic_rigs import FAMILIES, renamed, walk

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "examples" / "data"
ALL_PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "benchmarks" / "README.md"]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
# Budgets: the last value of an option counts, and training ends by steps or minutes, whichever is earlier.
TINY_RUN = "--preset tiny --steps 2 --batch 4 --window 32 --splices 4 --device cpu --force".split()
SMALL_EVALUATION = "--quick --seeds 1".split()


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of the fenced blocks of a page."""
    return BLOCK.findall(page.read_text("utf-8"))


PAGES = [page for page in ALL_PAGES if any(language in ("sh", "python") for language, _ in blocks(page))]


def commands(text: str) -> list[list[str]]:
    """The words of each command of a block, without comments."""
    lines = text.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


@pytest.fixture(scope="module")
def named_files(
    clips_folder: Path,
    tiny_model: MotionModel,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """A folder with the files that the pages name; not to be written to."""
    folder = tmp_path_factory.mktemp("named")
    for name in ("examples", "docs"):
        (folder / name).symlink_to(ROOT / name)
    for name in ("my-motion", "cmu"):
        shutil.copytree(clips_folder, folder / name)
    # The models and the datasets have the same reference rotations, as those of a reader have.
    model = replace(tiny_model, reference_rotations=load_bundled_model().reference_rotations)
    for name in ("free", "mine"):
        mk.preprocess([clips_folder], folder / "datasets" / name, mk.PreprocessOptions(jobs=1))
    (folder / "my-motion-model").mkdir()
    for name in ("mine.safetensors", "my-motion-model/model.safetensors"):
        save_model(folder / name, model)
    for name in ("walk", "truth", "made", "ground_truth", "generated"):
        shutil.copy(SAMPLE / "16_45.bvh", folder / f"{name}.bvh")
    write_bvh(folder / "my.bvh", renamed(walk(8), FAMILIES["unreal"]).scaled(0.01))
    write_character(folder / "hero.glb", character())
    (way,) = (text for language, text in blocks(ROOT / "docs" / "paths.md") if language == "json")
    for name in ("route", "way"):
        (folder / f"{name}.json").write_text(way)
    return folder


@pytest.fixture
def workplace(named_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder: a copy of the files that the pages name."""
    folder = Path(shutil.copytree(named_files, tmp_path / "work", symlinks=True))
    monkeypatch.chdir(folder)
    monkeypatch.setenv("CI", "1")  # opens no browser
    # Only that the commands of the pages work is shown here, not how long a graph equals motionkit.
    monkeypatch.setattr("motionkit.export.onnx_export.CHECK_FRAMES", 60)
    return folder


def run_command(words: list[str]) -> None:
    """Run a command of a page with a small budget; what installs or serves is only checked."""
    if words[:2] == ["pip", "install"]:
        extras = re.findall(r"\[([\w,]+)\]", " ".join(words))
        known = (ROOT / "pyproject.toml").read_text("utf-8")
        assert all(f"\n{extra} = [" in known for group in extras for extra in group.split(","))
        return
    only_check = words[0] == "torchrun" or words[1] in ("play", "quickstart") or "cmu/" in words
    if words[0] == "torchrun":
        words = ["motionkit", *words[words.index("motionkit") + 1 :]]
    assert words[0] == "motionkit", words
    name, arguments = words[1], words[2:]
    if only_check:
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        command.make_context(name, list(arguments))
        return
    arguments += {"train": TINY_RUN, "preprocess": ["--jobs", "1"]}.get(name, [])
    if "--count" in arguments:
        arguments += ["--count", "2"]
    if name == "follow-path" and arguments[0] in SHAPES:
        arguments += ["--size", "1"]
    if name == "evaluate":
        arguments += SMALL_EVALUATION
        arguments += [] if "--only" in arguments else ["--only", "reconstruction"]
    done = CliRunner().invoke(cli, [name, *arguments], catch_exceptions=False)
    assert done.exit_code == 0, f"{shlex.join(words)}\n{done.output}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
@pytest.mark.usefixtures("unscored")
def test_blocks_run(page: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["block", "examples/data"])
    names: dict[str, object] = {"__name__": "block"}
    for language, text in blocks(page):
        if language == "sh":
            for words in commands(text):
                run_command(words)
        elif language == "python" and "127.0.0.1" not in text:
            text = text.replace(
                'mk.fine_tune_options("tptn", minutes=5)',
                'mk.fine_tune_options("tptn", steps=2, splices=4, batch=2)',
            )
            exec(compile(text, str(page), "exec"), names)
    for made in workplace.glob("*.bvh"):
        assert len(read_bvh(made).values) > 1


def test_no_command_stands_outside_a_block() -> None:
    for page in ALL_PAGES:
        if page.name != "commands.md":
            text = BLOCK.sub("", page.read_text("utf-8"))
            assert not re.search(r"^    (motionkit|python|pip|torchrun) ", text, re.MULTILINE), page.name


def test_clients_of_the_live_page(tmp_path: Path) -> None:
    """The Python clients of live.md print frames of a server that runs."""
    serve = [sys.executable, "-m", "motionkit", "play", "--headless", "--port", "0", "--tcp", "0", "--json"]
    server = subprocess.Popen(serve, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=tmp_path)
    try:
        assert server.stdout is not None
        told = json.loads(server.stdout.readline())
        web, tcp = (int(address) for address in (told["url"].rstrip("/").rpartition(":")[2], told["tcp"][1]))
        clients = [text for language, text in blocks(ROOT / "docs" / "live.md") if language == "python"]
        assert len(clients) == 2
        for text in clients:
            code = re.sub("8642|8643", lambda found: str(web if found[0] == "8642" else tcp), text)
            command = [sys.executable, "-u", "-c", code]
            client = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            assert client.stdout is not None and client.stderr is not None
            try:
                first = client.stdout.readline()
                assert re.match(r"\d+ ", first), first or client.stderr.read()
            finally:
                client.kill()
                client.communicate()
    finally:
        server.terminate()
        server.communicate(timeout=30)


OLD_WORDS = re.compile(
    r"\b(guides?|outlines?|grip|footing|inertia|obedience|endurance|likeness|replay)\b", re.IGNORECASE
)
RECORDS = {"scoreboard"}


@pytest.mark.parametrize("page", [p for p in ALL_PAGES if p.stem not in RECORDS], ids=lambda page: page.stem)
def test_pages_use_the_fields_words(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text("utf-8"), flags=re.DOTALL)
    found = OLD_WORDS.findall(text)
    assert not found, f"{page.name}: {', '.join(sorted(set(found)))}"
