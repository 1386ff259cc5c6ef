// User input: held keys, gamepad sticks and buttons, an on-screen stick.

import { Vector2 } from "three";

const WAYS = {
  w: [0, 1], arrowup: [0, 1], s: [0, -1], arrowdown: [0, -1], a: [-1, 0], arrowleft: [-1, 0], d: [1, 0], arrowright: [1, 0],
};
const DEAD = 0.18; // share of a stick's range that is ignored
// Buttons of a gamepad with the standard mapping.
const FAST = [5, 7]; // right shoulder and trigger
const CROSS = { 12: [0, 1], 13: [0, -1], 14: [-1, 0], 15: [1, 0] };

export class Steering {
  constructor() {
    this.held = new Set();
    this.fast = false;
    this.pressed = new Set();
    this.thumb = null; // a ThumbStick
    addEventListener("blur", () => this.release());
  }

  release() {
    this.held.clear();
    this.fast = false;
    this.thumb?.release();
  }

  /** Handles a key; returns whether it steers. */
  key(event, down) {
    if (event.key === "Shift") {
      this.fast = down;
      return true;
    }
    const key = event.key.toLowerCase();
    if (!(key in WAYS)) return false;
    if (down) this.held.add(key);
    else this.held.delete(key);
    this.fast = event.shiftKey;
    return true;
  }

  /** The direction [right, ahead] in the camera's view, at most 1 long, and whether to go fast. */
  way() {
    let [right, ahead] = sum([...this.held].map((key) => WAYS[key]));
    let { fast } = this;
    const { thumb } = this;
    if (thumb && !right && !ahead) [right, ahead, fast] = [thumb.right, thumb.ahead, fast || thumb.fast];
    const pad = this.pad();
    if (pad && !right && !ahead) {
      const pressed = (n) => Boolean(pad.buttons[n]?.pressed);
      [right, ahead] = sum(Object.keys(CROSS).filter(pressed).map((n) => CROSS[n]));
      if (!right && !ahead) [right, ahead] = stick(pad.axes[0], -pad.axes[1]);
      fast ||= FAST.some(pressed);
    }
    return { right, ahead, fast };
  }

  /**
   * The gamepad that steers. It must have the standard mapping: on others, triggers or missing axes would act as
   * sticks and steer by themselves. Like keys, it steers only the page with the focus.
   */
  pad() {
    if (!document.hasFocus()) return null;
    return [...(navigator.getGamepads?.() ?? [])].find((one) => one?.connected && one.mapping === "standard") ?? null;
  }

  /** Camera rotation by the right stick: [right, down]. */
  look() {
    const pad = this.pad();
    return pad ? stick(pad.axes[2], pad.axes[3]) : [0, 0];
  }

  /** Gamepad buttons that were pressed since the last call. */
  newButtons() {
    const down = (this.pad()?.buttons ?? []).flatMap((one, n) => (one.pressed ? [n] : []));
    const fresh = down.filter((n) => !this.pressed.has(n));
    this.pressed = new Set(down);
    return fresh;
  }
}

// The sum of directions, at most 1 long.
function sum(ways) {
  return ways.reduce((all, way) => all.add(new Vector2(...way)), new Vector2()).clampLength(0, 1).toArray();
}

function stick(x, y) {
  const length = Math.hypot(x, y);
  if (!(length >= DEAD)) return [0, 0];
  const scale = Math.min(1, (length - DEAD) / (1 - DEAD)) / length;
  return [x * scale, y * scale];
}
