"""Blender add-on: motion by motionkit, synthesized, along a curve, or live.

It holds no logic of its own: it runs the `motionkit` command, or reads the socket of `motionkit play --tcp PORT`. With
an armature selected, motion is made for that rig (`--rig`) and put on it; otherwise a body is imported.
Install: Edit, Preferences, Add-ons, Install from Disk. The panel is in the sidebar of the 3D view.
"""

import json
import math
import os
import shlex
import socket
import subprocess
import tempfile
import time
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

CONNECT_SECONDS = 1.0
PATIENCE = 15.0  # seconds without a frame, after which live mode ends
RECEIVE_BYTES = 1 << 18  # room for some frames: the server leaves out what we are too slow for
MOST_BYTES = 1 << 24  # of one line
TO_Z_UP = Matrix.Rotation(math.pi / 2, 4, "X")  # motionkit has Y up


def command_words(command):
    """The words of a command, which may stand in quotes; on Windows, paths have backslashes."""
    if os.name != "nt":
        return shlex.split(command)
    return [word.strip('"') for word in shlex.split(command, posix=False)]


def run(settings, *words):
    """Run a motionkit command; raises RuntimeError with its message if it fails."""
    command = [*command_words(settings.command), *map(str, words)]
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
    try:
        bpy.ops.export_anim.bvh(
            filepath=str(path),
            global_scale=100.0,
            frame_start=scene.frame_start,
            frame_end=scene.frame_start + 1,
        )
    finally:
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
    evaluated = curve.evaluated_get(context.evaluated_depsgraph_get())
    points = [curve.matrix_world @ vertex.co for vertex in evaluated.to_mesh().vertices]
    evaluated.to_mesh_clear()
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
    turns, made = {}, {}
    for index, (name, parent) in enumerate(zip(skeleton["joints"], skeleton["parents"], strict=True)):
        turn = Quaternion(character["rotations"][index])
        turns[index] = turns[parent] @ turn if parent >= 0 else turn
        bone = armature.pose.bones.get(name)
        if bone is not None:
            place = Matrix.Translation([value / 100.0 for value in character["positions"][index]])
            world = TO_Z_UP @ place @ turns[index].to_matrix().to_4x4() @ TO_Z_UP.inverted()
            wanted = world @ bone.bone.matrix_local.to_3x3().to_4x4()
            # Not by bone.matrix, for which all of the scene would have to be updated after every bone.
            before = Matrix.Identity(4)
            at_rest = bone.bone.matrix_local
            if bone.parent is not None:
                before = made.get(bone.parent.name, bone.parent.matrix)
                at_rest = bone.parent.bone.matrix_local.inverted() @ at_rest
            own = (before @ at_rest).inverted() @ wanted
            if bone.bone.use_connect:
                own.translation = (0.0, 0.0, 0.0)  # Blender ignores it
            bone.matrix_basis = own
            made[name] = before @ at_rest @ own
    bpy.context.view_layer.update()


class LiveClient:
    """A connection to `motionkit play --tcp` that never waits (docs/live.md); nothing here knows of Blender."""

    def __init__(self, port, clock=time.monotonic):
        """Connect; raises OSError where nothing listens."""
        self.clock = clock
        self.hello = None
        self._buffer, self._unsent = b"", b""
        self._heard = self._pinged = clock()
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=CONNECT_SECONDS)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        self._socket.setblocking(False)

    def close(self):
        """Leave the server."""
        self._socket.close()

    def newest(self):
        """The character to show, as in the newest frame that has arrived; None where none has.

        Raises:
            OSError: the server has ended, or is no motionkit play --tcp; the message says which.
        """
        self._ping()
        data, ended = self._arrived()
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        frame = None
        for line in lines:
            event = self._event(line)
            if event["event"] == "error" and event.get("closing"):
                raise ConnectionError(event["message"])
            if event["event"] == "hello":
                self.hello = event
            elif self.hello is None:
                raise ConnectionError("something other than motionkit play --tcp answers")
            elif event["event"] == "frame":
                frame = event
        if ended:
            raise ConnectionError("motionkit play has ended")
        if frame is not None:
            self._heard = self.clock()
        elif self.clock() - self._heard > PATIENCE:
            raise ConnectionError(f"no frame for {PATIENCE:g} s")
        return None if frame is None else self._chosen(frame["characters"])

    def _chosen(self, characters):
        """The first character that somebody else steers: the one that this connection was given only stands."""
        own = self.hello["character"]
        return next((one for one in characters if one["id"] != own), characters[0] if characters else None)

    def _arrived(self):
        """All bytes that have arrived, and whether these were the last."""
        data = b""
        while len(self._buffer) + len(data) <= MOST_BYTES:
            try:
                part = self._socket.recv(RECEIVE_BYTES)
            except BlockingIOError:
                return data, False
            if not part:
                return data, True
            data += part
        raise ConnectionError("something other than motionkit play --tcp answers")

    def _event(self, line):
        try:
            event = json.loads(line)
        except ValueError:
            event = None
        if not isinstance(event, dict) or "event" not in event:
            raise ConnectionError("something other than motionkit play --tcp answers")
        return event

    def _ping(self):
        """Send a ping in a third of the time after which a silent client may lose its place."""
        now = self.clock()
        if self.hello is not None and now - self._pinged > self.hello["limits"]["idle_seconds"] / 3.0:
            self._pinged = now
            self._unsent += b'{"do": "ping"}\n'
        if self._unsent:
            try:
                self._unsent = self._unsent[self._socket.send(self._unsent) :]
            except BlockingIOError:
                pass  # the rest goes next time


class MOTIONKIT_OT_live(bpy.types.Operator):
    """Show a character of a running motionkit play --tcp on the selected armature; Escape stops"""

    bl_idname = "motionkit.live"
    bl_label = "Live"

    def execute(self, context):
        self.armature = selected_armature(context)
        if self.armature is None:
            self.report({"ERROR"}, "select an armature that motionkit made (import a .glb)")
            return {"CANCELLED"}
        try:
            self.client = LiveClient(context.scene.motionkit.port)
        except OSError as error:
            self.report({"ERROR"}, f"no motionkit play --tcp {context.scene.motionkit.port}: {error}")
            return {"CANCELLED"}
        self.timer = context.window_manager.event_timer_add(1.0 / 60.0, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self.cancel(context)
            return {"FINISHED"}
        if event.type == "TIMER":
            try:
                character = self.client.newest()
                if character is not None:
                    pose(self.armature, self.client.hello, character)
            except (OSError, ReferenceError) as error:  # the latter where the armature was deleted
                self.cancel(context)
                self.report({"ERROR"}, f"live mode has stopped: {error}")
                return {"CANCELLED"}
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Called by Blender too, when it closes the window or opens another file."""
        context.window_manager.event_timer_remove(self.timer)
        self.client.close()


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
