"""A body mesh for any skeleton: one of motionkit's bodies for human rigs, tapered bones for others.

The body's parts are scaled to the rig's bones: along a limb by its length, across it by the size of the whole. Then
skin weights pass from the body's joints to those of the rig, which may have more joints along a bone, or fewer.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import lower_median, smoothstep
from motionkit.errors import SkeletonError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_between, quat_rotate, quat_to_matrix
from motionkit.motion.skeleton import Skeleton
from motionkit.rig.names import RigMap, map_rig, name_part
from motionkit.view.asset import BODIES, Asset, load_asset
from motionkit.view.contact_sheet_geometry import Figure, motion_figure
from motionkit.view.surface import REGIONS, Array, Surface, unit

SIDES = ("Left", "Right")
INFLUENCES = 4  # most joints per point
LONGEST = 20.0  # largest ratio of a bone to the same bone of a body of the same legs
# As shares of the leg: the least drop from ankle to ball of a standing foot, to which those of CMU's rest poses are
# raised, the largest and least at which the foot of a rest pose stands flat, and the least height of its ball.
DROP, FLAT, BALL = 0.045, (0.015, 0.13), 0.024
# Bones of limbs, each with the joint at its end.
_BONES = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}
_FINGERS = {"Thumb": "thumb", "Index": "index", "Middle": "mid", "Ring": "ring", "Pinky": "pink|little"}
_UPRIGHT = 0.96  # cosine of the angle to an axis of the world within which that axis is up
_NO_FINGER = "end|nub|tip|site"
_SPINE = ("Hips", "LowerBack", "Spine", "Spine1")
_TRUNK = (*_SPINE, "Shoulder")
Chain = Sequence[tuple[float, float, int]]


@dataclass(frozen=True, eq=False)
class BodyPose:
    """The pose in which a body mesh is made.

    Attributes:
        rotations: (J, 3, 3) global rotations.
        places: (J, 3) global positions, m.
        ends: joint index -> end (3,) of its bone.
        parents: J parent indices.
    """

    rotations: Array
    places: Array
    ends: dict[int, Array]
    parents: tuple[int, ...]

    def matrices_from(self, rotations: Array, places: Array) -> Array:
        """Affine matrices (J, 3, 4) from this pose to another one, given by its rotations and positions."""
        turn = rotations @ self.rotations.transpose(0, 2, 1)
        return np.concatenate(
            [turn, (places - np.einsum("jab,jb->ja", turn, self.places))[..., None]], axis=2
        )

    def copy(self) -> BodyPose:
        """The same pose with its own arrays."""
        ends = {joint: end.copy() for joint, end in self.ends.items()}
        return replace(self, rotations=self.rotations.copy(), places=self.places.copy(), ends=ends)

    def turn(self, joint: int, by: Array) -> None:
        """Turn a joint and its descendants by a rotation (3, 3) about the joint."""
        moved = {joint}
        for child, parent in enumerate(self.parents):
            if parent in moved:
                moved.add(child)
        middle = self.places[joint].copy()
        for one in moved:
            self.places[one] = middle + by @ (self.places[one] - middle)
            self.rotations[one] = by @ self.rotations[one]
            if one in self.ends:
                self.ends[one] = middle + by @ (self.ends[one] - middle)

    def lifted(self, by: Array) -> BodyPose:
        """The pose moved by (3,)."""
        ends = {joint: end + by for joint, end in self.ends.items()}
        return replace(self, places=self.places + by, ends=ends)


def make_body(
    motion: Motion, figure: Figure | None = None, body: str = BODIES[0]
) -> tuple[Surface, BodyPose]:
    """A skinned body mesh for the rig of a motion, and the pose in which the mesh is made.

    Args:
        motion: in metres with Y up (`figure_data.in_metres`). The mesh is made in its rest pose if that is upright,
            else in its most upright frame.
        figure: the motion's `motion_figure`, computed if None.
        body: one of BODIES, for human rigs.

    Raises:
        SkeletonError: all bones of a human rig have length zero.
    """
    check_bones(motion)
    rest = _rest(motion)
    try:
        rig = map_rig(motion.skeleton)
        poses = [rest]
        if _stoop(rest, rig) > 0.5:  # the rest pose is not a standing human
            poses = [_frame(motion, t) for t in np.linspace(0, len(motion) - 1, 24).astype(int)]
        pose = min(poses, key=lambda p: _stoop(p, rig))
        made, pose = _Fitting(load_asset(body), motion.skeleton, rig, pose).surface()
    except SkeletonError:  # no human, or one with the proportions of none
        made, pose = _bony(motion, rest, (figure or motion_figure(motion)).bones), rest
    lift = np.array([0.0, -made.points[:, 1].min(), 0.0])  # on the floor
    return replace(made, points=made.points + lift), pose.lifted(lift)


def check_bones(motion: Motion) -> None:
    """Raise SkeletonError if all bones of a human rig have length zero; other rigs are then drawn as a ball."""
    between = motion.skeleton.offsets if motion.local_positions is None else motion.local_positions
    if between[..., 1:, :].any():
        return
    try:
        map_rig(motion.skeleton)
    except SkeletonError:
        return
    raise SkeletonError("all bones have length zero")


def _rest(motion: Motion) -> BodyPose:
    skeleton = motion.skeleton
    if motion.local_positions is not None:
        skeleton = replace(skeleton, offsets=lower_median(motion.local_positions))
    at = skeleton.rest_positions().astype(np.float64)
    ends = {j: at[j] + np.array(end) for j, end in skeleton.end_sites.items()}
    rotations = np.broadcast_to(np.eye(3), (len(skeleton), 3, 3)).copy()
    return BodyPose(rotations, at, ends, skeleton.parents)


def _frame(motion: Motion, frame: int) -> BodyPose:
    rotations, places = motion_kinematics(motion.cut(frame, frame + 1))
    ends = {
        j: (places[0, j] + quat_rotate(rotations[0, j], np.array(end, np.float32))).astype(np.float64)
        for j, end in motion.skeleton.end_sites.items()
    }
    turns = quat_to_matrix(rotations[0]).astype(np.float64)
    return BodyPose(turns, places[0].astype(np.float64), ends, motion.skeleton.parents)


def _stoop(pose: BodyPose, rig: RigMap) -> float:
    """How far a pose deviates from standing: thighs below the hips, sides apart, chest on top."""
    at = {name: pose.places[joint] for name, joint in rig.places.items()}
    hips, chest = (at["LeftUpLeg"] + at["RightUpLeg"]) / 2, (at["LeftArm"] + at["RightArm"]) / 2
    up = unit(chest - hips, np.zeros(3))
    across = unit(at["LeftUpLeg"] - at["RightUpLeg"], up)
    thighs = [unit(at[f"{side}Leg"] - at[f"{side}UpLeg"], up) for side in SIDES]
    arms = unit(at["LeftArm"] - at["RightArm"], -across)
    return float(sum(1 + up @ thigh for thigh in thighs) + abs(up @ across) + (1 - across @ arms))


def _between(start: Array, end: Array) -> Array:
    """The smallest rotation (3, 3) from one unit vector (3,) to another."""
    return quat_to_matrix(quat_between(start, end))


def _smooth(shares: Array) -> Array:
    return smoothstep(np.clip(shares, 0.0, 1.0))


class _Trunk:
    """The frame of a standing body: its axes, in rows left, up and front, its middle between the hips, lengths in m."""

    def __init__(self, at: dict[str, Array]) -> None:
        self.hips = (at["LeftUpLeg"] + at["RightUpLeg"]) / 2
        chest = (at["LeftArm"] + at["RightArm"]) / 2
        up = unit(self.hips - (at["LeftFoot"] + at["RightFoot"]) / 2, np.array([0.0, 1.0, 0.0]))
        if np.abs(up).max() > _UPRIGHT:
            up = up.round()
        across = at["LeftUpLeg"] - at["RightUpLeg"] + at["LeftArm"] - at["RightArm"]
        left = unit(across - (across @ up) * up, np.eye(3)[0])
        self.axes = np.stack([left, up, np.cross(left, up)])
        # Trunks lean against their legs in some rigs; the torso is sheared along with them.
        self.torso = np.stack([left, chest - self.hips, self.axes[2]])
        self.height = float((chest - self.hips) @ up)
        self.widths = [float(np.linalg.norm(at[f"Left{p}"] - at[f"Right{p}"])) for p in ("UpLeg", "Arm")]
        ends = [(at[f"{side}UpLeg"], at[f"{side}Leg"], at[f"{side}Foot"]) for side in SIDES]
        self.leg = float(np.mean([np.linalg.norm(b - a) + np.linalg.norm(c - b) for a, b, c in ends]))

    def inside(self, points: Array) -> Array:
        """Points (N, 3) as m to the left, shares of the torso's height, and m to the front."""
        shares: Array = (points - self.hips) @ np.linalg.inv(self.torso)
        return shares


