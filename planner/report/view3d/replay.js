// The replay: a film with its bar, the key of its colours, and the controls above it.
import { between, byId, lastAt, Replay } from "./film.js";

const clockOf = (s) => `${Math.floor(s / 60)}:${(s % 60).toFixed(1).padStart(4, "0")}`;

// The colours of a figure with their scale, what the report says, and the figure at this moment.
class Key {
  constructor(view, section) {
    Object.assign(this, { view, section, layer: null });
  }

  show(layer) {
    this.layer = layer;
    this.section.hidden = !layer;
    if (!layer) return;
    const { low, high, key, limits, unit, title, words } = layer;
    const make = (tag, props, ...inside) => {
      const one = Object.assign(document.createElement(tag), props);
      one.append(...inside);
      return one;
    };
    const bar = make("div", { className: "scale" });
    bar.style.background = `linear-gradient(90deg, ${key.join(",")})`;
    for (const [value, word] of limits) {
      const tick = make("i", { title: `${word}: ${figure(value)} ${unit}` });
      tick.style.left = `${(100 * (value - low)) / (high - low)}%`;
      bar.append(tick);
    }
    const marks = limits.map(([value, word]) => `${word} ${figure(value)} ${unit}`);
    this.here = make("b", {});
    this.section.replaceChildren(
      make("h2", {}, title),
      bar,
      make("div", { className: "ends" }, make("span", {}, `${figure(low)} ${unit}`), make("span", {}, `${figure(high)} ${unit}${layer.points ? "" : " or more"}`)),
      make("p", {}, [words, ...new Set(marks)].filter(Boolean).join("; ")),
      ...(Object.keys(layer.values).length ? [make("p", {}, "here: ", this.here)] : []),
    );
    this.tell();
  }

  tell() {
    if (!this.layer || !this.here) return;
    const { values, unit } = this.layer;
    const { at, fine, now } = this.view;
    const key = Math.min(at + (now > fine[at] + 1e-4 ? 1 : 0), fine.length - 1);
    const all = Object.entries(values).map(([arm, found]) => [arm, this.view.read(found)[key]]);
    this.here.textContent = all.map(([arm, value]) => `${arm ? `${arm} ` : ""}${Number.isFinite(value) ? `${figure(value)} ${unit}` : "–"}`).join(", ");
  }
}

const figure = (value) => `${+value.toFixed(Math.abs(value) < 1 ? 2 : 1)}`.replace("-", "−");

// The bar: time, segments, targets, speed, keys.
class Bar {
  constructor(view, times, targets, moved) {
    Object.assign(this, { view, times, moved, at: 0, going: false, last: 0, end: times.end, targets: targets.runs, reached: view.read(targets.times) });
    this.input = byId("time");
    const lane = document.querySelector("#bar .lane");
    const stripe = (name, a, b, title, colour) => {
      const one = Object.assign(document.createElement("span"), { className: name, title });
      one.style.left = `${(100 * a) / this.end}%`;
      if (b !== null) one.style.width = `${(100 * (b - a)) / this.end}%`;
      if (colour) one.style.background = colour;
      lane.append(one);
    };
    for (const [a, b, name, colour] of times.segments) stripe("seg", a, b, name, colour);
    for (const [a, text] of times.stops) stripe("stop", a, null, text);
    this.input.addEventListener("input", () => this.go(this.input.valueAsNumber));
    this.input.addEventListener("keydown", (event) => this.key(event));
    byId("play").addEventListener("click", () => this.toggle());
    requestAnimationFrame((now) => this.step(now));
  }

  go(value) {
    this.at = Math.min(Math.max(value, 0), this.end);
    this.view.go(this.at);
    this.tell();
    this.moved();
  }

  set(going) {
    this.going = going;
    byId("play").textContent = going ? "❚❚" : "▶";
    byId("play").setAttribute("aria-label", going ? "Pause" : "Play");
  }

  toggle() {
    if (!this.going && this.at >= this.end) this.go(0);
    this.set(!this.going);
  }

  step(now) {
    if (this.going) {
      this.go(this.at + (Math.min(now - this.last, 250) / 1000) * byId("speed").value);
      if (this.at >= this.end) this.set(false);
    }
    this.last = now;
    requestAnimationFrame((next) => this.step(next));
  }

  // The target that the arms are on the way to, by its number; -1 on ways without any.
  target() {
    const { reached } = this;
    if (!reached.length || this.at < reached[0] - 1e-6 || this.at > reached.at(-1) + 1e-6) return -1;
    let k = lastAt(reached, this.at + 1e-6);
    if (reached[k] < this.at - 1e-6 && k + 1 < reached.length) k += 1;
    return k;
  }

  nameOf(k) {
    const run = this.targets.findLast(([first]) => first <= k);
    return run ? `${run[1]}/${k - run[0] + 1}` : "";
  }

