// The cell in 3D: bodies where the service says they are, targets, and what can be moved by hand.
import * as THREE from "./vendor/three.module.min.js";
import { h } from "./dom.js";
import { Stage, snapped } from "./stage.js";

const SNAP = { mm: 5, deg: 15 };
const NEAR = 14; // pixels from the pointer at which a target is meant
const DEG = Math.PI / 180;
const SCENE_SIZE = 3.9; // makes a dot's size one in the scene: one over the tangent of half the lens' angle

// The matrix of a pose {xyz_mm, rpy_deg}; roll, pitch, yaw are about x, y, z of the frame outside, in this order.
export function matrixOf({ xyz_mm, rpy_deg }) {
  const turn = new THREE.Euler(...rpy_deg.map((v) => v * DEG), "ZYX");
  return new THREE.Matrix4().makeRotationFromEuler(turn).setPosition(...xyz_mm);
}

const fromRows = (rows) => new THREE.Matrix4().set(...rows, 0, 0, 0, 1);

export class CellView extends Stage {
  // meant(target number or null): the pointer is at it; moved(move, pose): the hand is at a body; dropped(): it lets go.
  constructor(canvas, labels, { meant, picked, moved, dropped }) {
    super(canvas, 1.25);
    Object.assign(this, { labels, meant, picked, moved, dropped, moves: [], chosen: null, posture: 0 });
    if (!this.works) return;
    this.hold();
  }

  // Draws what the service tells of a cell; keep: leave the camera as it is.
  show(data, keep) {
    if (!this.works) return;
    const posture = keep ? this.posture : 0;
    this.clear(this.cell);
    this.moves = data.moves;
    this.poses = Object.fromEntries(Object.entries(data.poses).map(([body, rows]) => [body, rows.map(fromRows)]));
    this.shifts = new Map();
    this.bodies = data.bodies.filter((one) => data.placed || !["stock", "support", "part"].includes(one.kind)).map((one) => this.body(one));
    this.wire = this.line([], "--view-hot");
    this.wires = data.wires_mm ?? null;
    this.arms = data.arms.map((arm) => arm.name);
    this.labels.replaceChildren(...this.arms.map((name) => h("span", { class: "measure arm-name" }, name)));
    this.targets(data);
    this.recolour();
    this.stand(Math.min(posture, (data.joints_deg?.[this.arms[0]]?.length ?? 1) - 1));
    this.whole = this.extent();
    this.floor(this.whole);
    this.near = this.canvas.clientWidth > 1.2 * this.canvas.clientHeight ? 1.25 : 1.15;
    if (keep) this.draw();
    else this.home();
  }

  // Points of the targets, those without a posture in another colour, and a line through them, for each arm.
  targets(data) {
    this.clear(this.marks);
    this.points = [];
    const all = data.targets ?? [];
    const working = data.arms.filter((arm) => arm.works).map((arm) => arm.name);
    for (const arm of all.length ? working : []) {
      const places = all.map((one) => new THREE.Vector3(...one.points_mm[arm]));
      this.points.push(...places.map((place, number) => ({ arm, place, number, bad: !good(all, number) })));
      const way = new THREE.Line(new THREE.BufferGeometry().setFromPoints(places), new THREE.LineBasicMaterial({ transparent: true, opacity: 0.5 }));
      way.userData = { style: "--accent" };
      this.marks.add(way);
      for (const bad of [false, true]) {
        const some = places.filter((_, number) => good(all, number) === !bad);
        if (!some.length) continue;
        const dots = new THREE.Points(new THREE.BufferGeometry().setFromPoints(some), new THREE.PointsMaterial({ size: bad ? 11 : 7, sizeAttenuation: false, map: this.round, alphaTest: 0.5, depthTest: !bad }));
        dots.userData = { style: bad ? "--view-bad" : "--accent" };
        dots.renderOrder = bad ? 4 : 1;
        this.marks.add(dots);
      }
    }
    this.here = this.dots([], 13, "--view-hot");
    this.point(null);
  }

  // Marks a target by its number among those that were looked at.
  point(number) {
    const some = this.points.filter((one) => one.number === number).map((one) => one.place);
    this.here.geometry.dispose();
    this.here.geometry = new THREE.BufferGeometry().setFromPoints(some);
    this.here.visible = some.length > 0;
    this.draw();
  }

  // Dots in place of block and part in the colours of what the arms can do there; styles: of each place the name of a colour.
  field(places, styles, size) {
    this.grid ??= this.stage.add(new THREE.Group()).children.at(-1);
    this.clear(this.grid);
    for (const style of new Set(styles)) {
      const some = places.filter((_, i) => styles[i] === style).map((place) => new THREE.Vector3(...place));
      const dots = new THREE.Points(new THREE.BufferGeometry().setFromPoints(some), new THREE.PointsMaterial({ size: size * SCENE_SIZE, map: this.round, alphaTest: 0.5 }));
      dots.userData = { style };
      dots.renderOrder = 1;
      this.grid.add(dots);
    }
    // what is not drawn can be taken hold of all the same
    for (const mesh of this.bodies) mesh.material.visible = !places.length || !["stock", "part"].includes(mesh.userData.kind);
    this.recolour();
  }

