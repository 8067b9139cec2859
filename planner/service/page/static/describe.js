// What people call a job, or an element, which is one, beside the name that its problem has: title, tags, notes.
import { job as path, post } from "./api.js";
import { tell } from "./common.js";
import { $, announce, h, show } from "./dom.js";

// list: the page that a tag leads to
export function drawDescription(job, list = "/") {
  document.title = `${job.title || job.name} · Tandem`;
  $("name").textContent = job.title || job.name;
  const tags = job.tags ?? [];
  show($("job-tags"), tags.length > 0);
  $("job-tags").replaceChildren(...tags.map((tag) => h("a", { class: "tag", href: `${list}?${new URLSearchParams({ tag })}` }, h("bdi", {}, tag))));
  show($("job-notes"), Boolean(job.notes));
  $("job-notes").textContent = job.notes ?? "";
}

export function setUpDescription(job, after) {
  $("describe").addEventListener("click", () => {
    $("describe-name").value = job().title ?? "";
    $("describe-tags").value = (job().tags ?? []).join(", ");
    $("describe-notes").value = job().notes ?? "";
    $("describe-ask").returnValue = "";
    $("describe-ask").showModal();
  });
  $("describe-ask").addEventListener("close", async () => {
    if ($("describe-ask").returnValue !== "yes") return;
    const tags = [...new Set($("describe-tags").value.split(",").map((tag) => tag.trim()).filter(Boolean))];
    const said = { title: $("describe-name").value, tags, notes: $("describe-notes").value };
    try {
      await post(path(job().id), { method: "PATCH", body: JSON.stringify(said), headers: { "Content-Type": "application/json" } });
      announce("Saved");
      await after();
    } catch (error) {
      tell(error);
    }
    $("describe").focus();
  });
}
