// A path of one gait and the controls that follow it, as Python's Path2D and PathFollower (control/path.py, follow.py).

import { free } from "./kernel.js";
import { TRAJECTORY } from "./springs.js";

const SPACING = 2; // cm between the points of a path
const [SEARCH_BACK, SEARCH_AHEAD, SLOWEST, DEFAULT_SPEED] = [30, 60, 20, 130];

/** Points [x, z] in cm resampled evenly, with their directions. */
export class Path {
  constructor(corners) {
    const arcs = [0];
    const kept = corners.slice(0, 1);
    for (const corner of corners.slice(1)) {
      const step = Math.hypot(corner[0] - kept.at(-1)[0], corner[1] - kept.at(-1)[1]);
      if (step <= 1e-6) continue;
      kept.push(corner);
      arcs.push(arcs.at(-1) + step);
    }
    const total = arcs.at(-1);
    if (total < 2 * SPACING) throw new Error(`the path is ${total.toFixed(1)} cm long, expected at least 4 cm`);
    const count = Math.max(3, Math.trunc(total / SPACING) + 1);
    let right = 1;
    const exact = Array.from({ length: count }, (_, n) => {
      while (right < arcs.length - 1 && arcs[right] < Math.min(n * SPACING, total)) right += 1;
      const share = Math.max(0, Math.min(1, (n * SPACING - arcs[right - 1]) / (arcs[right] - arcs[right - 1])));
      return [0, 1].map((k) => kept[right - 1][k] * (1 - share) + kept[right][k] * share);
    });
    this.points = exact.map((point) => point.map(Math.fround));
    this.tangents = exact.map((_, n) => {
      const [a, b] = [exact[Math.max(n - 1, 0)], exact[Math.min(n + 1, count - 1)]];
      return unit(b[0] - a[0], b[1] - a[1]).map(Math.fround);
    });
  }

  get length() {
    return (this.points.length - 1) * SPACING;
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

const unit = (x, z) => {
  const size = Math.max(Math.hypot(x, z), 1e-12);
  return [x / size, z / size];
};

export class Follower {
  /** @param {object} model of readModel @param {Path} path @param {number} type a gait @param {number | null} speed in cm/s */
  constructor(model, path, type, speed = null) {
    const { gait } = model.types[type];
    Object.assign(this, { model, path, type, arc: 0, speed: Math.max(SLOWEST, speed ?? gait?.speed ?? DEFAULT_SPEED), facing: gait?.facing ?? 0 });
  }

  /** Controls for a body at [x, z, heading]. */
  controls([x, z, heading]) {
    this.arc = this.#nearest(x, z);
    const trajectory = new Float32Array(24);
    TRAJECTORY.forEach((frames, n) => {
      const [point, tangent] = this.path.at(this.arc + (this.speed * frames) / this.model.fps);
      trajectory.set(turned(-heading, point[0] - x, point[1] - z), 2 * n);
      trajectory.set(turned(-heading - this.facing, ...tangent), 12 + 2 * n);
    });
    // On a path the trajectory comes first, wherever the feet stand.
    return { ...free(this.model, this.type), trajectory, slip: 0 };
  }

  get arrived() {
    return this.arc >= this.path.length - SPACING;
  }

  // The arc of the nearest point, sought near the last, so that a path that crosses itself is not cut short.
  #nearest(x, z) {
    const { points, tangents } = this.path;
    const first = Math.max(0, Math.trunc((this.arc - SEARCH_BACK) / SPACING));
    const end = Math.min(points.length, Math.trunc((this.arc + SEARCH_AHEAD) / SPACING) + 2);
    let best = first;
    let least = Infinity;
    for (let n = first; n < end; n++) {
      const away = Math.hypot(points[n][0] - x, points[n][1] - z);
      if (away < least) [best, least] = [n, away];
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
