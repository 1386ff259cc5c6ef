// Runs the C kernels as WebAssembly and advances characters frame by frame.
//
// Does the same as Python's RolloutState and CharacterStream around the kernels. The kernels' memory comes from the
// model file (kernel_image.py); model.addresses has the addresses of its arrays.


const PAGE = 65536; // bytes of a page of WebAssembly memory
const ROUTE = 32 * PAGE; // bytes for a character's path
const NEITHER = () => 0;

export class Kernel {
  /** Compiles to a kernel with memory for `most` characters. @param {WebAssembly.Module} module @param {object} model result of readModel */
  static async from(module, model, most) {
    // The C library imports random_get, which no kernel calls.
    const { exports } = await WebAssembly.instantiate(module, { wasi_snapshot_preview1: { random_get: NEITHER } });
    const kernel = Object.assign(new Kernel(), { run: exports, model, most });
    if (exports.__heap_base.value > model.base) throw new Error("the model file does not fit the kernels");
    const { shared, own } = model.arrays;
    kernel.size = roundUp(own.length, 64);
    kernel.first = roundUp(model.base + shared.length, 64);
    kernel.scratch = kernel.first + most * kernel.size;
    kernel.routes = kernel.scratch + 4 * PAGE;
    const bytes = kernel.routes + most * ROUTE; // before the call of scratch_size, which needs its memory
    exports.memory.grow(Math.max(0, Math.ceil((bytes - exports.memory.buffer.byteLength) / PAGE)));
    kernel.bytes().set(shared, model.base);
    const scratch = 4 * Number(exports.scratch_size(model.addresses.program, 1n));
    if (scratch < 0 || scratch > 4 * PAGE) throw new Error("the kernels cannot run this network");
    return kernel;
  }

  bytes(at = 0, length = undefined) {
    return new Uint8Array(this.run.memory.buffer, at, length);
  }
}

/** A character in the kernels' memory. */
export class Character {
  /** @param {Kernel} kernel @param {number} slot index among the characters @param {(out: Float32Array) => void} normals fills an array with standard normal numbers */
  constructor(kernel, slot, normals) {
    const { model } = kernel;
    Object.assign(this, { kernel, model, normals, at: kernel.first + slot * kernel.size, route: kernel.routes + slot * ROUTE });
    this.steering = this.at + model.addresses.steering;
    const { features, contacts, controls } = model;
    const floats = (name, count, type = Float32Array) => new type(kernel.run.memory.buffer, this.at + model.addresses[name], count);
    this.row = features + contacts + 1;
    this.recent = floats("recent", model.kernel * this.row);
    this.filled = floats("filled", 1, BigInt64Array);
    this.controls = floats("controls", controls.size);
    this.mean = floats("out", 2 * features);
    for (const name of ["x", "before", "last", "fresh", "noise", "smooth"]) this[name] = floats(name, features);
    for (const name of ["velocity_blend", "slip_correction", "feet_hold"]) this[name] = floats(name, 1);
    this.contacts = floats("contacts", contacts);
    this.place = floats("ground", 3);
    this.carry = floats("feet_carry", 2);
    this.rotations = floats("rotations", 92);
    this.root = floats("root", 3);
    this.positions = floats("positions", 69);
    this.offsets = floats("offsets", 69);
    this.soles = { points: floats("soles_points", 12 * model.fields.sole_points), counts: floats("soles_counts", 4, BigInt64Array), floor: floats("soles_floor", 1) };
    this.words = new DataView(kernel.run.memory.buffer, this.at);
    this.trajectory = new Float32Array(kernel.run.memory.buffer, this.steering + model.fields.trajectory, 24);
    this.noiseSize = null;
  }

  /** Restarts from the model's start pose at [x, z, heading] in cm and radians. */
  start(place) {
    const { kernel, model } = this;
    kernel.bytes(this.at).set(model.arrays.own);
    for (const offset of model.moved) this.words.setUint32(offset, this.words.getUint32(offset, true) + this.at, true);
    if (this.noiseSize !== null) this.temperature = this.noiseSize;
    this.slot = model.slot;
    this.place.set(place);
    this.normals(this.noise);
    this.smooth.set(this.noise);
  }

  /** Puts on a body of rigOf, or leaves that of start if there is none: its offsets, and its soles if they are known. */
  wear(body) {
    if (!body) return;
    this.offsets.set(body.offsets);
    const { points, counts, floor } = this.soles;
    counts.fill(0n);
    body.soles.forEach((part, n) => {
      points.set(part.flat(), 3 * n * this.model.fields.sole_points);
      counts[n] = BigInt(part.length);
    });
    floor[0] = body.floor;
  }

  /** Sets the noise temperature, in standard deviations. */
  set temperature(size) {
    this.noiseSize = size;
    this.words.setFloat32(this.model.addresses.draw + this.model.fields.temperature, size, true);
  }

  /** Root x, z (cm) and heading (radians) in the world. */
  get ground() {
    const { place, carry } = this;
    return [Math.fround(place[0] + carry[0]), Math.fround(place[1] + carry[1]), place[2]];
  }

  /** Records the body's place for steering, once per frame; free: nobody steers, so its springs follow the body. */
  observe(free) {
    this.kernel.run.observe(this.steering, ...this.ground, free);
  }

