// Issues as people read them, in lists and at the fields that they name.
import { h, icon } from "./dom.js";
import { clock, labelOf, number } from "./words.js";

const ICON = { error: "cross", warning: "warning", note: "note" };
const WORD = { error: "Error", warning: "Warning", note: "Note" };
const RANK = { error: 0, warning: 1, note: 2 };

export const sorted = (issues) => [...issues].sort((a, b) => RANK[severity(a)] - RANK[severity(b)]);
export const severity = (issue) => issue.severity ?? "error";
export const errors = (issues) => issues.filter((issue) => severity(issue) === "error");

// One issue; at: {seek(time), edit(field)} where the page can go there, {removes(field), remove(field)} for what is none
// of the form's fields.
export function issueItem(issue, at = {}) {
  const kind = severity(issue);
  const where = [
    issue.arm && ["arm", issue.arm],
    issue.target ? ["target", issue.target] : issue.index !== undefined && ["target", String(issue.index)],
    issue.bodies?.length && [issue.bodies.length > 1 ? "between" : "at", issue.bodies.join(" and ")],
    issue.value !== undefined && ["value", measure(issue.value, issue.unit)],
    issue.limit !== undefined && ["limit", measure(issue.limit, issue.unit)],
    issue.line !== undefined && ["line", String(issue.line)],
    issue.count > 1 && ["times", String(issue.count)],
  ].filter(Boolean);
  const actions = [
    issue.time !== undefined && at.seek && h("button", { type: "button", class: "small", onclick: () => at.seek(issue) }, icon("play"), `Show at ${clock(issue.time)}`),
    issue.field && at.removes?.(issue.field) && h("button", { type: "button", class: "small", onclick: () => at.remove(issue.field) }, icon("bin"), "Remove it"),
    issue.field && issue.time === undefined && at.edit && !at.removes?.(issue.field) && h("button", { type: "button", class: "small", onclick: () => at.edit(issue.field) }, at.editText ?? "Go to the field"),
  ].filter(Boolean);
  return h(
    "li",
    { class: `issue ${kind}` },
    h("span", { class: "mark", title: WORD[kind] }, icon(ICON[kind]), h("span", { class: "unseen" }, WORD[kind])),
    h(
      "div",
      {},
      h("p", { class: "message" }, issue.accepted ? h("b", {}, "Accepted by the problem: ") : null, withoutField(issue)),
      issue.hint ? h("p", { class: "hint" }, h("b", {}, "What to do: "), sentence(issue.hint)) : null,
      h("p", { class: "where" }, h("code", {}, issue.code), issue.field ? h("span", {}, issue.time === undefined ? "field " : "during ", h("b", {}, issue.time === undefined ? fieldName(issue.field) : issue.field)) : null, where.map(([what, value]) => h("span", {}, `${what} `, h("b", {}, value)))),
      actions.length ? h("div", { class: "actions" }, actions) : null,
    ),
  );
}

export function issueList(issues, at) {
  return h("ul", { class: "issues" }, sorted(issues).map((issue) => issueItem(issue, at)));
}

const measure = (value, unit) => `${number(value)}${unit ? ` ${unit.replace("^2", "²").replace("^3", "³")}` : ""}`;
const sentence = (text) => (/^[a-z]+[ ,:]/.test(text ?? "") ? text.charAt(0).toUpperCase() + text.slice(1) : text ?? "");
export const fieldName = (field) => field.split(".").map((step) => (/^\d+$/.test(step) ? String(+step + 1) : labelOf(step).toLowerCase())).join(" › ");

// The innermost place of the form that an issue's field is in; planning names fields of an operation alone.
export function placeOf(field) {
  const own = inForm((field ?? "").split("."));
  if (own || !field) return own;
  const operations = document.querySelectorAll('.item[data-path^="operations."]').length;
  for (let i = 0; i < operations; i++) {
    const found = document.querySelector(`[data-path="${CSS.escape(`operations.${i}.${field}`)}"]`) ?? document.querySelector(`[data-path="${CSS.escape(`operations.${i}.${field.split(".")[0]}`)}"]`);
    if (found) return found;
  }
  return null;
}

function inForm(steps) {
  for (let n = steps.length; n > 0; n--) {
    const found = document.querySelector(`[data-path="${CSS.escape(steps.slice(0, n).join("."))}"]`);
    if (found) return found;
  }
  return null;
}

// Shows each issue at its field; gives back those that have none.
export function atFields(issues) {
  for (const old of document.querySelectorAll(".faults")) old.replaceChildren();
  for (const old of document.querySelectorAll("[aria-invalid]")) old.removeAttribute("aria-invalid");
  for (const old of document.querySelectorAll(".has-fault")) old.classList.remove("has-fault");
  const homeless = [];
  for (const issue of issues) {
    const place = placeOf(issue.field);
    const faults = place?.querySelector(":scope > .faults");
    if (!faults) {
      homeless.push(issue);
      continue;
    }
    const kind = severity(issue);
    faults.append(h("p", { class: `fault ${kind}` }, icon(ICON[kind]), h("span", {}, withoutField(issue), issue.hint ? h("span", { class: "soft" }, ` ${sentence(issue.hint)}`) : null)));
    if (kind === "error") {
      place.classList.add("has-fault");
      place.querySelector("input, select, textarea")?.setAttribute("aria-invalid", "true");
      for (let up = place.closest("details"); up; up = up.parentElement.closest("details")) up.open = true;
    }
  }
  return homeless;
}

function withoutField(issue) {
  const start = `${issue.field}: `;
  return sentence(issue.message.startsWith(start) ? issue.message.slice(start.length) : issue.message);
}

// Brings the place of a field into view, with the cursor in it.
export function goTo(field) {
  const place = placeOf(field);
  if (!place) return;
  for (let up = place.closest("details"); up; up = up.parentElement.closest("details")) up.open = true;
  place.scrollIntoView({ block: "center", behavior: matchMedia("(prefers-reduced-motion: reduce)").matches ? "auto" : "smooth" });
  place.querySelector("input, select, textarea, button, summary")?.focus({ preventScroll: true });
  place.classList.add("flash");
  setTimeout(() => place.classList.remove("flash"), 1600);
}
