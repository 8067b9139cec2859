// One building element: divided as its sliders say, its panels as jobs, and the list that is ticked off.
import { fileOf, json, post, Refused, remove, Unreachable } from "./api.js";
import { ask } from "./ask.js";
import { drawBlockJobs } from "./block_jobs.js";
import { banner, ready, tell } from "./common.js";
import { drawDescription, setUpDescription } from "./describe.js";
import { $, announce, h, icon, later, show } from "./dom.js";
import { atFields, goTo, issueItem, placeOf, sorted } from "./issues.js";
import { badge } from "./outcome.js";
import { pictureOf } from "./thumbnail.js";
import { COLOURS, PanelView } from "./panel_view.js";
import { problemsOf, redrawn, stateOf, stateWords, workOf } from "./planned.js";
import { drawReleasePanels, setUpReleasePanels } from "./release_panels.js";
import { Sliders } from "./sliders.js";
import { ago, bytes, duration, isOpen, number, plural } from "./words.js";

const SOON = 1200;
const EACH = 2; // ms more for each panel that an answer has
const SELDOM = 5000;
const SHOWN = 40;
const MARKS = { cut: "Cut", glued: "Glued", broken: "Broken" };
const GROUPS = { all: "All", not_planned: "Not planned", open: "Waiting", verified: "Verified", refused: "Refused", uncut: "To be cut", cut: "Cut", glued: "Glued", broken: "Broken" };
const TITLES = { "element.html": "Page of the element, for printing", "labels.pdf": "Labels at 1:1, to print", "labels.svg": "Labels at 1:1", "panels.csv": "Table of panels", "panels.svg": "Drawing of panels", "element.obj": "Panels in 3D", "element.3dm": "Panels in 3D, for Rhino", "blocks.svg": "Cut drawings of raw blocks", "blocks.csv": "Table of raw blocks", "stock.csv": "What is left over", "progress.csv": "What is cut, glued and broken", "element.json": "All of it as data" };

let id = $("element").dataset.id;
let element = null; // as the service has it
let data = null; // element.json of what is drawn
let drawn = ""; // whose data those are
let asked = 0; // requests for the element, the newest of which counts
let taken = 0;
let sending = false;
let planning = false; // jobs are being made
let refused = []; // what the last change was refused for
let group = "all";
let chosen = "";
let count = SHOWN;
let shownList = "";
let timer = 0;
let gone = false;
let lost = false; // the service was out of reach

const path = () => `/v1/elements/${encodeURIComponent(id)}`;
const send = (what, body) => post(`${path()}/${what}`, { body: JSON.stringify(body) });
const divided = () => element.state === "done";
const kindOf = (panel) => panel.mark ?? stateOf(panel);
const inGroup = (panel, name) => name === "all" || (name in MARKS ? panel.mark === name : name === "uncut" ? !panel.mark : stateOf(panel) === name);

const viewer = new PanelView($("canvas"), $("labels"), (panel) => choose(panel));
const sliders = new Sliders($("fields"), () => {
  refused = [];
  drawVerdict();
  soon();
});
const soon = later(350, () => divide());

// Asks for the element; an answer that an earlier request comes with late is past.
async function refresh() {
  const [own, of] = [++asked, id];
  const found = await json(path());
  if (own < taken || of !== id) return;
  taken = own;
  element = found;
  sliders.take(element.fields ?? {}, element.kind, false);
  await drawData();
  draw();
}

// The drawing of a division, once for each; of one that is refused, the former one stays.
async function drawData() {
  if (!divided() || drawn === id) return;
  const of = id;
  const found = await json(fileOf(of, "element.json"));
  const files = (await json(`/v1/jobs/${of}/files`)).files;
  if (of !== id) return;
  const before = data;
  [data, drawn, shownList] = [found, of, ""];
  show($("element"), true); // the view is fitted into a canvas that has its size
  viewer.show(data, before !== null);
  show($("view-empty"), !viewer.works);
  if (!viewer.works) $("view-empty").textContent = "This browser cannot show 3D views: it lacks WebGL 2. The list below contains all panels.";
  drawFiles(files);
  announce(`Divided into ${plural(data.panels.length, "panel")}`);
}

