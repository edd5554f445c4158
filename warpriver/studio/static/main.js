// The studio: what the session tells goes to the map and the panels, what is done on them goes to the session.

import { MapCamera } from "./camera.js";
import { Grid, Ground } from "./ground.js";
import { Link } from "./link.js";
import { Overlay } from "./overlay.js";
import { drawRamp, kindOf, rampOf, TYPES } from "./layers.js";
import { $, inWords, makeLayers, number, Plots, put, showChannel, showChoices, showConstants, showEdits, showGenerators, showScale, showSession, showTimeline } from "./panels.js";
import { facts, nearest } from "./rivers.js";
import { MapScene } from "./scene.js";
import { makeTools, OPTIONS, optionValues } from "./tools.js";

const canvas = $("view3d"), holder = canvas.parentElement;
const ground = new Ground(), view = new MapCamera(ground), scene = new MapScene(canvas, ground, view);
const overlay = new Overlay(holder, view), plots = new Plots(), link = new Link();

const studio = {
  plots, link, view, scene, ground, overlay,
  origin: [0, 0], state: null, live: null, chosen: null, controls: [], locks: [], records: [], events: [], shown: null,
  layers: {}, tool: null, latency: [], files: [], seen: 0, types: null, map: null,

  async ask(what, rest) {
    try {
      const began = performance.now();
      const answer = await link.ask(what, rest);
      this.latency.push(performance.now() - began);
      if (this.latency.length > 500) this.latency.shift();
      return answer;
    } catch (error) { this.say(error.message); throw error; }
  },
  say(text, quiet = false) {
    const box = quiet ? $("hint") : $("message");
    box.textContent = text;
    if (quiet) return;
    box.hidden = false;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => { box.hidden = true; }, 6000);
  },
  choose(id) { this.chosen = id; this.mark(); this.redraw(); showChannel(this); },
  mark() {
    const state = this.state;
    scene.rivers.uniforms.chosen.value = state && this.chosen !== null ? state.id.indexOf(this.chosen) : -1;
    scene.flow();
  },
  redraw() { scene.urgent = scene.dirty = true; },
  showLayer(id, on) {
    this.layers[id] = on;
    if (id === "rivers") scene.rivers.mesh.material.visible = on;
    if (id === "oxbows") scene.oxbows.mesh.material.visible = on;
    if (id === "old") scene.old.mesh.material.visible = on;
    if (id === "relief") scene.uniforms.shaded.value = on;
    if (id === "contours") scene.uniforms.contours.value = on;
    if (id === "field") scene.setField(on);
    if (id === "controls") overlay.shown.controls = on;
    if (id === "locks") overlay.shown.locks = on;
    this.redraw();
  },
  use(tool) {
    this.tool?.cancel?.();
    this.tool = tool;
    overlay.hover = overlay.ring = overlay.path = null;
    for (const button of document.querySelectorAll("#tools button")) {
      const on = button.dataset.tool === tool.id;
      button.setAttribute("aria-pressed", String(on));
    }
    $("hint").textContent = tool.title;
    showOptions(tool);
    this.redraw();
  },
};
window.studio = studio;

// ---- tools and their options

const tools = makeTools(studio);
for (const [name, list] of tools.list) {
  const head = document.createElement("h2"), row = document.createElement("div");
  head.textContent = name;
  row.className = "row";
  for (const tool of list) {
    const button = document.createElement("button");
    Object.assign(button, { textContent: tool.name, title: tool.key ? `${tool.title} (${tool.key})` : tool.title });
    button.dataset.tool = tool.id;
    button.addEventListener("click", () => studio.use(tool));
    row.append(button);
  }
  $("tools").append(head, row);
}

