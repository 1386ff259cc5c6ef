// Converts requests to the controls of every frame, like Python's Driver (control/drive.py).

import { free, typeNumber } from "./kernel.js";
import { Follower } from "./path.js";
import { FirstSteps, Player } from "./player.js";
import { Springs, nearestWish, steeredType } from "./springs.js";

const [BLEND, DEFAULT_SECONDS] = [12, 2]; // frames of a change of type; default seconds of a performance
const NOTHING = { velocity: [0, 0], facing: null, type: null };

export class Driver {
  /** @param {object} model result of readModel @param {number} choice chooses among recordings */
  constructor(model, choice = 0) {
    const type = typeNumber(model, model.start);
    Object.assign(this, { model, choice, wish: NOTHING, type, springs: new Springs(model), player: new Player(model, choice), played: -1 });
    Object.assign(this, { follower: null, performance: null, waiting: null, firstSteps: new FirstSteps(model, choice) });
    this.weights = free(model, type).weights;
    Object.assign(this, { from: this.weights, target: type, blended: BLEND });
  }

  /** Sets a new wish: {velocity: [x, z] cm/s or null, facing: radians or null, type: name or null}. */
  set({ velocity, facing, type = null }) {
    this.#known(type);
    this.wish = { velocity, facing, type };
    this.follower = null;
  }

  /** Follows a path (arguments as for Follower); the character stands at its end. */
  follow(path) {
    this.#known(path.type);
    this.follower = new Follower(this.model, path, this.choice);
    this.wish = NOTHING;
  }

  /** Performs a type once, then returns to the wish. A second performance waits for the first to end. */
  perform(type, choice = 0, seconds = DEFAULT_SECONDS) {
    this.#known(type);
    this.waiting = [typeNumber(this.model, type), seconds, choice];
  }

  /** The controls of a frame for a body at [x, z, heading]; frame must increase by one per call. */
  controls(frame, ground) {
    this.#takeTurns(frame);
    const shown = this.performance;
    this.springs.observe(...ground, this.wish.velocity === null || this.follower !== null || shown !== null);
    let [kind, asked] = this.follower ? this.#follow(ground) : this.#steer();
    if (shown) [kind, asked] = this.#show(shown, frame, kind, asked);
    return { ...asked, weights: this.#blend(kind, asked.weights) };
  }

  // Ends a finished performance, begins the next one, or repeats the performance that the wish holds.
  #takeTurns(frame) {
    const over = this.performance;
    if (over && frame < over.begins + over.controls.length) return;
    this.performance = null;
    const { model } = this;
    const held = this.wish.type === null ? -1 : typeNumber(model, this.wish.type);
    if (!this.waiting && !this.follower && held >= 0 && model.types[held].seconds) this.waiting = [held, DEFAULT_SECONDS, frame];
    if (!this.waiting) return;
    const [type, seconds, choice] = this.waiting;
    this.waiting = null;
    const player = new Player(model, choice);
    player.begin(type, Math.hypot(...this.springs.velocity));
    const length = player.track?.performance || Math.max(1, Math.round((model.types[type].seconds || seconds) * model.fps));
    // The blend is half done at the performance's first frame, as in training.
    const begins = over && over.type === type ? frame : frame + BLEND / 2;
    this.performance = { type, begins, controls: Array.from({ length }, () => player.next()) };
  }

  #steer() {
    const { model, wish } = this;
    const { velocity } = wish;
    const kind = wish.type === null ? steeredType(model, velocity ?? [0, 0], wish.facing) : typeNumber(model, wish.type);
    if (velocity === null) return this.#recorded(kind);
    let { facing } = wish;
    if (facing === null && Math.hypot(...velocity) >= model.steering.stands_below) facing = Math.atan2(...velocity) - (model.types[kind].gait?.facing ?? 0);
    const [nearest, turned] = nearestWish(model, model.types[kind], velocity, facing);
    const slip = this.springs.settled(nearest);
    const trajectory = this.springs.trajectory(nearest, turned);
    if (!model.types[kind].steered) return this.#recorded(kind, trajectory);
    this.played = -1;
    if (this.#goesFromStanding(kind)) this.firstSteps.begin(kind, Math.hypot(...nearest));
    return [kind, this.firstSteps.shown(kind, { ...free(model, kind), trajectory, slip })];
  }

  // Whether the character starts a gait from standing in this frame.
  #goesFromStanding(kind) {
    const { types } = this.model;
    return !types[kind].stands && this.target !== null && types[this.target].stands;
  }

  // The controls of a type with reference recordings.
  #recorded(kind, trajectory = null) {
    if (kind !== this.played) this.player.begin(kind, Math.hypot(...(trajectory ? this.wish.velocity : this.springs.velocity)));
    this.played = kind;
    const asked = this.player.next(trajectory);
    return [kind, trajectory ? asked : { ...asked, trajectory: null }];
  }

  // The controls of a path; its target is null, so that leaving the path blends.
  #follow(ground) {
    const asked = this.follower.controls(ground);
    if (this.follower.arrived) Object.assign(this, { follower: null, wish: NOTHING });
    return [null, asked];
  }

  // The controls of a performance. Before its first frame and near its end, only part of them apply.
  #show(shown, frame, kind, otherwise) {
    const at = frame - shown.begins;
    const { trajectory, slip } = otherwise;
    if (at < 0) return [shown.type, { ...free(this.model, shown.type), trajectory, slip }];
    let asked = { ...shown.controls[at], slip };
    if (at < shown.controls.length - BLEND / 2) kind = shown.type;
    else asked.weights = otherwise.weights;
    // A standing character can travel during a performance; a moving one keeps its trajectory.
    const moves = this.follower !== null || Math.hypot(...(this.wish.velocity ?? [0, 0])) >= this.model.steering.stands_below;
    if (!asked.trajectory && moves) asked = { ...asked, trajectory };
    return [kind, asked];
  }

  // Type weights, blended linearly to the goal within BLEND frames of a change of kind.
  #blend(kind, goal) {
    if (kind !== this.target) Object.assign(this, { from: this.weights, target: kind, blended: 0 });
    this.blended += 1;
    const share = Math.min(1, this.blended / BLEND);
    this.weights = this.from.map((weight, n) => weight + share * (goal[n] - weight));
    this.type = kind ?? goal.indexOf(Math.max(...goal));
    return this.weights;
  }

  #known(name) {
    if (name !== null && typeNumber(this.model, name) < 0) throw new Error(`unknown motion type ${name}`);
  }
}
