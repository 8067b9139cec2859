// The replay: a plan on one clock, drawn by three.js, with its bar, its colours along the cut, and a measure.
import * as THREE from "./vendor/three.module.min.js";
import { Stage, shaded } from "./stage.js";

const byId = (id) => document.getElementById(id);
const readAs = { f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
const clockOf = (s) => `${Math.floor(s / 60)}:${(s % 60).toFixed(1).padStart(4, "0")}`;
const WHITE = new THREE.Color(1, 1, 1);
const RING = 6; // sides of a bent wire
const MOST_NEAR = 3.9; // of points whose size is in the scene: one over the tangent of half the lens' angle
const MIN_POINT = 0.5;

// The index of the last of ascending values that is not after one.
function lastAt(values, at) {
  let [low, high] = [0, values.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (values[middle] <= at) low = middle;
    else high = middle - 1;
  }
  return low;
}

class Replay extends Stage {
  constructor(canvas, film) {
    super(canvas, 1);
    Object.assign(this, { film, now: 0, key: 0, share: 0, layer: null, following: false, measuring: false, picked: [], hidden: new Set(), attached: [] });
    const bytes = Uint8Array.from(atob(film.arrays), (c) => c.charCodeAt(0));
    this.read = ([kind, start, count]) => new readAs[kind](bytes.buffer, start, count);
    this.time = this.read(film.time);
    this.fine = this.read(film.fine); // times of the rows of cuts, which their keys count by
    this.setup = this.read(film.setup);
    this.turn = film.view.turn;
    this.lift = film.view.lift;
    this.frames = new Map(film.frames.map((one) => [one.name, { poses: this.read(one.poses), matrix: new THREE.Matrix4() }]));
    this.whole = this.all = film.view.work;
    if (!this.works) return;
    this.bodies = film.bodies.map((one) => {
      const [vertices, faces] = film.meshes[one.mesh].map(this.read);
      return Object.assign(this.body({ ...one, vertices, faces: [...faces] }), { seen: one.seen });
    });
    this.cuts = film.cuts.map((one) => this.cut(one));
    this.bodies.push(...this.cuts.map((one) => one.mesh));
    if (film.wire) this.wire = this.tube(film.wire);
    this.dotted = [this.dots([], 11, "--accent", 6), this.dots([], 3, "--card", 7)];
    this.rule = this.line([], "--accent");
    Object.assign(this.rule, { renderOrder: 6, frustumCulled: false, visible: false });
    this.rule.material.depthTest = false;
    this.go(0);
    this.all = this.everything();
    this.depth = 3 * Math.hypot(...this.all[1].map((v, i) => v - this.all[0][i]));
    this.least = 0.02;
    this.floor(this.all);
    this.listenForPoints();
  }

  everything() {
    const [low, high] = this.extent();
    return [low.map((v, i) => Math.min(v, this.whole[0][i])), high.map((v, i) => Math.max(v, this.whole[1][i]))];
  }

  cut(one) {
    const [vertices, faces, keys, upto] = [one.vertices, one.faces, one.keys, one.upto].map(this.read);
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
    shape.setIndex(new THREE.BufferAttribute(faces, 1));
    shape.computeVertexNormals();
    shape.setAttribute("color", new THREE.BufferAttribute(new Float32Array(vertices.length).fill(1), 3));
    const mesh = new THREE.Mesh(shape, shaded(true, 1, true));
    Object.assign(mesh, { matrixAutoUpdate: false, frustumCulled: false, seen: one.seen, userData: { body: "block", kind: "cut" } });
    if (!one.arm) Object.assign(mesh.material, { polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -4 }); // before the part that it lies on
    this.cell.add(mesh);
    return { mesh, arm: one.arm, per: one.per, keys, upto };
  }

  tube({ points, count, radius, seen }) {
    const faces = [];
    for (let i = 0; i + 1 < count; i++)
      for (let j = 0; j < RING; j++) {
        const [a, b] = [i * RING + j, i * RING + ((j + 1) % RING)];
        faces.push(a, b, b + RING, a, b + RING, a + RING);
      }
    const mesh = this.body({ body: "wire", kind: "edge", color: null, vertices: new Float32Array(3 * RING * count), faces });
    Object.assign(mesh, { frustumCulled: false, seen });
    this.bodies.push(mesh);
    return { mesh, count, radius, points: this.read(points) };
  }

  // The wire between two keyframes: a ring about each of its points.
  bend() {
    const { mesh, count, radius, points } = this.wire;
    const { key, share } = this;
    const next = Math.min(key + 1, this.time.length - 1);
    const at = (i) => new THREE.Vector3().fromArray(points, 3 * (key * count + i)).lerp(new THREE.Vector3().fromArray(points, 3 * (next * count + i)), share);
    const all = Array.from({ length: count }, (_, i) => at(i));
    const place = mesh.geometry.attributes.position;
    const [way, side, up] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
    for (let i = 0; i < count; i++) {
      way.subVectors(all[Math.min(i + 1, count - 1)], all[Math.max(i - 1, 0)]).normalize();
      side.set(0, 0, 1).cross(way);
      if (side.lengthSq() < 1e-3) side.set(1, 0, 0).cross(way);
      up.crossVectors(way, side.normalize());
      for (let j = 0; j < RING; j++) {
        const turn = (2 * Math.PI * j) / RING;
        const [c, s] = [radius * Math.cos(turn), radius * Math.sin(turn)];
        place.setXYZ(i * RING + j, all[i].x + c * side.x + s * up.x, all[i].y + c * side.y + s * up.y, all[i].z + c * side.z + s * up.z);
      }
    }
    place.needsUpdate = true;
    mesh.geometry.computeVertexNormals();
  }

  isSeen(seen) {
    return !seen || seen.some(([from, to]) => this.key >= from && this.key < to);
  }

  // Draws the moment t [s] of the replay's own clock.
  go(t) {
    this.now = t;
    if (!this.works) return;
    this.key = lastAt(this.time, t + 1e-6);
    this.at = lastAt(this.fine, t + 1e-4);
    const next = Math.min(this.key + 1, this.time.length - 1);
    const step = this.time[next] - this.time[this.key];
    this.share = step > 1e-9 ? Math.min(Math.max((t - this.time[this.key]) / step, 0), 1) : 0;
    for (const frame of this.frames.values()) this.place(frame, next);
    for (const mesh of this.bodies) {
      const { body, kind } = mesh.userData;
      const frame = this.frames.get(body);
      if (frame) mesh.matrix.copy(frame.matrix);
      mesh.matrixWorldNeedsUpdate = true;
      const aside = this.hidden.has(kind) || this.covered(kind);
      mesh.visible = !aside && this.isSeen(mesh.seen);
    }
    for (const { mesh, keys, upto } of this.cuts) {
      const done = keys[0] > this.at ? 0 : upto[lastAt(keys, this.at)];
      mesh.geometry.setDrawRange(0, this.layer ? upto.at(-1) : done);
      if (!this.layer && !done) mesh.visible = false;
    }
    for (const { frame, object } of this.attached) object.matrix.copy(this.frames.get(frame).matrix);
    if (this.wire?.mesh.visible) this.bend();
    if (this.following) this.follow();
    this.mark();
    this.draw();
  }

  // What would stand before the colours.
  covered(kind) {
    if (!this.layer) return false;
    if (kind === "cut") return Boolean(this.layer.points);
    return kind === "stock" || (kind === "part" && (Boolean(this.layer.points) || this.cuts.some((one) => !one.arm)));
  }

  place(frame, next) {
    const { poses, matrix } = frame;
    const moves = poses.length > 7;
    const [a, b] = moves ? [7 * this.key, 7 * next] : [0, 0];
    const where = new THREE.Vector3().fromArray(poses, a).lerp(new THREE.Vector3().fromArray(poses, b), this.share);
    const turn = new THREE.Quaternion().fromArray(poses, a + 3).slerp(new THREE.Quaternion().fromArray(poses, b + 3), this.share);
    matrix.compose(where, turn, new THREE.Vector3(1, 1, 1));
  }

  // Something that goes along with a frame.
  attach(frame, object) {
    object.matrixAutoUpdate = false;
    this.stage.add(object);
    this.attached.push({ frame, object });
    this.go(this.now);
  }

  hide(kind, off) {
    if (off) this.hidden.add(kind);
    else this.hidden.delete(kind);
    this.go(this.now);
  }

  // Where the tools of the operation are, or the middle between two.
  tip() {
    const { view } = this.film;
    const [, operation] = view.operation.findLast(([key]) => key <= this.key) ?? [0, 0];
    const names = (view.arms[operation] ?? []).filter((name) => this.frames.has(`${name}/tool`));
    const all = names.map((name) => new THREE.Vector3(...view.tips[name][this.setup[this.key]]).applyMatrix4(this.frames.get(`${name}/tool`).matrix));
    if (!all.length) return null;
    return all.reduce((sum, one) => sum.add(one), new THREE.Vector3()).multiplyScalar(1 / all.length);
  }

  follow() {
    const tip = this.tip();
    if (tip) this.shift = tip.toArray().map((v, i) => v - (this.whole[0][i] + this.whole[1][i]) / 2);
  }

  home() {
    Object.assign(this, { turn: this.film.view.turn, lift: this.film.view.lift, zoom: 1, shift: [0, 0, 0] });
    if (this.following) this.follow();
    this.draw();
  }

  lookAtAll() {
    const size = ([low, high]) => Math.hypot(...high.map((v, i) => v - low[i]));
    this.zoom = (1.25 * size(this.whole)) / size(this.all);
    this.shift = this.all[0].map((v, i) => (v + this.all[1][i] - this.whole[0][i] - this.whole[1][i]) / 2);
    this.draw();
  }

  // Colours along the cut, by one of the figures of the proof, or none.
  paintBy(layer) {
    this.layer = layer;
    if (!this.works) return;
    for (const { mesh, arm, per, keys } of this.cuts) {
      const colour = mesh.geometry.attributes.color;
      const found = layer && (layer.colours[arm] ?? layer.colours[""] ?? Object.values(layer.colours)[0]);
      if (!found) colour.array.fill(1);
      else {
        const shades = this.read(found);
        for (let row = 0; row < keys.length; row++)
          for (let i = 0; i < per; i++) for (let c = 0; c < 3; c++) colour.array[3 * (row * per + i) + c] = shades[3 * keys[row] + c] / 255;
      }
      colour.needsUpdate = true;
    }
    if (this.cloud) this.cloud.visible = false;
    if (layer?.points) {
      this.clouds ??= new Map();
      if (!this.clouds.has(layer)) this.clouds.set(layer, this.cloudOf(layer));
      this.cloud = this.clouds.get(layer);
      this.cloud.visible = true;
    }
    this.recolour();
    this.go(this.now);
  }

  cloudOf({ points, point_colours: colours, spacing }) {
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(this.read(points), 3));
    shape.setAttribute("color", new THREE.BufferAttribute(this.read(colours), 3, true));
    const made = new THREE.Points(shape, new THREE.PointsMaterial({ size: Math.max(2.2 * spacing, MIN_POINT) * MOST_NEAR, vertexColors: true, map: this.round, alphaTest: 0.5 }));
    made.frustumCulled = false;
    this.attach("block", made);
    return made;
  }

  recolour() {
    super.recolour();
    if (!this.cuts) return;
    const cut = new THREE.Color(...this.colour("--view-cut"));
    for (const { mesh } of this.cuts) {
      mesh.material.uniforms.paint.value.copy(this.layer ? WHITE : cut);
      mesh.material.uniforms.even.value = this.layer ? 0.75 : 0;
    }
    this.draw();
  }

  // What is seen through is passed over where there is something behind it.
  hit(at) {
    const all = this.ray(at).intersectObjects(this.bodies.filter((one) => one.visible || (this.layer && one.userData.kind === "part")), false);
    return all.find((one) => one.object.userData.kind !== "stock") ?? all[0] ?? null;
  }

  listenForPoints() {
    const { canvas } = this;
    let pressed = null;
    canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => {
      const still = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4;
      pressed = null;
      if (still && this.measuring) this.pick(this.spot(event));
    });
    canvas.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || !this.measuring) return;
      event.preventDefault();
      this.pick(new THREE.Vector2(0, 0));
    });
  }

  pick(at) {
    const found = this.hit(at);
    if (!found) return this.told?.("Nothing is there.");
    if (this.picked.length > 1) this.picked = [];
    const frame = this.frames.get(found.object.userData.body);
    const own = frame ? found.point.clone().applyMatrix4(frame.matrix.clone().invert()) : found.point.clone();
    this.picked.push({ frame, own });
    this.mark();
    this.draw();
  }

  // The points that were picked go along with what they are on.
  mark() {
    if (!this.rule) return;
    const places = this.picked.map(({ frame, own }) => (frame ? own.clone().applyMatrix4(frame.matrix) : own.clone()));
    for (const one of this.dotted) {
      one.geometry.dispose();
      one.geometry = new THREE.BufferGeometry().setFromPoints(places);
      one.visible = places.length > 0;
    }
    this.rule.visible = places.length === 2;
    this.rule.geometry.dispose();
    this.rule.geometry = new THREE.BufferGeometry().setFromPoints(places);
    this.ends = places;
    if (this.measuring) this.told?.(this.words(places));
  }

  words(places) {
    if (places.length < 2) return places.length ? "Now the second point" : "Choose two points";
    const way = places[1].clone().sub(places[0]);
    return `${way.length().toFixed(1)} mm (x ${way.x.toFixed(1)}, y ${way.y.toFixed(1)}, z ${way.z.toFixed(1)})`;
  }

  after() {
    const label = byId("labels").firstElementChild ?? byId("labels").appendChild(Object.assign(document.createElement("span"), { className: "measure" }));
    label.hidden = !(this.ends?.length === 2);
    if (label.hidden) return;
    label.textContent = `${this.ends[0].distanceTo(this.ends[1]).toFixed(1)} mm`;
    this.pin(label, this.ends[0].clone().lerp(this.ends[1], 0.5));
  }
}

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
  between(value, from, to) {
    const all = this.times.clock;
    const k = all.findIndex((pair) => pair[from] >= value);
    if (!all.length) return null;
    if (k < 1) return all[k ? all.length - 1 : 0][to];
    const [a, b] = [all[k - 1], all[k]];
    return a[to] + ((b[to] - a[to]) * (value - a[from])) / Math.max(b[from] - a[from], 1e-9);
  }

  onReplay(value) {
    return this.between(value, 0, 1) ?? value;
  }

  onPrograms(value) {
    return this.between(value, 1, 0);
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
