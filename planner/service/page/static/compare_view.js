// Two plans over each other: the replay of the first, and clear what of the second is not as in it, at one time of both.
import * as THREE from "./vendor/three.module.min.js";
import { fileOf, text } from "./api.js";
import { $, h, show } from "./dom.js";
import { between, framesOf, keyAt, lastAt, placeFrame, reader, Replay } from "./film.js";
import { shaded } from "./stage.js";
import { duration } from "./words.js";

const CLEAR = 0.4;
const CLEARER = 0.22; // of what has something inside
const ALIKE_MM = 0.01; // shapes are one whose corners are no farther apart
const SAME_MM = 0.05; // and stand at one place, likewise
const CUT_POINTS = 60;
const MOST_STEP_S = 0.25; // that one picture goes on by, where the page was out of sight
const WORDS = { link: "arms", tool: "tools", edge: "tools", wire: "wire", stock: "block", part: "part", support: "support", obstacle: "obstacles", cut: "cuts" };

// What a replay holds as data, without running or showing anything of it.
export function filmOf(page) {
  const data = (id) => JSON.parse(page.match(new RegExp(`<script type='application/json' id='${id}'>(.*?)</script>`, "s"))?.[1] ?? "null");
  const [film, times] = [data("film"), data("track")];
  if (!film?.fine || !times?.segments) throw new Error("the replay was written by another version. Plan the job again.");
  return { film, times };
}

// A moment of the time that both have, on the clock of one replay: that of the programs, or from its begin.
const onReplay = (times, t, programs) => (programs ? between(times.clock, t, 0, 1) : Math.min(t, times.end));

const within = (a, b, most) => a.length === b.length && a.every((value, i) => Math.abs(value - b[i]) <= most);
const alike = (a, b) => within(a.attributes.position.array, b.attributes.position.array, ALIKE_MM) && within(a.index.array, b.index.array, 0);
const asMany = (a, b) => a.attributes.position.count === b.attributes.position.count && a.index.count === b.index.count;

// Points of a body in its own frame, by which it is told whether it stands where another one does: the corners of what
// it fills, or some of a cut, which is where it is whatever block it is in.
function pointsOf({ geometry, userData }) {
  const { position } = geometry.attributes;
  const some = Math.min(position.count, CUT_POINTS);
  if (userData.kind === "cut") return Array.from({ length: some }, (_, i) => new THREE.Vector3().fromBufferAttribute(position, Math.floor((i * position.count) / some)));
  geometry.computeBoundingBox();
  const { min, max } = geometry.boundingBox;
  return Array.from({ length: 8 }, (_, i) => new THREE.Vector3(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z));
}

const joined = ([a, b], [c, d]) => [a.map((v, i) => Math.min(v, c[i])), b.map((v, i) => Math.max(v, d[i]))];

// Another film in the picture of a replay: its bodies, cuts and wire, those alone that are not as the replay's.
class Ghost {
  constructor(view, film) {
    Object.assign(this, { view, read: reader(film), told: { shown: [], same: [] } });
    this.time = this.read(film.time);
    this.fine = this.read(film.fine);
    this.frames = framesOf(film, this.read);
    this.bodies = film.bodies.map((one) => {
      const [vertices, faces] = film.meshes[one.mesh].map(this.read);
      return this.clear(view.body({ ...one, vertices, faces: [...faces] }), one.seen, one.kind === "part");
    });
    this.cuts = film.cuts.map((one) => {
      const made = view.cut(one, this.read);
      this.bodies.push(this.clear(made.mesh, one.seen, true));
      return made;
    });
    this.wire = film.wire && { ...film.wire, points: this.read(film.wire.points), line: view.line([], "--view-second") };
    if (this.wire) this.wire.line.frustumCulled = false;
    addEventListener("themechange", () => this.recolour(), { signal: view.over.signal });
    this.recolour();
  }

  clear(mesh, seen, twoSided) {
    const { kind } = mesh.userData;
    mesh.material.dispose();
    mesh.material = shaded(twoSided, kind === "stock" ? CLEARER : CLEAR);
    const isOne = kind === "cut" ? asMany : alike;
    const twins = this.view.bodies.filter((one) => one.userData.kind === kind && isOne(one.geometry, mesh.geometry)).map((one) => ({ one, points: pointsOf(one) }));
    return Object.assign(mesh, { renderOrder: kind === "stock" ? 4 : 3, seen, twins, points: pointsOf(mesh) });
  }

  recolour() {
    const colour = new THREE.Color(...this.view.colour("--view-second"));
    for (const mesh of this.bodies) mesh.material.uniforms.paint.value.copy(colour);
    this.wire?.line.material.color.copy(colour);
    this.view.draw();
  }

