"""Run by a Python that has bpy: uses the add-on as the panel does, and prints what came of it as JSON.

python addon_check.py ADDON COMMAND RIG.bvh
"""

import importlib.util
import json
import sys

import bpy
from mathutils import Matrix

addon, command, rig = sys.argv[1:]
spec = importlib.util.spec_from_file_location("motionkit_blender", addon)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
bpy.ops.wm.read_factory_settings(use_empty=True)
module.register()
settings = bpy.context.scene.motionkit
settings.command = command
found = {}


def moved(armature):
    """Bones, frames, and how far the first bone goes over the ground."""
    first, last = (round(frame) for frame in armature.animation_data.action.frame_range)
    places = []
    for frame in (first, last):
        bpy.context.scene.frame_set(frame)
        bone = armature.pose.bones[0]
        places.append((armature.matrix_world @ bone.matrix).translation.copy())
    return {
        "bones": len(armature.data.bones),
        "frames": last - first + 1,
        "way": (places[1] - places[0]).length,
    }


settings.types = "walking:1"
assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
body = bpy.context.view_layer.objects.active
found["new body"] = moved(body)

# A frame of the socket in the rest pose puts every bone where it rests, 2 m ahead (motionkit's +Z is Blender's -Y).
joints = [bone.name for bone in body.data.bones]
parents = [joints.index(bone.parent.name) if bone.parent else -1 for bone in body.data.bones]
heads = [bone.head_local for bone in body.data.bones]
frame = {
    "rotations": [[1.0, 0.0, 0.0, 0.0]] * len(joints),
    "positions": [[100.0 * head.x, 100.0 * head.z, 200.0 - 100.0 * head.y] for head in heads],
}
action, body.animation_data.action = body.animation_data.action, None
module.pose(body, {"joints": joints, "parents": parents}, frame)
gaps = []
for bone in body.pose.bones:
    wanted = Matrix.Translation((0.0, -2.0, 0.0)) @ bone.bone.matrix_local
    gaps.append(max(abs(value) for row in bone.matrix - wanted for value in row))
found["live"] = max(gaps)
body.animation_data.action = action

bpy.ops.object.select_all(action="DESELECT")
bpy.ops.import_anim.bvh(filepath=rig, global_scale=0.056444, update_scene_fps=False)
target = bpy.context.view_layer.objects.active
target.animation_data_clear()
count = len(bpy.data.objects)
assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
assert bpy.context.view_layer.objects.active is target and len(bpy.data.objects) == count
found["own rig"] = moved(target)

bpy.ops.object.select_all(action="DESELECT")
bpy.context.view_layer.objects.active = None
bpy.ops.curve.primitive_bezier_circle_add(radius=1.5)
settings.curve = bpy.context.view_layer.objects.active
settings.curve.select_set(False)
bpy.context.view_layer.objects.active = None
assert bpy.ops.motionkit.follow_curve() == {"FINISHED"}
found["curve"] = moved(bpy.context.view_layer.objects.active)

settings.types = "flying"
try:
    bpy.ops.motionkit.synthesize()
except RuntimeError as error:
    found["fault"] = str(error)
module.unregister()
print("RESULT " + json.dumps(found))
