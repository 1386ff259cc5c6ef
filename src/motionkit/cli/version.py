"""Text of `motionkit --version`: the release and what it computes with."""

from __future__ import annotations

import click

from motionkit.cli.common import eager_option
from motionkit.version import __version__


def version_text() -> str:
    """The release, C kernels, torch and the bundled model, one line each; does not import torch."""
    return "\n".join(
        [
            f"motionkit, version {__version__}",
            f"kernels: {_kernels()}",
            f"torch: {_torch()}",
            f"model: {_model()}",
        ]
    )


def _kernels() -> str:
    """The inference kernels; checking those for training would need to import torch."""
    from motionkit.errors import MotionkitError
    from motionkit.inference.frame_kernel import frame_library
    from motionkit.inference.step_kernel import kernel_library

    try:
        kernel_library(), frame_library()
    except MotionkitError as error:
        return str(error)
    return "step, frame"


def _torch() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("torch")
    except PackageNotFoundError:
        return "none (only training needs it)"


def _model() -> str:
    from motionkit.errors import MotionkitError
    from motionkit.models.bundled import BUNDLED_MODEL
    from motionkit.models.checkpoint import read_header

    if not BUNDLED_MODEL.is_file():
        return "none, give --model"
    try:
        types = read_header(BUNDLED_MODEL)["types"]
    except MotionkitError as error:
        return str(error)
    return f"{BUNDLED_MODEL.name}, {len(types)} types, {BUNDLED_MODEL.stat().st_size / 1e6:.1f} MB"


def _show(context: click.Context, option: click.Parameter, requested: bool) -> None:
    if requested and not context.resilient_parsing:
        click.echo(version_text())
        context.exit()


version_option = eager_option(
    "--version",
    is_flag=True,
    callback=_show,
    help="Show the release, the kernels, torch and the model, and exit.",
)
