// Paths and the controls that follow them, as Python's Path2D and PathFollower (control/path.py, control/follow.py).

import { free, typeNumber } from "./kernel.js";
import { Player, askedSpeed } from "./player.js";
import { RUN_SPEED, TRAJECTORY, WALK_SPEED, stands, steeredType } from "./springs.js";
import { FirstSteps } from "./steps.js";

const SPACING = 2; // cm between the points of a path
const [SEARCH_BACK, SEARCH_AHEAD, SLOWEST, DEFAULT_SPEED, CREEP, ARRIVED] = [30, 60, 20, 130, 10, 8];
const [BACK, NO_FURTHER, BESIDE, NEARER, SHARP, TURN_SPEED, BESIDE_TURN] = [-0.9, 1, 15, 5, -0.8, 30, 3];
const TOO_SLOW = 0.99; // of the slowest recorded speed of a run, below which a body walks
const [ACCELERATION, TYPE_BLEND, BLEND_SAMPLES, STEP] = [220, 40, 16, 5];

/** Points resampled evenly, with their directions and the parts they belong to. */
export class Path {
  /** @param {{points: number[][], type: string, speed?: number | null, stop?: number}[]} parts points [x, z] in cm, end to end */
  constructor(parts) {
    const corners = [];
    const ends = [];
    let total = 0;
    let previous = [];
    parts.forEach(({ points, type }, n) => {
      const all = [...previous, ...points];
      const steps = all.slice(1).map((point, i) => apart(point, all[i]));
      const length = steps.reduce((sum, step) => sum + step, 0);
      if (length < 2 * SPACING) throw new Error(`part ${n + 1} of the path (${type}) is ${length.toFixed(1)} cm long, expected at least 4 cm`);
      corners.push(...(n ? [] : all.slice(0, 1)), ...all.slice(1).filter((_, i) => steps[i] > 1e-6));
      ends.push((total += length));
      previous = all.slice(-1);
    });
    const arcs = [0];
    for (let n = 1; n < corners.length; n++) arcs.push(arcs[n - 1] + apart(corners[n], corners[n - 1]));
    const count = Math.max(3, Math.trunc(total / SPACING) + 1);
    let right = 1;
    const exact = Array.from({ length: count }, (_, n) => {
      while (right < arcs.length - 1 && arcs[right] < Math.min(n * SPACING, arcs.at(-1))) right += 1;
      const share = Math.max(0, Math.min(1, (n * SPACING - arcs[right - 1]) / (arcs[right] - arcs[right - 1])));
      return [0, 1].map((k) => corners[right - 1][k] * (1 - share) + corners[right][k] * share);
    });
    this.parts = parts;
    this.points = exact.map((point) => point.map(Math.fround));
    this.tangents = exact.map((_, n) => {
      const [a, b] = [exact[Math.max(n - 1, 0)], exact[Math.min(n + 1, count - 1)]];
      return unit(b[0] - a[0], b[1] - a[1]).map(Math.fround);
    });
    this.part = exact.map((_, n) => Math.min(ends.filter((end) => end < n * SPACING).length, parts.length - 1));
  }

  get length() {
    return (this.points.length - 1) * SPACING;
  }

  /** Where to stand still and for how long: [arc in cm, seconds], in the order of the path. */
  get stops() {
    return this.parts
      .map(({ stop }, n) => [Math.min((this.part.lastIndexOf(n) + 1) * SPACING, this.length), stop])
      .filter(([, stop]) => stop);
  }

  /** The number of the point nearest to an arc length; of two as near, the even one, as numpy rounds. */
  nearest(arc) {
    const place = arc / SPACING;
    const even = 2 * Math.round(place / 2);
    return Math.max(0, Math.min(this.points.length - 1, Math.abs(place - even) === 0.5 ? even : Math.round(place)));
  }

  /** The point and the direction at an arc length; straight on beyond the ends. */
  at(arc) {
    const { points, tangents } = this;
    const last = points.length - 1;
    const index = Math.max(0, Math.min(last - 1, Math.floor(arc / SPACING)));
    const share = Math.max(0, Math.min(1, arc / SPACING - index));
    const between = (rows, k) => rows[index][k] * (1 - share) + rows[index + 1][k] * share;
    const beyond = Math.max(arc - this.length, 0);
    const before = Math.min(arc, 0);
    const point = [0, 1].map((k) => between(points, k) + beyond * tangents[last][k] + before * tangents[0][k]);
    return [point, unit(between(tangents, 0), between(tangents, 1))];
  }
}