class _Fitting:
    """Fits a body to the joints of a human rig."""

    def __init__(self, asset: Asset, skeleton: Skeleton, rig: RigMap, pose: BodyPose) -> None:
        self.asset, self.skeleton, self.pose = asset, skeleton, pose.copy()
        self.joints = dict(rig.places)
        for side in SIDES:
            self.joints |= self._fingers(side)
        self.asset_trunk = _Trunk(asset.places)
        self.trunk = _Trunk({name: self.at(name) for name in asset.places if self._known(name)})
        if self.trunk.leg == 0.0 or self.trunk.height < 0.1 * self.trunk.leg:
            raise SkeletonError("legs or a trunk without length")
        self.size = self.trunk.leg / self.asset_trunk.leg
        self.turn = self.trunk.axes.T @ self.asset_trunk.axes  # from the asset's axes to the rig's
        self.soles = {f"{side}Foot": self._sole(f"{side}Foot") for side in SIDES}
        arms = [skeleton.path(self.joints[f"{side}Arm"]) for side in SIDES]
        chest = [joint for joint in arms[0] if joint in arms[1]]
        hips = rig.places["Hips"]
        self.spine = [hips, *(chest[chest.index(hips) + 1 :] if hips in chest else chest[1:])]

    def surface(self) -> tuple[Surface, BodyPose]:
        """The mesh around the rig, with its limbs in the asset's directions; and this pose."""
        self._strike()
        asset = self.asset
        made = np.zeros_like(asset.points)
        for n, name in enumerate(asset.names):
            some = np.flatnonzero(asset.weights[:, n])
            made[some] += asset.weights[some, n, None] * self._placed(name, asset.points[some])
        joints, weights = _strongest(self._skin(made))
        upright = _between(self.trunk.axes[1], np.array([0.0, 1.0, 0.0]))  # rest poses may have Z up
        made = self.pose.places[0] + (made - self.pose.places[0]) @ upright.T
        self.pose.turn(0, upright)
        return Surface(made, asset.triangles, joints, weights, asset.regions, asset.palette), self.pose

    def at(self, name: str) -> Array:
        """The place of a joint in the pose; of a missing ankle or wrist the end of the bone above."""
        if name in self.joints:
            return self.pose.places[self.joints[name]]
        above = self.asset.parents[name]
        bone = self.at(above) - self.at(self.asset.parents[above])
        return self.pose.ends.get(self.joints[above], self.at(above) + 0.9 * bone)

    def _known(self, name: str | None) -> bool:
        return name is not None and (name in self.joints or name.endswith(("Foot", "Hand")))

    def _fingers(self, side: str) -> dict[str, int]:
        """The joints of a hand's fingers by their names, numbered from the palm."""
        found: dict[str, int] = {}
        names, hand = self.skeleton.names, self.joints.get(f"{side}Hand", len(self.skeleton))
        below = [j for j in range(hand + 1, len(names)) if self.skeleton.descends(j, hand)]
        for finger, words in _FINGERS.items():
            matching = [j for j in below if re.search(words, names[j], re.IGNORECASE)]
            matching = [j for j in matching if not re.search(_NO_FINGER, names[j], re.IGNORECASE)]
            if finger != "Thumb":
                matching = [j for j in matching if "metacarpal" not in names[j].lower()]
            found |= {f"{side}Hand{finger}{n}": joint for n, joint in enumerate(matching[:3], start=1)}
        return found

    def _end(self, name: str) -> str | None:
        """The joint at the end of a joint's bone, if the rig has both."""
        part = re.sub("^(Left|Right)", "", name)
        side = name.removesuffix(part)
        if part in _BONES:
            end = side + _BONES[part]
        elif part[-1].isdigit() and "Hand" in part:
            end = f"{name[:-1]}{int(name[-1]) + 1}"
        elif part in ("Neck", "Neck1"):
            end = "Neck1" if part == "Neck" and "Neck1" in self.joints else "Head"
        else:
            return None
        return end if self._known(end) else None

    def _owner(self, name: str) -> str:
        """The joint that moves the part of a joint: itself, or the nearest above it that the rig has."""
        while name not in self.joints:
            name = self.asset.parents[name]
        return name

    def _strike(self) -> None:
        """Bring the limbs of the pose into the directions of the asset."""
        for name in (name for name in self.asset.names if name in self.joints):
            here, end = self.at(name), self._end(name)
            if name.startswith("Neck"):
                continue
            if name in self.soles:
                toe = name.replace("Foot", "ToeBase")
                if toe not in self.joints:
                    continue
                bone = self.at(toe) - here
                drop = np.clip(self.soles[name][1] / max(float(np.linalg.norm(bone)), 1e-9), 0.0, 0.85)
                wish = [0.0, -drop, np.sqrt(1.0 - drop**2)] @ self._shoe(self.trunk, name)
            elif name.endswith("Hand") and len(knuckles := self._knuckles(name)) > 2:
                bone = np.mean([self.at(knuckle) for knuckle in knuckles], axis=0) - here
                wish = self.turn @ self._palm(name, knuckles)
            elif end is not None:
                bone = self.at(end) - here
                wish = self.turn @ (self.asset.places[end] - self.asset.places[name])
            else:
                continue
            wish = wish / np.linalg.norm(wish)
            self.pose.turn(self.joints[name], _between(unit(bone, wish), wish))

    def _knuckles(self, hand: str) -> list[str]:
        return [f"{hand}{finger}1" for finger in _FINGERS if f"{hand}{finger}1" in self.joints]

    def _palm(self, hand: str, knuckles: list[str]) -> Array:
        middle: Array = np.mean([self.asset.places[knuckle] for knuckle in knuckles], axis=0)
        return middle - self.asset.places[hand]

    def _shoe(self, trunk: _Trunk, foot: str) -> Array:
        """The axes of a flat foot, in rows left, up and ahead, in the axes of the asset or of the rig."""
        direction = self.asset.places[foot.replace("Foot", "ToeBase")] - self.asset.places[foot]
        ahead = unit(direction * [1.0, 0.0, 1.0], np.array([0.0, 0.0, 1.0]))
        up = np.array([0.0, 1.0, 0.0])
        axes: Array = np.stack([np.cross(up, ahead), up, ahead]) @ trunk.axes
        return axes

    def _sole(self, foot: str) -> tuple[float, float]:
        """Height of the ankle of a standing foot, and its drop to the ball: as in a rest pose that stands flat."""
        leg, toe = self.trunk.leg, foot.replace("Foot", "ToeBase")
        usual = load_asset()  # of all bodies: motions are finished for the soles of the first
        ankle = leg * float(usual.places[foot][1]) / _Trunk(usual.places).leg
        if foot in self.joints and toe in self.joints:
            drop = float((self.at(foot) - self.at(toe)) @ self.trunk.axes[1])
            if FLAT[0] < drop / leg < FLAT[1]:
                drop = max(drop, DROP * leg)
                return max(ankle, drop + BALL * leg), drop
        return ankle, ankle * (1.0 - float(usual.places[toe][1] / usual.places[foot][1]))

    def _placed(self, name: str, points: Array) -> Array:
        """Points (N, 3) of a joint's part of the asset, around the rig."""
        part = re.sub("^(Left|Right)", "", name)
        if part in _TRUNK or ("Head" not in self.joints and part in ("Neck", "Neck1", "Head")):
            return self._on_trunk(points)
        if part in ("Neck", "Neck1", "Head"):
            return self._on_neck(points)
        if part in ("Foot", "ToeBase"):
            return self._in_shoe(name.replace("ToeBase", "Foot"), points)
        owner = self._owner(name)
        if owner.endswith("ForeArm") and part != "ForeArm":  # a hand that the rig lacks
            owner = owner.replace("ForeArm", "Hand")
        origin, end, along = self.asset.places[owner], self._end(owner), self.size
        direction = np.zeros(3)
        if end is not None:
            direction = self.asset.places[end] - origin
            along = float(np.linalg.norm(self.at(end) - self.at(owner)) / np.linalg.norm(direction))
        elif owner.endswith("Hand") and len(knuckles := self._knuckles(owner)) > 2:
            direction = self._palm(owner, knuckles)
            middle = np.mean([self.at(knuckle) for knuckle in knuckles], axis=0)
            along = float(np.linalg.norm(middle - self.at(owner)) / np.linalg.norm(direction))
        if along > LONGEST * self.size:
            raise SkeletonError(f"{owner} is too long for a body")
        direction = unit(direction, direction)
        girth = float(np.cbrt(self.size**2 * max(along, 0.3 * self.size)))
        scale = girth * np.eye(3) + (along - girth) * np.outer(direction, direction)
        placed: Array = self.at(owner) + (points - origin) @ (self.turn @ scale).T
        return placed

    def _on_trunk(self, points: Array) -> Array:
        """As high as the rig's trunk, as wide as its hips and shoulders where they are plausible."""
        tall = self.trunk.height / self.asset_trunk.height
        inside = self.asset_trunk.inside(points)
        low, high = (
            np.clip(mine / theirs, 0.8 * tall, 1.3 * tall)
            for mine, theirs in zip(self.trunk.widths, self.asset_trunk.widths, strict=True)
        )
        upper = np.clip((inside[:, 1] - 0.1) / 0.7, 0.0, 1.0)
        deep = float(np.sqrt(tall * self.size))
        scales = np.stack([low + upper * (high - low), 0 * upper + 1.0, 0 * upper + deep], axis=-1)
        placed: Array = self.trunk.hips + inside * scales @ self.trunk.torso
        return placed

    def _on_neck(self, points: Array) -> Array:
        """The head with its middle over the rig's joint, and the neck between it and the trunk."""
        up, head = self.trunk.axes[1], self.asset.places["Head"]
        tall = float(np.sqrt(self.size * self.trunk.height / self.asset_trunk.height))
        # Joints of this name lie anywhere from the top of the neck to the middle of the head.
        lift = np.clip((self._on_trunk(head[None])[0] - self.at("Head")) @ up, -0.03 * tall, 0.06 * tall)
        placed: Array = self.at("Head") + lift * up + tall * (points - head) @ self.turn.T
        neck = self.asset.places["Neck"]
        shares = _smooth((points - neck) @ (head - neck) / ((head - neck) @ (head - neck)))[:, None]
        return shares * placed + (1.0 - shares) * self._on_trunk(points)

    def _in_shoe(self, foot: str, points: Array) -> Array:
        """A foot on the ground under the ankle, as long as the rig's up to the ball."""
        toe, ankle, axes = (
            foot.replace("Foot", "ToeBase"),
            self.asset.places[foot],
            self._shoe(self.trunk, foot),
        )
        tall, long = self.soles[foot][0] / ankle[1], self.size
        if toe in self.joints:
            length = np.linalg.norm((self.asset.places[toe] - ankle)[[0, 2]])
            ratio = (self.at(toe) - self.at(foot)) @ axes[2] / length
            long = float(np.clip(ratio, 0.75 * self.size, 1.35 * self.size))
        inside = (points - ankle) @ self._shoe(self.asset_trunk, foot).T
        placed: Array = self.at(foot) + (inside * [self.size, tall, long]) @ axes
        return placed

    def _skin(self, points: Array) -> Array:
        """Weights (V, J) of the rig's joints for points (V, 3) of the mesh."""
        out = np.zeros((len(points), len(self.pose.places)))
        weights = dict(zip(self.asset.names, self.asset.weights.T, strict=True))
        levels = self.trunk.inside(self.pose.places[self.spine])[:, 1].tolist()
        ends = [*levels[1:], 1.0]
        chain = []
        for n in range(1, len(self.spine)):  # each joint blends into the next around the middle of its bone
            start = max(levels[n], 0.06) if n == 1 else levels[n]
            chain.append((start, max(0.45 * (ends[n] - levels[n - 1]), 0.08), self.spine[n]))
        total = sum(weights[name] for name in _SPINE)
        _add_chain(out, total, self.trunk.inside(points)[:, 1], self.spine[0], chain)
        for name, weight in weights.items():
            owner = self._owner(name)
            if name in _SPINE:
                continue
            joint, end = self.spine[-1] if owner in _SPINE else self.joints[owner], self._end(owner)
            if end not in self.joints or owner in _SPINE:
                out[:, joint] += weight
                continue
            bone = self.at(end) - self.at(owner)
            between = self.skeleton.path(self.joints[end])[:-1]
            between = [j for j in between if j != joint and self.skeleton.descends(j, joint)]
            far = float(bone @ bone) or 1.0
            chain = [(float((self.pose.places[j] - self.at(owner)) @ bone) / far, 0.1, j) for j in between]
            _add_chain(out, weight, (points - self.at(owner)) @ bone / far, joint, chain)
        return out


