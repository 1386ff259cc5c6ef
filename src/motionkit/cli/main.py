"""The `motionkit` command: finds subcommands, prints errors as one line, sets the exit code."""

from __future__ import annotations

import importlib
import io
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from difflib import get_close_matches
from types import FrameType
from typing import Any

import click

from motionkit.cli.common import STOPPED, remark
from motionkit.cli.version import version_option
from motionkit.errors import MotionkitError, OverwriteError
from motionkit.interrupts import postpone
from motionkit.reading import reading

# One thread for numpy: its products are small here, and several threads cost more than they save, most of all on a busy
# machine. torch has its own threads. Set this before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Command name to the module under motionkit.cli that defines it as `command`.
COMMANDS = {
    "doctor": "doctor",
    "preprocess": "preprocess",
    "train": "train",
    "quickstart": "quickstart",
    "synthesize": "synthesize",
    "follow-path": "follow_path",
    "metrics": "metrics",
    "evaluate": "evaluate",
    "retarget": "retarget",
    "mirror": "mirror",
    "convert": "convert",
    "trim": "trim",
    "join": "join",
    "loop": "loop",
    "fix": "fix",
    "view": "view",
    "play": "play",
    "demo": "demo",
    "export": "export",
    "experiment": "experiment",
}


# Words that people try, and the command for each.
SPELLINGS = {
    "synthesise": "synthesize",
    "generate": "synthesize",
    "looking": "view",
    "show": "view",
    "cut": "trim",
    "crop": "trim",
    "speed": "trim --speed",
    "resample": "trim --fps",
    "concat": "join",
    "merge": "join",
    "repair": "fix",
    "flip": "mirror",
    "info": "doctor",
    "types": "synthesize --list-types",
    "help": "--help",
}


# What an argument that a command does not take may have been meant for.
MEANT = {
    "synthesize": "--types",
    "retarget": "--rig",
    "follow-path": "--types",
    "loop": "-o",
    "trim": "-o",
    "fix": "-o",
}

# What takes the place of an option that other commands have.
INSTEAD = {"convert": {name: "give the file to write as TARGET, after SOURCE" for name in ("-o", "--output")}}


class Stopped(Exception):
    """Ctrl-C or SIGTERM stopped the command."""


class CommandGroup(click.Group):
    """Imports a subcommand only when it is used, so that `--help` is fast."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the subcommand; KeyboardInterrupt becomes Stopped, because click would print an empty line."""
        try:
            with reading(on_note=_remark_once()):
                return super().invoke(ctx)
        except KeyboardInterrupt:
            raise Stopped from None

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            meant = _meant(name)
            if meant:
                raise click.UsageError(f"no such command {name!r}; did you mean {meant}?")
            return None
        return importlib.import_module(f"motionkit.cli.{COMMANDS[name]}").command


def _meant(name: str) -> str:
    """The command that a word which is none may have been meant for; "" if none is known."""
    word = name.lower()
    if word in SPELLINGS:
        return SPELLINGS[word]
    if os.path.isfile(name):
        return f"view {name}"
    return _with_option(f"--{word}") or next(iter(get_close_matches(word, COMMANDS, 1, 0.6)), "")


def _with_option(option: str) -> str:
    """The first command that has this option, with it; "" if none has it."""
    for name, module in COMMANDS.items():
        command: click.Command = importlib.import_module(f"motionkit.cli.{module}").command
        if any(option in parameter.opts for parameter in command.params):
            return f"{name} {option}"
    return ""


def _remark_once() -> Callable[[str], None]:
    """Prints the notes on files that are read; some commands read a file twice."""
    printed: set[str] = set()

    def print_once(note: str) -> None:
        if note not in printed:
            printed.add(note)
            remark(note)

    return print_once


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"]})
@version_option
def cli() -> None:
    """Human motion: train a model on BVH files, control it and write BVH.

    Exit codes: 0 done, 1 the data or the work failed, 2 wrong usage, 130 stopped.
    """


