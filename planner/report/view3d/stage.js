// A cell drawn by three.js: bodies in the colours of the style sheet, lines, dots, a floor. The camera is Orbit's.
import * as THREE from "./vendor/three.module.min.js";
import { Orbit } from "./orbit.js";

// Light from the sky and from one side, worked out at the corners: without a graphics card each pixel counts.
const SHADED = {
  vertexShader: `varying float lit; varying vec3 own;
    void main() {
      vec3 n = normalize(mat3(modelMatrix) * normal);
      float side = dot(n, vec3(0.31, -0.55, 0.78));
      lit = twosided ? 0.66 + 0.16 * abs(n.z) + 0.2 * abs(side) : 0.72 + 0.16 * n.z + 0.2 * side;
      #ifdef USE_COLOR
      own = color;
      #else
      own = vec3(1.0);
      #endif
      gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    }`,
  fragmentShader: `uniform vec3 paint; uniform float opacity, even; varying float lit; varying vec3 own;
    void main() { gl_FragColor = vec4(paint * own * mix(lit, 1.0, even), opacity); }`,
};

export class Stage extends Orbit {
  constructor(canvas, near) {
    super(canvas, near);
    Object.assign(this, { bodies: [], shown: 0 });
    if (!this.works) return;
    this.three = new THREE.WebGLRenderer({ canvas, context: this.gl, antialias: true });
    this.three.setPixelRatio(1);
    this.three.outputColorSpace = THREE.LinearSRGBColorSpace; // colours as the style sheet has them
    this.lens = new THREE.Camera();
    this.stage = new THREE.Scene();
    this.round = disc();
    this.cell = this.stage.add(new THREE.Group()).children.at(-1);
    this.marks = this.stage.add(new THREE.Group()).children.at(-1);
    addEventListener("themechange", () => this.recolour(), { signal: this.over.signal });
  }

  end() {
    this.three?.dispose();
    super.end();
  }

  clear(group) {
    for (const one of [...group.children]) {
      one.geometry?.dispose();
      one.material?.dispose();
      group.remove(one);
    }
  }

  // A body of vertices and triangles in its own frame: {body, kind, color, vertices, faces}; what can be seen
  // from both sides is lit alike from both.
  body(one, twoSided = one.kind === "part") {
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.Float32BufferAttribute(one.vertices, 3));
    shape.setIndex(one.faces);
    shape.computeVertexNormals();
    const clear = one.kind === "stock";
    const mesh = new THREE.Mesh(shape, shaded(twoSided, clear ? 0.34 : 1));
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

  // Round dots of a size in pixels in a colour of the style sheet, hidden behind nothing.
  dots(points, size, name, order = 5) {
    const made = new THREE.Points(new THREE.BufferGeometry().setFromPoints(points), new THREE.PointsMaterial({ size, sizeAttenuation: false, depthTest: false, map: this.round, alphaTest: 0.5 }));
    Object.assign(made, { userData: { style: name }, renderOrder: order, frustumCulled: false });
    this.marks.add(made);
    return made;
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

  floor([low, high]) {
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

  // Whether a body glows, as one that is chosen.
  glows() {
    return false;
  }

  recolour() {
    if (!this.stage) return;
    const style = (name) => new THREE.Color(...this.colour(name));
    const own = { part: "--view-part", stock: "--view-stock", edge: "--view-hot", cut: "--view-hot", obstacle: "--view-body", support: "--view-body" };
    for (const mesh of this.bodies) {
      const { kind, paint } = mesh.userData;
      const { value } = mesh.material.uniforms.paint;
      value.copy(own[kind] ? style(own[kind]) : new THREE.Color(...(paint ?? [0.7, 0.7, 0.7])));
      if (this.glows(mesh)) value.lerp(style("--accent"), 0.6);
    }
    for (const one of [...this.cell.children, ...this.marks.children]) if (one.userData.style) one.material.color.copy(style(one.userData.style));
    this.draw();
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
    this.after();
    this.shown += 1;
  }

  // What stands over the picture goes along with it.
  after() {}

  // Puts an element where a place is seen, or hides it.
  pin(mark, place) {
    const { x, y, z } = place.clone().project(this.lens);
    mark.hidden = Math.abs(x) > 1 || Math.abs(y) > 1 || z > 1;
    mark.style.left = `${(50 * (x + 1)).toFixed(2)}%`;
    mark.style.top = `${(50 * (1 - y)).toFixed(2)}%`;
  }

  spot(event) {
    const box = this.canvas.getBoundingClientRect();
    return new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
  }

  ray(at) {
    const caster = new THREE.Raycaster();
    caster.ray.origin.setFromMatrixPosition(this.lens.matrixWorld);
    caster.ray.direction.set(at.x, at.y, 0.5).unproject(this.lens).sub(caster.ray.origin).normalize();
    return caster;
  }

  // The body that is seen at a place of the picture, with the point where it is met.
  hit(at) {
    return this.whole ? this.ray(at).intersectObjects(this.bodies.filter((one) => one.visible), false)[0] ?? null : null;
  }
}

export const snapped = (value, step) => Math.round(value / step) * step;

// Colours of its own for each corner with vertexColors; the uniform paint times these, and less shade with even.
export function shaded(twoSided, opacity, vertexColors = false) {
  const uniforms = { paint: { value: new THREE.Color(1, 1, 1) }, opacity: { value: opacity }, even: { value: 0 } };
  const clear = opacity < 1;
  const vertexShader = SHADED.vertexShader.replaceAll("twosided", String(twoSided));
  return new THREE.ShaderMaterial({ ...SHADED, vertexShader, uniforms, vertexColors, transparent: clear, depthWrite: !clear, side: twoSided ? THREE.DoubleSide : THREE.FrontSide });
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
