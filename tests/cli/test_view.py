"""The view command."""

from __future__ import annotations

import base64
import json
import signal
import sys
from pathlib import Path

import pytest

from motionkit.cli.showing import open_in_browser
from motionkit.errors import MotionkitError
from motionkit.export.formats import write_motion
from rig.test_gltf_rig import character
from synthetic_characters import CHARACTERS, skinned
from synthetic_motions import make_walk

from .test_mirror import RIG, run


def test_a_sheet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    clip, sheet = tmp_path / "clip.bvh", tmp_path / "sheet.png"
    clip.write_text(RIG)
    assert run(monkeypatch, "view", clip, clip, "-o", sheet, "--poses", 2, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["output"] == str(sheet)
    assert [c["frames"] for c in result["clips"]] == [2, 2]
    assert sheet.read_bytes().startswith(b"\x89PNG")


def test_a_glb_is_shown_as_the_clip_it_was_made_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_motion("walk.bvh", make_walk(40))
    write_motion("walk.glb", make_walk(40))
    assert run(monkeypatch, "view", "walk.bvh", "walk.glb", "-o", "sheet.png", "--json") == 0
    first, second = json.loads(capsys.readouterr().out)["clips"]
    assert (first["frames"], first["fps"]) == (second["frames"], second["fps"]) == (40, 60.0)
    Path("cut.glb").write_bytes(Path("walk.glb").read_bytes()[:500])
    assert run(monkeypatch, "view", "cut.glb", "-o", "cut.png") == 1
    assert "cut.glb" in capsys.readouterr().err and not Path("cut.png").exists()


def test_a_page_is_the_default_and_never_overwrites(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("motionkit.cli.showing.has_desktop", lambda: True)
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG)
    assert run(monkeypatch, "view", clip) == 0
    assert opened == [(tmp_path / "clip.html").as_uri()]
    assert run(monkeypatch, "view", clip, "--no-open") == 0
    assert run(monkeypatch, "view", clip, "--json") == 0
    assert len(opened) == 1 and sorted(path.name for path in tmp_path.glob("*.html")) == [
        "clip-2.html",
        "clip-3.html",
        "clip.html",
    ]
    assert '"name":"clip"' in (tmp_path / "clip.html").read_text("utf-8")


def test_nothing_is_opened_without_a_desktop(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("webbrowser.open", lambda address: pytest.fail("opened"))
    monkeypatch.setenv("CI", "true")
    monkeypatch.setenv("DISPLAY", ":0")
    assert not open_in_browser((tmp_path / "page.html").as_uri())
    monkeypatch.delenv("CI")
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert not open_in_browser((tmp_path / "page.html").as_uri())


def test_a_path_is_put_into_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip, path, page = (tmp_path / name for name in ("clip.bvh", "path.json", "page.html"))
    clip.write_text(RIG)
    path.write_text('{"parts": [{"type": "walking", "points": [[0, 0], [0, 2]]}]}')
    assert run(monkeypatch, "view", clip, "--path", path, "-o", page, "--no-open") == 0
    assert '"path":{"type":"f4","shape":[101,2]' in page.read_text("utf-8")


@pytest.mark.parametrize(
    ("option", "name"), [("--poses", "page.html"), ("--width", "page.html"), ("--every", "a.gif")]
)
def test_options_of_another_kind_of_file(
    option: str,
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG)
    assert run(monkeypatch, "view", clip, option, 200, "-o", tmp_path / name) == 2
    assert option in capsys.readouterr().err and not (tmp_path / name).exists()


def test_other_endings_are_wrong_usage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG)
    assert run(monkeypatch, "view", clip, "-o", tmp_path / "sheet.jpg") == 2
    assert ".html, .png, .gif, .mp4" in capsys.readouterr().err


def test_a_broken_clip_leaves_no_sheet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG.replace("Frames: 2", "Frames: 3"))
    assert run(monkeypatch, "view", clip, "--strict", "-o", tmp_path / "sheet.png") == 1
    clip.write_text(RIG.replace("Frames: 2", "Frames: two"))
    assert run(monkeypatch, "view", clip, "-o", tmp_path / "sheet.png") == 1
    assert "clip.bvh" in capsys.readouterr().err
    assert not (tmp_path / "sheet.png").exists()


def test_without_pillow_one_line_tells_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "clip.bvh"
    clip.write_text(RIG)
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert run(monkeypatch, "view", clip, "-o", tmp_path / "sheet.png") == 1
    err = capsys.readouterr().err.strip()
    assert err.count("\n") == 0 and 'pip install "motionkit[view]"' in err


