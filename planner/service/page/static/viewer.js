// The part in 3D with its size: shaded triangles, the block around it, measures along three edges.
import { h } from "./dom.js";
import { minus, plus, project, scaled, times } from "./matrix.js";
import { boxOf } from "./mesh.js";
import { Orbit } from "./orbit.js";
import { number } from "./words.js";

export class Viewer extends Orbit {
  constructor(canvas, labels) {
    super(canvas);
    Object.assign(this, { bodies: [], box: null });
    if (!this.works) return;
    this.marks = [0, 1, 2].map(() => h("span", { class: "measure" }));
    labels.append(...this.marks);
    addEventListener("themechange", () => this.recolour());
    this.recolour();
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
    if (keep) this.draw();
    else this.home();
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
    const [part, stock, line, grid, measure] = ["--view-part", "--view-stock", "--soft", "--view-grid", "--accent"].map((name) => this.colour(name));
    this.colours = { part, stock, line, grid, measure };
    this.draw();
  }

  paint() {
    const { gl } = this;
    if (!this.cleared()) return;
    for (const mark of this.marks) mark.hidden = true;
    if (!this.whole || !this.lines) return;
    const { view, lens } = this.begin();
    this.line("grid", this.colours.grid, 0.9);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    for (const body of this.bodies) if (body.kind !== "stock") this.fill(body, body.kind === "path" ? this.colours.measure : this.colours.part, 1);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    this.line("part", this.colours.measure, 0.9);
    gl.depthMask(false);
    for (const body of this.bodies) if (body.kind === "stock") this.fill(body, this.colours.stock, this.bodies.length > 1 ? 0.16 : 0.4);
    gl.depthMask(true);
    this.line("edges", this.colours.line, 0.6);
    this.measure(times(lens, view));
  }

  line(name, colour, alpha) {
    this.stroke(this.lines, colour, alpha, ...this.ranges[name]);
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
}

const corner = ([low, high], bits) => [0, 1, 2].map((axis) => (bits & (1 << axis) ? high[axis] : low[axis]));

function joined(boxes) {
  if (!boxes.length) return null;
  return [[0, 1, 2].map((i) => Math.min(...boxes.map((b) => b[0][i]))), [0, 1, 2].map((i) => Math.max(...boxes.map((b) => b[1][i])))];
}
