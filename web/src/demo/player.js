// Plays the tracks of a type that page_tracks.py has made ready: what Python's ReferencePlayer would show.

import { free } from "./kernel.js";
import { TRAJECTORY } from "./springs.js";

const WIDTH = 24; // of a pose
const AHEAD = [0, 10, 25]; // rows of a track, from a frame on, whose poses are shown
const [FADE, PAUSE, FIRST_STEPS] = [30, 20, 45]; // frames
const [OTHER_SPEED, OWN_SHARE] = [60, 0.5]; // cm/s; of the recorded trajectory in one that is asked for

export class Player {
  /** @param {object} model of readModel @param {number} choice the same choice plays the same @param {number} ownShare see OWN_SHARE */
  constructor(model, choice = 0, ownShare = OWN_SHARE) {
    Object.assign(this, { model, choice, ownShare, type: -1, track: null, at: 0, left: null });
  }

  /** Changes to a type by its number: to the next of its tracks that are entered at about a speed in cm/s, null for any. */
  begin(type, speed = null) {
    const { track: left, at: leftAt } = this;
    const { tracks, performed } = this.model.types[type];
    const gap = (track) => (speed === null || performed ? 0 : Math.abs(track.speed - speed));
    const most = OTHER_SPEED + Math.min(...tracks.map(gap));
    const suited = tracks.filter((track) => gap(track) <= most);
    Object.assign(this, { type, track: suited[this.choice % suited.length] ?? null, at: 0 });
    this.choice += 1;
    // A performance begins without a blend: a handspring is over the hands before the blend would be.
    this.left = left && !performed ? { track: left, at: leftAt } : null;
  }

  /** Forgets what is played: the body has gone its own way since. */
  forget() {
    Object.assign(this, { track: null, left: null });
  }

  /** Controls of the next frame; a trajectory is asked for in it, or none. */
  next(wanted = null) {
    const { at, left, model, track, type } = this;
    const asked = free(model, type);
    this.at += 1;
    if (!track) return { ...asked, phase: this.#clock(at), trajectory: wanted };
    let reference = this.#poses(track, at);
    if (left && at < FADE) reference = mixed(this.#poses(left.track, left.at + at), reference, at / FADE);
    let trajectory = wanted;
    if (wanted ? this.ownShare : model.types[type].performed) {
      const own = this.#trajectory(track, at % track.frames);
      trajectory = wanted ? mixed(wanted, own, this.ownShare) : own;
    }
    return { ...asked, reference, gain: model.types[type].gain, phase: model.arrays.phases[track.from + (at % track.frames)], trajectory };
  }

  // The phase of a type without tracks: one performance after another, with pauses between them.
  #clock(at) {
    const length = Math.round(this.model.types[this.type].seconds * this.model.fps);
    const frame = at % (length + PAUSE);
    return frame < length ? frame / length : -1;
  }

  // The poses ahead of a frame; a track goes on from its beginning.
  #poses(track, at) {
    const { poses } = this.model.arrays;
    const rows = AHEAD.map((ahead) => WIDTH * (track.from + ((at + ahead) % track.frames)));
    return rows.flatMap((row) => [...poses.subarray(row, row + WIDTH)]);
  }

  // Where a track goes in the second after a frame, in its heading frame: places, then directions.
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

/** The first steps of a gait from standing, for which tracks are shown, and then none, as by Python's FirstSteps. */
export class FirstSteps {
  constructor(model, choice = 0) {
    Object.assign(this, { player: new Player(model, choice, 0), left: 0 });
  }

  /** A body that stands begins to go in a gait, by its number, at a speed in cm/s. */
  begin(type, speed) {
    this.player.forget();
    this.player.begin(type, speed);
    this.left = FIRST_STEPS;
  }

  /** Controls of the next frame in a gait: while its first steps are still to come, those that are asked with a reference. */
  shown(type, asked) {
    if (type !== this.player.type || this.left === 0) return asked;
    this.left -= 1;
    const { reference, gain } = this.player.next(asked.trajectory);
    return { ...asked, reference, gain };
  }
}

/** The mean speed in cm/s, to its last place as the crow flies, of a trajectory that is asked for. */
export const askedSpeed = (trajectory, fps) => (Math.hypot(trajectory[10], trajectory[11]) * fps) / TRAJECTORY[5];

const mixed = (a, b, share) => a.map((value, n) => value + share * (b[n] - value));
