// Integral controller for speed: Python's SpeedTrim (control/memory.py).

import { STANDS_BELOW, stands } from "./springs.js";

const [LEAD, LEAD_SECONDS] = [0.3, 0.35];
const [TRIM_SECONDS, WAIT_SECONDS, SAME_WISH, LEAST, MOST] = [1, 0.5, 0.1, 0.75, 1.35];

export class SpeedTrim {
  constructor(model) {
    Object.assign(this, { model, shares: {}, kind: -1, wish: [0, 0], since: 0, lead: 0 });
  }

  /** The velocity [x, z] to ask a gait for in this frame, for one that is wanted and one at which the body goes. */
  asks(kind, velocity, gone) {
    const { fps, types } = this.model;
    const speed = Math.hypot(...velocity);
    if (speed < STANDS_BELOW || !types[kind].steered || stands(types[kind])) {
      this.kind = -1;
      return velocity;
    }
    const far = Math.hypot(velocity[0] - this.wish[0], velocity[1] - this.wish[1]);
    if (kind !== this.kind || far > SAME_WISH * speed) {
      const change = kind === this.kind ? speed - Math.hypot(...this.wish) : 0;
      const lead = LEAD * Math.min(Math.max(change, -speed), speed);
      Object.assign(this, { kind, wish: velocity, since: 0, lead });
    }
    this.since += 1;
    let share = this.shares[kind] ?? 1;
    const found = this.since > WAIT_SECONDS * fps;
    if (found) {
      const along = (gone[0] * velocity[0] + gone[1] * velocity[1]) / speed;
      share = Math.min(Math.max(share + (1 - along / speed) / (TRIM_SECONDS * fps), LEAST), MOST);
    }
    // Not beyond the speeds of the recordings for the sake of one within them.
    const [slowest, fastest] = types[kind].speeds ?? [0, Infinity];
    const asked = share * speed + (this.since <= LEAD_SECONDS * fps ? this.lead : 0);
    share = Math.max(Math.min(asked, Math.max(fastest, speed)), Math.min(slowest, speed)) / speed;
    if (found) this.shares[kind] = share;
    return [share * velocity[0], share * velocity[1]];
  }
}
