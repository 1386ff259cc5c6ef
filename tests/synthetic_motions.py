"""Motions made by formula with known properties: walks, spins, cartwheels, hops and standing."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.arrays import Array, smoothstep
from motionkit.motion.bvh import write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import TOES, move_feet
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_from_yaw,
    quat_identity,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_to_matrix,
)
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT, JOINT_NAMES, canonical_skeleton

TOE_HEIGHT = 4.1  # where a standing toe of the canonical skeleton is; cleaning leaves such clips alone


def _about(axis: str, angle: Array) -> Array:
    expmap = np.zeros((*angle.shape, 3), np.float64)
    expmap[..., "XYZ".index(axis)] = angle
    return expmap_to_quat(expmap)


def standing_rotations(frames: int) -> Array:
    """Local rotations (T, 23, 4): legs straight down, arms hanging, everything else as in the rest pose."""
    rotations = quat_identity((frames, JOINT_COUNT), np.float64)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        thigh, arm, fore = (JOINT_NAMES.index(side + n) for n in ("UpLeg", "Arm", "ForeArm"))
        toe = JOINT_NAMES.index(side + "Foot")
        angle = np.full((frames,), sign * math.radians(20.0), np.float64)
        rotations[:, thigh] = _about("Z", -angle)
        rotations[:, toe] = _about("Z", angle)
        rotations[:, arm] = _about("Z", -3.6 * angle)
        rotations[:, fore] = _about("Y", -1.0 * angle)
    return rotations


def _grounded(motion: Motion) -> Motion:
    """The motion with its lowest toe at standing height in every frame."""
    _, positions = motion_kinematics(motion)
    toes = positions[:, [FOOT_JOINTS[1], FOOT_JOINTS[3]], 1].min(axis=1)
    root = motion.root_positions.copy()
    root[:, 1] += TOE_HEIGHT - toes
    return Motion(motion.skeleton, motion.local_rotations, root, motion.fps)


def make_walk(
    frames: int = 180,
    fps: float = 60.0,
    speed: float = 120.0,
    turn: float = 0.3,
    phase: float = 0.0,
    swing: float = 0.45,
    cadence: float = 1.0,
    crouch: float = 0.0,
) -> Motion:
    """A walk with swinging legs and arms along a curve: speed in cm/s, turn in radians per second.

    crouch bends hips, knees and ankles, in radians of the knee.
    """
    time = np.arange(frames, dtype=np.float64) / fps
    beat = 2 * math.pi * cadence * time + phase
    rotations = standing_rotations(frames)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        at = {n: JOINT_NAMES.index(side + n) for n in ("UpLeg", "Leg", "Foot", "Arm", "ForeArm")}
        thigh = sign * swing * np.sin(beat)
        knee = swing * (1.0 + np.sin(beat * 1.0 + (0.0 if sign > 0 else math.pi) - 1.2))
        ankle = 0.3 * (thigh - knee) - 0.5 * crouch
        rotations[:, at["UpLeg"]] = quat_multiply(
            _about("X", -thigh - 0.5 * crouch), rotations[:, at["UpLeg"]]
        )
        rotations[:, at["Leg"]] = _about("X", knee + crouch)
        rotations[:, at["Foot"]] = quat_multiply(_about("X", ankle), rotations[:, at["Foot"]])
        rotations[:, at["Arm"]] = quat_multiply(_about("X", 0.7 * thigh), rotations[:, at["Arm"]])
    sway = JOINT_NAMES.index("Spine")
    rotations[:, sway] = _about("Y", 0.22 * swing * np.sin(beat))
    yaw = turn * time
    rotations[:, 0] = quat_multiply(quat_from_yaw(yaw), _about("X", 0.05 + 0.02 * np.sin(2 * beat)))
    steps = speed / fps * np.stack([np.sin(yaw), np.cos(yaw)], axis=-1)
    xz = np.cumsum(steps, axis=0) - steps[:1]
    root = np.stack([xz[:, 0], np.full_like(time, 95.0), xz[:, 1]], axis=-1)
    return _grounded(Motion(canonical_skeleton(), rotations.astype(np.float32), root.astype(np.float32), fps))


def make_steps(frames: int = 180, fps: float = 60.0, turn: float = 0.3, phase: float = 0.0) -> Motion:
    """A walk of 100 cm/s whose low feet stand: each toe rests for half a second, then swings 12 cm high for another."""
    walk = make_walk(frames, fps, speed=100.0, turn=turn, phase=phase)
    beat = np.arange(frames) / fps + phase / (2 * math.pi)
    toes = np.empty((frames, 2, 3), np.float32)
    for foot, sign in enumerate((1.0, -1.0)):
        step, share = np.divmod(beat - 0.25 * sign, 1.0)
        lifted = np.maximum(2 * share - 1, 0.0)
        swing = smoothstep(np.clip((lifted - 0.15) / 0.7, 0.0, 1.0))  # while the toe is high
        stands = []
        for number in (step, step + 1):
            time = number + 0.25 + 0.25 * sign - phase / (2 * math.pi)  # when the body passes the foot
            ahead = np.stack([np.sin(turn * time), np.cos(turn * time)], axis=-1)
            body = 100.0 / turn * np.stack([1 - ahead[:, 1], ahead[:, 0]], axis=-1)
            stands.append(body + 12.0 * ahead + 9.0 * sign * ahead[:, ::-1] * (1.0, -1.0))
        toes[:, foot, ::2] = stands[0] + swing[:, None] * (stands[1] - stands[0])
        toes[:, foot, 1] = TOE_HEIGHT + 12.0 * np.sin(math.pi * lifted)
    roots = walk.root_positions.copy()
    roots[:, 1] = 88.0
    low = replace(walk, root_positions=roots)
    turns, positions = motion_kinematics(low)
    rotations, level = low.local_rotations.copy(), quat_identity((frames, 2))
    move_feet(rotations, positions, quat_to_matrix(turns), level, toes - positions[:, TOES])
    return replace(low, local_rotations=quat_normalize(rotations))


def feet_down(frames: int, left: list[tuple[int, int]], right: list[tuple[int, int]]) -> Array:
    """Contacts (T, 4) with both feet down in the given frames."""
    contacts = np.zeros((frames, 4), np.float32)
    for columns, spans in ((slice(0, 2), left), (slice(2, 4), right)):
        for start, end in spans:
            contacts[start:end, columns] = 1.0
    return contacts


def sliding(frames: int = 120, speed: float = 10.0, crouch: float = 0.4) -> Motion:
    """A body whose feet slide with its root at `speed` cm/s, with knees bent by `crouch` radians."""
    return make_walk(frames, speed=speed, turn=0.0, swing=0.08, cadence=0.3, crouch=crouch)


def make_idle(frames: int = 180, fps: float = 60.0, phase: float = 0.0) -> Motion:
    """A standing body that sways a little."""
    return make_walk(frames, fps, speed=0.0, turn=0.02, phase=phase, swing=0.03, cadence=0.4)


def make_jump(frames: int = 150, fps: float = 60.0, side: float = 1.0, phase: float = 0.0) -> Motion:
    """Hops in place on the left leg (side 1) or the right one (side -1), the other leg held up."""
    time = np.arange(frames, dtype=np.float64) / fps
    beat = 2 * math.pi * 1.2 * time + phase
    rotations = standing_rotations(frames)
    up = "Right" if side > 0 else "Left"
    thigh, knee = JOINT_NAMES.index(up + "UpLeg"), JOINT_NAMES.index(up + "Leg")
    rotations[:, thigh] = quat_multiply(_about("X", -0.9 - 0.1 * np.sin(beat)), rotations[:, thigh])
    rotations[:, knee] = _about("X", 1.3 + 0.1 * np.sin(beat))
    root = np.stack([np.sin(beat), np.full_like(time, 95.0), np.zeros_like(time)], axis=-1)
    motion = _grounded(
        Motion(canonical_skeleton(), rotations.astype(np.float32), root.astype(np.float32), fps)
    )
    hop = 12.0 * np.maximum(np.sin(beat), 0.0)
    motion.root_positions[:, 1] += hop.astype(np.float32)
    return motion


def make_cartwheel(
    frames: int = 180, fps: float = 60.0, yaw: float = 0.0, side: float = 1.0, turns: float = 1.0
) -> Motion:
    """A body that stands, turns over sideways in its own plane, and stands again, without turning its facing."""
    time = np.arange(frames, dtype=np.float64) / fps
    share = np.clip((time - 0.25 * time[-1]) / (0.5 * time[-1]), 0.0, 1.0)
    eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    roll = -side * 2 * math.pi * turns * eased
    rotations = standing_rotations(frames)
    for name, sign in (("LeftArm", 1.0), ("RightArm", -1.0)):  # arms overhead while inverted
        joint = JOINT_NAMES.index(name)
        lift = math.radians(140.0) * np.sin(math.pi * eased)
        rotations[:, joint] = quat_multiply(_about("Z", sign * lift), rotations[:, joint])
    facing = quat_from_yaw(np.full((frames,), yaw, np.float64))
    rotations[:, 0] = quat_multiply(facing, _about("Z", roll))
    across = np.stack([side * 160.0 * eased, np.zeros_like(time), np.zeros_like(time)], axis=-1)
    root = quat_rotate(facing, across)
    upright = make_idle(frames, fps).root_positions[:, 1].astype(np.float64)
    root[:, 1] = upright - 25.0 * np.sin(math.pi * eased)
    return Motion(canonical_skeleton(), rotations.astype(np.float32), root.astype(np.float32), fps)


def make_dance(frames: int = 240, fps: float = 60.0) -> Motion:
    """A spinning body whose arms, thighs and spine turn through pi and on."""
    motion = make_walk(frames, fps, speed=40.0, turn=2.5)
    time = np.arange(frames, dtype=np.float64) / fps
    rotations = motion.local_rotations.astype(np.float64)
    for name, axis, rate in (
        ("LeftArm", "X", 1.7),
        ("RightArm", "Z", -2.1),
        ("LeftForeArm", "Y", 2.6),
        ("RightUpLeg", "X", -1.3),
        ("Head", "Y", 3.1),
    ):
        joint = JOINT_NAMES.index(name)
        rotations[:, joint] = quat_multiply(_about(axis, rate * time), rotations[:, joint])
    return Motion(motion.skeleton, rotations.astype(np.float32), motion.root_positions, fps)


def placed(motion: Motion, yaw: float = 0.0, move: tuple[float, float] = (0.0, 0.0)) -> Motion:
    """The motion turned about Y through the origin, then moved by x, z in cm."""
    turn = quat_from_yaw(np.array(yaw, np.float64))
    rotations = motion.local_rotations.astype(np.float64).copy()
    rotations[:, 0] = quat_multiply(np.broadcast_to(turn, rotations[:, 0].shape), rotations[:, 0])
    root = quat_rotate(turn, motion.root_positions.astype(np.float64))
    root = root + np.array([move[0], 0.0, move[1]], np.float64)
    return Motion(motion.skeleton, rotations.astype(np.float32), root.astype(np.float32), motion.fps)


LABELS = """file,start_frame,end_frame,type,subject,fps,split,note
walk_01.bvh,0,120,walking,1,,train,
walk_01.bvh,120,-1,running,1,,train,touches the stretch before
walk_02.bvh,0,-1,walking,1,,train,
walk_03.bvh,0,-1,walking,1,,test,
run_01.bvh,0,-1,running,2,,train,at 120 fps
wheel_01.bvh,0,-1,cartwheel,2,,train,
hop_left.bvh,0,-1,jumping-l,2,,train,
hop_right.bvh,0,-1,jumping-r,2,,train,
idle_01.bvh,0,-1,idle,3,,train,
"""


def write_clips(folder: Path) -> Path:
    """A folder of small BVH files with a labels.csv: six types, one file at 120 fps, two types in one file."""
    folder.mkdir(parents=True, exist_ok=True)
    clips = {
        "walk_01": make_walk(240),
        "walk_02": make_walk(200, turn=-0.4, phase=1.0, speed=100.0),
        "walk_03": make_walk(150, turn=0.0, phase=2.0),
        "run_01": make_walk(300, fps=120.0, speed=300.0, cadence=1.6, swing=0.7),
        "wheel_01": make_cartwheel(170),
        "hop_left": make_jump(150, side=1.0),
        "hop_right": make_jump(140, side=-1.0, phase=0.5),
        "idle_01": make_idle(160),
    }
    for name, motion in clips.items():
        write_bvh(folder / f"{name}.bvh", motion)
    (folder / "labels.csv").write_text(LABELS, encoding="utf-8")
    return folder