function draw() {
  show($("element"), true);
  drawDescription(element, "/ui/elements");
  badge(element.state, $("state"));
  const panels = element.panels ?? [];
  $("facts").textContent = [element.title ? element.name : null, divided() ? plural(panels.length, "panel") : null, element.kind, `created ${ago(element.created)}`].filter(Boolean).join(" · ");
  const problems = problemsOf(element);
  const left = problems.filter((one) => stateOf(one) === "not_planned").length;
  $("plan").disabled = !left || planning;
  $("plan").textContent = planning ? "Creating jobs …" : left && left < problems.length ? `Create jobs of the other ${left}` : left ? `Create jobs of all ${left}` : "All panels have jobs";
  const open = problems.filter((one) => isOpen(one.state)).length;
  const reporting = element.report && isOpen(element.report.state);
  $("report").disabled = reporting || !problems.some((one) => one.job && !isOpen(one.state));
  $("report").textContent = reporting ? "The report is being written …" : "Report on planned panels";
  show($("cancel"), open > 0 || isOpen(element.state));
  drawReleasePanels(problems);
  const made = [...panels, ...problems].some((one) => one.job || one.mark);
  show($("keeps"), made);
  $("keeps").textContent = made ? "Some panels are planned or marked. A change creates another element with the same marks. Jobs stay with this one." : "";
  drawVerdict();
  drawView();
  drawFoam();
  drawBlockJobs(element.block_jobs ?? [], { plan, tick });
  drawList();
}

// What the division comes to, and what stands in its way, at its fields.
function drawVerdict() {
  const issues = refused.length ? refused : element.issues ?? [];
  const wrong = refused.length > 0 || (!divided() && !isOpen(element.state));
  const moved = Object.keys(sliders.changes()).length > 0;
  const busy = isOpen(element.state) || sending || (moved && !refused.length);
  const say = (kind, ...text) => {
    $("verdict").className = `verdict-line ${kind}`;
    $("verdict").replaceChildren(...text);
  };
  if (refused.length) say("bad", icon("cross"), "The settings have errors");
  else if (busy) say("busy", element.state === "queued" && element.ahead ? `Waiting; ${plural(element.ahead, "job")} before it` : "Dividing …");
  else if (wrong) say("bad", icon("cross"), element.state === "cancelled" ? "Stopped before it was divided" : "The division failed");
  else say(issues.length ? "warn" : "ok", icon(issues.length ? "warning" : "check"), `${plural((element.panels ?? []).length, "panel")}${issues.length ? `, with ${plural(issues.length, "remark")}` : ""}`);
  $("canvas").parentElement.classList.toggle("past", busy || drawn !== id);
  if (!data) $("view-empty").textContent = wrong ? "Nothing to draw. See the issues next to the settings." : "The panels appear here when the element is divided.";
  const key = JSON.stringify([issues, busy]);
  if ($("issues").dataset.shown === key) return;
  $("issues").dataset.shown = key;
  if (busy) return;
  const homeless = atFields(issues);
  $("issues").replaceChildren(...sorted(homeless).map((issue) => issueItem(issue, placeOf(issue.field) ? { edit: goTo } : {})));
}

function drawView() {
  const panels = element.panels ?? [];
  const found = panels.find((panel) => panel.id === chosen);
  viewer.colourBy(new Map(panels.map((panel) => [panel.id, kindOf(panel)])), chosen);
  $("size").textContent = data ? plural(data.panels.length, "panel") : "";
  $("said").textContent = found ? `${found.id}: ${words(found)}` : drawn && drawn !== id ? "Previous division" : "";
  $("canvas").setAttribute("aria-label", `3D view of ${data ? plural(data.panels.length, "panel") : "nothing yet"}${found ? `; ${found.id} is selected` : ""}`);
}

