// Reads the model file that page_model.py writes: a header, and deflated arrays whose bytes are sorted.

const COLUMNS = { poses: 24, ground: 3 };

/** The header of the file, and its arrays by name: bytes as Uint8Array, numbers as Float32Array. */
export async function readModel(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const model = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const read = async ([name, { type, from, to }]) => {
    const bytes = await inflated(new Uint8Array(buffer, 4 + length + from, to - from));
    if (type === "d2") return [name, summed(new Uint16Array(unsorted(bytes, 2).buffer), COLUMNS[name], halves())];
    if (type === "d4") return [name, summed(new Uint32Array(unsorted(bytes, 4).buffer), COLUMNS[name])];
    return [name, type === "f4" ? new Float32Array(unsorted(bytes, 2).buffer) : unsorted(bytes, 2)];
  };
  model.arrays = Object.fromEntries(await Promise.all(Object.entries(model.arrays).map(read)));
  return model;
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The first bytes of all numbers of so many bytes, then the second ones and so on, as numbers again.
function unsorted(bytes, width) {
  const count = bytes.length / width;
  const out = new Uint8Array(bytes.length);
  for (let k = 0; k < width; k++) for (let i = 0; i < count; i++) out[width * i + k] = bytes[k * count + i];
  return out;
}

// Columns of differences of the bits of floats, as rows of numbers; halves are the numbers of bits, of floats of 16.
function summed(steps, columns, halves = null) {
  const rows = steps.length / columns;
  const out = new Float32Array(steps.length);
  const bits = new Uint32Array(out.buffer);
  for (let column = 0; column < columns; column++) {
    let sum = 0;
    for (let row = 0; row < rows; row++) {
      sum = (sum + steps[column * rows + row]) | 0;
      if (halves) out[row * columns + column] = halves[sum & 0xffff];
      else bits[row * columns + column] = sum;
    }
  }
  return out;
}

// The numbers of all half floats.
function halves() {
  const out = new Float32Array(65536);
  for (let bits = 0; bits < 65536; bits++) {
    const [sign, power, share] = [bits & 0x8000 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
    out[bits] = sign * (power ? 2 ** (power - 15) * (1 + share / 1024) : 2 ** -14 * (share / 1024));
  }
  return out;
}
