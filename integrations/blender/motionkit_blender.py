"""Blender add-on: motion by motionkit, synthesized, along a curve, or live.

It holds no logic of its own: it runs the `motionkit` command, or reads the socket of `motionkit play --tcp PORT`. With
an armature selected, motion is made for that rig (`--rig`) and put on it; otherwise a body is imported.
Install: Edit, Preferences, Add-ons, Install from Disk. The panel is in the sidebar of the 3D view.
"""

import json
import math
import shlex
import socket
import subprocess
import tempfile
from pathlib import Path

import bpy
from mathutils import Matrix, Quaternion

bl_info = {
    "name": "motionkit",
    "author": "the motionkit authors",
    "version": (0, 2, 0),
    "blender": (4, 2, 0),
    "location": "3D View > Sidebar > motionkit",
    "description": "Synthesized motion on the selected armature",
    "category": "Animation",
}

TO_Z_UP = Matrix.Rotation(math.pi / 2, 4, "X")  # motionkit has Y up


def run(settings, *words):
    """Run a motionkit command; raises RuntimeError with its message if it fails."""
    command = [*shlex.split(settings.command), *map(str, words)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RuntimeError(f"motionkit cannot be run: {error}") from None
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["motionkit failed"])[-1])


def selected_armature(context):
    """The active armature, or None."""
    active = context.view_layer.objects.active
    return active if active is not None and active.type == "ARMATURE" and active.select_get() else None


def make(context, *words):
    """Run a command that writes a motion and import what it wrote; returns the armature that moves."""
    settings = context.scene.motionkit
    target = selected_armature(context)
    context.scene.render.fps = 60
    with tempfile.TemporaryDirectory() as folder:
        if target is None:
            file = Path(folder, "motion.glb")
            run(settings, *words, "--seed", settings.seed, "-o", file)
            bpy.ops.import_scene.gltf(filepath=str(file))
            return context.view_layer.objects.active
        rig, file = Path(folder, "rig.bvh"), Path(folder, "motion.bvh")
        export_rig(context, target, rig)
        run(settings, *words, "--seed", settings.seed, "--rig", rig, "-o", file)
        bpy.ops.import_anim.bvh(filepath=str(file), global_scale=0.01, axis_forward="Y", axis_up="Z")
    return put_on(context, context.view_layer.objects.active, target)


def export_rig(context, target, path):
    """Write the rest pose of an armature as BVH, in centimetres."""
    scene = context.scene
    shown = target.data.pose_position
    target.data.pose_position = "REST"
    bpy.ops.export_anim.bvh(
        filepath=str(path), global_scale=100.0, frame_start=scene.frame_start, frame_end=scene.frame_start + 1
    )
    target.data.pose_position = shown


def put_on(context, source, target):
    """Bake the motion of an imported armature onto another one with the same bone names, and remove it."""
    first, last = (round(frame) for frame in source.animation_data.action.frame_range)
    for bone in target.pose.bones:
        if bone.name not in source.pose.bones:
            continue
        turn = bone.constraints.new("COPY_ROTATION")
        turn.target, turn.subtarget = source, bone.name
        turn.owner_space, turn.target_space = "LOCAL", "LOCAL_OWNER_ORIENT"
        if bone.parent is None:
            move = bone.constraints.new("COPY_LOCATION")
            move.target, move.subtarget = source, bone.name
    bpy.ops.object.select_all(action="DESELECT")
    target.select_set(True)
    context.view_layer.objects.active = target
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.pose.select_all(action="SELECT")
    bpy.ops.nla.bake(
        frame_start=first, frame_end=last, visual_keying=True, clear_constraints=True, bake_types={"POSE"}
    )
    bpy.ops.object.mode_set(mode="OBJECT")
    action = source.animation_data.action
    bpy.data.objects.remove(source)
    bpy.data.actions.remove(action)
    context.scene.frame_end = last
    return target


def curve_points(context, curve):
    """The points of a curve in the world as motionkit's x, z in metres."""
    mesh = curve.evaluated_get(context.evaluated_depsgraph_get()).to_mesh()
    points = [curve.matrix_world @ vertex.co for vertex in mesh.vertices]
    return [[point.x, -point.y] for point in points]


