"""Run by Blender, not by motionkit: makes a .glb of an FBX file, or an FBX file of a .glb.

... -- SOURCE TARGET [FPS]
"""

from __future__ import annotations

import os
import sys
from typing import Any


def to_glb(bpy: Any, source: str, target: str) -> None:
    bpy.ops.import_scene.fbx(filepath=source)  # which takes over the frame rate of the file
    bpy.ops.export_scene.gltf(
        filepath=target,
        export_format="GLB",
        export_animation_mode="ACTIONS",
        export_optimize_animation_size=False,
    )


def to_fbx(bpy: Any, source: str, target: str, fps: float) -> None:
    render = bpy.context.scene.render
    render.fps = max(1, round(fps))  # before the motion is imported
    render.fps_base = render.fps / fps
    bpy.ops.import_scene.gltf(filepath=source)
    for item in [item for item in bpy.data.objects if item.type == "MESH" and not item.vertex_groups]:
        bpy.data.objects.remove(item)  # the shape that the importer draws bones with
    bpy.ops.export_scene.fbx(
        filepath=target,
        object_types={"ARMATURE", "MESH"},
        add_leaf_bones=False,
        bake_anim_use_nla_strips=False,
        bake_anim_simplify_factor=0.0,
    )


def main() -> int:
    import bpy

    source, target, *more = sys.argv[sys.argv.index("--") + 1 :]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        to_fbx(bpy, source, target, float(more[0])) if more else to_glb(bpy, source, target)
    except Exception as error:  # Blender itself would go on and report success
        print(" ".join(str(error).split()))
        return 1
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # bpy 4.2 crashes where Python ends as usual
