"""--up, --unit and --map: what is taken of a clip in place of what is found, by every command that reads one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.export.formats import read_motion
from motionkit.motion.bvh import write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_inverse
from motionkit.rig.retarget import retarget_file
from motionkit.rig.up_axis import named_up, turned_world, up_turn
from motionkit.rig.upright import Upright
from synthetic_motions import make_walk

from .conftest import page_data

SWAPPED = {"UpLeg": "Arm", "Leg": "ForeArm", "Foot": "Hand", "Arm": "UpLeg", "ForeArm": "Leg", "Hand": "Foot"}
TAKEN = ("--up", "-x", "--unit", "7.3", "--map", "map.json")
SAID = "as given: -X is up\nas given: 1 unit is 7.3 cm\nas given: the bone map map.json\n"


@pytest.fixture(autouse=True)
def clips(tmp_path: Path) -> None:
    """A walk, and the same in an odd unit with -X up, whose arms are called legs and the other way round."""
    walk = make_walk(150)
    write_bvh(tmp_path / "walk.bvh", walk)
    names = walk.skeleton.names
    odd = {name: name[: -len(part)] + to for name in names for part, to in SWAPPED.items() if name in
           (f"Left{part}", f"Right{part}")}  # fmt: skip
    skeleton = replace(walk.skeleton, names=tuple(odd.get(name, name) for name in names))
    turned = turned_world(replace(walk, skeleton=skeleton), quat_inverse(up_turn(named_up("-X"))))
    (tmp_path / "odd").mkdir()
    write_bvh(tmp_path / "odd" / "walk.bvh", turned.scaled(1 / 7.3))
    table = {odd.get(name, name): name for name in names}
    (tmp_path / "map.json").write_text(json.dumps({"joints": table}))


@pytest.mark.parametrize(
    "words",
    [
        "convert odd/walk.bvh a.npz",
        "mirror odd/walk.bvh a.bvh",
        "view odd/walk.bvh -o a.png",
        "loop odd/walk.bvh -o a.bvh",
        "fix odd/walk.bvh -o a.bvh",
        "trim odd/walk.bvh -o a.bvh",
        "doctor odd --json",
        "metrics odd/walk.bvh --json",
        "preprocess odd -o a --jobs 1 --no-test --no-validation --json",
        "preprocess odd -o a --jobs 2 --no-test --no-validation --json",
        "doctor odd --jobs 2 --json",
        "fix odd -o a --jobs 2",
    ],
)
def test_every_command_takes_and_says_it(motionkit, tmp_path: Path, words: str) -> None:
    done = motionkit(*words.split(), *TAKEN)
    assert done.code == 0, done.err
    assert done.err.startswith(SAID), done.err
    if words.startswith("convert"):  # in cm with Y up, as the walk is
        with np.load(tmp_path / "a.npz") as found:
            assert np.abs(found["positions"] - motion_kinematics(make_walk(150))[1]).max() < 0.01
            assert len(found["contacts"]) == 150
    elif words.startswith("doctor"):
        (clip,) = json.loads(done.out)["clips"]
        assert (clip["up"], clip["unit"]) == ("-X", "given") and not any("shape" in n for n in clip["notes"])
    elif words.startswith("metrics"):
        both = [
            json.loads(said.out)["metrics"] for said in (done, motionkit("metrics", "walk.bvh", "--json"))
        ]
        ours, plain = ({row["id"]: row["value"] for row in rows} for rows in both)
        assert all(
            ours[name] == pytest.approx(plain[name], rel=0.05) for name in ("bm-geodesic", "jerk", "afs")
        )
    elif words.startswith("preprocess"):
        (file,) = json.loads(done.out)["files"]
        assert file["mapping"]["scale"] == 7.3 and file["mapping"]["scale_source"] == "given"
        assert not file["mapping"]["missing"]


def test_retarget_takes_it_of_the_source_alone(motionkit, tmp_path: Path) -> None:
    """The rig to write on is found as ever, and the page shows both upright."""
    words = ("retarget", "odd/walk.bvh", "--source-map", "map.json", "--up", "-X", "--unit", "7.3")
    done = motionkit(*words, "--rig", "walk.bvh", "-o", "a.bvh", "--no-ik", "--view")
    assert done.code == 0 and done.err.startswith(SAID.rpartition("as given")[0]), done.err
    places = motion_kinematics(read_motion(tmp_path / "a.bvh"))[1]
    assert np.abs(places - motion_kinematics(make_walk(150))[1]).max() < 1.0
    assert retarget_file(tmp_path / "a.bvh")[1].scale == 1.0


def test_a_rig_to_write_on_is_read_as_ever(motionkit, tmp_path: Path) -> None:
    """What is said of the clips does not hold for the rig of --rig."""
    (tmp_path / "odd" / "again.bvh").write_bytes((tmp_path / "odd" / "walk.bvh").read_bytes())
    taken = (*TAKEN, "--rig", "@lafan1")
    joined = motionkit("join", "odd/walk.bvh", "odd/again.bvh", *taken, "-o", "a.bvh")
    assert joined.code == 0, joined.err
    made = Upright.of(read_motion(tmp_path / "a.bvh"))
    assert made.up[1] == 1.0 and 80.0 < made.positions[:, 0, 1].mean() < 110.0
    shown = motionkit("view", "odd/walk.bvh", *taken, "-o", "a.html", "--no-open")
    assert shown.code == 0, shown.err
    (drawn,) = page_data(tmp_path / "a.html")["motions"]
    assert (drawn["scale"], drawn["unit"]) == (0.01, "detected from leg length: centimetres")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('{"joints": {"LeftArm": "LeftUpLeg", "Tail": "Hips"}}', "walk.bvh: has no joint 'Tail', which the bone map"),
        ('{"joints": {"LeftArm": "Wing"}}', "map.json: LeftArm is mapped to 'Wing', expected a canonical joint"),
        ('{"joints": {"LeftArm": "LeftUpLeg"}}', "no joint is mapped to Hips"),
        ('{"joints": [', "map.json: not JSON"),
    ],
)  # fmt: skip
def test_faults_of_a_map(motionkit, tmp_path: Path, table: str, said: str) -> None:
    (tmp_path / "map.json").write_text(table)
    done = motionkit("metrics", "odd/walk.bvh", "--map", "map.json")
    assert done.code != 0 and said in done.err, done.err


def test_a_map_of_another_rig_is_told(motionkit, tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text('{"joints": {"Pelvis": "Hips"}}')
    done = motionkit("metrics", "walk.bvh", "--map", "map.json")
    assert done.code == 0 and "because the bone map names none of them" in done.err
