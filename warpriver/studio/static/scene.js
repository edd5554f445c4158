// What is drawn: the ground, and ribbons of water whose points lie in a texture.

import * as THREE from "./vendor/three.module.js";

const ROW = 1024;
// Points of old courses that are kept: the latest ones; and kinds of channels that have a colour of their own.
const OLD_POINTS = 96 * 1024;
export const KINDS = 12;

/** Whether this machine draws without a graphics card: then edges stay rough, so that the page keeps up. */
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const told = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = told ? gl.getParameter(told.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software/i.test(name);
}

const GROUND_VERTEX = `
precision highp float;
uniform sampler2D height; uniform vec4 box; uniform float lift; uniform bool has;
out vec2 place;
void main() {
  place = uv;
  vec2 xy = mix(box.xy, box.zw, uv);
  float z = has ? texture(height, vec2(uv.x, 1.0 - uv.y)).r : 0.0;
  gl_Position = projectionMatrix * viewMatrix * vec4(xy, (z == z ? z : 0.0) * lift, 1.0);
}`;

const GROUND_FRAGMENT = `
precision highp float;
uniform sampler2D height, shade, control, cells, ramp; uniform vec4 box, field, place4; uniform vec2 range; uniform float step, most;
uniform bool has, contours, shaded, painted, dark, mapped;
in vec2 place; out vec4 colour;
vec3 hypsometric(float t) {
  vec3 a = vec3(.53, .62, .45), b = vec3(.72, .71, .52), c = vec3(.63, .55, .45), d = vec3(.93, .93, .92);
  return t < .35 ? mix(a, b, t / .35) : t < .7 ? mix(b, c, (t - .35) / .35) : mix(c, d, (t - .7) / .3);
}
// The map that lies on the ground: 255 is no data.
vec3 covered(vec3 c) {
  if (!mapped) return c;
  vec2 at = (mix(box.xy, box.zw, place) - place4.xy) / (place4.zw - place4.xy);
  if (any(lessThan(at, vec2(0))) || any(greaterThan(at, vec2(1)))) return c;
  float v = texture(cells, vec2(at.x, 1.0 - at.y)).r * 255.0;
  if (v > 254.5) return c;
  vec4 tone = texture(ramp, vec2((v + .5) / 255.0, .5));
  return mix(c, tone.rgb, tone.a);
}
void main() {
  vec2 uv = vec2(place.x, 1.0 - place.y);
  vec3 c = vec3(.81, .83, .77);
  if (has) {
    float z = texture(height, uv).r;
    if (z != z) { colour = vec4(.6, .6, .6, 1.0); return; }
    c = hypsometric(clamp((z - range.x) / max(range.y - range.x, 1e-6), 0.0, 1.0));
    c = covered(c);
    if (shaded) c *= .45 + .75 * texture(shade, uv).r;
    if (contours) {
      float at = z / step, near = abs(fract(at - .5) - .5) / max(fwidth(at), 1e-6);
      c = mix(c * .72, c, clamp(near, 0.0, 1.0));
    }
  } else c = covered(c);
  if (painted) {
    vec2 xy = mix(box.xy, box.zw, place), at = (xy - field.xy) / (field.zw - field.xy);
    if (all(greaterThan(at, vec2(0))) && all(lessThan(at, vec2(1)))) {
      float v = texture(control, vec2(at.x, 1.0 - at.y)).r / max(most, 1e-6);
      c = mix(c, v > 0.0 ? vec3(.10, .52, .47) : vec3(.80, .35, .10), .65 * smoothstep(0.0, 1.0, abs(v)));
    }
  }
  colour = vec4(dark ? c * .66 : c, 1.0);
}`;

