// The frames of a motion, and the curves that the page draws over time.

import { unpack } from "./pack.js";
import { Rig } from "./rig.js";

const SMOOTHING = 0.4; // seconds on either side that the follow camera averages over

export class Clip {
  static async from(data) {
    const clip = new Clip();
    Object.assign(clip, { name: data.name, fps: data.fps, frames: data.frames, unit: data.unit, types: data.types });
    clip.rig = await Rig.from(data);
    clip.hero = await clip.rig.newHero();
    clip.turns = await unpack(data.rotations);
    clip.roots = await unpack(data.roots);
    clip.floor = data.floor;
    clip.moving = data.moving && { joints: data.moving.joints, places: await unpack(data.moving.places) };
    clip.offsets = clip.rig.offsets.slice();
    clip.path = data.path && (await unpack(data.path));
    clip.feet = await Promise.all(
      data.feet.map(async (foot) => ({
        side: foot.side,
        joint: foot.joint,
        low: await unpack(foot.low),
        slides: await unpack(foot.slides),
      })),
    );
    clip.pose = clip.rig.newPose();
    clip.#measure();
    return clip;
  }

  /** Length on the timeline; the last frame is at its end. */
  get seconds() {
    return (this.frames - 1) / this.fps;
  }

  frameAt(time) {
    return Math.max(0, Math.min(this.frames - 1, Math.floor(time * this.fps + 1e-6)));
  }

  /** The pose of a frame; every call returns the same object. */
  poseAt(frame) {
    const count = this.rig.count;
    if (this.moving) {
      const { joints, places } = this.moving;
      joints.forEach((joint, n) => {
        for (let k = 0; k < 3; k++) this.offsets[joint * 3 + k] = places[(frame * joints.length + n) * 3 + k];
      });
    }
    return this.pose.set(this.rig, this.turns, frame * count * 4, this.roots, frame * 3, this.offsets);
  }

  // Computes tracks of hips and feet, speeds, heights and extent.
  #measure() {
    const { frames, fps } = this;
    this.hips = new Float32Array(frames * 3);
    for (const foot of this.feet) foot.track = new Float32Array(frames * 3);
    for (let frame = 0; frame < frames; frame++) {
      const { places } = this.poseAt(frame);
      places[this.rig.hips].toArray(this.hips, frame * 3);
      for (const foot of this.feet) places[foot.joint].toArray(foot.track, frame * 3);
    }
    this.speed = new Float32Array(frames);
    const reach = Math.max(1, Math.round(fps / 30));
    for (let frame = 0; frame < frames; frame++) {
      const a = Math.max(0, frame - reach) * 3;
      const b = Math.min(frames - 1, frame + reach) * 3;
      const way = Math.hypot(this.hips[b] - this.hips[a], this.hips[b + 2] - this.hips[a + 2]);
      this.speed[frame] = b > a ? (way * fps * 3) / (b - a) : 0;
    }
    for (const foot of this.feet) foot.height = foot.track.filter((_, i) => i % 3 === 1).map((y) => y - this.floor);
    this.middle = this.#smoothed(Math.round(SMOOTHING * fps));
    this.box = [Infinity, Infinity, -Infinity, -Infinity];
    for (let i = 0; i < this.hips.length; i += 3) {
      this.box[0] = Math.min(this.box[0], this.hips[i]);
      this.box[1] = Math.min(this.box[1], this.hips[i + 2]);
      this.box[2] = Math.max(this.box[2], this.hips[i]);
      this.box[3] = Math.max(this.box[3], this.hips[i + 2]);
    }
  }

  // x, z of the hips averaged over time, so that a following camera does not sway with every step.
  #smoothed(half) {
    const out = new Float32Array(this.frames * 2);
    for (let axis = 0; axis < 2; axis++) {
      const at = (frame) => this.hips[frame * 3 + axis * 2];
      const sums = new Float64Array(this.frames + 1);
      for (let frame = 0; frame < this.frames; frame++) sums[frame + 1] = sums[frame] + at(frame);
      for (let frame = 0; frame < this.frames; frame++) {
        const reach = Math.min(half, frame, this.frames - 1 - frame);
        out[frame * 2 + axis] = (sums[frame + reach + 1] - sums[frame - reach]) / (2 * reach + 1);
      }
    }
    return out;
  }
}
