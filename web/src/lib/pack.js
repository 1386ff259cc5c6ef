// Reads arrays packed by figure_data.py: little-endian, deflated, base64.

/** The bytes of base64. */
export const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

const KINDS = { f4: Float32Array, i2: Int16Array, u2: Uint16Array, i1: Int8Array, u1: Uint8Array };

/** The numbers of a packed field, or of one that is unpacked already, row by row; `shape` gives the number of rows. */
export async function unpack(field) {
  if (ArrayBuffer.isView(field)) return field;
  const stream = new Blob([bytesOf(field.data)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const numbers = new KINDS[field.type](await new Response(stream).arrayBuffer());
  if (field.type !== "f4") {
    // Integers are differences from the previous row; typed arrays wrap around like the writer's.
    const width = field.shape.slice(1).reduce((product, size) => product * size, 1);
    for (let i = width; i < numbers.length; i++) numbers[i] += numbers[i - width];
  }
  return numbers;
}
