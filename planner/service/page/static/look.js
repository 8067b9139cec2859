// One job for who has a link to look: state, figures, issues, report, replay. It asks for nothing else.
import { fileOf, job as path, json, Refused } from "./api.js";
import { $, h, show } from "./dom.js";
import { issueItem, sorted } from "./issues.js";
import { badge, outcomeOf, tiles } from "./outcome.js";
import { ago, duration, isOpen, minute, processName } from "./words.js";

const { job: id, look, signature } = $("look").dataset;
const EVERY_MS = 5000;
const WORDS = { released: "programs released", withdrawn: "release of the programs withdrawn", "not-released": "programs not released" };

function draw(job) {
  show($("look"), true);
  document.title = `${job.title || job.name} · Tandem`;
  $("name").textContent = job.title || job.name;
  badge(job.state, $("state"));
  const facts = [job.title ? job.name : null, job.processes.map(processName).join(", "), `created ${ago(job.created)}`, isOpen(job.state) ? job.stage : null, job.seconds ? `planned in ${duration(job.seconds)}` : null, WORDS[job.release], `this link expires ${minute(job.expires)}`];
  $("facts").textContent = facts.filter(Boolean).join(" · ");
  const figures = tiles(job.metrics);
  show($("figures"), figures.length > 0);
  $("figures").replaceChildren(...figures);
  show($("outcome"), !isOpen(job.state));
  if (!isOpen(job.state)) {
    const outcome = outcomeOf(job, job.issues);
    $("outcome").className = `card outcome ${outcome.kind}`;
    $("outcome-title").textContent = outcome.title;
    $("outcome-text").textContent = outcome.text;
  }
  show($("no-issues"), !job.issues.length);
  $("issues").replaceChildren(...sorted(job.issues).map((issue) => issueItem(issue)));
  const asked = new URLSearchParams({ look, signature });
  $("files").replaceChildren(...job.files.map((name) => h("a", { class: "button", href: `${fileOf(id, name)}?${asked}`, target: "_blank", rel: "noopener noreferrer" }, `Open the ${name.split(".")[0]}`)));
}

async function follow() {
  let open = true;
  try {
    const job = await json(`${path(id)}/looks/${encodeURIComponent(look)}?${new URLSearchParams({ signature })}`, { credentials: "omit" });
    show($("banner"), false);
    draw(job);
    open = isOpen(job.state);
  } catch (error) {
    $("banner").className = "banner bad";
    $("banner").textContent = error.message;
    show($("banner"), true);
    if (error instanceof Refused && error.status === 404) {
      show($("look"), false);
      open = false;
    }
  }
  if (open) setTimeout(follow, EVERY_MS);
}
await follow();
