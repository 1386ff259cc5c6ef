"""Run by a Python that has bpy: the add-on on armatures as importers make them; prints what came of it as JSON.

python addon_rigs_check.py ADDON COMMAND RIG.bvh BODY.glb FOLDER
"""

import importlib.util
import json
import math
import sys
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

addon, command, bvh, glb, folder = sys.argv[1:]
spec = importlib.util.spec_from_file_location("motionkit_blender", addon)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
module.register()
TURN = Matrix.Rotation(math.pi / 2, 4, "X")
MOVED = Matrix.Translation((3.0, -2.0, 0.5)) @ Matrix.Rotation(1.0, 4, "Z") @ Matrix.Scale(1.2, 4)
NAMES = ("Hips", "LeftToeBase", "RightToeBase", "Head", "LeftHand")


def import_bvh():
    bpy.ops.import_anim.bvh(filepath=bvh, global_scale=0.056444, update_scene_fps=False)


def import_glb():
    bpy.ops.import_scene.gltf(filepath=glb)


def import_fbx():
    """By way of a file that Blender writes."""
    file = str(Path(folder, "a.fbx"))
    import_bvh()
    at_rest(the_armature())
    bpy.ops.export_scene.fbx(filepath=file, object_types={"ARMATURE"}, add_leaf_bones=False)
    bpy.data.objects.remove(the_armature())
    bpy.ops.import_scene.fbx(filepath=file)


def import_centimetres():
    """Bones in cm with Y up, the object turned and scaled by .01, as files of Mixamo come."""
    import_glb()
    armature = the_armature()
    for item in (armature, *armature.children):
        item.data.transform(Matrix.Scale(100.0, 4) @ TURN.inverted())
    armature.matrix_world = armature.matrix_world @ TURN @ Matrix.Scale(0.01, 4)


IMPORTS = {"bvh": import_bvh, "glb": import_glb, "fbx": import_fbx, "centimetres": import_centimetres}


def the_armature():
    (armature,) = (item for item in bpy.data.objects if item.type == "ARMATURE")
    return armature


def at_rest(armature):
    armature.animation_data_clear()
    for bone in armature.pose.bones:
        bone.matrix_basis = Matrix.Identity(4)
    bpy.context.view_layer.update()


