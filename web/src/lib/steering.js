// What the user wants: held keys, a gamepad's sticks and buttons, a stick on the screen.

const WAYS = {
  w: [0, 1], arrowup: [0, 1], s: [0, -1], arrowdown: [0, -1], a: [-1, 0], arrowleft: [-1, 0], d: [1, 0], arrowright: [1, 0],
};
const DEAD = 0.18; // of a stick's way
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

  /** Takes a key; whether it steers. */
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

  /** Where to: [right, ahead] as seen by the camera, at most 1 long, and whether to go fast. */
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
   * The gamepad that steers. Only one with the standard mapping: others have triggers or nothing where a stick is
   * expected, and would go off by themselves. Like keys, it steers only the page that has the focus.
   */
  pad() {
    if (!document.hasFocus()) return null;
    return [...(navigator.getGamepads?.() ?? [])].find((one) => one?.connected && one.mapping === "standard") ?? null;
  }

  /** Turn of the camera by the right stick: [right, down]. */
  look() {
    const pad = this.pad();
    return pad ? stick(pad.axes[2], pad.axes[3]) : [0, 0];
  }

  /** Buttons of the gamepad that went down since the last time. */
  newButtons() {
    const down = (this.pad()?.buttons ?? []).flatMap((one, n) => (one.pressed ? [n] : []));
    const fresh = down.filter((n) => !this.pressed.has(n));
    this.pressed = new Set(down);
    return fresh;
  }
}

// Ways put together, at most 1 long.
function sum(ways) {
  const [x, y] = ways.reduce(([a, b], [c, d]) => [a + c, b + d], [0, 0]);
  const length = Math.max(1, Math.hypot(x, y));
  return [x / length, y / length];
}

function stick(x, y) {
  const length = Math.hypot(x, y);
  if (!(length >= DEAD)) return [0, 0];
  const scale = Math.min(1, (length - DEAD) / (1 - DEAD)) / length;
  return [x * scale, y * scale];
}