const words = (panel) => [panel.mark, stateWords(panel), `block ${panel.block_mm.map((v) => number(v)).join(" × ")} mm`].filter(Boolean).join(", ");

// What an order of foam rests on: blocks, robot hours, panels that are not proven.
function drawFoam() {
  const panels = element.panels ?? [];
  show($("foam"), panels.length > 0);
  if (!panels.length) return;
  const hours = Object.entries(element.cut_h ?? {}).map(([arm, value]) => `${number(value, 3)} h of the arm ${arm}`).join(" and ");
  const proven = panels.filter((panel) => panel.state === "verified");
  const bad = panels.filter((panel) => stateOf(panel) === "refused");
  const sawn = (element.block_jobs ?? []).filter((job) => !job.panels?.length && stateOf(job) === "refused");
  const problems = problemsOf(element).filter((one) => one.state === "verified");
  const cycle = problems.reduce((sum, one) => sum + (one.cycle_s ?? 0), 0);
  const nest = drawn === id ? data.blocks : null;
  const sizes = new Map();
  for (const block of nest?.blocks ?? []) {
    const size = `${block.size_mm.map((v) => number(v)).join(" × ")} mm${block.left_over ? ", left over" : ""}`;
    sizes.set(size, (sizes.get(size) ?? 0) + 1);
  }
  const named = (some) => `${some.slice(0, 8).map((panel) => `${panel.id}${panel.issue ? ` (${panel.issue.code})` : ""}`).join(", ")}${some.length > 8 ? ` and ${some.length - 8} more` : ""}`;
  const lines = [
    ["", `Robot hours: ${hours ? `cutting takes about ${hours} (estimate)` : "no estimate, because the jobs state no feed"}${problems.length ? `; the ${plural(problems.length, element.block_jobs?.length ? "proven job" : "proven panel")} take ${duration(cycle)} with all motion` : ""}.`],
    nest ? ["", `Foam: ${[...sizes].map(([size, n]) => `${n} of ${size}`).join("; ")}; ${number(100 * nest.yield_volume, 2)} % of it becomes panels.`] : null,
    bad.length ? ["bad", `Refused: ${plural(bad.length, "panel")}, ${named(bad)}. Do not order foam for them.`] : null,
    sawn.length ? ["bad", `Refused: ${plural(sawn.length, "job")} that divide raw blocks, ${named(sawn)}. Cut these blocks by hand.`] : null,
    proven.length < panels.length ? ["warn", `Proven: ${proven.length} of ${panels.length}. The others may still be infeasible. Plan them before you order their foam.`] : ["ok", `Proven: all ${panels.length} panels.`],
  ].filter(Boolean);
  $("foam-said").replaceChildren(...lines.map(([kind, text]) => h("li", { class: kind }, icon(kind === "ok" ? "check" : kind === "bad" ? "cross" : kind === "warn" ? "warning" : "note"), h("span", {}, text))));
}

function drawFilters(panels) {
  const names = Object.keys(GROUPS).filter((name) => name === "all" || name === group || panels.some((panel) => inGroup(panel, name)));
  const focus = document.activeElement?.closest?.("#filters") ? document.activeElement.dataset.key : null;
  $("filters").replaceChildren(...names.map((name) => h("button", { type: "button", class: "chip", "aria-pressed": String(name === group), data: { key: name }, onclick: () => pick(name) }, name in COLOURS ? h("i", { class: `swatch kind ${name}` }) : null, `${GROUPS[name]} ${panels.filter((panel) => inGroup(panel, name)).length}`)));
  if (focus) $("filters").querySelector(`[data-key="${focus}"]`)?.focus();
}

function pick(name) {
  [group, count] = [name, SHOWN];
  drawList();
}

const byText = new Intl.Collator("en", { numeric: true }).compare;
function wanted(panels) {
  const text = $("find").value.trim().toLowerCase();
  const some = panels.filter((panel) => inGroup(panel, group) && panel.id.toLowerCase().includes(text));
  const order = $("order").value;
  if (order === "order") some.sort((a, b) => (a.order ?? 0) - (b.order ?? 0));
  if (order === "block") some.sort((a, b) => byText(a.block ?? "", b.block ?? ""));
  return some;
}

