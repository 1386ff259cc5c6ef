"""What finishing changes of recorded clips that were spoilt: if any of these values changes, a correction has changed.

PYTHONPATH=tests python tests/finish/test_golden.py prints them anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from motionkit.export.formats import read_motion
from motionkit.finish.feet import clear_toes, lock_feet
from motionkit.finish.finish import Finish, finish
from motionkit.finish.hands import fingers_above
from motionkit.finish.root_height import above_ground, in_the_air
from motionkit.finish.root_path import corrected_path
from motionkit.finish.soles import plant_soles
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_rotate
from motionkit.rig.soles import Sole
from motionkit.rig.upright import Upright

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"
FOOT, TOE = (
    np.array([[x, -3.0, z] for x in (-4.0, 4.0) for z in far], np.float32)
    for far in ((-17.0, -9.0, 0.0), (1.0, 8.0))
)
SOLE = Sole(FOOT, TOE, 3.0, 4.1)


@cache
def recorded(name: str, fps: float) -> tuple[Motion, np.ndarray]:
    """A clip on the canonical joints, and its contacts."""
    upright = Upright.of(resample(read_motion(DATA / f"{name}.bvh"), fps).cut(0, round(4.0 * fps)))
    assert upright.canonical is not None
    return upright.canonical, upright.contacts


def spoilt(motion: Motion, rise: float, jumps: float, drift: float) -> Motion:
    """The motion raised now and then by so many cm, its heights stretched, drifting by cm/s and rocking."""
    roots, time = motion.root_positions.astype(np.float64), np.arange(len(motion)) / motion.fps
    usual = np.median(roots[:, 1])
    roots[:, 1] = usual + jumps * (roots[:, 1] - usual) + rise * np.sin(4.0 * time) ** 4
    roots[:, 0] += drift * time
    roots[:, 2] += 0.1 * drift * np.sin(9.0 * time)
    return replace(motion, root_positions=roots.astype(np.float32))


def lowered(motion: Motion, down: float) -> Motion:
    return replace(motion, root_positions=motion.root_positions - np.array([0.0, down, 0.0], np.float32))


def points(motion: Motion) -> np.ndarray:
    """A point (T, 23, 3) beside each joint, which moves and turns with it."""
    turns, places = motion_kinematics(motion)
    return places + quat_rotate(turns.astype(np.float64), np.array([7.0, 5.0, 3.0]))


def changes(name: str, step: Callable[[Motion, np.ndarray], Motion], fps: float = 60.0) -> list[float]:
    """How far a step moves the joints of three versions of a clip, in cm: the mean, and with random weights."""
    out = []
    for number, (rise, jumps, drift) in enumerate(((-8.0, 1.0, 0.0), (4.0, 1.3, 12.0), (2.0, 0.8, -30.0))):
        motion, contacts = recorded(name, fps)
        motion = spoilt(motion, rise, jumps, drift)
        before, after = map(points, (motion, step(motion, contacts)))
        weights = np.random.default_rng(number).normal(size=before.shape)
        out += [
            100.0 * float(np.abs(after - before).mean()),
            100.0 * float(((after - before) * weights).mean()),
        ]
    return out


STEPS: dict[str, Callable[[Motion, np.ndarray], Motion]] = {
    "feet": lock_feet,
    "uncertain feet": lambda motion, contacts: lock_feet(motion, 0.3 + 0.45 * contacts),
    "toes": lambda motion, contacts: clear_toes(motion),
    "fingers": lambda motion, contacts: fingers_above(motion),
    "ground": lambda motion, contacts: above_ground(lowered(motion, 20.0)),
    "air": lambda motion, contacts: in_the_air(motion),
    "air of a larger body": lambda motion, contacts: in_the_air(motion, 1.2),
    "path": lambda motion, contacts: corrected_path(motion, contacts, 0.6, 4.0),
    "soles": lambda motion, contacts: plant_soles(motion, (SOLE, SOLE), contacts),
    "all": lambda motion, contacts: finish(motion, contacts, Finish(hold=0.3, most=6.0, soles=(SOLE, SOLE))),
}
CLIPS = {"16_26": 60.0, "16_05": 60.0, "49_06": 60.0, "35_01": 120.0}
# fmt: off
VALUES: dict[str, list[float]] = {
    "feet of 16_26": [30.3951, -0.0272, 28.8918, -0.6484, 94.611, -0.4543],
    "uncertain feet of 16_26": [56.4786, 0.3527, 32.3156, 0.23, 97.3672, -0.5181],
    "toes of 16_26": [29.9802, 0.7037, 0.0, 0.0, 0.0, 0.0],
    "fingers of 16_26": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "ground of 16_26": [666.6667, 1.5931, 666.6667, 6.3966, 666.6667, -5.7384],
    "air of 16_26": [0.0, 0.0, 7.3153, -0.4566, 0.0, 0.0],
    "air of a larger body of 16_26": [0.0, 0.0, 7.3153, -0.4566, 0.0, 0.0],
    "path of 16_26": [215.1106, -6.5517, 354.8079, -0.5297, 724.4707, 23.406],
    "soles of 16_26": [96.3142, -0.2185, 78.3321, 1.2501, 50.5459, -0.6394],
    "all of 16_26": [169.8482, -2.6909, 199.5075, -0.1919, 415.3711, 11.0744],
    "feet of 16_05": [20.1357, 0.0246, 36.2931, -0.4689, 50.5559, 2.1721],
    "uncertain feet of 16_05": [39.9396, 0.3865, 37.8808, -0.3572, 63.9054, 2.3552],
    "toes of 16_05": [16.7961, -0.0917, 2.9262, 0.1518, 0.0, 0.0],
    "fingers of 16_05": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "ground of 16_05": [666.6667, 1.7194, 666.6667, 7.497, 666.6667, -2.2096],
    "air of 16_05": [3.5805, -0.1621, 35.2737, 0.109, 53.8325, 2.6713],
    "air of a larger body of 16_05": [14.9014, -0.577, 2.0368, -0.1419, 0.0, 0.0],
    "path of 16_05": [34.3132, -1.1112, 258.337, -1.3323, 594.039, 19.1949],
    "soles of 16_05": [63.0676, 0.4811, 54.7715, 0.2152, 56.3773, -0.6852],
    "all of 16_05": [68.2472, -0.2202, 196.9375, -0.402, 341.8048, 12.3907],
    "feet of 49_06": [27.84, 0.0497, 27.726, -0.4674, 42.0018, 2.3889],
    "uncertain feet of 49_06": [47.4447, 1.6613, 37.8321, -0.7458, 57.6803, 2.8557],
    "toes of 49_06": [26.9499, 0.7885, 5.5648, -0.0075, 2.4255, 0.1444],
    "fingers of 49_06": [4.9681, -0.1462, 2.8292, -0.1573, 2.6058, 0.1188],
    "ground of 49_06": [505.5877, -4.578, 556.7273, 3.0064, 580.5094, -12.827],
    "air of 49_06": [0.0, 0.0, 4.1589, -0.0819, 2.2795, 0.0274],
    "air of a larger body of 49_06": [0.0, 0.0, 4.1589, -0.0819, 2.2795, 0.0274],
    "path of 49_06": [103.1059, -0.4555, 492.9274, 0.6419, 967.0288, 9.0732],
    "soles of 49_06": [154.7546, 1.4752, 81.5287, -0.8293, 50.6626, 0.8833],
    "all of 49_06": [181.2839, 0.7261, 304.8772, -0.3031, 530.7947, 6.7811],
    "feet of 35_01": [18.3379, -0.2859, 19.5573, -0.1369, 47.9823, 0.1358],
    "uncertain feet of 35_01": [40.7391, -0.9442, 32.2924, 0.2933, 52.5161, 0.5249],
    "toes of 35_01": [24.2344, -0.7473, 0.114, 0.0166, 0.3023, 0.0263],
    "fingers of 35_01": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "ground of 35_01": [666.6667, -5.3274, 666.6667, 10.2035, 666.6667, -11.9718],
    "air of 35_01": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "air of a larger body of 35_01": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "path of 35_01": [114.9691, -0.118, 291.4647, 1.8165, 620.2709, 4.7767],
    "soles of 35_01": [103.0414, -0.3384, 38.499, 0.3411, 13.9099, 0.1339],
    "all of 35_01": [128.7531, -0.4573, 165.9732, 1.1197, 327.9197, 2.8946],
}
# fmt: on


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("name", CLIPS)
def test_finishing_changes_what_it_changed(name: str, step: str) -> None:
    found = changes(name, STEPS[step], CLIPS[name])
    assert found == pytest.approx(VALUES[f"{step} of {name}"], rel=1e-3, abs=1e-3)


if __name__ == "__main__":
    for name, fps in CLIPS.items():
        for step, work in STEPS.items():
            print(f'    "{step} of {name}": {[round(value, 4) for value in changes(name, work, fps)]},')
