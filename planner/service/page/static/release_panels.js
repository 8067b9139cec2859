// Releases the proven panels of an element by one act, each as it was shown; those that are refused are named.
import { post } from "./api.js";
import { banner, me, sign, signed, tell } from "./common.js";
import { $, announce, h, icon, show } from "./dom.js";
import { plural } from "./words.js";

// What was withdrawn had its reason, and is released again where that stands: at its job.
export const toRelease = (panels) => panels.filter((panel) => panel.state === "verified" && panel.release === "not-released");

// One of them, in a word: jobs where raw blocks have some, too.
const named = (problems) => (problems.some((one) => one.said) ? "job" : "panel");

// How the button stands for these panels and jobs of raw blocks.
export function drawReleasePanels(panels) {
  const some = toRelease(panels);
  const proven = panels.filter((panel) => panel.state === "verified").length;
  show($("release-all"), proven > 0);
  $("release-all").disabled = !some.length;
  $("release-all").textContent = some.length ? `Release ${some.length === proven ? "all " : ""}${plural(some.length, `proven ${named(panels)}`)}` : panels.some((panel) => panel.release === "withdrawn") ? "Withdrawn. Release them in their jobs." : `All proven ${named(panels)}s are released`;
}

// path(): the element's address; panels(): as they are shown now; after(): reads them anew.
export function setUpReleasePanels(path, panels, after) {
  let nameless = false; // nobody is known by a token
  let shown = [];
  $("release-all").addEventListener("click", async () => {
    const who = await me;
    nameless = Boolean(who && !who.tokens);
    show($("release-who"), nameless);
    $("release-name").required = nameless;
    shown = toRelease(panels());
    const left = panels().length - shown.length;
    $("release-count").textContent = `${plural(shown.length, named(panels()))}${left ? `; ${plural(left, "other")} excluded: not proven, already released, or withdrawn` : ", all of them"}.`;
    $("release-what").replaceChildren(...shown.flatMap((one) => [h("dt", {}, one.id), h("dd", {}, h("code", { title: one.digest }, one.digest.slice(0, 16)))]));
    $("release-name").value = signed();
    $("release-ask").returnValue = "";
    $("release-ask").showModal();
    if (nameless && !$("release-name").value) $("release-name").focus();
  });
  $("release-ask").addEventListener("close", async () => {
    if ($("release-ask").returnValue !== "yes") return;
    const by = nameless ? { name: $("release-name").value } : {};
    if (nameless) sign(by.name);
    const asked = Object.fromEntries(shown.map((one) => [one.id, { job: one.job, digest: one.digest }]));
    let done = null;
    try {
      const body = JSON.stringify({ panels: asked, note: $("release-note").value, ...by });
      done = await (await post(`${path()}/release`, { body, headers: { "Content-Type": "application/json" } })).json();
      $("release-note").value = "";
    } catch (error) {
      tell(error);
    }
    await after();
    if (!done) return;
    announce(`${plural(done.releases.length, named(panels()))} released`);
    banner(done.refused.map((one) => `${one.panel} was not released: ${one.issues.map((issue) => issue.message).join("; ")}`).join(" · "), "warn");
    $("release-all").focus();
  });
}

// Whether the programs of a panel may run, in a word.
export function released(panel) {
  if (panel.state !== "verified" || !panel.release) return null;
  const words = { released: "released", withdrawn: "release withdrawn", "not-released": "not released" }[panel.release];
  return h("span", { class: `sub released-${panel.release}` }, panel.release === "released" ? icon("check") : null, words);
}
