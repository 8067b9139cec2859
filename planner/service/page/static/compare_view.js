// Two plans over each other: the replay of the first, the arms of the second clear, at one time of both programs.
import * as THREE from "./vendor/three.module.min.js";
import { fileOf, text } from "./api.js";
import { $, h, show } from "./dom.js";
import { between, framesOf, keyAt, placeFrame, reader, Replay } from "./film.js";
import { shaded } from "./stage.js";
import { duration } from "./words.js";

const STAYS = ["part", "stock", "support", "obstacle"]; // of the second: they stand where those of the first do, or hide them
const CLEAR = 0.4;
const MOST_STEP_S = 0.25; // that one picture goes on by, where the page was out of sight

// What a replay holds as data, without running or showing anything of it.
export function filmOf(page) {
  const data = (id) => JSON.parse(page.match(new RegExp(`<script type='application/json' id='${id}'>(.*?)</script>`, "s"))?.[1] ?? "null");
  const [film, times] = [data("film"), data("track")];
  if (!film || !times) throw new Error("the replay is of another version; plan the job again");
  return { film, times };
}

// A moment of the time that both have, on the clock of one replay: that of the programs, or from its begin.
const onReplay = (times, t, programs) => (programs ? between(times.clock, t, 0, 1) : Math.min(t, times.end));

// The arms and tools of another film in the picture of a replay.
class Ghost {
  constructor(view, film) {
    Object.assign(this, { view, read: reader(film) });
    this.time = this.read(film.time);
    this.frames = framesOf(film, this.read);
    this.bodies = film.bodies.filter((one) => !STAYS.includes(one.kind)).map((one) => {
      const [vertices, faces] = film.meshes[one.mesh].map(this.read);
      const mesh = view.body({ ...one, vertices, faces: [...faces] });
      mesh.material.dispose();
      mesh.material = shaded(false, CLEAR);
      return Object.assign(mesh, { renderOrder: 3, seen: one.seen });
    });
    this.wire = film.wire && { ...film.wire, points: this.read(film.wire.points), line: view.line([], "--accent") };
    if (this.wire) this.wire.line.frustumCulled = false;
    addEventListener("themechange", () => this.recolour());
    this.recolour();
  }

  recolour() {
    const colour = new THREE.Color(...this.view.colour("--accent"));
    for (const mesh of this.bodies) mesh.material.uniforms.paint.value.copy(colour);
    this.view.draw();
  }

  go(t, visible) {
    const now = keyAt(this.time, t);
    for (const frame of this.frames.values()) placeFrame(frame, now);
    for (const mesh of this.bodies) {
      const frame = this.frames.get(mesh.userData.body);
      if (frame) mesh.matrix.copy(frame.matrix);
      mesh.matrixWorldNeedsUpdate = true;
      mesh.visible = visible && (!mesh.seen || mesh.seen.some(([from, to]) => now.key >= from && now.key < to));
    }
    if (this.wire) this.bend(now, visible);
  }

  bend({ key, next, share }, visible) {
    const { points, count, seen, line } = this.wire;
    const at = (k, i) => new THREE.Vector3().fromArray(points, 3 * (k * count + i));
    line.geometry.dispose();
    line.geometry = new THREE.BufferGeometry().setFromPoints(Array.from({ length: count }, (_, i) => at(key, i).lerp(at(next, i), share)));
    line.visible = visible && (!seen || seen.some(([from, to]) => key >= from && key < to));
  }
}

// What one of them does at a moment of its replay.
const doing = ({ times }, at) => (times.segments.find(([a, b]) => at >= a && at <= b) ?? times.segments.at(-1))?.[2] ?? "";

class Both {
  constructor(one, two) {
    Object.assign(this, { one, two, at: 0, going: false, last: 0, gone: false });
    this.programs = [one, two].every(({ times }) => times.clock?.length);
    const span = ({ times }) => (this.programs ? times.clock.at(-1)[0] : times.end);
    this.end = Math.max(span(one), span(two));
    this.view = new Replay($("canvas"), one.film);
    show($("view-empty"), !this.view.works);
    if (this.view.works) this.ghost = new Ghost(this.view, two.film);
    $("both-time").max = String(this.end);
    $("both-time").addEventListener("input", () => this.go($("both-time").valueAsNumber));
    $("both-play").addEventListener("click", () => this.play(!this.going));
    $("both-second").addEventListener("change", () => this.go(this.at));
    $("both-whole").addEventListener("click", () => this.view.works && this.view.lookAtAll());
    this.go(0);
  }

  go(t) {
    this.at = Math.min(Math.max(t, 0), this.end);
    const [first, second] = [this.one, this.two].map(({ times }) => onReplay(times, this.at, this.programs));
    this.ghost?.go(second, $("both-second").checked);
    this.view.go(first);
    $("both-time").value = String(this.at);
    const over = (own) => (this.programs && this.at > own.times.clock.at(-1)[0] ? "is done" : null);
    $("both-said").textContent = `${duration(this.at)} of ${duration(this.end)}. First: ${over(this.one) ?? doing(this.one, first)}. Second: ${over(this.two) ?? doing(this.two, second)}.`;
    $("both-time").setAttribute("aria-valuetext", $("both-said").textContent);
  }

  play(on) {
    if (on && this.at >= this.end) this.go(0);
    this.going = on;
    $("both-play").textContent = on ? "Pause" : "Play";
    this.last = performance.now();
    if (on) requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    if (!this.going || !$("canvas")?.isConnected) return;
    this.go(this.at + Math.min((now - this.last) / 1000, MOST_STEP_S) * Number($("both-speed").value));
    this.last = now;
    if (this.at >= this.end) return this.play(false);
    requestAnimationFrame((next) => this.step(next));
  }
}

// Loads the replays of two jobs, and draws them over each other in the section that it makes.
export async function openBoth(place, a, b) {
  const [one, two] = (await Promise.all([a, b].map((id) => text(fileOf(id, "replay.html"))))).map(filmOf);
  place.replaceChildren(
    h("div", { class: "canvas" }, h("canvas", { id: "canvas", tabIndex: 0, role: "img", "aria-label": "3D view of both plans; the arms of the second are clear. Arrow keys turn it, + and - zoom, 0 goes back to the work." }), h("div", { id: "labels", "aria-hidden": "true" }), h("p", { class: "view-empty", id: "view-empty", hidden: true }, "This browser draws no 3D (WebGL 2).")),
    h("div", { class: "cell-tools" },
      h("p", { class: "cell-line" }, h("button", { type: "button", class: "small", id: "both-play" }, "Play"), h("label", { htmlFor: "both-time" }, "Time"), h("input", { type: "range", id: "both-time", min: "0", step: "any", value: "0" })),
      h("p", { class: "told", id: "both-said" }),
      h("p", { class: "cell-line" }, h("label", { htmlFor: "both-speed" }, "Speed"), h("select", { id: "both-speed" }, [1, 5, 20].map((times) => h("option", { value: String(times), selected: times === 5 }, `${times} ×`))), h("label", { class: "check" }, h("input", { type: "checkbox", id: "both-second", checked: true }), " The second, clear"), h("button", { type: "button", class: "small", id: "both-whole" }, "Whole cell"))),
  );
  const both = new Both(one, two);
  $("both-time").focus({ preventScroll: true });
  return both;
}
