// What all pages share: when they work, the banner, logging out, ages.
import { json, remove, Refused, text, Unreachable } from "./api.js";
import { $, announce, h, show } from "./dom.js";
import { ago } from "./words.js";

export function banner(text, kind = "bad") {
  const place = $("banner");
  if (!place) return;
  show(place, Boolean(text));
  place.className = `banner ${kind}`;
  if (place.textContent !== text) place.textContent = text ?? "";
}

// Enter in a field of a dialog presses the button that keeps what was typed, and none where there is no such: by
// itself it is the first one, which leaves all as it was.
document.addEventListener("keydown", (event) => {
  const form = event.key === "Enter" && !event.isComposing && event.target instanceof HTMLInputElement && event.target.closest('dialog form[method="dialog"]');
  if (!form) return;
  event.preventDefault();
  form.querySelector("button[data-enter]")?.click();
});

// The page's controls work from now on; they are disabled until somebody hears them.
export function ready() {
  $("whole").disabled = false;
  $("main").removeAttribute("aria-busy");
}

const RETRY_MS = 2000;

// What is asked for; again and again while the service cannot be reached.
export async function patiently(ask) {
  for (let told = false; ; told = true) {
    try {
      const found = await ask();
      if (told) reached();
      return found;
    } catch (error) {
      if (!(error instanceof Unreachable)) throw error;
      tell(error, true);
    }
    await new Promise((after) => setTimeout(after, RETRY_MS));
  }
}

// A script that is loaded when it is wanted. Browsers do not ask again for one that did not come, so it is seen first
// whether the service sends it.
export async function script(name) {
  await patiently(() => text(`/ui/static/${name}`));
  try {
    return await import(`./${name}`);
  } catch {
    throw new Refused(0, [{ code: "service.request", severity: "error", message: "a script of this page was not loaded. Reload the page." }]);
  }
}

// The service answers: what was told of one that is away is past. What it refused stays until something else is done.
export function reached() {
  if ($("banner")?.classList.contains("warn")) banner("");
}

// Says what went wrong with a request; again: it is sent once more by itself.
export function tell(error, again = false) {
  if (error instanceof Unreachable) banner(`The service cannot be reached. ${again === true ? "Trying again …" : "Try again in a moment."}`, "warn");
  else if (error instanceof Refused) banner(error.issues.map((issue) => (issue.hint ? `${issue.message.replace(/\.?$/, ".")} ${issue.hint}` : issue.message)).join(" · "));
  else {
    banner(`The page failed: ${error.message}`);
    throw error;
  }
}

// How long ago something was, with the moment itself on touch.
export const age = (at) => h("time", { dateTime: at, title: new Date(at).toLocaleString("en-GB") }, ago(at));

// Who released or withdrew something the last time, where the service asks for no tokens.
export const signed = () => localStorage.getItem("tandem-name") ?? "";
export const sign = (name) => localStorage.setItem("tandem-name", name);

// Who uses this page; null where that is not known yet. What his role does not allow is not shown.
export const me = document.body.dataset.page === "login" ? Promise.resolve(null) : json("/v1/session").catch(() => null);
me.then((who) => {
  if (!who) return;
  document.body.dataset.role = who.role;
  if (who.scope) document.body.dataset.scope = who.scope;
  const may = { submit: "own jobs only", released: `released programs only${who.tag ? `, ${who.tag}` : ""}` }[who.scope];
  if ($("me") && who.tokens) $("me").textContent = [who.name, who.team, may ?? who.role].filter(Boolean).join(" · ");
});

$("logout")?.addEventListener("click", async () => {
  try {
    await remove("/v1/session");
    announce("Logged out");
    location.assign("/ui/login");
  } catch (error) {
    tell(error);
  }
});
if ($("logout")) $("logout").disabled = false;
