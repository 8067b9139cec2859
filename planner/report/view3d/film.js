// A plan on one clock, drawn by three.js: bodies that move, cuts that grow, colours along them, and a measure.
import * as THREE from "./vendor/three.module.min.js";
import { Stage, shaded } from "./stage.js";

export const byId = (id) => document.getElementById(id);
const readAs = { f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
const WHITE = new THREE.Color(1, 1, 1);
const RING = 6; // sides of a bent wire
const MOST_NEAR = 3.9; // of points whose size is in the scene: one over the tangent of half the lens' angle
const MIN_POINT = 0.5;

// The index of the last of ascending values that is not after one.
export function lastAt(values, at) {
  let [low, high] = [0, values.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (values[middle] <= at) low = middle;
    else high = middle - 1;
  }
  return low;
}

// What reads the arrays of a film by where they lie.
export function reader(film) {
  const bytes = Uint8Array.from(atob(film.arrays), (c) => c.charCodeAt(0));
  return ([kind, start, count]) => new readAs[kind](bytes.buffer, start, count);
}

// The frames of a film by their names, with their poses at its keyframes.
export const framesOf = (film, read) => new Map(film.frames.map((one) => [one.name, { poses: read(one.poses), matrix: new THREE.Matrix4() }]));

// The last keyframe that is not after a moment, the next one, and the share of the way to it.
export function keyAt(time, t) {
  const key = lastAt(time, t + 1e-6);
  const next = Math.min(key + 1, time.length - 1);
  const step = time[next] - time[key];
  return { key, next, share: step > 1e-9 ? Math.min(Math.max((t - time[key]) / step, 0), 1) : 0 };
}

// Puts a frame where it is between two keyframes.
export function placeFrame({ poses, matrix }, { key, next, share }) {
  const [a, b] = poses.length > 7 ? [7 * key, 7 * next] : [0, 0];
  const where = new THREE.Vector3().fromArray(poses, a).lerp(new THREE.Vector3().fromArray(poses, b), share);
  const turn = new THREE.Quaternion().fromArray(poses, a + 3).slerp(new THREE.Quaternion().fromArray(poses, b + 3), share);
  matrix.compose(where, turn, new THREE.Vector3(1, 1, 1));
}

// A time of one of two clocks on the other one, by pairs of times that belong together, straight between them.
export function between(all, value, from, to) {
  const k = all.findIndex((pair) => pair[from] >= value);
  if (!all.length) return null;
  if (k < 1) return all[k ? all.length - 1 : 0][to];
  const [a, b] = [all[k - 1], all[k]];
  return a[to] + ((b[to] - a[to]) * (value - a[from])) / Math.max(b[from] - a[from], 1e-9);
}

export class Replay extends Stage {
  constructor(canvas, film) {
    super(canvas, 1);
    Object.assign(this, { film, now: 0, key: 0, share: 0, layer: null, following: false, measuring: false, picked: [], hidden: new Set(), attached: [] });
    this.read = reader(film);
    this.time = this.read(film.time);
    this.fine = this.read(film.fine); // times of the rows of cuts, which their keys count by
    this.setup = this.read(film.setup);
    this.turn = film.view.turn;
    this.lift = film.view.lift;
    this.frames = framesOf(film, this.read);
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

  cut(one, read = this.read) {
    const [vertices, faces, keys, upto] = [one.vertices, one.faces, one.keys, one.upto].map(read);
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
    const now = keyAt(this.time, t);
    [this.key, this.share] = [now.key, now.share];
    this.at = lastAt(this.fine, t + 1e-4);
    for (const frame of this.frames.values()) placeFrame(frame, now);
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
    if (!found) return this.told?.("No surface here.");
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
    if (places.length < 2) return places.length ? "Select the second point" : "Select two points";
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
