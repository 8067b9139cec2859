// Makes a job: where to begin, cell, part, operations; the part and what is wrong with it show at once.
import { json, once, post, Refused, upload } from "./api.js";
import { ask } from "./ask.js";
import { closeBatch, openBatch, setUpBatch, sortFiles } from "./batch.js";
import { drawCells, takeCell } from "./cell.js";
import { banner, patiently, ready, script, tell } from "./common.js";
import { Draft, fromDraft, sentAs } from "./draft.js";
import { $, announce, h, icon, later, show } from "./dom.js";
import { assign, drawFiles, drawUnits, fieldOfFile, held, inUnit, partMesh, sizeText, wanted } from "./files.js";
import { Form } from "./form.js";
import { atFields, errors, fieldName, goTo, issueItem, sorted } from "./issues.js";
import { goneRobots, Keeping } from "./keeping.js";
import { boxOf } from "./mesh.js";
import { at, differences, put, Schema } from "./schema.js";
import { drawExamples, drawProcesses, fromExample, fromFiles, fromJob } from "./start.js";
import { setUpSweep } from "./sweep.js";
import { Viewer } from "./viewer.js";
import { number } from "./words.js";

const FIRST_TARGETS = 40; // of the first look, which answers within two seconds
const BY_ARM = ["arms", "arm", "held_by", "signals", "tools", "io"];
const asked = new URLSearchParams(location.search);
const state = { problem: {}, origin: {}, files: new Map(), given: new Map(), cell: {}, process: "", example: "", shown: "" };
const viewer = new Viewer($("canvas"), $("labels"));
let form = null;
let draft = null;
let keeping = null;
let catalogue = [];
let drawSweep = null;
let examples = {};
let cells = {};
let checking = null;
let outdone = null; // the check while which something that was sent was refused: it tells nothing over that
let cell = null;
let choices = 0;
let partTitle = "Part";
const seen = { signal: null, looked: false }; // what is known of the problem as it stands, for who draws the cell later

async function begin() {
  const needed = ["/v1/schema", "/v1/catalogue/robots", "/v1/catalogue/materials", "/v1/catalogue/cells", "/ui/examples"];
  const [schema, robots, materials, found, bundled] = await patiently(() => Promise.all(needed.map((path) => json(path))));
  cells = found.entries;
  catalogue = Object.keys(robots.entries);
  examples = bundled;
  const titled = (kind) => Object.entries(materials.entries).filter(([, one]) => one.kind === kind).map(([name, one]) => [name, one.title, name]);
  const lists = {
    robot: { strict: true, entries: Object.entries(robots.entries).map(([name, one]) => [name, one.title, name]) },
    metal: { strict: true, entries: titled("sheet") },
    foam: { entries: titled("foam") },
    material: { strict: true, entries: titled("wire") },
    wire_material: { strict: true, entries: titled("wire") },
  };
  const arms = () => ({ entries: (state.problem.cell?.arms ?? []).map((arm) => [arm.name]) });
  form = new Form(new Schema(schema), state, changed, (name) => (BY_ARM.includes(name) ? arms() : lists[name]));
  form.drawn = () => afterwards();
  if (!viewer.works) $("view-empty").textContent = "This browser cannot show 3D views: it lacks WebGL 2. Sizes are shown nevertheless.";
  draft = new Draft(state, () => {
    draw();
    $("go").disabled = true;
    check();
  });
  drawSweep = setUpSweep(state, () => wanted(state), draft, (error) => (error instanceof Refused ? tellRefused(error.issues) : tell(error)));
  keeping = new Keeping(state, putIn);
  await patiently(() => keeping.load());
  $("kept").addEventListener("change", chooseKept);
  drawProcesses("", chooseProcess);
  if (asked.has("draft")) return takeKept(asked.get("draft"), true);
  if (asked.has("template")) return takeKept(asked.get("template"), false);
  if (asked.has("job")) take({ ...(await patiently(() => fromJob(asked.get("job")))), job: asked.get("job") });
  else if (asked.has("example")) await begun(asked.get("example"));
  else if (asked.has("process")) await chooseProcess(asked.get("process"));
}

