"""Output of commands: the file of -o, the page of --view, and results as text or JSON."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import PLACE, print_json, remark, stderr_console, stdout_console, together
from motionkit.cli.showing import open_in_browser
from motionkit.errors import MotionkitError
from motionkit.files import check_outputs, safe_name
from motionkit.names import counted

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.export.clip import Clip
    from motionkit.motion.motion import Motion
    from motionkit.view.figure_data import MotionView

FORMATS = (
    "bvh",
    "glb",
    "fbx",
    "vrm",
    "vrma",
    "usda",
    "npz",
    "csv",
)  # as in export.formats, which is slow to import
ENDINGS = f"{', '.join(f'.{name}' for name in FORMATS[:-1])} or .{FORMATS[-1]}"
NAMED = (".glb", ".vrm", ".vrma")  # endings of files with named animations
STDOUT = Path("-")
READ_AS = "motionkit.taken"  # in the meta of a command's context: how its clips were read

view_option = click.option(
    "--view", is_flag=True, help="Also write a web page that plays the motion, and open it."
)
BODIES = ("adult", "woman", "heavy")  # as in view.asset, which is slow to import


def body_option(where: str) -> Callable:
    """The --body option of commands that write a body."""
    text = f"Body that human rigs get in {where}; {BODIES[0]} by default, or that of a .glb of motionkit."
    return click.option("--body", type=click.Choice(BODIES), help=text)


animation_options = together(
    click.option(
        "--name", help="Name of the animation in a .glb or .vrm; by default from the types or the clip."
    ),
    click.option(
        "--replace",
        "alone",
        is_flag=True,
        help="Remove the animations already in the .glb or .vrm; by default they stay beside the new one.",
    ),
)


def checked_ending(context: click.Context, parameter: click.Parameter, value: Path | None) -> Path | None:
    """Refuse an output with an unknown ending, before any work; "-" is standard output."""
    if value is None or value == STDOUT:
        return value
    from motionkit.export.formats import check_ending

    try:
        check_ending(value)
    except MotionkitError as error:
        raise click.BadParameter(str(error)) from None
    return value


def output_option(text: str) -> Callable:
    """The -o option of commands that write a motion, to a file or as BVH to standard output."""
    text = f"{text}. The ending chooses the format: {ENDINGS}; - writes BVH to standard output."
    return click.option("-o", "--output", type=PLACE, callback=checked_ending, help=text)


def clip_output_option(word: str, clip: str = "CLIP") -> Callable:
    """The -o option of commands that take a clip or a folder; the default is CLIP-word.bvh in the current folder."""
    text = f"File to write: {ENDINGS}; {clip}-{word}.bvh by default. A folder if {clip} is one."
    return click.option("-o", "--output", type=PLACE, help=text)


def default_output(
    name: str, ending: str = ".bvh", files: Callable[[Path], Sequence[Path]] = lambda path: [path]
) -> Path:
    """A file name in the current folder that is not taken yet; `files` lists the files that a name stands for."""
    name = safe_name(name, 120)
    path = Path(f"{name}{ending}")
    number = 2
    while any(file.exists() for file in files(path)):
        path, number = Path(f"{name}-{number}{ending}"), number + 1
    return path


@dataclass(frozen=True)
class OutputOptions:
    """The options -o, --view and --json, --name and --replace."""

    output: Path | None
    view: bool
    as_json: bool
    name: str | None = None
    alone: bool = False

    def check(self, count: int = 1) -> None:
        """Raise UsageError for options that BVH on standard output excludes."""
        others = {"--view": self.view, "--json": self.as_json, f"{count} motions": count > 1}
        for name in (name for name, used in others.items() if used and self.output == STDOUT):
            raise click.UsageError(
                f"{name} cannot be combined with standard output (-), which gets one motion"
            )

    def files(
        self,
        name: str,
        inputs: Iterable[str | Path | None],
        count: int = 1,
        also: Sequence[Path] = (),
        ending: str = ".bvh",
    ) -> Outputs:
        """The files to write; several are numbered. Checks that they can be written and overwrite no input.

        Args:
            name, ending: file name without -o.
            inputs: files to read; None entries are ignored.
            count: number of motions.
            also: other files to write.
        """

        def motions(base: Path) -> list[Path]:
            width = len(str(count))
            numbers = [""] if count == 1 else [f"-{number:0{width}}" for number in range(1, count + 1)]
            return [base.with_name(f"{base.stem}{number}{base.suffix}") for number in numbers]

        def everything(base: Path) -> list[Path]:
            return motions(base) + ([base.with_suffix(".html")] if self.view else [])

        if self.output == STDOUT:
            check_outputs(also, inputs)
            return Outputs((STDOUT,), None, self.as_json)
        inputs = list(inputs)
        if self.output is not None and self.output.suffix.lower() == ".vrm":
            if not any(Path(path).suffix.lower() == ".vrm" for path in inputs if path is not None):
                raise click.UsageError(
                    "a .vrm is an avatar: give one with --rig avatar.vrm, or write its animation as .vrma"
                )
        base = self.output or default_output(name, ending, everything)
        check_outputs([*everything(base), *also], inputs)
        if base.suffix.lower() not in NAMED:
            flags = [flag for flag, used in {"--name": self.name, "--replace": self.alone}.items() if used]
            if flags:
                remark(f"{' and '.join(flags)} left out: {base.name} has no named animations")
        page = base.with_suffix(".html") if self.view else None
        replaced = tuple(path for path in (*everything(base), *also) if path.exists())
        return Outputs(tuple(motions(base)), page, self.as_json, replaced, self.name, self.alone)


@dataclass(frozen=True)
class Outputs:
    """The files that a command writes.

    Attributes:
        files: motion files; "-" is standard output.
        page: the page of --view, or None.
        as_json: print JSON, and do not open a browser.
        replaced: those that were there before.
        name: name of the animation; None for that of the clip.
        alone: without the other animations of the character's file.
    """

    files: tuple[Path, ...]
    page: Path | None
    as_json: bool
    replaced: tuple[Path, ...] = ()
    name: str | None = None
    alone: bool = False

    @property
    def file(self) -> Path:
        """The first motion file."""
        return self.files[0]

    @property
    def console(self) -> PlainConsole:
        """The console for the result: stderr if the motion goes to stdout, else stdout."""
        return stderr_console() if STDOUT in self.files else stdout_console()

    def write(self, clip: Clip, number: int = 0) -> None:
        """Write a motion to one of the files; an invalid motion leaves no file."""
        from motionkit.export.formats import write_motion

        clip = replace(clip, name=self.name or clip.name, alone=self.alone)
        if self.files[number] != STDOUT:
            write_motion(self.files[number], clip)
            return
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "motion.bvh"
            write_motion(made, clip)
            with made.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
        sys.stdout.buffer.flush()

    def show(self, views: Callable[[], Sequence[MotionView]]) -> None:
        """With --view, write the page of the motions and open it."""
        if self.page is None:
            return
        from motionkit.view.viewer import write_viewer

        write_viewer(self.page, views())
        if not self.as_json:
            open_in_browser(self.page.resolve().as_uri())

    def report(self, facts: dict[str, Any], lines: Iterable[Any], *read: tuple[Path, Motion]) -> None:
        """Print the result: the facts with --json, else the lines and tables; then the page. Says what was replaced.

        Both end with how the clips were read: their files, and their motions as in the files.
        """
        if self.as_json:
            print_json(self.facts(facts, *read))
            return
        self._say_replaced()
        words = [describe_input(motion) for _, motion in read]
        for line in (*lines, *input_lines([clip for clip, _ in read], words)):
            self.console.print(line)
        if self.page:
            self.console.print(f"wrote {self.page}")

    def facts(self, facts: dict[str, Any], *read: tuple[Path, Motion]) -> dict[str, Any]:
        """What report prints with --json, for a command that prints several results as one document."""
        self._say_replaced()
        words = [describe_input(motion) for _, motion in read]
        read_as: Any = words[0] if len(words) == 1 else words
        return facts | ({"taken": read_as} if read else {}) | ({"view": self.page} if self.page else {})

    def _say_replaced(self) -> None:
        if self.replaced:
            more = f" and {counted(len(self.replaced) - 1, 'other file')}" if len(self.replaced) > 1 else ""
            remark(f"replaced {self.replaced[0]}{more}")


def describe_input(motion: Motion) -> str:
    """How a clip was read, in words; kept for the run of a folder (cli/folders.py)."""
    from motionkit.rig.upright import describe_motion

    words = describe_motion(motion)
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta.setdefault(READ_AS, []).append(words)
    return words


def input_lines(clips: Iterable[Path], words: Sequence[str]) -> list[str]:
    """How clips were read, in lines; every command that reads clips prints them."""
    return [f"  {clip.name}: {text}" for clip, text in zip(clips, words, strict=True)]


def display_name(path: Path) -> str:
    """The name of an output file in messages."""
    return "standard output" if path == STDOUT else str(path)
