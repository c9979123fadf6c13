// The page: what is shown, and what keys, links and tables do to it.
import { Chart } from "./charts.js";
import { Layers } from "./codec.js";
import { Directions } from "./directions.js";
import { LayerView } from "./layer.js";
import { View } from "./view.js";

const meta = JSON.parse(document.getElementById("meta").textContent);
const $ = (id) => document.getElementById(id);
const shown = meta.layers.shown, count = meta.layers.count, size = meta.frame.width * meta.frame.height;
const stack = (name) => meta.images[name] &&
  new Layers(name, meta.images[name].offsets, meta.images.chunk_layers, shown.length, size);
const before = stack("before"), changed = stack("changed"), paths = stack("paths");
const page = (window.layerfix = { ready: false, layer: -1, mode: "difference", skeleton: false, counts: null, meta });
const charts = [];
let view = null, wanted = 0, directions = null;

const middle = (layer) => (meta.layers.z_mm[layer][0] + meta.layers.z_mm[layer][1]) / 2;
// Which of the stored layers is nearest.
const stored = (layer) => {
  let low = 0, high = shown.length - 1;
  while (low < high) { const half = (low + high + 1) >> 1; if (shown[half] <= layer) low = half; else high = half - 1; }
  return low;
};

const image = new LayerView($("layer"), meta, { step: (by) => go(page.layer + by), pointed });

async function go(layer) {
  layer = Math.min(count - 1, Math.max(0, Math.round(layer) || 0));
  wanted = layer;
  $("slider").value = layer;
  $("number").value = layer;
  const k = stored(layer), kinds = new Uint8Array(size);
  const fill = (bit) => (first, past) => { for (let i = first; i < past; i++) kinds[i] |= bit; };
  await Promise.all([before.runs(k, fill(1)), changed.runs(k, fill(2)), paths && paths.runs(k, fill(4))]);
  if (wanted !== layer) return; // another was asked for meanwhile
  image.kinds = kinds;
  page.layer = layer;
  let added = 0, removed = 0;
  for (let i = 0; i < size; i++) if (kinds[i] & 2) { if (kinds[i] & 1) removed++; else added++; }
  page.counts = { added, removed };
  const [bottom, top] = meta.layers.z_mm[layer], other = shown[k] === layer ? "" : ` (shown: ${shown[k]})`;
  $("of").textContent = `of 0 \u2026 ${count - 1}${other}   z ${bottom.toFixed(3)} \u2013 ${top.toFixed(3)} mm`;
  $("counts").textContent = `+${meta.charts.added_mm3[layer]} mm\u00b3  \u2212${meta.charts.removed_mm3[layer]} mm\u00b3`;
  for (const chart of charts) chart.at(layer);
  paint();
  remember();
}

function paint() {
  image.paint(page.mode, page.skeleton);
  if (view) { view.at(middle(page.layer)); view.mode(page.mode); }
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.setAttribute("aria-pressed", String(button.dataset.mode === page.mode));
  }
  $("skeleton").setAttribute("aria-pressed", String(page.skeleton));
}

function mode(name) { page.mode = name; paint(); }

function remember() {
  try { history.replaceState(null, "", `#layer=${page.layer}`); } catch { /* a frame may not */ }
}

function fromLink() {
  const found = /layer=(\d+)/.exec(location.hash);
  return found ? Number(found[1]) : null;
}

const isChanged = (layer) => meta.charts.changed_px[layer] > 0;
function nextChange(by) {
  for (let layer = page.layer + by; layer >= 0 && layer < count; layer += by) {
    if (isChanged(layer) && shown[stored(layer)] === layer) return go(layer);
  }
}

function pointed(at) {
  if (!at) { $("place").textContent = "\u00a0"; return; }
  const { pixel_mm: [px, py], corner_mm: [x, y], step, left_px, top_px } = meta.frame;
  const what = at.kind & 2 ? (at.kind & 1 ? "removed" : "added") : at.kind & 1 ? "solid" : "empty";
  const mm = `x ${(x + (at.column + 0.5) * px).toFixed(3)}  y ${(y - (at.row + 0.5) * py).toFixed(3)} mm`;
  $("place").textContent = `${mm}   px ${left_px + at.column * step}, ${top_px + at.row * step}   ${what}`;
}