// What was changed and not sent, in words; nothing where all is as it came.
function unsent() {
  const fields = differences(state.origin, state.problem).length;
  const files = [...state.files].filter(([name, file]) => state.given.get(name) !== file).length;
  const said = [fields && `${fields} changed field${fields > 1 ? "s" : ""}`, files && `${files} file${files > 1 ? "s" : ""} that you chose`];
  return said.filter(Boolean).join(" and ");
}

// Whether another start may take the place of this one.
async function mayLeave(yes) {
  const lost = unsent();
  const what = draft.kept() ? "stays in the draft, and the page starts over" : "would be lost, because nothing was submitted yet";
  return !lost || (await ask(`${lost.charAt(0).toUpperCase()}${lost.slice(1)} ${what}.`, yes));
}

// The choices as they are, after one that was taken back.
function back() {
  drawProcesses(state.process, chooseProcess);
  $("example").value = state.example;
  document.querySelector("input[name=process]:checked")?.focus();
}

async function chooseProcess(name) {
  if (!(await mayLeave("Discard and start over"))) return back();
  state.process = name;
  drawProcesses(name, chooseProcess);
  const some = drawExamples(examples, name, "", chooseExample);
  const pains = ([, one]) => 100 * !one.feasible + 10 * one.processes.length + one.robots.length;
  const first = [...some].sort((a, b) => pains(a) - pains(b))[0]; // the plainest, so that it is understood at once
  if (first) await begun(first[0]).catch(tell);
}

async function chooseExample(name) {
  if (!name) return;
  if (await mayLeave(`Discard and start with ${name}`)) return begun(name);
  $("example").value = state.example;
}

async function begun(name) {
  const own = ++choices; // an earlier choice whose files come later is past
  try {
    const found = await fromExample(name);
    if (own !== choices) return;
    state.example = name;
    take(found);
  } catch (error) {
    tell(error);
  }
}

function take({ problem, files, source, job = "" }) {
  Object.assign(state, { problem, job, origin: structuredClone(problem), files, given: new Map(files), cell: structuredClone(problem.cell), shown: "" });
  const process = problem.operations?.[0]?.process ?? state.process;
  if (process !== state.process && !examples[state.example]?.processes.includes(state.process)) state.process = process;
  drawProcesses(state.process, chooseProcess);
  drawExamples(examples, state.process, source.includes("bundled") ? state.example : "", chooseExample);
  $("source").textContent = source;
  show($("rest"), true);
  show($("check-card"), true);
  draw();
  draft.begin();
  if (new URLSearchParams(location.search).has("draft")) history.replaceState(null, "", "/ui/new");
  banner("");
  check();
}

function draw() {
  form.forget();
  const root = form.schema.root;
  if (state.problem.cell && typeof state.problem.cell === "object") form.into($("cell-form"), form.schema.defs.CellFile, ["cell"]);
  else $("cell-form").replaceChildren();
  form.into($("part-form"), root, [], ["part", "sheet", "stock"]);
  form.into($("operations-form"), root, [], ["operations"]);
  form.into($("settings-form"), root, [], ["name", "settings"]);
  afterwards();
}

function afterwards() {
  drawCells(state, cells, chooseCell);
  drawFiles(state, (name) => {
    state.files.delete(name);
    draw();
    changed([]);
  });
  keeping.draw();
  drawSweep();
  drawChanges();
  atFields(state.issues ?? []);
}

// What was kept, as the draft that goes on, or as the start of a new one.
async function takeKept(id, goesOn) {
  const found = await patiently(() => fromDraft(id));
  state.example = "";
  take(found);
  if (goesOn) {
    draft.begin(found.about);
    history.replaceState(null, "", `/ui/new?draft=${id}`);
  }
  const gone = goneRobots(found.problem, catalogue);
  if (gone) banner(gone, "warn");
}

async function chooseKept() {
  const id = $("kept").value;
  $("kept").value = "";
  if (!id || !(await mayLeave("Discard and open the saved work"))) return;
  await takeKept(id, keeping.kept.some((one) => one.id === id && one.kind === "draft")).catch(tell);
}

