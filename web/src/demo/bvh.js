// Writes a recording as a BVH file, with as many digits as motion/bvh.py, which made the hierarchy text.

import { Euler, Quaternion } from "three";

const DEGREES = 180 / Math.PI;

/** The text of a BVH file. @param {{hierarchy: string, order: number[]}} bvh joints in channel order @param {{root: Float32Array, rotations: Float32Array}[]} frames in cm */
export function bvhText({ hierarchy, order }, frames, fps) {
  const lines = ["MOTION", `Frames: ${frames.length}`, `Frame Time: ${Number((1 / fps).toPrecision(9))}`];
  const angles = order.map(() => null);
  for (const { root, rotations } of frames) {
    const numbers = [...root];
    for (const joint of order) {
      angles[joint] = eulers(rotations.subarray(4 * joint, 4 * joint + 4), angles[joint]);
      numbers.push(...angles[joint].map((angle) => angle * DEGREES));
    }
    lines.push(numbers.map((number) => number.toFixed(6)).join(" "));
  }
  return `${hierarchy}${lines.join("\n")}\n`;
}

// Angles about Z, Y and X of a quaternion; of the two equivalent triples, the one closer to the previous frame's.
function eulers([w, x, y, z], before) {
  const turn = new Euler().setFromQuaternion(new Quaternion(x, y, z, w).normalize(), "ZYX");
  const first = [turn.z, turn.y, turn.x];
  if (!before) return first;
  const second = [first[0] + Math.PI, Math.PI - first[1], first[2] + Math.PI];
  const near = (angles) => angles.map((angle, n) => angle + 2 * Math.PI * Math.round((before[n] - angle) / (2 * Math.PI)));
  const away = (angles) => angles.reduce((sum, angle, n) => sum + Math.abs(angle - before[n]), 0);
  const [a, b] = [near(first), near(second)];
  return away(a) <= away(b) ? a : b;
}
