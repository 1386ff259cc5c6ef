"""`motionkit retarget`, and --rig of the commands that make motion."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

import motionkit as mk
from motionkit.arrays import normalized
from motionkit.cli.main import cli
from motionkit.errors import MotionkitError
from motionkit.motion.bvh import bvh_to_motion, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_identity, quat_normalize
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton, canonical_skeleton, mirrored_name
from motionkit.rig.built_in import BUILT_IN, rig_file
from synthetic_motions import make_steps
from synthetic_rigs import FAMILIES, renamed, turned_rest, walk

NAMES = FAMILIES["bandai-namco"]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a rig in metres (my.bvh) and a walk on canonical joints (walk.bvh)."""
    write_bvh(tmp_path / "my.bvh", renamed(walk(8), NAMES).scaled(0.01))
    write_bvh(tmp_path / "walk.bvh", make_steps(40))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, list(words))


def fault(*words: str) -> str:
    """The message of a command that the data or the work makes fail, one line without a traceback."""
    result = run(*words)
    assert isinstance(result.exception, MotionkitError), result.output
    said = str(result.exception)
    assert "\n" not in said
    return said


def hierarchy(path: str) -> str:
    return Path(path).read_text().split("MOTION")[0]


def test_a_clip_on_my_rig(place: Path) -> None:
    result = run(
        "retarget", "walk.bvh", "--rig", "my.bvh", "-o", "out.bvh", "--fps", "30", "--save-map", "rig.json"
    )
    assert result.exit_code == 0, result.output
    assert "wrote out.bvh: 20 frames at 30 fps on my.bvh, 21 joints" in result.output
    assert "my.bvh: 21 canonical joints found by name; not on this rig: LowerBack, Neck1\n" in result.output
    assert "UpperLeg_L" not in result.output
    assert hierarchy("out.bvh") == hierarchy("my.bvh")
    made = mk.read_canonical("out.bvh")
    assert (
        abs(float(made.root_positions[:, 1].mean()) - float(make_steps(40).root_positions[:, 1].mean())) < 3.0
    )
    joints = json.loads((place / "rig.json").read_text())["joints"]
    assert joints == {theirs: ours for ours, theirs in NAMES.items()}


def test_without_a_rig_the_canonical_joints(place: Path) -> None:
    result = run("retarget", "my.bvh")
    assert result.exit_code == 0 and "my-on-canonical.bvh" in result.output, result.output
    assert read_bvh("my-on-canonical.bvh").skeleton.names == JOINT_NAMES


def test_looking_at_a_rig(place: Path) -> None:
    shown = run("retarget", "--rig", "my.bvh", "--save-map", "rig.json")
    assert shown.exit_code == 0 and "wrote rig.json: bone map" in shown.output
    told = json.loads(run("retarget", "--rig", "my.bvh", "--map", "rig.json", "--json").output)
    assert told["joints"]["UpperLeg_L"] == "LeftUpLeg" and told["found"]["LeftUpLeg"] == "map"
    assert told["missing"] == ["LowerBack", "Neck1"]


def test_the_saved_map_of_a_mirrored_rig_reads_it(place: Path) -> None:
    """One whose rest pose does not stand, so that the exchange shows in its motion alone."""
    changes = np.random.default_rng(3).standard_normal((len(JOINT_NAMES), 4), np.float32)
    made = turned_rest(walk(120), quat_normalize(changes))
    names = tuple(map(mirrored_name, JOINT_NAMES))
    write_bvh("mirrored.bvh", replace(made, skeleton=replace(made.skeleton, names=names)))
    assert "--save-map map.json" in fault("retarget", "mirrored.bvh")
    saved = run("retarget", "--rig", "mirrored.bvh", "--save-map", "map.json")
    assert saved.exit_code == 0 and "exchanges left and right" in saved.output
    assert run("retarget", "mirrored.bvh", "--source-map", "map.json", "-o", "out.bvh").exit_code == 0


