// Puts a character that was saved in a pose back into the pose its skin is bound in, as rig/gltf_nodes.py finds it.

import { Matrix4, Quaternion, Vector3 } from "three";

const POSED = { degrees: 5, share: 0.02 };
const MOST_TURNED = 45;

/** Moves the nodes of scenes into the bind pose of their skins, unless they are in it. */
export function toBindPose(scenes) {
  const bound = new Map();
  for (const scene of scenes) {
    scene.updateMatrixWorld(true);
    scene.traverse(({ skeleton }) => skeleton && boundOf(skeleton).forEach((world, bone) => bound.has(bone) || bound.set(bone, world)));
  }
  if (!bound.size) return;
  for (const scene of scenes) {
    scene.traverse((node) => {
      const above = node.parent?.matrixWorld ?? new Matrix4();
      const own = bound.get(node);
      if (own) above.clone().invert().multiply(own).decompose(node.position, node.quaternion, node.scale);
      node.updateMatrix();
      node.matrixWorld.multiplyMatrices(above, node.matrix);
    });
  }
}

// The world matrices in which the bones of a skeleton are bound; none if they have these.
function boundOf({ bones, boneInverses }) {
  const out = new Map();
  if (!bones.length || boneInverses.some((inverse) => !(Math.abs(inverse.determinant()) > 0))) return out;
  const spaces = bones.map((bone, n) => bone.matrixWorld.clone().multiply(boneInverses[n]));
  const depth = (node) => (node ? 1 + depth(node.parent) : 0);
  const depths = bones.map(depth);
  const top = depths.indexOf(Math.min(...depths));
  const places = boneInverses.map((inverse) => new Vector3().setFromMatrixPosition(inverse.clone().invert()));
  const reach = Math.max(...["x", "y", "z"].map((axis) => Math.max(...places.map((place) => place[axis])) - Math.min(...places.map((place) => place[axis]))));
  const off = spaces.map((space) => apart(spaces[top], space));
  if (off.every(([degrees, way]) => degrees < POSED.degrees && way < POSED.share * reach)) return out;
  const usual = [new Matrix4(), bones[top].parent?.matrixWorld ?? new Matrix4()];
  const turns = usual.map((space) => apart(space, spaces[top])[0]);
  const least = Math.min(...turns);
  const space = least < MOST_TURNED ? usual[turns.indexOf(least)] : spaces[top];
  bones.forEach((bone, n) => out.set(bone, space.clone().multiply(boneInverses[n].clone().invert())));
  return out;
}

// Degrees and distance between two transforms; the degrees are infinite where their scales differ.
function apart(one, other) {
  const [place, turn, scale] = [new Vector3(), new Quaternion(), new Vector3()];
  one.clone().invert().multiply(other).decompose(place, turn, scale);
  const alike = scale.toArray().every((size) => size > 0.98 && size < 1.02);
  return alike ? [(180 / Math.PI) * new Quaternion().angleTo(turn), place.length()] : [Infinity, Infinity];
}
