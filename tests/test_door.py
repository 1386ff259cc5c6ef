"""`import motionkit as mk`: lazy, typed, and the same defaults as the commands."""

from __future__ import annotations

import ast
import inspect
import os
import subprocess
import sys
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import click
import numpy as np
import pytest

import motionkit as mk
from motionkit import api, requests
from motionkit.cli.main import COMMANDS, cli
from motionkit.control.synthesize import SynthesisOptions

SOURCE = Path(mk.__file__)
CLIP = SOURCE.parents[2] / "examples" / "data" / "16_45.bvh"

SCRIPT = """
import motionkit as mk

model: mk.MotionModel = mk.load_model()
made = mk.synthesize("running:4,cartwheel:3", model=model, seed=1)
motion: mk.Motion = made.motion
mk.write_bvh("out.bvh", motion)
followed: mk.Motion = mk.follow_path("circle", size=2.0).motion
encoded = mk.encode(mk.read_canonical("out.bvh"))
back: mk.Motion = mk.decode(encoded.features, motion.skeleton, motion.fps)
sliding: float | None = mk.measure("out.bvh").value("afs")
mk.write_view("out.html", motion, back)
mk.preprocess(["data"], "dataset")
mk.train("dataset", "model.safetensors", mk.train_options("tiny", steps=2))
"""


def modules_after(code: str) -> set[str]:
    """The modules a new Python has loaded after some code."""
    command = [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return set(done.stdout.split())


def test_the_door_alone_imports_nothing_heavy() -> None:
    loaded = modules_after("import motionkit as mk; dir(mk); mk.__version__")
    assert not loaded & {"numpy", "torch", "click", "rich", "bvhio", "safetensors", "motionkit.api"}


def test_synthesizing_imports_no_torch() -> None:
    loaded = modules_after("import motionkit as mk; mk.synthesize('running:0.1'); mk.kinematics, mk.encode")
    assert "torch" not in loaded and "motionkit.api" in loaded


def test_every_public_name_is_there_and_typed() -> None:
    typed = {
        name.asname or name.name
        for block in ast.parse(SOURCE.read_text("utf-8")).body
        if isinstance(block, ast.If)
        for line in block.body
        if isinstance(line, ast.ImportFrom)
        for name in line.names
    }
    assert typed == set(mk.__all__) - {"__version__"}
    for name in mk.__all__:
        assert getattr(mk, name) is not None and name in dir(mk)
    with pytest.raises(AttributeError, match="has no attribute 'synthesise'"):
        mk.synthesise  # type: ignore[attr-defined]  # noqa: B018


def test_no_public_name_is_that_of_a_room() -> None:
    """Python binds motionkit.metrics to the room as soon as anything imports it."""
    rooms = {path.stem for path in SOURCE.parent.iterdir() if (path / "__init__.py").exists()}
    assert not rooms & set(mk.__all__)
    assert not any(isinstance(getattr(mk, name), ModuleType) for name in mk.__all__)


def test_public_functions_say_what_they_do() -> None:
    for name in mk.__all__:
        value = getattr(mk, name)
        if inspect.isfunction(value):
            assert value.__doc__, name
            assert "return" in value.__annotations__, name


@pytest.mark.skipif(find_spec("mypy") is None, reason="mypy is not installed")
def test_mypy_sees_the_types(tmp_path: Path) -> None:
    right, wrong = tmp_path / "right.py", tmp_path / "wrong.py"
    right.write_text(SCRIPT)
    wrong.write_text("import motionkit as mk\nmk.synthesize(seeds=1)\nnumber: int = mk.load_model()\n")
    # Without the packages of this environment, which take ten times as long to check as motionkit's own files.
    words = ["--strict", "--config-file=", "--cache-dir", str(tmp_path / "cache"), "--no-site-packages"]
    words += ["--ignore-missing-imports", "--follow-imports=silent", str(right), str(wrong)]
    source = {"MYPYPATH": str(SOURCE.parents[1])}
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *words], capture_output=True, text=True, env=os.environ | source
    )
    assert "seeds" in done.stdout and "MotionModel" in done.stdout, done.stdout
    assert "2 errors in 1 file (checked 2 source files)" in done.stdout, done.stdout
    assert (SOURCE.parent / "py.typed").is_file()


# Options that belong to the terminal, and arguments that are named otherwise in Python.
ONLY_COMMAND = {
    "in_place",  # functions of their own: mk.in_place, mk.with_ground_root, mk.make_loop
    "root",
    "rest",
    "rest_frame",
    "loops",
    "keys_file",  # keys in Python
    "output",
    "list_types",
    "view",
    "as_json",
    "help",
    "temperature",
    "noise",
    "model_path",
    "path",
    "rig_path",
    "map_path",
    "clip_path",
    "name",  # of the animation: fields of the clip that mk.retarget returns
    "alone",
}


