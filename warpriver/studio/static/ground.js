// The heights that a page holds, and the field that is painted on them.

import * as THREE from "./vendor/three.module.js";

export class Grid {
  constructor(place, fill = 0) {
    Object.assign(this, place);
    this.values = new Float32Array(this.rows * this.columns).fill(fill);
    this.texture = new THREE.DataTexture(this.values, this.columns, this.rows, THREE.RedFormat, THREE.FloatType);
    this.texture.minFilter = this.texture.magFilter = THREE.LinearFilter;
    this.texture.needsUpdate = true;
  }

  put({ row, column, rows, columns, values }) {
    for (let r = 0; r < rows; r++) {
      this.values.set(values.subarray(r * columns, (r + 1) * columns), (row + r) * this.columns + column);
    }
    this.texture.needsUpdate = true;
  }

  /** Value at a place relative to the origin of the map, bilinear; 0 off the grid. */
  at(x, y) {
    const c = (x - this.west) / this.cell - 0.5, r = (this.north - y) / this.cell - 0.5;
    const c0 = Math.min(this.columns - 1, Math.max(0, Math.floor(c))), r0 = Math.min(this.rows - 1, Math.max(0, Math.floor(r)));
    const c1 = Math.min(this.columns - 1, c0 + 1), r1 = Math.min(this.rows - 1, r0 + 1);
    const u = Math.min(1, Math.max(0, c - c0)), v = Math.min(1, Math.max(0, r - r0));
    const a = this.values, n = this.columns;
    const value = (1 - v) * ((1 - u) * a[r0 * n + c0] + u * a[r0 * n + c1]) + v * ((1 - u) * a[r1 * n + c0] + u * a[r1 * n + c1]);
    return Number.isFinite(value) ? value : 0;
  }

  range() {
    let low = Infinity, high = -Infinity;
    for (const v of this.values) { if (v < low) low = v; if (v > high) high = v; }
    return low <= high ? [low, high] : [0, 1];
  }
}

export class Ground {
  constructor() {
    this.height = null; this.control = null; this.exaggeration = 2;
    this.shade = null;
  }

  at(x, y) { return this.height ? this.height.at(x, y) : 0; }
  shown(x, y) { return this.exaggeration * this.at(x, y); }

  /** Shade the slopes of some rows, lit from the north-west. */
  shadeRows(first = 0, count = Infinity) {
    const g = this.height;
    if (!g) return;
    if (!this.shade) {
      this.shade = new THREE.DataTexture(new Uint8Array(g.rows * g.columns), g.columns, g.rows, THREE.RedFormat, THREE.UnsignedByteType);
      this.shade.minFilter = this.shade.magFilter = THREE.LinearFilter;
      this.shade.unpackAlignment = 1;
    }
    const out = this.shade.image.data, n = g.columns, h = g.values, scale = 1 / (2 * g.cell);
    const from = Math.max(0, first - 1), to = Math.min(g.rows, first + count + 1);
    for (let r = from; r < to; r++) {
      const up = Math.max(0, r - 1) * n, down = Math.min(g.rows - 1, r + 1) * n;
      for (let c = 0; c < n; c++) {
        const dx = (h[r * n + Math.min(n - 1, c + 1)] - h[r * n + Math.max(0, c - 1)]) * scale * 2.5;
        const dy = (h[up + c] - h[down + c]) * scale * 2.5;
        const light = (0.5 * dx - 0.5 * dy + 0.707) / Math.sqrt(1 + dx * dx + dy * dy);
        out[r * n + c] = Math.max(0, Math.min(255, 255 * (0.25 + 0.75 * light)));
      }
    }
    this.shade.needsUpdate = true;
  }
}
