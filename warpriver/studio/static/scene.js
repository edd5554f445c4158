// What is drawn: the ground, and ribbons of water whose points lie in a texture.

import * as THREE from "./vendor/three.module.js";

const ROW = 1024;

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
uniform sampler2D height, shade, control; uniform vec4 box, field; uniform vec2 range; uniform float step, most;
uniform bool has, contours, shaded, painted, dark;
in vec2 place; out vec4 colour;
vec3 ramp(float t) {
  vec3 a = vec3(.53, .62, .45), b = vec3(.72, .71, .52), c = vec3(.63, .55, .45), d = vec3(.93, .93, .92);
  return t < .35 ? mix(a, b, t / .35) : t < .7 ? mix(b, c, (t - .35) / .35) : mix(c, d, (t - .7) / .3);
}
void main() {
  vec2 uv = vec2(place.x, 1.0 - place.y);
  vec3 c = vec3(.81, .83, .77);
  if (has) {
    float z = texture(height, uv).r;
    if (z != z) { colour = vec4(.6, .6, .6, 1.0); return; }
    c = ramp(clamp((z - range.x) / max(range.y - range.x, 1e-6), 0.0, 1.0));
    if (shaded) c *= .45 + .75 * texture(shade, uv).r;
    if (contours) {
      float at = z / step, near = abs(fract(at - .5) - .5) / max(fwidth(at), 1e-6);
      c = mix(c * .72, c, clamp(near, 0.0, 1.0));
    }
  }
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
uniform sampler2D points, height; uniform vec4 box; uniform float lift, rise, pixel; uniform int chosen; uniform bool has;
out float side; flat out int own;
vec4 at(int i) { return texelFetch(points, ivec2(i % ${ROW}, i / ${ROW}), 0); }
void main() {
  int segment = gl_VertexID / 6, corner = gl_VertexID % 6;
  vec4 a = at(segment), b = at(segment + 1);
  bool end = corner == 1 || corner == 2 || corner == 4;
  side = corner == 0 || corner == 1 || corner == 3 ? 1.0 : -1.0;
  own = int(a.w);
  if (a.z < 0.0) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  vec4 p = end ? b : a;
  vec2 along = b.xy - a.xy;
  if (end) { if (b.z >= 0.0) along = normalize(along) + normalize(at(segment + 2).xy - b.xy); }
  else if (segment > 0) { vec4 c = at(segment - 1); if (c.z >= 0.0) along = normalize(along) + normalize(a.xy - c.xy); }
  vec2 normal = length(along) > 0.0 ? normalize(vec2(along.y, -along.x)) : vec2(0);
  float reach = max(abs(p.z), pixel * (own == chosen ? 1.6 : .9));
  vec2 xy = p.xy + side * reach * normal;
  vec2 uv = (p.xy - box.xy) / (box.zw - box.xy);
  float z = has ? texture(height, vec2(uv.x, 1.0 - uv.y)).r : 0.0;
  gl_Position = projectionMatrix * viewMatrix * vec4(xy, (z == z ? z : 0.0) * lift + rise, 1.0);
}`;

const RIBBON_FRAGMENT = `
precision highp float;
uniform vec3 tone, light; uniform int chosen; uniform float opacity;
in float side; flat in int own; out vec4 colour;
void main() {
  float edge = smoothstep(.55, 1.0, abs(side));
  colour = vec4(own == chosen ? light : mix(tone, tone * .7, edge), opacity);
}`;

function material(vertex, fragment, uniforms, extra = {}) {
  return new THREE.ShaderMaterial({
    glslVersion: THREE.GLSL3, vertexShader: vertex, fragmentShader: fragment, side: THREE.DoubleSide, uniforms, ...extra,
  });
}

/** Lines of some width, whose points lie in a texture: x, y, half the width (below 0 at the last one), channel. */
export class Ribbon {
  constructor(shared, tone, light, rise, opacity = 1) {
    this.capacity = 0; this.count = 0;
    this.uniforms = {
      ...shared, points: { value: null }, rise: { value: rise }, chosen: { value: -1 },
      tone: { value: new THREE.Color(...tone) }, light: { value: new THREE.Color(...light) }, opacity: { value: opacity },
    };
    const geometry = new THREE.BufferGeometry();
    geometry.setDrawRange(0, 0);
    this.mesh = new THREE.Mesh(geometry, material(RIBBON_VERTEX, RIBBON_FRAGMENT, this.uniforms, { transparent: opacity < 1, depthTest: true }));
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

  /** Add lines: their starts, points and half widths. */
  add(start, xy, half, first = 0) {
    const points = start[start.length - 1];
    this.reserve(this.count + points);
    const data = this.data;
    for (let c = 0; c + 1 < start.length; c++) {
      const stop = start[c + 1];
      for (let i = start[c]; i < stop; i++) {
        const k = 4 * (this.count + i);
        data[k] = xy[2 * i]; data[k + 1] = xy[2 * i + 1];
        data[k + 2] = i + 1 < stop ? half(c) : -half(c); data[k + 3] = first + c;
      }
    }
    this.count += points;
    this.finish();
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
      pixel: { value: 1 }, has: { value: false },
    };
    this.uniforms = {
      ...this.shared, shade: { value: this.empty }, control: { value: this.empty }, field: { value: new THREE.Vector4() },
      range: { value: new THREE.Vector2(0, 1) }, step: { value: 50 }, most: { value: 1 }, contours: { value: true },
      shaded: { value: true }, painted: { value: false }, dark: { value: false },
    };
    const cells = this.software ? 160 : 256, plane = new THREE.PlaneGeometry(2, 2, cells, cells);
    this.terrain = new THREE.Mesh(plane, material(GROUND_VERTEX, GROUND_FRAGMENT, this.uniforms));
    this.terrain.frustumCulled = false;
    this.old = new Ribbon(this.shared, [.55, .53, .42], [.55, .53, .42], 0.6, .8);
    this.oxbows = new Ribbon(this.shared, [.36, .55, .58], [.36, .55, .58], 1.0);
    this.rivers = new Ribbon(this.shared, [.09, .40, .70], [.98, .72, .15], 1.6);
    this.scene.add(this.terrain, this.old.mesh, this.oxbows.mesh, this.rivers.mesh);
    this.box = [-1, -1, 1, 1];
    this.dirty = true;
    this.frames = 0;
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

  setState(state) {
    const half = (c) => 0.5 * state.size[4 * c];
    this.rivers.count = 0;
    this.rivers.add(state.start, state.xy, half);
    this.dirty = true;
  }

  resize(width, height) {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.dirty = true;
  }

  draw() {
    if (!this.dirty) return false;
    this.dirty = false;
    this.view.update();
    this.shared.lift.value = this.view.relief ? this.ground.exaggeration : 0;
    this.shared.pixel.value = this.view.metres;
    const thick = this.view.relief ? 0.0015 * this.view.metres * this.view.height : 0;
    this.rivers.uniforms.rise.value = 3 + 3 * thick;
    this.oxbows.uniforms.rise.value = 2 + 2 * thick;
    this.old.uniforms.rise.value = 1 + thick;
    this.renderer.render(this.scene, this.view.camera);
    this.frames++;
    return true;
  }
}
