// Two jobs side by side: state, figures, what differs in their problems, issues that only one has.
import { fileOf, job as path, json, text, Unreachable } from "./api.js";
import { banner, patiently, reached, ready, script, tell } from "./common.js";
import { $, h, icon } from "./dom.js";
import { short } from "./form.js";
import { fieldName, issueList } from "./issues.js";
import { badge } from "./outcome.js";
import { differences } from "./schema.js";
import { ago, BETTER, duration, figureName, figureOrder, isOpen, number, STATES, unitOf } from "./words.js";
import { readYaml } from "./yaml.js";

const asked = new URLSearchParams(location.search);
const RETRY_MS = 2000;
const EVERY_MS = 1500; // jobs under way are looked at
const called = (job) => job.title || job.name; // jobs of a sweep have one name
const label = (job) => `${called(job)} · ${STATES[job.state]?.[0] ?? job.state} · ${ago(job.created)} · ${job.id.slice(0, 6)}`;
let turn = 0; // of what was asked last; answers to former questions are dropped
let wanted = false; // whether both are to be drawn
let left = null; // how the picture of two others was left

// The last jobs, and before them those that the address asks for; a reason for each of these that there is not.
async function load() {
  const { jobs } = await json("/v1/jobs?limit=200");
  const faults = [];
  for (const id of new Set(["a", "b"].map((name) => asked.get(name)).filter(Boolean))) {
    if (jobs.some((one) => one.id === id)) continue;
    try {
      jobs.unshift(await json(path(id)));
    } catch (error) {
      if (error instanceof Unreachable) throw error;
      faults.push(error);
    }
  }
  const options = () => jobs.map((one) => h("option", { value: one.id }, label(one)));
  for (const name of ["a", "b"]) {
    $(name).replaceChildren(h("option", { value: "" }, "Choose a job"), ...options());
    $(name).value = jobs.some((one) => one.id === asked.get(name)) ? asked.get(name) : "";
  }
  return faults;
}

function empty(text) {
  endView();
  $("result").replaceChildren(h("div", { class: "card empty" }, h("p", {}, text)));
}

async function compare() {
  const [a, b] = [$("a").value, $("b").value];
  turn += 1;
  const mine = turn;
  history.replaceState(null, "", `/ui/compare?a=${a}&b=${b}`);
  if (!a || !b) return empty("Choose two jobs to see their differences.");
  try {
    const [one, two] = await Promise.all([a, b].map((id) => json(path(id))));
    const [p, q] = await Promise.all([a, b].map(async (id) => readYaml(await text(fileOf(id, "problem/problem.yaml")))));
    const lists = await Promise.all([a, b].map(async (id) => (await json(`${path(id)}/files`)).files));
    if (mine !== turn) return;
    endView();
    $("result").replaceChildren(figures(one, two), ...inView(a, b, lists), programs(a, b, lists), fields(p, q), issues(one, two));
    banner("");
    follow(mine, [one, two]);
  } catch (error) {
    if (mine !== turn) return;
    empty("These jobs cannot be compared now."); // and not what was chosen before
    if (error instanceof Unreachable) setTimeout(() => mine === turn && show(), RETRY_MS);
    tell(error, true);
  }
}

// What is under way is looked at until it has ended; then all is drawn anew.
async function follow(mine, seen) {
  for (const one of seen) for (const option of document.querySelectorAll(`#a [value="${one.id}"], #b [value="${one.id}"]`)) option.textContent = label(one);
  if (!seen.some((one) => isOpen(one.state))) return;
  await new Promise((after) => setTimeout(after, EVERY_MS));
  if (mine !== turn) return;
  let now = seen;
  try {
    now = await Promise.all(seen.map((one) => (isOpen(one.state) ? json(path(one.id)) : one)));
    if (mine !== turn) return;
    reached();
  } catch (error) {
    if (mine !== turn) return;
    if (!(error instanceof Unreachable)) return show(); // says what became of it
    tell(error, true);
  }
  if (now.some((one, i) => one.state !== seen[i].state)) return show();
  $("result").querySelectorAll("td.state").forEach((cell, i) => cell.replaceChildren(...stateOf(now[i])));
  follow(mine, now);
}

