"""A body mesh for any skeleton: human shapes for human rigs, tapered bones for others.

Default sizes belong to the canonical skeleton, whose legs (thigh plus shin) are 0.834 m long; they scale with the rig's
leg length. Lengths and widths given by the rig take precedence.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motionkit.arrays import lower_median
from motionkit.errors import SkeletonError
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_rotate, quat_to_matrix
from motionkit.rig.names import RigMap, map_rig, name_part
from motionkit.view.contact_sheet_geometry import Figure, motion_figure
from motionkit.view.flesh import STEP, Chain, Piece, skin
from motionkit.view.surface import TINTS, Array, Surface, SurfaceBuilder, cross_axes, joined, unit

LEG = 0.834  # m, leg length for the profiles below
ANKLE, BALL = 0.095, 0.022  # m, joint heights of a standing foot
SIDES = ("Left", "Right")
MOST_KEPT = 16  # bodies in the cache
Profile = tuple[tuple[float, ...], ...]

# Share of the length, half width, half depth, forward shift; m.
_THIGH = ((0.0, 0.082, 0.088, 0.0), (0.2, 0.080, 0.087, 0.004), (0.55, 0.064, 0.069, 0.006),
          (0.85, 0.050, 0.053, 0.004), (1.0, 0.047, 0.050, 0.004))  # fmt: skip
_SHIN = ((0.0, 0.046, 0.049, 0.002), (0.15, 0.048, 0.052, -0.008), (0.32, 0.050, 0.055, -0.014),
         (0.6, 0.040, 0.042, -0.008), (0.9, 0.031, 0.034, -0.003), (1.0, 0.032, 0.036, -0.003))  # fmt: skip
_UPPER_ARM = ((0.0, 0.050, 0.053, 0.0), (0.25, 0.046, 0.050, 0.0), (0.6, 0.039, 0.042, 0.0),
              (1.0, 0.034, 0.035, 0.0))  # fmt: skip
_FOREARM = ((0.0, 0.033, 0.034, 0.0), (0.2, 0.037, 0.039, 0.0), (0.5, 0.032, 0.034, 0.0),
            (1.0, 0.021, 0.027, 0.0))  # fmt: skip
_MITTEN = ((0.0, 0.020, 0.026, 0.0), (0.22, 0.019, 0.036, 0.0), (0.48, 0.018, 0.038, 0.0),
           (0.72, 0.016, 0.034, 0.0), (1.0, 0.014, 0.022, 0.0))  # fmt: skip
_THUMB = ((0.0, 0.013, 0.014, 0.0), (1.0, 0.010, 0.011, 0.0))
_COLLAR = ((0.0, 0.042, 0.050, 0.0), (0.6, 0.041, 0.050, 0.0), (1.0, 0.041, 0.047, 0.0))
_TRAPEZIUS = ((0.0, 0.030, 0.034, 0.0), (0.5, 0.028, 0.032, 0.0), (1.0, 0.026, 0.032, 0.0))
_BELT = 0.18  # share of the torso at which the trousers end
_NECK = ((0.0, 0.070, 0.066, -0.012), (0.25, 0.052, 0.055, -0.008), (0.55, 0.047, 0.051, -0.004),
         (1.0, 0.046, 0.050, 0.0))  # fmt: skip
# Height from the middle, in half head heights; then as above.
_HEAD = ((-0.6, 0.054, 0.068, 0.018), (-0.3, 0.065, 0.083, 0.010), (0.0, 0.072, 0.092, 0.003),
         (0.25, 0.075, 0.095, -0.001), (0.45, 0.074, 0.093, -0.003))  # fmt: skip
_HEAD_CAPS = 0.80, 0.80
_HEAD_HALF = 0.118  # m, half height of the head
# Share of the distance from mid hips to mid shoulders; then as above.
_TORSO = ((-0.08, 0.110, 0.078, -0.012), (-0.03, 0.138, 0.096, -0.012),
          (0.06, 0.154, 0.104, -0.010), (0.18, 0.146, 0.098, -0.005),
          (0.42, 0.120, 0.086, 0.004), (0.62, 0.136, 0.100, 0.006), (0.8, 0.150, 0.108, 0.006),
          (0.93, 0.144, 0.096, 0.0), (1.03, 0.112, 0.070, -0.008), (1.1, 0.064, 0.054, -0.010))  # fmt: skip
# Distance ahead of the ankle (0.1 is the ball of the foot), half width, heights of sole and instep; m.
_FOOT = ((-0.042, 0.030, 0.002, 0.076), (-0.03, 0.033, 0.0, 0.090),
         (0.0, 0.035, 0.0, 0.102), (0.035, 0.037, 0.0, 0.088), (0.07, 0.041, 0.0, 0.066),
         (0.1, 0.044, 0.0, 0.049), (0.13, 0.041, 0.001, 0.040), (0.152, 0.032, 0.004, 0.033))  # fmt: skip


@dataclass(frozen=True, eq=False)
class BodyPose:
    """The pose in which a body mesh is made.

    Attributes:
        rotations: (J, 3, 3) global rotations.
        places: (J, 3) global positions, m.
        ends: joint index -> end (3,) of its bone.
        parents: J parent indices.
        bones: joints whose bone to their parent belongs to the body.
    """

    rotations: Array
    places: Array
    ends: dict[int, Array]
    parents: tuple[int, ...]
    bones: frozenset[int]

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

    def inverse_matrices(self) -> Array:
        """Matrices (J, 4, 4) from the world to each joint's space in this pose: glTF's inverse bind matrices."""
        back = self.rotations.transpose(0, 2, 1)
        out = np.broadcast_to(np.eye(4), (len(back), 4, 4)).copy()
        out[:, :3, :3] = back
        out[:, :3, 3] = -np.einsum("jab,jb->ja", back, self.places)
        return out


_kept: OrderedDict[tuple, tuple[Surface, BodyPose]] = OrderedDict()


def make_body(motion: Motion, figure: Figure | None = None, step: float = STEP) -> tuple[Surface, BodyPose]:
    """A skinned body mesh for the rig of a motion, and the pose in which the mesh is made.

    Recent bodies are cached, because clips shown together often share one.

    Args:
        motion: in metres with Y up (`figure_data.in_metres`). The mesh is made in its rest pose if that is upright,
            else in its most upright frame.
        figure: the motion's `motion_figure`, computed if None.
        step: approximate edge length of the mesh, m.

    Raises:
        SkeletonError: all bones of a human rig have length zero.
    """
    check_bones(motion)
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
    human = _Human(motion.skeleton.names, rig, pose)
    if human.size == 0.0:  # all sizes depend on the leg length
        return _bony(motion, _rest(motion, drawn))
    try:
        return _human_body(human, step)
    except SkeletonError:  # proportions of no human
        return _bony(motion, _rest(motion, drawn))


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


def _human_body(human: _Human, step: float) -> tuple[Surface, BodyPose]:
    """The body of a human rig, cached; its arrays must not be changed."""
    pose = human.pose
    ends = tuple((joint, end.tobytes()) for joint, end in sorted(pose.ends.items()))
    numbers = (pose.rotations.tobytes(), pose.places.tobytes(), ends)
    key = (human.names, pose.parents, pose.bones, tuple(sorted(human.rig.items())), numbers, step)
    if key not in _kept:
        made = human.surface(step)
        for array in (*vars(made[0]).values(), made[1].rotations, made[1].places):
            array.flags.writeable = False
        while len(_kept) >= MOST_KEPT:
            _kept.popitem(last=False)
        _kept[key] = made
    return _kept[key]


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
    axis = np.cross(start, end)
    cosine = float(start @ end)
    if cosine < -0.999:  # a half turn about any perpendicular axis
        across, _ = cross_axes(start, np.array([0.0, 0.0, 1.0]))
        return 2.0 * np.outer(across, across) - np.eye(3)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turn: Array = np.eye(3) + cross + cross @ cross / (1.0 + cosine)
    return turn


class _Human:
    """Builds the parts of a human body around the canonical joints of a rig."""

    def __init__(self, names: tuple[str, ...], rig: RigMap, pose: BodyPose) -> None:
        self.names, self.rig = names, rig.places
        self.pose = pose
        self.pieces: list[Piece] = []
        self.builder = SurfaceBuilder()  # for fingers and other thin parts, which the skin would swallow
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
        spine = [self.rig[n] for n in ("Hips", "LowerBack", "Spine", "Spine1") if n in self.rig]
        self.spine = list(dict.fromkeys(spine))
        self.chest = self.spine[-1]

    def at(self, name: str) -> Array:
        return self.pose.places[self.rig[name]]

    def path(self, above: int, joint: int) -> list[int]:
        """The joints from an ancestor `above` down to a joint, both included."""
        out = [joint]
        while out[-1] != above and self.pose.parents[out[-1]] >= 0:
            out.append(self.pose.parents[out[-1]])
        return out[::-1]

    def limb_end(self, side: str, part: str, below: str) -> Array:
        """The end of a limb's last bone: its joint, its End Site, or an extrapolation of the bone before."""
        if side + below in self.rig:
            return self.at(side + below)
        joint = self.rig[side + part]
        before = {"Leg": "UpLeg", "ForeArm": "Arm"}[part]
        bone = self.at(side + part) - self.at(side + before)
        return self.pose.ends.get(joint, self.pose.places[joint] + 0.9 * bone)

    def _spread(self) -> None:
        """Spread the limbs so that their skins do not touch, in a pose from which the joints bend little."""
        self.pose = self.pose.copy()
        for side, out in zip(SIDES, (self.left, -self.left), strict=True):
            for part, below, way in (
                ("UpLeg", "Leg", (-0.985, 0.17, 0.0)),
                ("Leg", "Foot", (-0.99, 0.14, -0.02)),
                ("Arm", "ForeArm", (-0.66, 0.75, 0.0)),
                ("ForeArm", "Hand", (-0.66, 0.74, 0.12)),
            ):
                target = way[0] * self.up + way[1] * out + way[2] * self.front
                joint = self.rig[side + part]
                bone = self.limb_end(side, part, below) - self.pose.places[joint]
                self.pose.turn(joint, _between(unit(bone, target), target / np.linalg.norm(target)))
            self._flatten_foot(side, out)

    def _flatten_foot(self, side: str, out: Array) -> None:
        ankle, toe = self.rig.get(f"{side}Foot"), self.rig.get(f"{side}ToeBase")
        if ankle is None or toe is None:
            return
        bone = self.pose.places[toe] - self.pose.places[ankle]
        length = float(np.linalg.norm(bone))
        if length < 0.05 * self.size:
            return
        drop = float(np.clip(self.size * (ANKLE - BALL) / length, 0.0, 0.85))
        ahead = unit(self.front + 0.1 * out, self.front)
        target = np.sqrt(1.0 - drop**2) * ahead - drop * self.up
        self.pose.turn(ankle, _between(bone / length, target))

    def surface(self, step: float) -> tuple[Surface, BodyPose]:
        self._spread()
        self._torso()
        self._neck_and_head()
        for side in SIDES:
            self._leg(side)
            self._arm(side)
            self._foot(side)
            self._hand(side)
        self._others()
        axes = np.stack([self.left, self.up, self.front])
        body = skin(self.pieces, axes, self.size, len(self.names), step)
        return (joined(body, self.builder.surface()) if self.builder.parts else body), self.pose

    def _piece(
        self,
        path: Sequence[Array],
        profile: Profile,
        joints: tuple[int, Chain],
        tint: str | tuple[int, Chain] = "body",
        front: Array | None = None,
        **form: Any,
    ) -> None:
        """Add a piece; `form` holds its `power` and `caps`."""
        scaled = np.array([(share, *(self.size * value for value in rest)) for share, *rest in profile])
        tints = (TINTS.index(tint), ()) if isinstance(tint, str) else tint
        ahead = self.front if front is None else front
        self.pieces.append(Piece(np.stack(path), scaled, ahead, joints, tints, **form))

    def _ball(
        self, place: Array, radii: tuple[float, float, float], joints: tuple[int, Chain], tint: str = "body"
    ) -> None:
        """Add an ellipsoid with a half width, half depth and approximate half height."""
        wide, deep, high = radii
        rest = max(high - float(np.sqrt(wide * deep)), 1e-3) * self.size
        path = [place - rest * self.up, place + rest * self.up]
        self._piece(
            path, ((0.0, wide, deep, 0.0), (0.5, wide, deep, 0.0), (1.0, wide, deep, 0.0)), joints, tint
        )

    def _bone(
        self, side: str, part: str, below: str, before: int, bends: tuple[float, float]
    ) -> tuple[list[Array], tuple[int, Chain]]:
        """The path of a limb's bone and its joints: the previous one, those along the bone, the next one.

        bends: half widths of the joint transitions at the near and far end, as shares of the length.
        """
        top = self.rig[side + part]
        end = self.rig.get(side + below)
        joints = [top] if end is None else self.path(top, end)[:-1]
        start, stop = self.pose.places[top], self.limb_end(side, part, below)
        along = stop - start
        shares = [float((self.pose.places[j] - start) @ along / max(along @ along, 1e-12)) for j in joints]
        chain = [(0.0, bends[0], top)]
        chain += [(share, 0.1, joint) for share, joint in zip(shares[1:], joints[1:], strict=True)]
        if end is not None:
            chain.append((1.0, bends[1], end))
        return [start, stop], (before, chain)

    def _leg(self, side: str) -> None:
        path, (hips, chain) = self._bone(side, "UpLeg", "Leg", self.rig["Hips"], (0.22, 0.09))
        chain = [(chain[0][0] + 0.06, *chain[0][1:]), *chain[1:]]
        self._piece(path, _THIGH, (hips, chain), "leg")
        last = self.path(self.rig[f"{side}UpLeg"], self.rig[f"{side}Leg"])[-2]
        path, joints = self._bone(side, "Leg", "Foot", last, (0.09, 0.06))
        shoe = (TINTS.index("leg"), ((0.93, 0.02, TINTS.index("foot")),))
        self._piece(path, _SHIN, joints, shoe)
        seat = self.at(f"{side}UpLeg") - self.size * (0.025 * self.up + 0.035 * self.front)
        self._ball(
            seat, (0.078, 0.082, 0.088), (self.rig[f"{side}UpLeg"], [(0.1, 1.6, self.rig["Hips"])]), "leg"
        )

    def _arm(self, side: str) -> None:
        """Add the arm and the shoulder between upper arm and chest, which rises with the collar bone."""
        arm = self.at(f"{side}Arm") - 0.018 * self.size * self.up
        base = self.hips + 0.93 * self.torso * self.up
        start = base + 0.3 * (arm - base)
        collar, upper = self.rig.get(f"{side}Shoulder", self.chest), self.rig[f"{side}Arm"]
        self._piece([start, arm], _COLLAR, (self.chest, [(0.25, 0.35, collar), (1.0, 0.3, upper)]))
        neck = self.hips + 1.1 * self.torso * self.up - 0.015 * self.size * self.front
        slope = [neck + 0.1 * (arm - neck), neck + 0.85 * (arm - neck)]
        self._piece(slope, _TRAPEZIUS, (self.chest, [(0.45, 0.4, collar)]))
        (top, end), (_, chain) = self._bone(side, "Arm", "ForeArm", collar, (0.25, 0.12))
        chain = [(0.12, *chain[0][1:]), *chain[1:]]
        self._piece([arm + 0.05 * (end - top), end], _UPPER_ARM, (collar, chain))
        last = self.path(self.rig[f"{side}Arm"], self.rig[f"{side}ForeArm"])[-2]
        path, joints = self._bone(side, "ForeArm", "Hand", last, (0.12, 0.12))
        glove = (TINTS.index("body"), ((0.93, 0.02, TINTS.index("hand")),))
        self._piece(path, _FOREARM, joints, glove if f"{side}Hand" in self.rig else "body")

    def _torso(self) -> None:
        hips_wide = (
            float(np.linalg.norm(self.at("LeftUpLeg") - self.at("RightUpLeg"))) / 2 / 0.0914 / self.size
        )
        chest_wide = float(np.linalg.norm(self.at("LeftArm") - self.at("RightArm"))) / 2 / 0.181 / self.size
        height = self.torso / 0.507 / self.size
        deep = 0.5 * (height + 1.0)
        shares = [float((self.pose.places[j] - self.hips) @ self.up) / self.torso for j in self.spine]
        low, high = _TORSO[0][0], _TORSO[-1][0]
        profile = []
        for share, width, depth, shift in _TORSO:
            upper = float(np.clip((share - 0.1) / 0.7, 0.0, 1.0))
            wide = (1 - upper) * np.clip(hips_wide, 0.8 * height, 1.25 * height) + upper * np.clip(
                chest_wide, 0.8 * height, 1.3 * height
            )
            profile.append(((share - low) / (high - low), width * float(wide), depth * deep, shift * deep))
        # Each joint of the spine blends into the next around the middle of its bone.
        ends = [*shares[1:], 1.0]
        chain = []
        for n in range(1, len(self.spine)):
            start = max(shares[n], 0.06) if n == 1 else shares[n]
            reach = max(0.45 * (ends[n] - (shares[n - 1])), 0.08)
            chain.append(((start - low) / (high - low), reach / (high - low), self.spine[n]))
        belt = (TINTS.index("leg"), (((_BELT - low) / (high - low), 0.02, TINTS.index("body")),))
        path = [self.hips + share * self.torso * self.up for share in (low, high)]
        self._piece(path, tuple(profile), (self.spine[0], chain), belt, power=2.3, caps=(0.5, 0.6))

    def _neck_and_head(self) -> None:
        base = self.hips + 1.0 * self.torso * self.up
        neck = self.rig.get("Neck", self.chest)
        head = self.rig.get("Head")
        if head is None:
            tip = self.pose.ends.get(neck, base)
            along = unit(tip - base, self.up)
            along = along if along @ self.up > 0.5 else self.up
            tip = base + float(np.clip((tip - base) @ along, 0.2 * self.size, 0.3 * self.size)) * along
            self._head(neck, tip, along)
            self._neck(base, tip, neck, [])
            return
        end = self.pose.ends.get(head)
        place = self.pose.places[head]
        along = unit(place - base, self.up)
        if end is not None and np.linalg.norm(end - place) > 0.03 * self.size:
            towards = unit(end - place, along)
            along = towards if towards @ along > 0.5 else along
        reach = 0.1 * self.size if end is None else float(np.linalg.norm(end - place))
        lift = float(np.clip(reach - 0.055 * self.size, 0.03 * self.size, 0.1 * self.size))
        middle = place + lift * along
        self._head(head, middle, along)
        self._neck(base, middle, neck, self.path(neck, head)[1:])

    def _neck(self, base: Array, top: Array, neck: int, above: list[int]) -> None:
        """Add the neck from the chest into the head; `above` lists the joints from neck to head."""
        way = top - base
        chain = [(0.12, 0.2, neck)]
        for joint in above:
            share = float((self.pose.places[joint] - base) @ way / max(way @ way, 1e-12))
            chain.append((float(np.clip(share, 0.25, 0.9)), 0.16, joint))
        throat = (TINTS.index("body"), ((0.2, 0.05, TINTS.index("head")),))
        self._piece([base, top], _NECK, (self.chest, chain), throat)

    def _head(self, joint: int, middle: Array, along: Array) -> None:
        _, depth = cross_axes(along, self.front)
        half = self.size * _HEAD_HALF
        low, high = _HEAD[0][0], _HEAD[-1][0]
        profile = tuple(((h - low) / (high - low), *rest) for h, *rest in _HEAD)
        path = [middle + low * half * along, middle + high * half * along]
        self._piece(path, profile, (joint, ()), "head", caps=_HEAD_CAPS)
        s = self.size
        bridge, tip = (
            middle + s * (0.088 * depth + 0.004 * along),
            middle + s * (0.100 * depth - 0.026 * along),
        )
        self._piece(
            [bridge, tip], ((0.0, 0.007, 0.006, 0.0), (1.0, 0.013, 0.012, 0.0)), (joint, ()), "head", depth
        )
        chin = middle + s * (0.056 * depth - 0.072 * along)
        self._ball(chin, (0.030, 0.026, 0.028), (joint, ()), "head")

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
        # The sole is flat on the floor when ankle and ball are at their standing heights.
        drop = float(np.arcsin(np.clip(s * (ANKLE - BALL) / length, 0.0, 0.85)))
        raised = unit(np.cross(bone, left), -down)
        ahead = np.cos(drop) * bone + np.sin(drop) * raised
        normal = np.cross(ahead, left)
        ground = ankle_at - s * ANKLE * normal
        stretch = length * float(np.cos(drop)) / (0.1 * s)
        rows = []
        for x, width, sole, top in _FOOT:
            forward = x * (stretch if 0.0 < x < 0.1 else 1.0) + (0.1 * (stretch - 1.0) if x >= 0.1 else 0.0)
            rows.append((forward, width, 0.5 * (top - sole), 0.5 * (sole + top)))
        start, stop = rows[0][0], rows[-1][0]
        profile = tuple(((x - start) / (stop - start), *rest) for x, *rest in rows)
        chain = []
        if toe is not None:
            chain.append(((0.1 * stretch - start) / (stop - start), 0.13, toe))
        path = [ground + s * start * ahead, ground + s * stop * ahead]
        self._piece(path, profile, (ankle, chain), "foot", normal, power=2.6)

    def _hand(self, side: str) -> None:
        if f"{side}Hand" not in self.rig:
            return
        hand, s = self.rig[f"{side}Hand"], self.size
        place = self.pose.places[hand]
        along = unit(place - self.at(f"{side}ForeArm"), self.left)
        knuckles = [self.pose.places[j] for j in self._knuckles(hand)]
        if knuckles:  # end the palm where the fingers begin
            reach = float(np.median([np.linalg.norm(k - place) for k in knuckles]))
            along = unit(np.mean(knuckles, axis=0) - place, along)
            spread = max((np.linalg.norm(a - b) for a in knuckles for b in knuckles), default=0.0)
            wide = float(np.clip(0.5 * spread / s, 0.025, 0.05))
            widest = max(
                ((a - b) for a in knuckles for b in knuckles), key=lambda v: float(np.linalg.norm(v))
            )
            profile = ((0.0, 0.018, 0.026, 0.0), (1.0, 0.012, wide, 0.0))
            tip = place + max(reach, 0.05 * s) * along
            self._piece([place, tip], profile, (hand, ()), "hand", widest)
            return
        end = self.pose.ends.get(hand)
        if end is not None and np.linalg.norm(end - place) > 0.03 * s:
            towards = unit(end - place, along)
            along = towards if towards @ along > 0.5 else along
        self._piece([place + 0.012 * s * along, place + 0.165 * s * along], _MITTEN, (hand, ()), "hand")
        _, depth = cross_axes(along, self.front)
        root, tip = place + s * (0.03 * along + 0.026 * depth), place + s * (0.085 * along + 0.056 * depth)
        self._piece([root, tip], _THUMB, (hand, ()), "hand")

    def _knuckles(self, hand: int) -> list[int]:
        """The first joints of a hand's fingers; none if the hand has only a thumb and a tip."""
        parents = self.pose.parents
        fingers = [j for j, parent in enumerate(parents) if parent == hand and j in parents]
        return fingers if len(fingers) >= 3 else []

    def _others(self) -> None:
        """Add fingers, tails and other extra joints as thin bones."""
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
    """Tapered bones for a rig that is not human, thicker near the trunk, with a head if a joint is named so."""
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
