"""`motionkit convert`: converts a motion file to another format."""

from __future__ import annotations

from pathlib import Path

import click

from motionkit.cli.common import PLACE, clip_options, gathered, json_option
from motionkit.cli.finite import FiniteRange
from motionkit.cli.folders import folders
from motionkit.cli.outputs import Wanted, naming
from motionkit.cli.rig_options import RootMotion, root_options


@click.command("convert")
@click.argument("source", type=PLACE)
@click.argument("target", type=PLACE)
@click.option("--fps", type=FiniteRange(1, 480), help="Frame rate of TARGET; that of SOURCE by default.")
@clip_options
@root_options
@json_option
@folders("source", "target")
@gathered("root_motion", RootMotion)
def command(source: Path, target: Path, fps: float | None, root_motion: RootMotion, as_json: bool) -> None:
    """Convert a motion file; the endings of SOURCE and TARGET name the formats.

    SOURCE is .bvh of any rig, or a .glb with a skinned skeleton and an animation. TARGET is .bvh, .glb (skeleton,
    body and animation), .vrma (VRM animation, human rigs only), .usda (UsdSkel), .npz or .csv. Lengths become metres
    (.glb, .vrma, .usda) or centimetres (.npz, .csv), with Y up; from .bvh to .bvh they stay as they are.
    """
    from motionkit.export.formats import read_clip
    from motionkit.motion.motion import resample
    from motionkit.rig.upright import taken

    outputs = Wanted(target, False, as_json).files("", [source])
    clip = read_clip(source)
    motion = root_motion.applied(clip.motion)
    motion = motion if fps is None else resample(motion, fps)
    with naming(source):
        outputs.write(clip.with_motion(motion))
    joints, frames = len(motion.skeleton), len(motion)
    took = taken(clip.motion)
    facts = {
        "file": source,
        "output": target,
        "frames": frames,
        "fps": motion.fps,
        "joints": joints,
        "taken": took,
    }
    outputs.report(
        facts, [f"wrote {target}: {joints} joints, {frames} frames at {motion.fps:g} fps", f"  {took}"]
    )
