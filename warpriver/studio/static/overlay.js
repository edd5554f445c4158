// What lies over the map: rings of brushes and controls, lines being drawn, locked points.

export class Overlay {
  constructor(holder, view) {
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("aria-hidden", "true");
    this.canvas.className = "overlay";
    holder.append(this.canvas);
    this.view = view;
    this.path = null; this.ring = null; this.hover = null; this.locks = []; this.controls = []; this.origin = [0, 0];
    this.shown = { locks: true, controls: true };
    this.blank = true;
  }

  resize(width, height) {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    this.ratio = ratio;
    this.blank = true;
  }

  draw() {
    const blank = !(this.ring || this.hover || this.path || (this.shown.controls && this.controls.length) || (this.shown.locks && this.locks.length));
    if (blank && this.blank) return;
    this.blank = blank;
    // Kept by the CPU: without a GPU, Chromium may show an earlier picture again after all of one was cleared.
    const g = this.canvas.getContext("2d", { willReadFrequently: true });
    g.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    g.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.shown.controls) for (const c of this.controls) this.control(g, c);
    if (this.shown.locks) for (const [x, y] of this.locks) this.lock(g, x, y);
    if (this.ring) this.circle(g, this.ring.x, this.ring.y, this.ring.radius, "#ffffff", "#222222");
    if (this.hover) this.circle(g, this.hover.x, this.hover.y, this.hover.radius, "#ffffff", "#222222");
    if (this.path) this.line(g, this.path.points, "#ffb020", 3, this.path.closed);
  }

  line(g, points, colour, width, closed = false, dash = []) {
    g.beginPath();
    let pen = false;
    for (const [x, y] of points) {
      const p = this.view.project(x, y);
      if (!p) { pen = false; continue; }
      if (pen) g.lineTo(...p); else g.moveTo(...p);
      pen = true;
    }
    if (closed) g.closePath();
    g.setLineDash(dash);
    g.lineJoin = "round";
    g.lineWidth = width + 2; g.strokeStyle = "rgba(0,0,0,.55)"; g.stroke();
    g.lineWidth = width; g.strokeStyle = colour; g.stroke();
    g.setLineDash([]);
  }

  circle(g, x, y, radius, colour) {
    const ring = [];
    for (let k = 0; k <= 48; k++) ring.push([x + radius * Math.cos(k * Math.PI / 24), y + radius * Math.sin(k * Math.PI / 24)]);
    this.line(g, ring, colour, 1.5);
  }

  lock(g, x, y) {
    const p = this.view.project(x, y);
    if (!p) return;
    g.fillStyle = "#ffffff"; g.strokeStyle = "#1d2623"; g.lineWidth = 2;
    g.beginPath(); g.arc(p[0], p[1] - 3, 4, Math.PI, 0); g.stroke();
    g.beginPath(); g.rect(p[0] - 6, p[1] - 3, 12, 9); g.fill(); g.stroke();
  }

  control(g, c) {
    const colour = { Attractor: "#19a18f", Repeller: "#e06a2b", Guide: "#19a18f", DampingRegion: "#8d6cc4", ErodibilityField: "#8d6cc4" }[c.kind];
    const local = (p) => [p[0] - this.origin[0], p[1] - this.origin[1]];
    if (c.center) {
      const [x, y] = local(c.center);
      this.circle(g, x, y, c.radius, colour);
      const p = this.view.project(x, y);
      if (p) { g.fillStyle = colour; g.beginPath(); g.arc(p[0], p[1], 5, 0, 7); g.fill(); g.strokeStyle = "#fff"; g.lineWidth = 1.5; g.stroke(); }
    }
    if (c.xy) this.line(g, c.xy.map(local), colour, 2, false, [8, 5]);
    if (c.area) this.line(g, c.area.map(local), colour, 2, true, [8, 5]);
  }
}
