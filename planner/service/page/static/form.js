// A form made from the JSON schema of problem files. Every value has a place, [data-path], where its issues show.
import * as controls from "./controls.js";
import { h, icon } from "./dom.js";
import { mapField } from "./maps.js";
import { at, put } from "./schema.js";
import { labelOf } from "./words.js";

const SKIPPED = new Set(["tandem", "process"]);
const FIRST = ["name", "robot", "arms", "mode", "kind", "file", "unit", "face", "size_mm"];

export class Form {
  // state: {problem, origin, files}; changed() after every change of a value; known: names for some fields.
  constructor(schema, state, changed, known) {
    Object.assign(this, { schema, state, known });
    this.changed = (path) => {
      this.mark(path);
      changed(path);
    };
    this.toggled = new Map();
  }

  // Whether a frame is open: as the user left it, else if it is near the top.
  openness(key, usual) {
    return { open: this.toggled.get(key) ?? usual, ontoggle: (event) => this.toggled.set(key, event.target.open) };
  }

  value(path) {
    return at(this.state.problem, path);
  }

  set(path, value) {
    put(this.state.problem, path, value);
    this.changed(path);
  }

  // Sets a value that changes what fields there are, and draws its place anew.
  reshape(path, value) {
    put(this.state.problem, path, value);
    this.redraw();
    this.changed(path);
  }

  // The fields of the object at a path, into an element.
  into(element, given, path, only = null) {
    const draw = () => {
      const { schema, choices } = this.schema.read(given);
      const chosen = choices ? choices[Math.max(this.schema.choiceOf(choices, this.value(path)), 0)] : schema;
      element.replaceChildren(...this.fields(this.schema.plain(chosen), path, only));
    };
    this.redraws ??= [];
    this.redraws.push(draw);
    draw();
  }

  redraw() {
    const focus = document.activeElement?.id;
    for (const draw of this.redraws ?? []) draw();
    if (focus) document.getElementById(focus)?.focus();
    this.drawn?.();
  }

  forget() {
    this.redraws = [];
  }

  fields(schema, path, only) {
    const names = Object.keys(schema.properties ?? {}).filter((name) => !SKIPPED.has(name) && (!only || only.includes(name)));
    const rank = (name) => (FIRST.includes(name) ? FIRST.indexOf(name) : FIRST.length);
    names.sort((a, b) => rank(a) - rank(b));
    const value = this.value(path) ?? {};
    const isMain = (name) => (schema.required ?? []).includes(name) || name in value;
    const draw = (name) => this.field(schema.properties[name], [...path, name], (schema.required ?? []).includes(name));
    const main = names.filter(isMain).map(draw);
    const more = names.filter((name) => !isMain(name));
    if (!more.length) return main;
    const key = path.join(".");
    const rest = h(
      "details",
      { class: "more", ...this.openness(`m:${key}`, false) },
      h("summary", {}, main.length ? `${more.length} more field${more.length > 1 ? "s" : ""}` : `${more.length} fields`, h("span", { class: "soft" }, ` ${more.slice(0, 3).map((n) => labelOf(n).toLowerCase()).join(", ")}${more.length > 3 ? " …" : ""}`)),
      h("div", { class: "more-inside" }, more.map(draw)),
    );
    return [...main, rest];
  }

  field(given, path, required, own = {}) {
    const name = path[path.length - 1];
    const { schema, nullable, choices } = this.schema.read(given);
    const value = this.value(path);
    const id = `f-${path.join("-")}`;
    const field = { id, name: String(name), required: required && !nullable, empty: required && !nullable ? null : undefined, ...own };
    const set = (v) => this.set(path, v);
    if (choices) return this.union(field, schema, choices, path, value, required, nullable);
    if (schema.type === "object" && schema.properties) return this.group(field, schema, path, value, required, nullable);
    if (schema.type === "array" && !schema.prefixItems && this.isList(schema)) return this.list(field, schema, path, value, nullable);
    const kinds = this.schema.mapOf(schema);
    if (kinds) return mapField(this, field, schema, kinds, path, value, !required);
    const control = this.control(field, schema, value, set, path, nullable);
    return this.wrap(field, path, schema, control, schema.type === "boolean" && !nullable);
  }

  isList(schema) {
    const items = this.schema.read(schema.items);
    return Boolean(items.choices) || Boolean(items.schema.properties);
  }

