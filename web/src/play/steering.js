// What the user wants: held keys, a gamepad's sticks and buttons.

const WAYS = {
  w: [0, 1], arrowup: [0, 1], s: [0, -1], arrowdown: [0, -1], a: [-1, 0], arrowleft: [-1, 0], d: [1, 0], arrowright: [1, 0],
};
const DEAD = 0.18; // of a stick's way

export class Steering {
  constructor() {
    this.held = new Set();
    this.fast = false;
    this.pressed = new Set();
    addEventListener("blur", () => this.release());
  }

  release() {
    this.held.clear();
    this.fast = false;
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
    let [right, ahead] = [0, 0];
    for (const key of this.held) {
      right += WAYS[key][0];
      ahead += WAYS[key][1];
    }
    let { fast } = this;
    const length = Math.hypot(right, ahead);
    if (length > 1) [right, ahead] = [right / length, ahead / length];
    const pad = this.pad();
    if (pad && length === 0) {
      [right, ahead] = stick(pad.axes[0], -pad.axes[1]);
      fast = fast || Boolean(pad.buttons[7]?.pressed || pad.buttons[5]?.pressed);
    }
    return { right, ahead, fast };
  }

  pad() {
    return [...(navigator.getGamepads?.() ?? [])].find((one) => one?.connected && one.axes.length >= 2) ?? null;
  }

  /** Turn of the camera by the right stick. */
  look() {
    const pad = this.pad();
    return pad && pad.axes.length >= 4 ? stick(pad.axes[2], pad.axes[3]) : [0, 0];
  }

  /** Buttons of the gamepad that went down since the last time. */
  newButtons() {
    const down = (this.pad()?.buttons ?? []).flatMap((one, n) => (one.pressed ? [n] : []));
    const fresh = down.filter((n) => !this.pressed.has(n));
    this.pressed = new Set(down);
    return fresh;
  }
}

function stick(x, y) {
  const length = Math.hypot(x, y);
  if (length < DEAD) return [0, 0];
  const scale = Math.min(1, (length - DEAD) / (1 - DEAD)) / length;
  return [x * scale, y * scale];
}
