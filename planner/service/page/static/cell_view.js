// The cell in 3D: bodies where the service says they are, targets, and what can be moved by hand.
import * as THREE from "./vendor/three.module.min.js";
import { h } from "./dom.js";
import { Orbit } from "./orbit.js";

const SNAP = { mm: 5, deg: 15 };
const NEAR = 14; // pixels from the pointer at which a target is meant
const DEG = Math.PI / 180;
export const snapped = (value, step) => Math.round(value / step) * step;

// The matrix of a pose {xyz_mm, rpy_deg}; roll, pitch, yaw are about x, y, z of the frame outside, in this order.
export function matrixOf({ xyz_mm, rpy_deg }) {
  const turn = new THREE.Euler(...rpy_deg.map((v) => v * DEG), "ZYX");
  return new THREE.Matrix4().makeRotationFromEuler(turn).setPosition(...xyz_mm);
}

// Light from the sky and from one side, worked out at the corners: without a graphics card each pixel counts.
const SHADED = {
  vertexShader: `varying float lit;
    void main() {
      vec3 n = normalize(mat3(modelMatrix) * normal);
      lit = 0.72 + 0.16 * n.z + 0.2 * dot(n, vec3(0.31, -0.55, 0.78));
      gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    }`,
  fragmentShader: `uniform vec3 paint; uniform float opacity; varying float lit;
    void main() { gl_FragColor = vec4(paint * lit, opacity); }`,
};
const fromRows = (rows) => new THREE.Matrix4().set(...rows, 0, 0, 0, 1);

export class CellView extends Orbit {
  // meant(target number or null): the pointer is at it; moved(move, pose): the hand is at a body; dropped(): it lets go.
  constructor(canvas, labels, { meant, picked, moved, dropped }) {
    super(canvas, 1.25);
    Object.assign(this, { labels, meant, picked, moved, dropped, bodies: [], moves: [], chosen: null, posture: 0, shown: 0 });
    if (!this.works) return;
    this.three = new THREE.WebGLRenderer({ canvas, context: this.gl, antialias: true });
    this.three.setPixelRatio(1);
    this.three.outputColorSpace = THREE.LinearSRGBColorSpace; // colours as the style sheet has them
    this.lens = new THREE.Camera();
    this.stage = new THREE.Scene();
    this.round = disc();
    this.cell = this.stage.add(new THREE.Group()).children.at(-1);
    this.marks = this.stage.add(new THREE.Group()).children.at(-1);
    addEventListener("themechange", () => this.recolour());
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
    this.floor();
    this.near = this.canvas.clientWidth > 1.2 * this.canvas.clientHeight ? 1.25 : 1.15;
    if (keep) this.draw();
    else this.home();
  }

  clear(group) {
    for (const one of [...group.children]) {
      one.geometry?.dispose();
      one.material?.dispose();
      group.remove(one);
    }
  }

