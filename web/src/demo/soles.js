// The soles of a user's character, from the vertices of its own meshes, as rig/soles.py finds them.

import { Vector3 } from "three";

const MARGIN = 0.5; // cm by which the least depth of a sole below its joint is lower than a plausible stance
const DOWN = steps(60).flatMap((pitch) => steps(45).map((roll) => [Math.sin(roll), Math.cos(roll) * Math.cos(pitch), Math.cos(roll) * Math.sin(pitch)]));

/** The points (cm) of left foot, left toes, right foot and right toes that are the lowest at any tilt, and the depth of the soles below their joints; null if the meshes show no feet. */
export function solesOf(read, joints, rest, part) {
  const { differences, map, places, scale, tables } = rest;
  const sides = ["Left", "Right"].map((side) => {
    const [ankle, anchor] = [map[`${side}Foot`], map[side + part]];
    if (ankle === undefined || anchor === undefined) return null;
    const below = (joint) => new Set(joints.nodes.filter((_, one) => above(joints.parents, one).includes(joint)).map((node) => read.nodes[node]));
    const found = vertices(read, below(ankle), part === "ToeBase" ? below(anchor) : new Set());
    const [upright, flat] = ["Hips", `${side}Foot`].map((name) => differences[tables.names.indexOf(name)].clone().invert());
    for (const { point } of found) point.sub(places[anchor]).multiplyScalar(scale);
    const depth = -Math.min(...found.map(({ point }) => point.clone().applyQuaternion(upright).y));
    const [low, high] = tables.plausible[part];
    if (!(depth >= low - MARGIN && depth <= high)) return null;
    if (!found.some(({ moving }) => moving)) for (const { point } of found) point.add(places[anchor].clone().sub(places[ankle]).multiplyScalar(scale));
    const turned = found.map(({ point, moving }) => [moving, point.applyQuaternion(flat).toArray()]);
    return { depth, parts: [false, true].map((toes) => outermost(turned.flatMap(([moving, point]) => (moving === toes ? [point] : [])))) };
  });
  return sides.includes(null) ? null : { parts: sides.flatMap(({ parts }) => parts), depth: (sides[0].depth + sides[1].depth) / 2 };
}

/** Whether skin moves with bones beside the body, and whether all such is skin of feet; as _along of rig/on_rig.py. */
export function skinBeside(read, beside, feet) {
  const of = [];
  eachVertex(read, (share) => share(beside) > 0 && of.push(share(feet) > 0.5));
  return { any: of.length > 0, ofFeet: of.every(Boolean) };
}

// The vertices in the rest pose of which more than half moves with the bones of a foot, and whether half moves with its toes.
function vertices(read, foot, toes) {
  const out = [];
  eachVertex(read, (share, mesh, vertex) => {
    if (share(foot) <= 0.5) return;
    const point = mesh.applyBoneTransform(vertex, new Vector3().fromBufferAttribute(mesh.geometry.attributes.position, vertex));
    out.push({ point: mesh.localToWorld(point), moving: share(toes) >= 0.5 });
  });
  return out;
}

// Calls a function with each vertex of a skin, and a function that says what share of it moves with some bones.
function eachVertex(read, visit) {
  for (const scene of read.scenes) scene.traverse((mesh) => {
    if (!mesh.isSkinnedMesh) return;
    const { position, skinIndex, skinWeight } = mesh.geometry.attributes;
    const share = (vertex) => (bones) => [0, 1, 2, 3].reduce((sum, k) => sum + (bones.has(mesh.skeleton.bones[skinIndex.getComponent(vertex, k)]) ? skinWeight.getComponent(vertex, k) : 0), 0);
    for (let vertex = 0; vertex < position.count; vertex++) visit(share(vertex), mesh, vertex);
  });
}

function outermost(points) {
  const height = (down, [x, y, z]) => down[0] * x + down[1] * y + down[2] * z;
  const lowest = (down) => points.reduce((least, point) => (height(down, point) < height(down, least) ? point : least), points[0]);
  return points.length ? [...new Set(DOWN.map(lowest))] : [];
}

function above(parents, joint) {
  return joint < 0 ? [] : [...above(parents, parents[joint]), joint];
}

// Angles every five degrees between a negative and a positive one, in radians.
function steps(degrees) {
  return Array.from({ length: (2 * degrees) / 5 + 1 }, (_, n) => ((5 * n - degrees) * Math.PI) / 180);
}