  /** The speed of the springs in cm/s. */
  get speed() {
    return this.kernel.run.spring_speed(this.steering);
  }

  /** The index of the type for a requested velocity [x, z] (cm/s) and facing (radians, null for any). */
  suited(velocity, facing) {
    return this.kernel.run.steered_type(this.steering, ...velocity, facing ?? NaN);
  }

  /** The trajectory of a type, by its index, for a request, and the factor on the root-slip correction. */
  steer(type, velocity, facing) {
    const slip = this.kernel.run.steer(this.steering, type, ...velocity, facing ?? NaN);
    return { trajectory: this.trajectory.slice(), slip };
  }

  /** Computes one frame from controls of Driver; the results are in rotations, root, positions and contacts. */
  step(controls) {
    const { kernel, model, mean } = this;
    // The root-slip correction acts on all bodies but standing ones, like root_hold in Python.
    const moving = model.types.reduce((sum, type, i) => (type.stands ? sum : sum + controls.weights[i]), 0);
    this.feet_hold[0] = controls.slip * moving;
    const share = this.#ask(controls);
    this.#step();
    for (let n = 0; n < model.features; n++) mean[model.features + n] += share;
    this.normals(this.fresh);
    kernel.run.draw_frames(this.at + model.addresses.draw, 1n);
    kernel.run.pose_frames(this.at + model.addresses.pose, 1n);
  }

  // Writes the control vector and the sampling presets of the types; returns the logarithm of the noise scale.
  #ask({ weights, trajectory, phase, reference, gain, slip }) {
    const { controls: out, model, x } = this;
    const { controls: columns, arrays } = model;
    const presets = [0, 0, 0];
    out.fill(0);
    for (let type = 0; type < weights.length; type++) {
      out[columns.types + type] = weights[type];
      for (let k = 0; k < 3; k++) presets[k] += weights[type] * arrays.presets[3 * type + k];
    }
    if (trajectory) {
      for (let n = 0; n < 24; n++) out[columns.trajectory + n] = (trajectory[n] - arrays.trajectory[n]) / arrays.trajectory[24 + n];
      out[columns.mask] = 1;
    }
    if (phase >= 0) {
      out[columns.phase] = Math.sin(2 * Math.PI * phase);
      out[columns.phase + 1] = Math.cos(2 * Math.PI * phase);
    }
    if (gain > 0) {
      const { reference_gains: gains, reference_matrix: matrix, reference_constant: constant } = arrays;
      const present = Float64Array.from(constant);
      for (let n = 0; n < x.length; n++) for (let k = 0; k < 72; k++) present[k] += x[n] * matrix[n * 72 + k];
      for (let k = 0; k < 72; k++) out[columns.reference + k] = gain * (gains[k] * reference[k] - present[k]);
      out[columns.gain] = 1;
    }
    this.velocity_blend[0] = presets[1];
    this.slip_correction[0] = presets[2] * slip;
    return Math.log(Math.max(presets[0], 1e-6));
  }

  // Runs the network: from the frame in x and contacts to the Gaussian of the next frame.
  #step() {
    const { kernel, model, recent, row, x, mean, last, words } = this;
    const { addresses, fields } = model;
    const newest = (model.kernel - 1) * row;
    recent.copyWithin(0, row);
    recent.set(x, newest);
    recent.set(this.contacts, newest + model.features);
    this.filled[0] += 1n;
    this.slot = (this.slot + 1) % model.window;
    words.setBigInt64(addresses.frame + fields.slot, BigInt(this.slot), true);
    words.setUint32(addresses.frame + fields.position, addresses.position + this.slot * fields.position_bytes, true);
    kernel.run.step(addresses.program, this.at + addresses.frame, 0n, 1n, kernel.scratch);
    const { momentum } = model.arrays;
    for (let n = 0; n < x.length; n++) mean[n] += momentum[n] * (x[n] - last[n]);
    last.set(x);
  }
}

/** Controls of a type without trajectory, phase or reference. */
export function free(model, type) {
  const weights = new Float32Array(model.types.length);
  weights[type] = 1;
  return { weights, trajectory: null, phase: -1, reference: null, gain: 0, slip: 1 };
}

/** The index of a type by its name. */
export function typeNumber(model, name) {
  return model.types.findIndex((type) => type.name === name);
}

function roundUp(value, step) {
  return Math.ceil(value / step) * step;
}

/** A function that fills arrays with standard normal numbers from a seed (mulberry32 and Box-Muller). */
export function normals(seed) {
  let state = Math.imul(seed, 0x9e3779b9);
  const uniform = () => {
    state = (state + 0x6d2b79f5) | 0;
    let bits = Math.imul(state ^ (state >>> 15), state | 1);
    bits ^= bits + Math.imul(bits ^ (bits >>> 7), bits | 61);
    return ((bits ^ (bits >>> 14)) >>> 0) / 2 ** 32;
  };
  return (out) => {
    for (let n = 0; n < out.length; n += 2) {
      const [size, angle] = [Math.sqrt(-2 * Math.log(1 - uniform())), 2 * Math.PI * uniform()];
      out.set([size * Math.cos(angle), size * Math.sin(angle)].slice(0, out.length - n), n);
    }
  };
}
