"""A body mesh for a skeleton: torso, limbs, head, hands and feet for human rigs, tapered bones for others.

Sizes are those of a human with legs (thigh plus shin) of 0.834 m, the canonical skeleton, and scale with the leg
length of the rig; lengths and widths that the rig gives take precedence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import lower_median
from motionkit.errors import SkeletonError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rig_names import RigMap, map_rig, name_part
from motionkit.motion.rotations import quat_rotate, quat_to_matrix
from motionkit.view.contact_sheet_geometry import Figure, motion_figure
from motionkit.view.surface import Array, Ring, Surface, SurfaceBuilder, cross_axes, rounded, unit

LEG = 0.834  # m, leg length of the profiles below
ANKLE, BALL = 0.095, 0.022  # heights of a standing foot's joints, m
SIDES = ("Left", "Right")
Profile = tuple[tuple[float, ...], ...]

# Share of the length, half width, half depth, shift to the front, m.
_THIGH = ((0.0, 0.086, 0.094, 0.0), (0.2, 0.084, 0.092, 0.004), (0.55, 0.069, 0.075, 0.006),
          (0.85, 0.055, 0.058, 0.004), (1.0, 0.053, 0.056, 0.004))  # fmt: skip
_SHIN = ((0.0, 0.051, 0.053, 0.002), (0.15, 0.052, 0.056, -0.008), (0.32, 0.054, 0.058, -0.014),
         (0.6, 0.043, 0.045, -0.008), (0.9, 0.033, 0.036, -0.003), (1.0, 0.034, 0.037, -0.003))  # fmt: skip
_UPPER_ARM = ((0.0, 0.056, 0.058, 0.0), (0.25, 0.052, 0.055, 0.0), (0.6, 0.044, 0.047, 0.0),
              (1.0, 0.038, 0.039, 0.0))  # fmt: skip
_FOREARM = ((0.0, 0.037, 0.038, 0.0), (0.2, 0.040, 0.042, 0.0), (0.5, 0.034, 0.036, 0.0),
            (1.0, 0.022, 0.028, 0.0))  # fmt: skip
_MITTEN = ((0.0, 0.020, 0.026, 0.0), (0.22, 0.017, 0.038, 0.0), (0.48, 0.015, 0.041, 0.0),
           (0.72, 0.012, 0.036, 0.0), (1.0, 0.009, 0.022, 0.0))  # fmt: skip
_THUMB = ((0.0, 0.013, 0.014, 0.0), (1.0, 0.009, 0.010, 0.0))
_COLLAR = ((0.0, 0.046, 0.052, 0.0), (0.6, 0.047, 0.053, 0.0), (1.0, 0.052, 0.055, 0.0))
_BELT = 0.18  # share of the torso where the trousers end
_NECK = ((0.0, 0.060, 0.062, 0.0), (0.5, 0.052, 0.056, 0.0), (1.0, 0.050, 0.054, 0.0))
# Height from the middle in half heads, then as above.
_HEAD = ((-1.0, 0.012, 0.016, 0.036), (-0.95, 0.032, 0.034, 0.034), (-0.82, 0.047, 0.054, 0.026),
         (-0.55, 0.060, 0.077, 0.014), (-0.15, 0.071, 0.089, 0.006), (0.2, 0.077, 0.096, 0.0),
         (0.5, 0.074, 0.094, -0.003), (0.75, 0.060, 0.077, -0.004), (0.91, 0.039, 0.050, -0.004),
         (0.98, 0.018, 0.024, -0.003))  # fmt: skip
_HEAD_HALF = 0.118
# Share of the distance from the middle of the hips to the middle of the shoulders, then as above.
_TORSO = ((-0.17, 0.040, 0.050, -0.004), (-0.13, 0.095, 0.086, -0.006), (-0.05, 0.150, 0.108, -0.010),
          (0.06, 0.163, 0.112, -0.010), (0.17, 0.156, 0.107, -0.005),
          (0.19, 0.157, 0.108, -0.005), (0.42, 0.132, 0.096, 0.004),
          (0.62, 0.148, 0.110, 0.006), (0.8, 0.164, 0.119, 0.006), (0.93, 0.163, 0.107, 0.0),
          (1.03, 0.132, 0.080, -0.008), (1.11, 0.078, 0.064, -0.010), (1.16, 0.058, 0.056, -0.008))  # fmt: skip
# Distance ahead of the ankle in m (the ball of the foot is at 0.1), half width, heights of sole and instep.
_FOOT = ((-0.062, 0.014, 0.016, 0.042), (-0.054, 0.027, 0.004, 0.066), (-0.03, 0.034, 0.0, 0.094),
         (0.0, 0.036, 0.0, 0.106), (0.035, 0.038, 0.0, 0.090), (0.07, 0.042, 0.0, 0.066),
         (0.1, 0.046, 0.0, 0.049), (0.13, 0.044, 0.001, 0.039), (0.155, 0.035, 0.004, 0.031),
         (0.17, 0.018, 0.009, 0.023))  # fmt: skip


@dataclass(frozen=True, eq=False)
class BodyPose:
    """The pose in which a body mesh is made.

    Attributes:
        rotations: (J, 3, 3) global rotations.
        places: (J, 3) global positions, m.
        ends: joint to the end (3,) of its bone.
        parents: J parent indices.
        bones: joints whose bone to the parent is part of the body.
    """

    rotations: Array
    places: Array
    ends: dict[int, Array]
    parents: tuple[int, ...]
    bones: frozenset[int]

    def matrices_from(self, rotations: Array, places: Array) -> Array:
        """Affine matrices (J, 3, 4) from this pose to another, given by its rotations and places."""
        turn = rotations @ self.rotations.transpose(0, 2, 1)
        return np.concatenate(
            [turn, (places - np.einsum("jab,jb->ja", turn, self.places))[..., None]], axis=2
        )

    def inverse_matrices(self) -> Array:
        """Matrices (J, 4, 4) from the world to each joint's own space in this pose: glTF's inverse bind matrices."""
        back = self.rotations.transpose(0, 2, 1)
        out = np.broadcast_to(np.eye(4), (len(back), 4, 4)).copy()
        out[:, :3, :3] = back
        out[:, :3, 3] = -np.einsum("jab,jb->ja", back, self.places)
        return out


def make_body(motion: Motion, figure: Figure | None = None) -> tuple[Surface, BodyPose]:
    """A skinned body mesh for the rig of a motion, and the pose in which it is made.

    Args:
        motion: in metres with Y up (`figure_data.in_metres`); its rest pose, or else its best frame, shows the body
            upright.
        figure: the motion's `motion_figure`, computed if None.
    """
    bones = (figure or motion_figure(motion)).bones
    drawn = frozenset(joint for _, joint in bones if joint < len(motion.skeleton))
    try:
        rig = map_rig(motion.skeleton)
    except SkeletonError:
        return _bony(motion, _rest(motion, drawn))
    poses = [_rest(motion, drawn)]
    if _stoop(poses[0], rig) > 0.5:  # the rest pose is not a standing human
        poses = [_frame(motion, t, drawn) for t in np.linspace(0, len(motion) - 1, 24).astype(int)]
    pose = min(poses, key=lambda p: _stoop(p, rig))
    return _Human(motion, rig, pose).surface(), pose


def _rest(motion: Motion, bones: frozenset[int]) -> BodyPose:
    skeleton = motion.skeleton
    places = skeleton.rest_positions()
    if motion.local_positions is not None:
        usual = lower_median(motion.local_positions)
        places = np.zeros_like(usual)
        for joint, parent in enumerate(skeleton.parents):
            if joint:
                places[joint] = places[parent] + usual[joint]
    at = places.astype(np.float64)
    ends = {j: at[j] + np.array(end) for j, end in skeleton.end_sites.items()}
    rotations = np.broadcast_to(np.eye(3), (len(skeleton), 3, 3)).copy()
    return BodyPose(rotations, at, ends, skeleton.parents, bones)


def _frame(motion: Motion, frame: int, bones: frozenset[int]) -> BodyPose:
    rotations, places = motion_kinematics(motion.cut(frame, frame + 1))
    ends = {
        j: (places[0, j] + quat_rotate(rotations[0, j], np.array(end, np.float32))).astype(np.float64)
        for j, end in motion.skeleton.end_sites.items()
    }
    turns = quat_to_matrix(rotations[0]).astype(np.float64)
    return BodyPose(turns, places[0].astype(np.float64), ends, motion.skeleton.parents, bones)


def _stoop(pose: BodyPose, rig: RigMap) -> float:
    """The deviation of a pose from standing: thighs below the hips, sides apart, chest on top."""
    at = {name: pose.places[joint] for name, joint in rig.places.items()}
    hips, chest = (at["LeftUpLeg"] + at["RightUpLeg"]) / 2, (at["LeftArm"] + at["RightArm"]) / 2
    up = unit(chest - hips, np.zeros(3))
    across = unit(at["LeftUpLeg"] - at["RightUpLeg"], up)
    thighs = [unit(at[f"{side}Leg"] - at[f"{side}UpLeg"], up) for side in SIDES]
    arms = unit(at["LeftArm"] - at["RightArm"], -across)
    return float(sum(1 + up @ thigh for thigh in thighs) + abs(up @ across) + (1 - across @ arms))


class _Human:
    """Makes the parts of a human body from the places of the canonical joints in a rig."""

    def __init__(self, motion: Motion, rig: RigMap, pose: BodyPose) -> None:
        self.names, self.pose, self.rig = motion.skeleton.names, pose, rig.places
        self.builder = SurfaceBuilder()
        hips = (self.at("LeftUpLeg") + self.at("RightUpLeg")) / 2
        chest = (self.at("LeftArm") + self.at("RightArm")) / 2
        self.hips, self.torso = hips, float(np.linalg.norm(chest - hips))
        self.up = unit(chest - hips, np.array([0.0, 1.0, 0.0]))
        across = self.at("LeftUpLeg") - self.at("RightUpLeg") + self.at("LeftArm") - self.at("RightArm")
        self.front = unit(np.cross(across, self.up), np.array([0.0, 0.0, 1.0]))
        self.left = np.cross(self.up, self.front)
        thigh = np.linalg.norm(self.at("LeftLeg") - self.at("LeftUpLeg"))
        shin = np.linalg.norm(self.limb_end("Left", "Leg", "Foot") - self.at("LeftLeg"))
        self.size = float(thigh + shin) / LEG
        self.used = {j for name in self.rig for j in self.path(0, self.rig[name])}

    def at(self, name: str) -> Array:
        return self.pose.places[self.rig[name]]

    def path(self, above: int, joint: int) -> list[int]:
        """Joints from an ancestor `above` down to a joint, both included."""
        out = [joint]
        while out[-1] != above and self.pose.parents[out[-1]] >= 0:
            out.append(self.pose.parents[out[-1]])
        return out[::-1]

    def limb_end(self, side: str, part: str, below: str) -> Array:
        """The end of a limb's last bone: its joint, its End Site, or extrapolated by the bone before."""
        if side + below in self.rig:
            return self.at(side + below)
        joint = self.rig[side + part]
        before = {"Leg": "UpLeg", "ForeArm": "Arm"}[part]
        bone = self.at(side + part) - self.at(side + before)
        return self.pose.ends.get(joint, self.pose.places[joint] + 0.9 * bone)

    def scaled(self, profile: Profile) -> list[tuple[float, ...]]:
        return [(share, *(self.size * value for value in rest)) for share, *rest in profile]

    def surface(self) -> Surface:
        self._torso()
        self._neck_and_head()
        for side in SIDES:
            self._limb(side, "UpLeg", "Leg", _THIGH, "leg")
            self._limb(side, "Leg", "Foot", _SHIN, "leg")
            self._collar(side)
            self._limb(side, "Arm", "ForeArm", _UPPER_ARM)
            self._limb(side, "ForeArm", "Hand", _FOREARM)
            self._foot(side)
            self._hand(side)
        self._others()
        return self.builder.surface()

    def _limb(self, side: str, part: str, below: str, profile: Profile, tint: str = "body") -> None:
        top = self.rig[side + part]
        joints = self.path(top, self.rig[side + below]) if side + below in self.rig else [top]
        path = [(self.pose.places[j], j) for j in joints]
        if len(path) == 1:
            path.append((self.limb_end(side, part, below), top))
        self.builder.limb(path, self.scaled(profile), self.front, tint)

    def _collar(self, side: str) -> None:
        """The shoulder between upper arm and chest, which rises with the collar bone."""
        chest = next(self.rig[n] for n in ("Spine1", "Spine", "LowerBack", "Hips") if n in self.rig)
        arm = self.at(f"{side}Arm")
        base = self.hips + 0.95 * self.torso * self.up
        start = base + 0.35 * (arm - base)
        joint = self.rig.get(f"{side}Shoulder", chest)
        self.builder.limb([(start, joint), (arm, joint)], self.scaled(_COLLAR), self.front)

    def _torso(self) -> None:
        middle = float(np.linalg.norm(self.at("LeftUpLeg") - self.at("RightUpLeg"))) / 2 / 0.0914
        top = float(np.linalg.norm(self.at("LeftArm") - self.at("RightArm"))) / 2 / 0.181
        height = self.torso / 0.507
        spine = [self.rig[n] for n in ("Hips", "LowerBack", "Spine", "Spine1") if n in self.rig]
        shares = [float((self.pose.places[j] - self.hips) @ self.up) / self.torso for j in spine]
        # The weight of each spine joint is largest halfway to the next.
        middles = [0.08] + [(a + b) / 2 for a, b in zip(shares[1:], [*shares[2:], 1.0], strict=True)]
        rings = []
        for share, width, depth, shift in _TORSO:
            upper = float(np.clip((share - 0.1) / 0.7, 0.0, 1.0))
            wide = (1 - upper) * np.clip(middle, 0.8 * height, 1.25 * height) + upper * np.clip(
                top, 0.8 * height, 1.3 * height
            )
            deep = 0.5 * (height + self.size)
            place = self.hips + share * self.torso * self.up + shift * deep * self.front
            above = int(np.clip(np.searchsorted(middles, share), 1, max(len(middles) - 1, 1)))
            if len(spine) == 1:
                joints, weight = (spine[0], spine[0]), 0.0
            else:
                joints = (spine[above - 1], spine[above])
                gap = max(middles[above] - middles[above - 1], 1e-6)
                weight = float(np.clip((share - middles[above - 1]) / gap, 0.0, 1.0))
            tint = "leg" if share < _BELT else "body"
            rings.append(
                Ring(place, depth * deep * self.front, width * wide * self.left, joints, weight, tint)
            )
        self.builder.loft(rounded(rings, self.up))

    def _neck_and_head(self) -> None:
        chest = next(self.rig[n] for n in ("Spine1", "Spine", "LowerBack", "Hips") if n in self.rig)
        base = self.hips + 1.06 * self.torso * self.up
        neck = self.rig.get("Neck", chest)
        head = self.rig.get("Head")
        if head is None:
            tip = self.pose.ends.get(neck, base + 0.1 * self.size * self.up)
            self._head(neck, tip, unit(tip - base, self.up))
            return
        path = [(self.pose.places[j], j) for j in self.path(neck, head)] if "Neck" in self.rig else []
        lowest = path[0][0] if path else base
        if not path or (lowest - self.hips) @ self.up > 1.0 * self.torso:
            path.insert(0, (base, neck))
            path = [p for n, p in enumerate(path) if n == 0 or (p[0] - base) @ self.up > 0.0]
        elif (lowest - self.hips) @ self.up < 0.9 * self.torso:
            path[0] = (path[0][0] + 0.5 * (base - path[0][0]), path[0][1])
        if path[-1][1] != head or len(path) == 1:
            path.append((self.pose.places[head], head))
        self.builder.limb(path, self.scaled(_NECK), self.front, "head")
        end = self.pose.ends.get(head)
        along = unit(self.pose.places[head] - path[0][0], self.up)
        if end is not None and np.linalg.norm(end - self.pose.places[head]) > 0.03 * self.size:
            towards = unit(end - self.pose.places[head], along)
            along = towards if towards @ along > 0.5 else along
        reach = 0.1 * self.size if end is None else float(np.linalg.norm(end - self.pose.places[head]))
        lift = float(np.clip(reach - 0.085 * self.size, 0.025 * self.size, 0.1 * self.size))
        self._head(head, self.pose.places[head] + lift * along, along)

    def _head(self, joint: int, middle: Array, along: Array) -> None:
        across, depth = cross_axes(along, self.front)
        s, pair = self.size, (joint, joint)
        rings = [
            Ring(middle + s * (h * _HEAD_HALF * along + shift * depth), s * w * across, s * d * depth, pair)
            for h, w, d, shift in _HEAD
        ]
        self.builder.loft(rings, "head")
        bridge = middle + s * (0.088 * depth + 0.008 * along)
        tip = middle + s * (0.098 * depth - 0.026 * along)
        profile = [(0.0, 0.007 * s, 0.006 * s, 0.0), (1.0, 0.014 * s, 0.012 * s, 0.0)]
        self.builder.limb([(bridge, joint), (tip, joint)], profile, depth, "head")

    def _foot(self, side: str) -> None:
        ankle_at = self.limb_end(side, "Leg", "Foot")
        ankle = self.rig.get(f"{side}Foot", self.rig[f"{side}Leg"])
        toe = self.rig.get(f"{side}ToeBase")
        s, down = self.size, unit(ankle_at - self.at(f"{side}Leg"), -self.up)
        fallback = ankle_at + s * (0.1 * self.front + (ANKLE - BALL) * down)
        ball = self.pose.places[toe] if toe is not None else self.pose.ends.get(ankle, fallback)
        if np.linalg.norm(ball - ankle_at) < 0.05 * s:
            ball = fallback
        bone = ball - ankle_at
        length = float(np.linalg.norm(bone))
        bone = bone / length
        left = unit(np.cross(-down, bone), self.left)
        # The sole is flat on the floor if ankle and ball are at their standing heights.
        drop = float(np.arcsin(np.clip(s * (ANKLE - BALL) / length, 0.0, 0.85)))
        raised = unit(np.cross(bone, left), -down)
        ahead = np.cos(drop) * bone + np.sin(drop) * raised
        normal = np.cross(ahead, left)
        ground = ankle_at - s * ANKLE * normal
        stretch = length * float(np.cos(drop)) / (0.1 * s)
        rings = []
        for x, width, sole, top in _FOOT:
            forward = s * x * (stretch if 0.0 < x < 0.1 else 1.0)
            forward += 0.1 * s * (stretch - 1.0) if x >= 0.1 else 0.0
            joints, weight = (ankle, ankle), 0.0
            if toe is not None and x > 0.08:
                joints, weight = (ankle, toe), 0.5 if x == 0.1 else 1.0
            middle = ground + forward * ahead + 0.5 * s * (sole + top) * normal
            rings.append(Ring(middle, s * width * left, 0.5 * s * (top - sole) * normal, joints, weight))
        self.builder.loft(rings, "foot")

    def _hand(self, side: str) -> None:
        if f"{side}Hand" not in self.rig:
            return
        hand, s = self.rig[f"{side}Hand"], self.size
        place = self.pose.places[hand]
        along = unit(place - self.at(f"{side}ForeArm"), self.left)
        knuckles = [self.pose.places[j] for j in self._knuckles(hand)]
        if knuckles:  # the palm ends where the fingers begin
            reach = float(np.median([np.linalg.norm(k - place) for k in knuckles]))
            along = unit(np.mean(knuckles, axis=0) - place, along)
            spread = max((np.linalg.norm(a - b) for a in knuckles for b in knuckles), default=0.0)
            wide = float(np.clip(0.5 * spread, 0.025 * s, 0.05 * s))
            widest = max(
                ((a - b) for a in knuckles for b in knuckles), key=lambda v: float(np.linalg.norm(v))
            )
            profile = [(0.0, 0.018 * s, 0.026 * s, 0.0), (1.0, 0.012 * s, wide, 0.0)]
            tip = place + max(reach, 0.05 * s) * along
            self.builder.limb([(place, hand), (tip, hand)], profile, widest, "hand")
            return
        end = self.pose.ends.get(hand)
        if end is not None and np.linalg.norm(end - place) > 0.03 * s:
            towards = unit(end - place, along)
            along = towards if towards @ along > 0.5 else along
        path = [(place + 0.012 * s * along, hand), (place + 0.165 * s * along, hand)]
        self.builder.limb(path, self.scaled(_MITTEN), self.front, "hand")
        _, depth = cross_axes(along, self.front)
        root, tip = place + s * (0.03 * along + 0.026 * depth), place + s * (0.085 * along + 0.052 * depth)
        self.builder.limb([(root, hand), (tip, hand)], self.scaled(_THUMB), self.front, "hand")

    def _knuckles(self, hand: int) -> list[int]:
        """The first joints of a hand's fingers; none if the rig has only a thumb and a tip."""
        parents = self.pose.parents
        fingers = [j for j, parent in enumerate(parents) if parent == hand and j in parents]
        return fingers if len(fingers) >= 3 else []

    def _others(self) -> None:
        """Fingers, tails and other extra joints, as thin bones."""
        hands = {self.rig[f"{side}Hand"] for side in SIDES if f"{side}Hand" in self.rig}
        knuckles = {joint for hand in hands for joint in self._knuckles(hand)}
        closed = {self.rig[n] for n in ("Head", "LeftFoot", "RightFoot") if n in self.rig}
        closed |= {hand for hand in hands if not self._knuckles(hand)}
        for joint in sorted(self.pose.bones - self.used):
            if closed & set(self.path(0, joint)):
                continue
            parent, place = self.pose.parents[joint], self.pose.places[joint]
            if joint not in knuckles:
                self._twig(self.pose.places[parent], place, parent)
            if joint in self.pose.ends:
                self._twig(place, self.pose.ends[joint], joint)

    def _twig(self, start: Array, end: Array, joint: int) -> None:
        if np.linalg.norm(end - start) > 0.01 * self.size:
            _bone(self.builder, start, end, joint, 0.009 * self.size, 0.008 * self.size, "hand")


