// The half-sphere of build directions, equal areas equal: a click, or arrows, choose the nearest one that was looked at.

const RAMP = [[48, 18, 92], [42, 90, 154], [32, 156, 144], [134, 205, 84], [250, 231, 80]];
const WIDE = 12; // from this ratio of the largest to the least on, colours follow the logarithm
const number = (value) => (Math.abs(value) >= 1000 ? Math.round(value).toLocaleString("en").replaceAll(",", "\u2009") : String(+value.toPrecision(3)));

export class Directions {
  constructor(section, found) {
    this.found = found;
    this.canvas = section.querySelector("canvas");
    this.say = section.querySelector("dl");
    this.poses = found.poses;
    this.values = this.poses.map((pose) => pose.value);
    this.low = Math.min(...this.values);
    this.high = Math.max(...this.values);
    this.log = this.low > 0 && this.high / this.low > WIDE;
    this.halves = found.both ? [1, -1] : [1];
    this.canvas.addEventListener("pointerdown", (event) => this.pointed(event));
    this.canvas.addEventListener("pointermove", (event) => { if (event.buttons) this.pointed(event); });
    this.canvas.addEventListener("keydown", (event) => this.step(event));
    const rows = section.querySelector("tbody");
    for (const pose of found.candidates) {
      const row = rows.insertRow(), link = document.createElement("button");
      link.type = "button";
      link.textContent = pose.direction.map((c) => c.toFixed(3)).join(", ");
      link.addEventListener("click", () => this.choose(pose));
      row.insertCell().append(link);
      for (const text of [number(pose.value), number(pose.added_px), number(pose.removed_px), `${pose.height_mm} mm`]) row.insertCell().textContent = text;
    }
    this.choose(found.candidates[0]);
  }

  level(value) {
    if (this.high <= this.low) return 0;
    return this.log ? Math.log(value / this.low) / Math.log(this.high / this.low) : (value - this.low) / (this.high - this.low);
  }

  colour(share) {
    const at = Math.min(share, 0.9999) * (RAMP.length - 1), k = Math.floor(at), t = at - k;
    return RAMP[k].map((c, i) => Math.round(c + (RAMP[k + 1][i] - c) * t));
  }

  // Opposite directions are one unless aims tell them apart.
  nearest([x, y, z]) {
    let best = null, most = -2;
    for (const pose of this.poses) {
      const dot = pose.direction[0] * x + pose.direction[1] * y + pose.direction[2] * z;
      const near = this.found.both ? dot : Math.abs(dot);
      if (near > most) { most = near; best = pose; }
    }
    return best;
  }

  disc(k) {
    const size = Math.min(this.canvas.height, this.canvas.width / this.halves.length) - 56;
    return { x: (this.canvas.width / this.halves.length) * (k + 0.5), y: this.canvas.height / 2, r: size / 2 };
  }

  // Lambert's equal-area projection from the pole of a half, and back.
  place([x, y, z]) {
    if (!this.found.both && z < 0) [x, y, z] = [-x, -y, -z];
    const k = this.halves.length > 1 && z < 0 ? 1 : 0, { x: cx, y: cy, r } = this.disc(k);
    const scale = r / Math.sqrt(1 + Math.abs(z));
    return [cx + x * scale, cy - y * scale];
  }

  direction(px, py) {
    for (const [k, sign] of this.halves.entries()) {
      const { x, y, r } = this.disc(k), u = (px - x) / r, v = (y - py) / r, across = u * u + v * v;
      if (across <= 1) { const s = Math.sqrt(2 - across); return [u * s, v * s, sign * (1 - across)]; }
    }
    return null;
  }

  pointed(event) {
    const box = this.canvas.getBoundingClientRect(), scale = this.canvas.width / box.width;
    const found = this.direction((event.clientX - box.left) * scale, (event.clientY - box.top) * scale);
    if (found) this.choose(this.nearest(found));
  }