// A kept cell, or a kept tool of an arm.
function putIn(content, arm, title) {
  if (arm) arm.tool = structuredClone(content);
  else {
    takeCell(state.problem, content);
    state.cell = structuredClone(content);
  }
  draw();
  changed();
  announce(`${title} is inserted`);
  const gone = goneRobots(state.problem, catalogue);
  if (gone) banner(gone, "warn");
}

const fieldOf = (issue) => fieldOfFile(state.problem, issue);

async function chooseCell(name) {
  const lost = differences(state.cell, state.problem.cell).length;
  if (lost && !(await ask(`${lost} changed field${lost > 1 ? "s" : ""} of this cell would be lost.`, `Discard and use ${name}`))) return afterwards();
  takeCell(state.problem, cells[name]);
  state.cell = structuredClone(cells[name]);
  draw();
  changed(["cell"]);
  announce(`Cell ${name}`);
}

function changed() {
  state.sending = null;
  if (!$("banner").classList.contains("warn")) banner("");
  drawChanges();
  draft.changed();
  cell?.follow();
  $("go").disabled = true;
  soon();
}
const soon = later(450, () => check());

function drawChanges() {
  const found = differences(state.origin, state.problem);
  $("changes").replaceChildren(
    ...(found.length
      ? [h("b", {}, `${found.length} field${found.length > 1 ? "s" : ""} changed: `), ...found.slice(0, 4).flatMap(([path], i) => [i ? ", " : "", h("button", { type: "button", class: "link", onclick: () => goTo(path.join(".")) }, fieldName(path.slice(typeof path.at(-2) === "number" ? -3 : -2).join(".")))]), found.length > 4 ? " …" : ""]
      : []),
  );
}

// The part as its file has it, before anything else is known of the problem.
async function drawMesh() {
  const found = await partMesh(state);
  drawUnits(state, found, (path, unit) => {
    put(state.problem, path, unit);
    draw();
    changed(path);
    drawMesh();
  });
  if (!found || found.mesh.error) return false;
  const body = inUnit(found);
  present([body], boxOf(body.vertices), found.unit ? "" : "unit not chosen");
  return true;
}

function present(bodies, box, note, stock = null) {
  const key = JSON.stringify([state.example, box?.map((c) => c.map((v) => Math.round(v)))]);
  viewer.show(bodies, key === state.shown);
  state.shown = key;
  show($("view-empty"), !bodies.length || !viewer.works);
  const part = bodies.filter((body) => body.kind === "part");
  const size = box ? (note === "unit not chosen" ? `${sizeText(box).replace(" mm", "")}, unit?` : sizeText(box)) : "";
  $("size").textContent = size;
  partTitle = part.length ? "Part" : "Stock";
  if (!$("part-view").hidden) $("view-title").textContent = partTitle;
  $("canvas").setAttribute("aria-label", `3D view of the ${part.length ? "part" : "stock"}, ${size}${stock ? `; stock ${sizeText(stock)}` : ""}`);
  const ways = bodies.some((body) => body.kind === "path");
  $("legend").replaceChildren(...(ways ? [h("i", { class: "swatch path" }), "way of the tool "] : []), ...(stock ? [h("i", { class: "swatch stock" }), `stock ${sizeText(stock)}`] : []));
}

