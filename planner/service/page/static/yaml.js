// Problem files as data, by the same rules of YAML 1.1 that the service reads them by.
import { load, YAML11_SCHEMA } from "./vendor/js-yaml.mjs";

export function readYaml(text) {
  const data = load(text, { schema: YAML11_SCHEMA });
  if (data === null || typeof data !== "object" || Array.isArray(data)) throw new Error("it is not a list of fields");
  return data;
}