  step(event) {
    const order = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!order) return;
    event.preventDefault();
    event.stopPropagation();
    const ranked = [...this.poses].sort((a, b) => a.value - b.value), at = ranked.findIndex((pose) => pose.value >= this.chosen.value);
    this.choose(ranked[Math.min(ranked.length - 1, Math.max(0, at + order))]);
  }

  choose(pose) {
    this.chosen = pose;
    const facts = [
      ["up is", pose.direction.map((c) => c.toFixed(3)).join(", ")],
      ["\u03b8 about x and z", pose.theta_rad.map((c) => c.toFixed(3)).join(", ") + " rad"],
      [this.found.unit, number(pose.value) + (pose.whole ? "" : " (from some of its layers)")],
      ["added, removed", `${number(pose.added_px)}, ${number(pose.removed_px)} px`],
      ["height", `${pose.height_mm} mm`],
      ["rank", `${1 + this.values.filter((value) => value < pose.value).length} of ${this.poses.length}`],
    ];
    this.say.replaceChildren(...facts.map(([name, value]) => {
      const pair = document.createElement("div"), term = document.createElement("dt"), is = document.createElement("dd");
      term.textContent = name;
      is.textContent = value;
      pair.append(term, is);
      return pair;
    }));
    this.draw();
  }

  field() {
    const { width, height } = this.canvas;
    if (this.drawn && this.drawn.width === width && this.drawn.height === height) return this.drawn;
    const image = new ImageData(width, height), cell = 3;
    for (let y = 0; y < height; y += cell) {
      for (let x = 0; x < width; x += cell) {
        const at = this.direction(x + cell / 2, y + cell / 2);
        if (!at) continue;
        const rgb = this.colour(this.level(this.nearest(at).value));
        for (let j = y; j < Math.min(y + cell, height); j++) for (let i = x; i < Math.min(x + cell, width); i++) image.data.set([...rgb, 255], 4 * (j * width + i));
      }
    }
    return (this.drawn = image);
  }

  draw() {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    if (!box.width) return;
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (this.canvas.width !== width || this.canvas.height !== height) { this.canvas.width = width; this.canvas.height = height; }
    const pen = this.canvas.getContext("2d"), css = getComputedStyle(document.documentElement);
    pen.putImageData(this.field(), 0, 0);
    const ink = css.getPropertyValue("--fg").trim();
    pen.font = `${13 * ratio}px system-ui, sans-serif`;
    pen.textAlign = "center";
    for (const [k, sign] of this.halves.entries()) {
      const { x, y, r } = this.disc(k);
      pen.strokeStyle = pen.fillStyle = ink;
      pen.lineWidth = 1.5 * ratio;
      pen.beginPath(); pen.arc(x, y, r, 0, 2 * Math.PI); pen.stroke();
      pen.fillText("+y", x, y - r - 7 * ratio);
      pen.fillText("+x", x + r + 16 * ratio, y + 4 * ratio);
      pen.fillText(sign > 0 ? "seen along +z" : "lower half, seen through", x, y + r + 17 * ratio);
    }
    const mark = (direction, shape, colour) => {
      const [x, y] = this.place(direction), s = 8 * ratio;
      for (const [wide, stroke] of [[5, "#ffffff"], [2.5, colour]]) {
        pen.lineWidth = wide * ratio;
        pen.strokeStyle = stroke;
        pen.beginPath();
        if (shape === "ring") pen.arc(x, y, s, 0, 2 * Math.PI);
        else if (shape === "cross") { pen.moveTo(x - s, y - s); pen.lineTo(x + s, y + s); pen.moveTo(x - s, y + s); pen.lineTo(x + s, y - s); }
        else pen.rect(x - s / 2, y - s / 2, s, s);
        pen.stroke();
      }
    };
    mark(this.found.given.direction, "cross", "#282c34");
    mark(this.found.best.direction, "ring", "#d62728");
    mark(this.chosen.direction, "square", "#111111");
  }
}
