// The problem that is edited, kept on the server as a draft: saved after changes, stepped back and forth, with its history.
import { blob, json, post, put, Refused, text, Unreachable, upload } from "./api.js";
import { age, tell } from "./common.js";
import { $, announce, h, later, show } from "./dom.js";
import { readYaml } from "./yaml.js";

const SAVE_MS = 1500;
const STEP_MS = 800; // changes that come so soon after one another are one step
const MOST_STEPS = 100;
const MOST_CHARACTERS = 2e7;
const drafts = "/v1/drafts";
const pathOf = (id) => `${drafts}/${encodeURIComponent(id)}`;

// What the name of a problem leaves for a title: what has no place in one is left out (planner/service/texts.py).
export function titleOf(name) {
  const refused = /[\p{Cc}\p{Cf}\p{Co}\p{Cs}\p{Zl}\p{Zp}]/gu;
  const plain = name.normalize("NFC").replace(refused, (one) => (one === "\u200c" || one === "\u200d" ? one : ""));
  return [...plain.trim()].slice(0, 200).join("");
}

// What a draft is called that nobody has named by hand (planner/service/drafts.py, UNTITLED).
const calledBy = (problem) => titleOf(String(problem.name ?? "")) || "Draft";

// Whether a draft is as it was when it was sent.
export const wasSent = (about) => about.sent === about.version;

// Notes that a version was sent as that job: it is no unsent work any more.
export async function sentAs({ id, number }, job) {
  const body = JSON.stringify({ version: number, job });
  await post(`${pathOf(id)}/sent`, { body, headers: { "Content-Type": "application/json" } });
}

// What is kept, and of which version: {problem, files, source} for the page, and how it is called.
export async function fromDraft(id, number = null) {
  const about = await json(pathOf(id));
  const version = number ?? about.version;
  const base = `${pathOf(id)}/versions/${version}`;
  const [listed, body] = await Promise.all([json(base), text(`${base}/problem`)]);
  const files = await Promise.all(listed.files.map(async ({ name }) => [name, await blob(`${base}/files/${name.split("/").map(encodeURIComponent).join("/")}`)]));
  return { problem: readYaml(body), files: new Map(files), cell: "", source: `from ${about.kind === "draft" ? "the draft" : `the ${about.kind}`} ${about.title}`, about };
}

// Keeps a problem, a cell, a tool or a template under a title.
export async function keep(kind, title, content, files) {
  return (await post(`${drafts}?${new URLSearchParams({ kind, title })}`, { body: upload(content, files) })).json();
}