  control(field, schema, value, set, path, nullable) {
    if (schema.enum) return controls.choice(field, schema, value, set);
    if ("const" in schema) return h("output", { id: field.id, class: "constant" }, String(schema.const));
    if (field.name === "file") return this.file(field, value, path);
    const known = this.known(field.name, path);
    if (schema.type === "string" && known?.strict) return controls.select(field, known.entries, value, set);
    if (schema.type === "boolean") return controls.yesNo(field, schema, value, set, nullable);
    if (schema.type === "number" || schema.type === "integer") return controls.numberInput(field, schema, value, set);
    if (schema.type === "array" && this.schema.isTable(schema)) {
      const items = this.schema.plain(schema.items ?? schema.prefixItems[0]);
      return controls.table({ ...field, flat: items.type !== "array" }, value ?? schema.default, set);
    }
    if (schema.type === "array" && schema.prefixItems && this.schema.isNumbers(schema)) return controls.tuple(field, schema, value, set);
    if (schema.type === "array") {
      const options = this.schema.itemsOf(schema).enum ?? known?.entries?.map(([key]) => key);
      if (options) return controls.slots(field, schema, options, value ?? schema.default, (v) => this.reshape(path, v));
      return controls.names(field, schema, value, set);
    }
    if (schema.type === "string") return controls.textInput(field, schema, value, set, known?.entries?.map(([key]) => key));
    throw new Error(`${path.join(".")}: the form has no part for ${schema.type}`);
  }

  file(field, value, path) {
    const pick = h("input", {
      type: "file",
      class: "unseen",
      tabIndex: -1,
      "aria-hidden": "true",
      onchange: () => {
        const file = pick.files[0];
        if (!file) return;
        this.state.files.set(file.name, file);
        this.reshape(path, file.name);
      },
    });
    const have = [...this.state.files.keys()];
    const names = value && !have.includes(value) ? [value, ...have] : have;
    const list = controls.select({ ...field, none: "no file" }, names.map((one) => [one, have.includes(one) ? one : `${one} (not uploaded)`]), value, (v) => this.set(path, v));
    return h("span", { class: "row" }, list, h("button", { type: "button", class: "small", onclick: () => pick.click() }, "Choose file"), pick);
  }

  wrap(field, path, schema, control, inline) {
    const help = controls.helpOf(schema);
    const names = Array.isArray(control) ? control : [control];
    const place = h(
      "div",
      { class: `field${inline ? " inline" : ""}`, data: { path: path.join(".") } },
      h("label", { htmlFor: field.id }, field.label ?? labelOf(field.name), field.required ? h("span", { class: "must", title: "must be given" }, " *") : null),
      h("div", { class: "control" }, names),
      h("p", { class: "help", id: `${field.id}-help` }, help),
      h("p", { class: "was", hidden: true }),
      h("div", { class: "faults", id: `${field.id}-faults` }),
    );
    place.querySelector(`#${CSS.escape(field.id)}`)?.setAttribute("aria-describedby", `${field.id}-help ${field.id}-faults`);
    this.markOne(place, path);
    return place;
  }

  // An object: its fields in a frame; one that may be missing can be added and taken away.
  group(field, schema, path, value, required, nullable) {
    const optional = !required;
    const there = value !== undefined && value !== null;
    if (!there && optional) return this.adder(field, schema, path, () => this.schema.blank({ ...schema, default: undefined }));
    const key = `g:${path.join(".")}`;
    const small = Object.keys(schema.properties).length <= 3;
    return h(
      "details",
      { class: "group", data: { path: path.join(".") }, ...this.openness(key, small || path.length < 4) },
      h("summary", {}, labelOf(String(field.name)), schema.description ? h("span", { class: "soft" }, ` ${firstSentence(schema.description)}`) : null),
      h("div", { class: "faults" }),
      h("div", { class: "group-inside" }, this.fields(schema, path)),
      optional ? this.remover(field, path) : null,
    );
  }

  adder(field, schema, path, make) {
    return h(
      "div",
      { class: "field add", data: { path: path.join(".") } },
      h("button", { type: "button", class: "quiet", id: field.id, onclick: () => this.reshape(path, make()) }, icon("plus"), labelOf(String(field.name))),
      schema.description ? h("p", { class: "help" }, firstSentence(schema.description)) : null,
      h("div", { class: "faults" }),
    );
  }

  remover(field, path) {
    const words = `Remove ${labelOf(String(field.name)).toLowerCase()}`;
    return h("button", { type: "button", class: "quiet remove", title: words, "aria-label": words, onclick: () => this.reshape(path, undefined) }, icon("bin"));
  }

