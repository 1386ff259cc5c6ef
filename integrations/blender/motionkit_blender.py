"""Blender add-on: motion by motionkit, synthesized, along a curve, or live.

It holds no logic of its own: it runs the `motionkit` command, or reads the socket of `motionkit play --tcp PORT`. With
an armature selected, motion is made for that rig (`--rig`) and put on it; otherwise a body is imported.
Install: Edit, Preferences, Add-ons, Install from Disk. The panel is in the sidebar of the 3D view.
"""

import contextlib
import json
import math
import os
import shlex
import socket
import struct
import subprocess
import tempfile
import time
from array import array
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import bpy
from mathutils import Euler, Matrix, Quaternion, Vector

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
LEG = 0.8341  # m, thigh plus shin of motionkit's canonical skeleton
STILL = 1e-4  # radians
LINEAR = 1  # the number of this interpolation in keyframes
TO_Z_UP = Matrix.Rotation(math.pi / 2, 4, "X")  # motionkit has Y up


def command_words(command):
    """The words of a command, which may stand in quotes; on Windows, paths have backslashes."""
    if os.name != "nt":
        return shlex.split(command)
    return [word.strip('"') for word in shlex.split(command, posix=False)]


def run(settings, folder, *words):
    """Run a motionkit command on files of a folder; returns what it prints; raises RuntimeError with its message."""
    try:
        command = [*command_words(settings.command), *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise RuntimeError(f"motionkit cannot be run: {error}") from None
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["motionkit failed"])[-1]
        raise RuntimeError(
            said.removeprefix("error: ").removeprefix("Error: ").replace(f"{folder}{os.sep}", "")
        )
    return done.stdout


def selected_armature(context):
    """The active armature, or the one that moves the active mesh; None without one."""
    active = context.view_layer.objects.active
    if active is None or not active.select_get():
        return None
    return active if active.type == "ARMATURE" else active.find_armature()


def make(context, request, begin=True):
    """Run a command that writes a motion, and put it on the selected armature or import it; returns what moves.

    `request(ground, folder)` gives the words of the command. If `begin`, the motion begins where the armature's hips
    are at the first frame of the scene; otherwise its own path says where.
    """
    scene, target = context.scene, selected_armature(context)
    settings = scene.motionkit
    words = ["--seed", settings.seed, "--fps", scene.render.fps / scene.render.fps_base]
    if settings.model:
        words += ["--model", bpy.path.abspath(settings.model)]
    with tempfile.TemporaryDirectory() as folder, at_first_frame(scene):
        if target is None:
            file = Path(folder, "motion.glb")
            run(settings, folder, *request(Ground(), folder), *words, "-o", file)
            bpy.ops.import_scene.gltf(filepath=str(file), bone_heuristic="TEMPERANCE")
            target = context.view_layer.objects.active
            from_first_frame(scene, target.animation_data.action)
            return target
        rig = ask_rig(settings, target, folder)
        ground = Ground(target, rig, begin)
        bare, file, to = Path(folder, "rig.glb"), Path(folder, "motion.bvh"), ground.from_armature
        bare.write_bytes(rest_glb(rig.bones, to, bound_vertices(context, target, rig.bones, to)))
        run(settings, folder, *request(ground, folder), *words, "--rig", bare, "-o", file)
        poses = pose_matrices(rig, ground, joint_matrices(rig.bones, file.read_text("utf-8")), begin)
        put_on(scene, target, rig, poses, file.stem)
    return target


@contextlib.contextmanager
def at_first_frame(scene):
    """Show the first frame of the scene meanwhile."""
    shown = scene.frame_current
    scene.frame_set(scene.frame_start)
    try:
        yield
    finally:
        scene.frame_set(shown)


class Rig(NamedTuple):
    """The bones that motionkit may move, parents first; those of its joints by name; thigh plus shin in their unit."""

    bones: list
    joints: dict
    leg: float


def ask_rig(settings, target, folder):
    """The rig of an armature, as motionkit reads it; raises RuntimeError if it is not a human one."""
    trees = [with_children(bone) for bone in target.data.bones if bone.parent is None]
    if not trees:
        raise RuntimeError(f"{target.name} has no bones")
    bones = max(trees, key=len)
    bare = Path(folder, f"{bpy.path.clean_name(target.name)}.glb")
    bare.write_bytes(rest_glb(bones, Matrix.Identity(4)))
    try:
        told = json.loads(run(settings, folder, "retarget", "--rig", bare, "--json"))
    except ValueError:
        raise RuntimeError(f"{settings.command} is not motionkit") from None
    joints = {name: bone for bone, name in zip(bones, told["joints"].values(), strict=True) if name}
    return Rig(bones, joints, told["leg"])


