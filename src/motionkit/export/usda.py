"""Writes motions as USD text (.usda) with UsdSkel: skeleton, skinned body and animation, in metres with +Y up.

Translations, rotations and scales must have samples at the same frames: otherwise Blender reads no animation.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from motionkit.arrays import Array
from motionkit.export.clip import Clip
from motionkit.export.figure import Figure, make_figure, materials, skin_weights
from motionkit.files import atomic_write
from motionkit.motion.rotations import quat_to_matrix
from motionkit.motion.skeleton import Skeleton


def write_usda(path: str | Path, clip: Clip) -> None:
    """Write a motion of any rig as a .usda file, atomically."""
    figure = make_figure(clip.motion, clip.new_body)
    with atomic_write(path) as file:
        for line in _lines(figure, clip):
            file.write(line + "\n")


def joint_paths(skeleton: Skeleton) -> list[str]:
    """For each joint a unique path of valid USD names, from the root to the joint."""
    names: list[str] = []
    for name in skeleton.names:
        word = re.sub(r"[^A-Za-z0-9_]", "_", name)
        word = word if word and not word[0].isdigit() else f"_{word}"
        while word in names:
            word += "_"
        names.append(word)
    paths: list[str] = []
    for name, parent in zip(names, skeleton.parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def _quoted(name: str) -> str:
    """A joint's own name as a string of USD, which paths may have only in part."""
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _lines(figure: Figure, clip: Clip) -> Iterable[str]:
    motion = figure.motion
    paths = joint_paths(motion.skeleton)
    joints = "[" + ", ".join(f'"{path}"' for path in paths) + "]"
    rest = np.tile(np.eye(4), (len(paths), 1, 1))
    turns, rest[:, :3, 3] = figure.rest_locals()
    rest[:, :3, :3] = quat_to_matrix(turns)
    yield from (
        "#usda 1.0", "(", '    defaultPrim = "Motion"', "    metersPerUnit = 1", '    upAxis = "Y"',
        "    startTimeCode = 0", f"    endTimeCode = {len(motion) - 1}", f"    timeCodesPerSecond = {motion.fps:.9g}",
        f"    framesPerSecond = {motion.fps:.9g}", ")", "", 'def SkelRoot "Motion" (',
        '    prepend apiSchemas = ["SkelBindingAPI"]', ")", "{",
        '    def Skeleton "Skeleton" (', '        prepend apiSchemas = ["SkelBindingAPI"]', "    )", "    {",
        f"        uniform token[] joints = {joints}",
        f"        uniform token[] jointNames = [{', '.join(map(_quoted, motion.skeleton.names))}]",
        f"        uniform matrix4d[] bindTransforms = {_matrix_list(figure.binds)}",
        f"        uniform matrix4d[] restTransforms = {_matrix_list(rest)}",
        "        rel skel:animationSource = </Motion/Skeleton/Animation>", "",
        '        def SkelAnimation "Animation"', "        {",
        f"            uniform token[] joints = {joints}",
    )  # fmt: skip
    rotations, translations = figure.locals()
    ones = np.ones((len(motion), len(paths), 3))
    yield from _samples("float3[] translations", translations)
    yield from _samples("quatf[] rotations", rotations)
    yield from _samples("half3[] scales", ones)
    yield from ("        }", "    }", "")
    yield from _mesh(figure)
    yield from _materials(figure)
    yield "}"


def _mesh(figure: Figure) -> Iterable[str]:
    surface = figure.surface
    joints, weights = skin_weights(surface)
    points = surface.points
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    yield from (
        '    def Mesh "Body" (',
        '        prepend apiSchemas = ["SkelBindingAPI", "MaterialBindingAPI"]', "    )", "    {",
        f"        int[] faceVertexCounts = {_flat([3] * len(surface.triangles))}",
        f"        int[] faceVertexIndices = {_flat(surface.triangles.reshape(-1).tolist())}",
        f"        point3f[] points = {_tuples(points)}",
        f"        float3[] extent = {_tuples(extent)}",
        f"        normal3f[] normals = {_tuples(figure.normals)} (", '            interpolation = "vertex"',
        "        )", '        uniform token subdivisionScheme = "none"',
        f"        int[] primvars:skel:jointIndices = {_flat(joints.reshape(-1).tolist())} (",
        "            elementSize = 4", '            interpolation = "vertex"', "        )",
        f"        float[] primvars:skel:jointWeights = {_flat(weights.reshape(-1).tolist())} (",
        "            elementSize = 4", '            interpolation = "vertex"', "        )",
        f"        matrix4d primvars:skel:geomBindTransform = {_matrix(np.eye(4))}",
        "        rel skel:skeleton = </Motion/Skeleton>",
        '        uniform token subsetFamily:materialBind:familyType = "partition"',
    )  # fmt: skip
    for name, _, triangles in materials(surface):
        yield from (
            f'        def GeomSubset "{name}" (', '            prepend apiSchemas = ["MaterialBindingAPI"]',
            "        )", "        {", '            uniform token elementType = "face"',
            '            uniform token familyName = "materialBind"',
            f"            int[] indices = {_flat(triangles.tolist())}",
            f"            rel material:binding = </Motion/Materials/{name}>", "        }",
        )  # fmt: skip
    yield "    }"


def _materials(figure: Figure) -> Iterable[str]:
    yield from ('    def Scope "Materials"', "    {")
    for name, color, _ in materials(figure.surface):
        surface = f"</Motion/Materials/{name}/Surface.outputs:surface>"
        yield from (
            f'        def Material "{name}"', "        {",
            f"            token outputs:surface.connect = {surface}",
            '            def Shader "Surface"', "            {",
            '                uniform token info:id = "UsdPreviewSurface"',
            f"                color3f inputs:diffuseColor = {_tuple(color)}",
            "                float inputs:roughness = 0.8", "                token outputs:surface", "            }",
            "        }",
        )  # fmt: skip
    yield "    }"


def _samples(name: str, values: Array) -> Iterable[str]:
    yield f"            {name}.timeSamples = {{"
    for frame, rows in enumerate(values):
        yield f"                {frame}: {_tuples(rows)},"
    yield "            }"


def _number(value: float) -> str:
    return f"{value:.7g}"


def _tuple(values: Sequence[float]) -> str:
    return "(" + ", ".join(map(_number, values)) + ")"


def _tuples(rows: Array) -> str:
    return "[" + ", ".join(map(_tuple, rows.tolist())) + "]"


def _flat(values: Sequence[float]) -> str:
    return "[" + ", ".join(map(_number, values)) + "]"


def _matrix(matrix: Array) -> str:
    """A matrix (4, 4) that acts on columns as USD text; USD matrices act on rows."""
    return "(" + ", ".join(map(_tuple, matrix.T.tolist())) + ")"


def _matrix_list(matrices: Array) -> str:
    return "[" + ", ".join(map(_matrix, matrices)) + "]"
