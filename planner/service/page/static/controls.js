// Inputs for single values, each with its unit, range and help.
import { h } from "./dom.js";
import { labelOf, number, unitOf } from "./words.js";

const AXES = { xyz_mm: ["x", "y", "z"], rpy_deg: ["roll", "pitch", "yaw"], size_mm: ["x", "y", "z"], opening_mm: ["x", "y"], centre_mm: ["x", "y"], kerf_range_mm: ["from", "to"], turn_deg: ["from", "to"], slide_mm: ["from", "to"], u: ["from", "to"], v: ["from", "to"], lead: ["x", "y", "z"], last: ["x", "y", "z"], start_mm: ["x", "y", "z"], cog_mm: ["x", "y", "z"], offsets: ["x", "y", "z"], roll_pitch_deg: ["roll", "pitch"] };

export function rangeOf(schema) {
  const low = schema.minimum ?? schema.exclusiveMinimum;
  const high = schema.maximum;
  const far = (value) => Math.abs(value) >= 100000;
  if (low === undefined && high === undefined) return "";
  if ((low === undefined || far(low)) && (high === undefined || far(high))) return "";
  if (high === undefined || far(high)) return `${schema.exclusiveMinimum !== undefined ? "more than" : "at least"} ${number(low)}`;
  if (low === undefined || far(low)) return `at most ${number(high)}`;
  return `${schema.exclusiveMinimum !== undefined ? "over " : ""}${number(low)} to ${number(high)}`;
}

export function helpOf(schema) {
  const parts = [schema.description, rangeOf(schema)].filter(Boolean);
  if (schema.default !== undefined && schema.default !== null && typeof schema.default !== "object")
    parts.push(`usually ${shown(schema.default)}`);
  const text = parts.join("; ");
  return text ? text.charAt(0).toUpperCase() + text.slice(1) : "";
}

const shown = (value) => (typeof value === "number" ? number(value) : value === true ? "yes" : value === false ? "no" : String(value));

// A number; nothing written means that the key is left out, or null where it must be there.
export function numberInput(field, schema, value, set) {
  const input = h("input", {
    id: field.id,
    type: "number",
    step: schema.type === "integer" ? "1" : "any",
    min: schema.minimum ?? schema.exclusiveMinimum,
    max: schema.maximum,
    value: value ?? "",
    placeholder: typeof schema.default === "number" ? number(schema.default) : field.required ? "" : "–",
    oninput: () => set(input.value === "" ? field.empty : input.valueAsNumber),
  });
  return withUnit(input, unitOf(field.name));
}

export function withUnit(input, unit) {
  return unit ? h("span", { class: "with-unit" }, input, h("span", { class: "unit", "aria-hidden": "true" }, unit)) : input;
}

export function textInput(field, schema, value, set, suggestions = []) {
  const list = suggestions.length ? h("datalist", { id: `${field.id}-list` }, suggestions.map((one) => h("option", { value: one }))) : null;
  const input = h("input", {
    id: field.id,
    type: "text",
    value: value ?? "",
    placeholder: typeof schema.default === "string" ? schema.default : "",
    spellcheck: false,
    autocomplete: "off",
    maxLength: schema.maxLength ?? 1000,
    oninput: () => set(input.value === "" ? field.empty : input.value),
  });
  if (list) input.setAttribute("list", list.id);
  return [input, list];
}

export function select(field, options, value, set) {
  const none = field.required && value !== undefined && value !== null ? [] : [["", field.none ?? (field.required ? "choose" : "not stated")]];
  const all = [...none, ...options];
  const input = h(
    "select",
    { id: field.id, onchange: () => set(input.value === "" ? field.empty : options[input.selectedIndex - none.length][2] ?? input.value) },
    all.map(([key, text]) => h("option", { value: key, selected: String(value ?? "") === key }, text)),
  );
  return input;
}

export function choice(field, schema, value, set) {
  const given = value ?? schema.default ?? undefined;
  return select({ ...field, required: field.required || schema.default !== undefined && schema.default !== null }, schema.enum.map((one) => [String(one), plainWord(one), one]), given, set);
}

const plainWord = (word) => (/^[a-z_]+$/.test(word) && String(word).length > 3 ? String(word).replaceAll("_", " ") : String(word));

