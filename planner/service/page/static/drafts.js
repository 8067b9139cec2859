// What people keep: drafts, cells, tools, templates; opened, called otherwise, deleted.
import { json, post, remove } from "./api.js";
import { ask } from "./ask.js";
import { age, banner, me, patiently, ready, tell } from "./common.js";
import { $, announce, h, icon, show } from "./dom.js";
import { wasSent } from "./draft.js";

const KINDS = { draft: "Draft", cell: "Cell", tool: "Tool", template: "Template" };
const PAGE = 100;
const MOST = 1000; // of one answer
let own;
const path = (id) => `/v1/drafts/${encodeURIComponent(id)}`;
let named = null;

// As which job it was planned, and whether it is newer than that.
function sent(one) {
  if (!one.sent) return null;
  const job = one.job ? h("a", { href: `/ui/jobs/${one.job}` }, "a job") : "a job that was deleted";
  return [wasSent(one) ? ", submitted as " : `, version ${one.sent} submitted as `, job];
}

function row(one) {
  const opens = { draft: `/ui/new?draft=${one.id}`, template: `/ui/new?template=${one.id}` }[one.kind];
  const title = h("bdi", {}, one.title);
  return h("tr", {},
    h("td", {}, opens ? h("a", { href: opens, class: "job-name", title: one.title }, title) : h("b", { class: "job-name", title: one.title }, title), h("span", { class: "sub" }, [one.by !== own ? `by ${one.by}` : null, `version ${one.version}`].filter(Boolean).join(", "), sent(one))),
    h("td", {}, KINDS[one.kind]),
    h("td", { class: "wide" }, age(one.changed)),
    h("td", { class: "n" }, h("span", { class: "actions plans" },
      h("button", { type: "button", class: "small", "aria-label": `Rename ${one.title}`, onclick: () => rename(one) }, "Rename"),
      h("button", { type: "button", class: "small danger", "aria-label": `Delete ${one.title}`, onclick: () => drop(one) }, icon("bin")))));
}

let shown = PAGE; // as many as were asked for stay in view

async function load() {
  let drafts = [];
  let next = null;
  do {
    const asked = new URLSearchParams({ limit: Math.min(shown - drafts.length, MOST), ...(next && { cursor: next }) });
    const page = await json(`/v1/drafts?${asked}`);
    drafts = drafts.concat(page.drafts);
    next = page.next;
  } while (next && drafts.length < shown);
  own = (await me)?.name;
  show($("table"), drafts.length > 0);
  show($("empty"), !drafts.length);
  show($("more"), Boolean(next));
  $("rows").replaceChildren(...drafts.map(row));
}

$("more").addEventListener("click", async () => {
  const first = shown;
  shown += PAGE;
  await load().catch(tell);
  $("rows").children[first]?.querySelector("a, button")?.focus();
});

function rename(one) {
  named = one;
  $("rename-name").value = one.title;
  $("rename-ask").returnValue = "";
  $("rename-ask").showModal();
}

async function drop(one) {
  if (!(await ask(`${one.title} and its ${one.version > 1 ? "versions are" : "content is"} deleted for the whole team.`, "Delete it"))) return;
  try {
    await remove(path(one.id));
    announce("Deleted");
    banner("");
    await load();
  } catch (error) {
    tell(error);
  }
}

$("rename-ask").addEventListener("close", async () => {
  if ($("rename-ask").returnValue !== "yes") return;
  try {
    await post(path(named.id), { method: "PATCH", body: JSON.stringify({ title: $("rename-name").value }), headers: { "Content-Type": "application/json" } });
    banner("");
    await load();
  } catch (error) {
    tell(error);
  }
});
ready();
await patiently(load).catch(tell);
