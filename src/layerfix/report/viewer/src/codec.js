// The page's data (docs/report.md): base64 of raw deflate in <script> elements.

function bytesOf(id) {
  const text = document.getElementById(id).textContent.trim();
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const binary = atob(text), bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Layers as run lengths: a chunk inflates to, for each layer, the number of runs and their lengths, as varints.
export class Layers {
  constructor(id, offsets, chunkLayers, count, size) {
    Object.assign(this, { bytes: bytesOf(id), offsets, chunkLayers, count, size, chunks: new Map() });
  }

  async chunk(number) {
    const known = this.chunks.get(number);
    if (known) return known;
    const data = await inflated(this.bytes.subarray(this.offsets[number], this.offsets[number + 1]));
    const starts = [];
    let at = 0;
    const layers = Math.min(this.chunkLayers, this.count - number * this.chunkLayers);
    for (let i = 0; i < layers; i++) {
      let runs, shift = 0, byte;
      starts.push(at);
      runs = 0;
      do { byte = data[at++]; runs |= (byte & 127) << shift; shift += 7; } while (byte & 128);
      for (let j = 0; j < runs; j++) while (data[at++] & 128);
    }
    const made = { data, starts };
    this.chunks.set(number, made);
    if (this.chunks.size > 8) this.chunks.delete(this.chunks.keys().next().value);
    return made;
  }

  // Calls fill(first, past) for every solid run of a layer, in pixels row after row.
  async runs(index, fill) {
    const { data, starts } = await this.chunk(Math.floor(index / this.chunkLayers));
    let at = starts[index % this.chunkLayers], place = 0, solid = false;
    const number = () => {
      let value = 0, shift = 0, byte;
      do { byte = data[at++]; value += (byte & 127) * 2 ** shift; shift += 7; } while (byte & 128);
      return value;
    };
    for (let left = number(); left > 0; left--) {
      const length = number();
      if (solid) fill(place, place + length);
      place += length;
      solid = !solid;
    }
  }
}

// A triangle mesh: zigzag differences of 16 bits for each axis, then how far each corner is below the next new vertex.
export async function bodyOf(id, { vertices, faces, low_mm, step_mm }) {
  const data = await inflated(bytesOf(id)), positions = new Float32Array(3 * vertices), corners = 3 * faces;
  let at = 0;
  for (let axis = 0; axis < 3; axis++, at += 2 * vertices) {
    let place = 0;
    for (let i = 0; i < vertices; i++) {
      const code = data[at + i] | (data[at + vertices + i] << 8);
      place += (code >>> 1) ^ -(code & 1);
      positions[3 * i + axis] = low_mm[axis] + place * step_mm[axis];
    }
  }
  const index = new Uint32Array(corners);
  let newest = 0;
  for (let i = 0; i < corners; i++) {
    const below = data[at + i] | (data[at + corners + i] << 8) | (data[at + 2 * corners + i] << 16)
      | (data[at + 3 * corners + i] << 24);
    index[i] = newest - below;
    if (below === 0) newest++;
  }
  return { positions, index };
}