def test_notes_of_a_folder_are_told_once(place: Path) -> None:
    (place / "clips").mkdir()
    text = (place / "my.bvh").read_text().splitlines()
    (place / "clips" / "hole.bvh").write_text(
        "\n".join((*text[:-1], f"nan {text[-1].split(maxsplit=1)[1]}\n"))
    )
    assert (
        run("retarget", "clips", "--rig", "my.bvh", "-o", "out").output.count("hole.bvh: read with 1 value")
        == 1
    )


def test_the_bone_map_names_what_names_say(place: Path) -> None:
    shown = run("retarget", "--rig", "my.bvh").output
    for name in ("Hips", "Spine", "Chest", "Neck", "Head", "Shoulder_L", "UpperLeg_L"):
        row = next(line for line in shown.splitlines() if f" {name} " in line)
        assert " name " in row and "100 %" in row


@pytest.mark.parametrize("changes", [{"Chest": "b7"}, {"LowerLeg_L": "b7"}, {"Toes_R": None, "Toes_L": None}])
def test_a_doubtful_bone_map_is_shown_whole(place: Path, changes: dict[str, str | None]) -> None:
    """Joints found by place or shape, and feet without toes."""
    names = {ours: changes.get(theirs, theirs) for ours, theirs in NAMES.items()}
    odd = renamed(walk(8), {ours: theirs for ours, theirs in names.items() if theirs})
    write_bvh("odd.bvh", odd)
    shown = run("retarget", "walk.bvh", "--rig", "odd.bvh", "-o", "out.bvh").output
    assert "canonical joint" in shown and "UpperLeg_L" in shown, shown


def test_other_joints_are_counted(place: Path) -> None:
    source = renamed(walk(8), NAMES)
    skeleton = source.skeleton
    turns = np.concatenate([source.local_rotations, quat_identity((8, 1))], axis=1)
    grown = Skeleton(
        (*skeleton.names, "Sword"),
        (*skeleton.parents, skeleton.index("Hand_R")),
        np.concatenate([skeleton.offsets, np.ones((1, 3), np.float32)]),
    )
    write_bvh("one.bvh", replace(source, skeleton=grown, local_rotations=turns))
    assert "1 other joint: Sword" in run("retarget", "--rig", "one.bvh").output
    assert "; 1 other joint\n" in run("retarget", "walk.bvh", "--rig", "one.bvh", "-o", "out.bvh").output


def test_a_map_that_the_user_edited_wins(place: Path) -> None:
    run("retarget", "--rig", "my.bvh", "--save-map", "rig.json")
    text = (place / "rig.json").read_text().replace('"Head": "Head"', '"Head": null')
    (place / "rig.json").write_text(text)
    result = run("retarget", "walk.bvh", "--rig", "my.bvh", "--map", "rig.json", "-o", "out.bvh")
    assert result.exit_code == 0 and "not on this rig: LowerBack, Neck1, Head" in result.output
    out = read_bvh("out.bvh")
    head = out.columns()[out.skeleton.index("Head")]
    assert np.abs(out.values[:, list(head)]).max() == 0.0


