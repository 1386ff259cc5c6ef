"""The viewer file in a real browser, from disk and without a network."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from motionkit.errors import MotionkitError
from motionkit.export.clip import rig_clip
from motionkit.export.formats import read_clip, write_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.rig.on_rig import read_rig
from motionkit.rig.upright import in_metres
from motionkit.view.figure_data import MotionView
from motionkit.view.notebook import show
from motionkit.view.viewer import viewer_page, write_viewer
from synthetic_characters import CHARACTERS, skinned
from synthetic_motions import make_cartwheel, make_walk
from view.conftest import PATIENCE, drawn

pytestmark = pytest.mark.thorough

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"


def cmu_clip(name: str, frames: int) -> Motion:
    """The first frames of a recording in its own rig and unit."""
    return bvh_to_motion(read_bvh(DATA / f"{name}.bvh")).cut(0, frames)


@pytest.fixture(scope="module")
def two_motions() -> list[MotionView]:
    """A walk at 60 fps and a recording of another rig and unit at 120, with types and a path."""
    path = np.array([[0.0, 0.0], [0.0, 300.0], [100.0, 500.0]], np.float32)
    walk = MotionView("a <b>walk</b></script>", make_walk(120), [("walking", 1.5), ("running", 0.5)], path)
    return [walk, MotionView("16_05", cmu_clip("16_05", 240))]


@pytest.fixture(scope="module")
def opened(
    two_motions: list[MotionView], tmp_path_factory: pytest.TempPathFactory, open_page: Callable
) -> Page:
    """The viewer of two_motions, opened from disk, offline."""
    file = tmp_path_factory.mktemp("viewer") / "two motions.html"
    write_viewer(file, two_motions)
    page = open_page(file.as_uri(), offline=True)
    assert page.evaluate("motionkit.playing"), "it plays when it is opened"
    return page


@pytest.fixture
def page(opened: Page) -> Page:
    """The same, standing at the start, the first motion chosen."""
    opened.evaluate("motionkit.play(false); motionkit.choose(0); motionkit.seek(0, true)")
    return opened


def joints_in_page(page: Page, track: int) -> np.ndarray:
    """(J, 3) where the page has the joints of a motion, before it moves them side by side."""
    places = page.evaluate(f"motionkit.tracks[{track}].clip.pose.places.map((p) => p.toArray())")
    return np.array(places)


def picture(page: Page) -> np.ndarray:
    """The scene as (H, W, 3)."""
    drawn(page)
    data = page.locator("#scene").screenshot()
    return np.array(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def test_joints_are_where_kinematics_puts_them(page: Page, two_motions: list[MotionView]) -> None:
    for seconds, frames in ((0.0, (0, 0)), (1.0, (60, 120)), (1.5, (90, 180))):
        page.evaluate(f"motionkit.seek({seconds}, true)")
        for track, (shown, frame) in enumerate(zip(two_motions, frames, strict=True)):
            motion = in_metres(shown.motion).motion
            expected = motion_kinematics(motion)[1][frame]
            assert page.evaluate(f"motionkit.tracks[{track}].frame") == frame
            np.testing.assert_allclose(joints_in_page(page, track), expected, atol=2e-3)


def test_every_joint_is_drawn(page: Page, two_motions: list[MotionView]) -> None:
    page.get_by_role("button", name="Skeleton").click()
    for track, shown in enumerate(two_motions):
        figure = f"motionkit.tracks[{track}].figure"
        assert page.evaluate(f"{figure}.joints.count") == len(shown.motion.skeleton)
        assert page.evaluate(f"{figure}.bones.visible")
        carried = set(page.evaluate(f"Array.from({figure}.rig.body.joints)"))
        names = shown.motion.skeleton.names
        limbs = {
            j for j, name in enumerate(names) if name.endswith(("UpLeg", "Leg", "Foot", "Arm", "ForeArm"))
        }
        assert limbs and limbs <= carried, "a limb without a body"


def test_playing_scrubbing_and_keys(page: Page) -> None:
    page.keyboard.press("Space")
    page.wait_for_function("motionkit.time > 0.1")
    page.keyboard.press("Space")
    stopped = page.evaluate("motionkit.time")
    page.wait_for_timeout(200)
    assert page.evaluate("motionkit.time") == stopped
    page.keyboard.press("Space")
    page.keyboard.press("Home")
    assert page.get_by_role("button", name="Play", exact=True).count() == 1, "a seek by hand stops"
    skeleton = page.get_by_role("button", name="Skeleton", exact=True)
    before = skeleton.get_attribute("aria-pressed")
    skeleton.press("Space")
    assert skeleton.get_attribute("aria-pressed") != before and not page.evaluate("motionkit.playing")
    skeleton.press("Space")
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("motionkit.time") == pytest.approx(1 / 60)
    page.keyboard.press("2")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("motionkit.tracks[1].frame") == 3, "steps at the chosen motion's own rate"
    page.keyboard.press("End")
    assert page.evaluate("motionkit.tracks.map(t => t.frame)") == [119, 239]
    timeline = page.locator("#timeline").bounding_box()
    page.mouse.click(timeline["x"] + 92 + (timeline["width"] - 106) / 2, timeline["y"] + 20)
    assert page.evaluate("motionkit.time / motionkit.timeline.seconds") == pytest.approx(0.5, abs=0.02)


def test_what_can_be_switched(page: Page) -> None:
    page.evaluate("motionkit.seek(0.5, true)")
    for name, state in (
        ("Names", "motionkit.names"),
        ("Paths", "motionkit.tracks[0].paths[2].visible"),
        ("Feet", "motionkit.tracks[0].prints.visible"),
        ("Follow", "motionkit.followed"),
        ("Side by side", "motionkit.apart"),
    ):
        before = page.evaluate(state)
        page.get_by_role("button", name=name, exact=True).click()
        assert page.evaluate(state) is (not before), name
    assert page.evaluate("motionkit.tracks.map(t => t.group.position.length())") == [0, 0], "overlaid"
    page.wait_for_function("document.querySelectorAll('#labels span:not(.name)').length > 20")
    assert page.locator("#clips").inner_text().count("fps") == 2
    assert "a <b>walk</b></script>" in page.locator("#clips").inner_text(), "names are text, not markup"
    page.keyboard.press("d")
    theme = page.evaluate("document.documentElement.dataset.theme")
    assert (picture(page)[5, 5].mean() > 128) == (theme == "light")


def test_the_picture_shows_figures_and_moves(page: Page) -> None:
    page.evaluate("motionkit.seek(0, true); motionkit.toggles.f.set(false); motionkit.frameAll()")
    first = picture(page)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 200, "blank"
    blue = (first[..., 2] - first[..., 0] > 60).sum()
    orange = (first[..., 0] - first[..., 2] > 60).sum()
    assert min(blue, orange) > 100, "both shirts are to be seen"
    page.evaluate("motionkit.seek(1.4, true)")
    assert (np.abs(picture(page) - first).max(axis=-1) > 30).sum() > 500


# Where the timeline writes the speed of each motion, at five times: left, right, and the width of the canvas.
SPEEDS_WRITTEN = """[0, 1, 2, 3, 3.9].flatMap((time) => {
    const [found, pen] = [[], CanvasRenderingContext2D.prototype];
    const write = pen.fillText;
    pen.fillText = function (text, x, ...more) {
        if (/^\\d\\.\\d\\d$/.test(text))
            found.push([x, x + this.measureText(text).width, this.canvas.clientWidth]);
        write.call(this, text, x, ...more);
    };
    motionkit.seek(time, true);
    motionkit.timeline.redraw();
    pen.fillText = write;
    return found.slice(-6);
})"""


@pytest.mark.parametrize(
    "size", [(1280, 720), (390, 844), (844, 390)], ids=["screen", "phone", "phone across"]
)
def test_motions_side_by_side_are_all_in_the_picture_at_first(
    size: tuple[int, int], tmp_path: Path, browser: Browser
) -> None:
    walk = make_walk(240)
    file = tmp_path / "many.html"
    write_viewer(file, [MotionView(f"walk of a stranger {n}", walk) for n in range(6)])
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]", state="attached", timeout=PATIENCE)
    drawn(page)
    assert page.evaluate("motionkit.followed && motionkit.apart")
    across = page.evaluate(
        """motionkit.tracks.map(({ clip, group, frame }) => {
            const [x, , z] = clip.hips.slice(frame * 3, frame * 3 + 3);
            return group.position.clone().add({ x, y: 0.9, z }).project(motionkit.stage.camera).x;
        })"""
    )
    values = page.evaluate(SPEEDS_WRITTEN)
    hidden = page.evaluate("document.querySelector('#clips').scrollHeight - clips.clientHeight")
    page.close()
    assert hidden <= 1, "six names are all to be seen"
    if size[1] > size[0]:
        assert len(values) == 5 * 6 and all(0 <= left < right <= width for left, right, width in values)
    assert np.abs(across).max() < 0.95
    assert np.ptp(across) > 1.0, "the camera stands no further off than it must"


def test_a_low_screen_leaves_the_figures_half_of_it(page: Page) -> None:
    before = page.viewport_size
    page.set_viewport_size({"width": 844, "height": 390})
    page.wait_for_function("document.getElementById('stage').clientHeight > 195")
    page.set_viewport_size(before)
    page.wait_for_function("document.getElementById('timeline').clientHeight > 100")


def test_many_motions_leave_the_figures_half_of_the_screen(tmp_path: Path, open_page: Callable) -> None:
    file = tmp_path / "many.html"
    walk = make_walk(60)
    write_viewer(file, [MotionView(f"walk {n}", walk, [("walking", 1.0)]) for n in range(20)])
    page = open_page(file.as_uri(), offline=True)
    for chosen in (0, 9, 19):
        page.evaluate(f"motionkit.choose({chosen})")
        named = page.evaluate(
            "motionkit.timeline.rows.filter(({ kind }) => kind === 'types').map(({ n }) => n)"
        )
        assert chosen in named and 1 < len(named) < 20
    size = page.viewport_size
    assert page.evaluate("document.getElementById('stage').clientHeight") > size["height"] / 2
    page.close()


def test_the_size_of_a_file(two_motions: list[MotionView]) -> None:
    empty = len(viewer_page([MotionView("x", two_motions[0].motion.cut(0, 1))]))
    assert empty < 1_500_000
    frames = len(two_motions[0].motion)
    assert len(viewer_page(two_motions[:1])) - empty < 200 * frames


def test_a_cartwheel_has_types_contacts_and_an_end(tmp_path: Path, open_page: Callable) -> None:
    file = tmp_path / "one.html"
    write_viewer(file, [MotionView("cartwheel", make_cartwheel(60), [("cartwheel", 1.0)])])
    page = open_page(file.as_uri(), offline=True)
    bands = page.evaluate("motionkit.tracks[0].clip.types")
    assert bands == [{"type": "cartwheel", "start": 0, "end": 1}]
    page.evaluate("motionkit.toggles.l.set(false); motionkit.seek(0.9, true); motionkit.play(true)")
    page.wait_for_function("!motionkit.playing")
    assert page.evaluate("motionkit.tracks[0].frame") == 59


def test_the_page_asks_for_nothing(two_motions: list[MotionView], tmp_path: Path, browser: Browser) -> None:
    file = tmp_path / "alone.html"
    write_viewer(file, two_motions[:1])
    page = browser.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]", state="attached", timeout=PATIENCE)
    page.close()
    assert asked == [file.as_uri()]


def test_no_motions_is_an_error() -> None:
    with pytest.raises(MotionkitError, match="1 to 32 motions"):
        viewer_page([])


def test_motion_waits_where_it_is_to_be_reduced(
    two_motions: list[MotionView], tmp_path: Path, open_page: Callable
) -> None:
    file = tmp_path / "calm.html"
    write_viewer(file, two_motions[:1])
    page = open_page(file.as_uri(), 400, 700, offline=True, reduced_motion="reduce")
    assert not page.evaluate("motionkit.playing")
    assert page.evaluate("document.documentElement.scrollWidth") == 400, "nothing reaches out of the screen"


def test_a_bare_page_has_no_controls_and_a_click_pauses(
    two_motions: list[MotionView], tmp_path: Path, open_page: Callable
) -> None:
    file = tmp_path / "bare.html"
    file.write_text(viewer_page(two_motions[:1], bare=True), "utf-8")
    page = open_page(file.as_uri(), 320, 240, offline=True)
    assert not page.locator("header").is_visible() and not page.locator("footer").is_visible()
    assert page.locator("#stage").bounding_box()["height"] == 240
    assert page.evaluate("motionkit.playing")
    page.mouse.click(160, 120)
    assert not page.evaluate("motionkit.playing")


def test_a_notebook_cell_plays_in_a_frame(
    two_motions: list[MotionView], tmp_path: Path, open_page: Callable
) -> None:
    player = show(two_motions[0].motion, names=['a "quoted" <name>'], height=300)
    cell = player._repr_html_()
    assert cell.startswith("<iframe") and cell.count("<") == 2, "all of the page is an attribute"
    assert "height: 300px" in cell
    file = tmp_path / "cell.html"
    file.write_text(f"<!doctype html><html data-ready><title>x</title>{cell}", "utf-8")
    page = open_page(file.as_uri(), 400, 320, offline=True)
    frame = page.frame_locator("iframe")
    frame.locator("html[data-ready]").wait_for(state="attached", timeout=PATIENCE)
    assert not frame.locator("footer").is_visible()


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"names": ["one", "two"]}, "a name for each of 1 motions, found 2"),
        ({"height": 0}, "height of 50 to 2000 pixels, found 0"),
    ],
)
def test_what_a_notebook_cell_cannot_show(two_motions: list[MotionView], options: dict, fault: str) -> None:
    with pytest.raises(MotionkitError, match=fault):
        show(two_motions[0].motion, **options)


@pytest.mark.parametrize("key", ["plain", "backwards", "vrm1"])
def test_a_users_character_is_where_its_joints_are(open_page: Callable, tmp_path: Path, key: str) -> None:
    """On the page, from its own animation, its nodes are where Python's kinematics has the joints."""
    hero, moving = tmp_path / "hero.glb", tmp_path / "moving.glb"
    hero.write_bytes(skinned(CHARACTERS[key]()))
    rig = read_rig(hero)
    write_motion(moving, rig_clip(on_rig(make_walk(40), rig), rig, "walk"))
    clip = read_clip(moving)
    assert clip.character is not None
    write_viewer(tmp_path / "view.html", [MotionView("walk", clip.motion, character=clip.character)] * 2)
    assert '"body":null' in (tmp_path / "view.html").read_text("utf-8")
    page = open_page((tmp_path / "view.html").as_uri())
    page.evaluate("motionkit.seek(0.5, true)")
    found = page.evaluate(
        """(nodes) => {
          const { figure } = motionkit.tracks[1];
          figure.updateWorldMatrix(true, true);
          const at = ({ matrixWorld }) => figure.position.clone().setFromMatrixPosition(matrixWorld);
          return nodes.map((node) => figure.worldToLocal(at(figure.hero.nodes[node])).toArray());
        }""",
        list(clip.character.nodes),
    )
    places = motion_kinematics(clip.motion)[1][30] / 100.0
    assert np.abs(np.array(found) - places).max() < 1e-3
