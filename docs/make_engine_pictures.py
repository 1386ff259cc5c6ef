"""Writes docs/engines.png: running into a cartwheel, opened by three.js, on a VRM avatar, and by Blender.

MOTIONKIT_BPY=/path/to/python-with-bpy python docs/make_engine_pictures.py

Needs chromium, playwright, Pillow, and tests/export/js built (its README says how).
"""

from __future__ import annotations

import base64
import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont
from playwright.sync_api import sync_playwright

import motionkit as mk

DOCS = Path(__file__).resolve().parent
TESTS = DOCS.parent / "tests"
sys.path.insert(0, str(TESTS))

from export.test_readers import write_avatar  # noqa: E402

SIZE = (420, 380)
SECONDS = 4.0 + 1.3  # in the middle of the cartwheel
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]

BLENDER = """
import sys, math, bpy
from mathutils import Vector
source, target, seconds, width, height = sys.argv[-5:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 60
bpy.ops.import_scene.gltf(filepath=source)
for item in [i for i in bpy.data.objects if i.type == "MESH" and not i.vertex_groups]:
    bpy.data.objects.remove(item)
armature = next(i for i in bpy.data.objects if i.type == "ARMATURE")
scene.frame_set(round(float(seconds) * 60))
at = armature.matrix_world @ armature.pose.bones["Hips"].head
bpy.ops.mesh.primitive_plane_add(size=200)
ground = bpy.data.materials.new("ground")
ground.use_nodes = True
ground.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.4, 0.42, 0.45, 1)
bpy.context.object.data.materials.append(ground)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.location = Vector((at.x + 3.4, at.y - 3.4, 1.7))
aim = Vector((at.x, at.y, 0.9)) - camera.location
camera.rotation_euler = aim.to_track_quat("-Z", "Y").to_euler()
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.rotation_euler = 1.6, (0.7, 0.2, 0.6)
for item in (camera, sun):
    scene.collection.objects.link(item)
scene.camera = camera
scene.world = bpy.data.worlds.new("world")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.45, 0.48, 0.52, 1)
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising = 24, False
scene.view_settings.view_transform = "Standard"
scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
scene.render.filepath = target
bpy.ops.render.render(write_still=True)
"""


def in_chromium(folder: Path) -> list[Image.Image]:
    """The .glb, and the .vrma on an avatar, as three.js draws them."""
    script = (
        (TESTS / "export" / "js" / "build" / "page.js").read_text("utf-8").replace("</script", "<\\/script")
    )
    (folder / "page.html").write_text(f"<!doctype html><body style='margin:0'><script>{script}</script>")
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    pictures = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        for names, hips in ((["a.glb"], "Hips"), (["a.vrma", "avatar.vrm"], "hips")):
            page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            page.goto((folder / "page.html").as_uri())
            files = [base64.b64encode((folder / name).read_bytes()).decode() for name in names]
            page.evaluate("(files) => checks.open(...files)", files)
            page.evaluate("([time, hips]) => checks.draw(time, hips)", [SECONDS, hips])
            pictures.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
        browser.close()
    return pictures


def in_blender(folder: Path) -> Image.Image:
    """The .glb as Blender renders it."""
    (folder / "render.py").write_text(BLENDER)
    words = [os.environ["MOTIONKIT_BPY"], "render.py", "a.glb", str(folder / "blender.png"), SECONDS, *SIZE]
    subprocess.run([str(word) for word in words], cwd=folder, check=True, capture_output=True, timeout=500)
    return Image.open(folder / "blender.png").convert("RGB")


def main() -> None:
    """Make the files, open them, and put the pictures side by side."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        made = mk.synthesize("running:4,cartwheel", seed=0).motion
        for ending in ("glb", "vrma"):
            mk.write(folder / f"a.{ending}", made)
        write_avatar(folder / "avatar.vrm", made.cut(0, 2).scaled(1.1))
        pictures = [*in_chromium(folder), in_blender(folder)]
    whole = Image.new("RGB", (SIZE[0] * len(pictures), SIZE[1]))
    draw = ImageDraw.Draw(whole)
    for number, (picture, name) in enumerate(
        zip(pictures, (".glb in three.js", ".vrma on an avatar", ".glb in Blender"), strict=True)
    ):
        whole.paste(picture, (number * SIZE[0], 0))
        draw.text((number * SIZE[0] + 10, 8), name, (30, 35, 42), ImageFont.load_default(16))
    whole.quantize(160, dither=Image.Dither.NONE).save(DOCS / "engines.png", optimize=True)
    print(f"engines.png: {(DOCS / 'engines.png').stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
