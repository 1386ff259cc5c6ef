// Random numbers: those of Python's random.Random, by which reference clips are drawn, and normal ones for the noise.

const [SIZE, MIDDLE] = [624, 397];

/** The Mersenne Twister as Python's random.Random(seed) has it, for seeds that are whole numbers of up to 32 bits. */
export class PythonRandom {
  constructor(seed) {
    const state = (this.state = new Uint32Array(SIZE));
    state[0] = 19650218;
    for (let i = 1; i < SIZE; i++) state[i] = Math.imul(1812433253, state[i - 1] ^ (state[i - 1] >>> 30)) + i;
    const mixed = (i, factor) => state[i] ^ Math.imul(state[i - 1] ^ (state[i - 1] >>> 30), factor);
    let i = 1;
    const next = () => {
      i += 1;
      if (i < SIZE) return;
      state[0] = state[SIZE - 1];
      i = 1;
    };
    for (let k = 0; k < SIZE; k++, next()) state[i] = mixed(i, 1664525) + (seed >>> 0);
    for (let k = 1; k < SIZE; k++, next()) state[i] = mixed(i, 1566083941) - i;
    state[0] = 0x80000000;
    this.at = SIZE;
  }

  /** 32 random bits. */
  bits32() {
    const { state } = this;
    if (this.at === SIZE) {
      for (let k = 0; k < SIZE; k++) {
        const y = (state[k] & 0x80000000) | (state[(k + 1) % SIZE] & 0x7fffffff);
        state[k] = state[(k + MIDDLE) % SIZE] ^ (y >>> 1) ^ (y & 1 ? 0x9908b0df : 0);
      }
      this.at = 0;
    }
    let y = state[this.at++];
    y ^= y >>> 11;
    y ^= (y << 7) & 0x9d2c5680;
    y ^= (y << 15) & 0xefc60000;
    return (y ^ (y >>> 18)) >>> 0;
  }

  /** A number from 0 to below 1. */
  random() {
    const high = this.bits32() >>> 5;
    return (high * 67108864 + (this.bits32() >>> 6)) / 9007199254740992;
  }

  /** A whole number below a count, as randbelow draws it. */
  below(count) {
    const shift = Math.clz32(count);
    let drawn;
    do drawn = this.bits32() >>> shift;
    while (drawn >= count);
    return drawn;
  }

  /** So many of some, each at most once, as sample(some, count) draws them. */
  sample(some, count) {
    const small = 21 + (count > 5 ? 4 ** Math.ceil(Math.log(count * 3) / Math.log(4)) : 0);
    if (some.length <= small) {
      const pool = [...some];
      return Array.from({ length: count }, (_, i) => {
        const at = this.below(some.length - i);
        const drawn = pool[at];
        pool[at] = pool[some.length - i - 1];
        return drawn;
      });
    }
    const seen = new Set();
    while (seen.size < count) seen.add(this.below(some.length));
    return [...seen].map((at) => some[at]);
  }
}

/** A function that fills arrays with standard normal numbers: xoshiro128** and the polar method, by a seed. */
export function normals(seed) {
  const state = new Uint32Array(4);
  for (let i = 0, mix = seed | 0; i < 4; i++) {
    mix = (mix + 0x9e3779b9) | 0;
    let z = Math.imul(mix ^ (mix >>> 16), 0x85ebca6b);
    z = Math.imul(z ^ (z >>> 13), 0xc2b2ae35);
    state[i] = z ^ (z >>> 16);
  }
  const turned = (x, k) => (x << k) | (x >>> (32 - k));
  const uniform = () => {
    const drawn = Math.imul(turned(Math.imul(state[1], 5), 7), 9) >>> 0;
    const shifted = state[1] << 9;
    state[2] ^= state[0];
    state[3] ^= state[1];
    state[1] ^= state[2];
    state[0] ^= state[3];
    state[2] ^= shifted;
    state[3] = turned(state[3], 11);
    return drawn / 2147483648 - 1;
  };
  return (out) => {
    for (let n = 0; n < out.length; n += 2) {
      let [x, y, size] = [0, 0, 0];
      do {
        [x, y] = [uniform(), uniform()];
        size = x * x + y * y;
      } while (size >= 1 || size === 0);
      const scale = Math.sqrt((-2 * Math.log(size)) / size);
      out[n] = x * scale;
      if (n + 1 < out.length) out[n + 1] = y * scale;
    }
  };
}
