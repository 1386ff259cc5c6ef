"""Numbers on the command line: none is nan or infinite."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from motionkit.cli.finite import FiniteFloat, FiniteRange
from motionkit.cli.main import cli


def numbers(command: click.Command, words: tuple[str, ...] = ()) -> Iterator[tuple[str, click.ParamType]]:
    """Every parameter of all commands that takes a number with a point, by name, and its type."""
    context = click.Context(command)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from numbers(below, (*words, name))
    for parameter in command.params:
        kinds = parameter.type.types if isinstance(parameter.type, click.Tuple) else [parameter.type]
        for kind in kinds:
            if isinstance(kind, click.types.FloatParamType):
                yield " ".join((*words, parameter.opts[0])), kind


OPTIONS = list(numbers(cli))


@pytest.mark.parametrize(("option", "kind"), OPTIONS, ids=[name for name, _ in OPTIONS])
def test_no_option_takes_nan_or_infinity(option: str, kind: click.ParamType) -> None:
    for word in ("nan", "inf", "-inf", "1e999"):
        with pytest.raises(click.BadParameter, match=f"^{word} is not a finite number$"):
            kind.convert(word, None, None)


def test_all_options_are_found() -> None:
    assert {"synthesize --temperature", "metrics --floor", "experiment long --seconds"} <= dict(
        OPTIONS
    ).keys()


def test_other_numbers_are_as_with_click() -> None:
    assert FiniteFloat().convert("-2.5", None, None) == -2.5
    assert FiniteRange(1, 3).convert("3", None, None) == 3.0
    for word, said in (("4", "4.0 is not in the range 1<=x<=3"), ("x", "'x' is not a valid float")):
        with pytest.raises(click.BadParameter, match=said):
            FiniteRange(1, 3).convert(word, None, None)


def test_what_the_command_says(motionkit) -> None:
    said = motionkit("follow-path", "circle", "--size", "nan")
    assert said.code == 2 and "'--size': nan is not a finite number" in said.err
