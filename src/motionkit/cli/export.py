"""motionkit export: a model for game engines."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import json_option, print_json, remark, say


@click.command("export")
@click.option(
    "--onnx",
    "path",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The ONNX file to write; what it means goes beside it as JSON.",
)
@click.option(
    "--model",
    "model_path",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="A model file; the bundled model by default.",
)
@click.option("--character", default="default", show_default=True, help="The body the joints are of.")
@click.option(
    "--weights",
    type=click.Choice(["float32", "int8"]),
    default="float32",
    show_default=True,
    help="Of the layers: int8 is a third of the size and faster, a little less exact, and not for every engine.",
)
@json_option
def command(path: Path, model_path: Path | None, character: str, weights: str, as_json: bool) -> None:
    """Write a model as an ONNX graph of one frame.

    Controls and state go in, a posed body and the next state come out: see docs/engines.md. With
    onnxruntime installed, graph and motionkit first run 600 frames side by side, and the largest
    difference is printed; joints more than 0.5 cm apart (int8: 200 cm) are an error, and nothing is written.
    """
    from motionkit.export.onnx_export import export_onnx, metadata_path
    from motionkit.files import check_outputs
    from motionkit.models.bundled import open_model

    beside = metadata_path(path)  # before the model is read
    check_outputs([path, beside], [model_path])
    check = export_onnx(open_model(model_path), path, character, weights)
    if as_json:
        result: dict = {"file": str(path), "metadata": str(beside)}
        if check is not None:
            result |= {
                "frames": check.frames,
                "largest_joint_difference_cm": check.positions,
                "largest_feature_difference": check.features,
                "frames_per_second": check.frames_per_second,
            }
        print_json(result)
        return
    say(f"wrote {path} and {beside}")
    if check is None:
        remark("not checked: onnxruntime is not installed (pip install 'motionkit[onnx]')")
        return
    say(
        f"{check.frames} frames in closed loop: joints differ by at most {check.positions:.1e} cm, "
        f"normalised features by {check.features:.1e}; {check.frames_per_second:.0f} frames per second"
    )
