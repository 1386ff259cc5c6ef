// A skeleton and its forward kinematics.

import { Hero, readCharacter } from "./hero.js";
import { bytesOf, unpack } from "./pack.js";

export class Rig {
  /** The rig of figure_data: names, hierarchy, offsets, and the body around it, in metres, or the hero in its place. */
  static async from(data) {
    const rig = new Rig();
    rig.names = data.joints;
    rig.parents = data.parents;
    rig.sides = data.sides;
    rig.bones = data.bones;
    rig.ends = data.ends;
    rig.hips = data.hips;
    rig.stature = data.stature;
    Object.assign(rig, data.bone); // the demo's own .glb has bones with axes of their own
    rig.offsets = await unpack(data.offsets);
    const { body } = data;
    rig.hero = data.hero && { bytes: () => bytesOf(data.hero.data).buffer, ...data.hero };
    rig.body = body && {
      points: (await unpack(body.points)),
      triangles: await unpack(body.triangles),
      joints: await unpack(body.joints),
      weights: await unpack(body.weights),
      normals: await unpack(body.normals),
      regions: await unpack(body.regions),
      shades: body.shades,
      rotations: await unpack(body.rotations),
      places: await unpack(body.places),
    };
    return rig;
  }

  get count() {
    return this.names.length;
  }

  /** A user's character for one more figure; null for a rig with a body. */
  async newHero() {
    return this.hero ? new Hero(await readCharacter(await this.hero.bytes()), this.hero) : null;
  }

  newPose() {
    return new Pose(this.count);
  }
}

/** Rotations (w, x, y, z) and positions of all joints in the world. */
export class Pose {
  constructor(count) {
    this.rotations = new Float32Array(count * 4);
    this.places = new Float32Array(count * 3);
  }

  /**
   * Forward kinematics.
   * @param {Rig} rig
   * @param {ArrayLike<number>} turns local quaternions of any length but zero, from index `at` on
   * @param {number} at
   * @param {ArrayLike<number>} root position of the root joint, from index `rootAt` on
   * @param {number} rootAt
   * @param {ArrayLike<number>} offsets positions of the joints relative to their parents
   */
  set(rig, turns, at, root, rootAt, offsets = rig.offsets) {
    const { rotations: q, places: p } = this;
    for (let joint = 0; joint < rig.count; joint++) {
      const i = at + joint * 4;
      const o = joint * 4;
      const norm = 1 / Math.hypot(turns[i], turns[i + 1], turns[i + 2], turns[i + 3]);
      const w = turns[i] * norm;
      const x = turns[i + 1] * norm;
      const y = turns[i + 2] * norm;
      const z = turns[i + 3] * norm;
      const parent = rig.parents[joint];
      if (parent < 0) {
        q.set([w, x, y, z], o);
        p.set([root[rootAt], root[rootAt + 1], root[rootAt + 2]], joint * 3);
        continue;
      }
      const u = parent * 4;
      const [a, b, c, d] = [q[u], q[u + 1], q[u + 2], q[u + 3]];
      q[o] = a * w - b * x - c * y - d * z;
      q[o + 1] = a * x + b * w + c * z - d * y;
      q[o + 2] = a * y - b * z + c * w + d * x;
      q[o + 3] = a * z + b * y - c * x + d * w;
      this.carry(parent, offsets, joint * 3, p, joint * 3);
    }
    return this;
  }

  /** Writes the world position of a point given in a joint's own space. */
  carry(joint, point, from, out, to) {
    const u = joint * 4;
    const [a, b, c, d] = [this.rotations[u], this.rotations[u + 1], this.rotations[u + 2], this.rotations[u + 3]];
    const [x, y, z] = [point[from], point[from + 1], point[from + 2]];
    const tx = 2 * (c * z - d * y);
    const ty = 2 * (d * x - b * z);
    const tz = 2 * (b * y - c * x);
    const p = joint * 3;
    out[to] = this.places[p] + x + a * tx + (c * tz - d * ty);
    out[to + 1] = this.places[p + 1] + y + a * ty + (d * tx - b * tz);
    out[to + 2] = this.places[p + 2] + z + a * tz + (b * ty - c * tx);
  }
}
