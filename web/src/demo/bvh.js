// Writes a recording as a BVH file, with as many digits as motion/bvh.py, which made the hierarchy text.

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
  const [a00, a10] = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z)];
  const last = Math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y));
  const first = [Math.atan2(a10, a00), Math.atan2(2 * (w * y - z * x), Math.hypot(a00, a10)), last];
  if (!before) return first;
  const second = [first[0] + Math.PI, Math.PI - first[1], first[2] + Math.PI];
  const near = (angles) => angles.map((angle, n) => angle + 2 * Math.PI * Math.round((before[n] - angle) / (2 * Math.PI)));
  const away = (angles) => angles.reduce((sum, angle, n) => sum + Math.abs(angle - before[n]), 0);
  const [a, b] = [near(first), near(second)];
  return away(a) <= away(b) ? a : b;
}
