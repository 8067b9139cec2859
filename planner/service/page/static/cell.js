// The choice of a cell, and what is in the one that was chosen.
import { $, h } from "./dom.js";
import { labelOf } from "./words.js";

const toolsOf = (cell) => (cell?.arms ?? []).map((arm) => arm?.tool?.kind).sort().join();
const robotName = (robot) => String(robot ?? "").toUpperCase().replaceAll("_", " ");

export function drawCells(state, cells, choose) {
  const now = JSON.stringify(state.problem.cell);
  const known = Object.entries(cells);
  const chosen = known.find(([, cell]) => JSON.stringify(cell) === now)?.[0];
  const alike = known.filter(([, cell]) => toolsOf(cell) === toolsOf(state.origin.cell));
  const other = known.filter(([, cell]) => toolsOf(cell) !== toolsOf(state.origin.cell));
  const option = ([name, cell]) => h("option", { value: name, selected: name === chosen }, `${name}: ${(cell.arms ?? []).map((arm) => robotName(arm.robot)).join(" and ")}`);
  const select = $("cell");
  select.replaceChildren(
    ...(chosen ? [] : [h("option", { value: "" }, "as in the problem")]),
    ...(alike.length ? [h("optgroup", { label: "With the same tools" }, alike.map(option))] : []),
    h("optgroup", { label: "With other tools" }, other.map(option)),
  );
  select.onchange = () => select.value && choose(select.value);
  const arms = Array.isArray(state.problem.cell?.arms) ? state.problem.cell.arms : [];
  $("arms").replaceChildren(
    ...arms.map((arm) => h("li", {}, h("b", {}, String(arm?.name ?? "")), h("span", {}, robotName(arm?.robot)), h("span", { class: "soft" }, labelOf(String(arm?.tool?.kind ?? "no tool"))))),
    ...(state.problem.cell?.obstacles?.length ? [h("li", {}, h("span", { class: "soft" }, `${state.problem.cell.obstacles.length} fixed ${state.problem.cell.obstacles.length > 1 ? "bodies" : "body"}: ${state.problem.cell.obstacles.map((one) => one.name).join(", ")}`))] : []),
  );
}

// Puts another cell in; operations whose arms it has not get its arms in order.
export function takeCell(problem, cell) {
  problem.cell = structuredClone(cell);
  const names = cell.arms.map((arm) => arm.name);
  for (const operation of problem.operations ?? []) {
    if (!Array.isArray(operation.arms) || operation.arms.every((name) => names.includes(name))) continue;
    operation.arms = operation.arms.map((name, i) => names[i] ?? name);
  }
}
