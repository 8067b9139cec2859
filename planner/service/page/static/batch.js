// Several problem files at once: a job for each, all or none.
import { once, post, Refused } from "./api.js";
import { banner, patiently, tell } from "./common.js";
import { $, announce, h, icon, show } from "./dom.js";
import { issueItem, sorted } from "./issues.js";
import { isMap, parse } from "./yaml.js";

const READ = /\.(ya?ml|json)$/i;

// Whether a text is a problem, and not a cell, an element or a table beside one; one that cannot be read may be.
export function isProblem(text) {
  try {
    const found = parse(text);
    return isMap(found) && "operations" in found;
  } catch {
    return true;
  }
}

// {problems, files} of what was chosen.
export async function sortFiles(chosen) {
  const kinds = await Promise.all(chosen.map(async (file) => READ.test(file.name) && isProblem(await file.text())));
  return { problems: chosen.filter((_, i) => kinds[i]), files: chosen.filter((_, i) => !kinds[i]) };
}

let now = { problems: [], files: [] };

// Shows what was chosen, to be made into jobs.
export function openBatch(found) {
  now = found;
  show($("batch"), true);
  $("batch-title").textContent = `${now.problems.length} problems`;
  $("batch-list").replaceChildren(...now.problems.map((one) => h("li", {}, icon("file"), h("bdi", {}, one.name), h("ul", { class: "issues" }))));
  $("batch-files").textContent = now.files.length ? `With ${now.files.map((one) => one.name).join(", ")}: each problem uses the files that it states.` : "No other files were selected.";
  $("batch-go").textContent = `Create ${now.problems.length} jobs`;
  $("batch-go").disabled = false;
  $("batch").scrollIntoView({ block: "nearest" });
  $("batch-title").focus();
  announce(`${now.problems.length} problems are selected`);
}

export const closeBatch = () => show($("batch"), false);

// As it is sent: what forms write otherwise is left out.
const nameOf = (file) => file.name.replace(/["\r\n]/g, "_");

// What is wrong, at the problems that it is wrong of; the others have nothing.
function tellFaults({ issues, of }) {
  const rows = [...$("batch-list").children];
  const left = [];
  for (const row of rows) row.lastChild.replaceChildren();
  for (const issue of sorted(issues)) {
    const number = of[issues.indexOf(issue)];
    if (number === undefined) {
      left.push(issue.message);
      continue;
    }
    const own = `${[...nameOf(now.problems[number])].slice(0, 80).join("")}: `; // it stands there already
    const message = issue.message.startsWith(own) ? issue.message.slice(own.length) : issue.message;
    rows[number].lastChild.append(issueItem({ ...issue, message }));
  }
  const wrong = rows.filter((row) => row.lastChild.children.length).length;
  banner(left.length ? left.join(" · ") : `${wrong} of ${rows.length} problems cannot be read, so no job was created.`);
}

export function setUpBatch() {
  $("batch-close").addEventListener("click", closeBatch);
  $("batch-go").addEventListener("click", async () => {
    $("batch-go").disabled = true;
    banner("");
    const tag = $("batch-tag").value.trim().normalize("NFC");
    const form = new FormData();
    for (const one of now.problems) form.append("problem", one, nameOf(one));
    for (const one of now.files) form.append("files", one, one.name);
    const headers = once();
    try {
      await patiently(() => post(`/v1/batches?${new URLSearchParams({ tag })}`, { body: form, headers }));
      location.assign(`/?${new URLSearchParams({ tag })}`);
    } catch (error) {
      if (error instanceof Refused && error.status === 422) tellFaults(error);
      else tell(error);
      $("batch-go").disabled = false;
    }
  });
}
