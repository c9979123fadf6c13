// The layer as an image: zoom, pan, a scale bar, where the pointer is.

const hex = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const colour = (name) => {
  const value = parseInt(hex(name).slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
};

export class LayerView {
  constructor(canvas, meta, told) {
    const { width, height } = meta.frame;
    Object.assign(this, { canvas, meta, told, width, height, scale: 0, x: 0, y: 0, flash: null });
    this.image = new ImageData(width, height);
    this.words = new Uint32Array(this.image.data.buffer);
    this.kinds = new Uint8Array(width * height); // 1 before, 2 changed, 4 paths
    this.buffer = document.createElement("canvas");
    this.buffer.width = width;
    this.buffer.height = height;
    this.context = this.buffer.getContext("2d");
    const [px, py] = meta.frame.pixel_mm;
    this.aspect = py / px; // pixels need not be square
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => this.moved(event));
    canvas.addEventListener("pointerleave", () => told.pointed(null));
    canvas.addEventListener("dblclick", () => this.fit());
  }

  // `kinds` has been filled for a layer: colour it.
  paint(mode, skeleton) {
    const pack = ([r, g, b]) => (255 << 24) | (b << 16) | (g << 8) | r;
    const part = pack(colour("--part")), added = pack(colour("--added")), removed = pack(colour("--removed"));
    const paths = pack(colour("--paths"));
    const table = new Uint32Array(8);
    for (let kind = 0; kind < 8; kind++) {
      const before = kind & 1, changed = (kind & 2) >> 1, after = before ^ changed;
      if (mode === "before") table[kind] = before ? part : 0;
      else if (mode === "after") table[kind] = after ? part : 0;
      else table[kind] = changed ? (before ? removed : added) : before ? part : 0;
      if (skeleton && kind & 4) table[kind] = paths;
    }
    const { words, kinds } = this;
    for (let i = 0; i < words.length; i++) words[i] = table[kinds[i]];
    this.context.putImageData(this.image, 0, 0);
    this.draw();
  }

  fit(box) {
    this.resize();
    const [left, top, right, bottom] = box || [0, 0, this.width, this.height];
    const { width, height } = this.canvas;
    this.scale = Math.min(width / (right - left), height / ((bottom - top) * this.aspect)) * 0.96;
    this.x = width / 2 - ((left + right) / 2) * this.scale;
    this.y = height / 2 - ((top + bottom) / 2) * this.scale * this.aspect;
    this.draw();
  }

  resize() {
    const { width, height } = this.canvas.getBoundingClientRect(), ratio = devicePixelRatio;
    if (this.canvas.width !== Math.round(width * ratio)) this.canvas.width = Math.round(width * ratio);
    if (this.canvas.height !== Math.round(height * ratio)) this.canvas.height = Math.round(height * ratio);
  }

  // Look at a box in mm, and flash it.
  show(box) {
    const [left, bottom, right, top] = box, [px, py] = this.meta.frame.pixel_mm, [x, y] = this.meta.frame.corner_mm;
    const inner = [(left - x) / px, (y - top) / py, (right - x) / px, (y - bottom) / py];
    const air = Math.max(inner[2] - inner[0], inner[3] - inner[1], 20);
    this.fit([inner[0] - air, inner[1] - air, inner[2] + air, inner[3] + air]);
    this.flash = inner;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => { this.flash = null; this.draw(); }, 2500);
    this.draw();
  }

  draw() {
    this.resize();
    const { canvas, scale, x, y, aspect } = this, pen = canvas.getContext("2d"), ratio = devicePixelRatio;
    pen.fillStyle = hex("--void");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.imageSmoothingEnabled = scale < 1;
    pen.imageSmoothingQuality = "high";
    pen.drawImage(this.buffer, x, y, this.width * scale, this.height * scale * aspect);
    if (this.flash) {
      const [left, top, right, bottom] = this.flash, air = 3 * ratio;
      pen.strokeStyle = hex("--focus");
      pen.lineWidth = 2 * ratio;
      pen.strokeRect(x + left * scale - air, y + top * scale * aspect - air,
        (right - left) * scale + 2 * air, (bottom - top) * scale * aspect + 2 * air);
    }
    this.scaleBar(pen, ratio);
  }

  scaleBar(pen, ratio) {
    const pixel = this.meta.frame.pixel_mm[0], room = (this.canvas.width / 3 / this.scale) * pixel;
    let length = 10 ** Math.floor(Math.log10(room));
    for (const times of [5, 2]) if (length * times <= room) { length *= times; break; }
    const wide = (length / pixel) * this.scale, left = 14 * ratio, bottom = this.canvas.height - 14 * ratio;
    const text = length >= 1 ? `${+length.toPrecision(3)} mm` : `${+(1000 * length).toPrecision(3)} \u00b5m`;
    pen.font = `${13 * ratio}px system-ui, sans-serif`;
    pen.fillStyle = hex("--void");
    pen.fillRect(left - 6 * ratio, bottom - 26 * ratio, Math.max(wide, pen.measureText(text).width) + 12 * ratio, 34 * ratio);
    pen.fillStyle = hex("--fg");
    pen.fillRect(left, bottom - 3 * ratio, wide, 3 * ratio);
    pen.fillText(text, left, bottom - 9 * ratio);
  }

  zoom(factor, atX = this.canvas.width / 2, atY = this.canvas.height / 2) {
    const limited = Math.min(Math.max(this.scale * factor, 0.02), 200 * devicePixelRatio) / this.scale;
    this.x = atX - (atX - this.x) * limited;
    this.y = atY - (atY - this.y) * limited;
    this.scale *= limited;
    this.draw();
  }

  pan(dx, dy) {
    this.x += dx;
    this.y += dy;
    this.draw();
  }

  wheel(event) {
    event.preventDefault();
    const box = this.canvas.getBoundingClientRect(), ratio = devicePixelRatio;
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) this.told.step(-Math.sign(event.deltaY || event.deltaX));
    else this.zoom(Math.exp(-event.deltaY * 0.0015), (event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio);
  }

  moved(event) {
    if (event.buttons) this.pan(event.movementX * devicePixelRatio, event.movementY * devicePixelRatio);
    const box = this.canvas.getBoundingClientRect(), ratio = devicePixelRatio;
    const column = Math.floor(((event.clientX - box.left) * ratio - this.x) / this.scale);
    const row = Math.floor(((event.clientY - box.top) * ratio - this.y) / this.scale / this.aspect);
    const inside = column >= 0 && row >= 0 && column < this.width && row < this.height;
    this.told.pointed(inside ? { column, row, kind: this.kinds[row * this.width + column] } : null);
  }
}
