// What came of a job: its state, its figures, and in words what to do next. It asks the service for nothing.
import { h } from "./dom.js";
import { errors } from "./issues.js";
import { duration, figureName, figureOrder, number, STATES, unitOf } from "./words.js";

const ENDS = {
  verified: ["ok", "Verified: the programs are proven", "Their text was replayed and compared with the problem: shape, clearance, limits, timing. Read the setup sheet in the report before you run them."],
  infeasible: ["bad", "There is no feasible plan for this problem", "No programs were written. These issues prevent a plan:"],
  bad_input: ["bad", "The problem has errors", "Correct these issues and run it again:"],
  unproven: ["bad", "A plan exists, but its proof failed", "Therefore no programs are available. Findings of the proof, each with its time in the replay:"],
  crashed: ["bad", "Planning failed", "The problem is not the cause. Try again. If it fails again, report it with the code below."],
  timeout: ["bad", "Planning exceeded its time limit", "Reduce the number of targets: a larger step, a looser tolerance, or fewer cuts. Or request more time."],
  memory: ["bad", "Planning exceeded its memory limit", "Reduce the number of targets: a larger step, a looser tolerance, or fewer cuts."],
  cancelled: ["off", "Cancelled", "The job was stopped before it ended. You can run it again."],
};

export function outcomeOf(job, issues) {
  const [kind, title, text] = ENDS[job.state] ?? ["off", job.state, ""];
  const wrong = errors(issues).length;
  const worse = job.state === "infeasible" && !wrong ? " See the report." : "";
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
