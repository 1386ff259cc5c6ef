"""Results of every edit of recorded clips: if any of these values changes, an edit has changed.

PYTHONPATH=tests python tests/editing/test_golden.py prints them anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from motionkit.editing.fix import Fixed, Repairs, fix_motion
from motionkit.editing.join import join_motions
from motionkit.editing.loop import make_loop
from motionkit.editing.rest_frame import with_rest_frame, with_rest_pose
from motionkit.editing.root_from_feet import root_from_feet
from motionkit.editing.root_motion import at_origin, in_place, with_ground_root
from motionkit.editing.trim import moving_frames
from motionkit.errors import MotionkitError
from motionkit.export.formats import read_motion
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.rig.upright import Upright
from synthetic_motions import make_cartwheel

pytestmark = pytest.mark.thorough

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"


@cache
def clip(name: str, fps: float = 60.0) -> Motion:
    return resample(read_motion(DATA / f"{name}.bvh"), fps)


def damaged(name: str) -> Motion:
    """A clip that trembles, with a pop, a leap of the root, and a floor that is too high."""
    motion = clip(name)
    rotations, roots = motion.local_rotations.copy(), motion.root_positions.copy()
    shaken = rotations + np.random.default_rng(1).normal(scale=0.01, size=rotations.shape)
    shaken[40, 5] = np.roll(shaken[40, 5], 1)
    roots[60] += 30.0
    roots[:, 1] += 4.0
    shaken /= np.linalg.norm(shaken, axis=-1, keepdims=True)
    return replace(motion, local_rotations=shaken.astype(np.float32), root_positions=roots)


def pinned(name: str) -> Motion:
    motion = clip(name)
    return replace(motion, root_positions=np.repeat(motion.root_positions[:1], len(motion), axis=0))


def human(motion: Motion) -> Motion:
    canonical = Upright.of(motion).canonical
    assert canonical is not None
    return canonical


def figures(motion: Motion) -> list[float]:
    """Its frames, and the means of its joints' places times random numbers."""
    places = motion_kinematics(motion)[1].astype(np.float64)
    chance = np.random.default_rng(0)
    return [
        len(motion),
        *(float((places * chance.normal(size=places.shape)).mean()) * 100.0 for _ in range(3)),
    ]


def looped(name: str, **options: float) -> list[float]:
    loop = make_loop(clip(name), **options)  # type: ignore[arg-type]
    return [loop.start, loop.end, loop.difference, *loop.seam.as_dict().values(), *figures(loop.motion)]


def every_loop() -> list[float]:
    """Which clips repeat, and where the best cycle of each begins and ends."""
    out: list[float] = []
    for number, path in enumerate(sorted(DATA.glob("*.bvh"))):
        try:
            loop = make_loop(clip(path.stem, 30.0))
        except MotionkitError:
            continue
        out += [number, loop.start, loop.end, loop.difference]
    return out


def joined(*names: str, **options: object) -> list[float]:
    made = join_motions([clip(name) for name in names], **options)  # type: ignore[arg-type]
    seams = [value for seam in made.seams for value in (seam.frame, seam.apart, *(seam.sliding or ()))]
    return [*seams, *figures(made.motion)]


def fixed(made: Fixed) -> list[float]:
    rows = [value for row in made.table for value in (row.before, row.after) if value is not None]
    return [len(made.glitches), *rows, *figures(made.motion)]


