// Cells, tools and templates that people keep for later, in the form of a new job.
import { json } from "./api.js";
import { banner, tell } from "./common.js";
import { $, announce, h, show } from "./dom.js";
import { fromDraft, keep, wasSent } from "./draft.js";
import { lastOf, naming } from "./files.js";

const WORDS = { cell: "cell", tool: "tool", template: "template" };
const filesOf = (data, files) => {
  const names = new Set(naming(data).map(([, one]) => lastOf(one.file)));
  return [...files].filter(([name]) => names.has(lastOf(name)));
};
const alike = async (a, b) => {
  if (a.size !== b.size) return false;
  const [one, other] = (await Promise.all([a.arrayBuffer(), b.arrayBuffer()])).map((bytes) => new Uint8Array(bytes));
  return one.every((byte, i) => byte === other[i]);
};

export class Keeping {
  // state of the page; took(what) draws it anew after a cell or a tool was put in
  constructor(state, took) {
    Object.assign(this, { state, took, kept: [] });
    $("keep-cell").addEventListener("click", () => this.ask("cell", this.state.problem.cell));
    $("keep-tool").addEventListener("click", () => this.ask("tool", this.arm()?.tool));
    $("keep-template").addEventListener("click", () => this.ask("template", this.state.problem));
    $("kept-cell").addEventListener("change", () => this.putCell().catch(tell));
    $("kept-tool").addEventListener("change", () => this.putTool().catch(tell));
    $("keep-ask").addEventListener("close", () => $("keep-ask").returnValue === "yes" && this.save().catch(tell));
  }

  arm() {
    const arms = this.state.problem.cell?.arms ?? [];
    return arms.find((arm) => arm.name === $("tool-arm").value) ?? arms[0];
  }

  async load() {
    const lists = await Promise.all(["cell", "tool", "template", "draft"].map((kind) => json(`/v1/drafts?kind=${kind}`)));
    this.kept = lists.flatMap((list) => list.drafts).filter((one) => one.kind !== "draft" || !wasSent(one)); // many drafts crowd nothing out that was kept
    const options = (kind) => this.kept.filter((one) => one.kind === kind).map((one) => h("option", { value: one.id, dir: "auto" }, one.title));
    for (const kind of ["cell", "tool"]) {
      $(`kept-${kind}`).replaceChildren(h("option", { value: "" }, "choose one"), ...options(kind));
      show($(`kept-${kind}-line`), options(kind).length > 0);
    }
    const groups = [["template", "Templates"], ["draft", "Drafts"]].filter(([kind]) => options(kind).length);
    $("kept").replaceChildren(h("option", { value: "" }, "choose one"), ...groups.map(([kind, label]) => h("optgroup", { label }, options(kind))));
    show($("kept-line"), groups.length > 0);
  }

  draw() {
    const arms = Array.isArray(this.state.problem.cell?.arms) ? this.state.problem.cell.arms : [];
    const chosen = $("tool-arm").value;
    $("tool-arm").replaceChildren(...arms.map((arm) => h("option", { value: String(arm?.name ?? ""), selected: arm?.name === chosen }, String(arm?.name ?? ""))));
    show($("keeping"), arms.length > 0);
  }

  ask(kind, content) {
    if (!content) return;
    this.asked = { kind, content };
    $("keep-title").textContent = `Save this ${WORDS[kind]} for later`;
    $("keep-name").value = kind === "template" ? String(content.name ?? "") : "";
    $("keep-ask").returnValue = "";
    $("keep-ask").showModal();
    $("keep-name").select(); // what is typed takes the place of what is proposed
  }

  async save() {
    const { kind, content } = this.asked;
    const files = kind === "template" ? this.state.files : filesOf(content, this.state.files);
    const made = await keep(kind, $("keep-name").value, content, files);
    announce(`The ${WORDS[kind]} ${made.title} is saved`);
    $("draft-state").textContent = `The ${WORDS[kind]} ${made.title} is saved`;
    await this.load();
  }

  async chosen(kind) {
    const id = $(`kept-${kind}`).value;
    $(`kept-${kind}`).value = "";
    if (!id) return null;
    const found = await fromDraft(id);
    const taken = await this.taken(found.files);
    if (taken.length) {
      const titles = `${WORDS[kind]} ${found.about.title}`;
      banner(`The ${titles} contains a file with the name of another file here but different content: ${taken.join(", ")}. Nothing was inserted. Rename or remove that file first.`);
      return null;
    }
    for (const [name, file] of found.files) this.state.files.set(name, file);
    return found;
  }

  // Names of files whose place something else has: put in, they would change the shape of other bodies.
  async taken(files) {
    const known = new Map([...this.state.files].map(([name, file]) => [lastOf(name), file]));
    const out = [];
    for (const [name, file] of files) {
      const here = known.get(lastOf(name));
      if (here && !(await alike(here, file))) out.push(name);
    }
    return out;
  }

  async putCell() {
    const found = await this.chosen("cell");
    if (found) this.took(found.problem, null, found.about.title);
  }

  async putTool() {
    const arm = this.arm();
    const found = arm && (await this.chosen("tool"));
    if (found) this.took(found.problem, arm, found.about.title);
  }
}

// Robots that a problem names and the catalogue has no more, in words; nothing where all are there.
export function goneRobots(problem, robots) {
  const arms = Array.isArray(problem.cell?.arms) ? problem.cell.arms : [];
  const gone = arms.filter((arm) => typeof arm?.robot === "string" && !robots.includes(arm.robot));
  return gone.map((arm) => `The robot ${arm.robot} of arm ${arm.name} is no longer in the catalogue. Choose another one under Cell.`).join(" ");
}
