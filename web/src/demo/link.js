// Replaces the server of `motionkit play` within the page; has the listeners and methods of play/link.js.

import { bvhText } from "./bvh.js";
import { glbBytes } from "./glb.js";
import { heroBytes } from "./hero.js";
import { World } from "./world.js";

const CLIENT = 1;
const [CATCH_UP, BUDGET] = [15, 30]; // most frames and ms of computing between two pictures
const MOST_RECORDED = 5 * 60; // seconds of a recording
const LIMITS = { messages_per_second: 120, path_points: 500 };
const KEPT = ["wish", "perform", "path", "stroll", "noise", "reset", "remove", "add"]; // requests that a link replays

export class LocalLink {
  /**
   * @param {{hello: Function, event: Function, frame: Function}} listeners
   * @param {object} bodies figures by name
   */
  constructor(listeners, bodies) {
    Object.assign(this, { listeners, bodies, seq: 0, replayed: [], stepMs: 0, behind: false });
  }

  /** Starts the session; replayed lists the [frame, request] of a link. */
  begin(kernel, seed, replayed = []) {
    const { model } = kernel;
    this.model = model;
    this.world = new World(kernel, seed);
    this.replayed = [...replayed];
    this.period = 1 / model.fps;
    this.hello = {
      client: CLIENT, character: 1, fps: model.fps, limits: LIMITS, recording_format: "bvh", characters: this.#facts(), bodies: [{ name: "default" }],
      types: model.types.map(({ name, gait, seconds }) => ({ name, speed: gait?.speed ?? 0, facing: gait?.facing ?? 0, seconds })),
      steered: model.types.filter(({ steered }) => steered).map(({ name }) => name),
    };
    this.#replay();
    this.before = this.after = this.#step();
    this.listeners.hello(this.hello);
  }

  /** The figure of a body. */
  async figure(name) {
    return this.bodies[name];
  }

  /** Whether requests of a link remain to be replayed. */
  get replays() {
    return this.replayed.length > 0;
  }

  /** Carries out a request from the next frame on; returns its number. */
  ask(what, fields = {}, counted = false) {
    if (!this.hello || what === "ping") return null;
    if (what === "record") this.#record(fields);
    else if (what === "body") this.#wear(fields.character, fields.body);
    else if (KEPT.includes(what)) {
      this.replayed = []; // a request by the user ends the replay
      const obeyed = this.#obey({ do: what, ...rounded(fields) });
      if (obeyed && what === "add" && fields.body) this.#wear(this.world.last, fields.body);
    }
    if (!counted) return this.seq;
    this.seq += 1;
    const one = this.world.characters.get(fields.character);
    if (one) one.seq = this.seq;
    return this.seq;
  }

  /** The two frames around a time (seconds) and the fraction between them; computes frames that are due. */
  around(now) {
    if (!this.hello) return null;
    this.began ??= now - this.period * (this.after.number - 1);
    const due = (now - this.began) / this.period;
    const begun = performance.now();
    for (let made = 0; this.after.number < due + 1; made++) {
      if (made === CATCH_UP || performance.now() - begun > BUDGET) {
        this.began = now - this.period * (this.after.number - 1); // slow down time, because motion cannot be made fast enough
        break;
      }
      this.before = this.after;
      this.#replay();
      this.after = this.#step();
      this.listeners.frame(this.after);
    }
    this.#pace(now);
    return { before: this.before, after: this.after, share: Math.max(0, Math.min(1, (now - this.began) / this.period - this.before.number)) };
  }

  #step() {
    const began = performance.now();
    const { shown, arrived } = this.world.step();
    this.stepMs += 0.1 * (performance.now() - began - this.stepMs);
    for (const character of arrived) this.listeners.event({ event: "arrived", character });
    for (const one of this.world.characters.values()) {
      if (one.recorded?.length >= MOST_RECORDED * this.model.fps) this.#record({ character: one.number, on: false });
    }
    return { number: this.world.frame, stepMs: this.stepMs, fps: this.fps ?? this.model.fps, characters: shown };
  }

  #replay() {
    while (this.replayed.length && this.replayed[0][0] <= this.world.frame) this.#obey(this.replayed.shift()[1]);
  }

  // Carries out a request; returns whether it could be.
  #obey(request) {
    let obeyed = true;
    try {
      this.world.obey(request);
    } catch (error) {
      obeyed = false;
      this.listeners.event({ event: "error", message: error.message });
    }
    if (["add", "remove", "noise"].includes(request.do)) this.#changed();
    return obeyed;
  }

  #wear(character, name) {
    if (this.world.characters.get(character)?.recorded) {
      this.listeners.event({ event: "error", message: "the body cannot change during a recording; end the recording first" });
      return;
    }
    this.world.wear(character, name, this.bodies[name].kernel ?? null);
    this.#changed();
  }

  #changed() {
    this.listeners.event({ event: "characters", characters: this.#facts() });
  }

  #facts() {
    return [...this.world.characters.values()].map(({ number, recorded, temperature, worn }) => ({
      id: number, body: worn, owner: CLIENT, recording: Boolean(recorded), noise: "correlated", temperature,
    }));
  }

  #record({ character, on }) {
    const one = this.world.characters.get(character);
    if (!one) return;
    const { recorded } = one;
    one.recorded = on ? [] : null;
    this.#changed();
    if (on || !recorded?.length) return;
    const { fps, bvh } = this.model;
    const seconds = recorded.length / fps;
    if (one.own) {
      const format = one.worn.split(".").at(-1).toLowerCase();
      heroBytes(this.bodies[one.worn], recorded, fps).then(
        (content) => this.listeners.event({ event: "recorded", character, url: addressOf(content), format, seconds }),
        ({ message }) => this.listeners.event({ event: "error", message }),
      );
      return;
    }
    const url = addressOf(bvhText(bvh, recorded, fps));
    const others = { glb: async (figure) => addressOf(await glbBytes(figure, recorded, fps)) };
    this.listeners.event({ event: "recorded", character, url, format: "bvh", others, seconds });
  }

  // Sends a pace event when the machine falls behind or catches up.
  #pace(now) {
    const { number } = this.after;
    this.paced ??= { now, number };
    const passed = now - this.paced.now;
    if (passed < 1) return;
    if (passed > 3) { // the page was hidden, and made no frames
      this.paced = { now, number };
      return;
    }
    this.fps = (number - this.paced.number) / passed;
    this.paced = { now, number };
    const behind = this.fps < 0.9 * this.model.fps;
    if (behind !== this.behind) this.listeners.event({ event: "pace", behind, fps: this.fps, step_ms: this.stepMs });
    this.behind = behind;
  }
}

const addressOf = (content) => URL.createObjectURL(new Blob([content], { type: "application/octet-stream" }));

// Rounds numbers as links store them, so that a replay gives the same motion.
function rounded(value) {
  if (typeof value === "number") return Math.round(value * 1e3) / 1e3;
  if (Array.isArray(value)) return value.map(rounded);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([name, each]) => [name, rounded(each)]));
}
