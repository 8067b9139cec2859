// Figures by which an element is divided, each as a slider and as a number.
import { h } from "./dom.js";
import { labelOf, number, unitOf } from "./words.js";

const NAMES = { count: "Panels", size_mm: ["Length", "Width", "Thickness"], cells: ["Across", "Along"], least_height_mm: "Minimum height", lobe_mm: "Radius of lobes", tolerance_mm: "Tolerance", joint_mm: "Step at joints", off_surface_mm: "Deviation from surface" };
const WHOLE = ["count", "cells"];
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

// A step that suits a figure, and the range of its slider: what is outside is typed.
function rangeOf(name, value) {
  const step = WHOLE.includes(name) ? 1 : value < 1 ? 0.01 : value < 10 ? 0.1 : value < 200 ? 1 : 10;
  const round = (v) => Math.max(+(Math.round(v / step) * step).toFixed(3), step);
  return { step, min: round(value / 4), max: round(value * 3) };
}

export class Sliders {
  // moved(): called when figures were changed.
  constructor(place, moved) {
    Object.assign(this, { place, moved, fields: {}, values: {}, inputs: new Map(), kind: "" });
  }

  // Takes over fields as the service has them; those that were moved since are left as they are.
  take(fields, kind, all) {
    const first = !this.inputs.size || Object.keys(fields).join() !== Object.keys(this.fields).join();
    for (const [path, value] of Object.entries(fields)) if (all || first || same(this.values[path], this.fields[path])) this.values[path] = structuredClone(value);
    Object.assign(this, { fields: structuredClone(fields), kind });
    if (first) this.draw();
    else this.sync();
  }

  // What differs from what the service has.
  changes() {
    return Object.fromEntries(Object.entries(this.values).filter(([path, value]) => !same(value, this.fields[path])));
  }

  draw() {
    this.inputs.clear();
    const groups = new Map();
    for (const path of Object.keys(this.fields)) {
      const steps = path.split(".");
      const group = ["blocks", "raw_blocks"].includes(steps[0]) ? steps[0] : "";
      groups.set(group, [...(groups.get(group) ?? []), path]);
    }
    this.place.replaceChildren(...[...groups].flatMap(([group, paths]) => {
      const own = paths.map((path, i) => this.field(path, group && paths.length > 1 ? i + 1 : 0));
      return group ? h("div", { data: { path: group } }, own, h("div", { class: "faults" })) : own;
    }));
    this.sync();
  }

  field(path, nth) {
    const steps = path.split(".");
    const name = steps.at(-1);
    const value = this.values[path];
    const title = { blocks: "Block", raw_blocks: "Raw block" }[steps[0]] ?? (typeof NAMES[name] === "string" ? NAMES[name] : labelOf(name));
    const heading = `${title}${nth ? ` ${nth}` : ""}`;
    const faults = h("div", { class: "faults" });
    if (!Array.isArray(value)) return h("div", { class: "slide", data: { path } }, this.line(path, null, heading, heading), faults);
    const lines = value.map((_, k) => this.line(path, k, NAMES[name][k], `${heading}, ${NAMES[name][k].toLowerCase()}`));
    return h("fieldset", { class: "slide", data: { path } }, h("legend", {}, heading), lines, faults);
  }

  line(path, k, label, whole) {
    const name = path.split(".").at(-1);
    const id = `f-${path}${k === null ? "" : `-${k}`}`;
    const get = () => (k === null ? this.values[path] : this.values[path][k]);
    const set = (value) => {
      if (!Number.isFinite(value)) return;
      const before = this.values.thickness_mm;
      if (k === null) this.values[path] = value;
      else this.values[path][k] = value;
      if (path === "thickness_mm") this.follow(before, value);
      this.sync();
      this.moved();
    };
    const range = h("input", { type: "range", "aria-label": `${whole}, slider`, ...rangeOf(name, get()), oninput: () => set(range.valueAsNumber) });
    const box = h("input", { id, type: "number", step: WHOLE.includes(name) ? "1" : "any", "aria-label": whole, oninput: () => set(box.valueAsNumber) });
    range.value = get();
    this.inputs.set(id, { range, box, get, name });
    return h("div", { class: "slide-line" }, h("label", { htmlFor: id }, label), range, h("span", { class: "with-unit" }, box, h("span", { class: "unit", "aria-hidden": "true" }, unitOf(name))));
  }

  // Planar panels are cut from blocks as thick as they are: such blocks go along.
  follow(before, now) {
    if (this.kind !== "hexagons") return;
    for (const [path, value] of Object.entries(this.values)) if (path.endsWith("size_mm") && value[2] === before) value[2] = now;
  }

  sync() {
    for (const { range, box, get, name } of this.inputs.values()) {
      const value = get();
      const bounds = rangeOf(name, value);
      if (value < Number(range.min) || value > Number(range.max)) Object.assign(range, { min: bounds.min, max: bounds.max, step: bounds.step });
      if (document.activeElement !== range || range.valueAsNumber !== value) range.value = value;
      range.setAttribute("aria-valuetext", `${number(value)} ${unitOf(name)}`.trim());
      if (document.activeElement !== box) box.value = value;
    }
  }
}
