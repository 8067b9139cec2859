// The history: newest first, by state; two can be marked for comparison.
import { json } from "./api.js";
import { badge, banner, me, tell } from "./common.js";
import { $, announce, h, show } from "./dom.js";
import { ago, bytes, duration, isOpen, number, processName } from "./words.js";

const GROUPS = [
  ["All", []],
  ["Under way", ["queued", "running"]],
  ["Verified", ["verified"]],
  ["No plan", ["infeasible", "bad_input", "unproven"]],
  ["Stopped", ["crashed", "timeout", "memory", "cancelled"]],
];
const EVERY = 1500;
const SELDOM = 5000; // where nothing is under way: somebody else may send a job
let drawn = "";
let group = Math.max(GROUPS.findIndex(([name]) => name === new URLSearchParams(location.search).get("show")), 0);
let jobs = new Map();
let next = null;
const marked = [];
const own = (await me)?.name; // jobs of others say whose they are

const query = (cursor) => `/v1/jobs?limit=50${GROUPS[group][1].map((s) => `&state=${s}`).join("")}${cursor ? `&cursor=${cursor}` : ""}`;

async function load(cursor = null) {
  const page = await json(query(cursor));
  if (!cursor) jobs = new Map([...page.jobs.map((one) => [one.id, one]), ...[...jobs].filter(([id]) => jobs.size > 50 && !page.jobs.some((one) => one.id === id))]);
  else for (const one of page.jobs) jobs.set(one.id, one);
  if (cursor || jobs.size <= 50) next = page.next ?? null;
  const now = JSON.stringify([[...jobs.values()], next, group]);
  if (now !== drawn) draw();
  else for (const time of document.querySelectorAll("#rows time")) time.textContent = ago(time.dateTime); // what is marked stays
  drawn = now;
  banner("");
}

function draw() {
  const all = [...jobs.values()];
  show($("table"), all.length > 0);
  show($("empty"), !all.length && group === 0);
  show($("none"), !all.length && group !== 0);
  show($("older"), Boolean(next));
  const focus = document.activeElement?.dataset.key;
  $("rows").replaceChildren(...all.map(row));
  if (focus) document.querySelector(`[data-key="${CSS.escape(focus)}"]`)?.focus();
}

function row(one) {
  const figure = (name, show) => (one.metrics?.[name] === undefined ? "" : show(one.metrics[name]));
  const wrong = (one.issues ?? []).filter((issue) => (issue.severity ?? "error") === "error").length;
  const warned = (one.issues ?? []).filter((issue) => issue.severity === "warning").length;
  const box = h("input", { type: "checkbox", checked: marked.includes(one.id), data: { key: `box-${one.id}` }, "aria-label": `Choose ${one.name} for comparison`, onchange: () => mark(one.id, box.checked) });
  const count = [wrong && `${wrong} error${wrong > 1 ? "s" : ""}`, warned && `${warned} warning${warned > 1 ? "s" : ""}`].filter(Boolean).join(", ");
  const running = one.state === "running" && one.stage;
  return h(
    "tr",
    {},
    h("td", {}, box),
    h("td", {}, h("a", { href: `/ui/jobs/${one.id}`, class: "job-name", data: { key: one.id } }, one.name), h("span", { class: "sub" }, [one.by && one.by !== own ? `of ${one.by}` : null, one.from_store ? "answered from the store" : one.id.slice(0, 8)].filter(Boolean).join(", "))),
    h("td", {}, badge(one.state), h("span", { class: "sub" }, running ? `${one.stage}, ${Math.round(100 * one.fraction)} %` : [one.released && "released", count].filter(Boolean).join(", "))),
    h("td", { class: "wide" }, one.processes.map(processName).join(", ")),
    h("td", { class: "n" }, figure("cycle_s", duration)),
    h("td", { class: "n wider" }, figure("clearance_mm", (v) => `${number(v, 3)} mm`)),
    h("td", { class: "n wider" }, one.seconds ? duration(one.seconds) : ""),
    h("td", {}, h("time", { dateTime: one.created, title: new Date(one.created).toLocaleString("en-GB") }, ago(one.created))),
  );
}

function mark(id, on) {
  if (on) marked.push(id);
  else marked.splice(marked.indexOf(id), 1);
  while (marked.length > 2) marked.shift();
  draw();
  show($("compare"), marked.length === 2);
  if (marked.length === 2) {
    $("compare").href = `/ui/compare?a=${marked[0]}&b=${marked[1]}`;
    announce("Two jobs are chosen; they can be compared now");
  }
}

function filters() {
  $("filters").replaceChildren(
    ...GROUPS.map(([name], i) =>
      h("button", { type: "button", class: "chip", "aria-pressed": String(i === group), onclick: () => choose(i) }, name),
    ),
  );
}

async function room() {
  const { used_mb: used, limit_mb: limit } = await json("/v1/storage");
  show($("room"), jobs.size > 0);
  $("room").textContent = `The files of your jobs take ${bytes(1e6 * used)} of ${bytes(1e6 * limit)}; deleted jobs give theirs back.`;
}

async function choose(i) {
  group = i;
  jobs = new Map();
  filters();
  history.replaceState(null, "", i ? `/?show=${encodeURIComponent(GROUPS[i][0])}` : "/");
  $("filters").children[i].focus();
  await load().catch(tell);
}

async function again() {
  try {
    if (!document.hidden) await load();
  } catch (error) {
    tell(error);
  } finally {
    setTimeout(again, [...jobs.values()].some((one) => isOpen(one.state)) || !$("banner").hidden ? EVERY : SELDOM);
  }
}

$("older").addEventListener("click", () => load(next).catch(tell));
filters();
await load().then(room).catch(tell);
setTimeout(again, EVERY);
addEventListener("visibilitychange", () => !document.hidden && load().catch(tell));

