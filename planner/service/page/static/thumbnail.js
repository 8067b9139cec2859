// Small pictures of jobs in lists: the cell, or what stands for the process where there is no picture.
import { fileOf } from "./api.js";
import { h, svg } from "./dom.js";
import { processName } from "./words.js";

const FILE = "thumbnail.png";
// Drawn with one line, 40 x 24.
const SIGNS = {
  elastic_wire: "M6 20V9M34 20V9M6 9c7-8 21-8 28 0M11 20v-4h18v4z",
  straight_wire: "M9 4v16M31 4v16M9 8h22M14 20v-8h12v8z",
  forming: "M4 8h7l4 9h10l4-9h7M20 3v10",
  milling: "M20 3v7M17 10h6v6l-3 3-3-3zM5 20h9M26 20h9",
  trim: "M20 3v8M17 7h6M20 11l-2 4h4zM5 17h11M24 17h11",
  targets: "M6 18c6 0 6-11 14-11s8 8 14 8M6 18h.1M20 7h.1M34 15h.1",
};
const OTHER = "M6 20h28M12 20v-7l7-7 8 4v4";

function sign(one) {
  const process = one.processes[0];
  const name = `${one.processes.map(processName).join(", ") || "Job"}, no picture`;
  return svg("svg", { class: "thumb sign", viewBox: "0 0 40 24", role: "img", "aria-label": name }, svg("path", { d: SIGNS[process] ?? OTHER }));
}

// The picture of a job, which is fetched when it comes into view; without one, nothing or what stands for it.
export function pictureOf(job, name, instead = () => "") {
  const picture = h("img", { class: "thumb", loading: "lazy", decoding: "async", width: 100, height: 60, alt: `The cell of ${name}`, onerror: () => picture.replaceWith(instead()) });
  picture.src = fileOf(job, FILE); // after what says when it is to be fetched
  return picture;
}

export const thumbnail = (one) => (one.thumbnail ? pictureOf(one.id, one.title || one.name, () => sign(one)) : sign(one));
