// Panels that become sheets at the bottom of a narrow screen: one at a time, below the scene.

import { button } from "./dom.js";

export class Sheets {
  /**
   * @param {HTMLElement} dock gets a button for each sheet
   * @param {{name: string, panel: HTMLElement}[]} sheets
   */
  constructor(dock, sheets) {
    this.sheets = sheets.map(({ name, panel }) => {
      const node = button(name, name, () => this.show(panel.classList.contains("open") ? null : panel));
      node.setAttribute("aria-expanded", "false");
      node.setAttribute("aria-controls", panel.id);
      dock.append(node);
      return { panel, node };
    });
    const resized = new ResizeObserver(() => this.#room());
    this.sheets.forEach(({ panel }) => resized.observe(panel));
    addEventListener("resize", () => this.#room());
    document.addEventListener("keydown", (event) => {
      const open = this.sheets.find(({ panel }) => panel.classList.contains("open"));
      if (event.key !== "Escape" || !open) return;
      this.show(null);
      open.node.focus();
    });
  }

  /** Opens a panel and closes the others; null closes all. */
  show(opened) {
    for (const { panel, node } of this.sheets) {
      panel.classList.toggle("open", panel === opened);
      node.setAttribute("aria-expanded", String(panel === opened));
    }
    this.#room();
  }

  // Shortens the scene to end where the sheet begins.
  #room() {
    const open = this.sheets.find(({ panel }) => panel.classList.contains("open") && getComputedStyle(panel).position === "fixed");
    document.documentElement.style.setProperty("--sheet", `${open ? open.panel.offsetHeight : 0}px`);
  }
}