@pytest.mark.parametrize("words", [("synthesize", "--types", "running"), ("follow-path", "line")])
def test_defaults_are_those_of_the_command(words: tuple[str, ...]) -> None:
    name, *arguments = words
    command = cli.get_command(click.Context(cli), name)
    assert command is not None and name in COMMANDS
    request, words = {
        "synthesize": (requests.synthesis_request, requests.SynthesisWords),
        "follow-path": (requests.path_request, requests.PathWords),
    }[name]
    defaults = {key: parameter.default for key, parameter in inspect.signature(request).parameters.items()}
    defaults |= {field.name: field.default for field in fields(SynthesisOptions)}
    assert words.__annotations__.keys() <= defaults.keys(), "a keyword that is typed is not taken"
    for option, value in command.make_context(name, arguments).params.items():
        if option not in ONLY_COMMAND:
            assert option == "types" or option in words.__annotations__, option
            assert option == "types" or defaults[option] == value, option
    assert (mk.Noise().kind, mk.Noise().temperature) == ("correlated", 0.05)


def test_the_same_file_as_from_the_command_line(tmp_path: Path) -> None:
    types = "running:0.5,cartwheel:0.5"
    mk.write_bvh(tmp_path / "door.bvh", mk.synthesize(types, seed=3).motion)
    command = [sys.executable, "-m", "motionkit", "synthesize", "--types", types, "--seed", "3"]
    subprocess.run([*command, "-o", tmp_path / "command.bvh"], check=True, capture_output=True)
    assert (tmp_path / "door.bvh").read_bytes() == (tmp_path / "command.bvh").read_bytes()

    mk.write_bvh(tmp_path / "door.bvh", mk.follow_path("line", size=1.0).motion)
    command = [sys.executable, "-m", "motionkit", "follow-path", "line", "--size", "1"]
    subprocess.run([*command, "-o", tmp_path / "command.bvh"], check=True, capture_output=True)
    assert (tmp_path / "door.bvh").read_bytes() == (tmp_path / "command.bvh").read_bytes()


def test_a_loop_is_that_of_the_command(tmp_path: Path) -> None:
    made, (cycle,) = api.loop("walking", seconds=1.0, seed=2)
    assert made.motion is cycle.motion and 0.5 < cycle.seconds < 1.5
    mk.write_bvh(tmp_path / "door.bvh", made.motion)
    command = [sys.executable, "-m", "motionkit", "synthesize", "--types", "walking", "--loop"]
    command += ["--seconds", "1", "--seed", "2", "-o", tmp_path / "command.bvh"]
    subprocess.run(command, check=True, capture_output=True)
    assert (tmp_path / "door.bvh").read_bytes() == (tmp_path / "command.bvh").read_bytes()
    assert len(made.motions[0].contacts) == len(made.motion)
    mk.write(tmp_path / "rig.bvh", mk.retarget(made, "@mixamo"))
    subprocess.run(
        [*command[:-1], tmp_path / "there.bvh", "--rig", "@mixamo"], check=True, capture_output=True
    )
    assert (tmp_path / "rig.bvh").read_bytes() == (tmp_path / "there.bvh").read_bytes()
    with pytest.raises(mk.MotionkitError, match="a loop takes one motion type"):
        api.loop("walking,running", seconds=1.0)
    for seconds in (-3.0, 0.0, float("inf"), float("nan")):
        with pytest.raises(mk.MotionkitError, match=r"expected a loop of 0\.1 to 3600 s"):
            api.loop("walking", seconds=seconds)
        with pytest.raises(mk.MotionkitError, match=r"expected a loop of 0\.1 to 3600 s"):
            mk.make_loop(made.motion, seconds)


def test_a_built_in_rig_has_its_rate_and_size(tmp_path: Path) -> None:
    """As on the command line, where a path lies in the world of the rig, and numbers may be those of numpy."""
    common = ["--rig", "@lafan1", "--seed", "5"]
    for arguments in (["synthesize", "--types", "walking:1"], ["follow-path", "line", "--size", "2"]):
        command = [
            sys.executable,
            "-m",
            "motionkit",
            *arguments,
            *common,
            "-o",
            tmp_path / f"{arguments[0]}.bvh",
        ]
        subprocess.run(command, check=True, capture_output=True)
    seed, rig, model = np.int64(5), mk.read_rig("@lafan1"), mk.load_model()
    made = mk.retarget(mk.synthesize("walking:1", seed=seed), rig)
    assert made.motion.fps == mk.read_bvh(tmp_path / "synthesize.bvh").fps == 30.0
    assert len(made.motion) == len(mk.read_bvh(tmp_path / "synthesize.bvh"))
    assert mk.retarget(mk.synthesize("walking:1"), rig, fps=50.0).motion.fps == 50.0
    path = mk.shape_path("line", 2.0, ["walking"], None).scaled(1.0 / rig.size(model.character("default")))
    walk = mk.retarget(mk.follow_path(path, seed=seed), rig).motion
    assert len(walk) == len(mk.read_bvh(tmp_path / "follow-path.bvh"))