function table() {
  const body = $("places").tBodies[0];
  $("no-places").textContent = meta.looked_for;
  $("no-places").hidden = meta.places.length > 0;
  const more = Object.entries(meta.more_places).map(([kind, count]) => `${count} ${kind}`).join(", ");
  $("more-places").hidden = more === "";
  $("more-places").textContent = `Not listed: ${more}. layerfix fix --json and layerfix check --json list all of them.`;
  document.querySelector(".scroll").hidden = meta.places.length === 0;
  for (const place of meta.places) {
    const row = body.insertRow(), [left, bottom, right, top] = place.box_mm.length ? place.box_mm : [];
    const link = document.createElement("a");
    link.href = `#layer=${place.layer}`;
    link.textContent = place.kind;
    row.insertCell().append(link);
    const between = (a, b) => (a === undefined ? "" : `${a.toFixed(2)} \u2013 ${b.toFixed(2)}`);
    const [first, last] = place.layers, layers = first === last ? first : `${first} \u2013 ${last}`;
    for (const text of [layers, meta.layers.z_mm[place.layer][0].toFixed(3), between(left, right), between(bottom, top), place.text]) {
      row.insertCell().textContent = text;
    }
    row.addEventListener("click", async (event) => {
      event.preventDefault();
      for (const other of body.rows) other.removeAttribute("aria-current");
      row.setAttribute("aria-current", "true");
      await go(place.layer);
      if (place.box_mm.length) {
        image.show(place.box_mm);
        if (view) view.lookAt(place.box_mm, middle(place.layer));
      }
      document.querySelector("nav").scrollIntoView({ block: "nearest" });
    });
  }
}

function facts() {
  $("title").textContent = meta.title;
  for (const [name, value] of meta.summary) {
    const pair = document.createElement("div"), term = document.createElement("dt"), is = document.createElement("dd");
    term.textContent = name;
    is.textContent = value;
    pair.append(term, is);
    $("summary").append(pair);
  }
  const rows = [...meta.settings];
  for (const input of meta.inputs) {
    rows.push(["file", input.name + (input.bytes === undefined ? "" : ` (${input.bytes} bytes)`)]);
    if (input.sha256) rows.push(["sha256", input.sha256]);
  }
  rows.push(["made with", Object.entries(meta.made_with).map((pair) => pair.join(" ")).join(", ")]);
  for (const [name, value] of rows) {
    const row = $("settings").tBodies[0].insertRow();
    row.insertCell().textContent = name;
    row.insertCell().textContent = value;
  }
  if (meta.notes.length) {
    const head = document.createElement("h2"), list = document.createElement("ul");
    head.textContent = "Notes";
    for (const note of meta.notes) list.append(Object.assign(document.createElement("li"), { textContent: note }));
    $("notes").append(head, list);
  }
}

function map() {
  if (!meta.orientation) return;
  $("directions").hidden = false;
  $("map-unit").textContent = meta.orientation.unit;
  directions = page.directions = new Directions($("directions"), meta.orientation);
}

function theme(dark) { document.documentElement.dataset.theme = dark ? "dark" : "light"; }

function keys(event) {
  if (event.target.matches("input[type=number]") && event.key !== "Escape" && event.key !== "Enter") return;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const steps = { ArrowUp: 1, ArrowDown: -1, PageUp: 10, PageDown: -10, Home: -count, End: count };
  const modes = { 1: "before", 2: "after", 3: "difference" };
  if (event.shiftKey && event.key.startsWith("Arrow")) {
    const by = 40 * devicePixelRatio;
    image.pan(by * ((event.key === "ArrowLeft") - (event.key === "ArrowRight")), by * ((event.key === "ArrowUp") - (event.key === "ArrowDown")));
  } else if (event.key in steps) go(page.layer + steps[event.key]);
  else if (event.key in modes) mode(modes[event.key]);
  else if (event.key === "n") nextChange(1);
  else if (event.key === "p") nextChange(-1);
  else if (event.key === "s") { page.skeleton = !page.skeleton; paint(); }
  else if (event.key === "0") image.fit();
  else if (event.key === "+" || event.key === "=") image.zoom(1.25);
  else if (event.key === "-") image.zoom(0.8);
  else if (event.key === "b") { if (!event.repeat) { page.held = page.mode; mode(page.mode === "before" ? "after" : "before"); } }
  else return;
  event.preventDefault();
}

