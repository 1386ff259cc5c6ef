// A recording as a BVH file, with the joints, the channels and the digits that motionkit writes (motion/bvh.py).

const DEGREES = 180 / Math.PI;
const POSITIONS = ["Xposition", "Yposition", "Zposition"];
const ROTATIONS = ["Zrotation", "Yrotation", "Xrotation"];

/** @param {{joints: string[], parents: number[], offsets: number[][], ends: object}} skeleton in cm @param {{root: Float32Array, rotations: Float32Array}[]} frames */
export function bvhText(skeleton, frames, fps) {
  const order = depthFirst(skeleton.parents);
  const lines = ["HIERARCHY", ...hierarchy(skeleton, 0, ""), "MOTION", `Frames: ${frames.length}`];
  lines.push(`Frame Time: ${Number((1 / fps).toPrecision(9))}`);
  const angles = skeleton.joints.map(() => [0, 0, 0]);
  frames.forEach(({ root, rotations }, frame) => {
    const numbers = [...root];
    for (const joint of order) {
      angles[joint] = eulers(rotations.subarray(4 * joint, 4 * joint + 4), frame ? angles[joint] : null);
      numbers.push(...angles[joint].map((angle) => angle * DEGREES));
    }
    lines.push(numbers.map((number) => number.toFixed(6)).join(" "));
  });
  return `${lines.join("\n")}\n`;
}

function depthFirst(parents, joint = 0) {
  return [joint, ...children(parents, joint).flatMap((child) => depthFirst(parents, child))];
}

const children = (parents, joint) => parents.flatMap((parent, child) => (parent === joint ? [child] : []));

function hierarchy(skeleton, joint, tab) {
  const { joints, parents, offsets, ends } = skeleton;
  const offset = (numbers) => `OFFSET ${numbers.map((number) => number.toFixed(6)).join(" ")}`;
  const channels = joint ? ROTATIONS : [...POSITIONS, ...ROTATIONS];
  const below = children(parents, joint).flatMap((child) => hierarchy(skeleton, child, `${tab}\t`));
  const end = ends[joint] ?? (below.length ? null : [0, 0, 0]);
  if (end) below.push(`${tab}\tEnd Site`, `${tab}\t{`, `${tab}\t\t${offset(end)}`, `${tab}\t}`);
  return [
    `${tab}${joint ? "JOINT" : "ROOT"} ${joints[joint]}`, `${tab}{`, `${tab}\t${offset(offsets[joint])}`,
    `${tab}\tCHANNELS ${channels.length} ${channels.join(" ")}`, ...below, `${tab}}`,
  ];
}

// Angles about Z, Y and X of a quaternion; of two equivalent triples, the one nearer to that of the frame before.
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