def with_children(bone):
    """A bone and all below it, depth first."""
    return [bone, *(each for child in bone.children for each in with_children(child))]


class Ground:
    """Motionkit's space: m of a body with its legs, Y up from the ground, from where a motion begins ahead along +Z.

    The ground is the plane through the armature's origin, ahead is where the armature faces in its rest pose, and all
    moves, turns and scales with the armature's object. Without an armature it is that of the world.
    """

    def __init__(self, target=None, rig=None, begin=False):
        """Of an armature, from its hips at the present frame if `begin`, else from its origin."""
        if target is None:
            self.from_world = self.from_armature = TO_Z_UP.inverted()
            return
        heads = {name: bone.head_local for name, bone in rig.joints.items()}
        hips, arms = (heads[f"Left{part}"] + heads[f"Right{part}"] for part in ("UpLeg", "Arm"))
        axis = max(range(3), key=lambda each: abs((arms - hips)[each]))
        up = Vector([0.0, 0.0, 0.0])
        up[axis] = math.copysign(1.0, (arms - hips)[axis])
        ahead = (heads["LeftUpLeg"] - heads["RightUpLeg"]).cross(up).normalized()
        turn = Matrix((up.cross(ahead), up, ahead)).to_4x4()
        place = target.pose.bones[rig.joints["Hips"].name].head if begin else Vector()
        origin = Matrix.Translation(up * place.dot(up) - place)
        self.from_armature = Matrix.Scale(LEG / rig.leg, 4) @ turn @ origin
        try:
            self.from_world = self.from_armature @ target.matrix_world.inverted()
        except ValueError:
            raise RuntimeError(f"{target.name} has a scale of zero") from None

    def place(self, point):
        """A point of the world as motionkit's x, z in metres."""
        x, _, z = self.from_world @ point
        return [x, z]

    def speed(self, speed):
        """A speed in the world as motionkit's in m/s."""
        return speed * abs(self.from_world.determinant()) ** (1.0 / 3.0)


