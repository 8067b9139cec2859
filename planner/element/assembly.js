// Panels of an element as they are put up, one after the other along their ways in.
import { cross, minus, plus, project, scaled, times, unit } from "./matrix.js";
import { Orbit } from "./orbit.js";
import { madePanel } from "./panels.js";

const BEFORE = 0.9; // how far a panel that comes hovers before its place, in its own diameters
const FILL = 0.8; // of the view that the element takes at first
const SECONDS = 0.8; // for a panel to come in, at most
const WHOLE = 40; // seconds for all of them, at most

// A cone and a rod from one point to another.
function arrow(from, to, radius) {
  const length = Math.hypot(...minus(to, from));
  const way = unit(minus(to, from));
  const side = unit(cross(way, Math.abs(way[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
  const other = cross(way, side);
  const head = Math.min(5 * radius, 0.6 * length);
  const rings = [[0, 0], [0, radius], [length - head, radius], [length - head, 2.2 * radius], [length, 0]];
  const sides = 14;
  const vertices = rings.flatMap(([along, wide]) => Array.from({ length: sides }, (_, k) => {
    const turn = (2 * Math.PI * k) / sides;
    return plus(plus(from, scaled(way, along)), plus(scaled(side, wide * Math.cos(turn)), scaled(other, wide * Math.sin(turn))));
  }).flat());
  const faces = [];
  for (let r = 0; r + 1 < rings.length; r++) for (let k = 0; k < sides; k++) {
    const [a, b] = [r * sides + k, r * sides + ((k + 1) % sides)];
    faces.push(a, b, b + sides, a, b + sides, a + sides);
  }
  return { vertices, faces };
}

class Assembly extends Orbit {
  constructor(box, data) {
    const canvas = box.querySelector("canvas");
    super(canvas, 1, true);
    const part = (name) => box.querySelector(`.${name}`);
    Object.assign(this, { line: part("line"), said: part("said"), name: part("name"), play: part("play"), all: part("all") });
    this.count = data.panels.length;
    this.texts = data.panels.map(({ id, words }) => [id, words]);
    this.now = this.count;
    this.line.oninput = () => this.go(Number(this.line.value));
    this.play.onclick = () => this.run(!this.going);
    part("back").onclick = () => this.go(Math.ceil(this.now) - 1);
    part("next").onclick = () => this.go(Math.floor(this.now) + 1);
    if (this.works) {
      this.panels = data.panels.map((panel) => madePanel(panel, data.axes));
      this.whole = [0, 1].map((end) => [0, 1, 2].map((k) => (end ? Math.max : Math.min)(...this.panels.map((p) => (end ? p.high : p.low)[k]))));
      this.zoom = this.near = this.filling();
      for (const panel of this.panels) [panel.body, panel.lines] = [this.load(panel.solid), this.load(panel.edges)];
      this.ways = this.load({ vertices: this.panels.flatMap((p) => [...p.middle, ...minus(p.middle, scaled(p.way, 0.6 * p.size))]), faces: [] });
      this.all.onchange = () => this.draw();
      this.recolour();
    } else {
      this.canvas.replaceWith(Object.assign(document.createElement("p"), { textContent: "This browser cannot show 3D views: it lacks WebGL 2. The order is listed below." }));
      this.all.parentElement.remove();
    }
    addEventListener("hashchange", () => this.asked());
    this.go(this.now);
    this.asked();
  }

  // The zoom at which the element fills the view from where it is seen first; in rounds, as what is near grows faster.
  filling() {
    if (!this.cleared()) return this.near;
    for (let round = 0; round < 4; round++) {
      const { view, lens } = this.camera();
      const all = times(lens, view);
      let most = 1e-6;
      for (const { solid } of this.panels)
        for (let i = 0; i < solid.vertices.length; i += 3) {
          const [x, y, , w] = project(all, solid.vertices.slice(i, i + 3));
          most = Math.max(most, Math.abs(x / w), Math.abs(y / w));
        }
      this.zoom *= FILL / most;
    }
    return this.zoom;
  }

  // #panel=A01 in the address: that one comes next.
  asked() {
    const id = new URLSearchParams(location.hash.slice(1)).get("panel");
    const k = this.texts.findIndex((one) => one[0] === id);
    if (k < 0) return;
    this.run(false);
    this.go(k);
  }

  go(value) {
    this.now = Math.min(Math.max(value, 0), this.count);
    this.line.value = this.now;
    const next = Math.floor(this.now);
    const [id, words] = this.texts[Math.min(next, this.count - 1)];
    this.said.textContent = next < this.count ? `Panel ${next + 1} of ${this.count}: ${id}, ${words}` : `All ${this.count} panels stand`;
    this.line.setAttribute("aria-valuetext", this.said.textContent);
    this.draw();
  }

  run(going) {
    if (going && this.now >= this.count) this.go(0);
    this.going = going;
    this.play.textContent = going ? "\u275A\u275A" : "\u25B6";
    if (!going) return;
    let last = performance.now();
    const each = 1000 * Math.min(SECONDS, WHOLE / this.count);
    const step = (time) => {
      if (!this.going) return;
      this.go(this.now + Math.min(time - last, 100) / each);
      last = time;
      if (this.now >= this.count) this.run(false);
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  recolour() {
    const known = new Map();
    const colour = (name) => known.get(name) ?? known.set(name, this.colour(name)).get(name);
    for (const panel of this.panels) panel.colour = colour(panel.fill);
    Object.assign(this, { ink: colour("--ink"), soft: colour("--soft"), mark: colour("--accent"), coming: colour("--c1") });
    this.draw();
  }

  paint() {
    const { gl } = this;
    this.name.hidden = true;
    if (!this.cleared()) return;
    const camera = this.begin();
    const next = Math.floor(this.now);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    for (const panel of this.panels.slice(0, next)) this.fill(panel.body, panel.colour, 1);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    for (const panel of this.panels.slice(0, next)) this.stroke(panel.lines, this.ink, 0.5);
    if (next < this.count) this.come(this.panels[next], this.now - next, camera);
    if (this.all.checked) {
      gl.disable(gl.DEPTH_TEST);
      this.stroke(this.ways, this.mark, 0.9);
    }
  }

  // The panel that comes, its share of the way done.
  come(panel, share, { view, lens }) {
    const { gl } = this;
    const off = scaled(panel.way, -BEFORE * panel.size * (1 - share) ** 2);
    gl.uniformMatrix4fv(this.at.view, false, times(view, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, ...off, 1]));
    gl.enable(gl.POLYGON_OFFSET_FILL);
    this.fill(panel.body, this.coming, 1);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    this.stroke(panel.lines, this.ink, 0.8);
    gl.uniformMatrix4fv(this.at.view, false, view);
    const from = plus(panel.middle, off);
    const span = Math.hypot(...minus(this.whole[1], this.whole[0]));
    if (Math.hypot(...off) > 0.1 * panel.size) {
      const body = this.load(arrow(from, panel.middle, Math.min(0.006 * span, 0.06 * panel.size)));
      gl.clear(gl.DEPTH_BUFFER_BIT);
      this.fill(body, this.mark, 1);
      this.drop(body);
    }
    const [x, y, , w] = project(times(lens, view), from);
    this.name.hidden = w <= 0;
    this.name.textContent = panel.id;
    this.name.style.left = `${(50 * (x / w + 1)).toFixed(2)}%`;
    this.name.style.top = `${(50 * (1 - y / w)).toFixed(2)}%`;
  }
}

window.assembly = new Assembly(document.getElementById("put-up"), JSON.parse(document.getElementById("put-up-data").textContent));
