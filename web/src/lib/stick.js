// An on-screen stick: it appears where a finger touches its zone, and reports where the finger is pushed.

const REACH = 46; // pixels from the middle to the rim
const PAST = 1.35; // share of REACH beyond which a push means fast

export class ThumbStick {
  /** @param {HTMLElement} zone area for the thumb; the ring and the knob are added to it */
  constructor(zone) {
    Object.assign(this, { zone, right: 0, ahead: 0, fast: false });
    this.ring = Object.assign(document.createElement("div"), { className: "ring" });
    this.knob = Object.assign(document.createElement("div"), { className: "knob" });
    this.ring.append(this.knob);
    zone.append(this.ring);
    zone.addEventListener("pointerdown", (event) => this.#down(event));
    zone.addEventListener("pointermove", (event) => event.pointerId === this.finger && this.#move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      zone.addEventListener(end, (event) => event.pointerId === this.finger && this.release());
    }
  }

  #down(event) {
    if (this.finger !== undefined) return;
    event.preventDefault();
    this.zone.setPointerCapture(event.pointerId);
    this.finger = event.pointerId;
    const box = this.zone.getBoundingClientRect();
    const inside = (at, size) => Math.max(REACH, Math.min(size - REACH, at));
    this.middle = [box.left + inside(event.clientX - box.left, box.width), box.top + inside(event.clientY - box.top, box.height)];
    this.ring.style.translate = `${this.middle[0] - box.left - box.width / 2}px ${this.middle[1] - box.top - box.height / 2}px`;
    this.zone.classList.add("held");
    this.#move(event);
  }

  #move(event) {
    const [x, y] = [event.clientX - this.middle[0], event.clientY - this.middle[1]];
    const length = Math.hypot(x, y) / REACH;
    const scale = 1 / (REACH * Math.max(1, length));
    [this.right, this.ahead] = [x * scale, -y * scale];
    this.fast = length > PAST;
    this.zone.classList.toggle("fast", this.fast);
    this.knob.style.translate = `${this.right * REACH}px ${-this.ahead * REACH}px`;
  }

  /** Releases the stick, as when the finger leaves the screen. */
  release() {
    Object.assign(this, { finger: undefined, right: 0, ahead: 0, fast: false });
    this.zone.classList.remove("held", "fast");
    this.knob.style.translate = this.ring.style.translate = "";
  }
}
