"""Run by a Python that has bpy: imports motion files into Blender and prints what is there as JSON.

python blender_check.py JOINT SECONDS FILE... ; each file in a fresh scene.
"""

import json
import sys
from pathlib import Path

import bpy

IMPORTERS = {
    ".bvh": lambda path: bpy.ops.import_anim.bvh(filepath=path, global_scale=0.01, update_scene_fps=True),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".vrma": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".usda": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".fbx": lambda path: bpy.ops.import_scene.fbx(filepath=path),
}


def check(path: str, joint: str, seconds: float) -> dict:
    """Bones, frames, and the place of a joint (in motionkit's axes, m) at a time."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = 60
    ending = Path(path).suffix
    IMPORTERS[ending](path)
    armatures = [item for item in bpy.data.objects if item.type == "ARMATURE"]
    if not armatures:
        return {"file": path, "bones": 0, "empties": sum(item.type == "EMPTY" for item in bpy.data.objects)}
    (armature,) = armatures
    first, last = armature.animation_data.action.frame_range if armature.animation_data else (0, 0)
    # Time samples of USD are frames of their own rate; the scene keeps its own.
    scene.frame_set(round(first) + round(seconds * scene.render.fps))
    x, y, z = armature.matrix_world @ armature.pose.bones[joint].head
    skinned = sum(item.type == "MESH" and bool(item.vertex_groups) for item in bpy.data.objects)
    return {
        "file": path,
        "bones": len(armature.data.bones),
        "frames": round(last - first) + 1,
        "place": [x, z, -y],
        "skinned": skinned,
    }


if __name__ == "__main__":
    words = sys.argv[1:]
    print("RESULT " + json.dumps([check(path, words[0], float(words[1])) for path in words[2:]]))
