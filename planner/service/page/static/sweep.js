// A field at several values: a job for each, all or none.
import { once, post, upload } from "./api.js";
import { patiently } from "./common.js";
import { $, h } from "./dom.js";
import { fieldName } from "./issues.js";

// [path] of all numbers of a problem that stand for themselves.
export function numbers(data, path = []) {
  if (typeof data === "number") return [path];
  if (data === null || typeof data !== "object") return [];
  return Object.entries(data).flatMap(([key, value]) => numbers(value, [...path, key]));
}

const MOST_FIELDS = 400; // of tables nobody sweeps a single number

// Gives back what draws the fields anew.
export function setUpSweep(state, files, draft, refused) {
  const draw = () => {
    const found = [...numbers(state.problem.operations, ["operations"]), ...numbers(state.problem.stock, ["stock"]), ...numbers(state.problem.settings, ["settings"])].slice(0, MOST_FIELDS);
    $("sweep-fields").replaceChildren(...found.map((path) => h("option", { value: path.join("."), label: fieldName(path.join(".")) })));
  };
  const values = () => $("sweep-values").value.split(/[\s;]+/).filter(Boolean);
  const ready = () => {
    $("sweep-go").disabled = !values().length || !$("sweep-field").value.trim();
    $("sweep-go").textContent = values().length > 1 ? `Create ${values().length} jobs` : "Create the jobs";
  };
  const redraw = () => {
    if (!$("sweep").open) return;
    draw();
    ready();
    $("sweep-go").scrollIntoView({ block: "nearest" }); // the card beside the form ends above it
  };
  $("sweep").addEventListener("toggle", redraw);
  for (const name of ["sweep-field", "sweep-values"]) $(name).addEventListener("input", ready);
  $("sweep-go").addEventListener("click", async () => {
    $("sweep-go").disabled = true;
    const asked = new URLSearchParams({ field: $("sweep-field").value.trim(), tag: $("sweep-tag").value });
    for (const one of values()) asked.append("value", one);
    try {
      const version = await draft.version();
      if (version) asked.append("draft", `${version.id}@${version.number}`);
      const [body, headers] = [upload(state.problem, files()), once()];
      await patiently(() => post(`/v1/sweeps?${asked}`, { body, headers }));
      state.sent = true;
      location.assign(`/?${new URLSearchParams({ tag: $("sweep-tag").value.trim().normalize("NFC") })}`);
    } catch (error) {
      refused(error);
      ready();
    }
  });
  return redraw;
}