class Settings(bpy.types.PropertyGroup):
    """What the panel shows."""

    command: bpy.props.StringProperty(
        name="Command",
        default="motionkit",
        description="How motionkit is called, such as python -m motionkit",
    )
    types: bpy.props.StringProperty(
        name="Types", default="running,cartwheel", description="Motion types, such as running:4,cartwheel"
    )
    seed: bpy.props.IntProperty(name="Seed", default=0, min=0)
    curve: bpy.props.PointerProperty(
        name="Curve", type=bpy.types.Object, poll=lambda self, item: item.type == "CURVE"
    )
    gait: bpy.props.StringProperty(name="Gait", default="walking", description="Motion type along the curve")
    port: bpy.props.IntProperty(
        name="Port", default=8643, description="That of motionkit play --tcp", min=1, max=65535
    )


class Work(bpy.types.Operator):
    """An operator that shows motionkit's message where it fails."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context):
        try:
            made = self.work(context)
        except (RuntimeError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"motion on {made.name}")
        return {"FINISHED"}


class MOTIONKIT_OT_synthesize(Work):
    """Synthesize the motion types, on the selected armature or on a new body"""

    bl_idname = "motionkit.synthesize"
    bl_label = "Synthesize"

    def work(self, context):
        return make(context, "synthesize", "--types", context.scene.motionkit.types)


class MOTIONKIT_OT_follow_curve(Work):
    """Follow the curve on the ground, on the selected armature or on a new body"""

    bl_idname = "motionkit.follow_curve"
    bl_label = "Follow curve"

    def work(self, context):
        settings = context.scene.motionkit
        if settings.curve is None:
            raise RuntimeError("choose a curve to follow")
        part = {"type": settings.gait, "points": curve_points(context, settings.curve)}
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "path.json")
            path.write_text(json.dumps({"parts": [part]}))
            return make(context, "follow-path", path)


def pose(armature, skeleton, character):
    """Give an armature with motionkit's rest pose the joints of one character of a frame (docs/live.md)."""
    turns = {}
    for index, (name, parent) in enumerate(zip(skeleton["joints"], skeleton["parents"], strict=True)):
        turn = Quaternion(character["rotations"][index])
        turns[index] = turns[parent] @ turn if parent >= 0 else turn
        bone = armature.pose.bones.get(name)
        if bone is not None:
            place = Matrix.Translation([value / 100.0 for value in character["positions"][index]])
            world = TO_Z_UP @ place @ turns[index].to_matrix().to_4x4() @ TO_Z_UP.inverted()
            rest = bone.bone.matrix_local.to_3x3().to_4x4()
            bone.matrix = world @ rest
            bpy.context.view_layer.update()


class MOTIONKIT_OT_live(bpy.types.Operator):
    """Show the first character of a running motionkit play --tcp on the selected armature; Escape stops"""

    bl_idname = "motionkit.live"
    bl_label = "Live"

    def execute(self, context):
        self.armature = selected_armature(context)
        if self.armature is None:
            self.report({"ERROR"}, "select an armature that motionkit made (import a .glb)")
            return {"CANCELLED"}
        try:
            self.socket = socket.create_connection(("127.0.0.1", context.scene.motionkit.port), timeout=5.0)
            self.lines = self.socket.makefile("r", encoding="utf-8")
            self.skeleton = json.loads(self.lines.readline())  # the hello event has joints and parents
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, f"no motionkit play --tcp {context.scene.motionkit.port}: {error}")
            return {"CANCELLED"}
        self.timer = context.window_manager.event_timer_add(1.0 / 60.0, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            context.window_manager.event_timer_remove(self.timer)
            self.socket.close()
            return {"FINISHED"}
        if event.type == "TIMER":
            frame = json.loads(self.lines.readline() or "{}")
            if frame.get("event") == "frame" and frame["characters"]:
                pose(self.armature, self.skeleton, frame["characters"][0])
        return {"PASS_THROUGH"}


class MOTIONKIT_PT_panel(bpy.types.Panel):
    """The panel in the sidebar."""

    bl_label = "motionkit"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "motionkit"

    def draw(self, context):
        settings = context.scene.motionkit
        for name in ("command", "types", "seed"):
            self.layout.prop(settings, name)
        self.layout.operator("motionkit.synthesize")
        self.layout.prop(settings, "curve")
        self.layout.prop(settings, "gait")
        self.layout.operator("motionkit.follow_curve")
        self.layout.prop(settings, "port")
        self.layout.operator("motionkit.live")


CLASSES = (
    Settings,
    MOTIONKIT_OT_synthesize,
    MOTIONKIT_OT_follow_curve,
    MOTIONKIT_OT_live,
    MOTIONKIT_PT_panel,
)


def register():
    """Called by Blender when the add-on is switched on."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.motionkit = bpy.props.PointerProperty(type=Settings)


def unregister():
    """Called by Blender when the add-on is switched off."""
    del bpy.types.Scene.motionkit
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
