// One job: stages and issues as they happen, then report, replay, programs.
import { fileOf, job as path, json, post, remove } from "./api.js";
import { banner, me, patiently, reached, ready, tell } from "./common.js";
import { drawDescription, setUpDescription } from "./describe.js";
import { Estimate } from "./estimate.js";
import { $, announce, h, icon, show } from "./dom.js";
import { errors, issueItem, issueList, sorted } from "./issues.js";
import { setUpLooks } from "./looks.js";
import { badge, outcomeOf, tiles } from "./outcome.js";
import { drawRelease, setUpRelease } from "./release.js";
import { AGAIN, ago, bytes, duration, isOpen, processName, STATES } from "./words.js";

const id = $("job").dataset.id;
const MOST = 3;
const STAGES = ["waiting", "targets", "cell", "placement", "motion", "programs", "proof", "report"];
let job = null;
const estimate = new Estimate(id, () => job);
let issues = [];
let stage = "";
let seen = 0;
let ended = false;
let files = [];

function drawHead() {
  drawDescription(job);
  badge(job.state, $("state"));
  const facts = [
    job.title ? job.name : null,
    job.processes.map(processName).join(", "),
    `created ${ago(job.created)}`,
    job.seconds ? `planned in ${duration(job.seconds)}` : null,
    job.from_store ? "answered from the store: the same problem was planned before" : null,
    job.attempts > 1 ? `attempt ${job.attempts}, the service was restarted` : null,
  ];
  $("facts").textContent = facts.filter(Boolean).join(" · ");
  show($("cancel"), isOpen(job.state));
  show($("first"), job.state === "queued" && job.ahead > 0);
  show($("retry"), AGAIN.includes(job.state));
  $("again").href = `/ui/new?job=${id}`;
  $("compare").href = `/ui/compare?a=${id}`;
}

function drawProgress() {
  const open = isOpen(job.state);
  show($("progress"), open);
  if (!open) return;
  const now = job.state === "queued" ? 0 : Math.max(STAGES.indexOf(stage), 0);
  const skipped = (name, i) => name === "placement" && i < now && !passed.has("placement");
  $("stages").replaceChildren(
    ...STAGES.map((name, i) =>
      h("li", { class: skipped(name, i) ? "skipped" : i < now ? "done" : i === now ? "now" : "", "aria-current": i === now ? "step" : null }, h("i", { "aria-hidden": "true" }, i < now && !skipped(name, i) ? icon("check") : null), name),
    ),
  );
  const percent = Math.round(100 * ((now + (now ? job.fraction : 0)) / STAGES.length));
  $("meter").setAttribute("aria-valuenow", String(percent));
  $("meter-fill").style.width = `${percent}%`;
  $("progress-text").textContent =
    job.state === "queued"
      ? job.ahead ? `Waiting; ${job.ahead} job${job.ahead > 1 ? "s are" : " is"} before it` : "Waiting for a free worker"
      : `${stage || "starting"}${job.fraction ? `, ${Math.round(100 * job.fraction)} %` : ""}`;
}
const passed = new Set();

function drawOutcome() {
  show($("outcome"), !isOpen(job.state));
  if (isOpen(job.state)) return;
  const { kind, title, text } = outcomeOf(job, issues);
  $("outcome").className = `card outcome ${kind}`;
  $("outcome-title").replaceChildren(icon(kind === "ok" ? "check" : kind === "off" ? "stop" : "cross"), title);
  $("outcome-text").textContent = text;
  $("outcome").querySelector(".issues")?.remove();
  const wrong = errors(issues);
  if (wrong.length && job.state !== "verified") $("outcome").append(issueList(wrong.slice(0, MOST), jumps()));
  if (wrong.length > MOST) $("outcome-text").textContent += ` ${wrong.length - MOST} more are listed below.`;
}

const jumps = () => ({
  seek: files.some((file) => file.name === "replay.html") ? seek : null,
  edit: (field) => location.assign(`/ui/new?job=${id}#${encodeURIComponent(field)}`),
  editText: "Change this field",
});

// What ended the job stands at its head; the rest is listed below.
const shownAbove = () => !isOpen(job.state) && job.state !== "verified";
const further = () => (shownAbove() ? issues.filter((issue) => !errors(issues).slice(0, MOST).includes(issue)) : issues);

function drawIssues() {
  const some = further();
  $("issues-title").textContent = shownAbove() ? "Further issues" : "Issues";
  show($("no-issues"), !some.length);
  $("issues").replaceChildren(...sorted(some).map((issue) => issueItem(issue, jumps())));
}

