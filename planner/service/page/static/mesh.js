// Reads OBJ, STL and PLY in the browser, so that a part is seen as soon as it is chosen.
// A mesh is {vertices: Float32Array (3 a vertex), faces: Uint32Array (3 a triangle)}.

const MOST = 40e6; // bytes; larger files are drawn when the service has thinned them out

export const isMesh = (name) => /\.(obj|stl|ply)$/i.test(name);

export async function readMesh(file, name) {
  if (file.size > MOST) throw new Error("too large to be drawn here");
  const data = await file.arrayBuffer();
  const kind = name.split(".").pop().toLowerCase();
  const mesh = { obj: readObj, stl: readStl, ply: readPly }[kind](data);
  if (!mesh.faces.length) throw new Error("it contains no triangles");
  for (const value of mesh.vertices) if (!Number.isFinite(value)) throw new Error("a coordinate is not a number");
  const count = mesh.vertices.length / 3;
  for (const index of mesh.faces) if (index >= count) throw new Error("a triangle refers to a missing vertex");
  return mesh;
}

export function boxOf(vertices) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < vertices.length; i++) {
    const axis = i % 3;
    if (vertices[i] < low[axis]) low[axis] = vertices[i];
    if (vertices[i] > high[axis]) high[axis] = vertices[i];
  }
  return [low, high];
}

const text = (data) => new TextDecoder("utf-8").decode(data);

function fan(indices, faces) {
  for (let i = 2; i < indices.length; i++) faces.push(indices[0], indices[i - 1], indices[i]);
}

function readObj(data) {
  const vertices = [];
  const faces = [];
  for (const line of text(data).split("\n")) {
    const words = line.trim().split(/\s+/);
    if (words[0] === "v") vertices.push(+words[1], +words[2], +words[3]);
    else if (words[0] === "f")
      fan(words.slice(1).map((word) => {
        const index = parseInt(word, 10);
        return index < 0 ? vertices.length / 3 + index : index - 1;
      }), faces);
  }
  return { vertices: new Float32Array(vertices), faces: new Uint32Array(faces) };
}

function readStl(data) {
  const view = new DataView(data);
  const count = data.byteLength >= 84 ? view.getUint32(80, true) : 0;
  if (data.byteLength >= 84 && data.byteLength === 84 + 50 * count) {
    const vertices = new Float32Array(9 * count);
    for (let i = 0; i < count; i++) for (let j = 0; j < 9; j++) vertices[9 * i + j] = view.getFloat32(84 + 50 * i + 12 + 4 * j, true);
    return { vertices, faces: Uint32Array.from({ length: 3 * count }, (_, i) => i) };
  }
  const found = [...text(data).matchAll(/vertex\s+(\S+)\s+(\S+)\s+(\S+)/g)].flatMap((m) => [+m[1], +m[2], +m[3]]);
  return { vertices: new Float32Array(found), faces: Uint32Array.from({ length: Math.floor(found.length / 9) * 3 }, (_, i) => i) };
}

const SIZES = { char: 1, int8: 1, uchar: 1, uint8: 1, short: 2, int16: 2, ushort: 2, uint16: 2, int: 4, int32: 4, uint: 4, uint32: 4, float: 4, float32: 4, double: 8, float64: 8 };
const GETS = { char: "getInt8", int8: "getInt8", uchar: "getUint8", uint8: "getUint8", short: "getInt16", int16: "getInt16", ushort: "getUint16", uint16: "getUint16", int: "getInt32", int32: "getInt32", uint: "getUint32", uint32: "getUint32", float: "getFloat32", float32: "getFloat32", double: "getFloat64", float64: "getFloat64" };

function readPly(data) {
  const head = text(data.slice(0, Math.min(data.byteLength, 20000)));
  const end = head.indexOf("end_header");
  if (end < 0) throw new Error("its header has no end");
  const start = head.indexOf("\n", end) + 1;
  const elements = [];
  let format = "ascii";
  for (const line of head.slice(0, end).split("\n")) {
    const words = line.trim().split(/\s+/);
    if (words[0] === "format") format = words[1];
    else if (words[0] === "element") elements.push({ name: words[1], count: +words[2], properties: [] });
    else if (words[0] === "property")
      elements.at(-1)?.properties.push(words[1] === "list" ? { count: words[2], type: words[3], name: words[4] } : { type: words[1], name: words[2] });
  }
  const next = format === "ascii" ? words(text(data.slice(start))) : numbers(data, start, format === "binary_little_endian");
  const vertices = [];
  const faces = [];
  for (const element of elements)
    for (let i = 0; i < element.count; i++) {
      const row = {};
      for (const property of element.properties) {
        if (!property.count) row[property.name] = next(property.type);
        else row[property.name] = Array.from({ length: next(property.count) }, () => next(property.type));
      }
      if (element.name === "vertex") vertices.push(row.x, row.y, row.z);
      else if (element.name === "face") fan(row.vertex_indices ?? row.vertex_index ?? [], faces);
    }
  return { vertices: new Float32Array(vertices), faces: new Uint32Array(faces) };
}

function words(body) {
  const all = body.split(/\s+/).filter(Boolean);
  let i = 0;
  return () => {
    if (i >= all.length) throw new Error("it is truncated");
    return +all[i++];
  };
}

function numbers(data, start, little) {
  const view = new DataView(data);
  let i = start;
  return (type) => {
    if (!(type in SIZES)) throw new Error(`unknown type ${type}`);
    if (i + SIZES[type] > data.byteLength) throw new Error("it is truncated");
    const value = view[GETS[type]](i, little);
    i += SIZES[type];
    return value;
  };
}
