// Asks before something is lost; the dialog takes the keyboard, Escape means no.
import { $ } from "./dom.js";

// Whether to go on: text says what would be lost, yes what the button does.
export function ask(text, yes) {
  const dialog = $("ask");
  $("ask-text").textContent = text;
  $("ask-yes").textContent = yes;
  dialog.returnValue = "";
  return new Promise((answer) => {
    dialog.addEventListener("close", () => answer(dialog.returnValue === "yes"), { once: true });
    dialog.showModal();
  });
}