function listen() {
  $("slider").max = $("number").max = count - 1;
  $("slider").addEventListener("input", (event) => go(Number(event.target.value)));
  $("number").addEventListener("change", (event) => go(Number(event.target.value)));
  $("next").addEventListener("click", () => nextChange(1));
  $("previous").addEventListener("click", () => nextChange(-1));
  $("fit").addEventListener("click", () => image.fit());
  $("skeleton").addEventListener("click", () => { page.skeleton = !page.skeleton; paint(); });
  $("skeleton").hidden = document.querySelector(".key.paths").hidden = !paths;
  for (const button of document.querySelectorAll("[data-mode]")) button.addEventListener("click", () => mode(button.dataset.mode));
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => view && view.look(button.dataset.view));
  $("section").addEventListener("change", (event) => { if (view) { view.sectioned = event.target.checked; paint(); } });
  $("opacity").addEventListener("input", (event) => view && view.opacity(event.target.value / 100));
  $("theme").addEventListener("click", () => { theme(document.documentElement.dataset.theme !== "dark"); repaint(); });
  addEventListener("keydown", keys);
  addEventListener("keyup", (event) => { if (event.key === "b" && page.held) { mode(page.held); page.held = null; } });
  addEventListener("hashchange", () => { const layer = fromLink(); if (layer !== null && layer !== page.layer) go(layer); });
  addEventListener("resize", () => { image.draw(); if (view) view.draw(); if (directions) directions.draw(); });
  addEventListener("blur", () => { if (page.held) { mode(page.held); page.held = null; } });
  addEventListener("beforeprint", () => { page.dark = document.documentElement.dataset.theme === "dark"; theme(false); repaint(); });
  addEventListener("afterprint", () => { theme(page.dark); repaint(); });
}

function repaint() { paint(); if (view) { view.paint(); view.mode(page.mode); } if (directions) directions.draw(); }

async function start() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  theme(dark.matches);
  dark.addEventListener("change", () => { theme(dark.matches); repaint(); });
  facts();
  table();
  map();
  listen();
  const zTop = meta.layers.z_mm[count - 1][1], jump = go;
  charts.push(new Chart($("charts"), { title: "Added and removed", unit: "mm\u00b3 a layer", zTop, jump, lines: [
    { values: meta.charts.added_mm3, name: "--added" }, { values: meta.charts.removed_mm3, name: "--removed" }] }));
  if (meta.charts.thinnest_mm.some((value) => value !== null)) {
    charts.push(new Chart($("charts"), { title: "Thinnest feature before", unit: "mm", zTop, jump, limit: meta.feature_mm,
      lines: [{ values: meta.charts.thinnest_mm, name: "--fg" }] }));
  }
  if (meta.charts.width_mm) {
    charts.push(new Chart($("charts"), { title: "Suggested extrusion width", unit: "mm", zTop, jump,
      lines: [{ values: meta.charts.width_mm, name: "--removed" }] }));
  }
  try {
    view = new View($("view"), meta, image.image);
  } catch {
    $("view").hidden = true;
    $("view").style.display = "none";
    $("no-webgl").hidden = false;
  }
  if (view) { await view.load(); page.triangles = view.triangles; }
  page.view = view;
  page.image = image;
  image.fit();
  const most = meta.charts.added_mm3.map((value, k) => value + meta.charts.removed_mm3[k]);
  const linked = fromLink();
  await go(linked === null ? shown[stored(most.indexOf(Math.max(...most)))] : linked);
  page.ready = true;
}

start().catch((problem) => {
  $("trouble").hidden = false;
  $("trouble").textContent = `This page could not be shown: ${problem.message}. It needs a browser of 2023 or newer.`;
  throw problem;
});
