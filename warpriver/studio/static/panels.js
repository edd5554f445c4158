// Everything beside the map: layers, figures, constants, timeline.

import { facts } from "./rivers.js";

const element = (name, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
};
export const $ = (id) => document.getElementById(id);
export const number = (value, digits = 3) => (Number.isFinite(value) ? Number(value.toPrecision(digits)).toLocaleString("en") : "–");

const LAYERS = [
  ["rivers", "Rivers", true], ["oxbows", "Oxbow lakes", true], ["old", "Abandoned courses", true], ["relief", "Shaded relief", true],
  ["contours", "Contours", true], ["field", "Painted control field", true], ["controls", "Attractors, repellers, guides, regions", true],
  ["locks", "Locked points", true],
];

export function makeLayers(studio) {
  for (const [id, name, on] of LAYERS) {
    const box = element("input", { type: "checkbox", checked: on, id: `layer-${id}` });
    box.addEventListener("change", () => studio.showLayer(id, box.checked));
    $("layers").append(element("label", { title: `Show or hide: ${name}` }, box, name));
  }
}

export function showChannel(studio) {
  const holder = $("channel"), state = studio.state;
  const channel = state && studio.chosen !== null ? state.id.indexOf(studio.chosen) : -1;
  if (channel < 0) {
    if (!holder.querySelector(".quiet")) holder.replaceChildren(element("p", { className: "quiet", textContent: "Choose a channel with the Inspect tool." }));
    return;
  }
  const f = facts(state, channel);
  const rows = [["Identity", f.id], ["Length", `${number(f.length / 1000)} km`], ["Sinuosity", number(f.sinuosity)], ["Strahler order", f.order], ["Width", `${number(f.width)} m`], ["Depth", `${number(f.depth)} m`], ["Discharge", `${number(f.discharge)} m³/s`]];
  const list = element("dl", {}, ...rows.flatMap(([name, value]) => [element("dt", { textContent: name }), element("dd", { textContent: value })]));
  const old = holder.querySelector("dl");
  if (old && holder.dataset.id === String(f.id)) { old.replaceWith(list); return; }
  holder.dataset.id = f.id;
  const form = element("form");
  for (const [name, unit] of [["width", "m"], ["depth", "m"], ["discharge", "m³/s"]]) {
    form.append(element("label", { title: `Set the ${name} of this channel` }, `Set ${name} (${unit})`, element("input", { type: "number", name, min: "0.01", step: "any", placeholder: number(f[name]) })));
  }
  form.append(element("button", { textContent: "Set", title: "Set what is filled in; the water goes on downstream" }));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const values = Object.fromEntries([...new FormData(form)].filter(([, v]) => v !== "").map(([k, v]) => [k, Number(v)]));
    if (Object.keys(values).length) studio.ask("edit", { edit: { edit: "SetChannel", channel: studio.chosen, ...values } });
    form.reset();
  });
  holder.replaceChildren(list, form);
}

const PLOTS = [["sinuosity", "Sinuosity", "-"], ["cutoffs", "Cutoffs", ""], ["wavelength", "Wavelength", "m"]];

