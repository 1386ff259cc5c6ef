"""Motion on the rigs of BVH files, there and back, and how feet slide on them: a table with one row per folder.

python benchmarks/rigs.py my-clips/ other-clips/

With --shape it counts instead the files whose legs and arms, and their sides, are found with all names removed.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import motionkit as mk
from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.files import files_below
from motionkit.finish.on_rig import on_rig
from motionkit.motion.bvh import read_bvh, write_bvh
from motionkit.motion.contacts import foot_contacts
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_angle
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.play.on_rig import LiveRig, with_rig
from motionkit.play.requests import parse_request
from motionkit.play.session import Session
from motionkit.rig.on_rig import read_rig
from motionkit.rig.pose import map_file, median_offsets
from motionkit.rig.retarget import retarget
from motionkit.rig.rig import Rig
from motionkit.rig.to_rig import on_body, rig_bvh, to_rig

TOES = [JOINT_NAMES.index(f"{side}ToeBase") for side in ("Left", "Right")]
LIVE_SECONDS = 7
TYPES = ("walking:4", "running:4", "dance-modern:4")


def there_and_back(motion: Motion, rig: Rig, own: bool) -> float:
    """The largest angle in degrees between mapped joints before and after; own: read with what is known of the rig."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "on-rig.bvh"
        write_bvh(file, rig_bvh(to_rig(motion, rig), rig))
        back, _ = retarget(read_bvh(file), rig=rig if own else None)
    joints = [JOINT_NAMES.index(name) for name in rig.joints.places]
    before, after = (motion_kinematics(one)[0][:, joints] for one in (motion, back))
    return float(np.rad2deg(quat_angle(before, after)).max())


def feet(motion: Motion, rig: Rig) -> Array:
    """Toes (T, 2, 3) of a motion on a rig, in cm for canonical legs; of a rig without toes, the ends of its feet."""
    back, _ = retarget(rig_bvh(motion, rig), rig=rig)
    return motion_kinematics(on_body(back, rig))[1][:, TOES]


def sliding(places: Array, touching: Array, fps: float) -> float:
    """Mean speed over the ground, cm/s, of feet (T, 2, 3) while they touch (T, 2) it."""
    way = np.linalg.norm(np.diff(places[..., [0, 2]], axis=0), axis=-1) * fps
    return float(way[(touching[1:] > 0.5) & (touching[:-1] > 0.5)].mean())


def measure(rig: Rig, motion: Motion) -> list[float]:
    """There and back (with the rig known, and without), and sliding of the motion, copied, and held."""
    places = motion_kinematics(motion)[1]
    touching = foot_contacts(places, motion.fps)[:, [1, 3]]
    rows = [places[:, TOES], feet(on_rig(motion, rig, ik=False), rig), feet(on_rig(motion, rig), rig)]
    return [there_and_back(motion, rig, True), there_and_back(motion, rig, False)] + [
        sliding(row, touching, motion.fps) for row in rows
    ]


def live_sliding(rig: Rig) -> float:
    """Sliding of the feet of a live character on a rig that walks for LIVE_SECONDS, after the first."""
    session = Session(with_rig(mk.load_model(), rig), rig.name)
    session.join(1)
    session.obey(1, parse_request('{"do": "wish", "velocity": [0, 130], "seq": 1}'))
    on_joints, shown, poses = LiveRig(rig), [], []
    for _ in range(60 * LIVE_SECONDS):
        (character,) = session.step().characters
        shown.append(character.contacts)
        poses.append(on_joints.pose(character))
    rotations, places = (
        np.array([pose[key] for pose in poses], np.float32) for key in ("rotations", "positions")
    )
    motion = Motion(rig.skeleton, rotations, places[:, 0], 60.0, places)
    return sliding(feet(motion, rig)[60:], np.stack(shown)[60:, [1, 3]], 60.0)


def found_by_shape(path: Path) -> bool:
    """Whether thighs, shins, upper arms and forearms are the same with and without names."""
    bvh = median_offsets(read_bvh(path))
    named = map_file(bvh)
    names = tuple(f"joint{joint}" for joint in range(len(bvh.skeleton)))
    try:
        nameless = map_file(replace(bvh, skeleton=replace(bvh.skeleton, names=names)))
    except MotionkitError:
        return False
    limbs = [f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Arm", "ForeArm")]
    return all(nameless.places[name] == named.places[name] for name in limbs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--most", type=int, default=1000, help="files of each folder, spread over it")
    parser.add_argument("--shape", action="store_true", help="count the limbs found without names instead")
    arguments = parser.parse_args()
    if arguments.shape:
        found = [found_by_shape(path) for folder in arguments.folders for path in files_below(folder, ".bvh")]
        print(f"limbs found by shape alone: {sum(found)} of {len(found)} files")
        return
    motions = [mk.synthesize(types, seed=1).motion for types in TYPES]
    print("| rigs | files | there and back | read as a new file | sliding: motion | copied | held | live |")
    print("|---|---|---|---|---|---|---|---|")
    for folder in arguments.folders:
        files = files_below(folder, ".bvh")
        files = files[:: max(1, -(-len(files) // arguments.most))]
        rows = []
        for path in files:
            try:
                rig = read_rig(path)
            except MotionkitError as error:
                print(f"refused: {error}")
                continue
            found = np.array([measure(rig, motion) for motion in motions])
            rows.append(np.array([*found[:, :2].max(axis=0), *found[:, 2:].mean(axis=0), live_sliding(rig)]))
        table = np.stack(rows)
        back, again = table[:, 0].max(), table[:, 1].max()
        print(
            f"| {folder.name} | {len(rows)} | {back:.4f}° | {again:.4f}° | "
            + " | ".join(f"{value:.1f}" for value in table[:, 2:].mean(axis=0))
            + " |",
            flush=True,
        )


if __name__ == "__main__":
    main()
