// The first steps of a gait from standing, as Python's FirstSteps (control/memory.py).

import { Player } from "./player.js";

const FRAMES = 45;

export class FirstSteps {
  constructor(model, choice = 0) {
    Object.assign(this, { player: new Player(model, choice, 0, "first"), kind: -1, left: 0 });
  }

  /** A body that stands begins to go in a gait, by its number. */
  begin(kind) {
    this.player.forget();
    this.player.begin(kind, null, 0);
    Object.assign(this, { kind, left: FRAMES });
  }

  /** Whether the first steps in this gait are still to come; those in another gait are over. */
  takes(kind) {
    if (kind !== this.kind) this.left = 0;
    return this.left > 0;
  }

  /** Controls of the next frame with a reference; asked are those without. */
  reference(asked, trajectory) {
    this.left -= 1;
    const [{ reference, gain }] = this.player.play(1, trajectory);
    return { ...asked, reference, gain };
  }
}
