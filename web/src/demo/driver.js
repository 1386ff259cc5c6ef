// Converts requests to the controls of every frame, like Python's Driver (control/drive.py).

import { free, typeNumber } from "./kernel.js";
import { Follower } from "./path.js";
import { FirstSteps, Player } from "./player.js";

const [BLEND, DEFAULT_SECONDS] = [12, 2]; // frames of a change of type; default seconds of a performance
const NOTHING = { velocity: [0, 0], facing: null, type: null };

export class Driver {
  /** @param {import("./kernel.js").Character} body what is driven @param {number} choice chooses among recordings */
  constructor(body, choice = 0) {
    const { model } = body;
    const type = typeNumber(model, model.start);
    Object.assign(this, { body, model, choice, wish: NOTHING, type, player: new Player(model, choice), played: -1 });
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
    this.follower = new Follower(this.body, path, this.#stands, this.choice);
    this.wish = NOTHING;
    if (this.target === null) Object.assign(this, { from: this.weights, blended: 0 }); // another path may be of another type
  }

  /** Performs a type once, then returns to the wish. A second performance waits for the first to end. */
  perform(type, choice = 0, seconds = DEFAULT_SECONDS) {
    this.#known(type);
    this.waiting = [typeNumber(this.model, type), seconds, choice];
  }

  /** The controls of a frame; it must increase by one per call. */
  controls(frame) {
    this.#takeTurns(frame);
    const { performance } = this;
    this.body.observe(this.wish.velocity === null || this.follower !== null || performance !== null);
    let [kind, controls] = this.follower ? this.#follow() : this.#steer();
    if (performance) [kind, controls] = this.#show(performance, frame, kind, controls);
    return { ...controls, weights: this.#blend(kind, controls.weights) };
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
    player.begin(type, this.body.speed);
    const length = player.track?.performance || Math.max(1, Math.round((model.types[type].seconds || seconds) * model.fps));
    // The blend is half done at the performance's first frame, as in training.
    const begins = over && over.type === type ? frame : frame + BLEND / 2;
    this.performance = { type, begins, controls: Array.from({ length }, () => player.next()) };
  }

  #steer() {
    const { body, model, wish } = this;
    const { velocity, facing } = wish;
    const kind = wish.type === null ? body.suited(velocity ?? [0, 0], facing) : typeNumber(model, wish.type);
    if (velocity === null) return this.#recorded(kind);
    const { trajectory, slip } = body.steer(kind, velocity, facing);
    if (!model.types[kind].steered) return this.#recorded(kind, trajectory);
    this.played = -1;
    if (this.#stands && !model.types[kind].stands) this.firstSteps.begin(kind, Math.hypot(...velocity));
    return [kind, this.firstSteps.reference(kind, { ...free(model, kind), trajectory, slip })];
  }

  get #stands() {
    return this.target !== null && this.model.types[this.target].stands;
  }

  // The controls of a type with reference recordings.
  #recorded(kind, trajectory = null) {
    if (kind !== this.played) this.player.begin(kind, this.body.speed);
    this.played = kind;
    const controls = this.player.next(trajectory);
    return [kind, trajectory ? controls : { ...controls, trajectory: null }];
  }

  // The controls of a path; its target is null, so that leaving the path blends.
  #follow() {
    const controls = this.follower.controls(this.body.ground);
    if (this.follower.arrived) Object.assign(this, { follower: null, wish: NOTHING });
    return [null, controls];
  }

  // The controls of a performance. Before its first frame and near its end, only part of them apply.
  #show(performance, frame, kind, otherwise) {
    const at = frame - performance.begins;
    const { trajectory, slip } = otherwise;
    if (at < 0) return [performance.type, { ...free(this.model, performance.type), trajectory, slip }];
    let controls = { ...performance.controls[at], slip };
    if (at < performance.controls.length - BLEND / 2) kind = performance.type;
    else controls.weights = otherwise.weights;
    // A standing character can travel during a performance; a moving one keeps its trajectory.
    const moves = this.follower !== null || Math.hypot(...(this.wish.velocity ?? [0, 0])) >= this.model.stands_below;
    if (!controls.trajectory && moves) controls = { ...controls, trajectory };
    return [kind, controls];
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