const stateOf = (job) => [badge(job.state), isOpen(job.state) && job.stage ? h("span", { class: "sub" }, `${job.stage}, ${Math.round(100 * job.fraction)} %`) : null].filter(Boolean);

// Of what is shown of a former choice nothing goes on.
function endView() {
  if (!globalThis.both) return;
  left = globalThis.both.left;
  globalThis.both.close();
  globalThis.both = null;
}

const link = (job) => h("a", { href: `/ui/jobs/${job.id}` }, h("bdi", {}, called(job)));

function figures(one, two) {
  const names = figureOrder(new Set([...Object.keys(one.metrics ?? {}), ...Object.keys(two.metrics ?? {})]));
  const value = (job, name) => {
    const found = job.metrics?.[name];
    if (found === undefined) return "–";
    return name.endsWith("_s") ? duration(found) : `${number(found)} ${unitOf(name)}`.trim();
  };
  const change = (name) => {
    const [x, y] = [one.metrics?.[name], two.metrics?.[name]];
    if (x === undefined || y === undefined) return h("td", { class: "n soft" }, "");
    if (value(one, name) === value(two, name)) return h("td", { class: "n soft" }, "same"); // less than is shown
    const better = BETTER[name] ? Math.sign(y - x) === BETTER[name] : null;
    const share = x ? ` (${y > x ? "+" : "−"}${number(Math.abs((100 * (y - x)) / x), 3)} %)` : "";
    return h("td", { class: `n ${better === null ? "" : better ? "good" : "worse"}` }, `${y > x ? "+" : "−"}${number(Math.abs(y - x), 3)} ${unitOf(name)}${share}`, better === null ? null : h("span", { class: "unseen" }, better ? " better" : " worse"));
  };
  return h(
    "section",
    { class: "card" },
    h("h2", {}, "Figures"),
    h("div", { class: "scroll" }, h("table", { class: "sides" },
      h("thead", {}, h("tr", {}, h("td", {}), h("th", { class: "n" }, "First: ", link(one)), h("th", { class: "n" }, "Second: ", link(two)), h("th", { class: "n" }, "Change"))),
      h("tbody", {},
        h("tr", {}, h("th", { scope: "row" }, "State"), [one, two].map((job) => h("td", { class: "n state" }, stateOf(job))), h("td", {}, "")),
        names.map((name) => h("tr", {}, h("th", { scope: "row" }, figureName(name)), h("td", { class: "n" }, value(one, name)), h("td", { class: "n" }, value(two, name)), change(name))),
        h("tr", {}, h("th", { scope: "row" }, "Planned in"), [one, two].map((job) => h("td", { class: "n" }, job.seconds ? duration(job.seconds) : "–")), h("td", {}, "")),
      ))),
  );
}

// Both plans in one picture, where both have a replay; it is loaded when it is wanted, and then for other choices too.
function inView(a, b, lists) {
  if (a === b) return [];
  const place = h("div", {});
  const none = lists.map((files) => !files.some((file) => file.name === "replay.html"));
  const open = async () => {
    wanted = true;
    button.disabled = true;
    button.textContent = "Loading …";
    try {
      const { openBoth } = await script("compare_view.js");
      const made = await openBoth(place, a, b, left);
      if (!made) return; // something else was chosen meanwhile
      globalThis.both = made;
      button.remove();
    } catch (error) {
      if (!place.isConnected) return;
      button.disabled = false;
      button.textContent = "Try again";
      tell(error);
    }
  };
  const button = h("button", { type: "button", class: "small", id: "both-open", onclick: open }, "Draw both over each other");
  const why = none[0] && none[1] ? "Neither has a plan to draw." : `The ${none[0] ? "first" : "second"} has no plan to draw.`;
  const section = h("section", { class: "card flush view", "aria-labelledby": "both-title" }, h("div", { class: "view-head" }, h("h2", { id: "both-title" }, "Both in 3D"), none.some(Boolean) ? h("span", { class: "soft" }, why) : button), place);
  if (wanted && !none.some(Boolean)) queueMicrotask(open); // when it is on the page
  return [section];
}

const MOST_LINES = 12;