def _add_chain(out: Array, weight: Array, shares: Array, first: int, chain: Chain) -> None:
    """Share a weight (V,) between the joints along a line: the first, then each (share, half width, joint)."""
    left, joint = weight.copy(), first
    for start, half, after in chain:
        passed = left * _smooth((shares - start) / (2 * half) + 0.5)
        out[:, joint] += left - passed
        left, joint = passed, after
    out[:, joint] += left


def _strongest(weights: Array) -> tuple[np.ndarray, Array]:
    """The joints (V, 4) with the largest weights, and these weights (V, 4), which add up to 1."""
    most = min(INFLUENCES, weights.shape[1])
    order = np.argsort(-weights, axis=1, kind="stable")[:, :most]
    found = np.take_along_axis(weights, order, axis=1)
    missing = ((0, 0), (0, INFLUENCES - most))
    return np.pad(order, missing), np.pad(found / found.sum(axis=1, keepdims=True), missing)


def _bony(motion: Motion, pose: BodyPose, pairs: Sequence[tuple[int, int]]) -> Surface:
    """Tapered bones for a rig that is not human, thicker near the trunk, with a head if a joint is named so."""
    names, count = motion.skeleton.names, len(pose.places)
    below = np.ones(count)
    for joint in range(count - 1, 0, -1):
        below[pose.parents[joint]] += below[joint]
    size = float(np.linalg.norm(np.ptp(pose.places, axis=0))) or 1.0
    radius = size * (0.008 + 0.03 * np.sqrt(below / count))
    bones = [(parent, pose.places[joint], radius[joint]) for parent, joint in pairs if joint < count]
    bones += [(j, end, 0.7 * radius[j]) for j, end in pose.ends.items()]
    rods = []
    for joint, end, thick in bones:
        length = float(np.linalg.norm(end - pose.places[joint]))
        if length >= 1e-6 * size:
            near, far = (min(r, 0.3 * length) for r in (1.15 * thick, thick))
            rods.append((pose.places[joint], end, near, far, joint, "Shirt"))
    for joint, name in enumerate(names):
        if name_part(name)[1] == "head" or not rods:
            ball = 0.055 * size if rods else 0.1
            along = np.array([0.0, 0.3 * ball, 0.0])
            middle = (pose.ends.get(joint, pose.places[joint]) + pose.places[joint]) / 2
            rods.append((middle - along, middle + along, ball, ball, joint, "Skin"))
    return _rods(rods)