async function check() {
  checking?.abort();
  const own = (checking = new AbortController());
  const going = (text) => own === outdone || say("busy", text);
  const found = (...given) => own === outdone || tellIssues(...given);
  going("Checking …");
  const drawn = await drawMesh();
  if (own.signal.aborted) return;
  try {
    const read = await (await post("/ui/preview", { body: upload(state.problem, wanted(state)), signal: own.signal })).json();
    const box = read.summary.part_mm ?? null;
    present(read.shapes, box ?? read.summary.stock_mm, "", read.summary.stock_mm);
    Object.assign(seen, { signal: own.signal, looked: false });
    cell?.draw(own.signal);
    if ($("banner").classList.contains("warn") && !goneRobots(state.problem, catalogue)) banner(""); // an error stays until something is done about it
    if (errors(read.issues).length) return found(read.issues, true);
    going("The file is valid. Checking reach and clearance of some targets …");
    const some = await (await post(`/v1/check?targets=${FIRST_TARGETS}`, { body: upload(state.problem, wanted(state)), signal: own.signal })).json();
    if (errors(some.issues).length) found(some.issues, true, some.looked_at);
    if (!some.looked_at) return; // there are no targets
    seen.looked = true;
    cell?.look(own.signal);
    if (!errors(some.issues).length) going(`${some.looked_at.placed ? `Checked ${share(some.looked_at)}: no errors so far` : "None of the first poses of the block is feasible. Trying more"}. Testing the part, the tools and the reach of every target …`);
    const whole = await (await post("/v1/check?reach=true", { body: upload(state.problem, wanted(state)), signal: own.signal })).json();
    found(whole.issues, true);
  } catch (error) {
    if (error.name === "AbortError") return;
    if (!(error instanceof Refused)) {
      say("bad", "The service cannot be reached. Trying again in a moment.");
      setTimeout(() => own === checking && check(), 2000);
      return;
    }
    if (!drawn) present([], null, "");
    if (viewer.works) $("view-empty").textContent = "Nothing can be drawn until the errors below are corrected.";
    found(error.issues, false);
  }
}

// The part, the cell or the map of a freedom; what draws cells is loaded when it is wanted.
function drawTabs() {
  const names = ["part", "cell", "map"];
  const open = async (name, focus) => {
    for (const one of names) {
      const tab = $(`tab-${one}`);
      tab.setAttribute("aria-selected", String(one === name));
      tab.tabIndex = one === name ? 0 : -1;
      show($(`${one}-view`), one === name);
      if (one === name && focus) tab.focus();
    }
    show($("cell-walk"), name !== "part");
    show($("size"), name === "part");
    $("view-title").textContent = name === "part" ? partTitle : name === "cell" ? "Cell in 3D" : "Axis map";
    if (name !== "part" && !cell) {
      const { CellPanel } = await script("cell_panel.js");
      cell ??= new CellPanel(state, () => wanted(state), (path) => form.reshape(path, at(state.problem, path)));
      cell.begin(seen.signal, seen.looked);
    }
    cell?.turn(name);
  };
  for (const [i, name] of names.entries()) {
    $(`tab-${name}`).addEventListener("click", () => open(name).catch(tell));
    $(`tab-${name}`).addEventListener("keydown", (event) => {
      const way = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!way) return;
      event.preventDefault();
      open(names[(i + way + names.length) % names.length], true).catch(tell);
    });
  }
}

function say(kind, text) {
  $("verdict").className = `verdict-line ${kind}`;
  $("verdict").replaceChildren(...(kind === "busy" ? [] : [icon(kind === "ok" ? "check" : kind === "warn" ? "warning" : "cross")]), text);
}

const share = ({ targets, of, thinned }) => `${number(targets)} of ${number(of)} targets${thinned ? " of a coarser path" : ""}`;

// What was sent is refused: the check that is under way beside it tells nothing over that.
function tellRefused(issues) {
  outdone = checking;
  tellIssues(issues, false);
}

// looked: {targets, of} where only so many were looked at; then nothing is ready yet, whatever was found
function tellIssues(issues, readable, looked = null) {
  // the page wrote the problem's text itself: its lines say nothing to the user
  state.issues = issues.map((issue) => ({ ...issue, field: issue.field ?? fieldOf(issue), line: issue.code.startsWith("problem.") ? undefined : issue.line }));
  atFields(state.issues);
  const wrong = errors(issues).length;
  if (wrong) say("bad", `${wrong} thing${wrong > 1 ? "s" : ""} to correct${readable ? "" : " before it can be planned"}${looked ? `; checked ${share(looked)} so far` : ""}`);
  else if (issues.length) say("warn", `Ready, with ${issues.length} remark${issues.length > 1 ? "s" : ""}`);
  else say("ok", "Ready: the arms reach every target");
  $("check-issues").replaceChildren(...sorted(state.issues).map((issue) => issueItem(issue, { edit: goTo, removes, remove })));
  $("go").disabled = wrong > 0 || looked !== null;
}

