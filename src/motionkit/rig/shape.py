"""Finds the legs and arms of a rig by its shape, whatever its joints are called.

A pair of limbs is two branches of one joint with the same bone lengths. Legs and arms are the pairs, and the joints
along them, whose proportions are most like a human's. Each assignment has a cost, the negative logarithm of its
likelihood. The costs of the other assignments give the probability of the best one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from motionkit.arrays import Array, cross, normalized
from motionkit.motion.skeleton import Skeleton

# Tolerance of equal bones, as a share of their length plus a share of the rig's size.
_EQUAL, _EQUAL_SIZE = 0.12, 0.005
_SHORTEST_LIMB = 0.15  # share of the longest path; fingers, eyes and ears are shorter
# Most pairs, joints along a limb, and assignments of a pair that are compared.
_MOST_PAIRS, _MOST_JOINTS, _BEST = 8, 24, 6
# Mean and standard deviation of proportions, and of logarithms of ratios. They are those of the tested rigs, widened
# for toons and for rigs with unusual joint places.
_THIGH_SHIN = (math.log(0.92), 0.18)
_HIP_WIDTH = (0.3, 0.2)  # from the fork of the legs, as a share of the thigh
_FOOT_SHIN = (math.log(0.35), 0.5)
# As shares of the leg: path from the fork of the arms to the shoulder, upper arm, forearm, and path from fork to fork.
_COLLAR_LEG, _UPPER_LEG, _FORE_LEG = (0.38, 0.13), (math.log(0.32), 0.15), (math.log(0.27), 0.25)
_TORSO_LEG = (0.45, 0.25)
_HAND_FORE = (math.log(0.5), 0.8)
_STUB = 0.1  # share of a shin or forearm; a shorter end is no foot or hand
_NO_END = 1.0  # cost of a leg without a foot, or an arm without a hand
_EXTRA = 0.4  # cost of a joint along a bone, such as a twist joint
_FINGERS = 1.5  # cost of a hand or foot below a joint that branches
_BENT = 0.06  # deviation of the share by which a bone is shorter than the path through its joints
# Mean and deviation of the height of ankles below the hips, and of wrists above the shoulders, as shares of the limb.
_LEG_DOWN, _WRIST = (1.0, 0.35), (0.0, 1.2)
_UPSIDE_DOWN = 3.0  # cost if the fork of the legs descends from that of the arms
_APART = 1.0  # cost if neither fork descends from the other
_NOT_HUMAN = 9.0  # cost at which a human rig and anything else are equally likely
_HOPELESS = _NOT_HUMAN + 12.0  # cost that is less likely than that by e^12


@dataclass(frozen=True)
class ShapeGuess:
    """Limbs found by shape.

    Attributes:
        places: canonical names of limb joints to joint indices; feet, toes and hands only if the rig has them.
        sure: probability from 0 to 1 of each of them, apart from its side.
        sides_sure: probability that left is left.
    """

    places: dict[str, int]
    sure: dict[str, float]
    sides_sure: float


@dataclass(frozen=True)
class _Pair:
    """Two branches with equal bones.

    Attributes:
        fork: the parent of both branches.
        joints: joints of both branches, from the fork outwards.
        distances: path length from the fork to each of them, and to the end of the last bone.
    """

    fork: int
    joints: tuple[tuple[int, int], ...]
    distances: tuple[float, ...]


@dataclass(frozen=True)
class _Limb:
    """Upper, middle and lower joint of a pair, as indices into its joints; lower may be the end of the last bone."""

    pair: _Pair
    upper: int
    middle: int
    lower: int
    cost: float

    @property
    def length(self) -> float:
        return self.pair.distances[self.lower] - self.pair.distances[self.upper]

    def named(self, names: tuple[str, ...]) -> dict[str, tuple[int, int]]:
        """Joints of both branches by names for the upper, middle, lower and next joint, as far as they exist."""
        at = (self.upper, self.middle, self.lower, self.lower + 1)
        joints = self.pair.joints
        return {name: joints[index] for name, index in zip(names, at, strict=False) if index < len(joints)}


_LEG_NAMES, _ARM_NAMES = ("UpLeg", "Leg", "Foot", "ToeBase"), ("Arm", "ForeArm", "Hand")


def limbs_by_shape(
    skeleton: Skeleton, sides: tuple[str, ...], poses: Array | None = None
) -> ShapeGuess | None:
    """Find the legs and arms of a rig by its recorded poses (P, J, 3), else its rest pose; None if it is not human.

    sides are "left", "right" or "" for each joint, by its name.
    """
    tree, poses, bodies = _bodies(skeleton, poses)
    if not bodies:
        return None
    best, leg, arm = bodies[0]
    weights = [math.exp(best - cost) for cost, _, _ in bodies]
    total = sum(weights) + math.exp(best - _NOT_HUMAN)
    found = leg.named(_LEG_NAMES) | arm.named(_ARM_NAMES)
    likely = dict.fromkeys(found, 0.0)
    for weight, (_, other_leg, other_arm) in zip(weights, bodies, strict=True):
        for name, joints in (other_leg.named(_LEG_NAMES) | other_arm.named(_ARM_NAMES)).items():
            if found.get(name) == joints:
                likely[name] += weight / total
    sides_sure, left_leg, left_arm = _left(tree, sides, (leg, arm), poses)
    places, sure = {}, {}
    for name, joints in found.items():
        left = left_leg if name in _LEG_NAMES else left_arm
        places[f"Left{name}"], places[f"Right{name}"] = joints[left], joints[1 - left]
        sure[f"Left{name}"] = sure[f"Right{name}"] = likely[name]
    return ShapeGuess(places, sure, sides_sure)


def opposites_by_shape(skeleton: Skeleton, poses: Array | None = None) -> tuple[int, ...] | None:
    """Each joint's opposite on the other side, by shape alone; of a central joint, itself. None if not human."""
    tree, _, bodies = _bodies(skeleton, poses)
    if not bodies:
        return None
    _, leg, arm = bodies[0]
    opposites = list(range(len(skeleton)))
    for limb in (leg, arm):
        tree.pair_up(*limb.pair.joints[0], opposites)
    across = tree.rest[leg.pair.joints[0][0]] - tree.rest[leg.pair.joints[0][1]]
    for joint, children in enumerate(tree.children):
        if opposites[joint] == joint:
            tree.pair_children([c for c in children if opposites[c] == c], normalized(across), opposites)
    return tuple(opposites)