const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

const dot = (a, b) => a[0] * b[0] + a[1] * b[1];

const unit = (x, z) => {
  const size = Math.max(Math.hypot(x, z), 1e-12);
  return [x / size, z / size];
};

export class Follower {
  /** @param {object} model of readModel @param {Path} path @param {number} choice picks among recordings */
  constructor(model, path, choice = 0) {
    const numbers = path.parts.map(({ type }) => typeNumber(model, type));
    const stand = model.types.reduce((least, type, n) => (stands(type) && !(model.types[least]?.gait.speed <= type.gait.speed) ? n : least), -1);
    Object.assign(this, { model, path, stand, arc: 0, least: 0, stops: path.stops, stood: null, entered: -1, player: new Player(model, choice, 0), firstSteps: new FirstSteps(model, choice) });
    this.types = path.part.map((part) => numbers[part]);
    this.facings = path.part.map((part) => model.types[numbers[part]].gait?.facing ?? 0);
    this.speeds = this.#profile(numbers);
    this.shown = this.#shownTypes();
  }

  /** Controls for a body at [x, z, heading]. */
  controls([x, z, heading]) {
    const { model, path } = this;
    this.arc = this.#project(x, z);
    const { stood } = this;
    const standing = this.#standing();
    const goesOn = stood !== null && this.stood === null;
    const trajectory = new Float32Array(24);
    this.#ahead(this.arc).forEach((arc, n) => {
      const [point, tangent] = path.at(arc);
      trajectory.set(turned(-heading, point[0] - x, point[1] - z), 2 * n);
      trajectory.set(turned(-heading - this.facings[path.nearest(arc)], ...tangent), 12 + 2 * n);
    });
    const at = path.nearest(this.arc);
    const [part, type] = [path.part[at], this.types[at]];
    const weights = this.#weights(standing);
    // On a path the trajectory comes first, wherever the feet stand and whatever the recording's trajectory was.
    if (model.types[type].steered) this.entered = part;
    if (model.types[type].steered || standing) {
      if (goesOn && !stands(model.types[type])) this.firstSteps.begin(type);
      const asked = { ...free(model, type), weights, trajectory, slip: 0 };
      return !standing && this.firstSteps.takes(type) ? this.firstSteps.reference(asked, trajectory) : asked;
    }
    if (part !== this.entered) this.player.begin(type, null, askedSpeed(trajectory, model.fps));
    this.entered = part;
    return { ...this.player.play(1, trajectory)[0], weights, trajectory, slip: 0 };
  }

  get arrived() {
    return this.arc >= this.path.length - SPACING;
  }

  // The share of standing still: it comes and goes over half a blend around a stop.
  #standing() {
    if (!this.stops.length) return 0;
    const [place, seconds] = this.stops[0];
    if (this.stood === null) {
      if (this.arc < place - ARRIVED) return 0;
      this.stood = 0;
    }
    this.stood += 1;
    const [left, half] = [Math.round(seconds * this.model.fps) - this.stood, TYPE_BLEND / 2];
    if (left >= 0) return Math.min(this.stood, left, half) / half;
    this.stood = null;
    this.stops.shift();
    return 0;
  }

  // Arc lengths from one on at the frames of a trajectory, at the speeds of the path.
  #ahead(start) {
    const end = this.stops.length ? this.stops[0][0] : Infinity;
    let [arc, frame] = [start, 0];
    return TRAJECTORY.map((wanted) => {
      for (; frame < wanted; frame += STEP) arc = Math.min(arc + (this.speeds[this.path.nearest(arc)] * STEP) / this.model.fps, Math.max(end, start));
      return Math.fround(arc);
    });
  }

  // Type weights: the mean over half a blend behind and ahead, and standing.
  #weights(standing) {
    const { arc, path, shown, stand } = this;
    const reach = (this.speeds[path.nearest(arc)] * TYPE_BLEND) / 2 / this.model.fps;
    const weights = new Float32Array(this.model.types.length);
    for (let n = 0; n < BLEND_SAMPLES; n++) weights[shown[path.nearest(arc - reach + (n * 2 * reach) / (BLEND_SAMPLES - 1))]] += 1 / BLEND_SAMPLES;
    if (!standing || stand < 0) return weights;
    for (let n = 0; n < weights.length; n++) weights[n] *= 1 - standing;
    weights[stand] += standing;
    return weights;
  }

  // The type shown at each point: who runs walks where the path is slower than any recorded run.
  #shownTypes() {
    const { types } = this.model;
    const walk = steeredType(this.model, [0, WALK_SPEED], 0);
    const slower = types[walk].speeds;
    return this.types.map((number, n) => {
      const { gait, speeds } = types[number];
      const runs = gait && speeds && slower && gait.speed > RUN_SPEED && slower[0] < speeds[0];
      return runs && this.speeds[n] < TOO_SLOW * speeds[0] ? walk : number;
    });
  }

  // The speed at each point, which changes no faster than bodies brake and start, to each stop.
  #profile(numbers) {
    const { model, path } = this;
    const asked = path.parts.map(({ speed }, n) => {
      const { gait, speeds } = model.types[numbers[n]];
      const wanted = Math.max(SLOWEST, Math.fround(speed ?? gait?.speed ?? DEFAULT_SPEED));
      // Beyond its recordings a gait glides.
      return speeds && speed != null ? Math.fround(Math.min(Math.max(wanted, speeds[0]), speeds[1])) : wanted;
    });
    const speeds = path.part.map((part) => asked[part]);
    const sharp = (n) => dot(path.tangents[n - BESIDE_TURN], path.tangents[n + BESIDE_TURN]) < SHARP;
    for (let n = BESIDE_TURN; n < speeds.length - BESIDE_TURN; n++) if (sharp(n)) speeds[n] = Math.min(speeds[n], TURN_SPEED);
    for (const [place] of this.stops) speeds[path.nearest(place)] = CREEP;
    // The square of the speed changes evenly along the way: no point's is more than so much above another's.
    const rise = 2 * ACCELERATION * SPACING;
    const squares = speeds.map((speed) => speed * speed);
    for (let n = 1; n < squares.length; n++) squares[n] = Math.min(squares[n], squares[n - 1] + rise);
    for (let n = squares.length - 2; n >= 0; n--) squares[n] = Math.min(squares[n], squares[n + 1] + rise);
    return Float32Array.from(squares, Math.sqrt);
  }

  // Where a path turns back on itself, the way there is as near as the way back: who has no further to go to a place
  // beyond the turn is on the way back, and stays there.
  #project(x, z) {
    const { path } = this;
    const arc = this.#nearest(x, z);
    const [beyond] = this.#ahead(arc);
    const [there, wayBack] = path.at(beyond);
    const way = path.tangents[path.nearest(arc)];
    const [toX, toZ] = [there[0] - x, there[1] - z];
    const turns = dot(wayBack, way) < BACK;
    if (!turns || toX * way[0] + toZ * way[1] >= NO_FURTHER || Math.hypot(toX, toZ) >= BESIDE) return arc;
    return (this.least = beyond);
  }

  // The arc of the nearest point, sought near the last, so that a path that crosses itself is not cut short.
  #nearest(x, z) {
    const { points, tangents } = this.path;
    const first = Math.max(0, Math.trunc(Math.max(this.arc - SEARCH_BACK, this.least) / SPACING));
    const end = Math.min(points.length, Math.trunc((this.arc + SEARCH_AHEAD) / SPACING) + 2);
    let best = first;
    let least = Infinity;
    for (let n = first; n < end; n++) {
      const away = Math.hypot(points[n][0] - x, points[n][1] - z);
      if (away < least) [best, least] = [n, away];
    }
    // The way back is no better than the way there for being nearer by a little.
    const way = tangents[this.path.nearest(this.arc)];
    if (dot(tangents[best], way) < BACK) {
      let nearest = least + NEARER;
      for (let n = first; n < end; n++) {
        const away = Math.hypot(points[n][0] - x, points[n][1] - z);
        if (dot(tangents[n], way) > 0 && away < nearest) [best, nearest] = [n, away];
      }
    }
    const last = points.length - 1;
    if (best < last) return best * SPACING;
    // Past the last point the way on is counted along its direction, so that the end can be reached.
    const beyond = (x - points[last][0]) * tangents[last][0] + (z - points[last][1]) * tangents[last][1];
    return best * SPACING + Math.max(0, beyond);
  }
}

/** A vector [x, z] turned about Y. */
function turned(angle, x, z) {
  const [sine, cosine] = [Math.sin(angle), Math.cos(angle)];
  return [cosine * x + sine * z, cosine * z - sine * x];
}
