// Where a new job begins: a process with its bundled problems, a file of one's own, or an earlier job.
import { blob, fileOf, job as pathOf, json, text } from "./api.js";
import { $, h, show, svg } from "./dom.js";
import { PROCESSES } from "./words.js";
import { readYaml } from "./yaml.js";

const PICTURES = {
  elastic_wire: ["M8 34V16l8-6M48 34V16l-8-6", "M16 10c3 20 21 20 24 0"],
  straight_wire: ["M10 34V18l9-8h22M41 10v18", "M19 10v18h22"],
  forming: ["M4 14h14M38 14h14M28 4v14", "M18 14c2 14 5 18 10 18s8-4 10-18"],
  milling: ["M22 4h12v10H22zM25 14v10h6V14", "M6 34c8-10 14-10 22-8s16 0 22-8"],
  targets: ["M10 30h8M14 26v8M24 18h8M28 14v8M40 24h8M44 20v8", "M14 30L28 18 44 24"],
};

export function drawProcesses(chosen, choose) {
  const shown = document.querySelectorAll("input[name=process]");
  for (const input of shown) input.checked = input.value === chosen;
  if (shown.length) return; // drawn once, so that the keyboard stays where it is
  $("processes").replaceChildren(
    ...Object.entries(PROCESSES).map(([name, [title, about]]) =>
      h("label", { class: "process" },
        h("input", { type: "radio", name: "process", value: name, checked: name === chosen, onchange: () => choose(name) }),
        svg("svg", { viewBox: "0 0 56 38", "aria-hidden": "true" }, svg("path", { d: PICTURES[name][0] }), svg("path", { d: PICTURES[name][1], class: "work" })),
        h("b", {}, title), h("span", { class: "soft" }, about)),
    ),
  );
}

export function drawExamples(all, process, chosen, choose) {
  const some = Object.entries(all).filter(([, one]) => one.processes.includes(process));
  const robots = (one) => [...new Set(one.robots)].map((name) => name.toUpperCase().replaceAll("_", " ")).join(", ");
  const option = ([key, one]) => h("option", { value: key, selected: key === chosen }, `${key} (${one.robots.length === 2 ? "2 arms: " : ""}${robots(one)})`);
  const select = $("example");
  const none = some.filter(([, one]) => !one.feasible);
  select.replaceChildren(
    ...(chosen && all[chosen] ? [] : [h("option", { value: "" }, "choose one")]),
    h("optgroup", { label: "Problems with a plan" }, some.filter(([, one]) => one.feasible).map(option)),
    ...(none.length ? [h("optgroup", { label: "Problems without a plan, to see their issues" }, none.map(option))] : []),
  );
  select.onchange = () => choose(select.value);
  $("about").textContent = all[chosen]?.about ?? "";
  show($("start"), some.length > 0);
  return some;
}

// {problem, files, cell, source} of a bundled problem.
export async function fromExample(name) {
  const found = await json(`/ui/example?name=${encodeURIComponent(name)}`);
  const files = await Promise.all(found.files.map(async (file) => [file, await blob(`/ui/example/file?name=${encodeURIComponent(name)}&file=${encodeURIComponent(file)}`)]));
  return { problem: found.problem, files: new Map(files), cell: found.cell, source: `from the bundled problem ${name}` };
}

// The same of an earlier job.
export async function fromJob(id) {
  const [about, listed, body] = await Promise.all([json(pathOf(id)), json(`${pathOf(id)}/files`), text(fileOf(id, "problem/problem.yaml"))]);
  const names = listed.files.map((file) => file.name).filter((name) => name.startsWith("problem/") && name !== "problem/problem.yaml");
  const files = await Promise.all(names.map(async (name) => [name.slice("problem/".length), await blob(fileOf(id, name))]));
  return { problem: readYaml(body), files: new Map(files), cell: "", source: `from the job ${about.name} (${id.slice(0, 6)})` };
}

// The same of a problem file and what was chosen with it; throws where the text is no problem.
export async function fromFiles(chosen) {
  const body = chosen.find((file) => /\.(ya?ml|json)$/i.test(file.name));
  if (!body) throw new Error("a problem file ends in .yaml, .yml or .json; choose it, and its files with it");
  const problem = readYaml(await body.text());
  const rest = chosen.filter((file) => file !== body);
  if (typeof problem.cell === "string") {
    const name = problem.cell.split("/").pop();
    const cell = rest.find((file) => file.name === name);
    if (cell) problem.cell = readYaml(await cell.text());
  }
  return { problem, files: new Map(rest.map((file) => [file.name, file])), cell: "", source: `from the file ${body.name}` };
}
