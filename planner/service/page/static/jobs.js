// The history: found by words and tags, by state, sorted; jobs can be marked, two for comparison, any to be deleted.
import { json, post } from "./api.js";
import { ask } from "./ask.js";
import { age, banner, me, reached, ready, tell } from "./common.js";
import { $, announce, h, icon, later, show } from "./dom.js";
import { badge } from "./outcome.js";
import { thumbnail } from "./thumbnail.js";
import { AGAIN, ago, bytes, duration, isOpen, number, processName } from "./words.js";

const GROUPS = [
  ["All", []],
  ["Under way", ["queued", "running"]],
  ["Queue", ["queued"]],
  ["Verified", ["verified"]],
  ["No plan", ["infeasible", "bad_input", "unproven"]],
  ["Stopped", ["crashed", "timeout", "memory", "cancelled"]],
];
const EVERY = 1500;
const SELDOM = 5000; // where nothing is under way: somebody else may send a job
let drawn = "";
const asked = new URLSearchParams(location.search);
let group = Math.max(GROUPS.findIndex(([name]) => name === asked.get("show")), 0);
let tags = asked.getAll("tag");
let turn = 0; // of what was asked last; answers to former questions are dropped
let jobs = new Map();
let next = null;
const marked = [];
const pictures = new Map();
let own; // jobs of others say whose they are
let reads = false; // what is released, and no more

function query(cursor) {
  const given = new URLSearchParams({ limit: 50, sort: GROUPS[group][0] === "Queue" ? "turn" : $("sort").value });
  for (const state of GROUPS[group][1]) given.append("state", state);
  for (const tag of tags) given.append("tag", tag);
  if ($("search").value.trim()) given.append("search", $("search").value.trim());
  if (cursor) given.append("cursor", cursor);
  return `/v1/jobs?${given}`;
}
const narrowed = () => group !== 0 || tags.length > 0 || Boolean($("search").value.trim());

async function load(cursor = null) {
  const mine = turn;
  const page = await json(query(cursor));
  const who = await me;
  [own, reads] = [who?.name, who?.scope === "released"];
  if (mine !== turn) return;
  if (!cursor) jobs = new Map([...page.jobs.map((one) => [one.id, one]), ...[...jobs].filter(([id]) => jobs.size > 50 && !page.jobs.some((one) => one.id === id))]);
  else for (const one of page.jobs) jobs.set(one.id, one);
  if (cursor || jobs.size <= 50) next = page.next ?? null;
  const now = JSON.stringify([[...jobs.values()], next, query()]);
  if (now !== drawn) draw();
  else for (const time of document.querySelectorAll("#rows time")) time.textContent = ago(time.dateTime); // what is marked stays
  drawn = now;
  reached();
}

function draw() {
  const all = [...jobs.values()];
  show($("table"), all.length > 0);
  show($("empty"), !all.length && !narrowed() && !reads);
  show($("unreleased"), !all.length && !narrowed() && reads);
  show($("none"), !all.length && narrowed());
  show($("older"), Boolean(next));
  const focus = document.activeElement?.dataset.key;
  $("rows").replaceChildren(...all.map(row));
  if (focus) document.querySelector(`[data-key="${CSS.escape(focus)}"]`)?.focus();
}

function row(one) {
  const figure = (name, show) => (one.metrics?.[name] === undefined ? "" : show(one.metrics[name]));
  const wrong = (one.issues ?? []).filter((issue) => (issue.severity ?? "error") === "error").length;
  const warned = (one.issues ?? []).filter((issue) => issue.severity === "warning").length;
  const box = h("input", { type: "checkbox", checked: marked.includes(one.id), data: { key: `box-${one.id}` }, "aria-label": `Choose ${one.title || one.name}`, onchange: () => mark(one.id, box.checked) });
  const count = [wrong && `${wrong} error${wrong > 1 ? "s" : ""}`, warned && `${warned} warning${warned > 1 ? "s" : ""}`].filter(Boolean).join(", ");
  const running = one.state === "running" && one.stage;
  return h(
    "tr",
    {},
    h("td", { class: "beyond" }, box),
    h("td", {}, h("div", { class: "pictured" }, picture(one), h("div", {}, h("a", { href: `/ui/jobs/${one.id}`, class: "job-name", title: one.title || one.name, data: { key: one.id } }, h("bdi", {}, one.title || one.name)), (one.tags ?? []).map((tag) => h("button", { type: "button", class: "tag", onclick: () => narrow([...new Set([...tags, tag])]) }, h("bdi", {}, tag))), h("span", { class: "sub" }, [one.title ? one.name : null, one.by && one.by !== own ? `by ${one.by}` : null, one.from_store ? "answered from the store" : one.id.slice(0, 8)].filter(Boolean).join(", "))))),
    h("td", {}, badge(one.state), AGAIN.includes(one.state) ? h("button", { type: "button", class: "small plans", data: { key: `again-${one.id}` }, "aria-label": `Try ${one.title || one.name} again`, onclick: () => act(one, "retry", "is queued again") }, "Try again") : null, h("span", { class: "sub" }, running ? `${one.stage}, ${Math.round(100 * one.fraction)} %` : one.state === "queued" ? place(one) : [one.released && "released", count].filter(Boolean).join(", "))),
    h("td", { class: "wide" }, one.processes.map(processName).join(", ")),
    h("td", { class: "n" }, figure("cycle_s", duration)),
    h("td", { class: "n wider" }, figure("clearance_mm", (v) => `${number(v, 3)} mm`)),
    h("td", { class: "n wider" }, one.seconds ? duration(one.seconds) : ""),
    h("td", {}, age(one.created)),
  );
}