def test_results_are_written_and_shown_as_they_are(tmp_path: Path) -> None:
    made = mk.synthesize("walking:0.5")
    mk.write(tmp_path / "result.bvh", made)
    mk.write(tmp_path / "motion.bvh", made.motion)
    assert (tmp_path / "result.bvh").read_bytes() == (tmp_path / "motion.bvh").read_bytes()
    mk.write_view(tmp_path / "result.html", made)
    with pytest.raises(mk.MotionkitError, match="expected a Motion, or a result that has one"):
        mk.write(tmp_path / "none.bvh", "walking")


def test_a_crowd_and_a_path_file(tmp_path: Path) -> None:
    model = mk.load_model()
    crowd = mk.synthesize(["walking:0.2", "idle:0.3"], model=model)
    assert [len(one.motion) for one in crowd.motions] == [12, 18]
    (tmp_path / "way.csv").write_text("x,z,type\n0,0,walking\n0,0.5,walking\n")
    two = mk.synthesize("idle:0.2", model=model, character="default,subject-16")
    assert len(two.motions) == 2, "one for each body"
    assert mk.follow_path(tmp_path / "way.csv", model=model).finished
    with pytest.raises(mk.MotionkitError, match="unknown path shape 'oval'"):
        mk.follow_path("oval", model=model)


def test_features_there_and_back() -> None:
    motion = mk.read_canonical(CLIP)
    encoded = mk.encode(motion)
    back = mk.decode(encoded.features, motion.skeleton, motion.fps, encoded.ground[0])
    assert np.abs(mk.kinematics(back)[1] - mk.kinematics(motion)[1]).max() < 0.01
    assert len(mk.read_bvh(CLIP).skeleton) > len(motion.skeleton) == 23


def test_measuring_files_and_motions(tmp_path: Path) -> None:
    report = mk.measure(CLIP)
    assert report.value("afs") == mk.measure(mk.read_canonical(CLIP)).value("afs")
    same = mk.measure(CLIP, CLIP)
    assert same.value("mpjpe") == 0.0 and len(same.read_as) == 2 and "units" in same.read_as[0]


def test_a_model_file_is_opened_and_what_it_makes_is_measured(tmp_path: Path) -> None:
    model = mk.load_model()
    mk.models.checkpoint.save_model(tmp_path / "mine.safetensors", model)
    made, same = (mk.synthesize("walking:1", model=each) for each in (tmp_path / "mine.safetensors", model))
    assert np.array_equal(made.motion.local_rotations, same.motion.local_rotations)
    assert mk.measure(made, same.motion).value("mpjpe") == 0.0
    with pytest.raises(mk.MotionkitError, match="expected a frame rate above 0, found 0"):
        mk.retarget(made.motion, "@mixamo", fps=0)
    with pytest.raises(mk.MotionkitError, match="expected a temperature from 0 to 2, found -1"):
        mk.Noise(temperature=-1.0)


def test_views(tmp_path: Path) -> None:
    motion = mk.read_bvh(CLIP).cut(0, 10)
    for ending in ("html", "png", "gif"):
        mk.write_view(tmp_path / f"clip.{ending}", motion, motion, width=600 if ending == "png" else 160)
        assert (tmp_path / f"clip.{ending}").stat().st_size > 100
    with pytest.raises(mk.MotionkitError, match=r"ends with \.html"):
        mk.write_view(tmp_path / "clip.avi", motion)


def test_training_without_torch_says_what_to_install() -> None:
    code = (
        "import sys; sys.modules['torch'] = None\nimport motionkit as mk\n"
        "for ask in (lambda: mk.train_options, lambda: mk.train('dataset')):\n"
        "    try: ask()\n"
        "    except mk.MotionkitError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == 2 * "training needs torch: pip install 'motionkit[train]'\n", done.stderr


@pytest.mark.parametrize(
    ("types", "options", "said"),
    [
        ([], {}, "expected at least one motion type"),
        ("walking", {"seconds": float("nan")}, "expected a length above 0 s, found nan"),
        ("walking", {"noise": "mean"}, "expected noise such as mk.Noise"),
        (
            ["walking", "idle", "running"],
            {"count": 2},
            "expected a count of 3 or more, one for each list of types",
        ),
        ("walking", {"keys": [{"time": 1}]}, "expected a Key, found"),
    ],
)
def test_wishes_that_make_no_sense_are_one_line(types: object, options: dict, said: str) -> None:
    with pytest.raises(mk.MotionkitError, match=said):
        mk.synthesize(types, **options)
