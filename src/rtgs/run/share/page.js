// The page's controls: a camera that turns about a point, the layer, the palette and its range, the spots.
"use strict";

const $ = (id) => document.getElementById(id);
const canvas = $("canvas");
const state = { kind: "thermal", palette: "inferno", span: [...DATA.range], view: 0, reduction: 1, moving: 0, times: [] };
let splats = null, camera = null, wanted = false, marked = null;

const minus = (a, b) => a.map((v, i) => v - b[i]), plus = (a, b) => a.map((v, i) => v + b[i]), times = (a, s) => a.map((v) => v * s);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0), length = (a) => Math.hypot(...a), unit = (a) => times(a, 1 / (length(a) || 1));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return plus(plus(times(v, c), times(cross(axis, v), s)), times(axis, dot(axis, v) * (1 - c)));
}

function lookFrom(view) {
  camera = { eye: [...view.eye], target: [...view.target], up: unit(view.up) };
  changed();
}

function axes() {
  const z = unit(minus(camera.target, camera.eye)), x = unit(cross(z, camera.up)), y = cross(z, x);
  return { x, y, z };
}

function viewMatrix() {
  const { x, y, z } = axes(), e = camera.eye;
  return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, e), -dot(y, e), -dot(z, e), 1]);
}

const focal = () => 0.9 * Math.min(canvas.width, 1.4 * canvas.height);

function orbit(dx, dy) {
  const { x } = axes();
  let arm = minus(camera.eye, camera.target);
  arm = turned(arm, camera.up, -dx * 0.006);
  const right = turned(x, camera.up, -dx * 0.006), tilted = turned(arm, right, -dy * 0.006);
  if (Math.abs(dot(unit(tilted), camera.up)) < 0.985) arm = tilted;
  camera.eye = plus(camera.target, arm);
}

function shift(dx, dy) {
  const { x, y } = axes(), step = length(minus(camera.eye, camera.target)) / focal() * devicePixelRatio;
  const move = plus(times(x, -dx * step), times(y, -dy * step));
  camera.eye = plus(camera.eye, move);
  camera.target = plus(camera.target, move);
}

function zoom(factor) {
  camera.eye = plus(camera.target, times(minus(camera.eye, camera.target), factor));
}

function changed(moving = false) {
  if (moving) state.moving = performance.now();
  if (!wanted) { wanted = true; requestAnimationFrame(draw); }
}

function draw(now) {
  wanted = false;
  if (!splats) return;
  const ratio = Math.min(devicePixelRatio || 1, 2), width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const moving = performance.now() - state.moving < 180, start = performance.now();
  const span = state.span.map((v) => (v - DATA.levels[0]) / (DATA.levels[1] - DATA.levels[0]));
  splats.draw({ kind: state.kind, view: viewMatrix(), focal: focal(), palette: state.palette, span, reduction: moving ? state.reduction : 1 });
  if (moving) {
    const last = splats.read(0.5, 0.5), taken = performance.now() - start;
    if (taken > 60 && state.reduction < 4) state.reduction += 1;
    else if (taken < 12 && state.reduction > 1) state.reduction -= 1;
    setTimeout(() => changed(), 200);
  }
  placeMark();
}

// Where a mark of the world is on the canvas, in shares of its width and height.
function projected(point) {
  const { x, y, z } = axes(), p = minus(point, camera.eye), depth = dot(z, p);
  return { x: 0.5 + focal() * dot(x, p) / depth / canvas.width, y: 0.5 + focal() * dot(y, p) / depth / canvas.height, seen: depth > 0 };
}

function placeMark() {
  const out = $("reading");
  out.hidden = marked === null;
  if (marked === null) return;
  const at = marked.point ? projected(marked.point) : { ...marked, seen: true };
  out.hidden = !at.seen;
  out.textContent = marked.text;
  out.style.left = `${100 * at.x}%`;
  out.style.top = `${100 * at.y}%`;
}