function drawList() {
  const panels = element.panels ?? [];
  show($("panels-card"), panels.length > 0);
  show($("told-card"), panels.length > 0);
  const some = wanted(panels);
  const key = JSON.stringify([some.slice(0, count), chosen, group, panels.length, element.counts, element.told]);
  if (key === shownList) return;
  shownList = key;
  drawFilters(panels);
  $("told").replaceChildren(...(element.told ?? []).map((line) => h("li", {}, line)));
  show($("no-panels"), !some.length);
  show($("more"), some.length > count);
  $("more").textContent = `Show more panels (${some.length - count} are left)`;
  redrawn($("panels"), some.slice(0, count).map(row));
}

function row(panel) {
  const own = panel.id;
  const done = panel.mark ? `mark-${panel.mark}` : "";
  const facts = [panel.order ? `assembly step ${panel.order}` : null, panel.cut_in ? `cut in ${panel.cut_in} with others` : panel.block ? `from ${panel.block}` : null, panel.block_mm.map((v) => number(v)).join(" × ") + " mm", panel.cycle_s ? duration(panel.cycle_s) : null];
  return h("li", { class: `panel ${own === chosen ? "chosen" : ""} ${done}`, data: { panel: own } },
    h("div", { class: "who" }, panel.thumbnail ? pictureOf(panel.job, `panel ${own}`) : null, h("div", {}, h("button", { type: "button", class: "link id", "aria-pressed": String(own === chosen), "aria-label": `Show panel ${own} in the drawing`, data: { key: `show-${own}` }, onclick: () => choose(own === chosen ? "" : own, false) }, own), h("span", { class: "sub" }, facts.filter(Boolean).join(" · ")))),
    workOf(panel, plan),
    h("div", { class: "tick", role: "group", "aria-label": `${own} at the robot` }, Object.entries(MARKS).map(([mark, word]) => h("button", { type: "button", class: `mark-button ${mark}`, "aria-pressed": String(panel.mark === mark), "aria-label": `${own} ${word.toLowerCase()}`, data: { key: `${mark}-${own}` }, onclick: () => tick(panel, mark) }, panel.mark === mark ? icon(mark === "broken" ? "cross" : "check") : null, word))),
  );
}

// A panel is chosen in the drawing or in the list; from the drawing, the list goes to it.
function choose(panel, scroll = true) {
  chosen = panel;
  if (!element) return;
  if (panel && scroll) {
    if (!wanted(element.panels ?? []).some((one) => one.id === panel)) {
      group = "all";
      $("find").value = "";
    }
    count = Math.max(count, wanted(element.panels ?? []).findIndex((one) => one.id === panel) + 1);
  }
  drawView();
  drawList();
  if (panel && scroll) $("panels").querySelector(`[data-panel="${CSS.escape(panel)}"]`)?.scrollIntoView({ block: "nearest" });
  if (panel) announce($("said").textContent);
}

function drawFiles(files) {
  const own = Object.keys(TITLES).map((name) => files.find((file) => file.name === name)).filter(Boolean);
  show($("files-card"), own.length > 0);
  const opens = (name) => (name.endsWith(".html") || name.endsWith(".svg") ? { target: "_blank", rel: "noopener" } : { download: "" });
  const item = (job, file, title) => h("li", {}, icon("file"), h("a", { href: fileOf(job, file.name) + (opens(file.name).target ? "" : "?download=true"), ...opens(file.name) }, title), h("span", { class: "soft" }, `${file.name}, ${bytes(file.size)}`));
  $("files").replaceChildren(...own.map((file) => item(id, file, TITLES[file.name])));
}