def edited(place: Path, **changes: Any) -> None:
    run("retarget", "--rig", "my.bvh", "--save-map", "rig.json")
    value = json.loads((place / "rig.json").read_text())
    value["joints"].update(changes)
    (place / "rig.json").write_text(json.dumps(value))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"Head": "Hips"}, "rig.json: Hips is given to two joints, Hips and Head"),
        ({"Tail": "Head"}, "rig.json: the rig has no joint 'Tail'"),
        (
            {"Head": "Heed"},
            "rig.json: Head is mapped to 'Heed', expected a canonical joint or null; did you mean Head?",
        ),
        ({"Foot_L": 7}, "rig.json: Foot_L is mapped to '7', expected a canonical joint or null"),
        ({"UpperLeg_L": None}, "rig.json: no joint is mapped to LeftUpLeg"),
        (
            {"LowerLeg_L": "LeftUpLeg", "UpperLeg_L": "LeftLeg"},
            "rig.json: UpperLeg_L is mapped to LeftLeg but does not hang from LowerLeg_L, which is mapped to LeftUpLeg",
        ),
    ],
)
def test_maps_that_cannot_be_used(place: Path, changes: dict[str, Any], said: str) -> None:
    edited(place, **changes)
    assert fault("retarget", "walk.bvh", "--rig", "my.bvh", "--map", "rig.json", "-o", "out.bvh") == said
    assert not (place / "out.bvh").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"joints": {"Hips": "Hips", "Hips": "Spine"}}', "rig.json: 'Hips' is named twice"),
        ("[1]", 'rig.json: expected {"joints": {"joint of the rig": "canonical joint"}}'),
        ("hello", "rig.json: not JSON (Expecting value: line 1 column 1 (char 0))"),
    ],
)
def test_files_that_are_no_maps(place: Path, text: str, said: str) -> None:
    (place / "rig.json").write_text(text)
    assert fault("retarget", "--rig", "my.bvh", "--map", "rig.json") == said


def test_rigs_that_are_refused(place: Path) -> None:
    broken = Path(__file__).resolve().parents[1] / "broken_bvh" / "two_roots.bvh"
    assert "expected 15 values in frame 0" in fault("retarget", "walk.bvh", "--rig", str(broken))
    legless = {name: new for name, new in NAMES.items() if "Leg" not in name and "Foot" not in name}
    write_bvh("legless.bvh", renamed(walk(2), {n: new for n, new in legless.items() if "Toe" not in n}))
    said = fault("synthesize", "--types", "walking:0.2", "--rig", "legless.bvh")
    assert said.startswith(
        "legless.bvh: not a known human rig: no joint found for LeftUpLeg, LeftLeg, RightUpLeg"
    )
    assert not list(place.glob("walking*"))
    assert run("convert", "walk.bvh", "walk.vrma").exit_code == 0
    assert "; the name of a file of another kind ends in .bvh" in fault("retarget", "--rig", "walk.vrma")
    assert "0.0001<=x<=10000" in run("retarget", "walk.bvh", "--scale", "1e9").output


@pytest.mark.parametrize(
    "words",
    [
        ("retarget",),
        ("retarget", "walk.bvh", "--map", "walk.bvh"),
        ("retarget", "--rig", "my.bvh", "-o", "out.bvh"),
        ("retarget", "walk.bvh", "--rig", "my.bvh", "--scale", "-1"),
        ("retarget", "walk.bvh", "--unit", "m", "--scale", "2"),
        ("retarget", ".", "--save-map", "maps.json", "-o", "elsewhere"),
        ("view", ".", "--poses", "5", "--format", "html", "-o", "elsewhere"),
        ("synthesize", "--types", "walking", "--from", "walk.bvh"),
        ("retarget", "walk.bvh", "--rig", "my.bvh", "-o", "-", "--json"),
    ],
)
def test_wrong_usage(place: Path, words: tuple[str, ...]) -> None:
    assert run(*words).exit_code == 2


def test_a_refused_rig_leaves_the_map_that_is_there(place: Path) -> None:
    motion = renamed(walk(8), NAMES)
    flat = np.linalg.norm(motion.skeleton.offsets, axis=-1)[:, None] * np.array([1.0, 0.0, 0.0], np.float32)
    still = quat_identity(motion.local_rotations.shape[:2])
    lying = replace(motion, skeleton=replace(motion.skeleton, offsets=flat), local_rotations=still)
    write_bvh("lying.bvh", lying)
    (place / "kept.json").write_text("mine")
    assert "lying.bvh" in fault("retarget", "--rig", "lying.bvh", "--save-map", "kept.json")
    assert (place / "kept.json").read_text() == "mine"


def test_inputs_are_never_overwritten(place: Path) -> None:
    for words in (("-o", "my.bvh"), ("-o", "walk.bvh"), ("-o", "x.bvh", "--save-map", "x.bvh")):
        assert "choose another output" in fault("retarget", "walk.bvh", "--rig", "my.bvh", *words)
    assert fault("synthesize", "--types", "walking:0.2", "--rig", "my.bvh", "-o", "my.bvh").startswith(
        "my.bvh: is read"
    )