export function yesNo(field, schema, value, set, nullable) {
  if (nullable) return select(field, [["true", "yes", true], ["false", "no", false]], value, set);
  const input = h("input", { id: field.id, type: "checkbox", checked: value ?? schema.default ?? false, onchange: () => set(input.checked) });
  return h("span", { class: "switch" }, input, h("span", { class: "track", "aria-hidden": "true" }));
}

// A few numbers in a row.
export function tuple(field, schema, value, set) {
  const count = schema.prefixItems.length;
  const known = AXES[field.name]?.slice(0, count) ?? [];
  const names = known.length === count ? known : Array.from({ length: count }, (_, i) => (count === 3 && field.name.endsWith("_mm") ? "xyz"[i] : String(i + 1)));
  const given = Array.isArray(value) ? value : Array.isArray(schema.default) ? schema.default : [];
  const inputs = schema.prefixItems.map((one, i) =>
    h("input", {
      id: i ? `${field.id}-${i}` : field.id,
      type: "number",
      step: "any",
      min: one.minimum,
      max: one.maximum,
      value: given[i] ?? "",
      "aria-label": `${labelOf(field.name)} ${names[i]}`,
      oninput: () => {
        const all = inputs.map((input) => (input.value === "" ? null : input.valueAsNumber));
        set(all.every((v) => v === null) ? field.empty : all);
      },
    }),
  );
  const cells = inputs.map((input, i) => h("span", { class: `axis${names[i].length > 1 ? " wordy" : ""}` }, h("span", { class: "axis-name", "aria-hidden": "true" }, names[i]), input));
  return h("span", { class: "tuple", data: { count: inputs.length } }, cells, unitOf(field.name) ? h("span", { class: "unit" }, unitOf(field.name)) : null);
}

// Lists of numbers as lines of text.
export function table(field, value, set) {
  const flat = Array.isArray(value) && value.every((row) => !Array.isArray(row));
  const text = (value ?? []).map((row) => (Array.isArray(row) ? row.join("  ") : String(row))).join(flat ? ", " : "\n");
  const input = h("textarea", {
    id: field.id,
    rows: Math.min(Math.max((value ?? []).length, 2), 8),
    spellcheck: false,
    value: text,
    oninput: () => {
      const rows = field.flat
        ? input.value.split(/[\s,;]+/).filter(Boolean).map(Number)
        : input.value.split("\n").filter((line) => line.trim()).map((line) => line.trim().split(/[\s,;]+/).map(Number));
      const wrong = rows.flat().some((one) => !isFinite(one));
      input.setCustomValidity(wrong ? "enter numbers" : "");
      input.classList.toggle("invalid", wrong);
      if (!wrong) set(rows.length ? rows : field.empty);
    },
  });
  return input;
}

// A few of the words that are known, in order, none twice: one choice for each, and one more while there is room.
export function slots(field, schema, options, value, set) {
  const chosen = Array.isArray(value) ? value : [];
  const most = Math.min(schema.maxItems ?? schema.prefixItems?.length ?? options.length, Math.max(options.length, chosen.length));
  const count = Math.min(chosen.length + 1, most);
  return h("span", { class: "slots", role: "group", "aria-label": labelOf(field.name) }, Array.from({ length: Math.max(count, 1) }, (_, i) => {
    const left = options.filter((one) => one === chosen[i] || !chosen.includes(one));
    const words = left.includes(chosen[i]) || chosen[i] === undefined ? left : [chosen[i], ...left];
    const own = { id: i ? `${field.id}-${i}` : field.id, none: i < (schema.minItems ?? 0) ? "choose" : chosen[i] === undefined && i ? "add one" : "none" };
    const pick = select(own, words.map((one) => [String(one), options.includes(one) ? plainWord(one) : `${one} (unknown)`, one]), chosen[i], (v) => {
      const all = [...chosen];
      if (v === undefined || v === null) all.splice(i, 1);
      else all[i] = v;
      set(all.length ? all : field.empty);
    });
    pick.setAttribute("aria-label", `${labelOf(field.name)} ${i + 1}`);
    return pick;
  }));
}

// Names with commas between them.
export function names(field, schema, value, set) {
  const input = h("input", {
    id: field.id,
    type: "text",
    spellcheck: false,
    autocomplete: "off",
    value: (value ?? []).join(", "),
    placeholder: "names, with commas between them",
    oninput: () => {
      const all = input.value.split(",").map((one) => one.trim()).filter(Boolean);
      set(all.length ? all : field.empty);
    },
  });
  return input;
}
