"""Written files in the programs that read them: glTF validator, pygltflib, USD, pandas, Blender, three.js.

Each program is optional (tests/export/js/README.md; MOTIONKIT_BPY is a Python that has bpy).
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.export.clip import Clip, rig_clip
from motionkit.export.figure import make_figure
from motionkit.export.formats import read_motion, write_motion
from motionkit.export.glb import add_figure
from motionkit.export.vrma import BONES, humanoid_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.reading import reading
from motionkit.rig.gltf import GltfDocument
from motionkit.rig.on_rig import read_rig
from motionkit.view.surface import REGIONS
from synthetic_motions import make_cartwheel, make_walk
from view.conftest import browser, open_page  # noqa: F401

pytestmark = pytest.mark.formats

HERE = Path(__file__).parent
JS = HERE / "js"
JOINT, SECONDS = "LeftHand", 0.75


def lacking(what: str) -> NoReturn:
    """Skip, or fail where these checks must run."""
    if os.environ.get("MOTIONKIT_FORMATS_TESTS") == "required":
        pytest.fail(f"{what}, and MOTIONKIT_FORMATS_TESTS=required")
    pytest.skip(what)


def module(name: str, package: str) -> ModuleType:
    """A package of the extra formats."""
    try:
        return import_module(name)
    except ImportError:
        lacking(f"{package} is not installed; pip install 'motionkit[formats]'")


@pytest.fixture(scope="module")
def motion() -> Motion:
    """A cartwheel, which turns the body over."""
    return make_cartwheel(90)


@pytest.fixture(scope="module")
def place(motion: Motion) -> Array:
    """Where JOINT is at SECONDS, m."""
    return motion_kinematics(motion)[1][round(SECONDS * motion.fps), JOINT_NAMES.index(JOINT)] / 100.0


@pytest.fixture(scope="module")
def files(motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the cartwheel in every format."""
    folder = tmp_path_factory.mktemp("formats")
    for ending in ("bvh", "glb", "vrma", "usda", "npz", "csv"):
        write_motion(folder / f"a.{ending}", Clip(motion, "cartwheel", [("cartwheel", 1.5)]))
    return folder


