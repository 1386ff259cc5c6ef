"""Every option of the commands that make motion stands in a section of the help, in the order of use."""

from __future__ import annotations

import click
import pytest

from motionkit.cli import follow_path, synthesize
from motionkit.cli.synthesis_options import SECTIONS


@pytest.mark.parametrize("command", [synthesize.command, follow_path.command], ids=lambda each: each.name)
def test_every_option_has_a_section(command: click.Command) -> None:
    told = [name for names in SECTIONS.values() for name in names]
    options = [each.name for each in command.params if isinstance(each, click.Option)]
    assert options == [name for name in told if name in options] and len(set(told)) == len(told)
    text = command.get_help(click.Context(command))
    assert all(f"{title}:\n" in text for title in SECTIONS)
    assert text.index("--types") < text.index("--output") < text.index("--rig ") < text.index("--temperature")