  // The corners of all of it, and of what stands about where that is not as in the replay.
  extent() {
    const box = new THREE.Box3();
    for (const { points, matrix, userData, visible } of this.bodies) if (userData.kind !== "obstacle" || visible) for (const one of points) box.expandByPoint(one.clone().applyMatrix4(matrix));
    return [box.min.toArray(), box.max.toArray()];
  }

  // Whether the replay has the same body at the same place now.
  isThere(mesh) {
    const near = ({ one, points }) => mesh.points.every((point, i) => point.clone().applyMatrix4(mesh.matrix).distanceTo(points[i].clone().applyMatrix4(one.matrix)) < SAME_MM);
    return mesh.twins.some((twin) => twin.one.visible && near(twin));
  }

  // Its moment t of its own clock, behind the replay's; what is shown of it, and what is as there, by kinds.
  go(t, visible) {
    const now = keyAt(this.time, t);
    const at = lastAt(this.fine, t + 1e-4);
    const isSeen = (seen) => !seen || seen.some(([from, to]) => now.key >= from && now.key < to);
    const [shown, there] = [new Set(), new Set()];
    for (const frame of this.frames.values()) placeFrame(frame, now);
    for (const { mesh, keys, upto } of this.cuts) mesh.geometry.setDrawRange(0, keys[0] > at ? 0 : upto[lastAt(keys, at)]);
    for (const mesh of this.bodies) {
      const { body, kind } = mesh.userData;
      const frame = this.frames.get(body);
      if (frame) mesh.matrix.copy(frame.matrix);
      mesh.matrixWorldNeedsUpdate = true;
      const here = isSeen(mesh.seen) && mesh.geometry.drawRange.count > 0;
      const same = here && this.isThere(mesh);
      mesh.visible = visible && here && !same;
      if (here) (same ? there : shown).add(WORDS[kind]);
    }
    if (this.wire) {
      const points = this.wirePoints(now);
      const here = isSeen(this.wire.seen);
      const same = here && this.isWireThere(points);
      this.bend(points, visible && here && !same);
      if (here) (same ? there : shown).add(WORDS.wire);
    }
    const inOrder = (some) => [...new Set(Object.values(WORDS))].filter((word) => some.has(word));
    this.told = { shown: inOrder(shown), same: inOrder(there).filter((word) => !shown.has(word)) };
  }

  wirePoints({ key, next, share }, { points, count } = this.wire) {
    const at = (k, i) => new THREE.Vector3().fromArray(points, 3 * (k * count + i));
    return Array.from({ length: count }, (_, i) => at(key, i).lerp(at(next, i), share));
  }

  isWireThere(points) {
    const { wire, time, now } = this.view;
    if (!wire?.mesh.visible || wire.count !== points.length) return false;
    return this.wirePoints(keyAt(time, now), wire).every((one, i) => one.distanceTo(points[i]) < SAME_MM);
  }

  bend(points, visible) {
    const { line } = this.wire;
    line.geometry.dispose();
    line.geometry = new THREE.BufferGeometry().setFromPoints(points);
    line.visible = visible;
  }
}

// What one of them does at a moment of its replay.
const doing = ({ times }, at) => (times.segments.find(([a, b]) => at >= a && at <= b) ?? times.segments.at(-1))?.[2] ?? "";

class Both {
  constructor(one, two) {
    Object.assign(this, { one, two, at: 0, going: false, last: 0 });
    this.programs = [one, two].every(({ times }) => times.clock?.length);
    const span = ({ times }) => (this.programs ? times.clock.at(-1)[0] : times.end);
    this.end = Math.max(span(one), span(two));
    this.view = new Replay($("canvas"), one.film);
    show($("view-empty"), !this.view.works);
    show($("both-legend"), this.view.works);
    if (this.view.works) this.ghost = new Ghost(this.view, two.film);
    $("both-time").max = String(this.end);
    $("both-time").addEventListener("input", () => this.go($("both-time").valueAsNumber));
    $("both-play").addEventListener("click", () => this.play(!this.going));
    $("both-second").addEventListener("change", () => this.go(this.at));
    $("both-whole").addEventListener("click", () => this.view.works && this.view.lookAtAll());
    this.go(0);
    if (this.ghost) this.widen();
  }

  // The picture has the work of both, and all of both.
  widen() {
    const { view } = this;
    view.whole = joined(view.whole, this.two.film.view.work);
    view.all = joined(joined(view.all, view.whole), this.ghost.extent());
    view.depth = 3 * Math.hypot(...view.all[1].map((v, i) => v - view.all[0][i]));
    view.draw();
  }

