// Plays reference clips of a type, as Python's ReferencePlayer (control/reference_player.py).

import { free } from "./kernel.js";
import { MotionIndex, squared } from "./matching.js";
import { PythonRandom } from "./random.js";
import { TRAJECTORY } from "./springs.js";

const WIDTH = 24; // of a pose
const OFFSETS = [5, 15, 30]; // frames ahead of the poses that are shown
const STATE = [0, 5, 15, 30]; // frames ago
const [CANDIDATES, CANDIDATES_WITHIN, PAUSE, SUITED] = [24, 200, 20, 2];
const [SHORTEST_BLEND, LONGEST_BLEND] = [15, 45]; // frames
const [RECONSIDERED, CLEARLY, OWN_SHARE] = [20, 0.4, 0.5];
const [OTHER_SPEED, SPEED_SPAN] = [60, 10]; // cm/s, frames
const [GOLDEN, STEPS, SIBLINGS] = [(Math.sqrt(5) - 1) / 2, [2, 3, 7, 11].map((n) => Math.sqrt(n) % 1), 32];
const [PLAYED, LEAST_SECONDS] = [0.5, 1.5];

export class Player {
  /**
   * @param {object} model of readModel
   * @param {number} choice the same choice plays the same
   * @param {number} ownShare of the recorded trajectory in one that is asked for
   * @param {"clips" | "first"} kept which recordings of a type to play
   */
  constructor(model, choice = 0, ownShare = OWN_SHARE, kept = "clips") {
    Object.assign(this, { kept, model, random: new PythonRandom(choice), choice, ownShare, draws: 0, type: -1, clip: null, at: 0, left: null, pause: null });
    Object.assign(this, { played: new Map(), indices: new Map(), since: 0 });
  }

  /** Changes to a type by its number; the frame entered suits the trajectory, if one is given, or the body's speed in cm/s. */
  begin(type, trajectory = null, speed = null) {
    const last = this.clip && Math.min(this.at, this.clip.frames - 1);
    const near = this.clip && this.#state(this.clip, last);
    if (speed === null && this.clip) speed = this.#speed(this.clip, last);
    const count = type === this.type ? CANDIDATES_WITHIN : CANDIDATES;
    const { clip: left, at: leftAt, left: before } = this;
    Object.assign(this, { type, clip: null, at: 0, left: null, pause: null, since: 0 });
    const { [this.kept]: clips, performed } = this.model.types[type];
    if (!clips.length) return;
    if (performed) this.clip = this.#performance(clips, near);
    else if (trajectory && near) [this.clip, this.at] = this.#index().nearest(near, trajectory, RECONSIDERED);
    else [this.clip, this.at] = this.#drawn(clips, count, near, speed);
    // A performance begins without a blend: a handspring is over the hands before the blend would be.
    if (left && !this.clip.performed) this.left = this.#leaving(left, leftAt, before);
  }

  /** Forgets the recording that is played: the body has gone its own way since. */
  forget() {
    Object.assign(this, { type: -1, clip: null, at: 0, left: null, pause: null });
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
      if (this.clip && this.at >= this.clip.frames) this.#goOn(trajectory);
      else if (trajectory && this.since >= RECONSIDERED) {
        this.since = 0;
        if (this.clip && !this.model.types[this.type].phased) this.#reconsider(trajectory);
      }
      if (this.pause) {
        out.push(this.#paused(trajectory));
        continue;
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
    const before = this.left;
    [this.clip, this.at] = found;
    this.left = this.#leaving(clip, at, before);
  }

  #index() {
    if (!this.indices.has(this.type)) {
      const index = new MotionIndex(this.model.types[this.type][this.kept], (clip, at) => this.#state(clip, at), (clip, at) => this.#trajectory(clip, at));
      this.indices.set(this.type, index);
    }
    return this.indices.get(this.type);
  }

  #frame(wanted) {
    const { clip, model, at } = this;
    const asked = free(model, this.type);
    if (!clip) return { ...asked, phase: this.#clock(), trajectory: wanted };
    let reference = this.#shown(clip, at);
    if (this.left) reference = this.#fading(this.left, at, reference);
    const phase = clip.phases === null ? -1 : model.arrays.phases[clip.phases + at];
    return { ...asked, reference, gain: model.types[this.type].gain, phase, trajectory: this.#shownTrajectory(clip, at, wanted) };
  }

  // The recorded trajectory, and the one that is asked for; null for none.
  #shownTrajectory(clip, at, wanted) {
    if (!wanted) return clip.performed ? this.#trajectory(clip, at) : null;
    return this.ownShare ? mixed(wanted, this.#trajectory(clip, at), this.ownShare) : wanted;
  }

  // Enters the next clip at the end of one; after a pause where there is no time for a blend.
  #goOn(trajectory) {
    const left = this.clip;
    this.begin(this.type, this.model.types[this.type].phased ? null : trajectory, trajectory && askedSpeed(trajectory, this.model.fps));
    const { clip, at, model } = this;
    const phases = clip.phases === null ? [] : model.arrays.phases.subarray(clip.phases + at, clip.phases + Math.min(at + SHORTEST_BLEND, clip.frames));
    if (left.performed || phases.some((phase) => phase >= 0)) Object.assign(this, { pause: { left, shown: 0 }, left: null });
  }

  // How a clip that was left fades into the present one: for as many frames as poses need that change at its pace.
  #leaving(left, leftAt, before) {
    const { poses } = this.model.arrays;
    const pose = (clip, at) => poses.subarray((clip.poses + at) * WIDTH, (clip.poses + at + 1) * WIDTH);
    const apart = Math.sqrt(squared(pose(this.clip, this.at), pose(left, leftAt)));
    const frames = Math.min(Math.max(SHORTEST_BLEND, Math.round(apart / this.clip.pace)), LONGEST_BLEND);
    const fades = before && leftAt < before.entered + before.frames;
    return { left, leftAt, entered: this.at, frames, before: fades ? before : null };
  }

  // The reference at a frame of the clip entered, blended with that of the clip left, which plays on.
  #fading(fade, at, reference) {
    const { left, leftAt, entered, frames, before } = fade;
    const leftNow = leftAt + at - entered;
    let earlier = this.#shown(left, leftNow);
    if (before && leftNow >= before.entered + before.frames) fade.before = null;
    if (fade.before) earlier = this.#fading(fade.before, leftNow, earlier);
    return mixed(earlier, reference, Math.min((at - entered) / frames, 1));
  }

