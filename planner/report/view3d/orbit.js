// A canvas whose camera is turned, moved and zoomed by mouse, touch and keys: plain WebGL 2.
import { cross, lookAt, minus, perspective, plus, scaled, unit } from "./matrix.js";

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

// Who extends it sets `whole`, the two corners of what is to be seen, and has a method paint(). `depth`: how
// far behind it something can be seen, `least` the least zoom, where there is more than that.
export class Orbit {
  // near: the zoom at first; scrolls: the wheel moves the page unless the canvas has the focus.
  constructor(canvas, near = 1, scrolls = false) {
    Object.assign(this, { canvas, near, scrolls, whole: null, ...HOME, zoom: near, shift: [0, 0, 0] });
    this.gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true });
    if (!this.gl) return;
    this.program = link(this.gl);
    this.at = Object.fromEntries(["view", "lens", "colour", "lit"].map((n) => [n, this.gl.getUniformLocation(this.program, n)]));
    this.over = new AbortController(); // of what listens beyond the canvas
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour(), { signal: this.over.signal });
    this.listen();
  }

  // Gives back what it holds of the graphics card: browsers have few such canvases at once.
  end() {
    this.over?.abort();
    this.gl?.getExtension("WEBGL_lose_context")?.loseContext();
    this.gl = null;
  }

  get works() {
    return Boolean(this.gl);
  }

  // A colour of the style sheet, such as --ink.
  colour(name) {
    const probe = document.createElement("span");
    probe.hidden = true;
    probe.style.color = `var(${name})`;
    this.canvas.parentElement.append(probe);
    const [r, g, b] = getComputedStyle(probe).color.match(/[\d.]+/g).map(Number);
    probe.remove();
    return [r / 255, g / 255, b / 255];
  }

  // A body of vertices and triangles; without triangles, its vertices are ends of lines.
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

  fill(body, colour, alpha) {
    this.gl.uniform4f(this.at.colour, ...colour, alpha);
    this.gl.uniform1f(this.at.lit, 1);
    this.gl.bindVertexArray(body.array);
    this.gl.drawElements(this.gl.TRIANGLES, body.count, this.gl.UNSIGNED_INT, 0);
  }

  stroke(body, colour, alpha, first = 0, count = body.count) {
    this.gl.uniform4f(this.at.colour, ...colour, alpha);
    this.gl.uniform1f(this.at.lit, 0);
    this.gl.bindVertexArray(body.array);
    this.gl.drawArrays(this.gl.LINES, first, count);
  }

  draw() {
    if (!this.works || this.waiting) return;
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
    return { view: lookAt(eye, middle, [0, 0, 1]), lens: perspective(ANGLE, aspect, far * 0.02, far + (this.depth ?? size * 4)), far, way };
  }

  // Clears the canvas; whether there is room to draw in.
  cleared() {
    const { gl, canvas } = this;
    const scale = Math.min(devicePixelRatio || 1, 2);
    const size = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (!size[0] || !size[1]) return false;
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    gl.viewport(0, 0, ...size);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    return true;
  }

  // Sets the camera for what is drawn next, and gives it back.
  begin() {
    const { gl } = this;
    const camera = this.camera();
    gl.useProgram(this.program);
    gl.uniformMatrix4fv(this.at.view, false, camera.view);
    gl.uniformMatrix4fv(this.at.lens, false, camera.lens);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    return camera;
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
      if (this.scrolls && document.activeElement !== canvas) return;
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
    this.zoom = Math.min(Math.max(this.zoom * factor, this.least ?? 0.2), 40);
    this.draw();
  }

  pan(dx, dy) {
    if (!this.whole) return;
    const { far, way } = this.camera();
    const right = unit(cross([0, 0, 1], way));
    const up = cross(way, right);
    const step = (2 * far * Math.tan(ANGLE / 2)) / this.canvas.clientHeight;
    this.shift = plus(this.shift, plus(scaled(right, -dx * step), scaled(up, dy * step)));
    this.draw();
  }

  home() {
    Object.assign(this, { ...HOME, zoom: this.near, shift: [0, 0, 0] });
    this.draw();
  }
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
