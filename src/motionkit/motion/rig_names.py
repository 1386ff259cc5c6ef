"""Maps the joints of other rigs to canonical joints: limbs by name or else by shape, the torso by hierarchy.

A name gives a side and a part: "mixamorig:LeftUpLeg", "Bip01 L Thigh", "thigh.L" and "lThigh" are all the left
thigh. Some words differ between rigs: "LeftShoulder" is a collar bone in one and an upper arm in another, and
"LeftHip" and "LeftLeg" are ambiguous too; the other joints of the same side decide. Spine, neck and collar joints
are found on the paths between the limbs, whatever their names.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.mirror import joint_sides
from motionkit.motion.rig_shape import limbs_by_shape
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton

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

_NEEDED = tuple(f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Arm", "ForeArm"))
_LIMB = re.compile(r"(Left|Right)(Leg|Foot|ToeBase|ForeArm|Hand)")
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
        by_shape: probability from 0 to 1 of the limb joints that were found by shape and not by name.
        sides_sure: probability that left is left; below 1 only if no name tells.
    """

    places: dict[str, int]
    turns: dict[str, int]
    by_shape: dict[str, float] = field(default_factory=dict)
    sides_sure: float = 1.0

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


def map_rig(skeleton: Skeleton, poses: Array | None = None) -> RigMap:
    """Find the canonical joints in a skeleton.

    Args:
        skeleton: any rig.
        poses: (P, J, 3) recorded joint positions, of use for limbs whose names are unknown.

    Raises:
        SkeletonError: it is not a human rig, or a limb is missing.
    """
    return _Mapper(skeleton).map(poses)


def given_map(skeleton: Skeleton, places: dict[str, int]) -> RigMap:
    """The map of a skeleton whose canonical joints are known; raises SkeletonError if they cannot be a body."""
    return _Mapper(skeleton).given(places)


class _Mapper:
    """The hierarchy with parts by name; its methods map the limbs first, then the torso."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.names = skeleton.names
        self.parents = skeleton.parents
        self.offsets = skeleton.offsets
        self.rest = skeleton.rest_positions()
        self.parts = [name_part(name) for name in skeleton.names]
        self.subtree = [1] * len(skeleton)
        for joint in range(len(skeleton) - 1, 0, -1):
            self.subtree[self.parents[joint]] += self.subtree[joint]
        self.places: dict[str, int] = {}

    def map(self, poses: Array | None) -> RigMap:
        for side in ("Left", "Right"):
            self._leg(side)
            self._arm(side)
        by_shape, sides_sure = self._by_shape(poses)
        self._require()
        self._hips()
        chest = self._spine()
        self._neck(chest)
        for side in ("Left", "Right"):
            self._collar(side, chest)
        return replace(self._rig_map(), by_shape=by_shape, sides_sure=sides_sure)

    def given(self, places: dict[str, int]) -> RigMap:
        self.places = places
        self._require()
        for name, joint in places.items():
            above = PARENTS[JOINT_NAMES.index(name)]
            while above > 0 and JOINT_NAMES[above] not in places:
                above = PARENTS[above]
            top = places.get(JOINT_NAMES[above]) if above >= 0 else None
            if _LIMB.fullmatch(name) and top is not None and top not in self.path(joint)[:-1]:
                raise SkeletonError(
                    f"{self.names[joint]} is mapped to {name} but does not hang from {self.names[top]}, "
                    f"which is mapped to {JOINT_NAMES[above]}"
                )
        if "Hips" not in places:
            raise SkeletonError("no joint is mapped to Hips")
        return self._rig_map()

    def _rig_map(self) -> RigMap:
        ordered = {name: self.places[name] for name in JOINT_NAMES if name in self.places}
        return RigMap(ordered, {name: self._turn(name) for name in ordered})

    def _by_shape(self, poses: Array | None) -> tuple[dict[str, float], float]:
        """Fill in the limbs that have no known names; returns how sure each of their joints is, and their sides."""
        if not self._lacking():
            return {}, 1.0
        guess = limbs_by_shape(self.skeleton, joint_sides(self.names), poses)
        if guess is None:
            return {}, 1.0
        found: dict[str, float] = {}
        for parts in (("UpLeg", "Leg", "Foot", "ToeBase"), ("Arm", "ForeArm", "Hand")):
            names = [f"{side}{part}" for side in ("Left", "Right") for part in parts]
            if set(names) & self._lacking():  # a limb half known by names is taken from one source
                for name in names:
                    self.places.pop(name, None)
                    if name in guess.places:
                        self.places[name], found[name] = guess.places[name], guess.sure[name]
        return found, guess.sides_sure

    def _lacking(self) -> set[str]:
        return {name for name in _NEEDED if name not in self.places}

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
        lacking = [name for name in _NEEDED if name in self._lacking()]
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
            neck = self.find("", "neck", under=chest)
            if neck is not None or self.put("Head", self._head_by_shape(chest)) is None:
                self.put("Neck", neck)
                return
            head = self.places["Head"]
        path = self.path(head)
        neck_joints = path[path.index(chest) + 1 : -1]
        if neck_joints:
            self.places["Neck"] = neck_joints[0]
        if len(neck_joints) > 1:
            self.places["Neck1"] = neck_joints[-1]

    def _head_by_shape(self, chest: int) -> int | None:
        """The head of unknown name: along the longest branch of the chest without arms, the third joint at most.

        A joint that branches (into eyes and jaw) ends it, and the last joint of a longer chain is the tip of the head.
        """
        arms = {self.places["LeftArm"], self.places["RightArm"]}

        def free(joint: int) -> list[int]:
            return [j for j in self.children(joint) if not any(j in self.path(arm) for arm in arms)]

        chain: list[int] = []
        here = chest
        while below := free(here):
            here = max(below, key=lambda j: self.reach(j))
            chain.append(here)
            if len(free(here)) > 1:
                return here
        if not chain or self.reach(chain[0]) < 0.05 * self.reach(0):
            return None
        return chain[-1] if len(chain) < 3 else chain[min(len(chain) - 2, 2)]

    def reach(self, joint: int) -> float:
        """The longest path from a joint's parent through the joint to the end of a branch."""
        end = float(np.linalg.norm(self.skeleton.end_sites.get(joint, (0.0, 0.0, 0.0))))
        below = max((self.reach(child) for child in self.children(joint)), default=end)
        return below + (float(np.linalg.norm(self.offsets[joint])) if joint else 0.0)

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