def prepare(kind, place=None):
    """A scene with an armature alone, moved by a matrix and selected."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.motionkit.command, scene.motionkit.types = command, "walking:2"
    IMPORTS[kind]()
    armature = the_armature()
    if place is not None:
        armature.matrix_world = place @ armature.matrix_world
    scene.render.fps = 30
    scene.frame_set(7)
    bpy.ops.object.select_all(action="DESELECT")
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    return armature


def heads(armature, frame=None, to=None, names=NAMES):
    """Heads of bones in the space of a matrix, of the world without one, at a frame."""
    if frame is not None:
        bpy.context.scene.frame_set(frame)
    to = (to or Matrix.Identity(4)) @ armature.matrix_world
    return [list(to @ armature.pose.bones[name].head) for name in names]


def all_heads(armature, to=None):
    first, last = (round(frame) for frame in armature.animation_data.action.frame_range)
    return [heads(armature, frame, to) for frame in range(first, last + 1)]


def state(armature):
    """What a failure must not change."""
    scene = bpy.context.scene
    counts = [len(getattr(bpy.data, kind)) for kind in ("objects", "armatures", "actions", "meshes")]
    rate = (scene.render.fps, scene.render.fps_base)
    action = armature.animation_data and armature.animation_data.action
    return [*counts, *rate, scene.frame_current, scene.frame_start, scene.frame_end, action and action.name]


def walk(kind, place):
    """A walk, in the space that the armature was moved by."""
    armature = prepare(kind, place)
    at_rest(armature)
    back = place.inverted()
    rest, shown = heads(armature, to=back), bpy.context.scene.frame_current
    assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
    scene = bpy.context.scene
    assert (scene.frame_current, scene.render.fps, scene.render.fps_base) == (shown, 30, 1.0)
    return {"rest": rest, "heads": all_heads(armature, back)}


def begins_where_the_clip_began():
    """The heads at the first frame of an imported clip, and of walks that replaced it, the second the first."""
    armature = prepare("bvh", Matrix.Translation((5.0, 0.0, 0.0)))
    out = [heads(armature, 1)]
    for _ in range(2):
        bpy.context.scene.frame_set(9)
        assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
        out.append(heads(armature, 1))
    return out


def failures():
    """The messages of failures, none of which changes anything."""
    out = []
    armature = prepare("bvh")
    settings = bpy.context.scene.motionkit
    for name, value in (
        ("types", "flying"),
        ("model", "/nowhere/a.model"),
        ("markers", True),
        ("command", '"unclosed'),
        ("command", "true"),
    ):
        old, before = getattr(settings, name), state(armature)
        setattr(settings, name, value)
        out.append(fault())
        setattr(settings, name, old)
        assert state(armature) == before
    armature.scale = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    out.append(fault())
    bpy.ops.object.armature_add()  # one bone
    before = state(bpy.context.view_layer.objects.active)
    out.append(fault())
    assert state(bpy.context.view_layer.objects.active) == before
    return out


def fault():
    try:
        bpy.ops.motionkit.synthesize()
    except RuntimeError as error:
        return str(error)
    raise AssertionError("it did not fail")


def along_a_curve():
    """The hips along a circle around (1, 2) of radius 2, at 1.2 m/s."""
    armature = prepare("centimetres", MOVED)
    bpy.ops.curve.primitive_bezier_circle_add(radius=2.0, location=(1.0, 2.0, 0.0))
    settings = bpy.context.scene.motionkit
    settings.curve, settings.speed = bpy.context.view_layer.objects.active, 1.2
    settings.curve.select_set(False)
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    assert bpy.ops.motionkit.follow_curve() == {"FINISHED"}
    return all_heads(armature)


def over_a_marker():
    """How far the hips are over the ground from an empty, at the time of the marker with its name."""
    armature = prepare("glb", MOVED)
    at_rest(armature)
    goal = armature.matrix_world @ Vector((0.3, -1.4, 0.0))
    bpy.ops.object.empty_add(location=goal)
    bpy.context.view_layer.objects.active.name = "goal"
    bpy.context.scene.timeline_markers.new("goal", frame=46)
    bpy.context.scene.motionkit.markers = True
    bpy.ops.object.select_all(action="DESELECT")
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
    ((x, y, _),) = heads(armature, 46, names=("Hips",))
    return math.hypot(x - goal.x, y - goal.y)


def loop():
    """The first and the last pose of a loop, from the hips, in a rig whose bones turn by quaternions."""
    armature = prepare("glb")
    bpy.context.scene.motionkit.loop = True
    assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
    first, *_, last = all_heads(armature)
    return [[list(Vector(head) - Vector(row[0])) for head in row] for row in (first, last)]


def soles():
    """How high the lowest vertex of a mesh is in each frame, in m of the armature; the mesh is selected."""
    armature = prepare("glb", MOVED)
    at_rest(armature)
    (body,) = (item for item in bpy.data.objects if item.find_armature() == armature)
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    assert bpy.ops.motionkit.synthesize() == {"FINISHED"} and armature.data.pose_position == "POSE"
    back, out = MOVED.inverted(), []
    for frame in range(1, 61):
        bpy.context.scene.frame_set(frame)
        evaluated = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
        to = back @ evaluated.matrix_world
        out.append(min((to @ vertex.co).z for vertex in evaluated.to_mesh().vertices))
    return out


def under_a_connected_root():
    """Heads where the hips are connected to a bone below them, which has to carry them."""
    armature = prepare("bvh")
    at_rest(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    hips, root = armature.data.edit_bones["Hips"], armature.data.edit_bones.new("root")
    root.head, root.tail = hips.head - Vector((0.0, 0.0, 0.9)), hips.head
    hips.parent, hips.use_connect = root, True
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
    return [row[:3] for row in all_heads(armature)]


def a_new_body():
    """The frames of an imported body's action, and the last of the scene."""
    prepare("bvh")
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 101, 110
    assert bpy.ops.motionkit.synthesize() == {"FINISHED"}
    action = bpy.context.view_layer.objects.active.animation_data.action
    return [*action.frame_range, bpy.context.scene.frame_end]


found = {
    "walks": {kind: [walk(kind, place) for place in (Matrix.Identity(4), MOVED @ TURN)] for kind in IMPORTS},
    "beginnings": begins_where_the_clip_began(),
    "faults": failures(),
    "curve": along_a_curve(),
    "marker": over_a_marker(),
    "loop": loop(),
    "soles": soles(),
    "connected": under_a_connected_root(),
    "new body": a_new_body(),
}
print("RESULT " + json.dumps(found))
