// Runs before the first paint: light or dark as chosen, else as the system has it.
(() => {
  const root = document.documentElement;
  const apply = (name) => {
    if (name === "light" || name === "dark") root.dataset.theme = name;
    else delete root.dataset.theme;
  };
  let chosen = null;
  try {
    chosen = localStorage.getItem("tandem-theme");
  } catch {
    chosen = null; // storage may be forbidden; the system's choice holds
  }
  apply(chosen);
  const dark = () =>
    root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  const tell = () => {
    const button = document.getElementById("theme");
    if (!button) return;
    const text = dark() ? "Use light colours" : "Use dark colours";
    button.title = text;
    button.setAttribute("aria-label", text);
  };
  // heard from the first paint on, before there are the scripts of the page
  addEventListener("click", (event) => {
    if (!event.target.closest?.("#theme")) return;
    const next = dark() ? "light" : "dark";
    apply(next);
    try {
      localStorage.setItem("tandem-theme", next);
    } catch {
      return tell();
    }
    tell();
    dispatchEvent(new Event("themechange"));
  });
  document.addEventListener("readystatechange", tell);
  // a file that is dropped takes the place of no page, whoever hears it or does not
  for (const name of ["dragover", "drop"]) addEventListener(name, (event) => event.dataTransfer?.types.includes("Files") && event.preventDefault());
  // a page whose scripts do not come stays disabled, and says so
  const stuck = (event) => {
    const place = event.target instanceof HTMLScriptElement && document.getElementById("banner");
    if (!place) return;
    place.textContent = "This page was not loaded completely and does not work. Reload it.";
    place.className = "banner bad";
    place.hidden = false;
  };
  addEventListener("error", stuck, true);
})();
