// The connection to the server (docs/live.md): requests and events as JSON, frames as bytes.

const HEADER = 24; // bytes of a binary frame before its characters
const CHARACTER = 396; // bytes of each character
const KEPT = 30; // frames kept for interpolation
const DRIFT = 0.0005; // seconds per frame by which the clock offset may grow, until a frame arrives early
const AGAIN = 1000; // ms before a lost connection is retried

export class Link {
  /** @param {{hello: Function, event: Function, frame: Function, lost: Function}} listeners */
  constructor(address, listeners) {
    Object.assign(this, { address, listeners, seq: 0, frames: [], offset: Infinity });
    this.#connect();
    setInterval(() => this.ask("ping", { stamp: performance.now() }), 1000);
  }

  #connect() {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.#event(JSON.parse(data)) : this.#frame(data));
    socket.onclose = () => {
      this.listeners.lost(this.fault);
      Object.assign(this, { frames: [], offset: Infinity, fault: undefined });
      setTimeout(() => this.#connect(), AGAIN);
    };
    this.socket = socket;
  }

  /** Sends a request; returns its seq. */
  ask(what, fields = {}, counted = false) {
    if (this.socket.readyState !== WebSocket.OPEN) return null;
    if (counted) this.seq += 1;
    this.socket.send(JSON.stringify({ do: what, ...fields, ...(counted ? { seq: this.seq } : {}) }));
    return this.seq;
  }

  /** The figure of a body; repeats the request until the server answers or the connection changes. */
  async figure(name) {
    const { hello } = this;
    const number = hello.bodies.findIndex((body) => body.name === name);
    while (hello === this.hello) {
      const answer = await fetch(`/figures/${number}`).catch(() => null);
      if (answer?.status === 200) return answer.json();
      if (answer?.status !== 202) await new Promise((done) => setTimeout(done, AGAIN)); // 202: still being made
    }
    throw new Error("the connection was lost");
  }

  #event(event) {
    if (event.event === "pong") this.delay = (performance.now() - event.stamp) / 2;
    else if (event.event === "hello") {
      this.hello = event;
      this.listeners.hello(event);
    } else {
      if (event.event === "error" && event.closing) this.fault = event.message;
      this.listeners.event(event);
    }
  }

  #frame(data) {
    const frame = readFrame(data);
    if (!frame) return; // a kind of message that this page does not know
    const arrived = performance.now() / 1000;
    this.offset = Math.min(this.offset + DRIFT, arrived - frame.time);
    this.frames.push(frame);
    if (this.frames.length > KEPT) this.frames.shift();
    this.listeners.frame(frame, arrived);
  }

  /**
   * The two frames around a moment and the fraction between them: at most one step behind the newest, so that a
   * slightly late frame is not missed.
   */
  around(now) {
    const { frames } = this;
    if (!frames.length) return null;
    const time = now - this.offset - 1 / this.hello.fps;
    let n = frames.length - 1;
    while (n > 0 && frames[n].time > time) n -= 1;
    const [before, after] = [frames[n], frames[Math.min(n + 1, frames.length - 1)]];
    const span = after.time - before.time;
    return { before, after, share: span > 0 ? Math.max(0, Math.min(1, (time - before.time) / span)) : 1 };
  }
}

/** A binary frame as an object; null for other messages. Rotations and root are views of the message. */
export function readFrame(data) {
  const view = new DataView(data);
  if (data.byteLength < HEADER || view.getUint8(0) !== 1 || view.getUint8(1) !== 1) return null;
  const count = view.getUint16(2, true);
  if (data.byteLength !== HEADER + count * CHARACTER) return null;
  const characters = new Map();
  for (let n = 0; n < count; n++) {
    const at = HEADER + n * CHARACTER;
    const flags = view.getUint8(at + 10);
    characters.set(view.getUint32(at, true), {
      seq: view.getUint32(at + 4, true),
      type: view.getUint16(at + 8, true),
      performing: Boolean(flags & 1),
      following: Boolean(flags & 2),
      recording: Boolean(flags & 4),
      root: new Float32Array(data, at + 16, 3),
      rotations: new Float32Array(data, at + 28, 92),
    });
  }
  return {
    number: view.getUint32(4, true),
    time: view.getFloat64(8, true),
    stepMs: view.getFloat32(16, true),
    fps: view.getFloat32(20, true),
    characters,
  };
}