  // All bodies as in one of the postures that the service knows.
  stand(posture) {
    this.posture = posture;
    for (const mesh of this.bodies) {
      const poses = this.poses[mesh.userData.body];
      mesh.matrix.copy(poses[Math.min(posture, poses.length - 1)]);
      const move = this.moves.find((one) => one.bodies.includes(mesh.userData.body) && this.shifts.has(one.name));
      if (move) mesh.matrix.premultiply(this.shifts.get(move.name));
      mesh.matrixWorldNeedsUpdate = true;
    }
    const wire = posture ? this.wires?.[posture - 1] : null;
    this.wire.visible = Boolean(wire);
    if (wire) {
      this.wire.geometry.dispose();
      this.wire.geometry = new THREE.BufferGeometry().setFromPoints(wire.map((p) => new THREE.Vector3(...p)));
    }
    this.draw();
  }

  // Bodies that stand elsewhere than the service knows yet: move is one of its moves, pose where its first field is.
  carry(move, pose) {
    this.shifts.set(move.name, matrixOf(pose).multiply(matrixOf(move.fields[0]).invert()));
    this.stand(this.posture);
  }

  recolour() {
    super.recolour();
    for (const one of this.grid?.children ?? []) one.material.color.setRGB(...this.colour(one.userData.style));
  }

  glows(mesh) {
    return this.chosen && this.moves.find((one) => one.name === this.chosen)?.bodies.includes(mesh.userData.body);
  }

  // Names what can be dragged now, or nothing.
  choose(name) {
    this.chosen = name;
    this.recolour();
  }

  // Names of the arms below their bases.
  after() {
    for (const [i, name] of this.arms.entries()) {
      const base = this.bodies.find((mesh) => mesh.userData.body === `${name}/base_link`);
      const mark = this.labels.children[i];
      if (!base || !mark) continue;
      this.pin(mark, new THREE.Vector3().setFromMatrixPosition(base.matrix));
    }
  }

  // The number of the target that the pointer is at, or null.
  target(event) {
    if (!this.points?.length) return null;
    const box = this.canvas.getBoundingClientRect();
    const at = this.spot(event);
    let best = [NEAR, null];
    for (const { place, number, bad } of this.points) {
      const seen = place.clone().project(this.lens);
      const far = Math.hypot(((seen.x - at.x) * box.width) / 2, ((seen.y - at.y) * box.height) / 2) - (bad ? 4 : 0);
      if (far < best[0]) best = [far, number];
    }
    return best[1];
  }

  // What is chosen follows the pointer over its level, or turns with the shift key; else the view turns.
  hold() {
    const { canvas } = this;
    let held = null;
    let pressed = null;
    const begin = (event) => {
      pressed = [event.clientX, event.clientY];
      const hit = this.chosen && this.hit(this.spot(event));
      const move = hit && this.moves.find((one) => one.name === this.chosen && one.bodies.includes(hit.object.userData.body));
      if (!move || event.button) return;
      event.stopImmediatePropagation();
      canvas.focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      held = { move, from: hit.point.clone(), start: this.moved(move, null), x: event.clientX };
    };
    const drag = (event) => {
      if (!held) return event.buttons || this.meant(this.target(event));
      event.stopImmediatePropagation();
      const { move, from, start } = held;
      if (event.shiftKey) {
        const turn = snapped(start.rpy_deg[2] + (event.clientX - held.x) * 0.6, SNAP.deg);
        return this.moved(move, { ...start, rpy_deg: [start.rpy_deg[0], start.rpy_deg[1], turn] });
      }
      const { origin, direction } = this.ray(this.spot(event)).ray;
      if (Math.abs(direction.z) < 1e-3) return;
      const go = origin.clone().addScaledVector(direction, (from.z - origin.z) / direction.z).sub(from);
      if (go.length() > 1e5) return;
      this.moved(move, { ...start, xyz_mm: [snapped(start.xyz_mm[0] + go.x, SNAP.mm), snapped(start.xyz_mm[1] + go.y, SNAP.mm), start.xyz_mm[2]] });
    };
    const end = (event) => {
      const still = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4;
      pressed = null;
      if (held) {
        held = null;
        event.stopImmediatePropagation();
        return this.dropped();
      }
      if (!still) return;
      const number = this.target(event);
      if (number !== null) return this.meant(number, true);
      const hit = this.hit(this.spot(event));
      this.picked(hit ? this.moves.find((one) => one.bodies.includes(hit.object.userData.body))?.name ?? null : null);
    };
    canvas.addEventListener("pointerdown", begin, true);
    canvas.addEventListener("pointermove", drag, true);
    canvas.addEventListener("pointerup", end, true);
    canvas.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && this.meant(null));
  }
}

const good = (all, number) => all[number].posture !== undefined;