  tell() {
    const { at, times } = this;
    const found = times.segments.find(([a, b]) => at >= a && at <= b) ?? times.segments.at(-1);
    const target = this.nameOf(this.target());
    const where = found && target.startsWith(found[2]) ? target : found?.[2] ?? "";
    const programs = this.onPrograms(at);
    this.input.value = at;
    this.input.style.setProperty("--done", `${(100 * at) / this.end}%`);
    this.input.setAttribute("aria-valuetext", `${clockOf(at)} of ${clockOf(this.end)}, ${where}`);
    document.querySelector("#bar .time").textContent = `${clockOf(at)} / ${clockOf(this.end)}`;
    document.querySelector("#bar .segment").textContent = `${where}${programs === null ? "" : ` · programs ${programs.toFixed(1)} s`}`;
    document.querySelector("#bar .say i").style.background = found?.[3] ?? "";
    const near = times.stops.filter(([time]) => Math.abs(time - at) < Math.max(this.end * 0.004, 0.05));
    const text = near.map(([, one]) => one).join(" · ");
    const place = document.querySelector("#bar .stopped");
    if (place.textContent !== text) place.textContent = text;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const step = this.end / 200;
    const near = (way) => {
      const k = this.target();
      const to = k < 0 ? (this.at < (this.reached[0] ?? 0) ? (way > 0 ? 0 : -1) : way < 0 ? this.reached.length - 1 : -1) : k + way;
      if (to >= 0 && to < this.reached.length) this.go(this.reached[to]);
    };
    const does = { ArrowRight: () => this.go(this.at + step), ArrowUp: () => this.go(this.at + step), ArrowLeft: () => this.go(this.at - step), ArrowDown: () => this.go(this.at - step), PageUp: () => this.go(this.at + 10 * step), PageDown: () => this.go(this.at - 10 * step), Home: () => this.go(0), End: () => this.go(this.end), ".": () => near(1), ",": () => near(-1), " ": () => this.toggle() }[event.key];
    if (!does) return false;
    event.preventDefault();
    event.stopPropagation();
    does();
    return true;
  }

  // Times of the programs and of the replay that belong together, straight between them.
  onReplay(value) {
    return between(this.times.clock, value, 0, 1) ?? value;
  }

  onPrograms(value) {
    return between(this.times.clock, value, 1, 0);
  }

  // A time from the start of the work of the operation that has a segment.
  inWork(value, name) {
    const { segments } = this.times;
    const n = Math.max(segments.findIndex((one) => one[2] === name), 0);
    const before = segments.slice(0, n + 1).filter((one) => one[2] === "entry" || one[2] === "setup").pop();
    return (before ? before[1] : 0) + value;
  }

  // The time that the address asks for, or null.
  asked() {
    const hash = new URLSearchParams(location.hash.slice(1));
    const [t, at, work] = ["t", "at", "work"].map((name) => (hash.has(name) && isFinite(hash.get(name)) ? +hash.get(name) : null));
    return t ?? (at !== null ? this.onReplay(at) : work !== null ? this.inWork(work, hash.get("in")) : null);
  }
}

function themes() {
  const root = document.documentElement;
  const button = byId("theme");
  const dark = () => (root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
  const tell = () => {
    button.textContent = dark() ? "Light" : "Dark";
    button.setAttribute("aria-label", dark() ? "Use light colours" : "Use dark colours");
    dispatchEvent(new Event("themechange"));
  };
  const asked = () => {
    const name = new URLSearchParams(location.hash.slice(1)).get("theme");
    if (name !== "light" && name !== "dark") return;
    root.dataset.theme = name;
    tell();
  };
  button.addEventListener("click", () => {
    root.dataset.theme = dark() ? "light" : "dark";
    tell();
  });
  addEventListener("hashchange", asked);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", tell);
  asked();
  tell();
}

function start() {
  const film = JSON.parse(byId("film").textContent);
  const times = JSON.parse(byId("track").textContent);
  const view = new Replay(byId("scene"), film);
  byId("none").hidden = view.works;
  const key = new Key(view, byId("key"));
  const bar = new Bar(view, times, film.targets, () => key.tell());
  const press = (id, on) => byId(id).setAttribute("aria-pressed", String(on));
  view.told = (text) => byId("measured").textContent !== text && (byId("measured").textContent = text);
  const follow = () => {
    view.following = !view.following;
    press("follow", view.following);
    view.go(view.now);
  };
  const measure = () => {
    view.measuring = !view.measuring;
    press("measure", view.measuring);
    document.body.classList.toggle("measuring", view.measuring);
    view.picked = [];
    view.told("");
    view.mark();
    view.draw();
  };
  const whole = () => {
    if (view.following) follow();
    view.lookAtAll();
  };
  const actions = { follow, measure, whole, home: () => view.home() };
  for (const [id, act] of Object.entries(actions)) byId(id).addEventListener("click", act);
  const choose = (number) => {
    const layer = number === "" ? null : film.layers[number];
    view.paintBy(layer);
    key.show(layer);
  };
  byId("colours")?.addEventListener("change", (event) => choose(event.target.value));
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const own = { f: follow, m: measure, w: whole, 0: () => view.home(), Escape: () => view.measuring && measure() }[event.key];
    if (event.target.tagName === "BUTTON" && (event.key === " " || event.key === "Enter")) return;
    if (event.defaultPrevented) return;
    if (own) own();
    else bar.key(event);
  });
  addEventListener("hashchange", () => {
    const value = bar.asked();
    if (value === null) return;
    bar.set(false);
    bar.go(value);
  });
  themes();
  const asked = bar.asked();
  bar.go(asked ?? 0);
  bar.set(asked === null && !matchMedia("(prefers-reduced-motion: reduce)").matches);
  if (view.works) dispatchEvent(new CustomEvent("replay", { detail: view }));
  globalThis.replay = { view, bar };
}

start();