// The one that was drawn before, where it shows the same: so it is not fetched anew with each look at the list.
function picture(one) {
  const shows = JSON.stringify([one.thumbnail, one.title || one.name, one.processes]);
  const drawn = pictures.get(one.id);
  if (drawn?.shows === shows && drawn.element.isConnected) return drawn.element;
  const element = thumbnail(one);
  pictures.set(one.id, { shows, element });
  return element;
}

// Where it stands among all that wait, and the way to the front of one's own.
function place(one) {
  const first = GROUPS[group][0] === "Queue" && one.ahead > 0;
  return [`position ${(one.ahead ?? 0) + 1} in the queue`, first ? h("button", { type: "button", class: "small plans", data: { key: `first-${one.id}` }, "aria-label": `Plan ${one.title || one.name} next`, onclick: () => act(one, "first", "is planned next") }, "Plan it next") : null];
}

async function act(one, what, said) {
  banner("");
  await post(`/v1/jobs/${one.id}/${what}`).then(() => announce(`${one.title || one.name} ${said}`), tell);
  await load().catch(tell);
}

function mark(id, on) {
  if (on) marked.push(id);
  else marked.splice(marked.indexOf(id), 1);
  choices();
}

function choices() {
  const seen = marked.filter((id) => jobs.has(id)).length; // what is not seen is not deleted
  show($("delete"), seen > 0);
  $("delete").replaceChildren(icon("bin"), `Delete ${seen === 1 ? "it" : seen}`);
  show($("compare"), marked.length === 2);
  if (marked.length === 2) {
    $("compare").href = `/ui/compare?a=${marked[0]}&b=${marked[1]}`;
    announce("Two jobs are selected and can be compared now");
  }
}

function filters() {
  $("filters").replaceChildren(
    ...GROUPS.map(([name], i) =>
      h("button", { type: "button", class: "chip", "aria-pressed": String(i === group), onclick: () => choose(i) }, name),
    ),
  );
}

function narrow(some) {
  tags = some;
  show($("tags"), tags.length > 0);
  $("tags").replaceChildren("With the tags", ...tags.map((tag) => h("button", { type: "button", class: "chip", "aria-label": `Without the tag ${tag}`, onclick: () => narrow(tags.filter((one) => one !== tag)) }, h("bdi", {}, tag), icon("cross"))));
  anew();
}

// Asks anew, from the first page on, and keeps in the address what was asked.
function anew() {
  banner("");
  turn += 1;
  jobs = new Map();
  next = null;
  const kept = new URLSearchParams();
  if (group) kept.append("show", GROUPS[group][0]);
  for (const tag of tags) kept.append("tag", tag);
  if ($("search").value.trim()) kept.append("search", $("search").value.trim());
  if ($("sort").value !== "newest") kept.append("sort", $("sort").value);
  history.replaceState(null, "", kept.size ? `/?${kept}` : "/");
  return load().then(choices).catch(tell);
}

async function removeMarked() {
  const some = marked.filter((id) => jobs.has(id)).slice(0, 200);
  const released = some.filter((id) => jobs.get(id)?.released).length;
  const text = `Programs, reports and problems of ${some.length === 1 ? "this job" : `these ${some.length} jobs`} are deleted too.${released ? ` ${released} of them ${released === 1 ? "is" : "are"} released.` : ""}`;
  if (!(await ask(text, `Delete ${some.length}`))) return;
  try {
    await post("/v1/jobs/delete", { body: JSON.stringify({ jobs: some }), headers: { "Content-Type": "application/json" } });
    for (const id of some) marked.splice(marked.indexOf(id), 1);
    announce(`${some.length} deleted`);
    await anew();
    await room();
  } catch (error) {
    tell(error);
  }
}

async function room() {
  if ((await me)?.scope === "released") return; // has no files of its own, and may not ask
  const { used_mb: used, limit_mb: limit } = await json("/v1/storage");
  show($("room"), jobs.size > 0);
  $("room").textContent = `The files of your jobs take ${bytes(1e6 * used)} of ${bytes(1e6 * limit)}. Deleting jobs frees space.`;
}

async function choose(i) {
  group = i;
  filters();
  $("filters").children[i].focus();
  await anew();
}

async function again() {
  try {
    if (!document.hidden) await load();
  } catch (error) {
    tell(error, true);
  } finally {
    setTimeout(again, [...jobs.values()].some((one) => isOpen(one.state)) || !$("banner").hidden ? EVERY : SELDOM);
  }
}

$("search").value = asked.get("search") ?? "";
if (["oldest", "title"].includes(asked.get("sort"))) $("sort").value = asked.get("sort");
$("search").addEventListener("input", later(250, anew));
$("sort").addEventListener("change", anew);
$("delete").addEventListener("click", removeMarked);
$("older").addEventListener("click", () => load(next).catch(tell));
filters();
ready();
if (tags.length) narrow(tags);
await load().then(room).catch((error) => tell(error, true));
setTimeout(again, EVERY);
addEventListener("visibilitychange", () => !document.hidden && load().catch(tell));

