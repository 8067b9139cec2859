// The files of a problem: which ones it names, where a new one belongs, and what units make of a mesh.
import { banner } from "./common.js";
import { $, h, icon, show } from "./dom.js";
import { boxOf, isMesh, readMesh } from "./mesh.js";
import { at, put } from "./schema.js";
import { bytes, number } from "./words.js";

const UNITS = { mm: 1, cm: 10, m: 1000, in: 25.4, ft: 304.8 };

// What was chosen or dropped, as it is now: browsers send no file that was written anew since. Tells what cannot be
// read, as folders; then there is none of it.
export async function held(chosen) {
  const unread = [];
  const read = async (file) => {
    try {
      return new File([await file.arrayBuffer()], file.name, { type: file.type });
    } catch {
      unread.push(file.name);
      return null;
    }
  };
  const found = await Promise.all(chosen.map(read));
  if (!unread.length) return found;
  banner(`${unread.join(", ")} cannot be read. Choose files, not folders, and select moved or changed files again.`);
  return [];
}

// [path, object] of everything in the data that names a file.
export function naming(data, path = []) {
  if (data === null || typeof data !== "object") return [];
  const own = !Array.isArray(data) && "file" in data ? [[path, data]] : [];
  return [...own, ...Object.entries(data).flatMap(([key, value]) => naming(value, [...path, Array.isArray(data) ? Number(key) : key]))];
}

// The last step of a file's name, by which uploads are found.
export const lastOf = (name) => String(name).split(/[/\\]/).pop();

// The field that names the file that an issue is about.
export function fieldOfFile(problem, issue) {
  const found = naming(problem).find(([, one]) => one.file && (lastOf(one.file) === lastOf(issue.file ?? "") || issue.message.startsWith(`${lastOf(one.file)}:`)));
  return found && [...found[0], issue.code === "mesh.unit" ? "unit" : "file"].join(".");
}

// The files that the problem names, of those that are at hand.
export function wanted(state) {
  const names = new Set(naming(state.problem).map(([, one]) => one.file));
  const lasts = new Set([...names].map(lastOf));
  return [...state.files].filter(([name]) => names.has(name) || lasts.has(lastOf(name)));
}

// Puts a file where the process wants its part; the path of what names it now, or null if nothing does.
export function assign(problem, name, process) {
  const named = naming(problem);
  const same = named.find(([, one]) => lastOf(one.file) === lastOf(name));
  if (same) {
    same[1].file = name;
    return same[0];
  }
  const end = name.split(".").pop().toLowerCase();
  const operation = problem.operations?.[0] ?? {};
  const swap = (path, ends) => {
    const found = named.find(([place, one]) => startsWith(place, path) && ends.includes(String(one.file ?? "").split(".").pop().toLowerCase()));
    if (found) found[1].file = name;
    return found?.[0];
  };
  const make = (path, value) => {
    put(problem, path, value);
    return path;
  };
  if (isMesh(name)) {
    const found = swap(["part"], ["obj", "stl", "ply", ""]);
    if (found) {
      delete at(problem, found).unit; // another file has another unit: it has to be said
      return found;
    }
    if (process === "forming") return make(["part"], { sheet_mesh: { file: name, face: "top" } }).concat("sheet_mesh");
    if (process === "straight_wire") return make(["part"], { mesh: { file: name } }).concat("mesh");
    return make(["part", "front"], { mesh: { file: name } }).concat("mesh");
  }
  if (end === "dxf") return swap(["part"], ["dxf"]) ?? make(["part"], { plate: { dxf: { file: name, unit: "mm" } } }).concat("plate", "dxf");
  if (["nc", "gcode", "ngc", "tap"].includes(end)) return swap(["operations"], ["nc", "gcode", "ngc", "tap"]) ?? null;
  if (["csv", "txt"].includes(end) && operation.process === "targets") return make(["operations", 0, "file"], name).slice(0, 2);
  return swap([], [end]) ?? null;
}

const startsWith = (path, start) => start.every((step, i) => path[i] === step);

export function drawFiles(state, removed) {
  const names = new Set(wanted(state).map(([name]) => name));
  $("file-list").replaceChildren(
    ...[...state.files].map(([name, file]) =>
      h("li", {}, icon("file"), h("b", {}, name.split("/").pop()), h("span", { class: "soft" }, bytes(file.size)), names.has(name) ? null : h("span", { class: "tag" }, "not used by the problem"), h("span", { class: "stretch" }), h("button", { type: "button", class: "round", "aria-label": `Remove ${name}`, onclick: () => removed(name) }, icon("cross"))),
    ),
  );
}

// The part's mesh as its file has it: {path, mesh, name}, or null; reads each file once.
const read = new Map();
export async function partMesh(state) {
  for (const [path, one] of naming(state.problem.part, ["part"])) {
    const file = state.files.get(one.file);
    if (!file || !isMesh(one.file)) continue;
    if (!read.has(file)) read.set(file, await readMesh(file, one.file).catch((error) => ({ error: error.message })));
    return { path, name: one.file, mesh: read.get(file), unit: one.unit, scale: one.scale ?? 1 };
  }
  return null;
}

export function sizeText(box) {
  return `${[0, 1, 2].map((i) => number(box[1][i] - box[0][i])).join(" × ")} mm`;
}

// The mesh in mm, for the picture.
export function inUnit(found) {
  const factor = (UNITS[found.unit] ?? 1) * found.scale;
  return { kind: "part", vertices: found.mesh.vertices.map((v) => v * factor), faces: found.mesh.faces };
}

// A choice of unit that shows what size each one makes of the part.
export function drawUnits(state, found, choose) {
  const place = $("units");
  show(place, Boolean(found));
  if (!found) return;
  if (found.mesh.error) {
    place.replaceChildren(h("p", { class: "help" }, `${found.name.split("/").pop()} cannot be drawn: ${found.mesh.error}. The check still reads it.`));
    return;
  }
  const box = boxOf(found.mesh.vertices);
  const span = Math.max(...[0, 1, 2].map((i) => box[1][i] - box[0][i])) * found.scale;
  const stock = state.problem.sheet?.size_mm ?? state.problem.stock?.size_mm ?? [];
  const room = Math.max(...stock.filter((v) => typeof v === "number"), 0);
  const odd = (unit) => {
    const size = span * UNITS[unit];
    if (size < 1) return "far too small";
    if (size > 20000) return "far too large";
    if (room && size > 1.6 * room) return "larger than the stock";
    if (room && size < 0.03 * room) return "tiny in this stock";
    return "";
  };
  const focused = document.activeElement?.closest?.("#units") ? document.activeElement.value : null;
  place.replaceChildren(
    h("fieldset", {}, h("legend", {}, `Unit of ${found.name.split("/").pop()}`), h("p", { class: "help" }, "Mesh files do not state their unit. Choose the one that gives the right size."),
      h("div", { class: "unit-rows" }, Object.keys(UNITS).map((unit) => h("label", { class: "unit-row" },
        h("input", { type: "radio", name: "mesh-unit", value: unit, checked: found.unit === unit, onchange: () => choose([...found.path, "unit"], unit) }),
        h("b", {}, unit), h("span", {}, sizeText(box.map((c) => c.map((v) => v * UNITS[unit] * found.scale)))), h("span", { class: "odd" }, odd(unit)))))),
  );
  if (focused) place.querySelector(`input[value="${focused}"]`)?.focus();
}