def bvh(names: list[str], frames: int, offset: str = "0 10 0") -> str:
    """A rig whose other joints all hang from the first one."""
    joints = "".join(
        f"JOINT {name}\n{{\nOFFSET {offset}\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n"
        f"{{\nOFFSET {offset}\n}}\n}}\n"
        for name in names[1:]
    )
    channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    row = " ".join(["0", "90", "0", *["0"] * (3 * len(names))])
    motion = f"MOTION\nFrames: {frames}\nFrame Time: 0.05\n" + f"{row}\n" * frames
    return f"HIERARCHY\nROOT {names[0]}\n{{\nOFFSET 0 0 0\n{channels}\n{joints}}}\n{motion}"


HOSTILE = [
    "</script><script>alert(1)</script>",
    "\"'&<b>",
    "\U0001f483\u821e",
    "__proto__",
    "[/b]",
    "x" * 200,
]


@pytest.mark.parametrize("ending", [".html", ".png", ".gif"])
@pytest.mark.parametrize(
    "text",
    [
        bvh(["Hips"], 3),
        bvh(["Hips", "A", "B"], 1),
        bvh(["Hips", "A", "B"], 3, "0 0 0"),
        bvh(["Hips", *HOSTILE], 3),
    ],
    ids=["one joint", "one frame", "no bones", "names"],
)
def test_odd_clips_are_shown(
    text: str,
    ending: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    clip, out = tmp_path / "\x1b[31m</title>\U0001f483'.bvh".replace("/", "\u2215"), tmp_path / f"out{ending}"
    clip.write_text(text, encoding="utf-8")
    assert run(monkeypatch, "view", clip, "-o", out, "--no-open") == 0
    told = capsys.readouterr()
    assert "\x1b" not in told.out + told.err and out.stat().st_size > 1000
    if ending == ".html":
        assert "<script>alert" not in out.read_text("utf-8")


def test_a_clip_without_frames_is_its_rest_pose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "empty.bvh"
    clip.write_text(bvh(["Hips", "A"], 0))
    assert run(monkeypatch, "view", clip, "--strict", "-o", tmp_path / "a.gif") == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "empty.bvh" in told and not (tmp_path / "a.gif").exists()
    assert run(monkeypatch, "view", clip, "-o", tmp_path / "a.png") == 0
    told = capsys.readouterr().err
    assert told == "empty.bvh: read with 1 frame of the rest pose, because the file has no motion\n"


def test_clips_of_the_same_name_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clips = [tmp_path / folder / "walk.bvh" for folder in ("truth", "made")]
    for clip in clips:
        clip.parent.mkdir()
        clip.write_text(RIG)
    assert run(monkeypatch, "view", *clips, "-o", tmp_path / "a.html", "--no-open") == 0
    page = (tmp_path / "a.html").read_text("utf-8")
    assert '"name":"truth/walk"' in page and '"name":"made/walk"' in page


@pytest.mark.parametrize("error", [ValueError, MotionkitError])
def test_an_interruption_that_a_library_turns_into_an_error_is_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: type[Exception]
) -> None:
    def interrupted(**_: object) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise error("could not determine the shape") from None

    names = [name for name in ("SIGINT", "SIGTERM", "SIGALRM") if hasattr(signal, name)]
    before = {getattr(signal, name): signal.getsignal(getattr(signal, name)) for name in names}
    monkeypatch.setattr("motionkit.cli.main.cli.main", interrupted)
    try:
        assert run(monkeypatch, "view") == 130
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert "shape" not in capsys.readouterr().err


def test_a_users_character_is_in_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_motion("walk.bvh", make_walk(40))
    hero = skinned(CHARACTERS["plain"]())
    Path("hero.glb").write_bytes(hero)
    assert run(monkeypatch, "view", "walk.bvh", "--rig", "hero.glb", "-o", "one.html", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["clips"][0]["frames"], told["clips"][0]["fps"]) == (40, 60.0)
    assert run(monkeypatch, "retarget", "walk.bvh", "--rig", "hero.glb", "-o", "moving.glb") == 0
    assert run(monkeypatch, "view", "moving.glb", "walk.bvh", "-o", "two.html", "--json") == 0
    for page, file in (("one.html", Path("hero.glb")), ("two.html", Path("moving.glb"))):
        assert base64.b64encode(file.read_bytes()).decode() in Path(page).read_text("utf-8")
    assert run(monkeypatch, "view", "walk.bvh", "--rig", "hero.glb", "-o", "sheet.png") == 0
    packed = skinned(
        character(), lambda value: value.update(extensionsRequired=["KHR_draco_mesh_compression"])
    )
    Path("packed.glb").write_bytes(packed)
    assert run(monkeypatch, "view", "walk.bvh", "--rig", "packed.glb", "-o", "no.html") == 1
    assert "packed.glb: its meshes are compressed by Draco" in capsys.readouterr().err
    assert not Path("no.html").exists()
