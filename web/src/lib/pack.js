// Reads numbers as motionkit's figure_data.py packs them: little-endian, deflated, base64.

const KINDS = { f4: Float32Array, i2: Int16Array, u2: Uint16Array, u1: Uint8Array };

/** Numbers of a packed field, row after row; `shape` tells how many rows. */
export async function unpack(field) {
  const bytes = Uint8Array.from(atob(field.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const numbers = new KINDS[field.type](await new Response(stream).arrayBuffer());
  if (field.type !== "f4") {
    // Whole numbers are differences from the row before; typed arrays wrap around as the writer does.
    const width = field.shape.slice(1).reduce((product, size) => product * size, 1);
    for (let i = width; i < numbers.length; i++) numbers[i] += numbers[i - width];
  }
  return numbers;
}
