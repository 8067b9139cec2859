// A problem of an element, a panel's own or of a raw block, as lists show it: what became of it, and what can be done.
import { h } from "./dom.js";
import { released } from "./release_panels.js";
import { isOpen } from "./words.js";

const STATE_KIND = { open: "run", not_planned: "", verified: "ok", refused: "bad" };

export const stateOf = (one) => (isOpen(one.state) ? "open" : one.state === "not_planned" || one.state === "cancelled" ? "not_planned" : one.state === "verified" ? "verified" : "refused");
export const stateWords = (one) => ({ open: one.state === "running" ? `planning${one.stage ? `, ${one.stage}` : ""}` : "waiting", not_planned: one.state === "cancelled" ? "cancelled" : "not planned", verified: "verified", refused: "refused" })[stateOf(one)];
// Each problem of an element once: a panel that is cut together with others has that of their job.
export const problemsOf = (element) => [...(element.panels ?? []).filter((panel) => !panel.cut_in), ...(element.block_jobs ?? [])];

// Puts rows into a list; the focus stays at its control, or where that went with a job's beginning, at the job.
export function redrawn(list, rows) {
  const key = document.activeElement?.dataset?.key;
  list.replaceChildren(...rows);
  const found = (name) => list.querySelector(`[data-key="${CSS.escape(name)}"]`);
  if (key) (found(key) ?? found(key.replace(/^plan-/, "job-")))?.focus({ preventScroll: true });
}

// State, links and buttons; plan(ids) is asked for. A panel that is cut in a job with others has a job of its own when it broke.
export function workOf(one, plan) {
  const [state, own] = [stateOf(one), one.id];
  const can = one.cut_in ? one.mark === "broken" : !one.job || ["refused", "not_planned"].includes(state);
  const word = one.cut_in ? "Create own job" : one.job ? "Plan again" : "Create job";
  return h("div", { class: "what" },
    h("span", { class: `badge ${STATE_KIND[state]}` }, h("i", { "aria-hidden": "true" }), stateWords(one).replace(/^./, (c) => c.toUpperCase())),
    one.job ? h("a", { href: `/ui/jobs/${one.job}`, "aria-label": `Job of ${own}`, data: { key: `job-${own}` } }, one.cut_in ? `job ${one.cut_in}` : "job") : null,
    one.state === "verified" ? h("a", { href: `/v1/jobs/${one.job}/programs.zip`, "aria-label": `Programs of ${own}`, data: { key: `programs-${own}` } }, "programs") : null,
    released(one),
    can ? h("button", { type: "button", class: "small", "aria-label": `${word} of ${own}`, data: { key: `plan-${own}` }, onclick: () => plan([own]) }, word) : null,
    one.issue ? h("p", { class: "why" }, h("b", {}, one.issue.code), " ", one.issue.message, one.issue.hint ? h("span", { class: "soft" }, ` What to do: ${one.issue.hint}`) : null) : null,
  );
}
