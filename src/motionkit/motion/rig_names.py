"""Which joint of a foreign rig is which: names tell the limbs, the hierarchy tells the torso.

A name gives a side and a part ("mixamorig:LeftUpLeg", "Bip01 L Thigh", "thigh.L", "lThigh" are all the
left thigh). Words that rigs use differently ("LeftShoulder" is a collar bone here, an upper arm there;
"LeftHip", "LeftLeg" likewise) are settled by what else the same side has. Spine, neck and collar
joints are found on the paths between the limbs, whatever they are called.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from motionkit.errors import SkeletonError
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton

# Part -> the words for it, lower case, without separators and digits. "shoulder", "arm", "hip" and
# "leg" stand for themselves because they are ambiguous.
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
    # Known to be none of ours: what lies between or beside the joints that count.
    "other": (
        "hipjoint", "buttock", "end", "nub", "site", "tip", "roll", "twist", "ik", "pole", "target",
        "effector", "rigmesh", "mesh", "helper", "finger", "fingers", "fingerbase", "thumb", "index",
        "middle", "mid", "ring", "pinky", "pinkie", "little", "eye", "jaw", "ear", "hair", "metacarpal",
        "carpal", "metatarsal", "metatarsals",
    ),
}  # fmt: skip
WORDS: dict[str, str] = {word: part for part, words in PARTS.items() for word in words}
SIDES: dict[str, str] = {"left": "Left", "right": "Right", "l": "Left", "r": "Right"}
# Where the canonical spine joints sit between hips (0) and shoulders (1).
SPINE_SHARES: dict[str, float] = {"LowerBack": 0.0, "Spine": 0.28, "Spine1": 0.56}

_TOKENS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+")
_WORD = "|".join(sorted(WORDS, key=len, reverse=True))
_SIDE = "|".join(SIDES)
_SIDED_WORD = re.compile(rf"(?:({_SIDE})({_WORD})|({_WORD})({_SIDE})|({_WORD}))")


@dataclass(frozen=True)
class RigMap:
    """Where the canonical joints are in a source skeleton.

    Attributes:
        places: canonical name to the index of the source joint that sits there.
        turns: canonical name to the index of the source joint whose rotation counts; another one than
            the place where twist joints follow it along the same bone.
    """

    places: dict[str, int]
    turns: dict[str, int]

    def missing(self) -> tuple[str, ...]:
        """Canonical joints that the source does not have."""
        return tuple(name for name in JOINT_NAMES if name not in self.places)


def name_part(name: str) -> tuple[str, str]:
    """Side ("Left", "Right" or "") and part (a key of PARTS, or "") that a joint name speaks of.

    Prefixes and namespaces ("mixamorig:", "Character1_", "Armature|") are left out.
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
    """Find the canonical joints in a skeleton; raises SkeletonError if it is not a human rig."""
    return _Mapper(skeleton).map()


class _Mapper:
    """The hierarchy with its parts by name; methods pick joints from the limbs inward."""

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
        """From the root to the joint, both included."""
        out = [joint]
        while self.parents[out[-1]] >= 0:
            out.append(self.parents[out[-1]])
        return out[::-1]

    def common(self, *joints: int) -> int:
        """The deepest joint above (or at) all of these."""
        paths = [self.path(joint) for joint in joints]
        shared = [steps[0] for steps in zip(*paths, strict=False) if len(set(steps)) == 1]
        return shared[-1]

    def children(self, joint: int) -> list[int]:
        return [j for j, parent in enumerate(self.parents) if parent == joint]

    def find(self, side: str, *parts: str, under: int | None = None, carries: bool = False) -> int | None:
        """The joint of one of these parts with the most joints below it, strictly below `under` if given.

        Rigs repeat names for helpers and meshes; those are leaves, which `carries` leaves out.
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
        """The first that is there."""
        return next((joint for joint in joints if joint is not None), None)

    def put(self, name: str, joint: int | None) -> int | None:
        if joint is not None:
            self.places[name] = joint
        return joint

    def _leg(self, side: str) -> None:
        leg = self.find(side, "leg", carries=True)
        if leg is not None and self.find(side, "shin", under=leg) is None:
            leg = None  # a "leg" with no shin below it is the shin
        thigh = self.first(self.find(side, "thigh", carries=True), leg, self.find(side, "hip", carries=True))
        if self.put(f"{side}UpLeg", thigh) is None:
            return
        shin = self.put(f"{side}Leg", self.find(side, "shin", "leg", under=thigh))
        if shin is None:
            return
        # Some rigs call their only foot joint a toe; in others the foot is what hangs below the ankle.
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
                f"not a human rig that is known here: no joint found for {', '.join(lacking)}; "
                f"joints seen: {seen}"
            )
        if len(set(self.places.values())) < len(self.places):
            raise SkeletonError("not a human rig that is known here: one joint answers for two limbs")

    def _hips(self) -> None:
        thighs = self.places["LeftUpLeg"], self.places["RightUpLeg"]
        fork = self.common(*thighs)
        above = [j for j in self.path(fork) if self.parts[j] in (("", "hips"), ("", "hip"))]
        if fork in thighs:
            raise SkeletonError(
                f"one thigh hangs below the other: {', '.join(self.names[j] for j in thighs)}"
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
        """Rest length along the hierarchy from the first path's fork to a joint."""
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
        """The last joint along a limb bone before the next placed joint: twist joints count."""
        below = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}
        place = self.places[name]
        for side in ("Left", "Right"):
            part = name.removeprefix(side)
            if part != name and part in below and f"{side}{below[part]}" in self.places:
                return self.parents[self.places[f"{side}{below[part]}"]]
        return place


def _spine_names(heights: list[float], top: float) -> tuple[str, ...]:
    """The canonical spine joints whose share of the way from hips to shoulders is nearest."""

    def misfit(names: tuple[str, ...]) -> float:
        return sum(abs(SPINE_SHARES[n] - h / top) for n, h in zip(names, heights, strict=True))

    return min(combinations(SPINE_SHARES, len(heights)), key=misfit)
