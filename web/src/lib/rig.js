// A skeleton and its forward kinematics.

import { Quaternion, Vector3 } from "three";
import { Hero, readCharacter } from "./hero.js";
import { bytesOf, unpack } from "./pack.js";

export class Rig {
  /** The rig of figure_data: names, hierarchy, offsets, and the body around it, in metres, or the hero in its place. */
  static async from(data) {
    const { joints: names, parents, sides, bones, ends, hips, stature, bone, body, hero } = data;
    const rig = Object.assign(new Rig(), { names, parents, sides, bones, ends, hips, stature });
    Object.assign(rig, bone); // the demo's own .glb has bones with axes of their own
    rig.offsets = await unpack(data.offsets);
    rig.hero = hero && { bytes: () => bytesOf(hero.data).buffer, ...hero };
    rig.body = body && Object.fromEntries(await Promise.all(Object.entries(body).map(async ([name, field]) => [name, await unpack(field)])));
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

/** Rotations (quaternions) and positions (vectors) of all joints in the world. */
export class Pose {
  constructor(count) {
    this.rotations = Array.from({ length: count }, () => new Quaternion());
    this.places = Array.from({ length: count }, () => new Vector3());
  }

  /**
   * Forward kinematics.
   * @param {Rig} rig
   * @param {ArrayLike<number>} turns local quaternions w, x, y, z of any length but zero, from index `at` on
   * @param {number} at
   * @param {ArrayLike<number>} root position of the root joint, from index `rootAt` on
   * @param {number} rootAt
   * @param {ArrayLike<number>} offsets positions of the joints relative to their parents
   */
  set(rig, turns, at, root, rootAt, offsets = rig.offsets) {
    const { rotations, places } = this;
    rig.parents.forEach((parent, joint) => {
      const i = at + joint * 4;
      rotations[joint].set(turns[i + 1], turns[i + 2], turns[i + 3], turns[i]).normalize();
      places[joint].fromArray(root, rootAt);
      if (parent < 0) return;
      rotations[joint].premultiply(rotations[parent]);
      this.carry(parent, places[joint].fromArray(offsets, joint * 3));
    });
    return this;
  }

  /** Brings a point of a joint's own space into the world. */
  carry(joint, point) {
    return point.applyQuaternion(this.rotations[joint]).add(this.places[joint]);
  }
}