const RIBBON_VERTEX = `
precision highp float; precision highp sampler2D;
uniform sampler2D points, height; uniform vec4 box; uniform float lift, rise, pixel, now; uniform int chosen; uniform bool has, aged;
out float side; flat out int own, kind; flat out float old;
vec4 at(int i) { return texelFetch(points, ivec2(i % ${ROW}, i / ${ROW}), 0); }
void main() {
  int segment = gl_VertexID / 6, corner = gl_VertexID % 6;
  vec4 a = at(segment), b = at(segment + 1);
  bool end = corner == 1 || corner == 2 || corner == 4;
  side = corner == 0 || corner == 1 || corner == 3 ? 1.0 : -1.0;
  own = aged ? -2 : int(a.w) & 65535;
  kind = aged ? 0 : int(a.w) >> 16;
  // Old courses fill up: to 1/e in 100 years.
  old = aged ? 1.0 - exp(-max(0.0, now - a.w) / 100.0) : 0.0;
  if (a.z < 0.0 || (aged && a.w > now + .01)) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  vec4 p = end ? b : a;
  vec2 along = b.xy - a.xy;
  if (end) { if (b.z >= 0.0) along = normalize(along) + normalize(at(segment + 2).xy - b.xy); }
  else if (segment > 0) { vec4 c = at(segment - 1); if (c.z >= 0.0) along = normalize(along) + normalize(a.xy - c.xy); }
  vec2 normal = length(along) > 0.0 ? normalize(vec2(along.y, -along.x)) : vec2(0);
  float reach = max(abs(p.z) * (1.0 - .5 * old), pixel * (1.0 - .4 * old) * (own == chosen ? 1.6 : .9));
  vec2 xy = p.xy + side * reach * normal;
  vec2 uv = (p.xy - box.xy) / (box.zw - box.xy);
  float z = has ? texture(height, vec2(uv.x, 1.0 - uv.y)).r : 0.0;
  gl_Position = projectionMatrix * viewMatrix * vec4(xy, (z == z ? z : 0.0) * lift + rise, 1.0);
}`;

const RIBBON_FRAGMENT = `
precision highp float;
uniform vec3 tone, light, kinds[${KINDS}]; uniform int chosen; uniform float opacity; uniform bool aged;
in float side; flat in int own, kind; flat in float old; out vec4 colour;
void main() {
  float edge = smoothstep(.55, 1.0, abs(side));
  vec3 c = kind > 0 ? kinds[kind - 1] : tone;
  if (aged) c = mix(c, light, old);
  colour = vec4(own == chosen ? light : mix(c, c * .7, edge), opacity * (1.0 - .6 * old));
}`;

// The ground as it was drawn last, seen from above.
const BAKED_VERTEX = `
void main() { gl_Position = vec4(position.xy, 1.0, 1.0); }`;
const BAKED_FRAGMENT = `
precision highp float;
uniform sampler2D baked; out vec4 colour;
void main() { colour = texelFetch(baked, ivec2(gl_FragCoord.xy), 0); }`;

function material(vertex, fragment, uniforms, extra = {}) {
  return new THREE.ShaderMaterial({
    glslVersion: THREE.GLSL3, vertexShader: vertex, fragmentShader: fragment, side: THREE.DoubleSide, uniforms, ...extra,
  });
}

/** Lines of some width, whose points lie in a texture: x, y, half the width (below 0 at the last one), channel. */
export class Ribbon {
  constructor(shared, tone, light, rise, { opacity = 1, aged = false } = {}) {
    this.capacity = 0; this.count = 0; this.aged = aged;
    this.uniforms = {
      aged: { value: aged }, kinds: { value: Array.from({ length: KINDS }, () => new THREE.Color(...tone)) },
      ...shared, points: { value: null }, rise: { value: rise }, chosen: { value: -1 },
      tone: { value: new THREE.Color(...tone) }, light: { value: new THREE.Color(...light) }, opacity: { value: opacity },
    };
    const geometry = new THREE.BufferGeometry();
    geometry.setDrawRange(0, 0);
    this.mesh = new THREE.Mesh(geometry, material(RIBBON_VERTEX, RIBBON_FRAGMENT, this.uniforms, { transparent: opacity < 1 || aged, depthTest: true }));
    this.mesh.frustumCulled = false;
  }

  reserve(points) {
    if (points + 2 <= this.capacity) return;
    const rows = Math.max(1, 2 ** Math.ceil(Math.log2((points + 2) / ROW)));
    const data = new Float32Array(4 * ROW * rows);
    if (this.data) data.set(this.data.subarray(0, 4 * this.count));
    this.uniforms.points.value?.dispose();
    this.data = data; this.capacity = ROW * rows;
    const texture = new THREE.DataTexture(data, ROW, rows, THREE.RGBAFormat, THREE.FloatType);
    texture.minFilter = texture.magFilter = THREE.NearestFilter;
    this.uniforms.points.value = texture;
  }

  clear() { this.count = 0; this.finish(); }

  /** Add lines: their starts, points and half widths, and what the last number of each point is. */
  add(start, xy, half, mark = (c) => c) {
    const points = start[start.length - 1];
    if (this.aged && this.count + points > OLD_POINTS) this.forget(OLD_POINTS / 2);
    this.reserve(this.count + points);
    const data = this.data;
    for (let c = 0; c + 1 < start.length; c++) {
      const stop = start[c + 1], own = mark(c);
      for (let i = start[c]; i < stop; i++) {
        const k = 4 * (this.count + i);
        data[k] = xy[2 * i]; data[k + 1] = xy[2 * i + 1];
        const h = half(c, i);
        data[k + 2] = i + 1 < stop ? h : -h; data[k + 3] = own;
      }
    }
    this.count += points;
    this.finish();
  }

