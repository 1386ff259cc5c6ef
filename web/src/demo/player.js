// Plays reference clips of a type, as Python's ReferencePlayer (control/reference_player.py).

import { free } from "./kernel.js";
import { MotionIndex, squared } from "./matching.js";
import { PythonRandom } from "./random.js";
import { TRAJECTORY } from "./springs.js";

const WIDTH = 24; // of a pose
const OFFSETS = [5, 15, 30]; // frames ahead of the poses that are shown
const STATE = [0, 5, 15, 30]; // frames ago
const [CANDIDATES, CANDIDATES_WITHIN, PAUSE, BLEND, SUITED] = [24, 200, 20, 15, 2];
const [RECONSIDERED, CLEARLY, OWN_SHARE] = [20, 0.4, 0.5];

export class Player {
  /**
   * @param {object} model of readModel
   * @param {number} choice the same choice plays the same
   * @param {number} ownShare of the recorded trajectory in one that is asked for
   */
  constructor(model, choice = 0, ownShare = OWN_SHARE) {
    Object.assign(this, { model, random: new PythonRandom(choice), choice, ownShare, type: -1, clip: null, at: 0, left: null });
    Object.assign(this, { played: new Map(), indices: new Map(), since: 0 });
  }

  /** Changes to a type by its number; the frame entered suits the trajectory, if one is given. */
  begin(type, trajectory = null) {
    const near = this.clip && this.#state(this.clip, Math.min(this.at, this.clip.frames - 1));
    const count = type === this.type ? CANDIDATES_WITHIN : CANDIDATES;
    const [left, leftAt] = [this.clip, this.at];
    Object.assign(this, { type, clip: null, at: 0, left: null, since: 0 });
    const { clips, performed } = this.model.types[type];
    if (!clips.length) return;
    if (performed) this.clip = this.#performance(clips, near);
    else if (trajectory && near) [this.clip, this.at] = this.#index().nearest(near, trajectory, RECONSIDERED);
    else [this.clip, this.at] = this.#drawn(clips, count, near);
    // A performance begins without a blend: its phase and trajectory do not wait for the reference.
    if (left && !this.clip.performed) this.left = [left, leftAt, this.at];
  }

  /** Frames from here to the end of the next strike or jump, zero if none comes. */
  eventFrames() {
    const { clip } = this;
    if (!clip) return this.#cycle();
    const phased = (at) => clip.phases !== null && this.model.arrays.phases[clip.phases + at] >= 0;
    let first = this.at;
    while (first < clip.frames && !phased(first)) first += 1;
    if (first === clip.frames) return 0;
    let end = first;
    while (end < clip.frames && phased(end)) end += 1;
    return end - this.at;
  }

  /** Controls of so many coming frames; at the end of a clip another one is entered. A trajectory is asked for in all of them. */
  play(frames, trajectory = null) {
    const out = [];
    while (out.length < frames) {
      const { phased } = this.model.types[this.type];
      if (this.clip && this.at >= this.clip.frames) {
        const left = this.clip;
        this.begin(this.type, phased ? null : trajectory);
        if (left.performed) {
          this.#between(left, Math.min(PAUSE, frames - out.length), trajectory, out);
          continue;
        }
      } else if (trajectory && this.since >= RECONSIDERED) {
        this.since = 0;
        if (this.clip && !phased) this.#reconsider(trajectory);
      }
      out.push(this.#frame(trajectory));
      if (this.clip) this.#playedOf(this.clip)[this.at] = 1;
      this.at += 1;
      this.since += 1;
    }
    return out;
  }

  // Jumps to a frame that suits the trajectory clearly better.
  #reconsider(trajectory) {
    const { clip, at } = this;
    const found = this.#index().nearest(this.#state(clip, at), trajectory, RECONSIDERED, [clip, at], CLEARLY);
    if (found[0] === clip && found[1] === at) return;
    this.left = [clip, at, found[1]];
    [this.clip, this.at] = found;
  }

  #index() {
    if (!this.indices.has(this.type)) {
      const index = new MotionIndex(this.model.types[this.type].clips, (clip, at) => this.#state(clip, at), (clip, at) => this.#trajectory(clip, at));
      this.indices.set(this.type, index);
    }
    return this.indices.get(this.type);
  }

