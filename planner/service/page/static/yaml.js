// Problem files as data, by the same rules of YAML 1.1 that the service reads them by.
import { load, YAML11_SCHEMA } from "./vendor/js-yaml.mjs";

export const parse = (text) => load(text, { schema: YAML11_SCHEMA });
export const isMap = (data) => data !== null && typeof data === "object" && !Array.isArray(data);

export function readYaml(text) {
  const data = parse(text);
  if (!isMap(data)) throw new Error("it is not a list of fields");
  return data;
}
