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
    for (const { key, text, x, y, z, name } of labels) {
      at.set(x, y, z).project(this.stage.camera);
      if (at.z > 1 || Math.abs(at.x) > 1.1 || Math.abs(at.y) > 1.1) continue;
      seen.add(key);
      let span = this.spans.get(key);
      if (!span) {
        span = document.createElement("span");
        span.textContent = text;
        if (name) Object.assign(span, { className: "name" }).style.color = name;
        this.box.append(span);
        this.spans.set(key, span);
      }
      const left = ((at.x + 1) / 2) * width;
      const top = ((1 - at.y) / 2) * height;
      span.style.transform = name
        ? `translate(${left.toFixed(1)}px, ${top.toFixed(1)}px) translate(-50%, -100%)`
        : `translate(${(left + 6).toFixed(1)}px, ${(top - 7).toFixed(1)}px)`;
    }
    for (const [key, span] of this.spans) {
      if (seen.has(key)) continue;
      span.remove();
      this.spans.delete(key);
    }
  }
}
