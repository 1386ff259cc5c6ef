"""`motionkit export`: writes a model for game engines."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import FILE, json_option, model_option, option, print_json, remark, say


@click.command("export")
@click.option(
    "--onnx",
    "path",
    required=True,
    type=FILE,
    help="ONNX file to write; a JSON file beside it describes its inputs and outputs.",
)
@model_option
@option("--character", default="default", help="Body whose joints the graph computes.")
@json_option
def command(path: Path, model_path: Path | None, character: str, as_json: bool) -> None:
    """Write a model as an ONNX graph that computes one frame.

    The graph takes controls and state, and returns a posed body and the next state (docs/onnx.md). If
    onnxruntime is installed, the command first runs graph and motionkit side by side for 600 frames and
    prints the largest difference. It fails and writes nothing if joints differ by more than 0.5 cm.
    """
    from motionkit.export.onnx_export import export_onnx, metadata_path
    from motionkit.files import check_outputs
    from motionkit.models.bundled import open_model

    beside = metadata_path(path)  # fails before the model is read
    check_outputs([path, beside], [model_path])
    if path.suffix.lower() != ".onnx":
        raise click.UsageError(f"--onnx {path}: expected a name that ends in .onnx")
    check = export_onnx(open_model(model_path), path, character)
    if as_json:
        result: dict = {"file": path, "metadata": beside}
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
