// One place on the map, seen from above or from the side: what is where on the screen, and the other way round.

import * as THREE from "./vendor/three.module.js";

const FIELD = 40 * Math.PI / 180;

export class MapCamera {
  constructor(ground) {
    this.ground = ground;
    this.x = 0; this.y = 0;
    this.metres = 10;            // metres a pixel at the point that is looked at
    this.relief = false;
    this.azimuth = 0; this.tilt = 0.95;
    this.width = 1; this.height = 1;
    this.flat = new THREE.OrthographicCamera(-1, 1, 1, -1, -1e6, 1e6);
    this.deep = new THREE.PerspectiveCamera(40, 1, 1, 1e6);
    this.deep.up.set(0, 0, 1);
  }

  get camera() { return this.relief ? this.deep : this.flat; }

  resize(width, height) { this.width = Math.max(1, width); this.height = Math.max(1, height); }

  fit(west, south, east, north) {
    this.x = 0.5 * (west + east); this.y = 0.5 * (south + north);
    this.metres = 1.08 * Math.max((east - west) / this.width, (north - south) / this.height, 0.01);
  }

  update() {
    const w = 0.5 * this.width * this.metres, h = 0.5 * this.height * this.metres;
    if (!this.relief) {
      Object.assign(this.flat, { left: -w, right: w, top: h, bottom: -h });
      this.flat.position.set(this.x, this.y, 0);
      this.flat.rotation.set(0, 0, 0);
      this.flat.updateProjectionMatrix();
      this.flat.updateMatrixWorld();
      return;
    }
    const away = h / Math.tan(FIELD / 2), z = this.ground.shown(this.x, this.y);
    const [c, s] = [Math.cos(this.tilt), Math.sin(this.tilt)];
    this.deep.aspect = this.width / this.height;
    this.deep.near = Math.max(0.5, away * 0.01); this.deep.far = away * 20 + 2e5;
    this.deep.position.set(this.x - Math.sin(this.azimuth) * c * away, this.y - Math.cos(this.azimuth) * c * away, z + s * away);
    this.deep.lookAt(this.x, this.y, z);
    this.deep.updateProjectionMatrix();
    this.deep.updateMatrixWorld();
  }

  /** Screen place in pixels of a place on the ground; null behind the camera. */
  project(x, y) {
    if (!this.relief) return [0.5 * this.width + (x - this.x) / this.metres, 0.5 * this.height - (y - this.y) / this.metres];
    const p = new THREE.Vector3(x, y, this.ground.shown(x, y)).project(this.deep);
    return p.z > 1 ? null : [0.5 * this.width * (1 + p.x), 0.5 * this.height * (1 - p.y)];
  }

  /** Place on the ground under a pixel. */
  place(px, py) {
    if (!this.relief) return [this.x + (px - 0.5 * this.width) * this.metres, this.y - (py - 0.5 * this.height) * this.metres];
    const from = this.deep.position, to = new THREE.Vector3(2 * px / this.width - 1, 1 - 2 * py / this.height, 0.5).unproject(this.deep);
    const d = to.sub(from).normalize();
    if (d.z > -1e-3) d.z = -1e-3;
    let z = this.ground.shown(this.x, this.y), x = 0, y = 0;
    for (let k = 0; k < 12; k++) {
      const t = (z - from.z) / d.z;
      x = from.x + t * d.x; y = from.y + t * d.y;
      z += 0.7 * (this.ground.shown(x, y) - z);
    }
    return [x, y];
  }

  /** Move the map along with a pointer, by pixels. */
  pan(dx, dy) {
    const right = -dx * this.metres, up = dy * this.metres / (this.relief ? Math.max(0.3, Math.sin(this.tilt)) : 1);
    const [c, s] = this.relief ? [Math.cos(this.azimuth), Math.sin(this.azimuth)] : [1, 0];
    this.x += right * c + up * s;
    this.y += up * c - right * s;
  }

  zoom(factor, px = 0.5 * this.width, py = 0.5 * this.height) {
    this.update();
    const before = this.place(px, py);
    this.metres = Math.min(5000, Math.max(0.05, this.metres * factor));
    this.update();
    const after = this.place(px, py);
    if (Number.isFinite(after[0]) && Math.hypot(before[0] - after[0], before[1] - after[1]) < 50 * this.metres * this.width) {
      this.x += before[0] - after[0]; this.y += before[1] - after[1];
    }
  }

  turn(dx, dy) {
    this.azimuth += dx * 0.005;
    this.tilt = Math.min(1.5, Math.max(0.15, this.tilt + dy * 0.005));
  }
}