export class Plots {
  constructor() {
    this.series = Object.fromEntries(PLOTS.map(([id]) => [id, []]));
    for (const [id, name, unit] of PLOTS) {
      const value = element("b");
      value.id = `plot-${id}`;
      const canvas = element("canvas", { width: 480, height: 88 });
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${name} over time`);
      $("plots").append(element("div", { className: "plot", title: `${name} over the run${unit && unit !== "-" ? `, ${unit}` : ""}` }, element("div", {}, element("span", { textContent: name }), value), canvas));
    }
    $("plots").append(element("p", { className: "quiet", id: "counts" }));
  }

  /** Begin with what the session has noted so far. */
  take(series) {
    for (const [id] of PLOTS) { this.series[id] = series[id] ?? []; this.draw(id); }
  }

  add(told) {
    for (const [id, , unit] of PLOTS) {
      const list = this.series[id], value = told[id];
      while (list.length && list[list.length - 1][0] >= told.time) list.pop();
      if (value !== null && value !== undefined) list.push([told.time, value]);
      if (list.length > 600) this.series[id] = list.filter((_, k) => k % 2 === 0);
      $(`plot-${id}`).textContent = `${number(value)}${unit && unit !== "-" ? ` ${unit}` : ""}`;
      this.draw(id);
    }
    $("counts").textContent = `${told.channels.toLocaleString("en")} channels, ${told.points.toLocaleString("en")} points, ${told.collisions} collisions, ${told.avulsions} avulsions`;
  }

  draw(id) {
    const canvas = $(`plot-${id}`).parentElement.nextElementSibling, g = canvas.getContext("2d", { willReadFrequently: true }), list = this.series[id];
    g.clearRect(0, 0, canvas.width, canvas.height);
    if (list.length < 2) return;
    const t0 = list[0][0], t1 = list[list.length - 1][0];
    let low = Infinity, high = -Infinity;
    for (const [, v] of list) { low = Math.min(low, v); high = Math.max(high, v); }
    if (high - low < 1e-9) { high += 0.5; low -= 0.5; }
    g.beginPath();
    list.forEach(([t, v], k) => {
      const x = 2 + (canvas.width - 4) * (t - t0) / Math.max(1e-9, t1 - t0), y = canvas.height - 4 - (canvas.height - 8) * (v - low) / (high - low);
      if (k) g.lineTo(x, y); else g.moveTo(x, y);
    });
    g.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue("--accent");
    g.lineWidth = 3; g.stroke();
  }
}

export function showConstants(studio, scene) {
  const form = $("constants");
  form.replaceChildren();
  for (const { name, symbol, unit, doc, choices } of scene.constants) {
    const value = scene.params[name];
    if (value === null || value === undefined) continue;
    const input = choices.length
      ? element("select", { name }, ...choices.map((c) => element("option", { value: c, textContent: c, selected: c === value })))
      : element("input", { name, type: "number", step: "any", value });
    const sign = element("span", { className: "symbol", textContent: symbol });
    form.append(element("label", { title: doc }, ...(symbol ? [sign] : []), `${name.replaceAll("_", " ")}${unit && unit !== "-" ? ` (${unit})` : ""}`, input));
  }
  form.append(element("button", { textContent: "Begin anew with these", title: "Other constants hold from a new beginning: the rivers as they are now" }));
  form.onsubmit = (event) => {
    event.preventDefault();
    const given = {};
    for (const [name, text] of new FormData(form)) {
      const value = Number.isNaN(Number(text)) ? text : Number(text);
      if (value !== scene.params[name]) given[name] = value;
    }
    if (Object.keys(given).length) studio.ask("params", given);
  };
}

/** Presets, maps and targets to choose from. */
export function showChoices(scene) {
  const fill = (id, options, first = []) => {
    const kept = $(id).value;
    $(id).replaceChildren(...[...first, ...options].map(([value, text]) => element("option", { value, textContent: text })));
    if ([...$(id).options].some((o) => o.value === kept)) $(id).value = kept;
  };
  fill("map", scene.maps, [["", "none"]]);
  fill("preset", scene.presets);
  fill("target", scene.targets);
  const tell = () => { $("preset-doc").textContent = scene.presets.find(([name]) => name === $("preset").value)?.[2] ?? ""; };
  $("preset").onchange = tell;
  tell();
}

export const inWords = (seconds) => (seconds < 2 ? "a second" : seconds < 90 ? `${number(seconds, seconds < 10 ? 1 : 2)} seconds` : `${number(seconds / 60, 2)} minutes`);

/** The dialog that asks for a new terrain. */
export function showGenerators(generators, make) {
  const form = $("fresh-form"), choice = element("select", { title: "What kind of land" }), doc = element("p", { className: "quiet" }), fields = element("div"), takes = element("p", { className: "quiet", id: "fresh-takes" });
  const given = () => Object.fromEntries([...new FormData(form)].map(([k, v]) => [k, Number.isNaN(Number(v)) ? v : Number(v)]));
  /** Seconds that it takes, about: what it took with the values by default, by powers of the values. */
  const seconds = () => {
    const chosen = generators.find((g) => g.name === choice.value), values = given();
    return Object.entries(chosen.powers).reduce((s, [name, power]) => s * (values[name] / chosen.fields.find((f) => f.name === name).value) ** power, chosen.seconds);
  };
  const estimate = () => { const s = seconds(); takes.textContent = Number.isFinite(s) ? `Takes about ${inWords(s)}.` : ""; };
  choice.append(...generators.map((g) => element("option", { value: g.name, textContent: g.title })));
  const show = () => {
    const chosen = generators.find((g) => g.name === choice.value);
    doc.textContent = chosen.doc;
    fields.replaceChildren(...chosen.fields.map((f) => {
      const input = f.choices
        ? element("select", { name: f.name, title: f.doc }, ...f.choices.map((c) => element("option", { value: c, textContent: c })))
        : element("input", { name: f.name, type: "number", step: f.whole ? "1" : "any", min: f.low, max: f.high, value: f.value, title: `${f.doc}: ${f.low} to ${f.high}`, required: true });
      return element("label", {}, `${f.label}${f.unit && f.unit !== "-" ? ` (${f.unit})` : ""}`, input);
    }));
    estimate();
  };
  choice.addEventListener("change", show);
  form.replaceChildren(
    element("label", { className: "wide" }, "Land", choice), doc, fields, takes,
    element("button", { type: "submit", textContent: "Make", title: "Make it; the present session is replaced, so save it first" }), " ",
    element("button", { type: "button", textContent: "Cancel", title: "Keep the present one (Esc)", onclick: () => $("fresh").close() }));
  show();
  form.oninput = estimate;
  form.onsubmit = (event) => {
    event.preventDefault();
    const values = given(), expected = seconds();
    $("fresh").close();
    make({ generator: choice.value, ...values }, expected);
  };
  $("fresh").showModal();
}

/** Set a property where it differs: setting it again would have the page drawn again. */
export function put(target, name, value) { if (target[name] !== value) target[name] = value; }

let listed = ["", ""];

export function showSession(studio, told) {
  put($("undo"), "disabled", !told.undo);
  put($("redo"), "disabled", !told.redo);
  put($("play"), "textContent", told.playing ? "Pause" : "Play");
  put($("play"), "ariaPressed", String(told.playing));
  const before = listed;
  listed = [JSON.stringify(told.edits), JSON.stringify(told.controls)];
  if (listed[0] !== before[0]) showEdits(studio);
  if (listed[1] === before[1]) return;
  const items = told.controls.map((c, k) => {
    const drop = element("button", { textContent: "Remove", title: `Remove this ${c.kind}` });
    drop.setAttribute("aria-label", `Remove ${c.kind} ${k + 1}`);
    drop.addEventListener("click", () => studio.ask("controls", { controls: studio.controls.filter((_, j) => j !== k) }));
    return element("li", {}, `${c.kind}${c.radius ? `, ${number(c.radius)} m` : ""} `, drop);
  });
  $("controls").replaceChildren(...items);
}

/** The last edits, where their list is open. */
export function showEdits(studio) {
  if (!$("edits").parentElement.open) return;
  const names = studio.edits.map(([step, name]) => element("li", { textContent: `${name.replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase()} – step ${step}` }));
  $("edits").replaceChildren(...names.reverse());
}

let marked = "";

export function showTimeline(studio) {
  const records = studio.records, slider = $("timeline");
  const live = studio.shown === null;
  put(slider, "max", String(Math.max(0, records.length)));
  if (live) put(slider, "value", slider.max);
  const at = live ? null : records[studio.shown];
  put($("timeline-text"), "textContent", live ? "now" : `${number(at ? at[1] : 0)} yr`);
  put(slider, "ariaValueText", $("timeline-text").textContent);
  put($("rewind"), "disabled", live);
  const last = records.length ? records[records.length - 1][1] : 0, first = records.length ? records[0][1] : 0;
  // Only when they have changed: this is asked for with each edit and each set of figures.
  const key = `${studio.events.length} ${studio.events.at(-1)?.[1]} ${first} ${last}`;
  if (key === marked) return;
  marked = key;
  const marks = studio.events.filter(([, t]) => t >= first && t <= last).slice(-400).map(([kind, t]) => {
    const mark = element("i", { className: kind });
    mark.style.left = `${100 * (t - first) / Math.max(1e-9, last - first)}%`;
    return mark;
  });
  $("marks").replaceChildren(...marks);
}

export function showScale(metres) {
  const aim = 120 * metres, power = 10 ** Math.floor(Math.log10(aim));
  const length = power * [5, 2, 1].find((k) => k * power <= aim);
  $("scale-bar").style.width = `${length / metres}px`;
  $("scale-text").textContent = length >= 1000 ? `${length / 1000} km` : `${length} m`;
}
