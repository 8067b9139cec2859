// What came of a job: its state, its figures, and in words what to do next. It asks the service for nothing.
import { h } from "./dom.js";
import { errors } from "./issues.js";
import { duration, figureName, figureOrder, number, STATES, unitOf } from "./words.js";

const ENDS = {
  verified: ["ok", "Verified: the programs are proven", "Their very text was replayed and held against the problem: shape, clearance, limits, timing. Read the setup sheet in the report before they run."],
  infeasible: ["bad", "There is no feasible plan for this problem", "Nothing was written for the robots. What stands in the way, where, and what can be done:"],
  bad_input: ["bad", "The problem cannot be planned as it is given", "Correct what is named here and run it again:"],
  unproven: ["bad", "A plan was made, but its proof does not hold", "So no program is given out. What the proof found, each with its moment in the replay:"],
  crashed: ["bad", "Planning failed", "This is not the problem's fault. Try again; if it happens once more, report it with the code below."],
  timeout: ["bad", "Planning took longer than it may", "Fewer targets help most: a larger step, a looser tolerance, or fewer cuts. Or ask for more time."],
  memory: ["bad", "Planning needs more memory than it may have", "Fewer targets help most: a larger step, a looser tolerance, or fewer cuts."],
  cancelled: ["off", "Cancelled", "It was stopped before it ended. Run it again whenever you like."],
};

export function outcomeOf(job, issues) {
  const [kind, title, text] = ENDS[job.state] ?? ["off", job.state, ""];
  const wrong = errors(issues).length;
  const worse = job.state === "infeasible" && !wrong ? " The report tells more." : "";
  return { kind, title, text: text + worse };
}

export function badge(state, element = h("span", {})) {
  const [word, kind] = STATES[state] ?? [state, "off"];
  element.className = `badge ${kind}`;
  element.replaceChildren(h("i", { "aria-hidden": "true" }), word);
  return element;
}

// A tile for each figure of a job.
export function tiles(metrics) {
  return figureOrder(Object.keys(metrics ?? {})).map((name) => {
    const unit = unitOf(name);
    const value = name === "cycle_s" ? duration(metrics[name]) : number(metrics[name]);
    return h("div", { class: "tile" }, h("dt", {}, figureName(name)), h("dd", {}, value, unit && name !== "cycle_s" ? h("small", {}, ` ${unit}`) : null));
  });
}