export class Draft {
  // state: {problem, files} of the page; restored() draws it anew
  constructor(state, restored) {
    Object.assign(this, { state, restored });
    this.soon = later(SAVE_MS, () => this.save());
    this.begin();
    $("undo").addEventListener("click", () => this.step(this.past, this.future, "Undone"));
    $("redo").addEventListener("click", () => this.step(this.future, this.past, "Redone"));
    $("history").addEventListener("click", () => this.showHistory().catch(tell));
    $("draft-theirs").addEventListener("click", () => this.open(this.id).catch(tell));
    $("draft-mine").addEventListener("click", () => {
      this.id = null;
      this.sent = new Map();
      this.wait(false);
      this.save();
    });
    addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.altKey || event.key.toLowerCase() !== "z" || event.target.matches("input, textarea, select")) return;
      event.preventDefault();
      $(event.shiftKey ? "redo" : "undo").click();
    });
  }

  // A new start: what was the draft stays what it is; this one is made with the first change.
  begin(about = null) {
    Object.assign(this, { id: about?.id ?? null, tag: about && `"${about.version}"`, sent: new Map(about ? this.state.files : []), past: [], future: [], dirty: false, at: 0 });
    this.follow(about?.title, !about || about.title === calledBy(this.state.problem));
    this.now = this.snapshot();
    this.wait(false);
    show($("draft-bar"), Boolean(Object.keys(this.state.problem).length));
    if (about && wasSent(about)) this.say(`The draft ${about.title} was submitted. Further changes are saved. `, about.job && h("a", { href: `/ui/jobs/${about.job}` }, "Its job"));
    else this.say(about ? `Saved as draft ${about.title}` : "");
    this.buttons();
  }

  // Its title, and whether that goes with the name of the problem: until somebody calls it otherwise.
  follow(title, follows) {
    Object.assign(this, { title, follows });
  }

  snapshot() {
    return { text: JSON.stringify(this.state.problem), files: new Map(this.state.files) };
  }

  changed() {
    const now = this.snapshot();
    const same = now.text === this.now.text && now.files.size === this.now.files.size && [...now.files].every(([name, file]) => this.now.files.get(name) === file);
    if (same) return;
    if (Date.now() - this.at > STEP_MS || !this.past.length) this.past.push(this.now);
    while (this.past.length > 1 && (this.past.length > MOST_STEPS || this.past.reduce((sum, one) => sum + one.text.length, 0) > MOST_CHARACTERS)) this.past.shift();
    Object.assign(this, { now, future: [], at: Date.now(), dirty: true });
    this.buttons();
    this.soon();
  }

  step(from, to, said) {
    const found = from.pop();
    if (!found) return;
    to.push(this.now);
    this.take(found);
    announce(said);
  }

  take(found) {
    Object.assign(this, { now: found, at: 0, dirty: true });
    this.state.problem = JSON.parse(found.text);
    this.state.files = new Map(found.files);
    this.buttons();
    this.restored();
    this.soon();
  }

  // Whether the service has all of it.
  kept() {
    return Boolean(this.id) && !this.dirty && !this.saving;
  }

  buttons() {
    $("undo").disabled = !this.past.length;
    $("redo").disabled = !this.future.length;
    show($("history"), Boolean(this.id));
    $("draft-bar").dataset.kept = String(this.kept()); // whether all of it is on the server
  }

  say(words, link = null) {
    if ($("draft-state").textContent !== words || link) $("draft-state").replaceChildren(words, ...(link ? [link] : []));
  }

  // Whether somebody else's version has to be settled first.
  wait(on, words = "") {
    this.waits = on;
    show($("draft-conflict"), on);
    $("draft-conflict-text").textContent = words;
  }

  save() {
    if (!this.saving && !this.waits && this.dirty) this.saving = this.send();
    return this.saving ?? Promise.resolve();
  }

  // Keeps what is not kept yet; the version that has what the page has now, null where it cannot be kept.
  async version() {
    await this.save();
    if (this.dirty) await this.save();
    return this.kept() ? { id: this.id, number: Number(this.tag.slice(1, -1)) } : null;
  }

  async send() {
    this.dirty = false;
    const saved = this.now;
    const { text: body, files } = saved;
    const own = this.past; // another start has another list
    const news = [...files].filter(([name, file]) => this.sent.get(name) !== file);
    try {
      const content = new Blob([body], { type: "application/json" });
      const problem = JSON.parse(body);
      const name = String(problem.name ?? "");
      const title = titleOf(name);
      const made = !this.id;
      const given = new URLSearchParams([...this.sent.keys()].filter((name) => !files.has(name)).map((name) => ["without", name]));
      if (this.follows && this.title !== calledBy(problem)) for (const one of [["title", title], ["instead", this.title]]) given.append(...one);
      const answer = this.id
        ? await put(`${pathOf(this.id)}?${given}`, { body: upload(content, news), headers: { "If-Match": this.tag } })
        : await post(`${drafts}?${new URLSearchParams({ title })}`, { body: upload(content, news) });
      const about = await answer.json();
      if (own !== this.past) return;
      Object.assign(this, { id: about.id, tag: `"${about.version}"`, sent: files });
      this.follow(about.title, (made || this.follows) && about.title === calledBy(problem));
      history.replaceState(null, "", `/ui/new?draft=${about.id}${location.hash}`);
      const other = this.follows && title !== name.normalize("NFC").trim() ? "; what no title may have of the name is left out of it" : "";
      this.say(`Saved as draft ${about.title}, version ${about.version}${other}`);
      this.buttons();
    } catch (error) {
      if (own !== this.past) return;
      this.dirty = true;
      if (error instanceof Unreachable) {
        this.say("Not saved yet: the service cannot be reached. Trying again …");
        setTimeout(() => this.save(), 3000);
      } else if (error instanceof Refused) {
        const words = error.issues.map((issue) => issue.message).join("; ");
        if (error.status === 412) this.wait(true, words);
        if (error.status === 404) this.id = null; // deleted elsewhere: the next change makes another one
        this.say(error.status === 404 ? "The draft was deleted elsewhere. Your next change saves it as a new draft." : error.status === 412 ? "Not saved" : `Not saved: ${words}`);
        if (error.status === 404) this.sent = new Map();
        if ([429, 503, 507].includes(error.status)) setTimeout(() => this.save(), 10_000);
      } else throw error;
    } finally {
      this.saving = null;
      if (this.dirty && this.now !== saved) this.soon();
      this.buttons();
    }
  }

  // The draft as it is on the server, or one of its versions, as another step.
  async open(id, number = null) {
    const found = await fromDraft(id, number);
    this.tag = `"${found.about.version}"`;
    this.wait(false);
    const text = JSON.stringify(found.problem);
    this.follow(found.about.title, number === null ? found.about.title === calledBy(found.problem) : this.follows && found.about.title === this.title);
    if (number === null) this.sent = found.files;
    this.past.push(this.now);
    this.future = [];
    this.take({ text, files: found.files });
    if (number === null) this.dirty = false;
    this.say(`Saved as draft ${found.about.title}, version ${found.about.version}`);
  }

  async showHistory() {
    const about = await json(pathOf(this.id));
    const take = (one) => async () => {
      $("history-ask").close();
      await this.open(this.id, one.number).catch(tell);
      announce(`Version ${one.number} is restored`);
    };
    $("history-list").replaceChildren(
      ...about.versions.map((one, i) =>
        h("li", {}, h("span", {}, h("b", {}, `Version ${one.number}`), " ", age(one.at), ", ", h("bdi", {}, one.by)), i ? h("button", { type: "button", class: "small", "aria-label": `Restore version ${one.number}`, onclick: take(one) }, "Restore") : h("span", { class: "soft" }, "present version"))),
    );
    $("history-ask").showModal();
  }
}
