// Reads the model file that page_model.py writes: a header, and deflated arrays whose bytes are sorted.

const COLUMNS = 24; // of a pose

/** The header of the file, and its arrays by name: bytes as Uint8Array, numbers as Float32Array. */
export async function readModel(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const model = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const read = async ([name, entry]) => {
    const packed = new Uint8Array(buffer, 4 + length + entry.from, entry.to - entry.from);
    const bytes = unsorted(await inflated(packed));
    if (entry.type === "f4") return [name, new Float32Array(bytes.buffer)];
    return [name, entry.type === "f2" ? poses(new Uint16Array(bytes.buffer)) : bytes];
  };
  model.arrays = Object.fromEntries(await Promise.all(Object.entries(model.arrays).map(read)));
  return model;
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Low bytes of all pairs, then the high ones, as pairs again.
function unsorted(bytes) {
  const half = bytes.length / 2;
  const out = new Uint8Array(bytes.length);
  for (let i = 0; i < half; i++) {
    out[2 * i] = bytes[i];
    out[2 * i + 1] = bytes[half + i];
  }
  return out;
}

// Columns of differences of the bits of half floats, as rows of numbers.
function poses(steps) {
  const rows = steps.length / COLUMNS;
  const out = new Float32Array(steps.length);
  const numbers = halves();
  for (let column = 0; column < COLUMNS; column++) {
    let bits = 0;
    for (let row = 0; row < rows; row++) {
      bits = (bits + steps[column * rows + row]) & 0xffff;
      out[row * COLUMNS + column] = numbers[bits];
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
