// A map of one freedom over the targets: for each arm, or for both, a picture of columns (targets) and rows (values).
import { h } from "./dom.js";
import { number } from "./words.js";

export const WORDS = { "": "nothing fails", "motion.no_reach": "out of reach", "motion.joint_limit": "joint limit", "motion.singular": "singularity", "motion.collision": "too close" };
export const STYLES = { "": "--map-free", "motion.no_reach": "--map-reach", "motion.joint_limit": "--map-limit", "motion.singular": "--map-singular", "motion.collision": "--map-near" };
const LAYERS = { limit_deg: ["margin to joint limits", 45, "°"], singular_deg: ["distance to singularities", 45, "°"], clearance_mm: ["clearance", 100, " mm"] };
const [LEFT, TOP, HEIGHT, GAP, BELOW] = [64, 20, 118, 26, 20]; // pixels

export class AxisMap {
  // chosen(column): a target is; moves(value): whether a field was set to a value; told: where it says what is there.
  constructor(canvas, told, { chosen, moves }) {
    Object.assign(this, { canvas, told, chosen, moves, data: null, at: -1, name: "states", cursor: null });
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
    addEventListener("themechange", () => this.draw());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    canvas.addEventListener("pointermove", (event) => this.say(this.cell(event)));
    canvas.addEventListener("pointerleave", () => this.say(this.cursor));
    canvas.addEventListener("click", (event) => this.take(this.cell(event)));
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  show({ map, arms, targets }) {
    this.data = map ?? null;
    this.targets = targets ?? [];
    this.arms = map ? arms.map((arm) => arm.name).filter((name) => name in map.states) : [];
    this.cursor = null;
    this.draw();
  }

  layer(name) {
    this.name = name;
    this.draw();
  }

  mark(column) {
    this.at = column;
    this.draw();
  }

  // The pictures that there are: one for each arm, one alone of what both share.
  get rows() {
    return this.name === "clearance_mm" ? ["both arms"] : this.arms;
  }

  draw() {
    const { canvas, data } = this;
    const width = canvas.parentElement.clientWidth;
    if (!width) return;
    const scale = Math.min(devicePixelRatio || 1, 2);
    const height = data ? this.rows.length * (HEIGHT + GAP) + BELOW : 0;
    canvas.hidden = !data;
    canvas.width = width * scale;
    canvas.height = height * scale;
    canvas.style.height = `${height}px`;
    const legend = canvas.parentElement.querySelector(".map-legend");
    legend.replaceChildren();
    if (!data) return;
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    const style = getComputedStyle(canvas);
    const colour = (name) => this.resolve(name);
    const colours = Object.fromEntries(["--ink", "--soft", "--card", "--accent", ...Object.values(STYLES), "--map-low", "--map-high"].map((name) => [name, colour(name)]));
    pen.font = `12px ${style.fontFamily}`;
    const all = data.values.flat();
    const [low, high] = [Math.min(...all), Math.max(...all)];
    const step = (high - low) / Math.max(data.values[0].length - 1, 1) || 1;
    this.frame = { width, low: low - step / 2, high: high + step / 2, step };
    for (const [i, arm] of this.rows.entries()) {
      const top = i * (HEIGHT + GAP) + TOP;
      pen.fillStyle = colours["--ink"];
      pen.fillText(this.arms.length > 1 || this.name === "clearance_mm" ? (this.arms.length > 1 ? arm : "all bodies") : arm, LEFT, top - 6);
      for (const [k, values] of data.values.entries())
        for (const [v, value] of values.entries()) {
          const [x, y, w, t] = this.box(k, value, top, this.own(k));
          pen.fillStyle = this.paint(arm, k, v, colours);
          const [from, to] = [Math.round(y), Math.round(y + t)]; // whole pixels leave no lines between
          pen.fillRect(Math.round(x), from, Math.round(x + w) - Math.round(x), to - from);
        }
      this.path(pen, top, step, colours);
      pen.fillStyle = colours["--soft"];
      const unit = data.unit === "deg" ? "°" : data.unit ? ` ${data.unit}` : "";
      pen.textAlign = "right";
      for (const [value, y] of [[high, top + 11], [(low + high) / 2, top + HEIGHT / 2 + 4], [low, top + HEIGHT - 1]]) pen.fillText(`${number(+value.toPrecision(3))}${unit}`, LEFT - 5, y);
      pen.textAlign = "left";
      for (const [column, kind] of [[this.at, "--ink"], [this.cursor?.[0] ?? -1, "--accent"]])
        if (column >= 0 && column < data.values.length) {
          const [x, , w] = this.box(column, 0, top, step);
          pen.strokeStyle = colours[kind];
          pen.lineWidth = 1.5;
          pen.strokeRect(x, top - 1, w, HEIGHT + 2);
        }
      if (this.cursor && this.cursor[2] === i) {
        const [x, y, w, t] = this.box(this.cursor[0], data.values[this.cursor[0]][this.cursor[1]], top, this.own(this.cursor[0]));
        pen.lineWidth = 2.5;
        pen.strokeRect(x, y, w, t);
      }
    }
    pen.fillStyle = colours["--soft"];
    pen.fillText(this.targets[0]?.name ?? "", LEFT, height - 8);
    pen.textAlign = "right";
    pen.fillText(this.targets.at(-1)?.name ?? "", width - 4, height - 8);
    legend.append(...this.legend());
  }

  // The way of the plan, in pieces where it leaves targets out or passes from one end of a full turn to the other.
  path(pen, top, step, colours) {
    const { path, unit } = this.data;
    if (!path) return;
    for (const [kind, width] of [["--card", 4.5], ["--ink", 2]]) {
      pen.beginPath();
      for (const [k, value] of path.entries()) {
        if (value === null) continue;
        const [x, y, w, t] = this.box(k, value, top, step);
        const jumps = !k || path[k - 1] === null || (unit === "deg" && Math.abs(value - path[k - 1]) > 180);
        if (y < top - HEIGHT || y > top + 2 * HEIGHT) continue;
        if (jumps) pen.moveTo(x + w / 2, y + t / 2);
        else pen.lineTo(x + w / 2, y + t / 2);
      }
      pen.strokeStyle = colours[kind];
      pen.lineWidth = width;
      pen.stroke();
    }
  }

  // How far the values of a column are apart, which may be nearer than those of others.
  own(k) {
    const values = this.data.values[k];
    return Math.max(Math.abs(values.at(-1) - values[0]) / Math.max(values.length - 1, 1), this.frame.step * 0.5);
  }

  box(k, value, top, step) {
    const { width, low, high } = this.frame;
    const w = (width - LEFT - 4) / this.data.values.length;
    const t = (step / (high - low)) * HEIGHT;
    return [LEFT + k * w, top + HEIGHT * (1 - (value + step / 2 - low) / (high - low)), w, t];
  }

  paint(arm, k, v, colours) {
    const { data, name } = this;
    if (name === "states") return colours[STYLES[data.codes[data.states[arm][k][v]]]];
    const value = name === "clearance_mm" ? data.clearance_mm[k][v] : data[name][arm][k][v];
    if (value === null) return colours["--map-reach"];
    const share = Math.round(100 * Math.min(Math.max(value / LAYERS[name][1], 0), 1));
    return `color-mix(in oklab, ${colours["--map-high"]} ${share}%, ${colours["--map-low"]})`;
  }

  resolve(name) {
    this.probe ??= this.canvas.parentElement.appendChild(h("span", { hidden: true }));
    this.probe.style.color = `var(${name})`;
    return getComputedStyle(this.probe).color;
  }

  legend() {
    const { data, name } = this;
    const way = data.path ? [h("span", {}, h("i", { class: "swatch map-path" }), "path of the plan ")] : [];
    if (name !== "states") {
      const [title, most, unit] = LAYERS[name];
      return [...way, h("i", { class: "swatch map-scale" }), `${title}, from 0 to ${most}${unit} and more; `, h("i", { class: "swatch map-none" }), "none"];
    }
    const some = new Set(this.arms.flatMap((arm) => data.states[arm].flat()));
    return [...way, ...[...some].sort().map((state) => h("span", {}, h("i", { class: `swatch ${STYLES[data.codes[state]].slice(2)}` }), WORDS[data.codes[state]], " "))];
  }

  // [column, value's number, picture] under the pointer, or null.
  cell(event) {
    if (!this.data || !this.frame) return null;
    const box = this.canvas.getBoundingClientRect();
    const { width, low, high, step } = this.frame;
    const k = Math.floor(((event.clientX - box.left - LEFT) / (width - LEFT - 4)) * this.data.values.length);
    const i = Math.floor((event.clientY - box.top) / (HEIGHT + GAP));
    const share = 1 - (event.clientY - box.top - i * (HEIGHT + GAP) - TOP) / HEIGHT;
    const values = this.data.values[k];
    if (!values || i < 0 || i >= this.rows.length || share < 0 || share > 1) return null;
    const value = low + share * (high - low);
    const v = values.reduce((best, one, n) => (Math.abs(one - value) < Math.abs(values[best] - value) ? n : best), 0);
    return Math.abs(values[v] - value) <= step ? [k, v, i] : null;
  }

  key(event) {
    if (!this.data || event.ctrlKey || event.metaKey || event.altKey) return;
    const [k, v, i] = this.cursor ?? [Math.max(this.at, 0), Math.floor(this.data.values[0].length / 2), 0];
    const go = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (event.key === "Enter" || event.key === " ") this.take([k, v, i]);
    else if (!go) return;
    else this.cursor = this.cursor ? [clip(k + go[0], this.data.values.length), clip(v + go[1], this.data.values[0].length), i] : [k, v, i];
    event.preventDefault();
    this.say(this.cursor);
    this.draw();
  }

  // A place is chosen: its target is shown, and its value taken where the problem has a field for it.
  take(place) {
    if (!place) return;
    this.cursor = place;
    const value = this.data.values[place[0]][place[1]];
    const name = this.data.freedom;
    this.chosen(place[0]);
    const done = this.moves(value);
    this.say(place, done ? "The block was moved." : `The planner chooses ${name.replaceAll("_", " ")}. It has no field.`);
    this.draw();
  }

  say(place, more = "") {
    const { data } = this;
    if (!place || !data) return;
    const [k, v] = place;
    const unit = data.unit === "deg" ? "°" : data.unit ? ` ${data.unit}` : "";
    const states = this.arms.map((arm) => {
      const code = data.codes[data.states[arm][k][v]];
      const room = ["limit_deg", "singular_deg"].map((name) => data[name][arm][k][v]);
      return `${arm}: ${WORDS[code]}${code === "motion.collision" && data.pairs[k][v] ? ` (${data.pairs[k][v]})` : ""}${room[0] === null ? "" : `, ${number(room[0])}° to limits, ${number(room[1])}° to singularity`}`;
    });
    const clear = data.clearance_mm[k][v];
    const text = `${this.targets[k]?.name}, ${data.freedom.replaceAll("_", " ")} ${number(data.values[k][v])}${unit}: ${states.join("; ")}${clear === null ? "" : `; clearance ${number(clear)} mm${clear >= 100 ? " or more" : ""}`}. ${more}`;
    if (this.told.textContent !== text) this.told.textContent = text;
  }
}

const clip = (value, count) => Math.min(Math.max(value, 0), count - 1);
