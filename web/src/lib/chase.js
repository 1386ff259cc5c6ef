// A camera target that follows a figure: a critically damped spring, whose speed never jumps.

const SETTLED = 1e-4; // metres and metres per second
const CUT = 8; // metres; for larger distances the camera jumps

export class Chase {
  /** @param {import("./stage.js").Stage} stage @param {number} seconds time to cover most of the distance */
  constructor(stage, seconds = 0.22) {
    Object.assign(this, { stage, rate: 2 / seconds, speed: [0, 0, 0], started: false });
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
  }

  /** Moves towards a place [x, y, z] for `passed` seconds; at once the first time, or if motion is to be reduced. */
  to(place, passed) {
    const { target } = this.stage.controls;
    const away = [target.x - place[0], target.y - place[1], target.z - place[2]];
    const far = Math.hypot(...away);
    if (!this.started || far > CUT || this.still.matches) {
      this.started = true;
      this.speed.fill(0);
      this.stage.follow(...place);
      return;
    }
    if (far < SETTLED && Math.hypot(...this.speed) < SETTLED) return;
    const fade = Math.exp(-this.rate * passed);
    const next = away.map((from, axis) => {
      const pull = (this.speed[axis] + this.rate * from) * passed;
      this.speed[axis] = (this.speed[axis] - this.rate * pull) * fade;
      return place[axis] + (from + pull) * fade;
    });
    this.stage.follow(...next);
  }
}