def test_new_motion_on_my_rig(place: Path) -> None:
    made = run("synthesize", "--types", "walking:0.5", "--rig", "my.bvh", "--from", "my.bvh", "-o", "a.bvh")
    assert made.exit_code == 0 and "30 frames at 60 fps on my.bvh" in made.output, made.output
    followed = run("follow-path", "line", "--size", "1", "--rig", "my.bvh", "-o", "b.bvh", "--view")
    assert followed.exit_code == 0 and "on my.bvh, reached the end" in followed.output, followed.output
    assert hierarchy("a.bvh") == hierarchy("b.bvh") == hierarchy("my.bvh") and Path("b.html").exists()
    door = mk.retarget(mk.synthesize("walking:0.5"), mk.read_rig("my.bvh"))
    mk.write("door.bvh", door)
    run("synthesize", "--types", "walking:0.5", "--rig", "my.bvh", "-o", "c.bvh")
    assert Path("door.bvh").read_bytes() == Path("c.bvh").read_bytes()
    mk.write_view("door.png", door.motion, mk.read_bvh("c.bvh"))


def test_one_animation_of_the_clip_on_the_rig(place: Path) -> None:
    assert run("convert", "walk.bvh", "hero.glb").exit_code == 0
    assert run("retarget", "walk.bvh", "--rig", "hero.glb", "--name", "other", "-o", "two.glb").exit_code == 0
    words = ("retarget", "walk.bvh", "--rig", "two.glb", "-o", "out.glb", "--from")
    assert "has 2 animations, choose one" in fault(*words, "two.glb")
    assert "no animation called third" in fault(*words, "two.glb#third")
    assert run(*words, "nope.glb#other").exit_code == 2
    made = run(*words, "two.glb#other")
    assert made.exit_code == 0, made.output


def test_metrics_are_those_of_the_motion_on_the_rig(place: Path) -> None:
    """On a rig with other legs feet slide otherwise than on the canonical joints; the line says what was written."""
    offsets = canonical_skeleton().offsets.copy()
    for side in ("Left", "Right"):
        for part, share in (("Leg", 1.3), ("Foot", 0.8), ("ToeBase", 1.4)):
            offsets[JOINT_NAMES.index(f"{side}{part}")] *= share
    write_bvh("long.bvh", renamed(replace(walk(8), skeleton=canonical_skeleton(offsets)), NAMES))
    ids = ("afs", "jerk", "penetration-mean")
    for words in (("synthesize", "--types", "walking:1"), ("follow-path", "line", "--size", "1")):
        file = f"{words[0]}.bvh"
        told = json.loads(run(*words, "--rig", "long.bvh", "-o", file, "--json").stdout)
        told = told.get("motions", [told])[0]["metrics"]
        rows = json.loads(run("metrics", file, "--json").stdout)["metrics"]
        measured = {row["id"]: row["value"] for row in rows}
        assert [told[i]["value"] for i in ids] == pytest.approx([measured[i] for i in ids], rel=1e-2)


def test_the_same_retargeting_from_python(place: Path) -> None:
    run("retarget", "walk.bvh", "--rig", "my.bvh", "-o", "out.bvh")
    mk.write("door.bvh", mk.retarget("walk.bvh", "my.bvh"))
    assert Path("door.bvh").read_bytes() == Path("out.bvh").read_bytes()


def test_a_source_whose_rig_another_file_shows(place: Path) -> None:
    """A clip of rig and its own joint map: --source-rig and --source-map."""
    run("retarget", "--rig", "my.bvh", "--save-map", "rig.json")
    plain = run("retarget", "my.bvh", "-o", "a.bvh")
    mapped = run("retarget", "my.bvh", "-o", "b.bvh", "--source-rig", "my.bvh", "--source-map", "rig.json")
    assert plain.exit_code == mapped.exit_code == 0
    assert Path("a.bvh").read_bytes() == Path("b.bvh").read_bytes()
    write_bvh("other.bvh", walk(2))
    assert "has other joints than the rig other.bvh" in fault(
        "retarget", "my.bvh", "--source-rig", "other.bvh"
    )