function showOptions(tool) {
  const box = $("options");
  box.replaceChildren(box.querySelector("legend"));
  box.hidden = !tool.options?.length;
  for (const name of tool.options ?? []) {
    const o = OPTIONS[name], label = document.createElement("label"), input = document.createElement("input"), out = document.createElement("output");
    const to = (v) => (o.log ? Math.log(v) : v), from = (v) => (o.log ? Math.exp(v) : v);
    Object.assign(input, { type: "range", min: to(o.low), max: to(o.high), step: "any", value: to(optionValues[name]), title: o.title, id: `option-${name}` });
    input.setAttribute("aria-label", `${o.label}${o.unit !== "-" ? `, ${o.unit}` : ""}`);
    const show = () => { out.textContent = `${number(optionValues[name])}${o.unit !== "-" ? ` ${o.unit}` : ""}`; input.setAttribute("aria-valuetext", out.textContent); };
    input.addEventListener("input", () => { optionValues[name] = Number(from(Number(input.value)).toPrecision(3)); show(); });
    show();
    label.append(o.label, " ", out, input);
    box.append(label);
  }
}
makeLayers(studio);

// ---- what the session tells

link.addEventListener("scene", ({ detail }) => {
  const fresh = !studio.ready || String(studio.origin) !== String(detail.origin);
  studio.origin = overlay.origin = detail.origin;
  const local = (place) => place && { ...place, west: place.west - detail.origin[0], north: place.north - detail.origin[1] };
  const [west, south, east, north] = detail.bounds.map((v, k) => v - detail.origin[k % 2]);
  scene.setBox(west, south, east, north);
  ground.height = detail.terrain ? new Grid(local(detail.terrain)) : null;
  ground.control = detail.control ? new Grid(local(detail.control)) : null;
  ground.shade = null;
  scene.setHeights();
  scene.setField(studio.layers.field !== false);
  scene.oxbows.clear(); scene.old.clear();
  plots.take(detail.series);
  Object.assign(studio, { events: [], shown: null, bounds: [west, south, east, north] });
  showConstants(studio, detail);
  showChoices(detail);
  studio.generators = detail.generators;
  showMap(null);
  if (fresh) {
    view.fit(west, south, east, north);
    // A brush that is seen, and that fits the map.
    optionValues.radius = Number(Math.min(5000, Math.max(50, 0.03 * Math.max(east - west, north - south))).toPrecision(2));
    showOptions(studio.tool);
  }
  studio.ready = true;
  studio.redraw();
});

link.addEventListener("session", ({ detail }) => {
  Object.assign(studio, { controls: detail.controls, locks: detail.locks, records: detail.records, playing: detail.playing, edits: detail.edits, undo: detail.undo, redo: detail.redo });
  const drawn = JSON.stringify([detail.controls, detail.locks]);
  if (drawn !== studio.drawn) scene.flow();
  studio.drawn = drawn;
  overlay.controls = detail.controls; overlay.locks = detail.locks;
  put($("map"), "value", detail.map ?? "");
  if (!detail.map && studio.map) showMap(null);
  put($("types"), "checked", detail.types);
  if (!detail.types && studio.types) { studio.types = null; $("types-legend").hidden = true; if (studio.state) show(studio.state); }
  put($("rate"), "value", String(detail.rate)); put($("rate-value"), "textContent", `${number(detail.rate)}/s`);
  showSession(studio, detail);
  showTimeline(studio);
});
$("edits").parentElement.addEventListener("toggle", () => showEdits(studio));

link.addEventListener("state", ({ detail }) => {
  studio.live = detail;
  studio.seen++;
  if (studio.shown === null) show(detail);
});

link.addEventListener("earlier", ({ detail }) => { if (studio.shown !== null && studio.records[studio.shown]?.[0] === detail.step) show(detail); });

function show(state) {
  studio.state = state;
  scene.setState(state, studio.types && ((c) => kindOf(studio.types[state.id[c]]?.[0])));
  studio.mark();
}

link.addEventListener("patch", ({ detail }) => {
  if (detail.raster === "height" && ground.height) {
    ground.height.put(detail);
    ground.shadeRows(detail.row, detail.rows);
    scene.setHeights();
  } else if (detail.raster === "control") {
    if (!ground.control) { link.ask("scene").catch(() => {}); return; }
    ground.control.put(detail);
    scene.setField(studio.layers.field !== false);
  }
});

