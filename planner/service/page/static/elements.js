// Building elements: a new one, from files or a bundled one; and those there are.
import { blob, json, once, post, Refused, upload } from "./api.js";
import { age, banner, patiently, reached, ready, tell } from "./common.js";
import { $, announce, h, icon, later, show } from "./dom.js";
import { held } from "./files.js";
import { issueItem, sorted } from "./issues.js";
import { badge } from "./outcome.js";
import { isOpen } from "./words.js";
import { readYaml } from "./yaml.js";

const EVERY = 2000;
const SELDOM = 5000; // where nothing is under way: somebody else may send an element
let elements = new Map();
let next = null;
let examples = {};
let sending = false;

const given = new URLSearchParams(location.search);
let tags = given.getAll("tag");
let turn = 0; // of what was asked last; answers to former questions are dropped

function query(cursor) {
  const asked = new URLSearchParams({ limit: 50 });
  for (const tag of tags) asked.append("tag", tag);
  if ($("search").value.trim()) asked.append("search", $("search").value.trim());
  if (cursor) asked.append("cursor", cursor);
  return `/v1/elements?${asked}`;
}
const narrowed = () => tags.length > 0 || Boolean($("search").value.trim());

async function load(cursor = null) {
  const mine = turn;
  const page = await json(query(cursor));
  if (mine !== turn) return;
  if (cursor) for (const one of page.elements) elements.set(one.id, one);
  else elements = new Map([...page.elements.map((one) => [one.id, one]), ...[...elements].slice(50)]);
  if (cursor || elements.size <= 50) next = page.next ?? null;
  show($("table"), elements.size > 0);
  show($("empty"), !elements.size && !narrowed());
  show($("none"), !elements.size && narrowed());
  show($("older"), Boolean(next));
  const focus = document.activeElement?.dataset.key;
  $("rows").replaceChildren(...[...elements.values()].map(row));
  if (focus) document.querySelector(`[data-key="${CSS.escape(focus)}"]`)?.focus();
  reached();
}

function row(one) {
  const count = one.fields?.["panels.hexagons.count"];
  return h("tr", {},
    h("td", {}, h("a", { href: `/ui/elements/${one.id}`, class: "job-name", title: one.title || one.name, data: { key: one.id } }, h("bdi", {}, one.title || one.name)), (one.tags ?? []).map((tag) => h("button", { type: "button", class: "tag", onclick: () => narrow([...new Set([...tags, tag])]) }, h("bdi", {}, tag))), h("span", { class: "sub" }, [one.title ? one.name : null, one.id.slice(0, 8)].filter(Boolean).join(", "))),
    h("td", {}, badge(one.state), one.state === "running" ? h("span", { class: "sub" }, one.stage ?? "") : null),
    h("td", { class: "wide" }, `${count ? `${count} ` : ""}${one.kind ?? ""}`),
    h("td", { class: "n wide" }, one.planned ? String(one.planned) : ""),
    h("td", {}, age(one.created)));
}

function narrow(some) {
  tags = some;
  show($("tags"), tags.length > 0);
  $("tags").replaceChildren("With the tags", ...tags.map((tag) => h("button", { type: "button", class: "chip", "aria-label": `Without the tag ${tag}`, onclick: () => narrow(tags.filter((one) => one !== tag)) }, h("bdi", {}, tag), icon("cross"))));
  return anew();
}

// Asks anew, from the first page on, and keeps in the address what was asked.
function anew() {
  banner("");
  turn += 1;
  elements = new Map();
  next = null;
  const kept = new URLSearchParams(tags.map((tag) => ["tag", tag]));
  if ($("search").value.trim()) kept.append("search", $("search").value.trim());
  history.replaceState(null, "", kept.size ? `/ui/elements?${kept}` : "/ui/elements");
  return load().catch(tell);
}

async function again() {
  try {
    if (!document.hidden) await load();
  } catch (error) {
    tell(error, true);
  } finally {
    setTimeout(again, [...elements.values()].some((one) => isOpen(one.state)) || !$("banner").hidden ? EVERY : SELDOM);
  }
}

function busy(text) {
  show($("busy"), Boolean(text));
  $("busy").textContent = text;
  sending = Boolean(text);
  $("go").disabled = sending || !$("example").value;
}

// Sends an element; the page of it shows how it is divided.
async function send(element, files) {
  if (sending) return;
  $("issues").replaceChildren();
  banner("");
  try {
    busy("Reading the element …");
    const [body, headers] = [upload(element, await files()), once()];
    const made = await (await patiently(() => post("/v1/elements", { body, headers }))).json();
    location.assign(`/ui/elements/${made.id}`);
  } catch (error) {
    busy("");
    if (!(error instanceof Refused)) return tell(error);
    $("issues").replaceChildren(...sorted(error.issues).map((issue) => issueItem(issue)));
    announce(`The element has errors: ${error.issues.length} thing${error.issues.length > 1 ? "s" : ""} to correct`);
  }
}

// The element file among those that were chosen: the one that says so.
async function take(chosen) {
  const list = await held(chosen);
  if (!list.length) return;
  const own = [];
  for (const file of list) {
    if (!/\.(ya?ml|json)$/i.test(file.name)) continue;
    const data = await file.text().then(readYaml).catch(() => null);
    if (data === null ? list.length === 1 : "element" in data) own.push(file);
  }
  if (own.length !== 1) return banner(own.length ? `${own.map((file) => file.name).join(" and ")} are element files. Choose one, with the files that it uses.` : "None of these is an element file, which starts with element: 1. Choose it with all files that it uses.");
  await send(own[0], async () => list.filter((file) => file !== own[0]).map((file) => [file.name, file]));
}

async function begin() {
  examples = await patiently(() => json("/ui/example-elements"));
  const option = ([name, one]) => h("option", { value: name }, `${name} (${one.kind})`);
  $("example").replaceChildren(h("option", { value: "" }, "choose one"), ...Object.entries(examples).map(option));
}

$("example").addEventListener("change", () => {
  $("about").textContent = examples[$("example").value]?.about ?? "";
  busy("");
});
$("go").addEventListener("click", async () => {
  const name = $("example").value;
  const one = examples[name];
  const get = (file) => blob(`/ui/example/file?name=${encodeURIComponent(name)}&file=${encodeURIComponent(file)}`);
  try {
    const files = await Promise.all(one.files.map(async (file) => [file, await get(file)]));
    const own = new File([files.find(([file]) => file === one.file)[1]], one.file);
    await send(own, async () => files.filter(([file]) => file !== one.file));
  } catch (error) {
    tell(error);
  }
});
$("choose").addEventListener("click", () => $("files").click());
$("files").addEventListener("change", () => take([...$("files").files]).finally(() => ($("files").value = "")));
for (const name of ["dragover", "drop"])
  addEventListener(name, (event) => {
    event.preventDefault();
    $("drop").classList.toggle("over", name === "dragover");
    if (name === "drop") take([...event.dataTransfer.files]);
  });
addEventListener("dragleave", () => $("drop").classList.remove("over"));
$("search").value = given.get("search") ?? "";
$("search").addEventListener("input", later(250, anew));
$("older").addEventListener("click", () => load(next).catch(tell));

ready();
if ($("files").files.length) $("files").dispatchEvent(new Event("change")); // chosen before there was this script
setTimeout(again, EVERY);
await Promise.all([begin(), tags.length ? narrow(tags) : load()]).catch((error) => tell(error, true));
