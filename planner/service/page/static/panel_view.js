// The panels of an element in 3D with their ids, each in the colour of what became of it.
import { h } from "./dom.js";
import { cross, dot, minus, plus, project, scaled, times, unit } from "./matrix.js";
import { Orbit } from "./orbit.js";
import { madePanel, uprightAxes } from "./panels.js";

export const COLOURS = { not_planned: "--view-part", open: "--warn", verified: "--ok", refused: "--bad", cut: "--accent", glued: "--view-stock", broken: "--bad" };
const ROOM = [24, 11]; // px: panels that are smaller on the screen show no id
const FILLED = 0.9; // share of the canvas that the whole takes at first
const TAP = 6; // px: a pointer that went farther turns the view

export class PanelView extends Orbit {
  // choose(id): called with the panel that was tapped, or with "" beside all.
  constructor(canvas, labels, choose) {
    super(canvas);
    Object.assign(this, { labels, panels: [], kinds: new Map(), chosen: "", marks: [], bodies: [], lines: null, built: "" });
    if (!this.works) return;
    let from = null;
    canvas.addEventListener("pointerdown", (e) => (from = [e.clientX, e.clientY]));
    canvas.addEventListener("pointerup", (e) => {
      if (from && Math.hypot(e.clientX - from[0], e.clientY - from[1]) < TAP) choose(this.found(e.offsetX, e.offsetY));
      from = null;
    });
    addEventListener("themechange", () => this.recolour());
    this.recolour();
  }

  // Shows the panels of element.json; keep: leave the camera as it is.
  show(data, keep) {
    if (!this.works) return;
    const axes = uprightAxes(data.up);
    this.panels = data.panels.filter((panel) => panel.solid).map(({ id, solid, way_in }) => {
      const made = madePanel({ id, front: solid.front_mm, back: solid.back_mm, faces: solid.faces, rim: solid.rim, way: way_in }, axes);
      const { vertices, faces } = made.solid;
      const corner = (k) => vertices.slice(3 * k, 3 * k + 3);
      const half = solid.faces.split(" ").length; // triangles of the front come first
      let out = [0, 0, 0];
      let middle = [0, 0, 0];
      for (let i = 0; i < half; i += 3) {
        const [a, b, c] = [0, 1, 2].map((k) => corner(faces[i + k]));
        out = plus(out, cross(minus(b, a), minus(c, a)));
        middle = plus(middle, plus(a, plus(b, c)));
      }
      return { ...made, out: unit(out), face: scaled(middle, 1 / Math.max(half, 1)) };
    });
    if (this.lines) this.drop(this.lines);
    this.lines = this.load({ vertices: this.panels.flatMap((panel) => panel.edges.vertices), faces: [] });
    this.build();
    const ends = (pick, k, axis) => this.panels.reduce((worst, panel) => pick(worst, panel[k][axis]), this.panels[0][k][axis]);
    this.whole = this.panels.length ? [[0, 1, 2].map((k) => ends(Math.min, "low", k)), [0, 1, 2].map((k) => ends(Math.max, "high", k))] : null;
    if (keep) this.draw();
    else this.home();
  }

  // Looks at the side that most fronts are on, from above, with all in view.
  home() {
    const [x, y, z] = unit(this.panels.reduce((sum, panel) => plus(sum, scaled(panel.out, panel.size * panel.size)), [0, 0, 0]));
    super.home();
    if (Math.hypot(x, y) > 0.2) this.turn = Math.atan2(y, x) - 0.35;
    this.lift = Math.min(Math.max(0.7 * Math.asin(z), 0.3), 0.9);
    if (!this.whole || !this.cleared()) return;
    for (let round = 0; round < 3; round++) {
      const { view, lens } = this.camera();
      const all = times(lens, view);
      let far = 0; // half of the canvas is 1
      for (const { solid } of this.panels) {
        for (let k = 0; k < solid.vertices.length; k += 3) {
          const [px, py, , w] = project(all, solid.vertices.slice(k, k + 3));
          far = Math.max(far, Math.abs(px) / w, Math.abs(py) / w);
        }
      }
      this.zoom *= FILLED / far;
    }
  }

  // kinds: Map of ids to keys of COLOURS.
  colourBy(kinds, chosen) {
    Object.assign(this, { kinds, chosen });
    const key = JSON.stringify([[...kinds], chosen]);
    if (!this.works || key === this.built) return;
    this.built = key;
    this.build();
    this.draw();
  }