  #frame(wanted) {
    const { clip, model, at } = this;
    const asked = free(model, this.type);
    if (!clip) return { ...asked, phase: this.#clock(), trajectory: wanted };
    let reference = this.#shown(clip, at);
    if (this.left) {
      // The clip that was left plays on while it fades into this one.
      const [left, leftAt, entered] = this.left;
      const before = this.#shown(left, leftAt + at - entered);
      reference = mixed(before, reference, Math.min((at - entered) / BLEND, 1));
    }
    const phase = clip.phases === null ? -1 : model.arrays.phases[clip.phases + at];
    return { ...asked, reference, gain: model.types[this.type].gain, phase, trajectory: this.#shownTrajectory(clip, at, wanted) };
  }

  // The recorded trajectory, and the one that is asked for; null for none.
  #shownTrajectory(clip, at, wanted) {
    if (!wanted) return clip.performed ? this.#trajectory(clip, at) : null;
    return this.ownShare ? mixed(wanted, this.#trajectory(clip, at), this.ownShare) : wanted;
  }

  // From the end of a performance to the beginning of the next.
  #between(left, frames, wanted, out) {
    const { clip } = this;
    for (let n = 1; n <= frames; n++) {
      const share = n / PAUSE;
      const reference = mixed(this.#shown(left, left.frames - 1), this.#shown(clip, 0), share);
      const trajectory = wanted ?? mixed(this.#trajectory(left, left.frames - 1), this.#trajectory(clip, 0), share);
      out.push({ ...free(this.model, this.type), reference, gain: this.model.types[this.type].gain, trajectory });
    }
  }

  #cycle() {
    return Math.round(this.model.types[this.type].seconds * this.model.fps);
  }

  // The phase of a type without recordings: one performance after another, with pauses between them.
  #clock() {
    const length = this.#cycle();
    const frame = length ? this.at % (length + PAUSE) : 0;
    return length && frame < length ? frame / length : -1;
  }

  // The recorded poses ahead of a frame; the last is held beyond its end.
  #shown(clip, at) {
    const { poses } = this.model.arrays;
    const out = new Float32Array(WIDTH * OFFSETS.length);
    OFFSETS.forEach((ahead, n) => {
      const row = clip.poses + Math.min(at + ahead, clip.rows - 1);
      out.set(poses.subarray(row * WIDTH, (row + 1) * WIDTH), n * WIDTH);
    });
    return out;
  }

  // Where the recording went in the second after a frame, in its heading frame: places, then directions.
  #trajectory(clip, at) {
    const { ground } = this.model.arrays;
    const row = (frame) => ground.subarray((clip.ground + frame) * 3, (clip.ground + frame) * 3 + 3);
    const last = clip.frames - 1;
    const span = Math.min(6, last);
    const [x, z, heading] = row(at);
    const [end, earlier] = [row(last), row(last - span)];
    const out = new Float32Array(24);
    TRAJECTORY.forEach((offset, n) => {
      const target = row(Math.min(at + offset, last));
      const beyond = Math.max(at + offset - last, 0) / Math.max(span, 1);
      const [dx, dz] = [0, 1].map((k) => target[k] + beyond * (end[k] - earlier[k]) - [x, z][k]);
      const [sine, cosine] = [Math.sin(heading), Math.cos(heading)];
      out.set([cosine * dx - sine * dz, cosine * dz + sine * dx], 2 * n);
      const turn = target[2] - heading;
      out.set([Math.sin(turn), Math.cos(turn)], 12 + 2 * n);
    });
    return out;
  }

  // One of the recorded performances that go on about as well as any from the present pose, each in turn.
  #performance(clips, near) {
    let suited = clips;
    if (near) {
      const costs = clips.map((clip) => squared(this.#state(clip, 0), near));
      const most = 1 + SUITED * Math.min(...costs);
      suited = clips.filter((_, n) => costs[n] <= most);
    }
    const fresh = suited.filter((clip) => !this.#playedOf(clip).includes(1));
    if (!fresh.length) suited.forEach((clip) => this.#playedOf(clip).fill(0));
    const some = fresh.length ? fresh : suited;
    return some[this.choice % some.length];
  }

  // Of some random entry frames that have not been played the one most like the present pose.
  #drawn(clips, count, near) {
    let found = clips.filter((clip) => clip.entries.length).map((clip) => [clip, clip.entries.flatMap(([from, to]) => range(from, to))]);
    const fresh = found.map(([clip, frames]) => [clip, frames.filter((at) => !this.#playedOf(clip)[at])]).filter(([, frames]) => frames.length);
    if (fresh.length) found = fresh;
    else found.forEach(([clip]) => this.#playedOf(clip).fill(0));
    const [clip, all] = this.random.choice(found, found.map(([, frames]) => frames.length));
    const frames = this.random.sample(all, Math.min(count, all.length));
    if (!near) return [clip, frames[0]];
    const costs = frames.map((at) => squared(this.#state(clip, at), near));
    return [clip, frames[costs.indexOf(Math.min(...costs))]];
  }

  // The pose of a frame and those before it.
  #state(clip, at) {
    const { poses } = this.model.arrays;
    const out = new Float32Array(WIDTH * STATE.length);
    STATE.forEach((ago, n) => {
      const row = clip.poses + Math.max(at - ago, 0);
      out.set(poses.subarray(row * WIDTH, (row + 1) * WIDTH), n * WIDTH);
    });
    return out;
  }

  #playedOf(clip) {
    if (!this.played.has(clip)) this.played.set(clip, new Uint8Array(clip.frames));
    return this.played.get(clip);
  }
}

const range = (from, to) => Array.from({ length: to - from }, (_, n) => from + n);

const mixed = (a, b, share) => a.map((value, n) => value + share * (b[n] - value));