  // Goes on as another one was left: its moment, speed and choices, and from where it was seen, if that was the same first plan.
  goOnAs(former) {
    $("both-speed").value = former.speed;
    $("both-second").checked = former.second;
    if (former.one === this.one) Object.assign(this.view, former.camera);
    this.go(former.at);
  }

  // What another one goes on with.
  get left() {
    const { turn, lift, zoom, shift } = this.view;
    return { one: this.one, at: this.at, speed: $("both-speed").value, second: $("both-second").checked, camera: { turn, lift, zoom, shift } };
  }

  close() {
    this.going = false;
    this.view.end();
  }

  go(t) {
    this.at = Math.min(Math.max(t, 0), this.end);
    const [first, second] = [this.one, this.two].map(({ times }) => onReplay(times, this.at, this.programs));
    this.view.go(first);
    this.ghost?.go(second, $("both-second").checked);
    $("both-time").value = String(this.at);
    const over = (own) => (this.programs && this.at > own.times.clock.at(-1)[0] ? "is done" : null);
    $("both-said").textContent = `${duration(this.at)} of ${duration(this.end)}. First: ${over(this.one) ?? doing(this.one, first)}. Second: ${over(this.two) ?? doing(this.two, second)}.`;
    $("both-time").setAttribute("aria-valuetext", $("both-said").textContent);
    this.tellLegend();
  }

  tellLegend() {
    const { shown, same } = this.ghost?.told ?? { shown: [], same: [] };
    const clear = !$("both-second").checked ? "not shown" : shown.length ? shown.join(", ") : "no differences now";
    const there = same.length ? `; ${same.join(", ")} as in the first` : "";
    if ($("both-clear").textContent !== clear) $("both-clear").textContent = clear;
    if ($("both-there").textContent !== there) $("both-there").textContent = there;
  }

  play(on) {
    if (on && this.at >= this.end) this.go(0);
    this.going = on;
    $("both-play").textContent = on ? "Pause" : "Play";
    this.last = performance.now();
    if (on) requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    if (!this.going) return;
    this.go(this.at + Math.min((now - this.last) / 1000, MOST_STEP_S) * Number($("both-speed").value));
    this.last = now;
    if (this.at >= this.end) return this.play(false);
    requestAnimationFrame((next) => this.step(next));
  }
}

let films = new Map(); // of the jobs that were drawn last

// Loads the replays of two jobs, and draws them over each other in the section that it makes, as `former` was left
// where there was one; nothing if the place is gone meanwhile.
export async function openBoth(place, a, b, former = null) {
  const found = await Promise.all([a, b].map(async (id) => [id, films.get(id) ?? filmOf(await text(fileOf(id, "replay.html")))]));
  if (!place.isConnected) return null;
  films = new Map(found);
  place.replaceChildren(
    h("div", { class: "canvas" }, h("canvas", { id: "canvas", tabIndex: 0, role: "img", "aria-label": "3D view of both plans; differences of the second are transparent. Arrow keys rotate, + and - zoom, 0 resets." }), h("div", { id: "labels", "aria-hidden": "true" }), h("p", { class: "view-empty", id: "view-empty", hidden: true }, "This browser cannot show 3D views: it lacks WebGL 2.")),
    h("p", { class: "view-foot", id: "both-legend" }, h("span", {}, h("i", { class: "swatch first" }), "First: complete, in its own colours"), h("span", {}, h("i", { class: "swatch second" }), "Second, clear: ", h("span", { id: "both-clear" }), h("span", { class: "soft", id: "both-there" }))),
    h("div", { class: "cell-tools" },
      h("p", { class: "cell-line" }, h("button", { type: "button", class: "small", id: "both-play" }, "Play"), h("label", { htmlFor: "both-time" }, "Time"), h("input", { type: "range", id: "both-time", min: "0", step: "any", value: "0" })),
      h("p", { class: "told", id: "both-said" }),
      h("p", { class: "cell-line" }, h("label", { htmlFor: "both-speed" }, "Speed"), h("select", { id: "both-speed" }, [1, 5, 20].map((times) => h("option", { value: String(times), selected: times === 5 }, `${times} ×`))), h("label", { class: "check" }, h("input", { type: "checkbox", id: "both-second", checked: true }), " The second, clear"), h("button", { type: "button", class: "small", id: "both-whole" }, "Whole cell"))),
  );
  const both = new Both(...found.map(([, one]) => one));
  if (former) both.goOnAs(former);
  else $("both-time").focus({ preventScroll: true });
  return both;
}
