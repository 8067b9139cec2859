// Fields that users name themselves: one for each arm, signal or work offset. Each entry is a part of the form.
import { h, icon } from "./dom.js";
import { labelOf } from "./words.js";

// The field of a mapping; form: the form it is in, kinds: {key, value} schemas of its entries.
export function mapField(form, field, schema, kinds, path, value, optional) {
  const entries = value && typeof value === "object" && !Array.isArray(value) ? Object.keys(value) : [];
  const title = field.label ?? labelOf(String(field.name));
  const remove = (key) => {
    const rest = Object.fromEntries(Object.entries(value).filter(([name]) => name !== key));
    form.reshape(path, optional && !Object.keys(rest).length ? undefined : rest);
  };
  const rows = entries.map((key) => entry(form, field, kinds.value, [...path, key], key, () => remove(key)));
  const add = (key) => form.reshape(path, { ...(value ?? {}), [key]: form.schema.blank(kinds.value) });
  return h(
    "div",
    { class: "list map", role: "group", "aria-label": title, data: { path: path.join(".") } },
    h("div", { class: "list-name" }, title, schema.description ? h("span", { class: "soft" }, ` ${schema.description}`) : null),
    h("div", { class: "faults" }),
    rows,
    adder(form, field, kinds, path, entries, title, add),
  );
}

function entry(form, field, given, path, key, remove) {
  const { schema, choices, nullable } = form.schema.read(given);
  const own = { id: `f-${path.join("-")}`, name: field.name, label: key, required: true };
  const bin = h("button", { type: "button", class: "quiet remove", title: `Remove ${key}`, "aria-label": `Remove ${key}`, onclick: remove }, icon("bin"));
  const inner = form.schema.mapOf(schema);
  if (!choices && !inner && !schema.properties) {
    const place = form.field(given, path, true, own);
    place.append(bin);
    place.classList.add("keyed");
    return place;
  }
  const value = form.value(path);
  const body = choices
    ? [form.union({ ...own, name: "kind", label: undefined }, schema, choices, path, value, true, nullable)]
    : inner
      ? [mapField(form, { ...own, name: "", label: "Names" }, { ...schema, description: "" }, inner, path, value, false)]
      : form.fields(schema, path);
  return h(
    "details",
    { class: "item", data: { path: path.join(".") }, ...form.openness(`k:${path.join(".")}`, true) },
    h("summary", {}, key),
    h("div", { class: "faults" }),
    h("div", { class: "group-inside" }, body),
    bin,
  );
}

// Where a new entry gets its name: from a list where the names are known, else written.
function adder(form, field, kinds, path, entries, title, add) {
  const id = `f-${path.join("-")}`;
  const known = kinds.key.enum ?? form.known(field.name, path)?.entries?.map(([name]) => name);
  const left = known?.filter((name) => !entries.includes(name));
  if (known && !left.length) return h("p", { class: "help", id, tabIndex: -1 }, "All entries are listed.");
  const pattern = kinds.key.pattern ? new RegExp(kinds.key.pattern, "u") : null;
  const told = h("span", { class: "help", role: "status" });
  const take = () => {
    const name = input.value.trim();
    const wrong = !name ? "give a name first" : entries.includes(name) ? `${name} exists already` : pattern && !pattern.test(name) ? kinds.key.description ?? "this name is not allowed" : "";
    told.textContent = wrong;
    input.toggleAttribute("aria-invalid", Boolean(wrong));
    if (wrong) input.focus();
    else add(name);
  };
  const label = `New entry of ${title.toLowerCase()}`;
  const input = left
    ? h("select", { id, "aria-label": label }, left.map((name) => h("option", { value: name }, name)))
    : h("input", { id, type: "text", "aria-label": label, placeholder: "name", spellcheck: false, autocomplete: "off", maxLength: 64, onkeydown: (event) => event.key === "Enter" && (event.preventDefault(), take()) });
  return h("div", { class: "row add-entry" }, input, h("button", { type: "button", class: "quiet", onclick: take }, icon("plus"), "Add"), told);
}
