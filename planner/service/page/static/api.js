// The service's HTTP API. A refusal becomes a Refused error with its issues.

import { h } from "./dom.js";

const version = document.querySelector(".version")?.textContent;
let told = false;

// A page that was left open while the service was updated says so, once.
function compare(answer) {
  const now = answer.headers.get("Tandem-Version");
  if (told || !now || !version || now === version) return;
  told = true;
  const again = h("button", { type: "button", class: "small", onclick: () => location.reload() }, "Reload");
  document.querySelector("main").prepend(h("p", { class: "banner warn", id: "outdated", role: "alert" }, `The service was updated to ${now}, and this page is of ${version}. What a draft has stays. `, again));
}

export class Refused extends Error {
  // of: of several things that were sent, which one each issue is of
  constructor(status, issues, of = []) {
    super(issues.map((issue) => issue.message).join("; "));
    Object.assign(this, { status, issues, of });
  }
}

export class Unreachable extends Error {}

async function ask(path, options = {}) {
  let answer;
  try {
    answer = await fetch(path, { credentials: "same-origin", ...options });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Unreachable("the service cannot be reached");
  }
  compare(answer);
  if (answer.ok) return answer;
  const said = await answer.json().catch((error) => {
    if (error.name === "AbortError") throw error; // nobody wants to know any more
    return null;
  });
  let issues = said?.issues ?? [];
  if (!issues.length) issues = [{ code: "service.request", severity: "error", message: `the service answered ${answer.status}` }];
  if (answer.status === 401 && document.body.dataset.page !== "login") {
    const back = encodeURIComponent(location.pathname + location.search + location.hash);
    location.assign(`/ui/login?next=${back}`);
  }
  throw new Refused(answer.status, issues, said?.of);
}

export const json = async (path, options) => (await ask(path, options)).json();
export const text = async (path, options) => (await ask(path, options)).text();
export const blob = async (path, options) => (await ask(path, options)).blob();
export const post = (path, options = {}) => ask(path, { method: "POST", ...options });
export const put = (path, options = {}) => ask(path, { method: "PUT", ...options });
export const remove = (path) => ask(path, { method: "DELETE" });

// Headers of a request that may be sent again and makes what it makes once.
export function once() {
  const key = [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
  return { "Idempotency-Key": key };
}

// The body of a job: the problem as JSON, or as the file that the user gave, and the files that it names.
export function upload(problem, files) {
  const form = new FormData();
  const body = problem instanceof Blob ? problem : new Blob([JSON.stringify(problem)], { type: "application/json" });
  form.append("problem", body, problem.name ?? "problem.json");
  for (const [name, content] of files) form.append("files", content, name);
  return form;
}

export const job = (id) => `/v1/jobs/${encodeURIComponent(id)}`;
export const fileOf = (id, name) => `${job(id)}/files/${name.split("/").map(encodeURIComponent).join("/")}`;