def write_avatar(path: Path, motion: Motion) -> None:
    """A VRM 1.0 avatar: the body of a motion in its T-pose."""
    person = humanoid_motion(motion)
    still = Motion(
        person.skeleton, quat_identity((1, len(person.skeleton))), np.zeros((1, 3), np.float32), 60.0
    )
    document = GltfDocument()
    joints = add_figure(document, make_figure(still), "avatar")
    bones = {BONES[name]: {"node": joints[i]} for i, name in enumerate(person.skeleton.names)}
    meta = {"name": "test", "authors": ["motionkit"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    vrm = {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": bones}}
    document.json |= {"extensionsUsed": ["VRMC_vrm"], "extensions": {"VRMC_vrm": vrm}}
    document.write(path)


# ---- Python packages ----


def test_pygltflib_reads_the_skin_and_the_animation(files: Path, motion: Motion) -> None:
    gltf = module("pygltflib", "pygltflib").GLTF2().load(str(files / "a.glb"))
    assert len(gltf.skins[0].joints) == len(motion.skeleton) and len(gltf.animations[0].channels) == 24
    times = gltf.accessors[gltf.animations[0].samplers[0].input]
    assert times.count == len(motion) and times.max[0] == pytest.approx((len(motion) - 1) / 60)


def test_usd_moves_the_joints(files: Path, place: Array, motion: Motion) -> None:
    module("pxr.Usd", "usd-core")
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(files / "a.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0 and UsdGeom.GetStageUpAxis(stage) == "Y"
    assert stage.GetEndTimeCode() == len(motion) - 1 and stage.GetTimeCodesPerSecond() == 60
    cache, root = UsdSkel.Cache(), UsdSkel.Root(stage.GetPrimAtPath("/Motion"))
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Motion/Skeleton")))
    assert query.HasBindPose() and query.HasRestPose()
    joint = [str(path).rsplit("/", 1)[-1] for path in query.GetJointOrder()].index(JOINT)
    found = query.ComputeJointSkelTransforms(SECONDS * 60)[joint].ExtractTranslation()
    assert list(found) == pytest.approx(place, abs=1e-4)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    assert [str(target.GetPrim().GetPath()) for target in binding.GetSkinningTargets()] == ["/Motion/Body"]


def test_pandas_reads_the_table(files: Path, place: Array, motion: Motion) -> None:
    table = module("pandas", "pandas").read_csv(files / "a.csv")
    assert len(table) == len(motion) and set(table["type"]) == {"cartwheel"}
    row = table[table["frame"] == round(SECONDS * 60)]
    found = row[[f"{JOINT}_x", f"{JOINT}_y", f"{JOINT}_z"]].to_numpy()[0] / 100.0
    assert found == pytest.approx(place, abs=1e-4)


# ---- Node ----


@pytest.fixture(scope="module")
def node() -> str:
    """Node, with the packages of tests/export/js installed and built."""
    path = shutil.which("node")
    if path is None or not (JS / "node_modules" / "gltf-validator").is_dir() or not (JS / "build").is_dir():
        lacking("Node or its packages are missing: npm ci && npm run build in tests/export/js")
    return path


def test_the_khronos_validator_finds_nothing(
    files: Path, node: str, make_motion: Callable[..., Motion], tmp_path: Path
) -> None:
    from motionkit.editing.root_motion import with_ground_root

    write_motion(tmp_path / "root.glb", with_ground_root(make_walk(60)))
    write_motion(tmp_path / "one.glb", make_walk(60).cut(0, 1))
    write_avatar(tmp_path / "avatar.vrm", make_walk(2))
    for source, target in (("avatar.vrm", "hero.vrm"), ("avatar.vrm", "hero.glb"), ("hero.glb", "twice.glb")):
        rig = read_rig(tmp_path / source)
        write_motion(tmp_path / target, rig_clip(on_rig(make_walk(60), rig), rig, "walk"))
    paths = [files / "a.glb", files / "a.vrma", *sorted(tmp_path.iterdir())]
    done = subprocess.run(
        [node, "validate.mjs", *map(str, paths)], cwd=JS, capture_output=True, text=True, timeout=60
    )
    reports = json.loads(done.stdout)
    assert len(reports) == 8
    for report in reports:
        assert (report["errors"], report["warnings"]) == (0, 0), report
        told = {message["code"] for message in report["messages"]}
        assert told <= {"UNSUPPORTED_EXTENSION", "NODE_EMPTY"}, report


def text_of(path: Path) -> str:
    """A file in base64."""
    return base64.b64encode(path.read_bytes()).decode()


@pytest.fixture(scope="module")
def page(node: str, open_page: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:  # noqa: F811
    """A page in Chromium with three.js and the VRM loaders."""
    file = tmp_path_factory.mktemp("page") / "page.html"
    script = (JS / "build" / "page.js").read_text("utf-8").replace("</script", "<\\/script")
    end = "<script>document.documentElement.dataset.ready = 1</script>"
    file.write_text(
        f"<!doctype html><html><body style='margin:0'><script>{script}</script>{end}</body></html>"
    )
    return open_page(file.as_uri())


def test_three_js_plays_a_glb(page: Any, files: Path, place: Array, motion: Motion) -> None:
    found = page.evaluate("(file) => checks.open(file)", text_of(files / "a.glb"))
    assert found["bones"] == len(motion.skeleton) and found["skinned"] == len(REGIONS)
    assert found["duration"] == pytest.approx((len(motion) - 1) / 60, abs=1e-4)
    (at,) = page.evaluate("([time, names]) => checks.places(time, names)", [SECONDS, [JOINT]])
    assert at == pytest.approx(place, abs=1e-3)


def test_three_js_moves_the_users_own_mesh(page: Any, tmp_path: Path) -> None:
    """The skin is that of the source, and its bones go where the motion on the rig has them."""
    write_avatar(tmp_path / "hero.vrm", make_walk(2))
    rig = read_rig(tmp_path / "hero.vrm")
    made = on_rig(make_walk(120), rig)
    write_motion(tmp_path / "out.glb", rig_clip(made, rig, "walk"))
    found = page.evaluate("(file) => checks.open(file)", text_of(tmp_path / "out.glb"))
    assert found["skinned"] == len(REGIONS) and found["duration"] == pytest.approx(119 / 60, abs=1e-4)
    names = ["LeftToeBase", "RightHand"]
    wanted = motion_kinematics(made)[1][:, [rig.skeleton.names.index(name) for name in names]]
    for frame in (0, 30, 77):
        places = page.evaluate("([time, names]) => checks.places(time, names)", [frame / 60, names])
        assert np.array(places) == pytest.approx(wanted[frame], abs=1e-3)


def test_a_vrm_animation_moves_an_avatar_of_another_size(
    page: Any, files: Path, tmp_path: Path, motion: Motion
) -> None:
    person = humanoid_motion(motion)
    write_avatar(tmp_path / "avatar.vrm", make_walk(2).scaled(1.2))
    page.evaluate(
        "([file, avatar]) => checks.open(file, avatar)",
        [text_of(files / "a.vrma"), text_of(tmp_path / "avatar.vrm")],
    )
    truth = motion_kinematics(person)[1] * 1.2
    bones = [BONES[name] for name in person.skeleton.names]
    for seconds in (0.0, SECONDS, 1.25):
        places = np.array(page.evaluate("([time, names]) => checks.places(time, names)", [seconds, bones]))
        wanted = truth[round(seconds * 60)]
        assert np.abs((places - places[0]) - (wanted - wanted[0])).max() < 0.02, seconds
        share = places[0, 1] / wanted[0, 1]  # its soles give the height of its hips, by which it travels
        assert 0.95 < share < 1.05 and places[0] == pytest.approx(share * wanted[0], abs=0.01)


# ---- Blender ----


def blender(*words: object, seconds: float = 170.0) -> str:
    """The output of a script that a Python with bpy runs for at most so many seconds."""
    python = os.environ.get("MOTIONKIT_BPY")
    if not python:
        lacking("MOTIONKIT_BPY names no Python that has bpy")
    done = subprocess.run([python, *map(str, words)], capture_output=True, text=True, timeout=seconds)
    # The result is the last that a script does; Blender 4.2 as a module crashes after it, as Python ends.
    assert "\nRESULT " in f"\n{done.stdout}", done.stderr + done.stdout
    return done.stdout


def test_blender_imports_bones_frames_and_places(files: Path, place: Array, motion: Motion) -> None:
    paths = [files / f"a.{ending}" for ending in ("bvh", "glb", "usda")]
    lines = blender(HERE / "blender_check.py", JOINT, SECONDS, *paths).splitlines()
    found = json.loads(next(line for line in lines if line.startswith("RESULT "))[7:])
    assert len(found) == 3
    for one in found:
        assert (one["bones"], one["frames"]) == (len(motion.skeleton), len(motion)), one
        assert one["place"] == pytest.approx(place, abs=2e-3), one
        assert one["skinned"] == (0 if one["file"].endswith(".bvh") else 1), one


def test_fbx_through_blender(
    place: Array, motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """motionkit's FBX is the motion to a program that reads it, and to motionkit."""
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    started = (
        tmp_path / "blender"
    )  # which is called with --background --factory-startup --python SCRIPT -- ...
    started.write_text(f'#!/bin/sh\nshift 3\nexec {os.environ.get("MOTIONKIT_BPY")} "$@"\n')
    started.chmod(0o755)
    blender("-c", "import bpy; print('RESULT ')")
    write_motion(tmp_path / "a.fbx", motion)
    lines = blender(HERE / "blender_check.py", JOINT, SECONDS, tmp_path / "a.fbx").splitlines()
    (found,) = json.loads(next(line for line in lines if line.startswith("RESULT "))[7:])
    assert (found["bones"], found["frames"]) == (len(motion.skeleton), len(motion))
    assert found["place"] == pytest.approx(place, abs=5e-3)
    with reading(on_note=lambda note: None):
        again = read_motion(tmp_path / "a.fbx")
    index = [again.skeleton.index(name) for name in motion.skeleton.names]
    assert again.fps == motion.fps
    assert np.abs(motion_kinematics(again)[1][:, index] - motion_kinematics(motion)[1]).max() < 0.01


ADD_ON = HERE.parents[1] / "integrations" / "blender" / "motionkit_blender.py"
SAMPLE = HERE.parents[1] / "examples" / "data" / "16_45.bvh"


@pytest.fixture
def command(tmp_path: Path) -> Path:
    """This motionkit as a command."""
    path = tmp_path / "motionkit"
    path.write_text(
        f'#!/bin/sh\nPYTHONPATH={HERE.parents[1] / "src"} exec {sys.executable} -m motionkit "$@"\n'
    )
    path.chmod(0o755)
    return path


def test_the_blender_add_on(command: Path) -> None:
    """As the panel does: a new body, motion on a rig of another shape, along a curve, a frame of the socket."""
    lines = blender(HERE / "addon_check.py", ADD_ON, command, SAMPLE).splitlines()
    found = json.loads(next(line for line in lines if line.startswith("RESULT "))[7:])
    assert found["new body"]["bones"] == 23 and found["new body"]["frames"] == 24
    assert found["own rig"]["bones"] == 31 and 0.8 < found["own rig"]["way"] < 2.0
    assert found["curve"]["frames"] > 120 and found["curve"]["way"] < 1.0
    assert found["live"] < 1e-3
    assert "unknown motion type 'flying'" in found["fault"]


def test_the_blender_add_on_works_in_the_armatures_own_space(
    files: Path, command: Path, tmp_path: Path
) -> None:
    """On armatures as importers make them, as they are, and moved, turned, laid down and scaled by 1.2."""
    words = (HERE / "addon_rigs_check.py", ADD_ON, command, SAMPLE, files / "a.glb", tmp_path)
    lines = blender(*words, seconds=600.0).splitlines()
    found = json.loads(next(line for line in lines if line.startswith("RESULT "))[7:])
    for walks in found["walks"].values():
        rest, (heads, again) = np.array(walks[0]["rest"]), np.array([walk["heads"] for walk in walks])
        assert len(heads) == 60 and again == pytest.approx(heads, abs=1e-5)
        assert heads[0, 0, :2] == pytest.approx(rest[0, :2], abs=1e-4)  # the hips, where they were
        assert heads[-1, 0, 1] - heads[0, 0, 1] < -2.0 and np.abs(heads[:, 0, 0]).max() < 0.2  # ahead
        assert 0.02 < heads[:, 1:3, 2].min() < 0.05  # joints of toes, m
    truth = subprocess.run(
        [
            command,
            "synthesize",
            "--types",
            "walking:2",
            "--rig",
            SAMPLE,
            "--fps",
            "30",
            "-o",
            tmp_path / "a.npz",
        ],
        capture_output=True,
    )
    assert truth.returncode == 0
    with np.load(tmp_path / "a.npz") as made:
        names = [*made["joints"]]
        told = ("Hips", "LeftToeBase", "RightToeBase", "Head", "LeftHand")
        places = made["positions"][:, [names.index(name) for name in told]] / 100.0
    places = np.stack([places[..., 0], -places[..., 2], places[..., 1]], -1)
    off = np.array(found["walks"]["bvh"][0]["heads"]) - places
    assert np.abs(off[..., 2]).max() < 0.01 and np.abs(off[..., :2] - off[0, 0, :2]).max() < 1e-3
    clip, first, second = np.array(found["beginnings"])
    assert first[0, :2] == pytest.approx(clip[0, :2], abs=1e-4) and second == pytest.approx(first, abs=1e-4)
    for fault, words in zip(
        found["faults"],
        (
            "unknown motion type",
            "'--model'",
            "timeline marker",
            "No closing quotation",
            "is not motionkit",
            "scale of zero",
            "LeftUpLeg",
        ),
        strict=True,
    ):
        assert words in fault and str(Path(tempfile.gettempdir(), "tmp")) not in fault
    hips = np.array(found["curve"])[:, 0]
    assert np.hypot(hips[:, 0] - 1.0, hips[:, 1] - 2.0) == pytest.approx(2.0, abs=0.05)
    assert np.linalg.norm(np.diff(hips[:, :2], axis=0), axis=1).mean() * 30 == pytest.approx(1.2, abs=0.1)
    assert found["marker"] < 0.1
    first, last = np.array(found["loop"])
    assert last == pytest.approx(first, abs=0.05)
    soles = np.abs(found["soles"])  # between two steps both may leave the floor for a moment
    assert np.quantile(soles, 0.9) < 0.01 and soles.max() < 0.03
    carried = np.array(found["connected"])
    assert carried[-1, 0, 1] - carried[0, 0, 1] < -2.0 and 0.02 < carried[:, 1:, 2].min() < 0.05
    assert found["new body"] == [101.0, 160.0, 160.0]
