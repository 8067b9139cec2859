// The audit log, for who may release: who did what, by job and act.
import { json } from "./api.js";
import { banner, patiently, ready, tell } from "./common.js";
import { $, h, later, show } from "./dom.js";

const asked = new URLSearchParams(location.search);
let next = null;
let turn = 0; // of what was asked last; answers to former questions are dropped

const moment = (at) => `${at.slice(0, 19).replace("T", " ")} UTC`;

function details(about) {
  const known = ["release", "file", "note", "reason", "released_by", "link", "made_by", "until", "kind"].filter((name) => about[name]);
  return known.map((name, i) => [i ? h("br") : null, `${name.replace("_", " ")}: `, h("bdi", {}, name === "until" ? moment(about[name]) : String(about[name]))]);
}

function row(one) {
  const name = h("bdi", {}, one.about?.name ?? one.job.slice(0, 8));
  const there = one.act !== "deleted" && !one.about?.kind;
  return h("tr", {},
    h("td", { class: "n" }, String(one.number)),
    h("td", {}, h("bdi", {}, one.by), h("span", { class: "sub" }, one.team ?? "")),
    h("td", {}, `${one.act} `, there ? h("a", { href: `/ui/jobs/${one.job}` }, name) : name, h("span", { class: "sub" }, one.job.slice(0, 8))),
    h("td", { class: "wide" }, details(one.about ?? {})),
    h("td", {}, h("time", { dateTime: one.at }, moment(one.at))));
}

async function load(cursor = null) {
  const mine = turn;
  const query = new URLSearchParams({ limit: 50 });
  if ($("act").value) query.append("act", $("act").value);
  if ($("of").value.trim()) query.append("job", $("of").value.trim());
  if (cursor) query.append("cursor", cursor);
  const page = await json(`/v1/audit?${query}`);
  if (mine !== turn) return;
  const rows = page.acts.map(row);
  if (cursor) $("rows").append(...rows);
  else $("rows").replaceChildren(...rows);
  next = page.next ?? null;
  show($("table"), $("rows").children.length > 0);
  show($("none"), !$("rows").children.length);
  show($("older"), next !== null);
  banner("");
}

const anew = () => {
  turn += 1;
  return load().catch(tell);
};
$("of").value = asked.get("job") ?? "";
if (asked.has("act")) $("act").value = asked.get("act");
$("act").addEventListener("change", anew);
$("of").addEventListener("input", later(300, anew));
$("older").addEventListener("click", () => load(next).catch(tell));
ready();
await patiently(load).catch(tell);
