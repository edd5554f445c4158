// What the pointer does on the map. Each tool has a name, a tooltip, a key, its options, and handlers that get a place
// {x, y} relative to the origin of the map.

import { facts, moved, nearest } from "./rivers.js";

const OPTIONS = {
  radius: { label: "Radius", unit: "m", low: 50, high: 5000, value: 800, log: true, title: "Radius of the brush or of the influence" },
  strength: { label: "Strength", unit: "m", low: 1, high: 500, value: 40, log: true, title: "What one touch adds at the centre of the brush" },
  pull: { label: "Strength", unit: "-", low: 0.1, high: 4, value: 1, log: true, title: "Greatest gradient of the control field; 1 moves a bend by its own rate" },
  factor: { label: "Factor of the rate", unit: "-", low: 0, high: 5, value: 0, title: "What the rate of migration is multiplied by in the region" },
  amount: { label: "Amount", unit: "m", low: 1, high: 200, value: 10, log: true, title: "Height that one touch adds or takes at the centre" },
  share: { label: "Amount", unit: "-", low: 0.05, high: 1, value: 0.5, title: "How far one touch goes: 1 is all the way" },
  ridge: { label: "Height", unit: "m", low: -300, high: 600, value: 120, title: "Height of the crest; a valley below 0" },
  foot: { label: "Width", unit: "m", low: 50, high: 5000, value: 1200, log: true, title: "Width of the foot" },
  width: { label: "Width", unit: "m", low: 5, high: 400, value: 40, log: true, title: "Bankfull width of the new river" },
};

export const optionValues = Object.fromEntries(Object.entries(OPTIONS).map(([name, o]) => [name, o.value]));
export { OPTIONS };

