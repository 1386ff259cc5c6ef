// Reads the model file of page_model.py: a header, and deflated arrays with reordered bytes.

import { through } from "../lib/pack.js";

/** The header of the file, and its arrays by name: bytes as Uint8Array, numbers as Float32Array. */
export async function readModel(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const model = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const read = async ([name, { type, columns, from, to }]) => {
    const bytes = unsorted(new Uint8Array(await through(new DecompressionStream("deflate"), new Uint8Array(buffer, 4 + length + from, to - from))));
    if (type === "steps") return [name, summed(new Int16Array(bytes.buffer), columns, model.step)];
    return [name, type === "f4" ? new Float32Array(bytes.buffer) : bytes];
  };
  model.arrays = Object.fromEntries(await Promise.all(Object.entries(model.arrays).map(read)));
  return model;
}

// Restores numbers of two bytes from all first bytes, then all second ones.
function unsorted(bytes) {
  return bytes.map((_, n) => bytes[(n % 2) * (bytes.length / 2) + (n >> 1)]);
}

// Restores rows of numbers from columns of integer differences, in units of step.
function summed(differences, columns, step) {
  const rows = differences.length / columns;
  const out = new Float32Array(differences.length);
  for (let column = 0; column < columns; column++) {
    let sum = 0;
    for (let row = 0; row < rows; row++) out[row * columns + column] = step * (sum += differences[column * rows + row]);
  }
  return out;
}
