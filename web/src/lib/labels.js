// Names over the scene: of joints, and of motions above their heads.

import { Vector3 } from "three";

const at = new Vector3();

export class Labels {
  /** @param {HTMLElement} box @param {import("../lib/stage.js").Stage} stage */
  constructor(box, stage) {
    Object.assign(this, { box, stage, spans: new Map() });
  }

  /** Shows exactly these labels: {key, text, x, y, z, name?}. */
  show(labels) {
    const { clientWidth: width, clientHeight: height } = this.box;
    const seen = new Set();
    const placed = []; // boxes of names, which move up until they cover no other
    for (const { key, text, x, y, z, name } of labels) {
      at.set(x, y, z).project(this.stage.camera);
      if (at.z > 1 || Math.abs(at.x) > 1.1 || Math.abs(at.y) > 1.1) continue;
      seen.add(key);
      let span = this.spans.get(key);
      if (!span) {
        span = document.createElement("span");
        span.textContent = text;
        if (name) span.className = "name";
        this.box.append(span);
        this.spans.set(key, span);
      }
      if (name) span.style.color = name; // removals give other colours
      const left = ((at.x + 1) / 2) * width;
      let top = ((1 - at.y) / 2) * height;
      if (!name) {
        span.style.transform = `translate(${(left + 6).toFixed(1)}px, ${(top - 7).toFixed(1)}px)`;
        continue;
      }
      const size = (span.size ??= [span.offsetWidth, span.offsetHeight]);
      for (const other of placed) {
        // Those placed before are sorted from the lowest to the highest.
        const beside = Math.abs(left - other.left) >= (size[0] + other.size[0]) / 2;
        if (!beside && top > other.top - other.size[1] && top - size[1] < other.top) top = other.top - other.size[1];
      }
      placed.push({ left, top, size });
      placed.sort((one, other) => other.top - one.top);
      span.style.transform = `translate(${left.toFixed(1)}px, ${top.toFixed(1)}px) translate(-50%, -100%)`;
    }
    for (const [key, span] of this.spans) {
      if (seen.has(key)) continue;
      span.remove();
      this.spans.delete(key);
    }
  }
}
