// Plays the precomputed tracks of page_tracks.py, with the results of Python's ReferencePlayer.

import { free } from "./kernel.js";

const TRAJECTORY = [10, 20, 30, 40, 50, 60]; // frames ahead of the present one
const WIDTH = 24; // numbers per pose
const AHEAD = [0, 10, 25]; // rows ahead of a frame whose poses are its reference, each 5 frames further: 5, 15 and 30 frames
const [FADE, PAUSE, FIRST_STEPS] = [30, 20, 45]; // frames: crossfade between tracks, pause between performances, first steps of a gait
const [OTHER_SPEED, OWN_SHARE] = [60, 0.5]; // tracks within this many cm/s of the best one take turns; weight of the recorded trajectory

export class Player {
  /** @param {object} model result of readModel @param {number} choice same choice, same tracks @param {number} ownShare see OWN_SHARE */
  constructor(model, choice = 0, ownShare = OWN_SHARE) {
    Object.assign(this, { model, choice, ownShare, type: -1, track: null, at: 0, left: null });
  }

  /** Changes to a type by its index, on the next of its tracks that start near a speed (cm/s, null for any). */
  begin(type, speed = null) {
    const { track: left, at: leftAt } = this;
    const { tracks, performed } = this.model.types[type];
    const gap = (track) => (speed === null || performed ? 0 : Math.abs(track.speed - speed));
    const most = OTHER_SPEED + Math.min(...tracks.map(gap));
    const suited = tracks.filter((track) => gap(track) <= most);
    Object.assign(this, { type, track: suited[this.choice % suited.length] ?? null, at: 0 });
    this.choice += 1;
    // A performance starts without a blend: in a handspring, the hands touch down before a blend would end.
    this.left = left && !performed ? { track: left, at: leftAt } : null;
  }

  /** The controls of the next frame; wanted is the requested trajectory or null. */
  next(wanted = null) {
    const { at, left, model, track, type } = this;
    const controls = free(model, type);
    this.at += 1;
    if (!track) return { ...controls, phase: this.#clock(at), trajectory: wanted };
    let reference = this.#poses(track, at);
    if (left && at < FADE) reference = mixed(this.#poses(left.track, left.at + at), reference, at / FADE);
    let trajectory = wanted;
    if (wanted ? this.ownShare : model.types[type].performed) {
      const own = this.#trajectory(track, at % track.frames);
      trajectory = wanted ? mixed(wanted, own, this.ownShare) : own;
    }
    return { ...controls, reference, gain: model.types[type].gain, phase: model.arrays.phases[track.from + (at % track.frames)], trajectory };
  }

  // The phase of a type without tracks: repeated performances with pauses in between.
  #clock(at) {
    const length = Math.round(this.model.types[this.type].seconds * this.model.fps);
    const frame = at % (length + PAUSE);
    return frame < length ? frame / length : -1;
  }

  // The poses ahead of a frame; a track repeats at its end.
  #poses(track, at) {
    const { poses } = this.model.arrays;
    const rows = AHEAD.map((ahead) => WIDTH * (track.from + ((at + ahead) % track.frames)));
    return rows.flatMap((row) => [...poses.subarray(row, row + WIDTH)]);
  }

  // The track's trajectory for the second after a frame, in its heading frame: positions, then directions.
  #trajectory(track, at) {
    const { ground } = this.model.arrays;
    const place = (frame, k) => ground[3 * (track.from + frame) + k];
    const [last, heading] = [track.frames - 1, place(at, 2)];
    const out = new Float32Array(24);
    TRAJECTORY.forEach((offset, n) => {
      const there = Math.min(at + offset, last);
      const beyond = at + offset - there;
      const [x, z, turn] = [0, 1, 2].map((k) => place(there, k) + beyond * (place(last, k) - place(last - 1, k)) - place(at, k));
      const [sine, cosine] = [Math.sin(heading), Math.cos(heading)];
      out.set([cosine * x - sine * z, cosine * z + sine * x], 2 * n);
      out.set([Math.sin(turn), Math.cos(turn)], 12 + 2 * n);
    });
    return out;
  }
}

/** The first steps of a gait from standing use a track as reference; later steps do not (Python's FirstSteps). */
export class FirstSteps {
  constructor(model, choice = 0) {
    Object.assign(this, { player: new Player(model, choice, 0), left: 0 });
  }

  /** Starts a gait, by its index, from standing at a speed in cm/s. */
  begin(type, speed) {
    this.player.track = null; // the body has moved independently of it
    this.player.begin(type, speed);
    this.left = FIRST_STEPS;
  }

  /** The controls of the next frame of a gait, with a reference during its first steps. */
  reference(type, controls) {
    if (type !== this.player.type) this.left = 0; // a change of type ends them, also for a return to it
    if (this.left === 0) return controls;
    this.left -= 1;
    const { reference, gain } = this.player.next(controls.trajectory);
    return { ...controls, reference, gain };
  }
}

/** The mean speed (cm/s) of a requested trajectory, from the distance to its last position. */
export const trajectorySpeed = (trajectory, fps) => (Math.hypot(trajectory[10], trajectory[11]) * fps) / TRAJECTORY[5];

const mixed = (a, b, share) => a.map((value, n) => value + share * (b[n] - value));
