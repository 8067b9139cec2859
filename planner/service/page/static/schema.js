// Reads JSON schemas: references, optional values, choices, and what an empty value of one looks like.

export class Schema {
  constructor(root) {
    this.defs = root.$defs;
    this.root = this.plain(root);
  }

  // The schema without references; words beside a reference win over its own.
  plain(schema) {
    let found = schema;
    while (found.$ref) {
      const { $ref, ...beside } = found;
      found = { ...this.defs[$ref.split("/").pop()], ...beside, ref: $ref.split("/").pop() };
    }
    return found;
  }

  // The schema without null, whether null was allowed, and the choices that remain.
  read(schema) {
    const plain = this.plain(schema);
    const options = plain.anyOf ?? plain.oneOf;
    if (!options) return { schema: plain, nullable: false, choices: null };
    const some = options.map((one) => this.plain(one));
    const left = some.filter((one) => one.type !== "null");
    const nullable = left.length < some.length;
    const { anyOf, oneOf, discriminator, ...beside } = plain;
    if (left.length === 1) {
      const inner = this.read({ ...left[0], ...pick(beside, ["description", "default", "title"]) });
      return { ...inner, nullable: nullable || inner.nullable };
    }
    const flat = left.flatMap((one) => {
      const inner = this.read(one);
      return inner.choices ?? [inner.schema];
    });
    return { schema: beside, nullable, choices: flat };
  }

  // The choice that a value is of.
  choiceOf(choices, value) {
    const points = choices.map((one) => this.fits(one, value));
    const best = Math.max(...points);
    return best > 0 ? points.indexOf(best) : -1;
  }

  fits(schema, value) {
    const one = this.plain(schema);
    if ("const" in one) return value === one.const ? 3 : 0;
    if (one.enum) return one.enum.includes(value) ? 3 : 0;
    const kind = Array.isArray(value) ? "array" : value === null ? "null" : typeof value;
    if (one.type === "integer" || one.type === "number") return kind === "number" ? 2 : 0;
    if (one.type !== kind) return 0;
    if (kind !== "object" || !one.properties) return 1;
    let points = 1;
    for (const [name, inner] of Object.entries(one.properties)) {
      const word = this.plain(inner);
      if ("const" in word && name in value) {
        if (value[name] !== word.const) return 0;
        points += 10;
      } else if (word.enum && name === "kind" && name in value) {
        if (!word.enum.includes(value[name])) return 0;
        points += 10;
      }
    }
    for (const name of Object.keys(value)) points += name in one.properties ? 1 : -1;
    for (const name of one.required ?? []) points += name in value ? 2 : -1;
    return Math.max(points, 0.1);
  }

  // A value to begin with: what must be there, with nothing where the user has to decide.
  blank(given) {
    const { schema, choices } = this.read(given);
    if (schema.default !== undefined && schema.default !== null) return structuredClone(schema.default);
    if (choices) return this.blank(choices[0]);
    if ("const" in schema) return schema.const;
    if (schema.enum) return schema.enum[0];
    if (schema.type === "object") {
      const made = {};
      for (const name of schema.required ?? []) made[name] = this.blank(schema.properties[name]);
      return made;
    }
    if (schema.type === "array") {
      if (schema.prefixItems) return schema.prefixItems.map((one) => this.blank(one));
      return Array.from({ length: schema.minItems ?? 0 }, () => this.blank(schema.items));
    }
    if (schema.type === "boolean") return false;
    return null;
  }

  // {key, value} schemas of an object whose fields the user names; null for others.
  mapOf(schema) {
    if (schema.type !== "object" || schema.properties) return null;
    const [pattern, value] = Object.entries(schema.patternProperties ?? {})[0] ?? [undefined, schema.additionalProperties];
    if (!value || typeof value !== "object") return null;
    const named = this.plain(schema.propertyNames ?? {});
    return { key: pattern ? { ...named, pattern } : named, value };
  }

  // What the items of a list are, where all are of one kind.
  itemsOf(schema) {
    return this.plain(schema.items ?? schema.prefixItems?.[0] ?? {});
  }

  titleOf(schema) {
    const one = this.plain(schema);
    if ("const" in one) return String(one.const);
    const kind = one.properties?.kind;
    if (kind?.const) return words(kind.const);
    if (kind?.enum && one.ref === "RoundFile") return "cylinder, capsule";
    const process = one.properties?.process;
    if (process?.const) return words(process.const);
    if (one.ref) return words(one.ref.replace(/(File|Cut)$/, "").replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase());
    if (one.enum) return one.enum.join(", ");
    if (one.type === "array") return one.prefixItems ? `${one.prefixItems.length} numbers` : "list";
    return { string: "by name", integer: "a number", number: "a number" }[one.type] ?? one.type;
  }

  // Whether lists of numbers are inside, one a line, so that text is the best way to write them.
  isTable(schema) {
    const items = schema.type === "array" ? schema.items ?? schema.prefixItems?.[0] : null;
    if (!items) return false;
    const one = this.plain(items);
    if (schema.prefixItems) return one.type === "array";
    if (one.type === "array") return this.isNumbers(one);
    return one.type === "number" || one.type === "integer";
  }

  isNumbers(schema) {
    const inner = schema.prefixItems ?? [schema.items ?? {}];
    return inner.every((one) => ["number", "integer"].includes(this.plain(one).type));
  }
}

const words = (name) => name.replaceAll("_", " ");
const pick = (from, names) => Object.fromEntries(names.filter((n) => from[n] !== undefined).map((n) => [n, from[n]]));

export function at(data, path) {
  return path.reduce((inner, step) => (inner === undefined || inner === null ? undefined : inner[step]), data);
}

export function put(data, path, value) {
  const last = path[path.length - 1];
  let inner = data;
  for (const [i, step] of path.slice(0, -1).entries()) {
    if (inner[step] === undefined || inner[step] === null) inner[step] = typeof path[i + 1] === "number" ? [] : {};
    inner = inner[step];
  }
  if (value !== undefined) inner[last] = value;
  else if (Array.isArray(inner)) inner.splice(last, 1);
  else delete inner[last];
}

// Where two problems differ: [path, before, after] of each value.
export function differences(before, after, path = []) {
  const simple = (v) => v === null || typeof v !== "object" || (Array.isArray(v) && v.every((e) => typeof e === "number"));
  if (simple(before) || simple(after) || Array.isArray(before) !== Array.isArray(after))
    return JSON.stringify(before) === JSON.stringify(after) ? [] : [[path, before, after]];
  const keys = [...new Set([...Object.keys(before), ...Object.keys(after)])];
  return keys.flatMap((key) => {
    const step = Array.isArray(before) ? Number(key) : key;
    return differences(before[key], after[key], [...path, step]);
  });
}