const degrees = (v, digits = 1) => `${v.toFixed(digits).replace("-", "−")} ${DATA.unit}`;

function readAt(x, y) {
  const kind = state.kind;
  state.kind = "thermal";
  draw();
  const { level, cover } = splats.read(x, y);
  state.kind = kind;
  draw();
  return cover < 0.5 ? null : DATA.levels[0] + level * (DATA.levels[1] - DATA.levels[0]);
}

function showReading(x, y) {
  const value = readAt(x, y);
  marked = { x, y, text: value === null ? "nothing here" : degrees(value) };
  placeMark();
}

function ticks(lo, hi) {
  const raw = (hi - lo) / 6, power = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const found = [];
  for (let v = Math.ceil(lo / step - 1e-9) * step; v <= hi + 1e-9 * step; v += step) found.push(v);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

function drawLegend() {
  $("legend").hidden = state.kind !== "thermal";
  $("thermal-controls").hidden = state.kind !== "thermal";
  const bar = $("bar").getContext("2d"), rgb = new Uint8Array(bytesOf(DATA.palettes[state.palette])), picture = bar.createImageData(1, 256);
  for (let i = 0; i < 256; i++) picture.data.set([...rgb.slice(3 * (255 - i), 3 * (255 - i) + 3), 255], 4 * i);
  bar.putImageData(picture, 0, 0);
  const [lo, hi] = state.span, { found, digits } = ticks(lo, hi);
  $("ticks").replaceChildren(...found.map((v) => {
    const mark = document.createElement("span");
    mark.textContent = v.toFixed(digits);
    mark.style.top = `${100 * (hi - v) / (hi - lo)}%`;
    return mark;
  }));
  $("legend-unit").textContent = DATA.unit;
  $("range-unit").textContent = DATA.unit;
}

function show(kind) {
  state.kind = kind;
  for (const name of ["thermal", "rgb"]) $(`show-${name}`).setAttribute("aria-pressed", String(name === kind));
  drawLegend();
  changed();
}

function setSpan(span) {
  if (span.every(Number.isFinite) && span[0] < span[1]) state.span = span;
  [$("low").value, $("high").value] = state.span.map((v) => String(Number(v.toFixed(2))));
  drawLegend();
  changed();
}

function jumpTo(spot) {
  const views = DATA.views, best = views.find((v) => spot.frames.includes(v.name));
  const nearest = best || views.reduce((a, b) => (length(minus(a.eye, spot.position)) < length(minus(b.eye, spot.position)) ? a : b));
  const arm = minus(nearest.eye, spot.position), size = Math.max(4 * spot.diameterM, 0.25 * length(arm));
  camera = { eye: plus(spot.position, times(unit(arm), Math.min(length(arm), size))), target: [...spot.position], up: unit(nearest.up) };
  marked = { point: spot.position, text: `${spot.number}: ${degrees(spot.extreme)}` };
  document.querySelectorAll("#spots button").forEach((b) => b.setAttribute("aria-current", String(b.dataset.number === String(spot.number))));
  changed();
}

function listSpots() {
  $("spots-section").hidden = DATA.criterion === "";
  $("criterion").textContent = DATA.spots.length ? DATA.criterion : `None: ${DATA.criterion}`;
  for (const spot of DATA.spots) {
    const item = document.createElement("li"), button = document.createElement("button");
    const part = (name, text) => { const s = document.createElement("span"); s.className = name; s.textContent = text; button.append(s); };
    part("number", String(spot.number));
    part("kind", spot.kind);
    part("value", degrees(spot.extreme) + (spot.std === null ? "" : ` ± ${spot.std.toFixed(1)}`));
    part("more", `${spot.excess >= 0 ? "+" : ""}${degrees(spot.excess)} to its surroundings, ⌀\u00a0${DATA.lengthUnit === "m" ? `${(100 * spot.diameterM).toPrecision(2)}\u00a0cm` : `${spot.diameterM.toPrecision(2)}\u00a0${DATA.lengthUnit}`}, ${spot.views} views` +
      (spot.modelDiffers ? `; the model shows ${degrees(spot.modelled)}` : ""));
    button.dataset.number = String(spot.number);
    button.addEventListener("click", () => jumpTo(spot));
    item.append(button);
    $("spots").append(item);
  }
}

function listen() {
  const pointers = new Map();
  let travelled = 0, apart = 0;
  canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, [e.clientX, e.clientY]); travelled = 0; apart = 0; });
  canvas.addEventListener("pointermove", (e) => {
    const before = pointers.get(e.pointerId);
    if (!before) return;
    const dx = e.clientX - before[0], dy = e.clientY - before[1];
    travelled += Math.abs(dx) + Math.abs(dy);
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
    if (travelled < 4) return;
    if (marked && !marked.point) marked = null;
    if (pointers.size === 2) {
      const [a, b] = [...pointers.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (apart) zoom(apart / now);
      apart = now;
      shift(dx / 2, dy / 2);
    } else if (e.shiftKey || e.buttons === 2) shift(dx, dy);
    else orbit(dx, dy);
    changed(true);
  });
  const end = (e) => {
    if (pointers.delete(e.pointerId) && travelled < 4 && e.type === "pointerup") {
      const box = canvas.getBoundingClientRect();
      showReading((e.clientX - box.left) / box.width, (e.clientY - box.top) / box.height);
    }
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(Math.sign(e.deltaY) * 0.12)); changed(true); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const moves = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] };
    if (moves[e.key]) { orbit(...moves[e.key]); changed(true); e.preventDefault(); }
    if (e.key === "+" || e.key === "-") { zoom(e.key === "+" ? 0.9 : 1.1); changed(true); }
  });
  new ResizeObserver(() => changed()).observe(canvas);
  $("show-thermal").addEventListener("click", () => show("thermal"));
  $("show-rgb").addEventListener("click", () => show("rgb"));
  $("palette").addEventListener("change", (e) => { state.palette = e.target.value; drawLegend(); changed(); });
  for (const name of ["low", "high"]) $(name).addEventListener("change", () => setSpan([$("low"), $("high")].map((i) => parseFloat(i.value))));
  $("reset-range").addEventListener("click", () => setSpan([...DATA.range]));
  $("home").addEventListener("click", () => { marked = null; state.view = 0; lookFrom(DATA.views[0]); });
  const step = (by) => { marked = null; state.view = (state.view + by + DATA.views.length) % DATA.views.length; lookFrom(DATA.views[state.view]); };
  $("next").addEventListener("click", () => step(1));
  $("previous").addEventListener("click", () => step(-1));
}

function begin() {
  for (const name of Object.keys(DATA.palettes)) $("palette").append(new Option(name, name));
  const count = (n) => n.toLocaleString("en");
  $("facts").textContent = `${count(DATA.rgb.count)} Gaussians in colour, ${count(DATA.thermal.count)} with temperatures; lengths in ${DATA.lengthUnit}. Made by rtgs. Nothing is fetched or sent.`;
  listSpots();
  lookFrom(DATA.views[0]);
  try {
    splats = new Splats(canvas, DATA);
  } catch (error) {
    $("message").textContent = error.message;
    $("message").hidden = false;
  }
  $("limits").textContent = (splats && splats.software
    ? "This browser draws with software, without a GPU: expect one to five seconds a picture with 100,000 Gaussians, in coarser pixels while the view moves. "
    : "Without a GPU a browser takes one to five seconds a picture with 100,000 Gaussians, in coarser pixels while the view moves. ") +
    "Colours do not depend on the direction here; the run's own pictures and figures are exact.";
  listen();
  setSpan([...DATA.range]);
  show("thermal");
}

begin();
