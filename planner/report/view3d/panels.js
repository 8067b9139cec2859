// Panels of an element, as element.json has their solids, made ready to be drawn.
import { cross, dot, minus, plus, scaled, unit } from "./matrix.js";

const SHARP = 0.75; // cosine of the turn at which an outline has an edge from front to back

const numbers = (text) => text.split(" ").map(Number);
const points = (text, axes) => {
  const flat = numbers(text);
  return Array.from({ length: flat.length / 3 }, (_, i) => axes.map((axis) => dot(axis, flat.slice(3 * i, 3 * i + 3))));
};

// Axes of the view, as rows: x as in the element, z up.
export function uprightAxes(up) {
  const along = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const x = unit(minus(along, scaled(up, dot(along, up))));
  return [x, cross(up, x), up];
}

// A panel {front, back, faces, rim, way} as it is drawn: its body, the lines on it, where it is and how large.
export function madePanel(panel, axes) {
  const [front, back] = [points(panel.front, axes), points(panel.back, axes)];
  const [faces, rim, count] = [numbers(panel.faces), numbers(panel.rim), front.length];
  const triangles = [...faces];
  for (let i = 0; i < faces.length; i += 3) triangles.push(count + faces[i], count + faces[i + 2], count + faces[i + 1]);
  const lines = [];
  for (const [i, a] of rim.entries()) {
    const [b, before] = [rim[(i + 1) % rim.length], rim[(i + rim.length - 1) % rim.length]];
    triangles.push(count + a, count + b, b, count + a, b, a);
    lines.push(...front[a], ...front[b], ...back[a], ...back[b]);
    if (dot(unit(minus(front[b], front[a])), unit(minus(front[a], front[before]))) < SHARP) lines.push(...front[a], ...back[a]);
  }
  const every = [...front, ...back];
  const low = [0, 1, 2].map((k) => Math.min(...every.map((p) => p[k])));
  const high = [0, 1, 2].map((k) => Math.max(...every.map((p) => p[k])));
  const way = axes.map((axis) => dot(axis, panel.way));
  const size = Math.hypot(...minus(high, low));
  return { ...panel, way, low, high, size, middle: scaled(plus(low, high), 0.5), solid: { vertices: every.flat(), faces: triangles }, edges: { vertices: lines, faces: [] } };
}
