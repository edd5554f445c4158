// Colours of the maps that lie on the ground, and of types of rivers, with their legends.

// Places from 0 to 1 with red, green, blue and how far the ground is covered.
const RAMPS = {
  moisture: [[0, 239, 233, 216, .75], [.25, 201, 219, 207, .85], [.55, 111, 168, 180, .9], [.8, 47, 111, 149, .9], [1, 23, 63, 107, .95]],
  sediment: [[0, 244, 241, 232, 0], [.02, 240, 226, 190, .6], [.3, 234, 217, 174, .9], [.6, 207, 159, 92, .9], [.85, 154, 98, 51, .9], [1, 93, 52, 25, .95]],
  vegetation: [[0, 240, 234, 214, .8], [.3, 199, 207, 148, .85], [.6, 127, 162, 87, .9], [1, 36, 81, 43, .95]],
  age: [[0, 255, 243, 196, .9], [.2, 243, 181, 98, .9], [.5, 198, 95, 79, .9], [.8, 111, 58, 109, .9], [1, 44, 35, 80, .9]],
  belt: [[0, 232, 206, 140, .8], [1, 232, 206, 140, .8]],
  elevation_change: [[0, 61, 95, 134, .95], [.4, 150, 175, 200, .7], [.5, 242, 239, 230, 0], [.6, 205, 170, 130, .7], [1, 143, 90, 43, .95]],
  sand: [[0, 91, 83, 71, .9], [.5, 179, 157, 114, .9], [1, 246, 231, 184, .9]],
};
// Rosgen's types, in the order of their slopes.
export const TYPES = {
  "A+": ["#7a1f4b", "cascades, steeper than 10 %"], A: ["#b5322f", "steps and pools, 4 to 10 %"], B: ["#d9822b", "rapids, 2 to 4 %"],
  C: ["#2f7fb8", "bends and bars on a wide floodplain"], D: ["#7d8f99", "braided"], DA: ["#4f9d69", "many stable threads"],
  E: ["#1b5fa8", "narrow, deep, tight bends"], F: ["#8a6fb0", "entrenched bends"], G: ["#a8577e", "gullies"],
};

function at(ramp, t) {
  const k = Math.max(1, ramp.findIndex(([place]) => place >= t)), [p, ...a] = ramp[k - 1], [q, ...b] = ramp[k];
  const u = Math.min(1, Math.max(0, (t - p) / Math.max(1e-9, q - p)));
  return a.map((v, j) => v + u * (b[j] - v));
}

/** 256 steps of red, green, blue and cover, of a map. */
export function rampOf(name) {
  const out = new Uint8Array(4 * 256), ramp = RAMPS[name] ?? RAMPS.moisture;
  for (let k = 0; k < 256; k++) {
    const [r, g, b, a] = at(ramp, Math.min(1, k / 254));
    out.set([r, g, b, 255 * a], 4 * k);
  }
  return out;
}

/** Draw the colours of a map from its least to its greatest value. */
export function drawRamp(canvas, name) {
  const g = canvas.getContext("2d"), colours = rampOf(name);
  for (let x = 0; x < canvas.width; x++) {
    const k = 4 * Math.round(254 * x / (canvas.width - 1)), a = colours[k + 3] / 255;
    const over = (v) => Math.round(a * v + (1 - a) * 205);
    g.fillStyle = `rgb(${over(colours[k])}, ${over(colours[k + 1])}, ${over(colours[k + 2])})`;
    g.fillRect(x, 0, 1, canvas.height);
  }
}

/** Number from 1 on of a type; 0 for none. Digits of the bed's material do not count. */
export const kindOf = (type) => 1 + Object.keys(TYPES).indexOf(String(type).replace(/\d+$/, ""));
