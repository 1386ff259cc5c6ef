// Predicts the next second of a steered character, like Python's Steering (control/steering.py).

export const TRAJECTORY = [10, 20, 30, 40, 50, 60]; // frames ahead of the present one

/** The equivalent angle between -pi and pi. */
export function nearestTurn(angle) {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}

// The rate (1/s) of a critically damped spring that halves its distance in `halflife` seconds.
const rate = (halflife) => 1.678347 / Math.max(halflife, 1e-3);

// Distance from the goal and velocity after t seconds.
function spring(away, velocity, y, t) {
  const push = velocity + away * y;
  const fade = Math.exp(-y * t);
  return [fade * (away + push * t), fade * (velocity - y * push * t)];
}

// The integral of the distance from the goal over t seconds.
function travel(away, velocity, y, t) {
  const push = velocity + away * y;
  const fade = Math.exp(-y * t);
  return (away * (1 - fade) + push * ((1 - fade) / y - t * fade)) / y;
}

/** A vector [x, z], turned about Y. */
export function turned(angle, x, z) {
  const [sine, cosine] = [Math.sin(angle), Math.cos(angle)];
  return [cosine * x + sine * z, cosine * z - sine * x];
}

/** The index of the steered type for a requested velocity [x, z] (cm/s) and facing (radians, null for any). */
export function steeredType(model, velocity, facing) {
  const all = model.types.map((type, number) => ({ ...type, number }));
  const steered = all.filter((type) => type.steered);
  const phaseless = all.filter((type) => !type.seconds);
  const [speed, set] = [Math.hypot(...velocity), model.steering];
  const going = speed >= set.goes_from ? steered.filter((type) => !type.stands) : [];
  const known = [going, steered, phaseless, all].find(({ length }) => length);
  const wanted = facing === null ? 0 : Math.atan2(...velocity) - facing;
  const cost = ({ gait }) => {
    if (!gait) return Infinity;
    const off = Math.abs(Math.sqrt(speed) - Math.sqrt(gait.speed));
    if (speed < set.stands_below) return off;
    return off + set.turn_cost * (Math.abs(nearestTurn(wanted - gait.facing)) + set.backwards_share * Math.abs(gait.facing));
  };
  return known.reduce((best, type) => (cost(type) < cost(best) ? type : best)).number;
}

/** The velocity [x, z] and facing nearest to the requested ones that a steered type can step (Python's GaitLimits). */
export function nearestWish({ steering }, type, velocity, facing) {
  const speed = Math.hypot(...velocity);
  if (type.stands) return [[0, 0], facing];
  if (speed < steering.stands_below || !type.steered || !type.gait) return [velocity, facing];
  const [slowest, fastest] = type.speeds ?? [0, Infinity];
  const share = Math.min(Math.max(speed, slowest), fastest) / speed;
  if (facing !== null) {
    const own = Math.atan2(...velocity) - type.gait.facing;
    const aside = nearestTurn(facing - own);
    const most = type.gait.runs ? steering.most_aside_running : steering.most_aside;
    if (Math.abs(aside) > most) facing = own + Math.sign(aside) * most;
  }
  return [[share * velocity[0], share * velocity[1]], facing];
}

export class Springs {
  /** @param {{fps: number, steering: object}} model result of readModel, with the settings of SteeringOptions */
  constructor({ fps, steering }) {
    Object.assign(this, { fps, set: steering, velocity: [0, 0], acceleration: [0, 0], measured: [0, 0], facing: null, before: null, anchor: null });
  }

  /** Records the body's place, once per frame; free: nobody steers, so the spring follows the body. */
  observe(x, z, heading, free) {
    const before = this.before ?? [x, z, heading];
    this.before = [x, z, heading];
    const share = free ? 1 : this.set.own_share;
    for (const axis of [0, 1]) {
      const step = (this.before[axis] - before[axis]) * this.fps;
      this.measured[axis] += this.set.smoothing * (step - this.measured[axis]);
      this.velocity[axis] += share * (this.measured[axis] - this.velocity[axis]);
      this.acceleration[axis] *= 1 - share;
    }
    const [facing, turning] = this.facing ?? [heading, 0];
    this.facing = [heading + nearestTurn(facing - heading) * (1 - share), turning * (1 - share)];
    if (free) this.anchor = null;
  }

