// The characters of the page and their requests, frame by frame, like Python's Session (play/session.py).
//
// Every request passes through obey at a frame, so the same seed and requests give the same motion again.

import { Character, normals } from "./kernel.js";
import { Driver } from "./driver.js";

const BETWEEN = 120; // cm between start positions
const TEMPERATURE = 0.05; // standard deviations, default noise
const JOINS_WITHIN = 30; // cm; a path that begins further away is extended by a line from the character
const MOST_CORNERS = 5000; // points of a requested path
export const MOST = 20; // characters

export class World {
  /** @param {import("./kernel.js").Kernel} kernel @param {number} seed a whole number */
  constructor(kernel, seed) {
    Object.assign(this, { kernel, model: kernel.model, seed, frame: 0, last: 0, characters: new Map(), done: [] });
    this.#add();
  }

  /** Carries out a request {do, character, ...} (docs/live.md); throws if it is impossible. */
  obey(request) {
    const number = request.character ?? this.characters.keys().next().value;
    const one = this.characters.get(number);
    if (!one && request.do !== "add") throw new Error(`there is no character ${number}`);
    check(request); // links may contain anything
    if (request.do === "add") this.#add();
    else if (request.do === "wish") one.driver.set(request);
    else if (request.do === "perform") one.driver.perform(request.type, this.frame, request.seconds);
    else if (request.do === "path") one.driver.follow(this.#path(request, one));
    else if (request.do === "stroll") one.driver.follow(this.#path({ points: figureEight(250, 12) }, one));
    else if (request.do === "noise") one.body.temperature = one.temperature = request.temperature;
    else if (request.do === "reset") this.#start(one);
    else if (request.do === "remove") this.characters.delete(number);
    else throw new Error(`cannot do ${request.do}`);
    this.done.push([this.frame, request]);
  }

  /** Puts another body on a character, where it is: its name, and its kernel's data by rigOf, null for the model's. */
  wear(number, worn, own) {
    const one = this.characters.get(number);
    if (one.worn === worn) return;
    Object.assign(one, { worn, own });
    this.#start(one, one.body.ground);
  }

  /** Computes one frame; returns the characters by number, as the pages draw them. */
  step() {
    this.frame += 1;
    const shown = new Map();
    const arrived = [];
    for (const [number, one] of this.characters) {
      const { body, driver } = one;
      const followed = driver.follower;
      body.step(driver.controls(this.frame));
      if (!Number.isFinite(body.positions[0])) this.#start(one);
      if (followed && !driver.follower) arrived.push(number);
      const [root, rotations] = [body.root.slice(), body.rotations.slice()];
      one.recorded?.push({ root, rotations });
      shown.set(number, {
        seq: one.seq,
        type: driver.type,
        performing: driver.performance !== null,
        following: driver.follower !== null,
        recording: Boolean(one.recorded),
        root,
        rotations,
      });
    }
    return { shown, arrived };
  }

  // The requested path of a character, with a line to its start.
  #path({ points, type = null, speed = null, stops = [] }, { body }) {
    const [x, z] = body.ground;
    const kind = type ?? this.model.types[body.suited([0, speed ?? 100], null)].name;
    const way = Math.hypot(points[0][0] - x, points[0][1] - z) > JOINS_WITHIN ? [[x, z]] : [];
    return { points: [...way, ...points], type: kind, speed, stops: stops.map(([at, seconds]) => [at + way.length, seconds]) };
  }

  #add() {
    const { characters, kernel } = this;
    if (characters.size >= MOST) throw new Error(`there is room for ${MOST} characters`);
    const taken = new Set([...characters.values()].map(({ slot }) => slot));
    const slot = Array.from({ length: MOST }, (_, n) => n).find((n) => !taken.has(n));
    this.last += 1;
    const one = { number: this.last, slot, seq: 0, recorded: null, temperature: TEMPERATURE, worn: "default", own: null };
    one.body = new Character(kernel, slot, normals(this.seed + this.last));
    this.#start(one);
    characters.set(this.last, one);
  }

  // Start positions form rows of seven; each row alternates to the left and right of its first.
  #start(one, at = null) {
    const [row, place] = [Math.floor(one.slot / 7), one.slot % 7];
    one.body.start(at ?? [BETWEEN * Math.ceil(place / 2) * (-1) ** place, -BETWEEN * row, 0]);
    one.body.wear(one.own);
    one.body.temperature = one.temperature;
    one.driver = new Driver(one.body, this.seed + one.number);
  }
}

const finite = (value, count) => Array.isArray(value) && value.length === count && value.every(Number.isFinite);

function check({ do: what, velocity, facing, type, points, seconds, speed, stops, temperature }) {
  if (what === "wish" && !(velocity === null || finite(velocity, 2))) throw new Error("expected a velocity [x, z] or null");
  if (what === "wish" && !(facing === null || Number.isFinite(facing))) throw new Error("expected a facing or null");
  if (what === "perform" && typeof type !== "string") throw new Error("expected a motion type");
  if (what === "perform" && !(seconds === undefined || (seconds >= 0.1 && seconds <= 60))) throw new Error("expected 0.1 to 60 seconds");
  if (what === "noise" && !(temperature >= 0 && temperature <= 2)) throw new Error("expected a temperature from 0 to 2");
  if (what !== "path") return;
  if (!Array.isArray(points) || points.length < 2 || !points.every((point) => finite(point, 2))) throw new Error("expected points [x, z]");
  if (points.length > MOST_CORNERS) throw new Error(`expected at most ${MOST_CORNERS} points`);
  if (!(speed === undefined || speed === null || (speed >= 5 && speed <= 1000))) throw new Error("expected a speed from 5 to 1000 cm/s");
  if (stops !== undefined) checkStops(stops, points.length);
}

function checkStops(stops, count) {
  const isStop = (stop, n) =>
    finite(stop, 2) && Number.isInteger(stop[0]) && stop[0] > (n ? stops[n - 1][0] : 0) && stop[0] < count && stop[1] >= 0.1 && stop[1] <= 600;
  if (!Array.isArray(stops) || !stops.every(isStop)) throw new Error("expected stops [number of a point, seconds], in the order of the path");
}

/** Points [x, z] of a figure eight that starts at the origin towards +Z. */
function figureEight(radius, laps) {
  const steps = 72;
  return Array.from({ length: laps * 2 * steps + 1 }, (_, n) => {
    const side = Math.floor(n / steps) % 2 ? -1 : 1;
    const angle = (2 * Math.PI * (n % steps)) / steps;
    return [side * radius * (1 - Math.cos(angle)), radius * Math.sin(angle)];
  });
}

