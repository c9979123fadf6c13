// Lines against the layer, as SVG; a click jumps there.

const NS = "http://www.w3.org/2000/svg";
const made = (name, attributes) => {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
};
const short = (value) => String(+value.toPrecision(3));

export class Chart {
  constructor(parent, { title, unit, lines, limit, zTop, jump }) {
    this.count = lines[0].values.length;
    const known = lines.flatMap(({ values }) => values.filter((value) => value !== null));
    this.most = Math.max(...known.map(Number), limit || 0, 1e-12);
    const box = document.createElement("div"), head = document.createElement("h3"), note = document.createElement("span");
    box.className = "chart";
    head.textContent = `${title} `;
    note.textContent = `${unit}, up to ${short(this.most)}`;
    head.append(note);
    const svg = made("svg", { viewBox: `0 0 ${Math.max(this.count, 1)} 100`, preserveAspectRatio: "none", tabindex: 0,
      role: "slider", "aria-label": `${title} by layer`, "aria-valuemin": 0, "aria-valuemax": this.count - 1 });
    for (const { values, name } of lines) this.line(svg, values, name);
    if (limit) svg.append(made("line", { class: "limit", x1: 0, x2: this.count, y1: this.y(limit), y2: this.y(limit) }));
    this.mark = made("line", { class: "mark", y1: 0, y2: 100 });
    svg.append(this.mark);
    const go = (event) => {
      const { left, width } = svg.getBoundingClientRect();
      jump(Math.min(this.count - 1, Math.max(0, Math.floor(((event.clientX - left) / width) * this.count))));
    };
    svg.addEventListener("pointerdown", (event) => { svg.setPointerCapture(event.pointerId); go(event); });
    svg.addEventListener("pointermove", (event) => { if (event.buttons) go(event); });
    const axis = document.createElement("div"), low = document.createElement("span"), high = document.createElement("span");
    axis.className = "axis";
    low.textContent = "z 0";
    high.textContent = `${short(zTop)} mm`;
    axis.append(low, high);
    box.append(head, svg, axis);
    parent.append(box);
    this.svg = svg;
  }

  y(value) { return 98 - (value / this.most) * 94; }

  // Runs of layers that have a value, each as a line; a lone one is a dash.
  line(svg, values, name) {
    let points = [];
    const end = () => {
      if (!points.length) return;
      if (points.length === 1) points.push([points[0][0] + 1, points[0][1]]);
      const text = points.map((point) => point.join(",")).join(" ");
      const [first, last] = [points[0][0], points[points.length - 1][0]];
      const area = made("polygon", { class: "fill", points: `${first},98 ${text} ${last},98` });
      const line = made("polyline", { class: "bar", points: text });
      area.style.fill = line.style.stroke = `var(${name})`;
      svg.append(area, line);
      points = [];
    };
    values.forEach((value, k) => {
      if (value === null) end();
      else points.push([k + 0.5, +this.y(value).toFixed(2)]);
    });
    end();
  }

  at(layer) {
    this.mark.setAttribute("x1", layer + 0.5);
    this.mark.setAttribute("x2", layer + 0.5);
    this.svg.setAttribute("aria-valuenow", layer);
  }
}
