// Type bands, contacts and curves over a common time axis, with a cursor to drag.

import { CONTACT_COLORS, SLIDE_COLOR } from "../lib/marks.js";

const LEFT = 92; // pixels, like the following sizes
const RIGHT = 14;
const BAND = 17;
const STRIPE = 9;
const PLOT = 46;
const AXIS = 18;
const GAP = 6;
const OTHERS = 2 * (STRIPE + 3 + PLOT + GAP) + AXIS + 50; // all but the bands of types, with the buttons above
const SHARE = 0.45; // of the page's height, which the bands may fill up
const hex = (color) => `#${color.toString(16).padStart(6, "0")}`;
const TYPE_HUES = [212, 28, 145, 280, 350, 180, 48, 310, 95, 240];

export class Timeline {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{clip: import("../lib/clip.js").Clip, color: string, shown: boolean}[]} tracks
   * @param {(time: number) => void} seek
   */
  constructor(canvas, tracks, seek) {
    Object.assign(this, { canvas, tracks, seek, time: 0, chosen: 0 });
    this.seconds = Math.max(...tracks.map((track) => track.clip.seconds), 1e-3);
    this.types = [...new Set(tracks.flatMap((track) => track.clip.types.map((band) => band.type)))];
    this.low = matchMedia("(max-height: 520px)");
    this.low.addEventListener("change", () => this.redraw());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      canvas.focus();
      this.#seekTo(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons & 1) this.#seekTo(event);
    });
    new ResizeObserver(() => this.redraw()).observe(canvas);
    addEventListener("resize", () => this.redraw());
  }

  // On a low screen, such as a phone held sideways, the figures need the space of the curves.
  #layout() {
    const low = this.low.matches;
    const rows = [];
    let top = 0;
    const add = (row, height, gap) => {
      rows.push({ ...row, top, height });
      top += height + gap;
    };
    const most = low ? 1 : Math.max(1, Math.floor((SHARE * innerHeight - OTHERS) / (BAND + 3))); // around the chosen one
    const typed = [...this.tracks.keys()].filter((n) => this.tracks[n].clip.types.length);
    const before = typed.findLastIndex((n) => n <= this.chosen) - Math.floor(most / 2);
    const first = Math.max(0, Math.min(before, typed.length - most));
    for (const n of typed.slice(first, first + most)) add({ kind: "types", n }, BAND, 3);
    const feet = Math.max(...this.tracks.map((track) => track.clip.feet.length));
    for (let foot = 0; foot < feet; foot++) add({ kind: "contact", foot }, STRIPE, 3);
    if (!low) {
      top += GAP - 3;
      add({ kind: "speed" }, PLOT, GAP);
      if (feet) add({ kind: "height" }, PLOT, 0);
    }
    add({ kind: "axis" }, AXIS, 0);
    this.rows = rows;
    this.height = top;
    this.canvas.style.height = `${top}px`;
  }

  #seekTo(event) {
    const box = this.canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    this.seek(Math.max(0, Math.min(1, share)) * this.seconds);
  }

  typeColor(type, dark) {
    const hue = TYPE_HUES[this.types.indexOf(type) % TYPE_HUES.length];
    return dark ? `hsl(${hue} 42% 36%)` : `hsl(${hue} 62% 80%)`;
  }

  /** Draws everything that does not move with the cursor. */
  redraw() {
    this.#layout();
    const scale = Math.min(window.devicePixelRatio, 2);
    this.width = this.canvas.clientWidth;
    this.canvas.width = Math.round(this.width * scale);
    this.canvas.height = Math.round(this.height * scale);
    this.still = document.createElement("canvas");
    this.still.width = this.canvas.width;
    this.still.height = this.canvas.height;
    const pen = this.still.getContext("2d");
    pen.scale(scale, scale);
    const style = getComputedStyle(document.documentElement);
    this.look = Object.fromEntries(
      ["ink", "dim", "faint", "edge", "accent", "hover", "panel-solid"].map((name) => [name, style.getPropertyValue(`--${name}`).trim()]),
    );
    this.look.dark = document.documentElement.dataset.theme === "dark";
    for (const row of this.rows) this[`_${row.kind}`](pen, row);
    this.scale = scale;
    this.draw(this.time);
  }

  /** Moves the cursor. */
  draw(time) {
    this.time = time;
    if (!this.still?.width) return;
    const pen = this.canvas.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.drawImage(this.still, 0, 0);
    pen.scale(this.scale, this.scale);
    const x = this.#x(time);
    pen.strokeStyle = this.look.accent;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(x, 0);
    pen.lineTo(x, this.height - AXIS + 4);
    pen.stroke();
    pen.fillStyle = this.look.accent;
    pen.beginPath();
    pen.arc(x, this.height - AXIS + 4, 4, 0, 7);
    pen.fill();
    for (const row of this.rows) if (row.curves) this.#values(pen, row, time, x);
  }

  #x(time) {
    return LEFT + (this.width - LEFT - RIGHT) * (time / this.seconds);
  }

  #label(pen, row, text, color = this.look.dim) {
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = color;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.fillText(text, LEFT - 10, row.top + row.height / 2 + 0.5, LEFT - 14);
  }

  _types(pen, row) {
    const { clip, color } = this.tracks[row.n];
    this.#label(pen, row, this.tracks.length > 1 ? clip.name : "types", this.tracks.length > 1 ? color : undefined);
    pen.textAlign = "left";
    for (const band of clip.types) {
      const [a, b] = [this.#x(band.start), this.#x(Math.min(band.end, this.seconds))];
      pen.fillStyle = this.typeColor(band.type, this.look.dark);
      pen.beginPath();
      pen.roundRect(a + 0.5, row.top, Math.max(1, b - a - 1), row.height, 4);
      pen.fill();
      pen.save();
      pen.clip();
      pen.fillStyle = this.look.ink;
      pen.fillText(band.type, a + 7, row.top + row.height / 2 + 0.5);
      pen.restore();
    }
  }

  _contact(pen, row) {
    const { clip } = this.tracks[this.chosen];
    const foot = clip.feet[row.foot];
    if (!foot) return;
    this.#label(pen, row, `${foot.side || "lowest"} foot`);
    pen.fillStyle = this.look.hover;
    pen.fillRect(LEFT, row.top, this.#x(clip.seconds) - LEFT, row.height);
    const side = hex(CONTACT_COLORS[foot.side]);
    for (const [mask, color] of [[foot.low, side], [foot.slides, hex(SLIDE_COLOR)]]) {
      pen.fillStyle = color;
      for (let frame = 0; frame < clip.frames; frame++) {
        if (!mask[frame]) continue;
        const first = frame;
        while (frame + 1 < clip.frames && mask[frame + 1]) frame++;
        const [a, b] = [this.#x(first / clip.fps), this.#x(Math.min(frame + 1, clip.frames - 1) / clip.fps)];
        pen.fillRect(a, row.top, Math.max(1, b - a), row.height);
      }
    }
  }

  _speed(pen, row) {
    row.curves = this.tracks
      .filter((track) => track.shown)
      .map(({ clip, color }) => ({ clip, color, values: clip.speed, factor: 1 }));
    this.#plot(pen, row, "root speed", "m/s", 1);
  }

  _height(pen, row) {
    const { clip } = this.tracks[this.chosen];
    row.curves = clip.feet.map((foot) => ({ clip, color: hex(CONTACT_COLORS[foot.side]), values: foot.height, factor: 100 }));
    this.#plot(pen, row, "foot height", "cm", 20);
  }

  #plot(pen, row, name, unit, least) {
    const values = row.curves.flatMap(({ values, factor }) => [values.reduce((a, b) => Math.max(a, b), 0) * factor, values.reduce((a, b) => Math.min(a, b), 0) * factor]);
    const high = Math.max(least, ...values) * 1.08;
    const low = Math.min(0, ...values);
    row.unit = unit;
    row.y = (value) => row.top + row.height * (1 - (value - low) / (high - low));
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = this.look.dim;
    pen.fillText(name, LEFT - 10, row.top + row.height / 2 - 7);
    pen.fillStyle = this.look.faint;
    pen.fillText(unit, LEFT - 10, row.top + row.height / 2 + 7);
    pen.strokeStyle = this.look.edge;
    pen.lineWidth = 1;
    const step = tick((high - low) / 2.5);
    pen.textAlign = "left";
    for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
      const y = Math.round(row.y(value)) + 0.5;
      pen.beginPath();
      pen.moveTo(LEFT, y);
      pen.lineTo(this.width - RIGHT, y);
      pen.stroke();
      pen.fillText(`${+value.toFixed(3)}`, LEFT + 3, Math.max(row.top + 6, y - 6));
    }
    pen.lineWidth = 1.4;
    pen.lineJoin = "round";
    for (const { clip, color, values, factor } of row.curves) {
      pen.strokeStyle = color;
      pen.beginPath();
      // One point per half pixel is enough.
      const stride = Math.max(1, Math.floor(values.length / (2 * this.width)));
      for (let frame = 0; frame < values.length; frame += stride) pen.lineTo(this.#x(frame / clip.fps), row.y(values[frame] * factor));
      pen.stroke();
    }
  }

  #values(pen, row, time, x) {
    pen.font = "600 11px system-ui, sans-serif";
    pen.textBaseline = "top";
    pen.textAlign = "left";
    const texts = row.curves.map(({ clip, color, values, factor }) => {
      const value = values[clip.frameAt(time)] * factor;
      const text = factor > 1 ? value.toFixed(1) : value.toFixed(2);
      return [color, text, value, pen.measureText(text).width];
    });
    // Beside the cursor, or as far to the left as all need to be seen.
    const all = texts.reduce((sum, [, , , width]) => sum + width + 10, 0);
    let at = x + 8 + all > this.width ? x - 8 - all : x + 8;
    if (at < LEFT) at = Math.max(2, Math.min(x + 8, this.width - all));
    for (const [color, text, value, width] of texts) {
      pen.fillStyle = this.look["panel-solid"];
      pen.globalAlpha = 0.8;
      pen.fillRect(at - 2, row.top + 1, width + 4, 14);
      pen.globalAlpha = 1;
      pen.fillStyle = color;
      pen.fillText(text, at, row.top + 2);
      pen.beginPath();
      pen.arc(x, row.y(value), 3, 0, 7);
      pen.fill();
      at += width + 10;
    }
  }

  _axis(pen, row) {
    pen.font = "11px system-ui, sans-serif";
    pen.textBaseline = "middle";
    const step = tick((this.seconds * 90) / Math.max(1, this.width - LEFT - RIGHT));
    pen.strokeStyle = this.look.faint;
    for (let time = 0; time <= this.seconds + 1e-9; time += step) {
      const x = this.#x(time);
      pen.beginPath();
      pen.moveTo(x, row.top);
      pen.lineTo(x, row.top + 4);
      pen.stroke();
      pen.textAlign = x > this.width - 40 ? "right" : "center";
      pen.fillStyle = this.look.dim;
      pen.fillText(`${+time.toFixed(3)} s`, x, row.top + 12);
    }
  }
}

// The smallest of 1, 2, 5 times a power of ten that is not below a length.
function tick(length) {
  const power = 10 ** Math.floor(Math.log10(Math.max(length, 1e-6)));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= length * 0.999);
}
