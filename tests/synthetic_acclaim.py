"""Writes motions as Acclaim files: a skeleton (.asf) whose bones have axes of their own, and its angles (.amc)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motionkit.motion.motion import Motion
from motionkit.motion.rotations import euler_to_quat, quat_inverse, quat_multiply, quat_to_euler

CMU_NAMES = {
    **{"Hips": "root", "LowerBack": "lowerback", "Spine": "upperback", "Spine1": "thorax"},
    **{"Neck": "lowerneck", "Neck1": "upperneck", "Head": "head"},
    **{
        f"{side}{ours}": f"{side[0].lower()}{theirs}"
        for side in ("Left", "Right")
        for ours, theirs in zip(
            ("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand"),
            ("femur", "tibia", "foot", "toes", "clavicle", "humerus", "radius", "hand"),
            strict=True,
        )
    },
}
ORDERS = ("XYZ", "ZYX", "YZX")  # of axes and of freedoms, one after another


def write_acclaim(
    folder: Path, motion: Motion, stem: str = "07_01", inch: float = 0.45, rate: str = ""
) -> Path:
    """Write a motion in cm with the joint names of CMU; returns the .amc."""
    skeleton, unit = motion.skeleton, 2.54 / inch
    names = [CMU_NAMES[name] for name in skeleton.names]
    chance = np.random.default_rng(3)
    bones, links, rows = [], [], []
    for joint, name in enumerate(names):
        order, axis = ORDERS[joint % 3], chance.uniform(-80, 80, 3) if joint else np.zeros(3)
        own = euler_to_quat(np.deg2rad(axis)[::-1], order[::-1])
        local = quat_multiply(quat_inverse(own), motion.local_rotations[:, joint].astype(np.float64))
        angles = np.rad2deg(quat_to_euler(quat_multiply(local, own), order[::-1]))[:, ::-1]
        if joint:
            links.append(f"{names[skeleton.parents[joint]]} link{joint}\nlink{joint} {name}")
            bones.append(bone(f"link{joint}", skeleton.offsets[joint] / unit))
            end = np.array(skeleton.end_sites.get(joint, (0.0, 0.0, 0.0))) / unit
            dof = " ".join(f"r{letter.lower()}" for letter in order)
            limits = "limits (-160 20)\n(-70.0 70.0)\n(-60.0 70.0)"
            bones.append(bone(name, end, f"axis {line(axis)} {order}\ndof {dof}\n{limits}"))
            rows.append([f"{name} {line(row)}" for row in angles])
        else:
            roots = motion.root_positions / unit
            rows.append([f"root {line(row)}" for row in np.concatenate([roots, angles], axis=1)])
            top = f"order TX TY TZ {' '.join('R' + letter for letter in order)}\naxis XYZ"
    (folder / f"{stem.partition('_')[0]}.asf").write_text(
        f"# made\n:version 1.10\n:name made\n:units\nmass 1.0\nlength {inch}\nangle deg\n:documentation\nfree text\n"
        f":root\n{top}\nposition 0 0 0\norientation 0 0 0\n:bonedata\n"
        + "\n".join(bones)
        + "\n:hierarchy\nbegin\n"
        + "\n".join(links)
        + "\nend\n"
    )
    frames = [f"{frame + 1}\n" + "\n".join(row) for frame, row in enumerate(zip(*rows, strict=True))]
    made = folder / f"{stem}.amc"
    made.write_text(f"#!OML:ASF\n:FULLY-SPECIFIED\n:DEGREES\n{rate}" + "\n".join(frames) + "\n")
    return made


def bone(name: str, end: np.ndarray, more: str = "axis 0 0 0 XYZ") -> str:
    """The block of a bone that ends at (3,)."""
    length = float(np.linalg.norm(end))
    return (
        f"begin\nid 1\nname {name}\ndirection {line(end / (length or 1.0))}\nlength {length:.9f}\n{more}\nend"
    )


def line(numbers: np.ndarray) -> str:
    return " ".join(f"{number:.9f}" for number in numbers)
