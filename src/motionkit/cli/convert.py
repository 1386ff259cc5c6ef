"""`motionkit convert`: converts a motion file to another format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    PLACE,
    animations_option,
    clip_options,
    fps_option,
    gathered,
    json_option,
    print_json,
    remark,
)
from motionkit.cli.folders import folders
from motionkit.cli.outputs import (
    STDOUT,
    OutputOptions,
    Outputs,
    animation_options,
    body_option,
    display_name,
)
from motionkit.cli.rig_options import RootMotion, root_options
from motionkit.errors import MotionkitError, naming
from motionkit.names import counted
from motionkit.reading import ALL, user_animation

if TYPE_CHECKING:
    from motionkit.export.clip import Clip


def _targets(source: Path, target: Path) -> list[tuple[str | None, Path]]:
    """The animations to convert and their files: one, or with --clip all TARGET with the name of each."""
    from motionkit.files import check_outputs, safe_name
    from motionkit.rig.gltf import GltfFile
    from motionkit.rig.read_file import is_gltf
    from motionkit.rig.read_glb import clip_lengths

    if user_animation() != ALL or not is_gltf(source):
        return [(None, target)]
    if target == STDOUT:
        raise click.UsageError(
            "--clip all cannot be combined with standard output (-), which gets one motion"
        )
    names = [name for name, _ in clip_lengths(GltfFile(source))]
    if not names:
        return [(None, target)]  # which is refused when it is read
    files = [target.with_name(f"{target.stem}-{safe_name(name, 80)}{target.suffix}") for name in names]
    check_outputs(files, [source])
    return list(zip(names, files, strict=True))


def _files(source: Path, target: Path) -> list[Path]:
    """The files that a clip of a folder is written to; TARGET for a clip that cannot be read, which fails later."""
    try:
        return [file for _, file in _targets(source, target)]
    except MotionkitError:
        return [target]


@click.command("convert")
@click.argument("source", type=PLACE)
@click.argument("target", type=PLACE)
@fps_option("Frame rate of TARGET; that of SOURCE by default.")
@clip_options
@root_options
@animations_option
@animation_options
@body_option(".glb and .usda")
@json_option
@folders("source", "target", written=_files)
@gathered("root_motion", RootMotion)
def command(
    source: Path,
    target: Path,
    fps: float | None,
    root_motion: RootMotion,
    name: str | None,
    alone: bool,
    body: str | None,
    as_json: bool,
) -> None:
    """Convert a motion file; the endings of SOURCE and TARGET name the formats.

    SOURCE is .bvh of any rig, .amc beside its .asf, .npz (AMASS, SMPL), or .glb, .vrm or .fbx with an animation. TARGET
    is .bvh, .glb (from .glb that file with one more animation, else skeleton, body and animation), .fbx (by Blender),
    .vrma (VRM animation, human rigs only), .usda (UsdSkel), .npz or .csv. Lengths become metres (.glb, .fbx, .vrma,
    .usda) or centimetres (.npz, .csv), with Y up; to .bvh they stay as they are, but become centimetres from .glb. With
    --clip all, the name of each animation is added to that of TARGET.
    """
    targets = _targets(source, target)
    written, failed = [], 0
    for clip_name, file in targets:
        output_options = OutputOptions(file, False, as_json, name, alone)
        output_options.check()
        try:
            outputs = output_options.files("", [source])
            written.append(_convert(source, clip_name, outputs, fps, root_motion, body))
        except MotionkitError as error:
            if len(targets) == 1:
                raise
            failed += 1
            remark(f"failed: {error}")
    if as_json and written:
        print_json(written if user_animation() == ALL else written[0])
    if failed:
        raise MotionkitError(f"{failed} of {len(targets)} animations failed")


def _convert(
    source: Path,
    clip_name: str | None,
    outputs: Outputs,
    fps: float | None,
    root_motion: RootMotion,
    body: str | None,
) -> dict[str, Any]:
    """Convert an animation of a file, the only one by default; prints what was written, or returns it for JSON."""
    from motionkit.editing.loop import at_rate
    from motionkit.export.formats import read_clip

    file = outputs.file
    clip = read_clip(source, clip_name)
    motion = clip.motion if fps is None else at_rate(clip.motion, fps)
    with naming(source):
        motion = root_motion.applied(motion)
        made = replace(clip.with_motion(motion), body=body)
        _say_left_out(file, made, root_motion)
        outputs.write(made)
    joints, frames = len(motion.skeleton), len(motion)
    if file.suffix.lower() == ".vrma":  # fingers and other joints are left out
        from motionkit.export.vrma import joints_kept

        joints = len(joints_kept())
    facts = {"file": source, "output": file, "frames": frames, "fps": motion.fps, "joints": joints}
    read = source, clip.in_file()
    if outputs.as_json:
        return outputs.facts(facts, read)
    words = f"{counted(joints, 'joint')}, {counted(frames, 'frame')} at {motion.fps:g} fps"
    outputs.report(facts, [f"wrote {display_name(file)}: {words}"], read)
    return facts


def _say_left_out(file: Path, clip: Clip, root_motion: RootMotion) -> None:
    """Say which options a file cannot follow."""
    ending = file.suffix.lower()
    kept = ending == ".vrm" or (ending == ".glb" and clip.host is not None)
    if clip.body is not None and (kept or ending not in (".glb", ".usda")):
        remark(f"--body left out: {file.name} {'keeps that of its character' if kept else 'shows none'}")
    if root_motion.root == "ground" and ending == ".vrma":
        remark(f"--root ground left out: {file.name} has the bones of a humanoid alone")