  body(one) {
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.Float32BufferAttribute(one.vertices, 3));
    shape.setIndex(one.faces);
    shape.computeVertexNormals();
    const clear = one.kind === "stock";
    const uniforms = { paint: { value: new THREE.Color() }, opacity: { value: clear ? 0.34 : 1 } };
    const mesh = new THREE.Mesh(shape, new THREE.ShaderMaterial({ ...SHADED, uniforms, transparent: clear, depthWrite: !clear, side: one.kind === "part" ? THREE.DoubleSide : THREE.FrontSide }));
    Object.assign(mesh, { matrixAutoUpdate: false, renderOrder: clear ? 2 : 0, userData: { body: one.body, kind: one.kind, paint: one.color } });
    this.cell.add(mesh);
    return mesh;
  }

  line(points, name) {
    const made = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial());
    made.userData = { style: name };
    this.cell.add(made);
    return made;
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
    this.here = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: 13, sizeAttenuation: false, depthTest: false, map: this.round, alphaTest: 0.5 }));
    this.here.userData = { style: "--view-hot" };
    this.here.renderOrder = 5;
    this.here.frustumCulled = false;
    this.marks.add(this.here);
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

  extent() {
    const box = new THREE.Box3();
    for (const mesh of this.bodies) {
      if (mesh.userData.kind === "obstacle") continue;
      mesh.geometry.computeBoundingBox();
      box.union(mesh.geometry.boundingBox.clone().applyMatrix4(mesh.matrix));
    }
    if (box.isEmpty()) box.set(new THREE.Vector3(-500, -500, 0), new THREE.Vector3(500, 500, 500));
    return [box.min.toArray(), box.max.toArray()];
  }

  floor() {
    const [low, high] = this.whole;
    const size = Math.max(high[0] - low[0], high[1] - low[1]) * 1.5;
    const step = size > 4000 ? 500 : size > 1500 ? 250 : 100;
    const count = Math.ceil(size / step);
    const grid = new THREE.GridHelper(count * step, count);
    grid.rotation.x = Math.PI / 2;
    grid.position.set(snapped((low[0] + high[0]) / 2, step), snapped((low[1] + high[1]) / 2, step), Math.min(low[2], 0) - 2);
    grid.material.vertexColors = false;
    grid.userData = { style: "--view-grid" };
    this.cell.add(grid);
    this.recolour();
  }

  recolour() {
    if (!this.stage) return;
    const style = (name) => new THREE.Color(...this.colour(name));
    const own = { part: "--view-part", stock: "--view-stock", edge: "--view-hot", obstacle: "--view-body", support: "--view-body" };
    for (const mesh of this.bodies) {
      const { kind, paint } = mesh.userData;
      const { value } = mesh.material.uniforms.paint;
      value.copy(own[kind] ? style(own[kind]) : new THREE.Color(...(paint ?? [0.7, 0.7, 0.7])));
      const glows = this.chosen && this.moves.find((one) => one.name === this.chosen)?.bodies.includes(mesh.userData.body);
      if (glows) value.lerp(style("--accent"), 0.6);
    }
    for (const one of [...this.cell.children, ...this.marks.children]) if (one.userData.style) one.material.color.copy(style(one.userData.style));
    this.draw();
  }

  // Names what can be dragged now, or nothing.
  choose(name) {
    this.chosen = name;
    this.recolour();
  }

  paint() {
    const { canvas } = this;
    const scale = Math.min(devicePixelRatio || 1, 2);
    const size = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (!size[0] || !size[1] || !this.whole) return;
    if (canvas.width !== size[0] || canvas.height !== size[1]) this.three.setSize(...size, false);
    const { view, lens } = this.camera();
    this.lens.matrixWorldInverse.fromArray(view);
    this.lens.matrixWorld.copy(this.lens.matrixWorldInverse).invert();
    this.lens.matrixAutoUpdate = this.lens.matrixWorldAutoUpdate = false;
    this.lens.projectionMatrix.fromArray(lens);
    this.lens.projectionMatrixInverse.copy(this.lens.projectionMatrix).invert();
    this.three.render(this.stage, this.lens);
    this.name();
    this.shown += 1;
  }

  // Names of the arms below their bases.
  name() {
    for (const [i, name] of this.arms.entries()) {
      const base = this.bodies.find((mesh) => mesh.userData.body === `${name}/base_link`);
      const mark = this.labels.children[i];
      if (!base || !mark) continue;
      const { x, y, z } = new THREE.Vector3().setFromMatrixPosition(base.matrix).project(this.lens);
      mark.hidden = Math.abs(x) > 1 || Math.abs(y) > 1 || z > 1;
      mark.style.left = `${(50 * (x + 1)).toFixed(2)}%`;
      mark.style.top = `${(50 * (1 - y)).toFixed(2)}%`;
    }
  }

  spot(event) {
    const box = this.canvas.getBoundingClientRect();
    return new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
  }

  ray(event) {
    const caster = new THREE.Raycaster();
    const at = this.spot(event);
    caster.ray.origin.setFromMatrixPosition(this.lens.matrixWorld);
    caster.ray.direction.set(at.x, at.y, 0.5).unproject(this.lens).sub(caster.ray.origin).normalize();
    return caster;
  }

  // The body under the pointer, with the place where it is met.
  hit(event) {
    return this.whole ? this.ray(event).intersectObjects(this.bodies, false)[0] ?? null : null;
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
      const hit = this.chosen && this.hit(event);
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
      const { origin, direction } = this.ray(event).ray;
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
      const hit = this.hit(event);
      this.picked(hit ? this.moves.find((one) => one.bodies.includes(hit.object.userData.body))?.name ?? null : null);
    };
    canvas.addEventListener("pointerdown", begin, true);
    canvas.addEventListener("pointermove", drag, true);
    canvas.addEventListener("pointerup", end, true);
    canvas.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && this.meant(null));
  }
}

// A round dot, for points that are squares otherwise.
function disc() {
  const size = 32;
  const alpha = new Uint8Array(4 * size * size);
  for (let i = 0; i < size * size; i++) {
    const far = Math.hypot((i % size) - 15.5, Math.floor(i / size) - 15.5);
    alpha.set([255, 255, 255, far < 15.5 ? 255 : 0], 4 * i);
  }
  const made = new THREE.DataTexture(alpha, size, size);
  made.needsUpdate = true;
  return made;
}

const good = (all, number) => all[number].posture !== undefined;