def rest_glb(bones, to, skin=None):
    """A binary glTF file of bones in the rest pose, turned to the axes of the world, in the space of a matrix.

    `skin` has what bound_vertices returns, in that space, from which motionkit knows the soles.
    """
    heads, at = [to @ bone.head_local for bone in bones], {bone: each for each, bone in enumerate(bones)}
    document, data = {"asset": {"version": "2.0"}, "nodes": []}, b""
    for bone, head in zip(bones, heads, strict=True):
        node = {"name": bone.name, "translation": [*(head - heads[at[bone.parent]] if bone.parent else head)]}
        if bone.children:
            node["children"] = [at[child] for child in bone.children]
        else:
            node["extras"] = {"end_site": [*(to @ bone.tail_local - head)]}
        document["nodes"].append(node)
    if skin is not None and skin[0]:
        binds = [value for x, y, z in heads for value in (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -x, -y, -z, 1)]
        names, kinds = ("POSITION", "JOINTS_0", "WEIGHTS_0"), {3: "VEC3", 4: "VEC4", 16: "MAT4"}
        lists = document["accessors"], document["bufferViews"] = [], []
        for values, width in zip((*skin, array("f", binds)), (3, 4, 4, 16), strict=True):
            what = {"componentType": 5126 if values.typecode == "f" else 5123, "type": kinds[width]}
            lists[0].append({"bufferView": len(lists[0]), "count": len(values) // width, **what})
            lists[1].append({"buffer": 0, "byteOffset": len(data), "byteLength": len(values.tobytes())})
            data += values.tobytes()
        points = {"mode": 0, "attributes": dict(zip(names, range(3), strict=True))}
        document["meshes"], document["buffers"] = [{"primitives": [points]}], [{"byteLength": len(data)}]
        document["skins"] = [{"joints": [*range(len(bones))], "inverseBindMatrices": 3}]
        document["nodes"].append({"mesh": 0, "skin": 0})
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x4E4942) + data
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def bound_vertices(context, target, bones, to):
    """The places of the vertices that bones move in the rest pose, by a matrix, and four joints and weights of each."""
    at = {bone.name: each for each, bone in enumerate(bones)}
    places, joints, weights = array("f"), array("H"), array("f")
    shown, target.data.pose_position = target.data.pose_position, "REST"
    try:
        graph = context.evaluated_depsgraph_get()
        for item in context.scene.objects:
            if item.type != "MESH" or item.find_armature() != target:
                continue
            evaluated = item.evaluated_get(graph)
            place = to @ target.matrix_world.inverted() @ evaluated.matrix_world
            groups = [at.get(group.name) for group in item.vertex_groups]
            for vertex in evaluated.to_mesh().vertices:
                bound = [(each.weight, groups[each.group]) for each in vertex.groups]
                most = sorted(
                    (pair for pair in bound if pair[1] is not None and pair[0] > 0.0), reverse=True
                )[:4]
                if most:
                    most += [(0.0, 0)] * (4 - len(most))
                    places.extend(place @ vertex.co)
                    joints.extend(joint for _, joint in most)
                    weights.extend(weight for weight, _ in most)
            evaluated.to_mesh_clear()
    finally:
        target.data.pose_position = shown
    return places, joints, weights


def joint_matrices(bones, text):
    """The matrices of the joints by name, for each frame of a BVH file of the hierarchy of rest_glb."""
    head, _, rows = text.rpartition("\nMOTION\n")
    lines = [line.split() for line in head.splitlines()]
    joints = [  # an OFFSET without CHANNELS is that of an End Site
        (Vector(map(float, line[1:])), after[1] == "6")
        for line, after in pairwise(lines)
        if line[0] == "OFFSET" and after[0] == "CHANNELS"
    ]
    for row in filter(None, rows.splitlines()[2:]):
        values = iter(map(float, row.split()))
        made = {}
        for bone, (offset, free) in zip(bones, joints, strict=True):
            place = Vector([next(values) for _ in range(3)]) if free else offset
            z, y, x = (math.radians(next(values)) for _ in range(3))
            own = Matrix.Translation(place) @ Euler((x, y, z)).to_matrix().to_4x4()
            made[bone.name] = made[bone.parent.name] @ own if bone.parent else own
            if bone.parent and bone.use_connect and free:  # Blender moves it by the bones above only
                above = made[bone.parent.name]
                gap = Matrix.Translation(above.to_3x3() @ (place - offset))
                made.update({name: gap @ made[name] for name in made if name != bone.name})
        yield made


def pose_matrices(rig, ground, frames, begin):
    """The basis matrices of the bones by name for each frame; if `begin`, the hips begin where they were."""
    at_rest = {bone.name: ground.from_armature @ bone.matrix_local for bone in rig.bones}
    back, start, out = ground.from_armature.inverted(), None, []
    for joints in frames:
        if start is None:
            x, _, z = joints[rig.joints["Hips"].name].translation if begin else Vector()
            start = back @ Matrix.Translation((-x, 0.0, -z))
        posed, basis = {}, {}
        for bone in rig.bones:
            rest, above = at_rest[bone.name], bone.parent
            turned = start @ joints[bone.name] @ Matrix.Translation(-rest.translation) @ rest
            posed[bone.name] = turned
            own = (
                {}
                if above is None
                else {"parent_matrix": posed[above.name], "parent_matrix_local": above.matrix_local}
            )
            basis[bone.name] = bone.convert_local_to_pose(turned, bone.matrix_local, invert=True, **own)
        out.append(basis)
    return out


def put_on(scene, target, rig, poses, name):
    """Give an armature a new action with basis matrices of its bones for each frame, from the first of the scene."""
    tracks = bone_tracks(target, rig, poses)
    data = target.animation_data or target.animation_data_create()
    if data.use_tweak_mode:
        raise RuntimeError(f"{target.name}: leave the tweak mode of the NLA editor first")
    data.action = action = bpy.data.actions.new(name)
    for (bone, path), values in tracks.items():
        where = f'pose.bones["{bpy.utils.escape_identifier(bone)}"].{path}'
        for index, column in enumerate(zip(*values, strict=True)):
            points = new_curve(action, target, where, index, bone).keyframe_points
            points.add(len(column))
            pairs = [number for at, value in enumerate(column) for number in (scene.frame_start + at, value)]
            points.foreach_set("co", pairs)
            points.foreach_set("interpolation", [LINEAR] * len(column))
    scene.frame_end = max(scene.frame_end, scene.frame_start + len(poses) - 1)


def from_first_frame(scene, action):
    """Move an imported action, which begins at frame 0, to the first frame of the scene."""
    for curve in curves_of(action):
        for point in curve.keyframe_points:
            point.co_ui.x += scene.frame_start
    scene.frame_end = max(scene.frame_end, math.ceil(action.frame_range[1]))


def curves_of(action):
    """The curves of an action; Blender 5 has them in slots only."""
    if hasattr(action, "fcurves"):
        return action.fcurves
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for bag in bags for curve in bag.fcurves]


def new_curve(action, target, path, index, group):
    """A curve of an action that an armature has; Blender 5 has curves in slots only."""
    if hasattr(action, "fcurve_ensure_for_datablock"):
        return action.fcurve_ensure_for_datablock(target, path, index=index, group_name=group)
    return action.fcurves.new(path, index=index, action_group=group)