function drawFigures() {
  const figures = tiles(job.metrics);
  show($("figures"), figures.length > 0);
  $("figures").replaceChildren(...figures);
}

async function drawFiles() {
  files = (await json(`${path(id)}/files`)).files;
  const has = (name) => files.some((file) => file.name === name);
  const programs = files.filter((file) => file.name.startsWith("programs/"));
  show($("download"), programs.length > 0);
  $("download").href = `${path(id)}/programs.zip`;
  await drawRelease(id, job, programs);
  tabs([further().length > 0 && ["issues", `${shownAbove() ? "Further issues" : "Issues"} (${further().length})`], has("report.html") && ["report", "Report"], has("replay.html") && ["replay", "Replay"], ["files", "Files"]].filter(Boolean));
  const groups = [
    ["Programs", programs, "Programs for the robots. They are available because their proof holds."],
    ["Results", files.filter((file) => !/^(programs|problem)\//.test(file.name)), ""],
    ["Problem", files.filter((file) => file.name.startsWith("problem/")), "The problem as it was planned, with all of its files."],
  ];
  $("panel-files").replaceChildren(
    ...groups.filter(([, some]) => some.length).flatMap(([name, some, about]) => [
      h("h2", {}, name),
      about ? h("p", { class: "soft" }, about) : null,
      h("ul", { class: "files" }, some.map((file) => h("li", {}, icon("file"), h("a", { href: `${fileOf(id, file.name)}?download=true`, download: "" }, file.name.replace(/^(programs|problem)\//, "")), h("span", { class: "soft" }, bytes(file.size))))),
    ]).filter(Boolean),
  );
}

// Tabs by WAI-ARIA's pattern: arrows move, the panel follows.
function tabs(names) {
  const asked = location.hash.slice(1);
  const chosen = names.some(([name]) => name === asked) ? asked : names[0][0];
  if (!names.some(([name]) => name === "issues")) show($("panel-issues"), false);
  $("tabs").replaceChildren(
    ...names.map(([name, title]) =>
      h("button", { type: "button", role: "tab", id: `tab-${name}`, "aria-controls": `panel-${name}`, onclick: () => open(name, true, true), onkeydown: (event) => move(event, names) }, title),
    ),
  );
  show($("tabs"), true);
  if ($("tabs").dataset.open !== chosen) open(chosen, false);
  else select(chosen);
}

function move(event, names) {
  const all = names.map(([name]) => name);
  const here = all.indexOf(event.target.id.slice(4));
  const to = { ArrowRight: here + 1, ArrowLeft: here - 1, Home: 0, End: all.length - 1 }[event.key];
  if (to === undefined) return;
  event.preventDefault();
  const name = all[(to + all.length) % all.length];
  open(name);
  $(`tab-${name}`).focus();
}

function select(name) {
  for (const tab of $("tabs").children) {
    const on = tab.id === `tab-${name}`;
    tab.setAttribute("aria-selected", String(on));
    tab.tabIndex = on ? 0 : -1;
    show($(tab.getAttribute("aria-controls")), on);
  }
}

function open(name, remember = true, closer = false) {
  $("tabs").dataset.open = name;
  select(name);
  if (name === "report" || name === "replay") frame(name);
  if (closer && (name === "report" || name === "replay")) $("tabs").scrollIntoView({ block: "start" });
  if (remember) history.replaceState(null, "", `#${name}`);
}

const theme = () => (getComputedStyle(document.documentElement).colorScheme === "light dark" ? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light") : getComputedStyle(document.documentElement).colorScheme);
const retheme = () => {
  const inside = $("panel-replay").querySelector("iframe");
  if (inside) inside.src = `${fileOf(id, "replay.html")}#theme=${theme()}`; // which loads nothing anew
};
addEventListener("themechange", retheme);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", retheme);

// Report and replay hold what users wrote, and scripts of their own: they run apart from this page.
function frame(name, moment = "") {
  const place = $(`panel-${name}`);
  const hash = name === "replay" ? `#${[moment, `theme=${theme()}`].filter(Boolean).join("&")}` : "";
  const address = `${fileOf(id, `${name}.html`)}${hash}`;
  let inside = place.querySelector("iframe");
  if (!inside) {
    const title = name === "replay" ? `Replay of ${job.name} with a time bar` : `Report on ${job.name}`;
    inside = h("iframe", { title, class: name, sandbox: "allow-scripts allow-popups allow-downloads" });
    inside.src = address;
    place.append(h("p", { class: "frame-head" }, h("a", { href: fileOf(id, `${name}.html`), target: "_blank", rel: "noopener" }, `Open the ${name} on its own`)), inside);
  } else if (moment) inside.src = address;
}

// The proof tells times of the programs' clock, planning those of the operation's work; the replay knows both.
function seek(issue) {
  const segment = (issue.target ?? "").split("/").slice(0, -1).join("/");
  const moment = issue.code.startsWith("verify.") ? { at: issue.time } : { work: issue.time, in: segment };
  open("replay");
  frame("replay", new URLSearchParams(moment).toString());
  $("tabs").scrollIntoView({ block: "start" });
  $("panel-replay").querySelector("iframe").focus({ preventScroll: true });
  announce(`The replay is at the time of the issue, ${issue.time.toFixed(1)} seconds`);
}

function draw() {
  show($("job"), true);
  drawHead();
  drawProgress();
  estimate.follow();
  drawFigures();
  drawOutcome();
  drawIssues();
}

async function refresh() {
  job = await json(path(id));
  stage = job.stage || stage;
  if (job.issues?.length || !isOpen(job.state)) issues = job.issues ?? [];
  if (!isOpen(job.state)) await drawFiles();
  draw();
  reached();
}

// What is done to the job; then it is read anew.
function act(what) {
  banner("");
  return post(`${path(id)}/${what}`).then(refresh).catch(tell);
}

async function retry() {
  banner("");
  try {
    await post(`${path(id)}/retry`);
  } catch (error) {
    return tell(error);
  }
  [issues, stage, ended, files] = [[], "", false, []];
  passed.clear();
  show($("tabs"), false);
  delete $("tabs").dataset.open;
  for (const name of ["report", "replay", "files"]) {
    $(`panel-${name}`).replaceChildren();
    show($(`panel-${name}`), false);
  }
  show($("panel-issues"), true);
  for (const name of ["download", "release", "withdraw", "released"]) show($(name), false);
  await refresh().catch(tell);
  if (isOpen(job.state)) listen();
}

const key = (issue) => JSON.stringify([issue.code, issue.message, issue.field, issue.arm, issue.index]);

function listen() {
  const source = new EventSource(`${path(id)}/events?after=${seen}`);
  const hear = (kind, action) =>
    source.addEventListener(kind, (event) => {
      seen = Math.max(seen, Number(event.lastEventId) || 0);
      reached();
      action(JSON.parse(event.data));
    });
  hear("state", ({ state, attempt }) => {
    if (state !== job.state) announce(`The job is ${STATES[state]?.[0].toLowerCase() ?? state}`);
    Object.assign(job, { state, fraction: 0 });
    if (attempt) job.attempts = attempt;
    if (state === "queued" || state === "running") {
      stage = "";
      passed.clear();
      draw();
    }
  });
  hear("progress", (data) => {
    if (data.stage !== stage) announce(`Stage: ${data.stage}`);
    stage = data.stage;
    passed.add(stage);
    job.fraction = data.fraction;
    drawProgress();
  });
  hear("issues", (data) => {
    const known = data.all ? [] : issues;
    const have = new Set(known.map(key));
    issues = [...known, ...data.issues.filter((issue) => !have.has(key(issue)))];
    drawIssues();
  });
  hear("end", () => {
    ended = true;
    source.close();
    patiently(refresh).catch(tell);
  });
  source.onerror = () => {
    if (ended) return;
    banner("The connection to the service is lost. Trying again …", "warn");
    source.close();
    setTimeout(reconnect, 1000);
  };
}

async function reconnect() {
  try {
    await refresh();
    if (isOpen(job.state)) listen();
  } catch (error) {
    if (error.status === 404) return tell(error);
    setTimeout(reconnect, 1000);
  }
}

$("cancel").prepend(icon("stop"));
$("delete").prepend(icon("bin"));
$("again").prepend(icon("again"));
$("compare").prepend(icon("swap"));
const after = () => {
  banner("");
  return refresh().catch(tell);
};
setUpDescription(() => job, after);
setUpRelease(id, after, await me);
setUpLooks(id);
$("retry").prepend(icon("again"));
$("first").addEventListener("click", () => act("first"));
$("retry").addEventListener("click", retry);
$("cancel").addEventListener("click", () => act("cancel"));
$("delete").addEventListener("click", () => $("sure").showModal());
$("sure").addEventListener("close", async () => {
  if ($("sure").returnValue !== "yes") return;
  await remove(path(id)).then(() => location.assign("/"), tell);
});
await patiently(refresh).catch((error) => {
  show($("missing"), !job);
  tell(error);
});
ready();
if (job && isOpen(job.state)) listen();