// Whether a field is in the problem and not in the form: a key that nobody knows.
function removes(field) {
  const path = field.split(".");
  return !/^\d+$/.test(path.at(-1)) && at(state.problem, path) !== undefined && !document.querySelector(`[data-path="${CSS.escape(field)}"]`);
}

function remove(field) {
  put(state.problem, field.split("."), undefined);
  draw();
  changed();
  $("verdict").scrollIntoView({ block: "nearest" });
  announce(`${fieldName(field)} is removed`);
}

async function addFiles(chosen) {
  const list = await held(chosen);
  if (!list.length) return;
  for (const file of list) {
    state.files.set(file.name, file);
    const path = assign(state.problem, file.name, state.process);
    if (path) announce(`${file.name} is used as ${fieldName(path.join("."))}`);
  }
  draw();
  changed([]);
}

async function openProblem(chosen) {
  await started; // what is chosen before the form is there waits for it
  if (!form) return; // why there is none is told
  const own = await held(chosen);
  if (!own.length) return;
  const { problems, files } = await sortFiles(own);
  if (problems.length > 1) return openBatch({ problems, files }); // beside what is edited here
  const list = [...problems, ...files];
  if (!(await mayLeave("Discard and open the file"))) return;
  closeBatch();
  state.example = "";
  choices += 1;
  try {
    take(await fromFiles(list));
  } catch (error) {
    banner(`The problem file cannot be opened: ${error.message}`);
    await sendAsItIs(list);
  }
}

// A file that is no problem for this page: the service says what is wrong with it.
async function sendAsItIs(list) {
  const body = list.find((file) => /\.(ya?ml|json)$/i.test(file.name)) ?? list[0];
  if (!body) return;
  show($("check-card"), true);
  try {
    await patiently(() => post("/ui/preview", { body: upload(body, []) }));
  } catch (error) {
    if (!(error instanceof Refused)) return tell(error);
    tellIssues(error.issues, false);
  }
}

async function start() {
  $("go").disabled = true;
  say("busy", "Sending …");
  try {
    const version = await draft.version(); // that which is sent, whatever is typed meanwhile
    const [body, headers, own] = [upload(state.problem, wanted(state)), once(), (state.sending = {})];
    const send = () => {
      if (state.sending === own) return post("/v1/jobs", { body, headers });
      throw new Refused(0, [{ code: "service.request", severity: "error", message: "the problem was changed while the service could not be reached. Start planning again." }]);
    };
    const made = await (await patiently(send)).json();
    if (version) await sentAs(version, made.id).catch(() => null); // the job is made, whatever becomes of its draft
    state.sent = true;
    location.assign(`/ui/jobs/${made.id}`);
  } catch (error) {
    if (error instanceof Refused && error.status === 422) tellRefused(error.issues);
    else {
      check(); // so that it can be sent again
      tell(error);
    }
    if (errors(state.issues ?? [])[0]?.field) goTo(errors(state.issues)[0].field);
  }
}

setUpBatch();
$("go").addEventListener("click", start);
$("form").addEventListener("submit", (event) => event.preventDefault());
$("choose").addEventListener("click", () => $("files").click());
$("files").addEventListener("change", () => addFiles([...$("files").files]).finally(() => ($("files").value = "")));
$("open-problem").addEventListener("click", () => $("problem-file").click());
$("problem-file").addEventListener("change", () => openProblem([...$("problem-file").files]).finally(() => ($("problem-file").value = "")));
for (const name of ["dragover", "drop"])
  addEventListener(name, (event) => {
    event.preventDefault();
    $("drop").classList.toggle("over", name === "dragover");
    if (name === "drop" && form && !$("rest").hidden) addFiles([...event.dataTransfer.files]);
    else if (name === "drop") openProblem([...event.dataTransfer.files]);
  });
addEventListener("beforeunload", (event) => !state.sent && !draft?.kept() && unsent() && event.preventDefault());
addEventListener("dragleave", () => $("drop").classList.remove("over"));

drawTabs();
const started = begin().catch(tell);
if ($("problem-file").files.length) $("problem-file").dispatchEvent(new Event("change")); // chosen before there was this script
await started;
ready();
if (location.hash) goTo(decodeURIComponent(location.hash.slice(1)));