  // One body for each kind, so that thousands of panels are a few calls to draw.
  build() {
    for (const [, body] of this.bodies) this.drop(body);
    const groups = new Map();
    for (const { id, solid } of this.panels) {
      const kind = id === this.chosen ? "chosen" : this.kinds.get(id) ?? "not_planned";
      if (!groups.has(kind)) groups.set(kind, { vertices: [], faces: [] });
      const { vertices, faces } = groups.get(kind);
      const from = vertices.length / 3;
      for (const v of solid.vertices) vertices.push(v);
      for (const k of solid.faces) faces.push(from + k);
    }
    this.bodies = [...groups].map(([kind, body]) => [kind, this.load(body)]);
  }

  recolour() {
    this.known = Object.fromEntries(Object.entries(COLOURS).map(([kind, name]) => [kind, this.colour(name)]));
    this.known.chosen = this.colour("--accent-deep");
    this.ink = this.colour("--ink");
    this.draw();
  }

  paint() {
    const { gl } = this;
    if (!this.cleared() || !this.whole) return;
    const camera = this.begin();
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    for (const [kind, body] of this.bodies) this.fill(body, this.known[kind], 1);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    this.stroke(this.lines, this.ink, 0.55);
    this.label(camera);
  }

  // Ids on fronts that are seen, where there is room, none over another.
  label({ view, lens, far }) {
    const all = times(lens, view);
    const eye = plus(scaled(plus(...this.whole), 0.5), plus(this.shift, scaled(this.camera().way, far)));
    const px = this.canvas.clientHeight / (2 * far * Math.tan(0.25));
    let used = 0;
    const taken = []; // px
    const half = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2];
    for (const panel of this.panels) {
      const sight = minus(eye, panel.face);
      const toward = dot(unit(sight), panel.out);
      const wide = 0.6 * panel.size * px * far / Math.hypot(...sight);
      const own = panel.id === this.chosen;
      if (!own && (toward < 0.4 || wide < ROOM[0] || wide * toward < ROOM[1])) continue;
      const [x, y, , w] = project(all, panel.face);
      if (w <= 0 || Math.abs(x / w) > 1 || Math.abs(y / w) > 1) continue;
      const at = [(half[0] * x) / w, (half[1] * y) / w];
      if (!own && taken.some((other) => Math.abs(at[0] - other[0]) < ROOM[0] && Math.abs(at[1] - other[1]) < ROOM[1])) continue;
      taken.push(at);
      const mark = (this.marks[used] ??= this.labels.appendChild(h("span", {})));
      used += 1;
      mark.hidden = false;
      mark.className = own ? "measure" : "panel-id";
      mark.textContent = panel.id;
      mark.style.left = `${(50 * (x / w + 1)).toFixed(2)}%`;
      mark.style.top = `${(50 * (1 - y / w)).toFixed(2)}%`;
    }
    for (const mark of this.marks.slice(used)) mark.hidden = true;
  }

  // The panel that is seen at a place of the canvas [px].
  found(left, top) {
    if (!this.whole) return "";
    const { view, lens } = this.camera();
    const all = times(lens, view);
    const [px, py] = [(2 * left) / this.canvas.clientWidth - 1, 1 - (2 * top) / this.canvas.clientHeight];
    let best = ["", Infinity];
    for (const { id, solid } of this.panels) {
      const seen = [];
      for (let k = 0; k < solid.vertices.length; k += 3) {
        const [x, y, z, w] = project(all, solid.vertices.slice(k, k + 3));
        seen.push([x / w, y / w, z / w]);
      }
      for (let i = 0; i < solid.faces.length; i += 3) {
        const [a, b, c] = [0, 1, 2].map((k) => seen[solid.faces[i + k]]);
        const turn = (p, q) => (q[0] - p[0]) * (py - p[1]) - (q[1] - p[1]) * (px - p[0]);
        const [u, v, t] = [turn(b, c), turn(c, a), turn(a, b)];
        if (!((u >= 0 && v >= 0 && t >= 0) || (u <= 0 && v <= 0 && t <= 0)) || u + v + t === 0) continue;
        const depth = (u * a[2] + v * b[2] + t * c[2]) / (u + v + t);
        if (depth < best[1]) best = [id, depth];
      }
    }
    return best[0];
  }
}