def _bodies(skeleton: Skeleton, poses: Array | None) -> tuple[_Tree, Array, list[tuple[float, _Limb, _Limb]]]:
    """The hierarchy, its poses, and costs, legs and arms of likely assignments, the best first; none if not human."""
    tree = _Tree(skeleton)
    poses = (tree.rest[None] if poses is None else poses).astype(np.float64)
    pairs = tree.pairs()
    legs = {pair: _limbs(tree, pair, _leg_cost) for pair in pairs}
    arms = {pair: _limbs(tree, pair, _arm_cost) for pair in pairs}
    found: list[tuple[float, _Limb, _Limb]] = []
    for one, other in permutations(pairs, 2):
        if tree.carries(one, other) or tree.carries(other, one):
            continue
        shared = _fork_cost(tree, one, other)
        for leg in legs[one]:
            for arm in arms[other]:
                found.append((shared + leg.cost + arm.cost + _body_cost(tree, leg, arm, poses), leg, arm))
    found.sort(key=lambda each: each[0])
    return tree, poses, found if found and found[0][0] <= _NOT_HUMAN else []


class _Tree:
    """The hierarchy, with the pairs of equal branches in it."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.rest = skeleton.rest_positions().astype(np.float64)
        self.bones = np.linalg.norm(skeleton.offsets.astype(np.float64), axis=-1)
        self.bones[0] = 0.0
        self.ends = {joint: math.hypot(*end) for joint, end in skeleton.end_sites.items()}
        self.children: list[list[int]] = [[] for _ in skeleton.names]
        for joint, parent in enumerate(skeleton.parents):
            if parent >= 0:
                self.children[parent].append(joint)
        reach = np.array([self.ends.get(joint, 0.0) for joint in range(len(skeleton))])
        for joint in range(len(skeleton) - 1, 0, -1):
            parent = skeleton.parents[joint]
            reach[parent] = max(reach[parent], reach[joint] + self.bones[joint])
        self.reach = reach + self.bones
        self.size = float(reach[0])
        self._matched: dict[tuple[int, int], tuple[float, tuple[tuple[int, int], ...]]] = {}

    def pairs(self) -> list[_Pair]:
        """The longest pairs of equal branches."""
        found: list[tuple[float, _Pair]] = []
        for fork, children in enumerate(self.children):
            long = [child for child in children if self.reach[child] >= _SHORTEST_LIMB * self.size]
            for one, other in combinations(sorted(long, key=lambda j: -self.reach[j])[:_MOST_PAIRS], 2):
                if not self._equal(self.bones[one], self.bones[other]):
                    continue
                length, joints = self._match(one, other)
                if length >= _SHORTEST_LIMB * self.size:
                    found.append((length, self._pair(fork, joints[:_MOST_JOINTS])))
        found.sort(key=lambda each: -each[0])
        return [pair for _, pair in found[:_MOST_PAIRS]]

    def _pair(self, fork: int, joints: tuple[tuple[int, int], ...]) -> _Pair:
        distances, here = [], 0.0
        for one, other in joints:
            here += 0.5 * float(self.bones[one] + self.bones[other])
            distances.append(here)
        one, other = joints[-1]
        distances.append(here + min(self.ends.get(one, 0.0), self.ends.get(other, 0.0)))
        return _Pair(fork, joints, tuple(distances))

    def _equal(self, a: float, b: float) -> bool:
        return abs(a - b) <= _EQUAL * max(a, b) + _EQUAL_SIZE * self.size

    def _match(self, one: int, other: int) -> tuple[float, tuple[tuple[int, int], ...]]:
        """Length and joints of the longest equal chain that begins at two joints."""
        key = (one, other)
        if key not in self._matched:
            end = min(self.ends.get(one, 0.0), self.ends.get(other, 0.0))
            best: tuple[float, tuple[tuple[int, int], ...]] = (end, ())
            for a in self.children[one]:
                for b in self.children[other]:
                    if self._equal(self.bones[a], self.bones[b]):
                        best = max(best, self._match(a, b), key=lambda each: each[0])
            bone = 0.5 * float(self.bones[one] + self.bones[other])
            self._matched[key] = (bone + best[0], (key, *best[1]))
        return self._matched[key]

    def pair_up(self, one: int, other: int, opposites: list[int]) -> None:
        """Make two joints opposites, and the similar joints below them too."""
        opposites[one], opposites[other] = other, one
        free = list(self.children[other])
        for a in sorted(self.children[one], key=lambda j: -self.reach[j]):
            alike = [b for b in free if self._equal(self.bones[a], self.bones[b])]
            if alike:
                nearest = min(alike, key=lambda b: abs(self.reach[a] - self.reach[b]))
                free.remove(nearest)
                self.pair_up(a, nearest, opposites)

    def pair_children(self, children: list[int], across: Array, opposites: list[int]) -> None:
        """Pair children of a central joint that mirror each other in the plane at right angles to across."""
        offsets = self.skeleton.offsets.astype(np.float64)
        for a, b in combinations(children, 2):
            aside = float(offsets[a] @ across)
            image = offsets[a] - 2.0 * aside * across
            near = (
                float(np.linalg.norm(image - offsets[b])) <= _EQUAL * self.bones[a] + _EQUAL_SIZE * self.size
            )
            if opposites[a] == a and opposites[b] == b and near and abs(aside) > _EQUAL_SIZE * self.size:
                self.pair_up(a, b, opposites)

    def end(self, joint: int) -> Array:
        """The End Site (3,) of a joint; zero without one."""
        return np.array(self.skeleton.end_sites.get(joint, (0.0, 0.0, 0.0)))

    def carries(self, pair: _Pair, other: _Pair) -> bool:
        """Whether a branch of `other` equals or descends from a branch of `pair`."""
        return any(self.skeleton.descends(b, a) for a in pair.joints[0] for b in other.joints[0])

    def torso(self, low: int, high: int) -> float | None:
        """Path length between two joints if one descends from the other, else None."""
        if not self.skeleton.descends(high, low):
            low, high = high, low
        if not self.skeleton.descends(high, low):
            return None
        return float(self.bones[self.skeleton.between(low, high)].sum())


def _off(value: float, expected: tuple[float, float]) -> float:
    """The cost of a value with an expected mean and standard deviation."""
    return 0.5 * ((value - expected[0]) / expected[1]) ** 2


def _limbs(tree: _Tree, pair: _Pair, cost_of: Callable[[float, float, float, float], float]) -> list[_Limb]:
    """The most likely upper, middle and lower joints of a pair."""
    found = []
    for upper, middle, lower in combinations(range(len(pair.distances)), 3):
        if middle >= len(pair.joints):
            continue
        first, second = (
            pair.distances[middle] - pair.distances[upper],
            pair.distances[lower] - pair.distances[middle],
        )
        if min(first, second) < 1e-3 * tree.size:
            continue
        behind = pair.distances[-1] - pair.distances[lower]
        cost = cost_of(pair.distances[upper], first, second, behind if behind > _STUB * second else 0.0)
        cost += _NO_END * (lower >= len(pair.joints)) + _EXTRA * (lower - upper - 2)
        cost += _FINGERS * any(len(tree.children[pair.joints[j][0]]) > 1 for j in range(middle + 1, lower))
        cost += _bend_cost(tree, pair, upper, middle) + _bend_cost(tree, pair, middle, lower)
        found.append(_Limb(pair, upper, middle, lower, cost))
    return sorted(found, key=lambda limb: limb.cost)[:_BEST]


def _leg_cost(before: float, thigh: float, shin: float, foot: float) -> float:
    end = _off(math.log(foot / shin), _FOOT_SHIN) if foot else _NO_END
    return _off(math.log(thigh / shin), _THIGH_SHIN) + _off(before / thigh, _HIP_WIDTH) + end


def _arm_cost(before: float, upper: float, fore: float, hand: float) -> float:
    """The cost of an arm by itself; _body_cost compares its lengths with those of the legs."""
    return _off(math.log(hand / fore), _HAND_FORE) if hand else _NO_END


def _bend_cost(tree: _Tree, pair: _Pair, top: int, bottom: int) -> float:
    """The cost of joints along a bone that are not on a line."""
    if bottom >= len(pair.joints) or bottom == top + 1:
        return 0.0
    path = pair.distances[bottom] - pair.distances[top]
    ends = zip(pair.joints[top], pair.joints[bottom], strict=True)
    straight = sum(float(np.linalg.norm(tree.rest[b] - tree.rest[a])) for a, b in ends) / 2
    return _off(1.0 - straight / path, (0.0, _BENT))


def _fork_cost(tree: _Tree, legs: _Pair, arms: _Pair) -> float:
    if tree.skeleton.descends(arms.fork, legs.fork):
        return 0.0
    return _UPSIDE_DOWN if tree.skeleton.descends(legs.fork, arms.fork) else _APART


def _body_cost(tree: _Tree, leg: _Limb, arm: _Limb, poses: Array) -> float:
    """The cost of a leg and an arm together, by their lengths and their places in the poses.

    The poses are not looked at where the lengths alone cost too much to matter.
    """
    distances, size = arm.pair.distances, leg.length
    cost = _off(distances[arm.upper] / size, _COLLAR_LEG)
    cost += _off(math.log((distances[arm.middle] - distances[arm.upper]) / size), _UPPER_LEG)
    cost += _off(math.log((distances[arm.lower] - distances[arm.middle]) / size), _FORE_LEG)
    torso = tree.torso(leg.pair.fork, arm.pair.fork)
    if torso is not None:
        cost += _off(torso / size, _TORSO_LEG)
    if cost + leg.cost + arm.cost > _HOPELESS:
        return cost
    hips, shoulders = _middle(leg, leg.upper, poses), _middle(arm, arm.upper, poses)
    up = normalized(shoulders - hips)
    down = ((hips - _middle(leg, leg.lower, poses)) * up).sum(-1) / size
    raised = ((_middle(arm, arm.lower, poses) - shoulders) * up).sum(-1) / arm.length
    return cost + _off(min(float(np.median(down)), 1.0), _LEG_DOWN) + _off(float(np.median(raised)), _WRIST)


def _joint(limb: _Limb, index: int, side: int, poses: Array) -> Array:
    """Positions (P, 3) of a limb's joint; the last joint stands for the end of its bone."""
    return poses[:, limb.pair.joints[min(index, len(limb.pair.joints) - 1)][side]]