def _rods(rods: list[tuple[Array, Array, float, float, int, str]]) -> Surface:
    """Rounded rods, each from a start (3,) to an end (3,) with a radius at both, a joint and a region."""
    around, rings = 12, np.radians([-90.0, -75.0, -45.0, -15.0, 15.0, 45.0, 75.0, 90.0])
    angles = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    n, k = np.meshgrid(np.arange(len(rings) - 1), np.arange(around), indexing="ij")
    a, b = n * around + k, n * around + (k + 1) % around
    faces = np.stack([a, b, b + around, a, b + around, a + around], axis=-1).reshape(-1, 3)
    points, palette = [], load_asset().palette
    for start, end, near, far, *_ in rods:
        along = unit(end - start, np.array([0.0, 1.0, 0.0]))
        depth = unit(np.array([0.31, 0.17, 0.93]) - (along @ [0.31, 0.17, 0.93]) * along, np.eye(3)[0])
        across = np.cross(depth, along)
        circle = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * depth
        for turn in rings:
            place, radius = (start, near) if turn < 0.0 else (end, far)
            points.append(place + radius * (np.sin(turn) * along + max(np.cos(turn), 1e-3) * circle))
    size = len(rings) * around
    joints = np.repeat([joint for *_, joint, _ in rods], size)
    regions = np.repeat([REGIONS.index(region) for *_, region in rods], size)
    triangles = (size * np.arange(len(rods))[:, None, None] + faces).reshape(-1, 3)
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))
    return Surface(
        np.concatenate(points),
        triangles,
        np.stack([joints, *[0 * joints] * 3], -1),
        weights,
        regions,
        palette,
    )
