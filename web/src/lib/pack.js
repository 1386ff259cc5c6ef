// Reads arrays packed by figure_data.py: little-endian, deflated, base64.

/** The bytes of base64. */
export const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

/** The bytes of a stream that others pass through, such as a DecompressionStream. */
export async function through(stream, bytes) {
  return new Response(new Blob([bytes]).stream().pipeThrough(stream)).arrayBuffer();
}

const KINDS = { f4: Float32Array, i2: Int16Array, u2: Uint16Array, i1: Int8Array, u1: Uint8Array };

/** The numbers of a packed field, row by row (`shape` gives how many), or what is no packed field as it is. */
export async function unpack(field) {
  if (!field?.shape) return field;
  const numbers = new KINDS[field.type](await through(new DecompressionStream("deflate"), bytesOf(field.data)));
  if (field.type !== "f4") {
    // Integers are differences from the previous row; typed arrays wrap around like the writer's.
    const width = field.shape.slice(1).reduce((product, size) => product * size, 1);
    for (let i = width; i < numbers.length; i++) numbers[i] += numbers[i - width];
  }
  return numbers;
}
