// Names, units and numbers as people read them.

export const plural = (n, one) => `${n.toLocaleString("en-GB")} ${one}${n === 1 ? "" : "s"}`;

const UNITS = [
  ["_mm_min", "mm/min"],
  ["_mm_s", "mm/s"],
  ["_n_mm", "N/mm"],
  ["_deg_s", "deg/s"],
  ["_percent", "%"],
  ["_mm", "mm"],
  ["_deg", "deg"],
  ["_rpm", "rpm"],
  ["_kg", "kg"],
  ["_s", "s"],
  ["_n", "N"],
  ["_w", "W"],
  ["_c", "°C"],
];
const ACRONYMS = { tcp: "TCP", naca: "NACA", dxf: "DXF", gcode: "G‑code", io: "I/O", cog: "centre of mass", xyz: "Position", rpy: "Roll, pitch, yaw", u: "u", v: "v" };

const UNIT_UNSAID = { offsets: "mm" };

export const unitOf = (name) => UNIT_UNSAID[name] ?? UNITS.find(([suffix]) => name.endsWith(suffix))?.[1] ?? "";

export function labelOf(name) {
  const suffix = UNITS.find(([end]) => name.endsWith(end))?.[0] ?? "";
  const bare = suffix ? name.slice(0, -suffix.length) : name;
  if (ACRONYMS[bare]) return ACRONYMS[bare];
  const words = bare.split("_").map((word) => ACRONYMS[word] ?? word).join(" ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

export const PROCESSES = {
  elastic_wire: ["Elastic wire", "Two arms bend one hot wire and sweep it through foam."],
  straight_wire: ["Straight wire", "A bow with a straight hot wire cuts ruled surfaces."],
  forming: ["Sheet forming", "One or two tools form a clamped metal sheet, step by step."],
  milling: ["Milling", "Flank and point milling, engraving, G‑code."],
  targets: ["Given poses", "Tool poses from a table, one arm or two."],
};
export const processName = (name) => PROCESSES[name]?.[0] ?? labelOf(name);

export const STATES = {
  queued: ["Waiting", "wait"],
  running: ["Planning", "run"],
  verified: ["Verified", "ok"],
  done: ["Divided", "ok"],
  not_planned: ["Not planned", "off"],
  infeasible: ["No feasible plan", "bad"],
  bad_input: ["Bad input", "bad"],
  unproven: ["Not proven", "bad"],
  crashed: ["Failed", "bad"],
  timeout: ["Out of time", "bad"],
  memory: ["Out of memory", "bad"],
  cancelled: ["Cancelled", "off"],
};
// Jobs in these states can be tried again; the service tries no others.
export const AGAIN = ["crashed", "timeout", "memory", "cancelled"];
export const isOpen = (state) => state === "queued" || state === "running";

const FIGURES = {
  cycle_s: "Motion time, first to last target",
  travel_s: "Time of track or turntable",
  targets: "Targets",
  path_cost: "Path cost",
  clearance_mm: "Minimum clearance",
  own_clearance_mm: "Minimum self-clearance of an arm",
  joint_limits_deg: "Margin to joint limits",
  joint_speed_percent: "Maximum joint speed",
  singularity_deg: "Distance to singularity",
  surface_percent: "Surface within tolerance",
};
export const BETTER = { cycle_s: -1, travel_s: -1, path_cost: -1, clearance_mm: 1, own_clearance_mm: 1, joint_limits_deg: 1, joint_speed_percent: -1, singularity_deg: 1, surface_percent: 1 };
export const figureName = (name) => FIGURES[name] ?? labelOf(name);
export const figureOrder = (names) => {
  const known = Object.keys(FIGURES);
  const place = (name) => (known.includes(name) ? known.indexOf(name) : known.length);
  return [...names].sort((a, b) => place(a) - place(b));
};

export function number(value, digits = 4) {
  if (typeof value !== "number" || !isFinite(value)) return String(value);
  if (Number.isInteger(value) || Math.abs(value) >= 1000) return Math.round(value).toLocaleString("en-GB").replaceAll(",", "\u202f").replace("-", "−");
  return String(+value.toPrecision(digits)).replace("-", "−");
}

export function duration(seconds) {
  if (seconds < 1) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 90) return `${seconds.toFixed(1)} s`;
  const minutes = Math.floor(seconds / 60);
  if (minutes < 90) return `${minutes} min ${Math.round(seconds % 60)} s`;
  return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export function clock(seconds) {
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}

export function ago(when) {
  const seconds = (Date.now() - new Date(when).getTime()) / 1000;
  if (seconds < 60) return "just now";
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ago`;
  if (seconds < 86400) return `${Math.floor(seconds / 3600)} h ago`;
  return new Date(when).toLocaleDateString("en-GB", { day: "numeric", month: "short", year: "numeric" });
}

// A moment, to the minute.
export const minute = (when) => new Date(when).toLocaleString("en-GB", { day: "numeric", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit" });

export function bytes(size) {
  if (size < 1000) return `${size} B`;
  if (size < 1e6) return `${(size / 1e3).toFixed(size < 1e4 ? 1 : 0)} kB`;
  if (size < 1e9) return `${(size / 1e6).toFixed(1)} MB`;
  return `${+(size / 1e9).toFixed(1)} GB`;
}