# Seconds until a signal that arrived during an import is tried again.
_IMPORT_WAIT = 0.002
# Seconds during which further signals are ignored, so that half-written files can be removed.
_PATIENCE = 2.0
_stopped_at = -_PATIENCE
_stop_printed = False


def _stop(number: int, frame: FrameType | None) -> None:
    """Treat SIGTERM like Ctrl-C, so that the command removes half-written files.

    The stop waits for `uninterrupted` blocks and for imports: compiled libraries (torch, PyGLM) crash if their
    initialization is interrupted. "stopped" is printed at once in both cases.
    """
    global _stopped_at
    if postpone(number):
        return
    if _importing(frame) and hasattr(signal, "setitimer"):
        print_stopped()
        signal.setitimer(signal.ITIMER_REAL, _IMPORT_WAIT)
    elif time.monotonic() - _stopped_at > _PATIENCE:
        _stopped_at = time.monotonic()
        raise KeyboardInterrupt


def print_stopped() -> None:
    """Print "stopped" once, on a new line after the ^C that a terminal shows.

    This bypasses Python's buffers, because a signal may have interrupted a write to them.
    """
    global _stop_printed
    if not _stop_printed:
        _stop_printed = True
        after_caret_c = os.linesep if os.isatty(2) else ""
        os.write(2, f"{after_caret_c}stopped{os.linesep}".encode())


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _catch_signals() -> None:
    global _stopped_at, _stop_printed
    _stopped_at, _stop_printed = -_PATIENCE, False
    for name in ("SIGINT", "SIGTERM", "SIGALRM"):  # SIGALRM is the timer of _stop
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)


def _show_any_text() -> None:
    """Print characters that the terminal's encoding lacks as escapes instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _run() -> None:
    try:
        cli.main(standalone_mode=False)
    except Exception:
        if _stopped_at >= 0.0:  # a library (safetensors) raised its own error for the interrupt
            raise KeyboardInterrupt from None
        raise


def main() -> None:
    """Entry point of the console script."""
    _show_any_text()
    _catch_signals()
    try:
        _run()
    except click.UsageError as error:
        _show(error)
        sys.exit(2)
    except click.ClickException as error:
        _show(error)
        sys.exit(error.exit_code)
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except (Stopped, click.Abort, KeyboardInterrupt):
        print_stopped()
        sys.exit(STOPPED)
    except MotionkitError as error:
        remark(f"error: {error}")
        sys.exit(2 if isinstance(error, OverwriteError) else 1)
    except MemoryError:
        remark("error: not enough memory")
        sys.exit(1)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        remark(f"error: {error.filename or 'file system'}: {error.strerror or error}")
        sys.exit(1)


def _show(error: click.ClickException) -> None:
    """Print an error as click does; an argument too many is suggested for the option that it may be meant for."""
    extra = re.fullmatch(r"Got unexpected extra argument \((.*)\)", error.message)
    option = MEANT.get(getattr(getattr(error, "ctx", None), "info_name", None) or "")
    if extra and option and isinstance(error, click.UsageError):
        error = click.UsageError(f"{error.message}; did you mean {option} {extra[1]}?", error.ctx)
    if isinstance(error, click.NoSuchOption) and error.ctx:
        group = isinstance(error.ctx.command, CommandGroup)
        instead = INSTEAD.get(error.ctx.info_name or "", {}).get(error.option_name)
        meant = _with_option(error.option_name) if group else None
        if instead:
            error = click.UsageError(f"no such option {error.option_name!r}; {instead}", error.ctx)
        elif meant:
            error = click.UsageError(f"{error.message.rstrip('.')}; did you mean {meant}?", error.ctx)
    with io.StringIO() as buffer:
        error.show(buffer)
        for line in buffer.getvalue().rstrip("\n").split("\n"):
            remark(line)


if __name__ == "__main__":
    main()