  /** Remove the first points, at least so many, and whole lines only. */
  forget(count) {
    let cut = Math.min(count, this.count);
    while (cut < this.count && this.data[4 * cut - 2] >= 0) cut++;
    this.data?.copyWithin(0, 4 * cut, 4 * this.count);
    this.count -= cut;
  }

  finish() {
    this.mesh.geometry.setDrawRange(0, 6 * Math.max(0, this.count - 1));
    if (this.uniforms.points.value) this.uniforms.points.value.needsUpdate = true;
    this.mesh.visible = this.count > 1;
  }
}

export class MapScene {
  constructor(canvas, ground, view) {
    this.ground = ground; this.view = view;
    this.software = isSoftware();
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !this.software, preserveDrawingBuffer: true });
    this.scene = new THREE.Scene();
    this.empty = new THREE.DataTexture(new Float32Array(1), 1, 1, THREE.RedFormat, THREE.FloatType);
    this.empty.needsUpdate = true;
    this.shared = {
      height: { value: this.empty }, box: { value: new THREE.Vector4(-1, -1, 1, 1) }, lift: { value: 0 },
      pixel: { value: 1 }, has: { value: false }, now: { value: 0 },
    };
    this.uniforms = {
      ...this.shared, shade: { value: this.empty }, control: { value: this.empty }, field: { value: new THREE.Vector4() },
      range: { value: new THREE.Vector2(0, 1) }, step: { value: 50 }, most: { value: 1 }, contours: { value: true },
      shaded: { value: true }, painted: { value: false }, dark: { value: false },
      mapped: { value: false }, cells: { value: this.empty }, ramp: { value: this.empty }, place4: { value: new THREE.Vector4() },
    };
    const cells = this.software ? 160 : 256, plane = new THREE.PlaneGeometry(2, 2, cells, cells);
    this.terrain = new THREE.Mesh(plane, material(GROUND_VERTEX, GROUND_FRAGMENT, this.uniforms));
    this.terrain.frustumCulled = false;
    this.old = new Ribbon(this.shared, [.55, .53, .42], [.50, .50, .36], 0.6, { opacity: .8, aged: true });
    this.oxbows = new Ribbon(this.shared, [.30, .52, .58], [.42, .50, .36], 1.0, { aged: true });
    this.rivers = new Ribbon(this.shared, [.09, .40, .70], [.98, .72, .15], 1.6);
    // From above the ground is drawn once, and its picture is laid under the rivers until it changes.
    this.baked = new THREE.WebGLRenderTarget(1, 1, { depthBuffer: false, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter });
    this.under = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material(BAKED_VERTEX, BAKED_FRAGMENT, { baked: { value: this.baked.texture } }, { depthTest: false, depthWrite: false }));
    this.under.frustumCulled = false;
    this.under.renderOrder = -1;
    this.ground3 = new THREE.Scene();
    this.ground3.add(this.terrain);
    this.scene.add(this.under, this.old.mesh, this.oxbows.mesh, this.rivers.mesh);
    this.box = [-1, -1, 1, 1];
    this.fence = null; this.began = 0; this.rest = 0;
    this.stale = true;
    // Called when there is something to draw; whether it is by hand, and should be seen at once.
    this.changed = null; this.urgent = false;
    this.dirty = true;
    this.frames = 0;
  }

  get dirty() { return this.isDirty; }
  set dirty(on) { this.isDirty = on; if (on) { this.stale = true; this.changed?.(); } }

  /** Whether all that there is has been drawn. */
  get settled() { this.wait(); return !this.isDirty && !this.fence; }

  /** Draw the rivers anew, over the ground as it was. */
  flow() { this.isDirty = true; this.changed?.(); }

  /**
   * Milliseconds until another picture can be drawn. The last one has to be done, since the thread that would wait for
   * it is the one on which states and answers come in. Without a graphics card the picture is made by the processor
   * that runs the simulation, too; so for some time after one, only what is done by hand is drawn.
   */
  wait() {
    const gl = this.renderer.getContext(), now = performance.now();
    if (this.fence) {
      const done = gl.getSyncParameter(this.fence, gl.SYNC_STATUS) === gl.SIGNALED || gl.isContextLost();
      if (!done && now - this.began < 2000) return 4;
      gl.deleteSync(this.fence);
      this.fence = null;
      this.rest = this.software ? now + Math.min(400, 3 * (now - this.began)) : 0;
    }
    return this.urgent ? 0 : Math.max(0, this.rest - now);
  }

  /** Colour around the map, that of the page. */
  setBack(dark) {
    this.uniforms.dark.value = dark;
    this.renderer.setClearColor(dark ? 0x27302b : 0xcfd4c6, 1);
    this.dirty = true;
  }

  setBox(west, south, east, north) {
    this.box = [west, south, east, north];
    this.shared.box.value.set(west, south, east, north);
  }

  setHeights() {
    const g = this.ground.height;
    this.shared.has.value = Boolean(g);
    this.shared.height.value = g ? g.texture : this.empty;
    this.uniforms.shade.value = this.ground.shade ?? this.empty;
    if (g) {
      const [low, high] = g.range();
      this.uniforms.range.value.set(low, high);
      const tenth = Math.max(1e-3, (high - low) / 14), power = 10 ** Math.floor(Math.log10(tenth));
      this.uniforms.step.value = power * [1, 2, 5, 10].find((k) => k * power >= tenth);
    }
    this.dirty = true;
  }

  setField(on) {
    const f = this.ground.control;
    this.uniforms.painted.value = Boolean(f) && on;
    this.uniforms.control.value = f ? f.texture : this.empty;
    if (f) {
      const [low, high] = f.range();
      this.uniforms.most.value = Math.max(Math.abs(low), Math.abs(high), 1e-6);
      this.uniforms.field.value.set(f.west, f.north - f.rows * f.cell, f.west + f.columns * f.cell, f.north);
    }
    this.dirty = true;
  }

  /** Lay a map on the ground, or none; its colours are 256 steps of RGBA. */
  setMap(map, colours) {
    for (const name of ["cells", "ramp"]) if (this.uniforms[name].value !== this.empty) this.uniforms[name].value.dispose();
    this.uniforms.mapped.value = Boolean(map);
    this.uniforms.cells.value = this.uniforms.ramp.value = this.empty;
    if (map) {
      const cells = new THREE.DataTexture(map.values, map.columns, map.rows, THREE.RedFormat, THREE.UnsignedByteType);
      cells.unpackAlignment = 1;
      const ramp = new THREE.DataTexture(colours, 256, 1);
      for (const texture of [cells, ramp]) { texture.minFilter = texture.magFilter = THREE.NearestFilter; texture.needsUpdate = true; }
      Object.assign(this.uniforms.cells, { value: cells }); Object.assign(this.uniforms.ramp, { value: ramp });
      this.uniforms.place4.value.set(map.west, map.north - map.rows * map.cell, map.west + map.columns * map.cell, map.north);
    }
    this.dirty = true;
  }

  /** Draw the channels of a state; kind says which have a colour of their own, from 1 on. */
  setState(state, kind) {
    this.rivers.count = 0;
    this.rivers.add(state.start, state.xy, (c, i) => 0.5 * state.width(c, i), kind ? (c) => (c & 65535) + 65536 * kind(c) : undefined);
    this.shared.now.value = state.time;
    this.flow();
  }

  resize(width, height) {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.baked.setSize(Math.floor(width * ratio), Math.floor(height * ratio));
    this.dirty = true;
  }

  draw() {
    if (!this.dirty) return false;
    this.isDirty = this.urgent = false;
    this.began = performance.now();
    this.view.update();
    this.shared.lift.value = this.view.relief ? this.ground.exaggeration : 0;
    this.shared.pixel.value = this.view.metres;
    const thick = this.view.relief ? 0.0015 * this.view.metres * this.view.height : 0;
    this.rivers.uniforms.rise.value = 3 + 3 * thick;
    this.oxbows.uniforms.rise.value = 2 + 2 * thick;
    this.old.uniforms.rise.value = 1 + thick;
    const flat = !this.view.relief;
    this.under.visible = flat;
    if (flat) {
      if (this.stale) {
        this.ground3.add(this.terrain);
        this.renderer.setRenderTarget(this.baked);
        this.renderer.render(this.ground3, this.view.camera);
        this.renderer.setRenderTarget(null);
        this.stale = false;
      }
    } else this.scene.add(this.terrain);
    this.renderer.render(this.scene, this.view.camera);
    const gl = this.renderer.getContext();
    if (this.fence) gl.deleteSync(this.fence);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.frames++;
    return true;
  }
}
