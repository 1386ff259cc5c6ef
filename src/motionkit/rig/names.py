"""Maps the joints of other rigs to canonical joints: limbs by name or else by shape, the torso by hierarchy.

A name gives a side and a part: "mixamorig:LeftUpLeg", "Bip01 L Thigh", "thigh.L" and "lThigh" all name the left thigh.
Some words differ between rigs: "LeftShoulder" is a collar bone in one and an upper arm in another. "LeftHip" and
"LeftLeg" are ambiguous too. The other joints of the same side decide. Spine, neck and collar joints are found on the
paths between the limbs, whatever their names.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from motionkit.arrays import Array
from motionkit.errors import SkeletonError
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton, mirrored_name
from motionkit.reading import user_joints
from motionkit.rig.handedness import OPPOSED, handedness
from motionkit.rig.shape import ShapeGuess, limbs_by_shape
from motionkit.rig.sides import joint_sides

# Words of each part, in lower case, without separators and digits. "shoulder", "arm", "hip" and "leg" are parts of
# their own because they are ambiguous.
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
    # Joints between or beside the canonical ones, which are not mapped.
    "other": (
        "hipjoint", "buttock", "end", "nub", "site", "tip", "roll", "twist", "ik", "pole", "target",
        "effector", "rigmesh", "mesh", "helper", "finger", "fingers", "fingerbase", "thumb", "index",
        "middle", "mid", "ring", "pinky", "pinkie", "little", "eye", "jaw", "ear", "hair", "metacarpal",
        "carpal", "metatarsal", "metatarsals",
    ),
}  # fmt: skip
WORDS: dict[str, str] = {word: part for part, words in PARTS.items() for word in words}
SIDES: dict[str, str] = {"left": "Left", "right": "Right", "l": "Left", "r": "Right"}
# Heights of the canonical spine joints between hips (0) and shoulders (1).
SPINE_SHARES: dict[str, float] = {"LowerBack": 0.0, "Spine": 0.28, "Spine1": 0.56}

# Parts that a name may have to confirm a joint between the limbs, and words that confirm a spine joint.
_BETWEEN = {
    "Hips": ("hips", "hip"), "Neck": ("neck",), "Neck1": ("neck",), "Head": ("head",),
    "LeftShoulder": ("collar", "shoulder"), "RightShoulder": ("collar", "shoulder"),
}  # fmt: skip
_SPINE_WORDS = re.compile(
    r"spine|back|chest|abdomen|torso|waist|belly|stomach|trunk|thorax|lumbar", re.IGNORECASE
)

# Parts that show a limb, whichever of its joints a skin has.
_LIMB_PARTS = {"leg": ("thigh", "leg", "shin", "foot"), "arm": ("arm", "upperarm", "forearm", "hand")}
LIMBS = {(side, limb) for side in ("Left", "Right") for limb in _LIMB_PARTS}
_NEEDED = tuple(f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Arm", "ForeArm"))
# Ending of a limb joint to its mapped parent, without the side; longer endings come before shorter ones.
_HANGS = {
    "UpLeg": "Hips",
    "Leg": "UpLeg",
    "Foot": "Leg",
    "ToeBase": "Foot",
    "ForeArm": "Arm",
    "Hand": "ForeArm",
}
# What is said of a rig whose sides are exchanged.
EXCHANGED = "left and right are exchanged: by the names of the joints, the feet would point backwards"
_HELPERS = ("ik", "pole", "target")  # words before a part that mark a helper, such as ik_foot_l
_TOKENS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+")
_WORD = "|".join(sorted(WORDS, key=len, reverse=True))
_SIDE = "|".join(SIDES)
_SIDED_WORD = re.compile(rf"(?:({_SIDE})({_WORD})|({_WORD})({_SIDE})|({_WORD}))")


@dataclass(frozen=True)
class RigMap:
    """The canonical joints of a source skeleton.

    Attributes:
        places: canonical name to the index of the source joint at its place.
        turns: canonical name to the index of the source joint with its rotation; this is another joint if twist joints
            follow along the same bone.
        likely: probability from 0 to 1, by the shape of the rig, of limb joints that were found by shape or whose
            names disagree with the shape; other joints have 1.
        by_shape: limb joints found by shape, because their names are unknown.
        by_name: joints between the limbs whose names confirm them.
        sides_sure: probability that left is left; below 1 only if no name says so.
        source: of the map, such as "map" for a user's bone map; "" if the joints were found.
        exchanged: whether left joints bear the names of right ones, because feet would point backwards by the names.
    """

    places: dict[str, int]
    turns: dict[str, int]
    likely: dict[str, float] = field(default_factory=dict)
    by_shape: frozenset[str] = frozenset()
    by_name: frozenset[str] = frozenset()
    sides_sure: float = 1.0
    source: str = ""
    exchanged: bool = False

    def sure(self, name: str) -> float:
        """Probability from 0 to 1 that a canonical joint is right."""
        side = self.sides_sure if name.startswith(("Left", "Right")) else 1.0
        return self.likely.get(name, 1.0) * side

    def found(self, name: str) -> str:
        """How a joint was found: "map", "VRM", "name", "shape", or "place" for an unnamed joint between the limbs."""
        if self.source:
            return self.source
        if name in self.by_shape:
            return "shape"
        between = name in SPINE_SHARES or name in _BETWEEN
        return "place" if between and name not in self.by_name else "name"

    def pair(self, part: str) -> list[int]:
        """The left and the right joint of a part, such as "UpLeg", that the source has."""
        return [self.places[f"{side}{part}"] for side in ("Left", "Right")]

    def with_sides_exchanged(self) -> RigMap:
        """The map, found by names, that takes left joints for right ones, and right ones for left ones."""
        return RigMap(
            {mirrored_name(name): joint for name, joint in self.places.items()},
            {mirrored_name(name): joint for name, joint in self.turns.items()},
            {mirrored_name(name): sure for name, sure in self.likely.items()},
            by_name=frozenset(map(mirrored_name, self.by_name)),
            exchanged=not self.exchanged,
        )

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
        if any(token in _HELPERS for token in tokens[:start]):
            return "", "other"
        before, word_after, word_before, after, alone = match.groups()
        side = before or after or next((t for t in tokens[:start] if t in SIDES), "")
        return SIDES.get(side, ""), WORDS[word_after or word_before or alone]
    return "", ""


def limb(name: str) -> tuple[str, str]:
    """Side ("" for none) and limb ("leg", "arm" or "") of a joint name, as far as it tells."""
    side, part = name_part(name)
    return side, next((limb for limb, parts in _LIMB_PARTS.items() if part in parts), "")


def tables() -> dict[str, Any]:
    """What names mean, as JSON values: a page that maps rigs itself (web/src/demo/rig.js) has no table of its own."""
    return {
        "tokens": _TOKENS.pattern, "sided": _SIDED_WORD.pattern, "sides": SIDES, "helpers": _HELPERS,
        "limbParts": _LIMB_PARTS, "parts": PARTS, "spine": SPINE_SHARES, "needed": _NEEDED, "hangs": _HANGS,
    }  # fmt: skip


def map_rig(skeleton: Skeleton, poses: Array | None = None) -> RigMap:
    """Find the canonical joints in a skeleton; raises SkeletonError if it is not a human rig, or a limb is missing.

    The user's bone map comes first, then Skeleton.humanoid, then names and shape. Recorded joint positions (P, J, 3)
    help to find limbs with unknown names.
    """
    places = user_places(skeleton)
    if places is not None:
        return user_map(skeleton, places)
    if skeleton.humanoid:
        return _Mapper(skeleton).around(skeleton.humanoid)
    if poses is not None:
        return _Mapper(skeleton).map(poses)
    offsets = skeleton.offsets
    ends = tuple(skeleton.end_sites.items())
    return _map_of_rest(skeleton.names, skeleton.parents, offsets.tobytes(), offsets.dtype.char, ends)


@lru_cache(maxsize=64)  # most clips of a folder are of one rig, and a command asks several times
def _map_of_rest(
    names: tuple[str, ...], parents: tuple[int, ...], offsets: bytes, kind: str, ends: tuple[Any, ...]
) -> RigMap:
    """The map of a skeleton by its names and rest pose; the arguments are its fields as values that can be compared."""
    places = np.frombuffer(offsets, kind).reshape(-1, 3)
    return _Mapper(Skeleton(names, parents, places, dict(ends))).map(None)


def user_places(skeleton: Skeleton) -> dict[str, int] | None:
    """The canonical joints that the user gives, if the skeleton has all of their joints."""
    joints = user_joints() or {}
    if not joints or not set(joints.values()) <= set(skeleton.names):
        return None
    return {name: skeleton.index(joints[name]) for name in JOINT_NAMES if name in joints}


def user_map(skeleton: Skeleton, places: dict[str, int]) -> RigMap:
    """The map of a skeleton with known canonical joints; raises SkeletonError if they cannot be a body."""
    return _Mapper(skeleton).from_user(places)


class _Mapper:
    """Maps a hierarchy whose names have been split into sides and parts: the limbs first, then the torso."""

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
        guess = limbs_by_shape(self.skeleton, joint_sides(self.names), poses)
        by_shape = self._fill_in(guess)
        self._require()
        self._hips()
        self._torso()
        sides_sure = guess.sides_sure if guess and by_shape else 1.0
        found = replace(
            self._rig_map(),
            likely=self._likely(guess, by_shape),
            by_shape=by_shape,
            by_name=self._by_name(),
            sides_sure=sides_sure,
        )
        return found.with_sides_exchanged() if not by_shape and self._backwards() else found

    def _backwards(self) -> bool:
        """Whether the feet of a standing rest pose point backwards by the names, which then exchange left and right."""
        places, points = dict(self.places), list(self.rest)
        for side in ("Left", "Right"):
            foot = self.places.get(f"{side}Foot")
            if foot in self.skeleton.end_sites and f"{side}ToeBase" not in places:
                places[f"{side}ToeBase"] = len(points)
                points.append(self.rest[foot] + self.skeleton.end_sites[foot])
        agree, toes = handedness(places, np.array(points)[None])
        return agree > -OPPOSED and toes is not None and toes < OPPOSED

    def around(self, limbs: dict[str, int]) -> RigMap:
        """The map around the limbs, hips and head of an avatar's bone table."""
        self.places = dict(limbs)
        self._require()
        self._check_limbs()
        if "Hips" not in limbs:
            self._hips()
        self._torso()
        return replace(self._rig_map(), source="VRM")

    def _torso(self) -> None:
        chest = self._spine()
        self._neck(chest)
        for side in ("Left", "Right"):
            self._collar(side, chest)

    def from_user(self, places: dict[str, int]) -> RigMap:
        self.places = places
        lacking = [name for name in ("Hips", *_NEEDED) if name not in places]
        if lacking:
            raise SkeletonError(f"no joint is mapped to {', '.join(lacking)}")
        self._check_limbs()
        return replace(self._rig_map(), source="map")

    def _check_limbs(self) -> None:
        """Raise SkeletonError for a limb joint that does not descend from the mapped joint above it."""
        for name, joint in self.places.items():
            above = next((top for part, top in _HANGS.items() if name.endswith(part)), None)
            if above is None:
                continue
            side = "Left" if name.startswith("Left") else "Right"
            above = above if above == "Hips" else f"{side}{above}"
            top = self.places.get(above)
            if top is not None and top not in self.skeleton.path(joint)[:-1]:
                raise SkeletonError(
                    f"{self.names[joint]} is mapped to {name} but does not hang from {self.names[top]}, "
                    f"which is mapped to {above}"
                )

    def _rig_map(self) -> RigMap:
        ordered = {name: self.places[name] for name in JOINT_NAMES if name in self.places}
        return RigMap(ordered, {name: self._turn(name) for name in ordered})

    def _fill_in(self, guess: ShapeGuess | None) -> frozenset[str]:
        """Take limbs without known names from the shape; returns their canonical joints."""
        found: set[str] = set()
        for parts in (("UpLeg", "Leg", "Foot", "ToeBase"), ("Arm", "ForeArm", "Hand")):
            names = {f"{side}{part}" for side in ("Left", "Right") for part in parts}
            if guess and names & self._lacking():  # take a whole limb from one source
                for name in names:
                    self.places.pop(name, None)
                    if name in guess.places:
                        self.places[name] = guess.places[name]
                        found.add(name)
        return frozenset(found)

    def _likely(self, guess: ShapeGuess | None, by_shape: frozenset[str]) -> dict[str, float]:
        if guess is None:
            return {}
        likely = {name: guess.sure[name] for name in by_shape}
        for part in ("UpLeg", "Leg", "Foot", "Arm", "ForeArm"):
            for name in (f"Left{part}", f"Right{part}"):
                if name in guess.places and guess.places[name] != self.places.get(name):
                    likely[name] = 1.0 - guess.sure[name] * guess.sides_sure
        return likely

    def _by_name(self) -> frozenset[str]:
        """The joints between the limbs whose names confirm them."""
        found = set()
        for name, joint in self.places.items():
            side, part = self.parts[joint]
            sided = next((one for one in ("Left", "Right") if name.startswith(one)), "")
            if name in SPINE_SHARES:
                confirmed = _SPINE_WORDS.search(self.names[joint]) is not None
            else:
                confirmed = side == sided and part in _BETWEEN.get(name, ())
            if confirmed:
                found.add(name)
        return frozenset(found)

    def _lacking(self) -> set[str]:
        return {name for name in _NEEDED if name not in self.places}

    def common(self, *joints: int) -> int:
        """The deepest common ancestor of these joints, which may be one of them."""
        paths = [self.skeleton.path(joint) for joint in joints]
        shared = [steps[0] for steps in zip(*paths, strict=False) if len(set(steps)) == 1]
        return shared[-1]

    def find(self, side: str, *parts: str, under: int | None = None, carries: bool = False) -> int | None:
        """The joint of one of these parts with the most descendants, below `under` if given.

        Rigs repeat names for helpers and meshes. These are leaves, and `carries` excludes leaves.
        """
        found = [
            j
            for j, (joint_side, part) in enumerate(self.parts)
            if joint_side == side
            and part in parts
            and self.subtree[j] > carries
            and (under is None or under in self.skeleton.path(j)[:-1])
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
        # Some rigs call their only foot joint a toe. In others the foot is the joint below the ankle.
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
        above = [j for j in self.skeleton.path(fork) if self.parts[j] in (("", "hips"), ("", "hip"))]
        if fork in thighs:
            raise SkeletonError(
                f"one thigh is a descendant of the other: {', '.join(self.names[j] for j in thighs)}"
            )
        self.places["Hips"] = above[-1] if above else fork

    def _spine(self) -> int:
        """Map the spine joints; returns the chest, the last common ancestor of both arms."""
        fork = self.common(self.places["LeftArm"], self.places["RightArm"])
        below = self.common(self.places["Hips"], fork)
        path = self.skeleton.path(fork)
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
        path = self.skeleton.path(below)
        start = path.index(self.common(above, below))
        return float(sum(np.linalg.norm(self.offsets[j]) for j in path[start + 1 :]))

    def _neck(self, chest: int) -> None:
        head = self.places.get("Head", self.find("", "head", under=chest))
        self.put("Head", head)
        if head is None:
            neck = self.find("", "neck", under=chest)
            if neck is not None or self.put("Head", self._head_by_shape(chest)) is None:
                self.put("Neck", neck)
                return
            head = self.places["Head"]
        path = self.skeleton.path(head)
        neck_joints = path[path.index(chest) + 1 : -1]
        if neck_joints:
            self.places["Neck"] = neck_joints[0]
        if len(neck_joints) > 1:
            self.places["Neck1"] = neck_joints[-1]

    def _head_by_shape(self, chest: int) -> int | None:
        """Find a head of unknown name: at most the third joint along the longest branch of the chest without arms.

        A joint that branches (into eyes and jaw) is the head. The last joint of a longer chain is only the tip of the
        head if it has no length of its own.
        """
        arms = {self.places["LeftArm"], self.places["RightArm"]}

        def free(joint: int) -> list[int]:
            return [
                j
                for j in self.skeleton.children(joint)
                if not any(j in self.skeleton.path(arm) for arm in arms)
            ]

        chain: list[int] = []
        here = chest
        while below := free(here):
            here = max(below, key=lambda j: self.reach(j))
            chain.append(here)
            if sum(self.reach(j) > 0.02 * self.reach(0) for j in free(here)) > 1:
                return here
        if not chain or self.reach(chain[0]) < 0.05 * self.reach(0):
            return None
        end = float(np.linalg.norm(self.skeleton.end_sites.get(chain[-1], (0.0, 0.0, 0.0))))
        tip = len(chain) > 2 and end < 0.03 * self.reach(0)
        return chain[min(len(chain) - 1 - tip, 2)]

    def reach(self, joint: int) -> float:
        """The longest path from a joint's parent through the joint to the end of a branch."""
        end = float(np.linalg.norm(self.skeleton.end_sites.get(joint, (0.0, 0.0, 0.0))))
        below = max((self.reach(child) for child in self.skeleton.children(joint)), default=end)
        return below + (float(np.linalg.norm(self.offsets[joint])) if joint else 0.0)

    def _collar(self, side: str, chest: int) -> None:
        path = self.skeleton.path(self.places[f"{side}Arm"])
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
    """The canonical spine joints nearest to some heights between hips and shoulders."""

    def misfit(names: tuple[str, ...]) -> float:
        return sum(abs(SPINE_SHARES[n] - h / top) for n, h in zip(names, heights, strict=True))

    return min(combinations(SPINE_SHARES, len(heights)), key=misfit)