def bone_tracks(target, rig, poses):
    """The values of each frame, by bone and property. Bones that rest and carry no joint of motionkit have none."""
    near = 1e-4 * rig.leg
    turning, moving = {bone.name for bone in rig.joints.values()}, set()
    for basis in poses:
        for name, matrix in basis.items():
            if matrix.to_quaternion().angle > STILL:
                turning.add(name)
            if matrix.translation.length > near:
                moving.add(name)
    out = {}
    for bone in rig.bones:
        below = {each.name for each in with_children(bone)}
        own = [basis[bone.name] for basis in poses]
        if not below.isdisjoint(turning):
            mode = target.pose.bones[bone.name].rotation_mode
            path, values = turns([matrix.to_quaternion() for matrix in own], mode)
            out[bone.name, path] = values
        if not below.isdisjoint(moving) and not (bone.use_connect and bone.parent):
            out[bone.name, "location"] = [matrix.translation for matrix in own]
    return out


def turns(quaternions, mode):
    """Rotations as the property of a bone's rotation mode and its values, without leaps."""
    before, out = None, []
    for turn in quaternions:
        if mode in ("QUATERNION", "AXIS_ANGLE"):
            if before is not None:
                turn.make_compatible(before)
            before = turn
            axis, angle = turn.to_axis_angle()
            out.append(turn if mode == "QUATERNION" else (angle, *axis))
        else:
            before = turn.to_euler(mode) if before is None else turn.to_euler(mode, before)
            out.append(before)
    return {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}.get(
        mode, "rotation_euler"
    ), out


def curve_points(context, curve, ground):
    """The points of a curve on the ground."""
    evaluated = curve.evaluated_get(context.evaluated_depsgraph_get())
    points = [ground.place(curve.matrix_world @ vertex.co) for vertex in evaluated.to_mesh().vertices]
    evaluated.to_mesh_clear()
    return points


def marker_keys(scene, ground):
    """Keys for motionkit: at each timeline marker that has the name of an object, the hips are over that object."""
    rate = scene.render.fps / scene.render.fps_base
    places = [(mark.frame, scene.objects.get(mark.name)) for mark in scene.timeline_markers]
    keys = [
        {"time": (frame - scene.frame_start) / rate, "position": ground.place(item.matrix_world.translation)}
        for frame, item in sorted(places, key=lambda place: place[0])
        if item is not None
    ]
    if not keys:
        raise RuntimeError("no timeline marker has the name of an object; give one the name of an empty")
    return {"keys": keys}


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
    model: bpy.props.StringProperty(
        name="Model", subtype="FILE_PATH", description="Model file of your own; the bundled model by default"
    )
    seed: bpy.props.IntProperty(name="Seed", default=0, min=0)
    loop: bpy.props.BoolProperty(name="Loop", description="One closed cycle of a gait or dance")
    markers: bpy.props.BoolProperty(
        name="Keys from markers",
        description="Be over an object at the time of each timeline marker that has the object's name",
    )
    curve: bpy.props.PointerProperty(
        name="Curve", type=bpy.types.Object, poll=lambda self, item: item.type == "CURVE"
    )
    gait: bpy.props.StringProperty(name="Gait", default="walking", description="Motion type along the curve")
    speed: bpy.props.FloatProperty(
        name="Speed", min=0.0, description="Along the curve, m/s; 0 is the type's own"
    )
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
        settings = context.scene.motionkit

        def request(ground, folder):
            words = ["synthesize", "--types", settings.types, *(["--loop"] if settings.loop else [])]
            if settings.markers:
                keys = Path(folder, "keys.json")
                keys.write_text(json.dumps(marker_keys(context.scene, ground)))
                words += ["--keys", keys]
            return words

        return make(context, request)


class MOTIONKIT_OT_follow_curve(Work):
    """Follow the curve on the ground, on the selected armature or on a new body"""

    bl_idname = "motionkit.follow_curve"
    bl_label = "Follow curve"

    def work(self, context):
        settings = context.scene.motionkit
        if settings.curve is None:
            raise RuntimeError("choose a curve to follow")

        def request(ground, folder):
            points = curve_points(context, settings.curve, ground)
            part = {"type": settings.gait, "points": points}
            if settings.speed:
                part["speed"] = ground.speed(settings.speed)
            path = Path(folder, "path.json")
            path.write_text(json.dumps({"parts": [part]}))
            return ["follow-path", path]

        return make(context, request, begin=False)


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
        for name in ("command", "model", "seed", "types", "loop", "markers"):
            self.layout.prop(settings, name)
        self.layout.operator("motionkit.synthesize")
        for name in ("curve", "gait", "speed"):
            self.layout.prop(settings, name)
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
