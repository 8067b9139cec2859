// Two jobs side by side: state, figures, what differs in their problems, issues that only one has.
import { fileOf, job as path, json, text } from "./api.js";
import { banner, tell } from "./common.js";
import { $, h, icon } from "./dom.js";
import { short } from "./form.js";
import { fieldName, issueList } from "./issues.js";
import { badge } from "./outcome.js";
import { differences } from "./schema.js";
import { ago, BETTER, duration, figureName, figureOrder, number, STATES, unitOf } from "./words.js";
import { readYaml } from "./yaml.js";

const asked = new URLSearchParams(location.search);
const { jobs } = await json("/v1/jobs?limit=200").catch((error) => (tell(error), { jobs: [] }));

async function chooseFrom(select, chosen) {
  const known = [...jobs];
  if (chosen && !known.some((one) => one.id === chosen)) known.unshift(await json(path(chosen)));
  select.replaceChildren(
    ...(chosen ? [] : [h("option", { value: "" }, "Choose a job")]),
    ...known.map((one) => h("option", { value: one.id, selected: one.id === chosen }, `${one.name} · ${STATES[one.state]?.[0] ?? one.state} · ${ago(one.created)} · ${one.id.slice(0, 6)}`)),
  );
}

async function compare() {
  const [a, b] = [$("a").value, $("b").value];
  history.replaceState(null, "", `/ui/compare?a=${a}&b=${b}`);
  if (!a || !b) return $("result").replaceChildren(h("div", { class: "card empty" }, h("p", {}, "Choose two jobs, and what differs between them is shown here.")));
  const [one, two] = await Promise.all([a, b].map((id) => json(path(id))));
  const [p, q] = await Promise.all([a, b].map(async (id) => readYaml(await text(fileOf(id, "problem/problem.yaml")))));
  $("result").replaceChildren(figures(one, two), fields(p, q), issues(one, two));
  banner("");
}

const link = (job) => h("a", { href: `/ui/jobs/${job.id}` }, job.name);

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
        h("tr", {}, h("th", { scope: "row" }, "State"), h("td", { class: "n" }, badge(one.state)), h("td", { class: "n" }, badge(two.state)), h("td", {}, "")),
        names.map((name) => h("tr", {}, h("th", { scope: "row" }, figureName(name)), h("td", { class: "n" }, value(one, name)), h("td", { class: "n" }, value(two, name)), change(name))),
        h("tr", {}, h("th", { scope: "row" }, "Planned in"), [one, two].map((job) => h("td", { class: "n" }, job.seconds ? duration(job.seconds) : "–")), h("td", {}, "")),
      ))),
  );
}

function fields(p, q) {
  const found = differences(p, q);
  return h(
    "section",
    { class: "card" },
    h("h2", {}, "What differs in the problems"),
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

$("swap").append(icon("swap"));
await chooseFrom($("a"), asked.get("a")).catch(tell);
await chooseFrom($("b"), asked.get("b")).catch(tell);
for (const name of ["a", "b"]) $(name).addEventListener("change", () => compare().catch(tell));
$("swap").addEventListener("click", () => {
  [$("a").value, $("b").value] = [$("b").value, $("a").value];
  compare().catch(tell);
});
await compare().catch(tell);