def _across(limb: _Limb, index: int, poses: Array) -> Array:
    """Vectors (P, 3) from a joint of the second branch to that of the first."""
    return _joint(limb, index, 0, poses) - _joint(limb, index, 1, poses)


def _middle(limb: _Limb, index: int, poses: Array) -> Array:
    """Midpoints (P, 3) between the joints of both sides."""
    return 0.5 * (_joint(limb, index, 0, poses) + _joint(limb, index, 1, poses))


def _left(
    tree: _Tree, sides: tuple[str, ...], limbs: tuple[_Limb, _Limb], poses: Array
) -> tuple[float, int, int]:
    """The probability of the sides, and the left branch of legs and of arms: by names, else by facing."""
    leg, arm = limbs
    # Hips and shoulders count more, because knees and elbows may cross the middle.
    across = [3.0 * _across(limb, limb.upper, poses) + _across(limb, limb.middle, poses) for limb in limbs]
    same = float(np.median((across[0] * across[1]).sum(-1))) >= 0.0
    votes = 0
    for limb, sign in ((leg, 1), (arm, 1 if same else -1)):
        for one, other in limb.pair.joints:
            votes += sign * (_LEFTNESS[sides[one]] - _LEFTNESS[sides[other]])
    if votes:
        first, sure = votes > 0, 1.0
    else:
        lateral = _leftward(tree, leg, arm, across[0], poses)
        first, sure = lateral >= 0.0, 1.0 / (1.0 + math.exp(-_SIDE_STEEP * abs(lateral)))
    left = 0 if first else 1
    return sure, left, left if same else 1 - left


