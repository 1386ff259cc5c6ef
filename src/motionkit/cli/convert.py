"""`motionkit convert`: a motion file in another format."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import json_option, print_json, say
from motionkit.cli.finite import FiniteRange
from motionkit.cli.motion_options import RootMotion, checked_ending, naming, root_options


@click.command("convert")
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("target", type=click.Path(path_type=Path), callback=checked_ending)
@click.option("--fps", type=FiniteRange(1, 480), help="Frame rate of TARGET; that of SOURCE by default.")
@root_options
@json_option
def command(source: Path, target: Path, fps: float | None, root_motion: RootMotion, as_json: bool) -> None:
    """Convert a motion file; the endings of SOURCE and TARGET name the formats.

    SOURCE is .bvh of any rig, or a .glb with a skinned skeleton and an animation. TARGET is .bvh, .glb (skeleton,
    body and animation), .vrma (VRM animation, human rigs only), .usda (UsdSkel), .npz or .csv. Lengths become metres
    (.glb, .vrma, .usda) or centimetres (.npz, .csv), with Y up; from .bvh to .bvh they stay as they are.
    """
    from motionkit.export.formats import read_clip, write_motion
    from motionkit.files import check_outputs
    from motionkit.motion.motion import resample

    check_outputs([target], [source])
    clip = read_clip(source)
    motion = root_motion.applied(clip.motion)
    motion = motion if fps is None else resample(motion, fps)
    with naming(source):
        write_motion(target, clip.with_motion(motion))
    if as_json:
        facts = {"frames": len(motion), "fps": motion.fps, "joints": len(motion.skeleton)}
        print_json({"file": str(source), "output": str(target), **facts})
    else:
        say(f"wrote {target}: {len(motion.skeleton)} joints, {len(motion)} frames at {motion.fps:g} fps")