  union(field, schema, choices, path, value, required, nullable) {
    const there = value !== undefined && value !== null;
    const index = there ? this.schema.choiceOf(choices, value) : -1;
    const scalars = choices.every((one) => !one.properties && one.type !== "array");
    if (scalars && choices.some((one) => one.type === "number" || one.type === "string")) return this.wrap(field, path, schema, controls.textInput(field, schema, value, (v) => this.set(path, v === undefined ? undefined : choices.some((one) => one.type === "number") && isFinite(Number(v)) ? Number(v) : v), choices.flatMap((one) => one.enum ?? ("const" in one ? [one.const] : [])).concat((this.known(field.name, path)?.entries ?? []).map(([key]) => key))), false);
    const titles = choices.map((one, i) => [String(i), this.schema.titleOf(one), i]);
    const fallback = schema.default !== undefined && schema.default !== null ? this.schema.choiceOf(choices, schema.default) : -1;
    const seen = index >= 0 ? index : fallback;
    const pick = controls.select({ ...field, required: seen >= 0 && !nullable }, titles, seen >= 0 ? String(seen) : undefined, (i) => this.reshape(path, i === undefined || i === null ? undefined : this.schema.blank({ ...choices[i], default: undefined })));
    const chosen = index >= 0 ? choices[index] : null;
    const isList = chosen?.type === "array" && !chosen.prefixItems && this.isList(chosen);
    const alone = chosen && !("const" in chosen) && !chosen.properties && !isList;
    const inner = alone ? this.control({ ...field, id: `${field.id}-in` }, chosen, value, (v) => this.set(path, v), path, false) : [];
    const place = this.wrap(field, path, schema, [pick, inner].flat(), false);
    place.querySelector(`#${CSS.escape(`${field.id}-in`)}`)?.setAttribute("aria-label", `${labelOf(field.name)}, ${this.schema.titleOf(chosen)}`);
    if (isList) place.append(h("div", { class: "chosen" }, this.list({ ...field, id: `${field.id}-in` }, chosen, path, value, false)));
    if (chosen?.properties) place.append(h("div", { class: "chosen" }, this.fields(chosen, path).filter((one) => one.dataset.path !== [...path, "kind"].join(".") || chosen.properties.kind?.enum)));
    return place;
  }

  list(field, schema, path, value, nullable) {
    const rows = Array.isArray(value) ? value : [];
    const add = h("button", { type: "button", class: "quiet", id: field.id, onclick: () => this.reshape(path, [...rows, this.schema.blank(schema.items)]) }, icon("plus"), `Add to ${labelOf(String(field.name)).toLowerCase()}`);
    const items = rows.map((row, i) => {
      const { schema: inner, choices } = this.schema.read(schema.items);
      const title = `${labelOf(String(field.name)).replace(/s$/, "")} ${i + 1}${row?.name ? ` · ${row.name}` : ""}`;
      const key = `i:${[...path, i].join(".")}`;
      const body = choices ? [this.union({ ...field, id: `${field.id}-${i}`, name: field.name === "operations" ? "process" : "kind", required: true }, inner, choices, [...path, i], row, true, false)] : this.fields(inner, [...path, i]);
      return h(
        "details",
        { class: "item", data: { path: [...path, i].join(".") }, ...this.openness(key, rows.length < 3 && path.length < 4) },
        h("summary", {}, title),
        h("div", { class: "faults" }),
        h("div", { class: "group-inside" }, body),
        h("button", { type: "button", class: "quiet remove", title: `Remove ${title}`, "aria-label": `Remove ${title}`, onclick: () => this.reshape(path, rows.length > 1 || !nullable ? rows.filter((_, j) => j !== i) : undefined) }, icon("bin")),
      );
    });
    return h("div", { class: "list", data: { path: path.join(".") } }, h("div", { class: "list-name" }, labelOf(String(field.name)), schema.description ? h("span", { class: "soft" }, ` ${schema.description}`) : null), h("div", { class: "faults" }), items, add);
  }

  // What a value was before, where the problem came from elsewhere.
  mark(path) {
    const place = document.querySelector(`.field[data-path="${CSS.escape(path.join("."))}"]`);
    if (place) this.markOne(place, path);
  }

  markOne(place, path) {
    const was = place.querySelector(":scope > .was");
    if (!was || !this.state.origin) return;
    const before = at(this.state.origin, path);
    const same = JSON.stringify(before) === JSON.stringify(this.value(path));
    place.classList.toggle("changed", !same);
    was.hidden = same;
    was.replaceChildren(
      ...(same ? [] : [`was ${before === undefined ? "not stated" : short(before)} `, h("button", { type: "button", class: "link", onclick: () => this.reshape(path, structuredClone(before)) }, "undo")]),
    );
  }
}

const firstSentence = (text) => text.replace(/``/g, "").split(/(?<=\.)\s/)[0].replace(/\s+/g, " ");

export function short(value) {
  const text = typeof value === "string" ? value : JSON.stringify(value);
  return text === undefined ? "not stated" : text.length > 60 ? `${text.slice(0, 57)}…` : text;
}