_LEFTNESS = {"left": 1, "right": -1, "": 0}
_SIDE_STEEP = 8.0
_TRUST_TRAVEL, _TRUST_Z = 0.3, 0.15  # weights of the direction of travel and of +Z; feet and knees have 1


def _leftward(tree: _Tree, leg: _Limb, arm: _Limb, across: Array, poses: Array) -> float:
    """Evidence (-1 to 1) that the first branch is the left one, from the first sign of where forward is.

    The signs are, in this order: feet point forward, knees bend forward, bodies mostly travel forward, +Z is forward.
    """
    up = normalized(_middle(arm, arm.upper, poses) - _middle(leg, leg.upper, poses))
    hip, knee, ankle = (_middle(leg, index, poses) for index in (leg.upper, leg.middle, leg.lower))
    toe = _middle(leg, len(leg.pair.joints), poses) - ankle
    ends = [tree.end(leg.pair.joints[-1][side]) for side in (0, 1)]
    share = ((knee - hip) * (ankle - hip)).sum(-1, keepdims=True) / np.maximum(
        ((ankle - hip) ** 2).sum(-1, keepdims=True), 1e-9
    )
    bend = knee - hip - share * (ankle - hip)
    rest_toe = np.broadcast_to(0.5 * (ends[0] + ends[1]), up.shape) if len(poses) == 1 else np.zeros_like(up)
    travel = np.gradient(hip, axis=0) if len(poses) > 2 else np.zeros_like(hip)
    ahead = np.broadcast_to(np.array([0.0, 0.0, 0.1]) * leg.length, up.shape)
    evidence = (
        (toe, 1.0),
        (rest_toe, 1.0),
        (bend, 1.0),
        (travel, _TRUST_TRAVEL),
        (ahead, _TRUST_Z),
    )
    forward, trust = toe, 0.0
    for candidate, weight in evidence:
        forward, trust = candidate - (candidate * up).sum(-1, keepdims=True) * up, weight
        if float(np.median(np.linalg.norm(forward, axis=-1))) > 0.04 * leg.length:
            break
    return trust * float(np.mean((normalized(across) * cross(up, normalized(forward))).sum(-1)))