def test_built_in_rigs_are_listed_and_found(place: Path) -> None:
    listed = run("synthesize", "--list-rigs")
    assert listed.exit_code == 0
    for name, built in BUILT_IN.items():
        count = len(mk.read_rig(f"@{name}").skeleton)
        assert f"@{name:8} {count} joints  {built.words}\n" in listed.output
    result = run("retarget", "walk.bvh", "--rig", "@unreal")
    assert result.exit_code == 0 and "on unreal.bvh, 53 joints" in result.output
    assert hierarchy("walk-on-unreal.bvh") == hierarchy(str(rig_file("@unreal")))
    wrong = run("play", "--rig", "@unreel")
    assert wrong.exit_code == 2 and "unknown rig '@unreel'; did you mean '@unreal'?" in wrong.output


@pytest.mark.parametrize(("fps", "rate"), [((), 30.0), (("--fps", "50"), 50.0)])
def test_a_built_in_rig_has_the_rate_of_its_readers(place: Path, fps: tuple[str, ...], rate: float) -> None:
    for words in (("retarget", "walk.bvh"), ("synthesize", "--types", "walking:0.5")):
        assert run(*words, *fps, "--rig", "@lafan1", "-o", "out.bvh").exit_code == 0
        assert read_bvh("out.bvh").fps == pytest.approx(rate, rel=1e-4)
    back = run("retarget", "out.bvh", "--source-rig", "@lafan1", "-o", "back.bvh")
    assert back.exit_code == 0, back.output


WRITING = pytest.mark.parametrize(
    "words",
    [
        ("retarget", "walk.bvh", "--rig", "@mixamo", "-o"),
        ("synthesize", "--types", "walking:0.5", "-o"),
        ("synthesize", "--types", "walking:0.5", "--rig", "my.bvh", "-o"),
        ("synthesize", "--types", "walking:0.5", "--root", "ground", "-o"),
        ("convert", "walk.bvh"),
    ],
)


@WRITING
@pytest.mark.parametrize("pose", ["tpose", "apose"])
def test_a_rest_pose_that_is_asked_for_is_written(place: Path, words: tuple[str, ...], pose: str) -> None:
    """With other offsets, the joints are where they are without it."""
    for file, more in (("plain.bvh", ()), ("rest.bvh", ("--rest", pose))):
        result = run(*words, file, *more)
        assert result.exit_code == 0, result.output
    plain, rest = (bvh_to_motion(read_bvh(file)) for file in ("plain.bvh", "rest.bvh"))
    assert np.abs(motion_kinematics(plain)[1] - motion_kinematics(rest)[1]).max() < 1e-2
    low = rest.skeleton.offsets[mk.read_rig("rest.bvh").place("LeftForeArm")]
    assert normalized(low)[1] == pytest.approx({"tpose": 0.0, "apose": -(0.5**0.5)}[pose], abs=1e-3)


@WRITING
def test_a_rest_frame_is_one_frame_more(place: Path, words: tuple[str, ...]) -> None:
    """The first frame has no rotations; the others are as without it."""
    for file, more in (("plain.bvh", ()), ("rest.bvh", ("--rest-frame",))):
        result = run(*words, file, *more)
        assert result.exit_code == 0, result.output
    plain, rest = read_bvh("plain.bvh"), read_bvh("rest.bvh")
    assert hierarchy("plain.bvh") == hierarchy("rest.bvh")
    turns = [j for j, name in enumerate(name for names in rest.channels for name in names) if "rot" in name]
    assert np.abs(rest.values[0, turns]).max() == 0.0
    apart = (rest.values[1:] - plain.values)[:, turns]
    assert np.abs(apart - 360.0 * np.round(apart / 360.0)).max() < 1e-3
