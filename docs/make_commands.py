"""Writes docs/commands.md from the help of the commands; run it after changing one.

python docs/make_commands.py
"""

from __future__ import annotations

import inspect
import textwrap
from collections import Counter
from pathlib import Path

import click

from motionkit.cli.main import COMMANDS, cli

PAGE = Path(__file__).resolve().parent / "commands.md"
HEADER = """# Commands

All commands and options, as `--help` shows them. This page is written by `python docs/make_commands.py`.

Exit codes: 0 done, 1 the data or the work failed, 2 wrong usage, 130 stopped by Ctrl-C or SIGTERM (0 for `play`,
which ends in no other way). Results go to stdout, progress and errors to stderr; `--json` prints the result as one JSON
document.

## Shared options

These mean the same in every command that names them.
"""
TABLE = ["| option | what it does |", "|---|---|"]
SHARED_BY = 3  # commands from which on an option is described once


def subcommand(name: str) -> click.Command:
    """A subcommand of motionkit by name, "experiment run" for one of a group."""
    command: click.Command | None = cli
    for word in name.split():
        assert isinstance(command, click.Group)
        command = command.get_command(click.Context(command), word)
    assert command is not None
    return command


def names() -> list[str]:
    """The names of all commands, those of a group after it."""
    out = []
    for name in COMMANDS:
        command = subcommand(name)
        out.append(name)
        out += [f"{name} {word}" for word in getattr(command, "commands", {})]
    return out


def help_text(command: click.Command) -> str:
    """Return the command's help as Markdown; a paragraph that click must not wrap becomes a code block."""
    paragraphs = inspect.cleandoc(command.help or "").split("\n\n")
    return "\n\n".join(
        textwrap.indent(text.removeprefix("\b\n"), "    ")
        if text.startswith("\b")
        else text.replace("<", "\\<")
        for text in paragraphs
    )


def usage(name: str, command: click.Command) -> str:
    """The line that says how to call the command."""
    words = ["motionkit", name, "COMMAND" if isinstance(command, click.Group) else "[OPTIONS]"]
    for parameter in command.params:
        if isinstance(parameter, click.Argument):
            word = parameter.human_readable_name.upper()
            word = word if parameter.required else f"[{word}]"
            words.append(word + ("..." if parameter.nargs == -1 else ""))
    return " ".join(words)


def takes_value(option: click.Option) -> bool:
    """Whether a value stands after the option."""
    return not (option.is_flag or option.count)


def value_name(option: click.Option) -> str:
    """The word for the option's value after its names; nothing for a flag."""
    if not takes_value(option):
        return ""
    if option.metavar:
        return " " + option.metavar.replace("|", "\\|")
    kinds = {"integer": "number", "float": "number", "directory": "folder"}
    kind = option.type
    types = kind.types if isinstance(kind, click.Tuple) else [kind]
    names = [each.name.removesuffix(" range") for each in types]
    return " " + " ".join(kinds.get(name, name) for name in names).upper()


def value_text(option: click.Option) -> str:
    """What the value may be and what it is by default, as sentences that follow the help."""
    kind, words = option.type, []
    if takes_value(option) and isinstance(kind, click.Choice):
        words.append("one of " + ", ".join(str(choice) for choice in kind.choices))
    elif takes_value(option) and isinstance(kind, (click.IntRange, click.FloatRange)):
        words.append(("whole number" if isinstance(kind, click.IntRange) else "number") + limits(kind))
    if default := default_text(option):
        words.append(f"default {default}")
    text = "; ".join(words)
    return f" {text[0].upper()}{text[1:]}." if text else ""


def limits(kind: click.IntRange | click.FloatRange) -> str:
    """The range of a number, as " 1 to 480", " at least 1" or " above 0"."""
    low, high = (x if x is None or isinstance(x, int) else f"{x:g}" for x in (kind.min, kind.max))
    if low is not None and high is not None:
        return f" {low} to {high}"
    if low is not None:
        return f" {'above' if kind.min_open else 'at least'} {low}"
    return "" if high is None else f" at most {high}"


def default_text(option: click.Option) -> str:
    """The default, where the help shows it."""
    if not option.show_default:
        return ""
    if option.is_flag and option.secondary_opts:
        return f"`{(option.opts if option.default else option.secondary_opts)[0]}`"
    return f"`{option.default}`"


def option_row(option: click.Option) -> str:
    """A row of the table of options."""
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    text = (option.help or "").replace("|", "\\|").replace("<", "\\<")
    return f"| {names}{value_name(option)} | {text}{value_text(option)} |"


def options(name: str) -> list[click.Option]:
    """The options of a command."""
    return [each for each in subcommand(name).params if isinstance(each, click.Option)]


def shared_rows() -> dict[str, str]:
    """The rows that stand in many commands, by the option's first name."""
    found: dict[str, str] = {}
    for row, count in Counter(option_row(each) for name in names() for each in options(name)).most_common():
        if count >= SHARED_BY:
            found.setdefault(row.split("`")[1], row)
    return found


def command_section(name: str, shared: dict[str, str]) -> str:
    """The page's section on one command."""
    command = subcommand(name)
    rows = {each.opts[0]: option_row(each) for each in options(name)}
    once = [option for option, row in rows.items() if shared.get(option) == row]
    own = [row for option, row in rows.items() if option not in once]
    others = ", ".join(f"`{option}`" for option in once)
    lines = [f"## {name}", "", f"    {usage(name, command)}", "", help_text(command), ""]
    lines += [*TABLE, *own, ""] if own else []
    return "\n".join([*lines, f"[Shared options](#shared-options): {others}.", ""] if others else lines)


def page_text() -> str:
    """The whole page."""
    shared = shared_rows()
    sections = [command_section(name, shared) for name in names()]
    return "\n".join([HEADER, *TABLE, *shared.values(), "", *sections])


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
