// Follows a path of one type, like Python's Path2D and PathFollower.

import { free, typeNumber } from "./kernel.js";
import { FirstSteps, Player, askedSpeed } from "./player.js";
import { TRAJECTORY, steeredType, turned } from "./springs.js";

const SPACING = 2; // cm between points of a path
const [AHEAD, SLOWEST, DEFAULT_SPEED, CREEP, ARRIVED] = [60, 20, 130, 10, 8]; // cm searched ahead for the nearest point; cm/s at least, by default and at stops; cm before a stop
const BESIDE_TURN = 8; // points to both sides between which a turn is measured
const TOO_SLOW = 0.99; // share of a run's slowest recorded speed, below which the body walks
const [ACCELERATION, TYPE_BLEND, BLEND_SAMPLES, STEP] = [220, 40, 16, 5]; // cm/s² of a body; frames of a change of type; samples of its weights; frames per step of the prediction

/** Evenly spaced points with their directions. */
class Path {
  /** @param {number[][]} corners [x, z] in cm */
  constructor(corners) {
    this.arcs = corners.map(() => 0); // arc length of each corner
    for (let n = 1; n < corners.length; n++) this.arcs[n] = this.arcs[n - 1] + Math.hypot(corners[n][0] - corners[n - 1][0], corners[n][1] - corners[n - 1][1]);
    const total = this.arcs.at(-1);
    if (total < 2 * SPACING) throw new Error(`the path is ${total.toFixed(1)} cm long, expected at least 4 cm`);
    const count = Math.max(3, Math.trunc(total / SPACING) + 1);
    let right = 1;
    this.points = Array.from({ length: count }, (_, n) => {
      while (right < corners.length - 1 && this.arcs[right] < n * SPACING) right += 1;
      const share = (n * SPACING - this.arcs[right - 1]) / Math.max(this.arcs[right] - this.arcs[right - 1], 1e-9);
      return between(corners[right - 1], corners[right], Math.min(1, share));
    });
    this.tangents = this.points.map((_, n) => {
      const [a, b] = [this.points[Math.max(n - 1, 0)], this.points[Math.min(n + 1, count - 1)]];
      return unit(b[0] - a[0], b[1] - a[1]);
    });
    this.length = (count - 1) * SPACING;
  }

  /** The index of the point nearest to an arc length. */
  nearest(arc) {
    return Math.max(0, Math.min(this.points.length - 1, Math.round(arc / SPACING)));
  }

  /** Point and direction at an arc length; extended straight beyond the ends. */
  at(arc) {
    const { points, tangents } = this;
    const index = Math.max(0, Math.min(points.length - 2, Math.floor(arc / SPACING)));
    const share = arc / SPACING - index;
    const tangent = unit(...between(tangents[index], tangents[index + 1], Math.max(0, Math.min(1, share))));
    return [between(points[index], points[index + 1], share), tangent];
  }
}

const between = (a, b, share) => [0, 1].map((k) => a[k] + share * (b[k] - a[k]));

const unit = (x, z) => [x, z].map((value) => value / Math.max(Math.hypot(x, z), 1e-12));

export class Follower {
  /**
   * @param {object} model result of readModel
   * @param {{points: number[][], type: string, speed: number | null, stops: number[][]}} asked points [x, z] in cm, stops [point index, seconds]
   * @param {number} choice chooses among recordings
   */
  constructor(model, { points, type, speed, stops }, choice = 0) {
    const path = new Path(points);
    const number = typeNumber(model, type);
    Object.assign(this, { model, path, type: number, known: model.types[number], arc: 0, stood: null, began: false });
    this.stops = stops.map(([at, seconds]) => [Math.min(path.arcs[at], path.length), seconds]);
    this.stand = model.types.reduce((least, one, n) => (one.stands && !(model.types[least]?.gait.speed <= one.gait.speed) ? n : least), -1);
    this.walk = steeredType(model, [0, model.steering.walk_speed], 0);
    Object.assign(this, { player: new Player(model, choice, 0), firstSteps: new FirstSteps(model, choice), speeds: this.#profile(speed) });
  }

  /** The controls for a body at [x, z, heading]. */
  controls([x, z, heading]) {
    const { known, model, path, stood, type } = this;
    this.#advance(x, z);
    const standing = this.#standing();
    const trajectory = new Float32Array(24);
    this.#ahead().forEach((arc, n) => {
      const [point, tangent] = path.at(arc);
      trajectory.set(turned(-heading, point[0] - x, point[1] - z), 2 * n);
      trajectory.set(turned(-heading - (known.gait?.facing ?? 0), ...tangent), 12 + 2 * n);
    });
    const weights = this.#weights(standing);
    const speed = askedSpeed(trajectory, model.fps);
    // On a path the trajectory has priority over foot contacts and the recording's own trajectory.
    const asked = { ...free(model, type), weights, trajectory, slip: 0 };
    if (standing) return asked;
    if (known.steered) {
      if (stood !== null && !known.stands) this.firstSteps.begin(type, speed);
      return this.firstSteps.shown(type, asked);
    }
    if (!this.began) this.player.begin(type, speed);
    this.began = true;
    return { ...this.player.next(trajectory), weights, trajectory, slip: 0 };
  }