export function makeTools(studio) {
  const { link, overlay } = studio;
  const absolute = (p) => [p.x + studio.origin[0], p.y + studio.origin[1]];
  const edit = (what, group) => studio.ask("edit", group ? { edit: what, group } : { edit: what });
  const reach = () => 14 * studio.view.metres + 60;
  const at = (place) => (studio.state ? nearest(studio.state, place.x, place.y, reach()) : null);
  const idOf = (hit) => studio.state.id[hit.channel];
  const needs = (hit) => { if (!hit) studio.say("No channel there: click on a river"); return hit; };

  /** Touches along a stroke, one at a time, a third of a radius apart; all of them are one edit to undo. */
  function brush(touch) {
    let last = null, busy = false, next = null, group = "";
    const go = async (place) => {
      if (busy) { next = place; return; }
      busy = true; last = place;
      try { await touch(place, group); } catch (error) { studio.say(error.message); next = null; }
      busy = false;
      if (next) { const p = next; next = null; go(p); }
    };
    return {
      radius: true,
      down(place) { group = `stroke-${Date.now()}`; go(place); },
      move(place, held) { if (held && last && Math.hypot(place.x - last.x, place.y - last.y) > optionValues.radius / 3) go(place); },
      up() { last = null; },
    };
  }

  /** A line drawn point by point; Enter or a double click ends it. */
  function line(finish, { closed = false, least = 2 } = {}) {
    return {
      points: [], line: true, closed,
      down(place) { this.points.push([place.x, place.y]); this.show(place); },
      move(place) { if (this.points.length) this.show(place); },
      show(place) { overlay.path = { points: [...this.points, [place.x, place.y]], closed }; studio.redraw(); },
      async done() {
        const points = this.points.filter((p, k, all) => !k || Math.hypot(p[0] - all[k - 1][0], p[1] - all[k - 1][1]) > 2 * studio.view.metres);
        this.cancel();
        if (points.length < least) { studio.say(`Give at least ${least} points`); return; }
        await finish(points.map(([x, y]) => absolute({ x, y })));
      },
      cancel() { this.points = []; overlay.path = null; studio.redraw(); },
    };
  }

  const control = (make) => ({
    radius: true,
    async down(place) { await studio.ask("controls", { controls: [...studio.controls, make(absolute(place))] }); },
  });
  const terrain = (operation, option) => brush((place, group) => edit(
    { edit: "EditTerrain", operation, center: absolute(place), radius: optionValues.radius, amount: optionValues[option] }, group));
  const paint = (sign) => brush((place, group) => studio.ask(
    "paint", { center: absolute(place), radius: optionValues.radius, amount: sign * optionValues.strength, group }));

  const drag = {
    hit: null,
    down(place) { this.hit = needs(at(place)); if (this.hit) studio.choose(idOf(this.hit)); return Boolean(this.hit); },
    move(place, held) {
      if (!held || !this.hit) return;
      overlay.path = { points: moved(studio.state, this.hit.channel, this.hit.point, place.x - this.hit.x, place.y - this.hit.y, optionValues.radius) };
      overlay.ring = { x: this.hit.x, y: this.hit.y, radius: optionValues.radius };
      studio.redraw();
    },
    async up(place) {
      const hit = this.hit;
      this.hit = null; overlay.path = overlay.ring = null; studio.redraw();
      if (!hit || Math.hypot(place.x - hit.x, place.y - hit.y) < 2 * studio.view.metres) return;
      await edit({ edit: "MovePoint", channel: idOf(hit), at: absolute(hit), to: absolute(place), radius: optionValues.radius });
    },
  };

  const lock = {
    async down(place) {
      const held = studio.locks.find((p) => Math.hypot(p[0] - place.x, p[1] - place.y) < reach());
      const hit = needs(at(place));
      if (hit) await edit({ edit: held ? "UnlockPoint" : "LockPoint", channel: idOf(hit), at: absolute(held ? { x: held[0], y: held[1] } : hit) });
    },
  };

  const click = (what) => ({ async down(place) { const hit = needs(at(place)); if (hit) await edit(what(hit)); } });

  const join = {
    first: null,
    async down(place) {
      const hit = needs(at(place));
      if (!hit) return;
      const id = idOf(hit);
      studio.choose(id);
      if (this.first === null) { this.first = id; studio.say("Now click the channel downstream of it", true); return; }
      const upper = this.first;
      this.first = null;
      await edit({ edit: "JoinChannels", upper, lower: id });
    },
    cancel() { this.first = null; },
  };

  const avulse = {
    from: null,
    async down(place) {
      const hit = at(place);
      if (this.from === null) {
        if (!needs(hit)) return;
        this.from = { id: idOf(hit), at: absolute(hit) };
        studio.choose(this.from.id);
        studio.say("Now click where the water shall go: farther down the same river, on another one, or beside them to leave it to chance", true);
        return;
      }
      const { id, at: from } = this.from, to = hit && idOf(hit);
      this.cancel();
      if (to !== null && to !== id) await edit({ edit: "DivertChannel", channel: id, at: from, to });
      else await edit({ edit: "AvulseChannel", channel: id, at: from, ...(to === id ? { to: absolute(hit) } : {}) });
    },
    cancel() { this.from = null; },
  };

  const redraw = line(async (xy) => {
    const hit = needs(at({ x: xy[0][0] - studio.origin[0], y: xy[0][1] - studio.origin[1] }));
    if (hit) await edit({ edit: "RedrawSection", channel: idOf(hit), xy });
  });

  const list = [
    ["View", [
      { id: "pan", name: "Move map", key: "1", title: "Drag the map; the wheel zooms; right drag turns the relief", pan: true },
      { id: "inspect", name: "Inspect", key: "2", title: "Choose a channel and read its size", down: (place) => { const hit = needs(at(place)); studio.choose(hit ? idOf(hit) : null); } },
      { id: "water", name: "See water", title: "A picture of the water of a reach, by the type of its river", down: (place) => { const hit = needs(at(place)); if (hit) return studio.showWater(absolute(hit), 12 * studio.state.width(hit.channel, hit.point)); return null; } },
    ]],
    ["Rivers", [
      { id: "drag", name: "Drag bend", key: "3", title: "Drag a point of a channel; what lies near it follows", options: ["radius"], ...drag },
      { id: "lock", name: "Lock", key: "4", title: "Hold a point in place, or let it go", ...lock },
      { id: "draw", name: "Draw river", key: "5", title: "Click from the source downstream; end on a channel to join it (Enter ends)", options: ["width"], ...line((xy) => edit({ edit: "AddChannel", xy, width: optionValues.width, ends: "any" })) },
      { id: "redraw", name: "Redraw", key: "6", title: "Give a channel another course: click from one point of it to another (Enter ends)", ...redraw },
      { id: "split", name: "Split", title: "Make two channels of one", ...click((hit) => ({ edit: "SplitChannel", channel: idOf(hit), at: absolute(hit) })) },
      { id: "join", name: "Join", title: "Make one channel of two: click the upper, then the lower one", ...join },
      { id: "remove", name: "Erase", key: "7", title: "Remove a channel", ...click((hit) => ({ edit: "RemoveChannel", channel: idOf(hit) })) },
      { id: "cut", name: "Cut bend", title: "Cut a bend off at its neck: click on the bend; it is left as an oxbow lake", ...click((hit) => ({ edit: "CutLoop", channel: idOf(hit), at: absolute(hit) })) },
      { id: "avulse", name: "Avulse", title: "Let a river leave its course: click where, then where it goes", ...avulse },
    ]],
    ["Ground", [
      { id: "raise", name: "Raise", key: "8", title: "Raise the ground under the brush", options: ["radius", "amount"], ...terrain("raise", "amount") },
      { id: "lower", name: "Lower", title: "Lower it", options: ["radius", "amount"], ...terrain("lower", "amount") },
      { id: "smooth", name: "Smooth", title: "Smooth it", options: ["radius", "share"], ...terrain("smooth", "share") },
      { id: "flatten", name: "Flatten", title: "Flatten it to the height at the centre", options: ["radius", "share"], ...terrain("flatten", "share") },
      { id: "ridge", name: "Ridge", title: "Raise a ridge along a line (Enter ends)", options: ["ridge", "foot"], ...line((xy) => edit({ edit: "EditTerrain", operation: "ridge", line: xy, height: optionValues.ridge, width: optionValues.foot })) },
    ]],
    ["Control", [
      { id: "attract", name: "Paint pull", key: "9", title: "Paint where channels are drawn to", options: ["radius", "strength"], ...paint(1) },
      { id: "repel", name: "Paint push", key: "0", title: "Paint where they are driven from", options: ["radius", "strength"], ...paint(-1) },
      { id: "attractor", name: "Attractor", title: "A point that draws channels towards it", options: ["radius", "pull"], ...control((center) => ({ kind: "Attractor", center, radius: optionValues.radius, strength: optionValues.pull })) },
      { id: "repeller", name: "Repeller", title: "A point that drives them away", options: ["radius", "pull"], ...control((center) => ({ kind: "Repeller", center, radius: optionValues.radius, strength: optionValues.pull })) },
      { id: "guide", name: "Guide", title: "A line that draws a channel towards it (Enter ends)", options: ["radius", "pull"], ...line((xy) => studio.ask("controls", { controls: [...studio.controls, { kind: "Guide", xy, radius: optionValues.radius, strength: optionValues.pull }] })) },
      { id: "region", name: "Bank region", title: "A region with a factor of the rate: below 1 it damps, above 1 it erodes more (Enter ends)", options: ["factor"], ...line((area) => studio.ask("controls", { controls: [...studio.controls, { kind: "ErodibilityField", area, factor: optionValues.factor }] }), { closed: true, least: 3 }) },
    ]],
  ];
  return { list, all: list.flatMap(([, tools]) => tools), facts };
}
