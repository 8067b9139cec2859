// The part in 3D with its size: shaded triangles, the block around it, measures along three edges. Plain WebGL 2.
import { h } from "./dom.js";
import { cross, lookAt, minus, perspective, plus, project, scaled, times, unit } from "./matrix.js";
import { boxOf } from "./mesh.js";
import { number } from "./words.js";

const VERTEX = `#version 300 es
in vec3 place; uniform mat4 view; uniform mat4 lens; out vec3 seen;
void main() { vec4 p = view * vec4(place, 1.0); seen = p.xyz; gl_Position = lens * p; }`;
const FRAGMENT = `#version 300 es
precision highp float; in vec3 seen; uniform vec4 colour; uniform float lit; out vec4 shown;
void main() {
  vec3 n = normalize(cross(dFdx(seen), dFdy(seen)));
  float key = abs(dot(n, normalize(vec3(0.35, 0.55, 0.75)))), rim = abs(n.z);
  float light = mix(1.0, 0.42 + 0.42 * key + 0.2 * rim, lit);
  shown = vec4(colour.rgb * light * colour.a, colour.a);
}`;
const ANGLE = 0.5;
const HOME = { turn: -0.9, lift: 0.5 };

export class Viewer {
  constructor(canvas, labels) {
    Object.assign(this, { canvas, labels, bodies: [], box: null, ...HOME, zoom: 1, shift: [0, 0, 0] });
    this.gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true });
    if (!this.gl) return;
    this.program = link(this.gl);
    this.at = Object.fromEntries(["view", "lens", "colour", "lit"].map((n) => [n, this.gl.getUniformLocation(this.program, n)]));
    this.marks = [0, 1, 2].map(() => h("span", { class: "measure" }));
    labels.append(...this.marks);
    new ResizeObserver(() => this.draw()).observe(canvas);
    addEventListener("themechange", () => this.recolour());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    this.listen();
    this.recolour();
  }

  get works() {
    return Boolean(this.gl);
  }

  // Shows bodies {kind, vertices, faces} in mm; keep: leave the camera as it is.
  show(bodies, keep = false) {
    if (!this.works) return;
    for (const body of this.bodies) this.drop(body);
    this.bodies = bodies.map((body) => this.load(body));
    const wanted = bodies.filter((body) => body.kind === "part");
    this.box = joined((wanted.length ? wanted : bodies.filter((body) => body.kind === "stock")).map((body) => boxOf(body.vertices)));
    this.whole = joined(bodies.map((body) => boxOf(body.vertices)));
    this.stock = joined(bodies.filter((body) => body.kind === "stock").map((body) => boxOf(body.vertices))) ?? this.whole;
    if (this.lines) this.drop(this.lines);
    this.lines = this.whole ? this.load({ kind: "lines", vertices: this.outline(), faces: [] }) : null;
    if (!keep) Object.assign(this, { ...HOME, zoom: 1, shift: [0, 0, 0] });
    this.draw();
  }

  load(body) {
    const gl = this.gl;
    const made = { kind: body.kind, array: gl.createVertexArray(), points: gl.createBuffer(), count: body.faces.length };
    gl.bindVertexArray(made.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, made.points);
    gl.bufferData(gl.ARRAY_BUFFER, Float32Array.from(body.vertices), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    if (made.count) {
      made.faces = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, made.faces);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint32Array.from(body.faces), gl.STATIC_DRAW);
    } else made.count = body.vertices.length / 3;
    gl.bindVertexArray(null);
    return made;
  }

  drop(body) {
    for (const buffer of [body.points, body.faces]) if (buffer) this.gl.deleteBuffer(buffer);
    this.gl.deleteVertexArray(body.array);
  }

  // Lines: a floor grid, then the edges of the stock, then the three edges that measures stand at.
  outline() {
    const [low, high] = this.whole;
    const span = Math.max(high[0] - low[0], high[1] - low[1], 1e-6);
    const step = 10 ** Math.floor(Math.log10(span)) * (span / 10 ** Math.floor(Math.log10(span)) > 4 ? 1 : 0.5) / 2;
    const from = [0, 1].map((i) => Math.floor((low[i] - span * 0.25) / step) * step);
    const to = [0, 1].map((i) => Math.ceil((high[i] + span * 0.25) / step) * step);
    const floor = low[2] - Math.hypot(...minus(high, low)) * 0.015;
    const grid = [];
    for (let x = from[0]; x <= to[0] + step / 2; x += step) grid.push(x, from[1], floor, x, to[1], floor);
    for (let y = from[1]; y <= to[1] + step / 2; y += step) grid.push(from[0], y, floor, to[0], y, floor);
    this.ranges = { grid: [0, grid.length / 3] };
    const edges = [];
    for (let a = 0; a < 8; a++) for (let axis = 0; axis < 3; axis++) if (!(a & (1 << axis))) edges.push(...corner(this.stock, a), ...corner(this.stock, a | (1 << axis)));
    this.ranges.edges = [grid.length / 3, edges.length / 3];
    const [plow, phigh] = this.box;
    const part = [[[plow[0], plow[1], plow[2]], [phigh[0], plow[1], plow[2]]], [[phigh[0], plow[1], plow[2]], [phigh[0], phigh[1], plow[2]]], [[phigh[0], phigh[1], plow[2]], [...phigh]]];
    this.measured = part;
    this.ranges.part = [(grid.length + edges.length) / 3, 6];
    return [...grid, ...edges, ...part.flat(2)];
  }

  recolour() {
    const probe = h("span", { hidden: true });
    this.canvas.parentElement.append(probe);
    const read = (name) => {
      probe.style.color = `var(${name})`;
      const [r, g, b] = getComputedStyle(probe).color.match(/[\d.]+/g).map(Number);
      return [r / 255, g / 255, b / 255];
    };
    this.colours = { part: read("--view-part"), stock: read("--view-stock"), line: read("--soft"), grid: read("--view-grid"), measure: read("--accent") };
    probe.remove();
    this.draw();
  }

  draw() {
    if (!this.works || !this.marks || this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.paint();
    });
  }

  camera() {
    const [low, high] = this.whole;
    const middle = plus(scaled(plus(low, high), 0.5), this.shift);
    const size = Math.max(Math.hypot(...minus(high, low)), 1e-6);
    const aspect = this.canvas.width / this.canvas.height;
    const far = (size * 0.5) / Math.sin(ANGLE / 2) / Math.min(1, aspect) / this.zoom;
    const way = [Math.cos(this.lift) * Math.cos(this.turn), Math.cos(this.lift) * Math.sin(this.turn), Math.sin(this.lift)];
    const eye = plus(middle, scaled(way, far));
    return { view: lookAt(eye, middle, [0, 0, 1]), lens: perspective(ANGLE, aspect, far * 0.02, far + size * 4), far, way };
  }

  paint() {
    const { gl, canvas } = this;
    const scale = Math.min(devicePixelRatio || 1, 2);
    const size = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (!size[0] || !size[1]) return;
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    gl.viewport(0, 0, ...size);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    for (const mark of this.marks) mark.hidden = true;
    if (!this.whole || !this.lines) return;
    const { view, lens } = this.camera();
    gl.useProgram(this.program);
    gl.uniformMatrix4fv(this.at.view, false, view);
    gl.uniformMatrix4fv(this.at.lens, false, lens);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.stroke("grid", this.colours.grid, 0.9);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    for (const body of this.bodies) if (body.kind !== "stock") this.fill(body, body.kind === "path" ? this.colours.measure : this.colours.part, 1);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    this.stroke("part", this.colours.measure, 0.9);
    gl.depthMask(false);
    for (const body of this.bodies) if (body.kind === "stock") this.fill(body, this.colours.stock, this.bodies.length > 1 ? 0.16 : 0.4);
    gl.depthMask(true);
    this.stroke("edges", this.colours.line, 0.6);
    this.measure(times(lens, view));
  }

  fill(body, colour, alpha) {
    this.gl.uniform4f(this.at.colour, ...colour, alpha);
    this.gl.uniform1f(this.at.lit, 1);
    this.gl.bindVertexArray(body.array);
    this.gl.drawElements(this.gl.TRIANGLES, body.count, this.gl.UNSIGNED_INT, 0);
  }

  stroke(name, colour, alpha) {
    const [first, count] = this.ranges[name];
    this.gl.uniform4f(this.at.colour, ...colour, alpha);
    this.gl.uniform1f(this.at.lit, 0);
    this.gl.bindVertexArray(this.lines.array);
    this.gl.drawArrays(this.gl.LINES, first, count);
  }

  // Lengths beside their edges.
  measure(matrix) {
    for (const [i, [from, to]] of this.measured.entries()) {
      const [x, y, , w] = project(matrix, scaled(plus(from, to), 0.5));
      const length = Math.hypot(...minus(to, from));
      const mark = this.marks[i];
      if (w <= 0 || Math.abs(x / w) > 1 || Math.abs(y / w) > 1) continue;
      mark.hidden = false;
      mark.textContent = `${number(length)} mm`;
      mark.style.left = `${(50 * (x / w + 1)).toFixed(2)}%`;
      mark.style.top = `${(50 * (1 - y / w)).toFixed(2)}%`;
    }
  }

  listen() {
    const { canvas } = this;
    const held = new Map();
    canvas.addEventListener("pointerdown", (e) => {
      held.set(e.pointerId, [e.clientX, e.clientY]);
      canvas.setPointerCapture(e.pointerId);
    });
    const release = (e) => held.delete(e.pointerId);
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("pointermove", (e) => {
      const before = held.get(e.pointerId);
      if (!before) return;
      const [dx, dy] = [e.clientX - before[0], e.clientY - before[1]];
      if (held.size === 2) {
        const other = [...held].find(([id]) => id !== e.pointerId)[1];
        const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
        this.nearer(apart([e.clientX, e.clientY]) / Math.max(apart(before), 1));
        this.pan(dx / 2, dy / 2);
      } else if (e.shiftKey || e.buttons & 6) this.pan(dx, dy);
      else this.rotate(-dx * 0.008, dy * 0.008);
      held.set(e.pointerId, [e.clientX, e.clientY]);
    });
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.nearer(Math.exp(-e.deltaY * 0.0012));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.home());
    canvas.addEventListener("keydown", (e) => {
      const does = { ArrowLeft: () => this.rotate(0.12, 0), ArrowRight: () => this.rotate(-0.12, 0), ArrowUp: () => this.rotate(0, -0.12), ArrowDown: () => this.rotate(0, 0.12), "+": () => this.nearer(1.15), "=": () => this.nearer(1.15), "-": () => this.nearer(1 / 1.15), 0: () => this.home(), Home: () => this.home() }[e.key];
      if (!does || e.ctrlKey || e.metaKey || e.altKey) return;
      e.preventDefault();
      does();
    });
  }

  rotate(turn, lift) {
    this.turn += turn;
    this.lift = Math.min(Math.max(this.lift + lift, -1.5), 1.5);
    this.draw();
  }

  nearer(factor) {
    this.zoom = Math.min(Math.max(this.zoom * factor, 0.2), 40);
    this.draw();
  }

  pan(dx, dy) {
    if (!this.lines) return;
    const { far, way } = this.camera();
    const right = unit(cross([0, 0, 1], way));
    const up = cross(way, right);
    const step = (2 * far * Math.tan(ANGLE / 2)) / this.canvas.clientHeight;
    this.shift = plus(this.shift, plus(scaled(right, -dx * step), scaled(up, dy * step)));
    this.draw();
  }

  home() {
    Object.assign(this, { ...HOME, zoom: 1, shift: [0, 0, 0] });
    this.draw();
  }
}

const corner = ([low, high], bits) => [0, 1, 2].map((axis) => (bits & (1 << axis) ? high[axis] : low[axis]));

function joined(boxes) {
  if (!boxes.length) return null;
  return [[0, 1, 2].map((i) => Math.min(...boxes.map((b) => b[0][i]))), [0, 1, 2].map((i) => Math.max(...boxes.map((b) => b[1][i])))];
}

function link(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "place");
  gl.linkProgram(program);
  return program;
}