def _bone(
    builder: SurfaceBuilder, start: Array, end: Array, joint: int, near: float, far: float, tint: str = "body"
) -> None:
    middle = ((0.0, near, near, 0.0), (1.0, far, far, 0.0))
    builder.limb([(start, joint), (end, joint)], middle, np.array([0.31, 0.17, 0.93]), tint)


def _bony(motion: Motion, pose: BodyPose) -> tuple[Surface, BodyPose]:
    """Tapered bones for a rig that is not a known human, thicker towards the trunk, with a head if one is named."""
    names, count = motion.skeleton.names, len(pose.places)
    below = np.ones(count)
    for joint in range(count - 1, 0, -1):
        below[pose.parents[joint]] += below[joint]
    size = float(np.linalg.norm(np.ptp(pose.places, axis=0))) or 1.0
    radius = size * (0.008 + 0.03 * np.sqrt(below / count))
    builder = SurfaceBuilder()
    bones = [(pose.parents[j], pose.places[j], radius[j]) for j in sorted(pose.bones) if pose.parents[j] >= 0]
    bones += [(j, end, 0.7 * radius[j]) for j, end in pose.ends.items()]
    lengths = [float(np.linalg.norm(end - pose.places[joint])) for joint, end, _ in bones]
    bones = [bone for bone, length in zip(bones, lengths, strict=True) if length >= 1e-6 * size]
    for joint, end, thick in bones:
        length = float(np.linalg.norm(end - pose.places[joint]))
        near, far = (min(r, 0.3 * length) for r in (1.15 * thick, thick))
        _bone(builder, pose.places[joint], end, joint, near, far)
    for joint, name in enumerate(names):
        if name_part(name)[1] == "head" or not bones:
            ball = 0.055 * size if bones else 0.1
            along = np.array([0.0, 0.3 * ball, 0.0])
            place = pose.ends.get(joint, pose.places[joint])
            middle = (place + pose.places[joint]) / 2
            _bone(builder, middle - along, middle + along, joint, ball, ball, "head")
    return builder.surface(), pose