  // One frame of a pause between the last frame of a clip and the one that the next was entered at.
  #paused(wanted) {
    const { clip, at, pause, model } = this;
    const { left } = pause;
    pause.shown += 1;
    const share = pause.shown / PAUSE;
    if (pause.shown === PAUSE) this.pause = null;
    const reference = mixed(this.#shown(left, left.frames - 1), this.#shown(clip, at), share);
    const own = clip.performed ? mixed(this.#trajectory(left, left.frames - 1), this.#trajectory(clip, at), share) : null;
    return { ...free(model, this.type), reference, gain: model.types[this.type].gain, trajectory: wanted ?? own };
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

  // Of some random entry frames of what has not been played the one most like the present pose.
  #drawn(clips, count, near, speed) {
    const entries = clips.filter((clip) => clip.entries.length).map((clip) => [clip, clip.entries.flatMap(([from, to]) => range(from, to))]);
    let found = this.#asFast(entries, speed);
    const fresh = found.map(([clip, frames]) => [clip, this.#fresh(clip, frames)]).filter(([, frames]) => frames.length);
    if (fresh.length) found = fresh;
    else found.forEach(([clip]) => this.#playedOf(clip).fill(0));
    const [clip, all] = found[this.place(found.map(([, frames]) => frames.length))];
    const frames = this.random.sample(all, Math.min(count, all.length));
    if (!near) return [clip, frames[0]];
    const costs = frames.map((at) => squared(this.#state(clip, at), near));
    return [clip, frames[costs.indexOf(Math.min(...costs))]];
  }

  // The entry frames before what has not been played, at least in part.
  #fresh(clip, frames) {
    const sums = [0];
    this.#playedOf(clip).forEach((played) => sums.push(sums.at(-1) + played));
    return frames.filter((at) => {
      const end = Math.min(at + Math.round(LEAST_SECONDS * this.model.fps), clip.frames);
      return sums[end] - sums[at] <= PLAYED * (end - at);
    });
  }

  // The entry frames at which strikes and jumps go about as fast as the body: a leap out of a run needs the run.
  #asFast(found, speed) {
    if (speed === null || !this.model.types[this.type].phased) return found;
    const gap = (clip, at) => Math.abs(this.#speed(clip, at) - speed);
    const most = OTHER_SPEED + found.reduce((least, [clip, frames]) => frames.reduce((m, at) => Math.min(m, gap(clip, at)), least), Infinity);
    return found.map(([clip, frames]) => [clip, frames.filter((at) => gap(clip, at) <= most)]).filter(([, frames]) => frames.length);
  }

  // The speed in cm/s with which a recording goes over the ground at a frame.
  #speed(clip, at) {
    const { ground } = this.model.arrays;
    const [from, to] = [Math.max(at - SPEED_SPAN / 2, 0), Math.min(at + SPEED_SPAN / 2, clip.frames - 1)];
    const place = (frame, k) => ground[(clip.ground + frame) * 3 + k];
    return (Math.hypot(place(to, 0) - place(from, 0), place(to, 1) - place(from, 1)) * this.model.fps) / Math.max(to - from, 1);
  }

  // Which of some sizes is drawn next, the larger the more often, and by successive choices evenly among all.
  place(sizes) {
    this.draws += 1;
    const step = STEPS[Math.floor(this.choice / SIBLINGS) % STEPS.length];
    const share = (this.choice * GOLDEN + this.draws * step) % 1;
    const drawn = share * sizes.reduce((sum, size) => sum + size, 0);
    let sum = 0;
    return sizes.findIndex((size) => (sum += size) > drawn);
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

/** The mean speed in cm/s, to its last place as the crow flies, of a trajectory that is asked for. */
export const askedSpeed = (trajectory, fps) => (Math.hypot(trajectory[10], trajectory[11]) * fps) / TRAJECTORY[5];

const range = (from, to) => Array.from({ length: to - from }, (_, n) => from + n);

const mixed = (a, b, share) => a.map((value, n) => value + share * (b[n] - value));
