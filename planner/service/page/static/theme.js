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
  addEventListener("DOMContentLoaded", () => {
    const button = document.getElementById("theme");
    const dark = () =>
      root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    const tell = () => {
      const text = dark() ? "Use light colours" : "Use dark colours";
      button.title = text;
      button.setAttribute("aria-label", text);
    };
    button.addEventListener("click", () => {
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
    tell();
  });
})();
