"""Output of commands: the file of -o, the page of --view, and results as text or JSON."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import PLACE, print_json, remark, stderr_console, stdout_console, together
from motionkit.cli.showing import open_in_browser
from motionkit.errors import MotionkitError, SkeletonError
from motionkit.files import check_outputs, safe_name
from motionkit.names import counted

if TYPE_CHECKING:
    from motionkit.cli.console import PlainConsole
    from motionkit.export.clip import Clip
    from motionkit.motion.motion import Motion
    from motionkit.view.figure_data import Shown

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
STDOUT = Path("-")

view_option = click.option(
    "--view", is_flag=True, help="Also write a web page that plays the motion, and open it."
)
BODIES = ("adult", "woman", "heavy")  # as in view.asset, which is slow to import


def body_option(where: str) -> Callable:
    """The --body option of commands that write a body."""
    text = f"Body that human rigs get in {where}; {BODIES[0]} by default."
    return click.option("--body", type=click.Choice(BODIES), default=BODIES[0], help=text)


animation_options = together(
    click.option(
        "--name", help="Name of the animation in a .glb or .vrm; by default from the types or the clip."
    ),
    click.option(
        "--replace",
        "alone",
        is_flag=True,
        help="Leave out the animations that the user's .glb or .vrm has; by default they stay beside the new one.",
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
    """A file name in the current folder that is not taken yet.

    Args:
        files: lists the files that a name stands for; by default, one file of that name.
    """
    name = safe_name(name, 120)
    path = Path(f"{name}{ending}")
    number = 2
    while any(file.exists() for file in files(path)):
        path, number = Path(f"{name}-{number}{ending}"), number + 1
    return path


@contextmanager
def naming(clip: Path, kind: type[MotionkitError] = SkeletonError) -> Iterator[None]:
    """Add the file's name to errors about its rig, because the library knows only the motion."""
    try:
        yield
    except kind as error:
        raise kind(f"{clip}: {error}") from None


@dataclass(frozen=True)
class Wanted:
    """The options -o, --view and --json, --name and --replace."""

    output: Path | None
    view: bool
    as_json: bool
    name: str | None = None
    alone: bool = False

    def check(self, count: int = 1) -> None:
        """Raise UsageError for options that BVH on standard output excludes."""
        others = {"--view": self.view, "--json": self.as_json, f"--count {count}": count > 1}
        for name in (name for name, given in others.items() if given and self.output == STDOUT):
            raise click.UsageError(f"{name} cannot be combined with -o -, which writes one motion")

    def files(
        self, name: str, inputs: Iterable[str | Path | None], count: int = 1, also: Sequence[Path] = ()
    ) -> Outputs:
        """The files to write; several are numbered. Checks that they can be written and overwrite no input.

        Args:
            name: file name without -o.
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
        base = self.output or default_output(name, files=everything)
        check_outputs([*everything(base), *also], inputs)
        page = base.with_suffix(".html") if self.view else None
        replaced = tuple(path for path in everything(base) if path.exists())
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

    def show(self, shown: Callable[[], Sequence[Shown]]) -> None:
        """With --view, write the page of the motions and open it."""
        if self.page is None:
            return
        from motionkit.view.viewer import write_viewer

        write_viewer(self.page, shown())
        if not self.as_json:
            open_in_browser(self.page.resolve().as_uri())

    def report(
        self, facts: dict[str, Any], lines: Iterable[Any], read: Mapping[Path, Motion] | None = None
    ) -> None:
        """Print the result: the facts with --json, else the lines and tables; then the page. Says what was replaced.

        Both end with what the clips that were read are taken to be.
        """
        if self.replaced:
            more = f" and {counted(len(self.replaced) - 1, 'other file')}" if len(self.replaced) > 1 else ""
            remark(f"replaced {self.replaced[0]}{more}")
        if self.as_json:
            page = {"view": self.page} if self.page else {}
            print_json(facts | ({"taken": taken_facts(read)} if read else {}) | page)
            return
        for line in (*lines, *taken_lines(read or {})):
            self.console.print(line)
        if self.page:
            self.console.print(f"wrote {self.page}")


def read_again(*clips: Path | None) -> dict[Path, Motion]:
    """The motions of clips as they are in their files, for commands that work on other forms; None is left out."""
    from motionkit.export.formats import read_motion

    return {clip: read_motion(clip) for clip in clips if clip is not None}


def taken_facts(read: Mapping[Path, Motion]) -> str | list[str]:
    """What the clips that a command read are taken to be, for JSON: of one its words, of several a list."""
    from motionkit.rig.upright import taken

    words = [taken(motion) for motion in read.values()]
    return words[0] if len(words) == 1 else words


def taken_lines(read: Mapping[Path, Motion]) -> list[str]:
    """The same in lines; every command that takes clips prints them."""
    from motionkit.rig.upright import taken

    return [f"  {path.name}: {taken(motion)}" for path, motion in read.items()]


def shown_name(path: Path) -> str:
    """The name of an output file in messages."""
    return "standard output" if path == STDOUT else str(path)
