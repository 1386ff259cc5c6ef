// Small helpers for the pages' controls.

const ICONS = {
  play: "M4 2.5v11l9-5.5z",
  pause: "M4 2.5h3v11H4zM9 2.5h3v11H9z",
  back: "M10.5 2.5v11L5 8zM3 2.5h1.8v11H3z",
  next: "M5.5 2.5v11L11 8zM11.2 2.5H13v11h-1.8z",
  first: "M12.5 2.5v11L7.6 8zM7.5 2.5v11L2.6 8zM1.5 2.5h1.3v11H1.5z",
  loop: "M4 4h7.5V2l3 3-3 3V6H5.5v2.5H4zM12 12H4.5v2l-3-3 3-3v2h6V7.500H12z",
  eye: "M8 3.5C4.500 3.500 2 6.200 1 8c1 1.800 3.500 4.500 7 4.500s6-2.700 7-4.500c-1-1.800-3.500-4.500-7-4.500zm0 7.500a3 3 0 1 1 0-6 3 3 0 0 1 0 6zm0-1.600a1.400 1.400 0 1 0 0-2.800 1.400 1.400 0 0 0 0 2.800z",
};

export function icon(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  return svg;
}

/** An element with properties and children; strings become text, never markup. */
export function element(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

export function button(label, title, onclick, ...children) {
  const node = element("button", { type: "button", title, onclick }, ...(children.length ? children : [label]));
  node.setAttribute("aria-label", label);
  // Remove focus after a click, so that keys go to the page.
  node.addEventListener("pointerup", () => node.blur());
  return node;
}

/** A button that is on or off; returns it and a function that sets it. */
export function toggle(label, title, on, onchange) {
  const node = button(label, title, () => set(node.getAttribute("aria-pressed") !== "true"));
  const set = (value) => {
    node.setAttribute("aria-pressed", String(value));
    onchange(value);
  };
  node.setAttribute("aria-pressed", String(on));
  return { node, set, flip: () => node.click() };
}

/** Says why nothing is shown. */
export function refused(what, { message }) {
  const textContent = `This ${what} cannot be shown here: ${message}. A browser of 2023 or later with WebGL is needed.`;
  Object.assign(document.getElementById("notice"), { hidden: false, textContent });
}

/** Fills a dialog with keys and their actions. */
export function fillHelp(dialog, title, keys) {
  const list = element("dl");
  for (const [names, text] of keys) {
    const term = element("dt");
    names.forEach((name) => term.append(element("kbd", {}, name), " "));
    list.append(term, element("dd", {}, text));
  }
  const close = button("Close", "Close", () => dialog.close());
  dialog.replaceChildren(element("h2", {}, title), list, element("p"), close);
}