link.addEventListener("loops", ({ detail }) => {
  const ribbon = detail.mode % 2 ? scene.old : scene.oxbows;
  if (detail.mode > 1) ribbon.clear();
  ribbon.add(detail.start, detail.xy, (c) => 0.5 * detail.width[c], (c) => detail.time[c]);
  scene.flow();
});

// ---- maps on the ground

function showMap(map) {
  studio.map = map;
  scene.setMap(map, map && rampOf(map.name));
  $("map-legend").hidden = !map;
}
link.addEventListener("map", ({ detail }) => { studio.mapWords = detail; });
link.addEventListener("mapcells", ({ detail }) => {
  if (detail.name !== $("map").value) return;
  const { title, unit, time } = studio.mapWords;
  showMap(detail);
  drawRamp($("map-ramp"), detail.name);
  $("map-low").textContent = number(detail.low, 2);
  $("map-high").textContent = number(detail.high, 2);
  $("map-title").textContent = `${title}${unit !== "-" ? `, ${unit}` : ""}, ${number(time)} yr`;
});
link.addEventListener("river_types", ({ detail }) => {
  if (!$("types").checked) return;
  studio.types = detail.types;
  const there = new Set(Object.values(detail.types).map(([type]) => kindOf(type)));
  $("types-legend").hidden = false;
  $("types-legend").replaceChildren(...Object.entries(TYPES).filter((_, k) => there.has(k + 1)).map(([type, [colour, words]]) => {
    const item = document.createElement("li"), swatch = document.createElement("canvas");
    Object.assign(swatch, { width: 14, height: 10 });
    const g = swatch.getContext("2d");
    g.fillStyle = colour; g.fillRect(0, 0, 14, 10);
    item.append(swatch, `${type}: ${words}`);
    return item;
  }));
  if (studio.state) show(studio.state);
});
scene.rivers.uniforms.kinds.value.forEach((colour, k) => colour.setStyle(Object.values(TYPES)[k]?.[0] ?? "#186ab3", ""));
$("map").addEventListener("change", () => studio.ask("map", { name: $("map").value || null }).catch(() => {}));
$("types").addEventListener("change", () => studio.ask("types", { on: $("types").checked }).catch(() => {}));
$("use-preset").addEventListener("click", () => studio.ask("preset", { name: $("preset").value }).then(({ note }) => { if (note) studio.say(note); }).catch(() => {}));

link.addEventListener("events", ({ detail }) => { studio.events.push(...detail.events); if (studio.events.length > 5000) studio.events.splice(0, 2500); });
link.addEventListener("figures", ({ detail }) => { studio.records = detail.records; plots.add(detail); showTimeline(studio); });
link.addEventListener("error", ({ detail }) => studio.say(detail.text));
link.addEventListener("crashed", () => {
  studio.say("The simulation has stopped. Its last state and all edits are kept; it is taken up again …");
  setTimeout(() => studio.ask("restart").catch(() => {}), 300);
});
link.addEventListener("closed", () => studio.say("Not connected; trying again …"));
link.addEventListener("open", () => {
  $("message").hidden = true;
  const saved = new URLSearchParams(location.search).get("saved");
  if (saved && !studio.opened) { studio.opened = true; studio.ask("open_saved", { saved }).catch(() => {}); }
});

// ---- run, edits, timeline

$("play").addEventListener("click", () => studio.ask(studio.playing ? "pause" : "play").catch(() => {}));
$("step").addEventListener("click", () => studio.ask("step").catch(() => {}));
$("undo").addEventListener("click", () => studio.ask("undo").catch(() => {}));
$("redo").addEventListener("click", () => studio.ask("redo").catch(() => {}));
$("rate").addEventListener("input", () => { $("rate-value").textContent = `${$("rate").value}/s`; });
$("rate").addEventListener("change", () => studio.ask("rate", { rate: Number($("rate").value) }).catch(() => {}));
$("timeline").addEventListener("input", async () => {
  const k = Number($("timeline").value);
  if (k >= studio.records.length) { studio.shown = null; if (studio.live) show(studio.live); showTimeline(studio); return; }
  studio.shown = k;
  showTimeline(studio);
  await studio.ask("record", { index: k }).catch(() => { studio.shown = null; });
});
$("rewind").addEventListener("click", async () => {
  const at = studio.records[studio.shown];
  studio.shown = null;
  if (at) await studio.ask("rewind", { step: at[0] }).catch(() => {});
});