# fmt: off
VALUES: dict[str, list[float]] = {
    "loop 06_06": [73, 137, 5.3224, 0.0, 26.3409, 6.5764, 123.7816, 65, 3.7161, 7.0559, -2.4018],
    "loop 16_26": [76, 132, 3.8812, 0.0, 21.8089, 8.571, 159.4318, 57, 23.3026, 0.3159, -15.7602],
    "loop 16_45": [10, 52, 4.5883, 0.0, 45.0898, 15.4963, 165.1907, 43, 30.5023, -7.8465, 11.8307],
    "loop 49_06": [33, 230, 7.5534, 0.0, 19.4052, 15.2706, 348.6193, 198, 12.4448, -2.7158, -12.5138],
    "loop 0.5 s": [37, 104, 1.4951, 0.0, 17.4841, 7.4631, 132.9846, 68, 29.332, -0.9042, 10.4024],
    "loop 1.3 s": [37, 104, 1.4951, 0.0, 17.4841, 7.4631, 132.9846, 68, 29.332, -0.9042, 10.4024],
    "loop 2.4 s": [37, 104, 1.4951, 0.0, 17.4855, 7.4631, 132.985, 135, 23.2504, 4.6788, 10.0122],
    "loop 9.0 s": [37, 104, 1.4951, 0.0002, 17.4768, 7.4632, 132.9904, 537, -6.7344, -16.0563, -13.8548],
    "loop at the origin": [10, 52, 4.5883, 0.0, 45.0904, 15.4964, 165.1885, 43, 28.3362, 24.3744, 12.7029],
    "join": [125, 2.6379, 19.8452, 18.1624, 224, 11.2304, 12.9332, 11.1455, 289, -15.7067, -30.7894, 2.3453],
    "join at once": [34, 11.1957, 32.2567, 6.6995, 96, 75.3387, -56.5436, -34.7941],
    "join at times": [61, 15.2834, 72.1285, 29.5886, 142, -8.0799, -3.3113, -1.2418],
    "fix": [
        1, 2, 0, 25.5664, 4.0593, 0.5837, 0.1029, 1.9072, 0.3819, 58533.1845, 384.2613, 127, 19.6844,
        -2.8416, 12.3296,
    ],
    "fix half": [
        1, 2, 0, 25.4484, 4.1136, 1.6406, 0.3542, 1.5349, 1.0077, 55973.5138, 3665.0245, 135, -4.5204,
        12.2181, 12.6819,
    ],
    "fix a root": [
        0, 0, 0, 4.2253, 3.8959, 6.1041, 0.4959, 0.1089, 0.0179, 7.0974, 1.8786, 395.7994, 129.0365,
        233, -3.1591, -1.6702, -0.2418,
    ],
    "root from feet": [190, 0.5481, 0.1444, -37.3904],
    "root from feet, running": [68, 136.0126, 34.04, -12.1875],
    "in_place False": [135, 2.1824, 0.8284, -7.6013],
    "in_place True": [135, 2.6319, 0.8298, -7.3153],
    "at_origin False": [135, 16.9729, 8.009, 8.7637],
    "at_origin True": [135, 17.3967, 7.106, 9.0581],
    "with_ground_root False": [135, -0.9812, -7.0448, 8.4415],
    "with_ground_root True": [135, -0.9781, -7.0915, 8.4237],
    "ground root twice": [135, -0.9781, -7.0915, 8.4237],  # as once: the root bone follows the hips
    "rest frame": [128, 18.0227, 0.415, 13.3054],
    "moving frames": [50, 190],
    "loop every clip": [
        1, 99, 127, 5.7313, 6, 5, 63, 2.4862, 8, 14, 94, 3.1302, 9, 5, 65, 6.1096, 10, 39, 67, 3.8296, 15, 8,
        29, 4.7573, 16, 9, 29, 5.465, 20, 9, 43, 1.508, 21, 21, 59, 1.182, 22, 16, 115, 7.6529, 24, 46, 130,
        7.1216,
    ],
    "join while they run": [
        51, 4.5333, 57.8016, 17.6456, 107, 3.5504, 42.3684, 25.3669, 239, 11.4777, 23.4381, 8.786,
        301, 3.7657, -54.0581, -8.3093,
    ],
    "join jumps": [233, 3.53, 4.3059, 0.9016, 421, -6.0454, -3.4542, 6.3804],
    "rest pose": [127, 19.5049, -2.7639, 12.3023],
    "fix a run": [
        1, 2, 0, 24.6327, 3.8703, 0.4816, 0.163, 0.4053, 0.0758, 94575.0092, 311.0169, 68, 41.6536, -34.011,
        26.5875,
    ],
    "root from feet, jumps": [148, -27.3119, 66.5868, -2.1745],
    "root from feet, cartwheel": [241, 114.7687, -115.8807, 15.9782],
}
# fmt: on
EDITS: dict[str, Callable[[], list[float]]] = {
    **{f"loop {name}": lambda name=name: looped(name) for name in ("06_06", "16_26", "16_45", "49_06")},
    **{f"loop {wish} s": lambda wish=wish: looped("35_01", seconds=wish) for wish in (0.5, 1.3, 2.4, 9.0)},
    "loop every clip": every_loop,
    "loop at the origin": lambda: looped("16_45", from_origin=True),
    "join": lambda: joined("16_26", "35_01", "16_45"),
    "join at once": lambda: joined("16_45", "35_30", blend=0.1, window=0.4, fps=30.0),
    "join at times": lambda: joined("16_26", "35_01", at=[(1.0, 0.5)]),
    "join while they run": lambda: joined("16_45", "16_46", "16_57", "16_48", window=0.6),
    "join jumps": lambda: joined("16_02", "16_04", blend=1.5),
    "fix": lambda: fixed(fix_motion(damaged("35_30"))),
    "fix half": lambda: fixed(fix_motion(damaged("16_26"), Repairs(strength=0.5))),
    "fix a root": lambda: fixed(fix_motion(pinned("16_02"), Repairs(root_from_feet=True))),
    "root from feet": lambda: figures(root_from_feet(human(pinned("16_04")))),
    "root from feet, running": lambda: figures(root_from_feet(human(pinned("16_45")))),
    **{
        f"{edit.__name__} {cyclic}": lambda edit=edit, cyclic=cyclic: figures(edit(clip("16_26"), cyclic))
        for edit in (in_place, at_origin, with_ground_root)
        for cyclic in (False, True)
    },
    "ground root twice": lambda: figures(with_ground_root(with_ground_root(clip("16_26")), True)),
    "rest frame": lambda: figures(with_rest_frame(clip("35_30"))),
    "rest pose": lambda: figures(with_rest_pose(clip("35_30"), "apose")),
    "fix a run": lambda: fixed(fix_motion(damaged("16_45"), Repairs(strength=2.0, sliding=False))),
    "root from feet, jumps": lambda: figures(root_from_feet(human(pinned("16_05")))),
    "root from feet, cartwheel": lambda: figures(root_from_feet(human(pinned("49_06")))),
    "moving frames": lambda: list(moving_frames(make_cartwheel(240))),
}


@pytest.mark.parametrize("edit", EDITS)
def test_edits_give_the_values_that_they_gave(edit: str) -> None:
    assert EDITS[edit]() == pytest.approx(VALUES[edit], rel=2e-4, abs=2e-3)


if __name__ == "__main__":
    for name, edit in EDITS.items():
        print(f'    "{name}": {[round(value, 4) for value in edit()]},')
