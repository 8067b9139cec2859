// The jobs of raw blocks: those that cut them apart, and those that cut several panels out of a part together.
import { $, h, icon, show } from "./dom.js";
import { redrawn, workOf } from "./planned.js";
import { number } from "./words.js";

const SHOWN = 20;
let count = SHOWN;
let shown = "";

function row(job, actions) {
  const own = job.id;
  const minutes = Object.values(job.cut_min ?? {}).reduce((sum, one) => sum + one, 0);
  const facts = [`block ${job.block}`, job.said, minutes ? `cuts take about ${number(minutes, 2)} min` : null];
  const done = job.mark === "cut";
  return h("li", { class: `panel ${done ? "mark-cut" : ""}`, data: { job: own } },
    h("div", { class: "who" }, h("div", {}, h("b", {}, own), h("span", { class: "sub" }, facts.filter(Boolean).join(" · ")))),
    workOf(job, actions.plan),
    h("div", { class: "tick" }, h("button", { type: "button", class: "mark-button cut", "aria-pressed": String(done), "aria-label": `Job ${own} cut${job.panels?.length ? `, with ${job.panels.join(", ")}` : ""}`, data: { key: `done-${own}` }, onclick: () => actions.tick(job, "cut") }, done ? icon("check") : null, "Cut")),
  );
}

// jobs: as the service has them; actions: plan(ids) and tick(job, mark).
export function drawBlockJobs(jobs, actions) {
  show($("blocks-card"), jobs.length > 0);
  const key = JSON.stringify([jobs.slice(0, count), jobs.length]);
  if (key === shown) return;
  shown = key;
  show($("more-jobs"), jobs.length > count);
  $("more-jobs").textContent = `Show more jobs (${jobs.length - count} are left)`;
  $("more-jobs").onclick = () => {
    count += SHOWN;
    drawBlockJobs(jobs, actions);
  };
  redrawn($("block-jobs"), jobs.slice(0, count).map((job) => row(job, actions)));
}