// ---- files

/** Ask the server to begin anew with something; the page tells how long that takes, and may give it up. */
async function beginWith(words, address, request, expected = null) {
  studio.begun?.abort();
  const control = new AbortController(), began = performance.now();
  const tell = () => {
    const s = (performance.now() - began) / 1000;
    $("busy-text").textContent = `${words} … ${s < 1 ? "" : `${s.toFixed(0)} s`}${expected ? ` of about ${inWords(expected)}` : ""}`;
  };
  studio.begun = control;
  tell();
  $("busy").hidden = false;
  const timer = setInterval(tell, 1000);
  try {
    const answer = await fetch(address, { ...request, signal: control.signal });
    if (!answer.ok) studio.say((await answer.text()).trim());
  } catch (error) {
    studio.say(control.signal.aborted ? "Given up; the session is as it was" : error.message);
  } finally {
    clearInterval(timer);
    if (studio.begun === control) { studio.begun = null; $("busy").hidden = true; }
  }
}
$("busy-cancel").addEventListener("click", () => studio.begun?.abort());
const openFile = (file) => beginWith(`Opening ${file.name}`, `open/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
$("open").addEventListener("change", () => { if ($("open").files[0]) openFile($("open").files[0]); $("open").value = ""; });
window.addEventListener("dragover", (event) => { event.preventDefault(); $("drop").hidden = false; });
window.addEventListener("dragleave", (event) => { if (!event.relatedTarget) $("drop").hidden = true; });
window.addEventListener("drop", (event) => { event.preventDefault(); $("drop").hidden = true; if (event.dataTransfer.files[0]) openFile(event.dataTransfer.files[0]); });
async function make(name, rest = {}) {
  $("making").textContent = `Making ${name} …`;
  try { return (await studio.ask("export", { name, ...rest })).file; } finally { $("making").textContent = ""; }
}
const download = (name) => make(name).then((file) => fetchFile(`exports/${file}`, file)).catch(() => {});
for (const button of document.querySelectorAll("[data-export]")) button.addEventListener("click", () => download(button.dataset.export));
$("landscape").addEventListener("click", () => download($("target").value));
/** Show the water of a reach, as a picture that is made for it. */
studio.showWater = async (center, width) => {
  studio.say("Making a picture of the water …", true);
  const file = await make("water.png", { center, width });
  $("water-picture").src = `exports/${file}?${Date.now()}`;
  $("water").showModal();
  $("hint").textContent = studio.tool?.title ?? "";
};
$("new").addEventListener("click", () => showGenerators(studio.generators ?? [], (recipe, seconds) =>
  beginWith("Making the terrain and its rivers", "new", { method: "POST", body: JSON.stringify(recipe) }, seconds)));
function fetchFile(address, name) {
  studio.files.push(name);
  const a = document.createElement("a");
  a.href = address; a.download = name;
  document.body.append(a); a.click(); a.remove();
}
$("save").addEventListener("click", async () => {
  const { saved } = await studio.ask("save");
  Object.assign($("saved"), { hidden: false, href: `./?saved=${saved}`, textContent: "link that restores it" });
});
$("picture").addEventListener("click", () => { scene.dirty = true; scene.draw(); canvas.toBlob((blob) => { const at = URL.createObjectURL(blob); fetchFile(at, "rivers.png"); setTimeout(() => URL.revokeObjectURL(at), 1000); }); });

// ---- view

$("view").addEventListener("click", () => { view.relief = !view.relief; $("view").setAttribute("aria-pressed", String(view.relief)); studio.redraw(); });
$("fit").addEventListener("click", () => { if (studio.bounds) view.fit(...studio.bounds); studio.redraw(); });
const root = document.documentElement;
const isDark = () => root.dataset.theme === "dark" || (root.dataset.theme === "auto" && matchMedia("(prefers-color-scheme: dark)").matches);
$("theme").addEventListener("click", () => { root.dataset.theme = isDark() ? "light" : "dark"; scene.setBack(isDark()); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => scene.setBack(isDark()));
scene.setBack(isDark());

// ---- pointer and keys

const pointers = new Map();
let held = null, pinch = null;
const pixel = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
const place = (event) => { view.update(); const [x, y] = view.place(...pixel(event)); return { x, y }; };
const run = (result) => { if (result?.catch) result.catch(() => {}); return result; };

canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  canvas.focus({ preventScroll: true });
  pointers.set(event.pointerId, pixel(event));
  if (pointers.size === 2) { const [a, b] = [...pointers.values()]; pinch = { span: Math.hypot(a[0] - b[0], a[1] - b[1]), middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] }; held = null; return; }
  const turn = event.button === 2 && view.relief, pan = event.button === 1 || (event.button === 2 && !turn) || studio.tool?.pan || event.shiftKey;
  held = { turn, pan, at: pixel(event) };
  if (!turn && !pan && event.button === 0) { held.tool = true; run(studio.tool?.down?.(place(event))); }
});
canvas.addEventListener("pointermove", (event) => {
  const now = pixel(event);
  if (pointers.has(event.pointerId)) pointers.set(event.pointerId, now);
  if (pinch && pointers.size === 2) {
    const [a, b] = [...pointers.values()], span = Math.hypot(a[0] - b[0], a[1] - b[1]), middle = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    view.zoom(pinch.span / Math.max(1, span), ...middle);
    view.pan(middle[0] - pinch.middle[0], middle[1] - pinch.middle[1]);
    pinch = { span, middle };
    studio.redraw();
    return;
  }
  if (held && (held.pan || held.turn)) {
    const [dx, dy] = [now[0] - held.at[0], now[1] - held.at[1]];
    if (held.turn) view.turn(dx, dy); else view.pan(dx, dy);
    held.at = now;
    studio.redraw();
    return;
  }
  const p = place(event);
  studio.tool?.move?.(p, Boolean(held?.tool));
  overlay.hover = studio.tool?.radius ? { ...p, radius: optionValues.radius } : null;
  const hit = studio.state && nearest(studio.state, p.x, p.y, 10 * view.metres + 30);
  const world = [p.x + studio.origin[0], p.y + studio.origin[1]];
  let text = `${world[0].toFixed(0)}, ${world[1].toFixed(0)} m`;
  if (ground.height) text += `   ${number(ground.at(p.x, p.y), 4)} m high`;
  if (studio.map) text += `   ${mapText(p)}`;
  if (hit) {
    const f = facts(studio.state, hit.channel), type = studio.types?.[f.id]?.[0];
    text += `\nchannel ${f.id}   ${number(studio.state.width(hit.channel, hit.point))} m wide, ${number(f.depth)} m deep, ${number(f.discharge)} m³/s`;
    text += `\nsinuosity ${number(f.sinuosity)}, order ${f.order}${type ? `, type ${type}` : ""}`;
  }
  $("readout").textContent = text;
  studio.redraw();
});
/** What the map on the ground says at a place. */
function mapText(p) {
  const m = studio.map, c = Math.floor((p.x - m.west) / m.cell), r = Math.floor((m.north - p.y) / m.cell);
  const v = c >= 0 && r >= 0 && c < m.columns && r < m.rows ? m.values[r * m.columns + c] : 255;
  const { title, unit } = studio.mapWords;
  return `${title.toLowerCase()}: ${v === 255 ? "none" : `${number(m.low + (m.high - m.low) * v / 254)}${unit !== "-" ? ` ${unit}` : ""}`}`;
}
function release(event) {
  pointers.delete(event.pointerId);
  if (pointers.size < 2) pinch = null;
  if (held?.tool) run(studio.tool?.up?.(place(event)));
  held = null;
}
canvas.addEventListener("pointerup", release);
canvas.addEventListener("pointercancel", release);
canvas.addEventListener("pointerleave", () => { overlay.hover = null; studio.redraw(); });
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("dblclick", () => { if (studio.tool?.line) run(studio.tool.done()); });
canvas.addEventListener("wheel", (event) => { event.preventDefault(); view.zoom(Math.exp(event.deltaY * 0.0015), ...pixel(event)); studio.redraw(); }, { passive: false });

const KEYS = {
  " ": ["Play or pause", () => $("play").click()], ".": ["One step", () => $("step").click()], v: ["Map or relief", () => $("view").click()],
  Home: ["Show all", () => $("fit").click()], t: ["Dark or light", () => $("theme").click()], "+": ["Zoom in", () => view.zoom(0.8)], "=": [null, () => view.zoom(0.8)],
  "-": ["Zoom out", () => view.zoom(1.25)], ArrowLeft: ["Move the map", () => view.pan(60, 0)], ArrowRight: [null, () => view.pan(-60, 0)],
  ArrowUp: [null, () => view.pan(0, 60)], ArrowDown: [null, () => view.pan(0, -60)], "[": ["Smaller brush", () => { optionValues.radius = Math.max(50, optionValues.radius / 1.2); showOptions(studio.tool); }],
  "]": ["Larger brush", () => { optionValues.radius = Math.min(5000, optionValues.radius * 1.2); showOptions(studio.tool); }],
  Enter: ["End a line", () => { if (studio.tool?.line) run(studio.tool.done()); }], Escape: ["Give up a line", () => studio.tool?.cancel?.()],
  "?": ["This list", () => $("help").click()],
};
for (const tool of tools.all) if (tool.key) KEYS[tool.key] = [tool.name, () => studio.use(tool)];
window.addEventListener("keydown", (event) => {
  if (event.target.matches("input:not([type=range]):not([type=checkbox]), select, textarea") || document.querySelector("dialog[open]")) return;
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z") { event.preventDefault(); (event.shiftKey ? $("redo") : $("undo")).click(); return; }
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const onButton = event.target.matches("button, a, summary, input") && [" ", "Enter", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home"].includes(event.key);
  const key = KEYS[event.key];
  if (key && !onButton) { event.preventDefault(); key[1](); studio.redraw(); }
});
$("help").addEventListener("click", () => {
  const list = $("key-list");
  list.replaceChildren();
  for (const [key, [name]] of [...Object.entries(KEYS), ["Ctrl Z", ["Undo"]], ["Ctrl Shift Z", ["Redo"]]]) {
    if (!name) continue;
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = key === " " ? "Space" : key; dd.textContent = name;
    list.append(dt, dd);
  }
  $("keys").showModal();
});

// ---- drawing

new ResizeObserver(() => {
  const { width, height } = holder.getBoundingClientRect();
  const first = view.width <= 1;
  view.resize(width, height); scene.resize(width, height); overlay.resize(width, height);
  if (first && studio.bounds) view.fit(...studio.bounds);
}).observe(holder);

let planned = null;
/** Draw as soon as that can be, and only if there is something new; words beside the map change with it. */
function plan() {
  if (!scene.dirty || planned === "frame" || (planned !== null && !scene.urgent)) return;
  clearTimeout(planned);
  const wait = scene.wait();
  if (wait > 0) planned = setTimeout(() => { planned = null; plan(); }, wait);
  else { planned = "frame"; requestAnimationFrame(frame); }
}
function frame() {
  planned = null;
  if (!scene.draw()) return;
  overlay.draw();
  showScale(view.metres);
  const state = studio.state;
  if (state) {
    put($("years"), "textContent", state.time.toFixed(1));
    put($("step-time"), "textContent", `${number(state.stepMs)} ms a step`);
    showChannel(studio);
  }
}
scene.changed = plan;
studio.use(tools.all[0]);
plan();