function drawReport() {
  const report = element?.report;
  $("files").querySelector(".of-report")?.remove();
  if (report?.state === "done") $("files").prepend(h("li", { class: "of-report" }, icon("check"), h("a", { href: fileOf(report.id, "element.html"), target: "_blank", rel: "noopener" }, "Report on the element: what is proven, joints, robot hours"), h("span", { class: "soft" }, `element.html, ${ago(report.created)}`)));
}

// Divides anew with what the sliders say. One request at a time: what is moved meanwhile goes out with the next.
async function divide() {
  if (sending) return;
  sending = true;
  try {
    banner("");
    for (let fields = sliders.changes(); Object.keys(fields).length; fields = sliders.changes()) {
      drawVerdict();
      const made = await (await send("divide?instead=true", { fields })).json();
      id = made.id;
      taken = ++asked;
      element = { panels: [], ...made };
      sliders.take(made.fields, made.kind, false);
      history.replaceState(null, "", `/ui/elements/${id}`);
    }
  } catch (error) {
    if (error instanceof Refused && error.status === 422) refused = error.issues;
    else failed(error);
  } finally {
    sending = false;
  }
  if (gone) return;
  draw();
  again(0);
}

async function plan(panels) {
  if (planning) return;
  planning = true;
  banner("");
  draw();
  await send("plan", panels ? { panels } : {}).then(refresh).catch(failed);
  planning = false;
  if (gone) return;
  draw();
  again(0);
}

// A mark that is set already is taken away: a tap may be wrong.
async function tick(panel, mark) {
  const state = panel.mark === mark ? "open" : mark;
  banner("");
  await send("mark", { panel: panel.id, state }).then(refresh).catch(failed);
  announce(`${panel.id} is ${state === "open" ? "open again" : state}`);
}

function failed(error) {
  lost = error instanceof Unreachable;
  gone ||= error instanceof Refused && error.issues[0]?.code === "service.unknown_job";
  if (!gone || !element) return tell(error, true);
  clearTimeout(timer);
  banner("This element no longer exists. It was divided again or deleted in another window. See the list of elements.");
  for (const control of document.querySelectorAll("#element button:not(.id), #element input, #element select")) control.disabled = true;
}

// Keeps up: soon where something is under way, else seldom, for others may tick panels off.
function again(wait) {
  clearTimeout(timer);
  const under = element && (isOpen(element.state) || (element.report && isOpen(element.report.state)) || [...(element.panels ?? []), ...(element.block_jobs ?? [])].some((one) => isOpen(one.state)));
  timer = setTimeout(async () => {
    try {
      if (!document.hidden && !sending) {
        await refresh();
        drawReport();
        if (lost) banner("");
        lost = false;
      }
    } catch (error) {
      failed(error);
    }
    if (!gone) again();
  }, wait ?? (under ? SOON + EACH * (element.panels ?? []).length : SELDOM));
}

setUpDescription(() => element, () => refresh().catch(failed));
setUpReleasePanels(path, () => (element ? problemsOf(element) : []), () => refresh().catch(failed));
$("cancel").prepend(icon("stop"));
$("delete").prepend(icon("bin"));
$("plan").addEventListener("click", () => plan());
$("report").addEventListener("click", () => post(`${path()}/report`).then(refresh).then(() => again()).catch(failed));
$("cancel").addEventListener("click", () => post(`${path()}/cancel`).then(refresh).catch(failed));
$("delete").addEventListener("click", async () => {
  const marks = (element.panels ?? []).filter((panel) => panel.mark).length;
  const text = `The division, its files and reports are deleted${marks ? `, and what ${plural(marks, "marked panel")} are` : ""}. Planned panels remain as jobs.`;
  if (await ask(text, "Delete")) await remove(path()).then(() => location.assign("/ui/elements"), failed);
});
$("find").addEventListener("input", () => pick(group));
$("order").addEventListener("change", () => pick(group));
$("more").addEventListener("click", () => {
  count += SHOWN;
  drawList();
});
addEventListener("visibilitychange", () => !document.hidden && again(0));
await refresh().then(drawReport).catch((error) => {
  show($("missing"), !element);
  failed(error);
});
ready();
if (!gone) again();