  /** The 24 trajectory numbers for a requested velocity [x, z] and facing (null keeps it); call observe before. */
  trajectory(velocity, facing) {
    const [x, z, heading] = this.before;
    const stands = Math.hypot(...velocity) < this.set.stands_below;
    if (facing !== null) [velocity, facing] = this.#turning(velocity, facing);
    const goal = stands ? [0, 0] : velocity;
    const anchor = stands ? this.#hold(x, z) : null;
    if (!stands) this.anchor = null;
    const wanted = facing ?? (anchor ? anchor[2] : heading);
    const [xs, zs] = [0, 1].map((axis) => this.#places(axis, goal[axis], anchor));
    const turns = this.#turns(wanted, heading);
    this.#advance(goal, wanted);
    const places = xs.flatMap((ahead, n) => turned(-heading, ahead, zs[n]));
    return Float32Array.from([...places, ...turns.flatMap((turn) => [Math.sin(turn), Math.cos(turn)])]);
  }

  /** Strength of the root-slip correction, 0 to 1: zero while the body still has to turn or speed up. */
  settled(velocity) {
    const speed = Math.hypot(...velocity);
    if (speed < this.set.stands_below) return 1;
    const along = (this.velocity[0] * velocity[0] + this.velocity[1] * velocity[1]) / speed;
    return Math.min(1, Math.max(0, 1 - (1 - along / speed) / this.set.settled_within));
  }

  // The velocity and facing to approach: a body turns about where it faces, and slows down to turn back.
  #turning(velocity, facing) {
    const { set } = this;
    const off = nearestTurn(facing - this.facing[0]);
    const most = (2 * set.turn_speed) / rate(set.turn_halflife); // a spring whose goal stays at distance d ahead of it moves by d rate / 2
    const share = Math.min(Math.max(1 + Math.cos(off), set.turn_share), 1);
    const beyond = Math.max(Math.abs(off) - (Math.hypot(...velocity) > set.run_speed ? 0 : set.turn_aside), 0);
    return [turned(-Math.sign(off) * beyond, ...velocity).map((value) => share * value), this.facing[0] + Math.min(Math.max(off, -most), most)];
  }

  // The position and heading to hold, once the spring has nearly stopped; null before.
  #hold(x, z) {
    const far = this.anchor && Math.hypot(this.anchor[0] - x, this.anchor[1] - z) > this.set.leave_anchor;
    if (!this.anchor || far) {
      if (Math.hypot(...this.velocity) > this.set.stands_below) return null;
      this.anchor = [x, z, this.facing[0]];
    }
    return this.anchor;
  }

  // The distance ahead along an axis at each trajectory time.
  #places(axis, goal, anchor) {
    const times = TRAJECTORY.map((offset) => offset / this.fps);
    if (anchor) {
      const away = this.before[axis] - anchor[axis];
      return times.map((t) => spring(away, this.velocity[axis], rate(this.set.anchor_halflife), t)[0] - away);
    }
    const away = this.velocity[axis] - goal;
    return times.map((t) => goal * t + travel(away, this.acceleration[axis], rate(this.set.halflife), t));
  }

  // The turn from the present heading at each trajectory time.
  #turns(wanted, heading) {
    const away = nearestTurn(this.facing[0] - wanted);
    const begin = nearestTurn(this.facing[0] - heading) - away;
    return TRAJECTORY.map((offset) => begin + spring(away, this.facing[1], rate(this.set.turn_halflife), offset / this.fps)[0]);
  }

  #advance(goal, wanted) {
    const t = 1 / this.fps;
    for (const axis of [0, 1]) {
      const [away, speed] = spring(this.velocity[axis] - goal[axis], this.acceleration[axis], rate(this.set.halflife), t);
      this.acceleration[axis] = speed;
      this.velocity[axis] = goal[axis] + away;
    }
    const away = nearestTurn(this.facing[0] - wanted);
    const [off, turning] = spring(away, this.facing[1], rate(this.set.turn_halflife), t);
    this.facing = [this.facing[0] - away + off, turning];
  }
}