  get arrived() {
    return this.arc >= this.path.length - SPACING;
  }

  // Weight of standing: rises and falls over half a blend around a stop.
  #standing() {
    if (!this.stops.length) return 0;
    const [place, seconds] = this.stops[0];
    if (this.stood === null && this.arc < place - ARRIVED) return 0;
    this.stood = (this.stood ?? 0) + 1;
    const [left, half] = [Math.round(seconds * this.model.fps) - this.stood, TYPE_BLEND / 2];
    if (left >= 0) return Math.min(this.stood, left, half) / half;
    this.stood = null;
    this.stops.shift();
    return 0;
  }

  // Arc lengths at the trajectory's frames, at the path's speeds, not beyond the next stop.
  #ahead() {
    const end = Math.max(this.stops[0]?.[0] ?? Infinity, this.arc);
    let [arc, frame] = [this.arc, 0];
    return TRAJECTORY.map((wanted) => {
      for (; frame < wanted; frame += STEP) arc = Math.min(arc + (this.speeds[this.path.nearest(arc)] * STEP) / this.model.fps, end);
      return arc;
    });
  }

  // Type weights, averaged over half a blend behind and ahead, plus standing. A run becomes a walk where the path is
  // slower than any recorded run.
  #weights(standing) {
    const { arc, known, path, speeds, stand, type, walk } = this;
    const reach = (speeds[path.nearest(arc)] * TYPE_BLEND) / 2 / this.model.fps;
    const weights = new Float32Array(this.model.types.length);
    const runs = known.gait?.runs && known.speeds?.[0] > this.model.types[walk].speeds?.[0];
    for (let n = 0; n < BLEND_SAMPLES; n++) {
      const slow = runs && speeds[path.nearest(arc - reach + (n * 2 * reach) / (BLEND_SAMPLES - 1))] < TOO_SLOW * known.speeds[0];
      weights[slow ? walk : type] += (1 - (stand < 0 ? 0 : standing)) / BLEND_SAMPLES;
    }
    if (stand >= 0) weights[stand] += standing;
    return weights;
  }

  // The speed at each point; limited by the acceleration of bodies, also before stops.
  #profile(speed) {
    const { known: { gait, lateral, speeds: recorded }, path: { points, tangents } } = this;
    let asked = Math.max(SLOWEST, speed ?? gait?.speed ?? DEFAULT_SPEED);
    if (recorded && speed !== null) asked = Math.min(Math.max(asked, recorded[0]), recorded[1]); // outside its recorded speeds, a gait slides
    // The speed at which a body leans into the turn as far as recorded ones.
    const speeds = points.map((_, n) => {
      const [first, last] = [Math.max(n - BESIDE_TURN, 0), Math.min(n + BESIDE_TURN, points.length - 1)];
      const [a, b] = [tangents[first], tangents[last]];
      const turn = Math.acos(Math.min(Math.max(a[0] * b[0] + a[1] * b[1], -1), 1));
      return Math.min(asked, Math.sqrt((lateral * (last - first) * SPACING) / Math.max(turn, 1e-6)));
    });
    for (const [place] of this.stops) speeds[this.path.nearest(place)] = CREEP;
    // At constant acceleration the square of speed changes evenly, so its difference between neighbours is limited.
    const rise = 2 * ACCELERATION * SPACING;
    const squares = speeds.map((each) => each * each);
    for (let n = 1; n < squares.length; n++) squares[n] = Math.min(squares[n], squares[n - 1] + rise);
    for (let n = squares.length - 2; n >= 0; n--) squares[n] = Math.min(squares[n], squares[n + 1] + rise);
    return squares.map(Math.sqrt);
  }

  // Moves to the nearest point, searched near the last one, so that a path that crosses itself is not cut short.
  #advance(x, z) {
    const { points, tangents } = this.path;
    const first = this.path.nearest(this.arc);
    const away = (n) => Math.hypot(points[n][0] - x, points[n][1] - z);
    let best = first;
    for (let n = first; n < Math.min(points.length, first + AHEAD / SPACING); n++) if (away(n) < away(best)) best = n;
    // Beyond the last point, progress continues along its direction, so that the end can be reached.
    const last = points.length - 1;
    const beyond = best < last ? 0 : (x - points[last][0]) * tangents[last][0] + (z - points[last][1]) * tangents[last][1];
    this.arc = Math.max(this.arc, best * SPACING + Math.max(0, beyond));
  }
}
