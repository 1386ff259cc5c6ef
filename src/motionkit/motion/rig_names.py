"""Maps the joints of other rigs to canonical joints: limbs by name, the torso by hierarchy.

A name gives a side and a part: "mixamorig:LeftUpLeg", "Bip01 L Thigh", "thigh.L" and "lThigh" are all the left
thigh. Some words differ between rigs: "LeftShoulder" is a collar bone in one and an upper arm in another, and
"LeftHip" and "LeftLeg" are ambiguous too; the other joints of the same side decide. Spine, neck and collar joints
are found on the paths between the limbs, whatever their names.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from motionkit.errors import SkeletonError
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton

# Part to its words, in lower case, without separators and digits. "shoulder", "arm", "hip" and "leg" are separate
# parts because they are ambiguous.
PARTS: dict[str, tuple[str, ...]] = {
    "thigh": ("thigh", "upleg", "upperleg", "uleg", "legupper", "femur", "thighbend"),
    "hip": ("hip",),
    "leg": ("leg",),
    "shin": ("shin", "calf", "lowerleg", "lowleg", "leglower", "knee", "tibia", "shinbend"),
    "foot": ("foot", "ankle", "feet"),
    "toe": ("toe", "toes", "toebase", "toesbase", "ball", "football"),
    "collar": ("collar", "clavicle", "clav", "collarbone", "scapula", "scap"),
    "shoulder": ("shoulder",),
    "arm": ("arm",),
    "upperarm": ("upperarm", "uparm", "uarm", "armupper", "humerus", "shldr", "shldrbend", "bicep"),
    "forearm": (
        "forearm", "fore", "lowerarm", "lowarm", "armlower", "farm", "elbow", "radius", "forearmbend",
    ),
    "hand": ("hand", "wrist", "palm"),
    "hips": ("hips", "pelvis"),
    "neck": ("neck", "lowerneck", "upperneck", "necklower", "neckupper", "neckbase", "neckmiddle"),
    "head": ("head", "skull"),
    # Known joints that are not mapped: those between or beside the canonical ones.
    "other": (
        "hipjoint", "buttock", "end", "nub", "site", "tip", "roll", "twist", "ik", "pole", "target",
        "effector", "rigmesh", "mesh", "helper", "finger", "fingers", "fingerbase", "thumb", "index",
        "middle", "mid", "ring", "pinky", "pinkie", "little", "eye", "jaw", "ear", "hair", "metacarpal",
        "carpal", "metatarsal", "metatarsals",
    ),
}  # fmt: skip
WORDS: dict[str, str] = {word: part for part, words in PARTS.items() for word in words}
SIDES: dict[str, str] = {"left": "Left", "right": "Right", "l": "Left", "r": "Right"}
# Places of the canonical spine joints between hips (0) and shoulders (1).
SPINE_SHARES: dict[str, float] = {"LowerBack": 0.0, "Spine": 0.28, "Spine1": 0.56}

_TOKENS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+")
_WORD = "|".join(sorted(WORDS, key=len, reverse=True))
_SIDE = "|".join(SIDES)
_SIDED_WORD = re.compile(rf"(?:({_SIDE})({_WORD})|({_WORD})({_SIDE})|({_WORD}))")


@dataclass(frozen=True)
class RigMap:
    """The canonical joints of a source skeleton.

    Attributes:
        places: canonical name to the index of the source joint at its place.
        turns: canonical name to the index of the source joint with its rotation; this differs from the place if
            twist joints follow along the same bone.
    """

    places: dict[str, int]
    turns: dict[str, int]

    def missing(self) -> tuple[str, ...]:
        """Canonical joints that the source lacks."""
        return tuple(name for name in JOINT_NAMES if name not in self.places)


def name_part(name: str) -> tuple[str, str]:
    """Side ("Left", "Right" or "") and part (a key of PARTS, or "") of a joint name.

    Prefixes and namespaces ("mixamorig:", "Character1_", "Armature|") are ignored.
    """
    tokens = [token.lower() for token in _TOKENS.findall(name)]
    for start in range(len(tokens)):
        match = _SIDED_WORD.fullmatch("".join(tokens[start:]))
        if match is None:
            continue
        before, word_after, word_before, after, alone = match.groups()
        side = before or after or next((t for t in tokens[:start] if t in SIDES), "")
        return SIDES.get(side, ""), WORDS[word_after or word_before or alone]
    return "", ""


def map_rig(skeleton: Skeleton) -> RigMap:
    """Find the canonical joints in a skeleton; raises SkeletonError if it is not a known human rig."""
    return _Mapper(skeleton).map()


class _Mapper:
    """The hierarchy with parts by name; its methods map the limbs first, then the torso."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.names = skeleton.names
        self.parents = skeleton.parents
        self.offsets = skeleton.offsets
        self.rest = skeleton.rest_positions()
        self.parts = [name_part(name) for name in skeleton.names]
        self.subtree = [1] * len(skeleton)
        for joint in range(len(skeleton) - 1, 0, -1):
            self.subtree[self.parents[joint]] += self.subtree[joint]
        self.places: dict[str, int] = {}

    def map(self) -> RigMap:
        for side in ("Left", "Right"):
            self._leg(side)
            self._arm(side)
        self._require()
        self._hips()
        chest = self._spine()
        self._neck(chest)
        for side in ("Left", "Right"):
            self._collar(side, chest)
        ordered = {name: self.places[name] for name in JOINT_NAMES if name in self.places}
        return RigMap(ordered, {name: self._turn(name) for name in ordered})

    def path(self, joint: int) -> list[int]:
        """The joints from the root to a joint, both included."""
        out = [joint]
        while self.parents[out[-1]] >= 0:
            out.append(self.parents[out[-1]])
        return out[::-1]

    def common(self, *joints: int) -> int:
        """The deepest common ancestor of these joints, which may be one of them."""
        paths = [self.path(joint) for joint in joints]
        shared = [steps[0] for steps in zip(*paths, strict=False) if len(set(steps)) == 1]
        return shared[-1]

    def children(self, joint: int) -> list[int]:
        return [j for j, parent in enumerate(self.parents) if parent == joint]

    def find(self, side: str, *parts: str, under: int | None = None, carries: bool = False) -> int | None:
        """The joint of one of these parts with the most descendants, below `under` if given.

        Rigs repeat names for helpers and meshes; those are leaves, and `carries` excludes them.
        """
        found = [
            j
            for j, (joint_side, part) in enumerate(self.parts)
            if joint_side == side
            and part in parts
            and self.subtree[j] > carries
            and (under is None or under in self.path(j)[:-1])
        ]
        return max(found, key=lambda j: (self.subtree[j], -j), default=None)

    @staticmethod
    def first(*joints: int | None) -> int | None:
        """The first that is not None."""
        return next((joint for joint in joints if joint is not None), None)

    def put(self, name: str, joint: int | None) -> int | None:
        if joint is not None:
            self.places[name] = joint
        return joint

    def _leg(self, side: str) -> None:
        leg = self.find(side, "leg", carries=True)
        if leg is not None and self.find(side, "shin", under=leg) is None:
            leg = None  # a "leg" without a shin below it is the shin
        thigh = self.first(self.find(side, "thigh", carries=True), leg, self.find(side, "hip", carries=True))
        if self.put(f"{side}UpLeg", thigh) is None:
            return
        shin = self.put(f"{side}Leg", self.find(side, "shin", "leg", under=thigh))
        if shin is None:
            return
        # Some rigs call their only foot joint a toe; in others the foot is the joint below the ankle.
        foot = self.first(self.find(side, "foot", under=shin), self.find(side, "toe", under=shin))
        if self.put(f"{side}Foot", foot) is not None:
            toe = self.first(self.find(side, "toe", under=foot), self.find(side, "foot", under=foot))
            self.put(f"{side}ToeBase", toe)

    def _arm(self, side: str) -> None:
        upper = self.first(*(self.find(side, part, carries=True) for part in ("upperarm", "arm", "shoulder")))
        if self.put(f"{side}Arm", upper) is None:
            return
        lower = self.find(side, "forearm", "arm", under=upper)
        if self.put(f"{side}ForeArm", lower) is not None:
            self.put(f"{side}Hand", self.find(side, "hand", under=lower))

    def _require(self) -> None:
        needed = [
            f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Arm", "ForeArm")
        ]
        lacking = [name for name in needed if name not in self.places]
        if lacking:
            seen = ", ".join(self.names[:12]) + (", ..." if len(self.names) > 12 else "")
            raise SkeletonError(
                f"not a known human rig: no joint found for {', '.join(lacking)}; the file has the joints {seen}"
            )
        if len(set(self.places.values())) < len(self.places):
            raise SkeletonError("not a known human rig: one joint matches two limbs")

    def _hips(self) -> None:
        thighs = self.places["LeftUpLeg"], self.places["RightUpLeg"]
        fork = self.common(*thighs)
        above = [j for j in self.path(fork) if self.parts[j] in (("", "hips"), ("", "hip"))]
        if fork in thighs:
            raise SkeletonError(
                f"one thigh is a descendant of the other: {', '.join(self.names[j] for j in thighs)}"
            )
        self.places["Hips"] = above[-1] if above else fork

    def _spine(self) -> int:
        """Place the spine joints; returns the chest, the last joint that carries both arms."""
        fork = self.common(self.places["LeftArm"], self.places["RightArm"])
        below = self.common(self.places["Hips"], fork)
        path = self.path(fork)
        spine = [j for j in path[path.index(below) + 1 :] if self.parts[j][1] not in ("neck", "head")]
        chest = spine[-1] if spine else fork
        picked = spine if len(spine) <= 3 else [spine[0], spine[len(spine) // 2], chest]
        heights = [self.length(self.places["Hips"], joint) for joint in picked]
        arms = (self.rest[self.places["LeftArm"]] + self.rest[self.places["RightArm"]]) / 2
        top = self.length(self.places["Hips"], chest) + float(np.linalg.norm(arms - self.rest[chest]))
        for name, joint in zip(_spine_names(heights, max(top, 1e-6)), picked, strict=True):
            self.places[name] = joint
        return chest

    def length(self, above: int, below: int) -> float:
        """Rest length along the hierarchy from the common ancestor to `below`."""
        path = self.path(below)
        start = path.index(self.common(above, below))
        return float(sum(np.linalg.norm(self.offsets[j]) for j in path[start + 1 :]))

    def _neck(self, chest: int) -> None:
        head = self.put("Head", self.find("", "head", under=chest))
        if head is None:
            self.put("Neck", self.find("", "neck", under=chest))
            return
        path = self.path(head)
        neck = path[path.index(chest) + 1 : -1]
        if neck:
            self.places["Neck"] = neck[0]
        if len(neck) > 1:
            self.places["Neck1"] = neck[-1]

    def _collar(self, side: str, chest: int) -> None:
        path = self.path(self.places[f"{side}Arm"])
        between = path[path.index(chest) + 1 : -1] if chest in path else []
        between = [j for j in between if self.parts[j][1] != "neck"]
        if between:
            self.places[f"{side}Shoulder"] = between[0]

    def _turn(self, name: str) -> int:
        """The last joint along a limb bone before the next mapped joint, twist joints included."""
        below = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}
        place = self.places[name]
        for side in ("Left", "Right"):
            part = name.removeprefix(side)
            if part != name and part in below and f"{side}{below[part]}" in self.places:
                return self.parents[self.places[f"{side}{below[part]}"]]
        return place


def _spine_names(heights: list[float], top: float) -> tuple[str, ...]:
    """The canonical spine joints nearest to these heights between hips and shoulders."""

    def misfit(names: tuple[str, ...]) -> float:
        return sum(abs(SPINE_SHARES[n] - h / top) for n, h in zip(names, heights, strict=True))

    return min(combinations(SPINE_SHARES, len(heights)), key=misfit)
