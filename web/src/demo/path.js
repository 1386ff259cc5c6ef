// Follows a path of one type by the kernels (control/steering_kernel.c), like Python's PathFollower.

import { free, typeNumber } from "./kernel.js";
import { FirstSteps, Player, trajectorySpeed } from "./player.js";

const MOST_POINTS = 25_001; // of a path, 2 cm apart

export class Follower {
  /**
   * @param {import("./kernel.js").Character} body whose memory keeps one path
   * @param {{points: number[][], type: string, speed: number | null, stops: number[][]}} request points [x, z] in cm, stops [point index, seconds]
   * @param {boolean} stands whether the body stands before
   * @param {number} choice chooses among recordings
   */
  constructor(body, { points, type, speed, stops }, stands, choice = 0) {
    const { model, route } = body;
    const number = typeNumber(model, type);
    Object.assign(this, { model, run: body.kernel.run, at: route, type: number, known: model.types[number], began: false });
    Object.assign(this, { player: new Player(model, choice, 0), firstSteps: new FirstSteps(model, choice) });
    const end = points.length - 1;
    this.#plan(body, points, stops.at(-1)?.[0] === end ? stops : [...stops, [end, 0]], speed ?? NaN, stands);
  }

  // Writes a path into the kernels' memory and plans it; a part ends at each stop.
  #plan({ steering, kernel, model, route: at }, corners, stops, speed, stands) {
    const { run } = kernel;
    const { addresses, fields: { path: fields } } = model;
    const { buffer } = run.memory;
    const line = new Float64Array(buffer, kernel.scratch, 2 * corners.length);
    line.set(corners.flat());
    const count = run.path_points(line.byteOffset, corners.length);
    if (!count) throw new Error("the path is shorter than 4 cm");
    if (count > MOST_POINTS) throw new Error("the path is longer than 500 m");
    const words = new DataView(buffer, at, fields.size);
    let next = at + fields.size;
    const put = (name, kind, length) => {
      const array = new kind(buffer, 8 * Math.ceil(next / 8), length);
      next = array.byteOffset + array.byteLength;
      words.setUint32(fields[name], array.byteOffset, true);
      return array;
    };
    new Uint8Array(buffer).copyWithin(at, addresses.path, addresses.path + fields.size);
    const parts = put("parts", Float64Array, 6 * stops.length);
    stops.forEach(([last, seconds], n) => {
      parts.set([speed, this.known.lateral, seconds], 6 * n);
      new Int32Array(buffer, parts.byteOffset + 48 * n + 40, 2).set([this.type, last]);
    });
    const [points, tangents] = ["points", "tangents"].map((name) => put(name, Float64Array, 2 * count).byteOffset);
    const part = put("part", Int32Array, count).byteOffset;
    put("track", Int32Array, count);
    put("speeds", Float64Array, count);
    this.weights = put("weights", Float32Array, model.types.length);
    words.setInt32(fields.count, count, true);
    words.setInt32(fields.part_count, stops.length, true);
    words.setInt32(fields.stands, Number(stands), true);
    run.even_points(line.byteOffset, parts.byteOffset, stops.length, count, points, tangents, part);
    run.plan_path(steering, at);
    this.trajectory = new Float32Array(buffer, at + fields.trajectory, 24);
    this.flags = new Int32Array(buffer, at + fields.goes_on, 2); // whether a stop ends, and whether the path does
  }

  /** The controls for a body at [x, z, heading]. */
  controls(ground) {
    const { at, known, model, run, type } = this;
    const standing = run.follow(at, ...ground);
    const [weights, trajectory] = [this.weights.slice(), this.trajectory.slice()];
    const speed = trajectorySpeed(trajectory, model.fps);
    // On a path the trajectory has priority over foot contacts and the recording's own trajectory.
    const controls = { ...free(model, type), weights, trajectory, slip: 0 };
    if (known.steered && this.flags[0] && !known.stands) this.firstSteps.begin(type, speed);
    if (standing) return controls;
    if (known.steered) return this.firstSteps.reference(type, controls);
    if (!this.began) this.player.begin(type, speed);
    this.began = true;
    return { ...this.player.next(trajectory), weights, trajectory, slip: 0 };
  }

  get arrived() {
    return this.flags[1] === 1;
  }
}
