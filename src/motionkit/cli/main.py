"""The `motionkit` command: finds subcommands, prints faults as one line, sets the exit code."""

from __future__ import annotations

import importlib
import signal
import sys
from types import FrameType

import click

from motionkit import __version__
from motionkit.errors import MotionkitError

# Command name to the module under motionkit.cli that defines it as `command`.
COMMANDS = {
    "preprocess": "preprocess",
    "train": "train",
    "synthesize": "synthesize",
    "follow-path": "follow_path",
    "metrics": "metrics",
    "evaluate": "evaluate",
    "mirror": "mirror",
    "view": "view",
    "play": "play",
    "export": "export",
}


class CommandGroup(click.Group):
    """Imports a subcommand only when it is asked for, so that `--help` answers at once."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        return importlib.import_module(f"motionkit.cli.{COMMANDS[name]}").command


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="motionkit")
def cli() -> None:
    """Human motion: train a model on BVH files, control it, write BVH.

    Exit codes: 0 done, 1 the data or the work failed, 2 wrong usage.
    """


# Seconds until a signal that came during an import is looked at again.
_IMPORT_WAIT = 0.02


def _stop(number: int, frame: FrameType | None) -> None:
    """A terminated command stops as with Ctrl-C, and takes what it has half written away.

    Not in the middle of an import: compiled libraries (torch, PyGLM) crash when their start is broken off.
    """
    if _importing(frame) and hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, _IMPORT_WAIT)
    else:
        raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _catch_signals() -> None:
    for name in ("SIGINT", "SIGTERM", "SIGALRM"):  # the last is the timer's, where there is one
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)


def main() -> None:
    """Entry point of the console script."""
    _catch_signals()
    try:
        cli.main(standalone_mode=False)
    except click.UsageError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("stopped", err=True)
        sys.exit(1)
    except MotionkitError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(1)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        click.echo(f"error: {error.filename or 'file system'}: {error.strerror or error}", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