// The lines that differ, from the first to the last that does.
function between(x, y) {
  let [start, back] = [0, 0];
  while (start < Math.min(x.length, y.length) && x[start] === y[start]) start += 1;
  while (back < Math.min(x.length, y.length) - start && x.at(-1 - back) === y.at(-1 - back)) back += 1;
  return [start, x.slice(start, x.length - back), y.slice(start, y.length - back)];
}

// Programs by name: the same, of one alone, or with other lines, which are read when somebody asks for them.
function programs(a, b, lists) {
  const [one, two] = lists.map((files) => new Map(files.filter((file) => file.name.startsWith("programs/")).map((file) => [file.name, file.sha256])));
  const names = [...new Set([...one.keys(), ...two.keys()])].sort();
  const row = (name) => {
    const place = h("div", {});
    const read = async () => {
      try {
        const [x, y] = await Promise.all([a, b].map(async (id) => (await text(fileOf(id, name))).split("\n")));
        const [start, left, right] = between(x, y);
        const side = (title, some) => h("div", {}, h("h3", {}, title), h("pre", { class: "lines", tabIndex: 0 }, some.slice(0, MOST_LINES).join("\n"), some.length > MOST_LINES ? `\n… ${some.length - MOST_LINES} more` : ""));
        place.replaceChildren(h("p", { class: "soft" }, `From line ${start + 1}: ${left.length} lines of ${x.length} in the first, ${right.length} of ${y.length} in the second.`), h("div", { class: "columns" }, side("First", left), side("Second", right)));
        button.remove();
      } catch (error) {
        tell(error);
      }
    };
    const button = h("button", { type: "button", class: "small", "aria-label": `Show what differs in ${name.slice(9)}`, onclick: read }, "Show");
    const says = !two.has(name) ? "only in the first" : !one.has(name) ? "only in the second" : one.get(name) === two.get(name) ? "the same" : "differs";
    return h("li", {}, h("span", {}, h("code", {}, name.slice(9)), ` ${says} `), says === "differs" ? button : null, place);
  };
  return h("section", { class: "card" }, h("h2", {}, "Programs"), names.length ? h("ul", { class: "programs" }, names.map(row)) : h("p", { class: "soft" }, "Neither job has programs."));
}

function fields(p, q) {
  const found = differences(p, q);
  return h(
    "section",
    { class: "card" },
    h("h2", {}, "Differences between the problems"),
    found.length
      ? h("div", { class: "scroll" }, h("table", { class: "sides" }, h("thead", {}, h("tr", {}, h("th", {}, "Field"), h("th", {}, "First"), h("th", {}, "Second"))), h("tbody", {}, found.slice(0, 100).map(([at, x, y]) => h("tr", {}, h("th", { scope: "row" }, fieldName(at.join(".")), unitOf(String(at.at(-1))) ? h("span", { class: "soft" }, ` ${unitOf(String(at.at(-1)))}`) : null), h("td", {}, short(x)), h("td", {}, short(y)))))))
      : h("p", { class: "soft" }, "Nothing: both are the same problem."),
    found.length > 100 ? h("p", { class: "soft" }, `${found.length - 100} more`) : null,
  );
}

function issues(one, two) {
  const key = (issue) => JSON.stringify([issue.code, issue.severity, issue.arm, issue.field]);
  const only = (a, b) => (a.issues ?? []).filter((issue) => !(b.issues ?? []).some((other) => key(other) === key(issue)));
  const both = (one.issues ?? []).filter((issue) => !only(one, two).includes(issue));
  const column = (title, some) => h("div", {}, h("h3", {}, title), some.length ? issueList(some) : h("p", { class: "soft" }, "None."));
  return h("section", { class: "card" }, h("h2", {}, "Issues"), h("div", { class: "columns" }, column("Only the first", only(one, two)), column("Only the second", only(two, one))), both.length ? column("Both", both) : null);
}

const show = () => compare().catch(tell);
async function begin() {
  const faults = await patiently(load);
  ready();
  await show();
  if (faults.length) tell(faults[0]);
}

$("swap").append(icon("swap"));
for (const name of ["a", "b"]) $(name).addEventListener("change", show);
$("swap").addEventListener("click", () => {
  [$("a").value, $("b").value] = [$("b").value, $("a").value];
  show();
});
await begin().catch((error) => {
  ready();
  tell(error);
});
