"""`motionkit demo`: writes a folder with a page that runs a model in the browser."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from motionkit.cli.common import FOLDER, json_option, model_option, option, print_json, remark, say
from motionkit.cli.synthesis_options import reference_option


@click.command("demo")
@option(
    "-o",
    "--output",
    type=FOLDER,
    default=Path("site"),
    help="Folder to write; other files in it stay.",
)
@model_option
@reference_option
@click.option("--force", is_flag=True, help="Replace files of the same names that motionkit did not write.")
@json_option
def command(output: Path, model_path: Path | None, reference: str, force: bool, as_json: bool) -> None:
    """Write a web page that runs the model in the browser, without a server of its own.

    Any file server can serve the folder; nothing is fetched from elsewhere, and after the first visit the page works
    without a network. docs/demo.md says what it does and how fast.
    """
    from motionkit.models.bundled import open_model
    from motionkit.play.demo import write_demo

    sizes = write_demo(output, open_model(model_path, reference), force)
    if as_json:
        print_json({"folder": output, "bytes": sizes})
        return
    say(f"{output}: {sum(sizes.values()) / 1e6:.1f} MB")
    remark(f"to look at it: python -m http.server --directory {shlex.quote(str(output))}")
