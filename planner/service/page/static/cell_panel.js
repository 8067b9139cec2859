// The cell beside the form: drawn as the service has it, walked through target by target, moved by hand or by numbers.
import { post, upload } from "./api.js";
import { AxisMap, STYLES, WORDS } from "./axis_map.js";
import { CellView } from "./cell_view.js";
import { $, h, show } from "./dom.js";
import { goTo } from "./issues.js";
import { at, put } from "./schema.js";
import { number } from "./words.js";

const TARGETS = 40; // that are looked at, as of the first look
const FIELDS = [["x", "xyz_mm", 0, "mm", 5], ["y", "xyz_mm", 1, "mm", 5], ["z", "xyz_mm", 2, "mm", 5], ["turn", "rpy_deg", 2, "°", 15]];
const round = (v) => +v.toFixed(3);
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

export class CellPanel {
  // state: {problem, …}; files(): those that the problem names; changed(path): a value was changed here.
  constructor(state, files, changed) {
    Object.assign(this, { state, files, changed, data: null, tab: "part", number: 0, hand: null, told: "", shown: "" });
    this.view = new CellView($("cell-canvas"), $("cell-labels"), {
      meant: (found, tapped) => this.meant(found, tapped),
      picked: (name) => this.choose(name),
      moved: (move, pose) => this.drag(move, pose),
      dropped: () => this.drop(),
    });
    this.map = new AxisMap($("map-canvas"), $("map-told"), { chosen: (target) => this.go(target + 1), moves: (value) => this.prefer(value) });
    if (!this.view.works) $("cell-empty").textContent = "This browser cannot show 3D views: it lacks WebGL 2. Targets are described in text nevertheless.";
    $("cell-at").oninput = () => this.go($("cell-at").valueAsNumber);
    $("cell-next").onclick = () => this.next();
    $("cell-operation").onchange = $("map-freedom").onchange = () => this.again();
    $("map-layer").onchange = () => this.map.layer($("map-layer").value);
    $("cell-reach").onchange = () => ($("cell-reach").value && !this.data?.reach ? this.again() : this.reach());
    $("cell-move").onchange = () => this.choose($("cell-move").value || null);
  }

  get open() {
    return this.tab !== "part";
  }

  // Shows the part, the cell or the map; what was not asked for yet is asked for.
  turn(tab) {
    this.tab = tab;
    if (this.open && this.signal && !this.signal.aborted) {
      if (this.ready) this.look(this.signal);
      else this.draw(this.signal);
    }
    this.view.draw?.();
    this.map.draw();
  }

  // What was known before there was this panel.
  begin(signal, ready) {
    if (signal) Object.assign(this, { signal, ready, bare: false, looked: "" });
  }

  // The file can be read: what stands where. signal ends with the next change.
  async draw(signal) {
    if (this.signal !== signal) Object.assign(this, { signal, ready: false, bare: false, looked: "" });
    if (!this.open || this.bare) return;
    this.bare = true;
    await this.ask("", signal);
  }

  // The targets are known: what the arms do there.
  async look(signal) {
    this.ready = true;
    const freedom = this.tab === "map" ? $("map-freedom").value || "?" : "";
    const reach = this.tab === "cell" && $("cell-reach").value ? "&reach=true" : "";
    if (!this.open || (this.looked === (freedom || this.looked || "none") && !(reach && !this.data?.reach && this.looked !== "reach"))) return;
    this.looked = freedom || (reach ? "reach" : "none");
    this.note("Checking the targets …");
    await this.ask(`&targets=${TARGETS}${freedom ? `&freedom=${encodeURIComponent(freedom)}` : ""}${freedom && this.state.job ? `&job=${this.state.job}` : ""}${reach}`, signal);
  }

  again() {
    if (!this.signal || this.signal.aborted) return;
    Object.assign(this, { bare: false, looked: "" });
    this.turn(this.tab);
  }

  async ask(more, signal) {
    const operation = $("cell-operation").value || 0;
    if (more) {
      this.asking?.abort(); // of two looks at the same problem the later one is wanted
      this.asking = new AbortController();
      signal = AbortSignal.any([signal, this.asking.signal]);
    }
    try {
      const found = await (await post(`/v1/cell?operation=${operation}${more}`, { body: upload(this.state.problem, this.files()), signal })).json();
      if (signal.aborted || (!more && this.full === signal)) return; // what tells more came first
      if (more) this.full = this.signal;
      this.take(found);
    } catch (error) {
      if (error.name !== "AbortError" && !signal.aborted) this.note(`Not drawn: ${error.message}`);
    }
  }

  note(text) {
    $("cell-note").textContent = text;
    if (this.tab === "map") $("map-told").textContent = text;
  }

  take(data) {
    const key = same([data.setup, data.arms.map((one) => one.name), this.state.example], this.shown);
    this.shown = [data.setup, data.arms.map((one) => one.name), this.state.example];
    this.data = data;
    this.hand = null;
    show($("cell-empty"), !this.view.works);
    const select = $("cell-operation");
    select.replaceChildren(...data.operations.map((name, i) => h("option", { value: i, selected: i === data.operation }, name)));
    show($("cell-operations"), data.operations.length > 1);
    this.view.show(data, key);
    const all = data.targets ?? [];
    $("cell-at").max = all.length;
    $("cell-at").disabled = !all.length;
    show($("cell-next"), all.some((target) => target.posture === undefined));
    const moves = data.moves.filter((move) => move.fields.every(({ field }) => this.reachable(field)));
    const chosen = moves.some((move) => move.name === this.view.chosen) ? this.view.chosen : null;
    $("cell-move").replaceChildren(h("option", { value: "" }, "nothing: the view turns"), ...moves.map((move) => h("option", { value: move.name, selected: move.name === chosen }, nameOf(move))));
    this.choose(chosen);
    const bad = all.filter((target) => target.posture === undefined).length;
    $("cell-canvas").setAttribute("aria-label", `3D view of the cell: ${data.arms.map((arm) => `${arm.name}, ${arm.robot}`).join("; ")}${all.length ? `; ${bad} of ${all.length} targets have no posture` : ""}`);
    $("cell-note").textContent = !data.placed ? "The block is not drawn, because its pose is not known yet." : all.length ? `${number(all.length)} of ${number(data.of)} targets${data.thinned ? " of a coarser path" : ""} checked${bad ? `, ${bad} without a posture (red)` : ", all have a posture"}` : "";
    this.reach();
    this.freedoms(data);
    if (all.length) this.go(Math.min(this.number, all.length));
  }

  // What the arms can do over the block, one of them or all together: where one fails, what fails first.
  reach() {
    const { arms, reach } = this.data;
    const select = $("cell-reach");
    const names = arms.filter((arm) => arm.works).map((arm) => arm.name);
    const ways = names.length > 1 ? [...names, "all arms"] : names;
    const wanted = ways.includes(select.value) ? select.value : select.value ? ways.at(-1) : "";
    select.replaceChildren(h("option", { value: "" }, "not shown"), ...ways.map((name) => h("option", { value: name, selected: name === wanted }, name)));
    const told = $("cell-reach-told");
    show(told, Boolean(wanted));
    if (!wanted || !reach) {
      if (this.view.works) this.view.field([], [], 0);
      if (wanted) told.textContent = this.data.targets ? "No reach over the block: its pose is unknown, an arm holds it, or no target has a posture." : "";
      return;
    }
    const rows = wanted in reach.states ? [reach.states[wanted]] : Object.values(reach.states);
    const states = rows[0].map((_, i) => Math.max(...rows.map((row) => row[i])) && Math.min(...rows.map((row) => row[i] || 9)));
    if (this.view.works) this.view.field(reach.points_mm, states.map((state) => STYLES[reach.codes[state]]), 0.6 * Math.max(3, Math.min(...reach.pitch_mm.filter((v) => v > 3), Math.max(...reach.pitch_mm))));
    const counts = reach.codes.map((code, state) => [code, states.filter((one) => one === state).length]).filter(([, count]) => count);
    const each = Math.round(Math.max(...reach.pitch_mm));
    told.replaceChildren(
      ...counts.map(([code, count]) => h("span", {}, h("i", { class: `swatch ${STYLES[code].slice(2)}` }), `${code ? WORDS[code] : "within reach"} ${Math.round((100 * count) / states.length)} %`)),
      h("span", {}, `${number(states.length)} points, every ${each} mm. Tool orientation of the nearest of ${reach.targets} targets, ${reach.samples} samples of the freedoms, all branches. Collisions are not tested.`),
    );
  }

  // Whether a field is in the problem as the page has it: a cell in a file of its own is changed there.
  reachable(field) {
    return !field.startsWith("cell.") || typeof this.state.problem.cell === "object";
  }

  freedoms(data) {
    if (!data.freedoms) return;
    const select = $("map-freedom");
    const before = data.map?.freedom ?? select.value;
    select.replaceChildren(...data.freedoms.map((one) => h("option", { value: one.name, selected: one.name === before }, titleOf(one))));
    if (this.tab === "map" && !data.map && select.value) return this.look(this.signal);
    if (data.map) $("map-told").textContent = "";
    this.map.show(data);
  }

  // Shows target n of those that were looked at, or all at home for 0.
  go(n) {
    this.number = n;
    const target = this.data?.targets?.[n - 1];
    $("cell-at").value = n;
    const where = n ? `${target?.name ?? ""} (${n} of ${this.data?.targets?.length})` : "at home";
    $("cell-where").textContent = where;
    $("cell-at").setAttribute("aria-valuetext", target?.posture === undefined && n ? `${where}, no posture` : where);
    if (this.data && (!n || target?.posture !== undefined)) this.view.works && this.view.stand(n ? target.posture : 0);
    if (this.view.works && this.data) this.view.point(n ? n - 1 : null);
    this.map.mark(n - 1);
    this.tell(target);
  }

  next() {
    const all = this.data?.targets ?? [];
    const after = all.findIndex((target, i) => i >= this.number && target.posture === undefined);
    this.go((after >= 0 ? after : all.findIndex((target) => target.posture === undefined)) + 1);
  }

  // The pointer is at a target: why it is red.
  meant(found, tapped) {
    if (tapped) return this.go(found + 1);
    this.tell(found === null ? this.data?.targets?.[this.number - 1] : this.data?.targets?.[found]);
  }

  tell(target) {
    const place = $("cell-told");
    const faults = target?.faults ?? [];
    place.classList.toggle("wrong", faults.length > 0);
    const joints = target?.posture === undefined ? [] : this.data.arms.filter((arm) => arm.works).map((arm) => `${arm.name} ${this.data.joints_deg[arm.name][target.posture].map((v) => `${v.toFixed(0)}°`).join(" ")}`);
    const told = faults.map((one) => `${one.message.replace(/\.?$/, ".")}${one.hint ? ` What to do: ${one.hint}` : ""}`).join(" "); // which names the target
    const text = !target ? "" : faults.length ? told.charAt(0).toUpperCase() + told.slice(1) : `${target.name}: ${joints.join(" · ")}`;
    if (place.textContent !== text) place.textContent = text;
  }

  poseOf(move) {
    const { field, ...found } = move.fields[0];
    const stated = at(this.state.problem, field.split("."));
    const pose = stated && typeof stated === "object" ? stated : found;
    return { xyz_mm: [...(pose.xyz_mm ?? [0, 0, 0])], rpy_deg: [...(pose.rpy_deg ?? [0, 0, 0])] };
  }

  choose(name) {
    const move = this.data?.moves.find((one) => one.name === name && one.fields.every(({ field }) => this.reachable(field)));
    $("cell-move").value = move ? name : "";
    if (this.view.works) this.view.choose(move ? name : null);
    const place = $("cell-numbers");
    show(place, Boolean(move));
    if (!move) return;
    const pose = this.poseOf(move);
    const typed = this.moved?.name === name && place.contains(document.activeElement);
    this.moved = move;
    if (typed) return this.write(pose); // what is being typed stays
    place.replaceChildren(...FIELDS.map(([label, key, i, unit, step]) => {
      const input = h("input", { type: "number", step: "any", value: round(pose[key][i]), "aria-label": `${nameOf(move)}, ${label} [${unit}]`, data: { key, i },
        onchange: () => Number.isFinite(input.valueAsNumber) && this.set(this.moved, key, i, input.valueAsNumber),
        onkeydown: (event) => {
          const way = { ArrowUp: 1, ArrowDown: -1 }[event.key];
          if (!way) return;
          event.preventDefault();
          input.value = Math.round(input.valueAsNumber / step + way) * step;
          this.set(this.moved, key, i, input.valueAsNumber);
        } });
      return h("label", {}, h("span", {}, `${label} [${unit}]`), input);
    }), h("button", { type: "button", class: "link", onclick: () => goTo(this.moved.fields[0].field) }, "all fields"));
  }

  // The numbers of what is chosen, but for the one that is being typed.
  write(pose) {
    for (const input of $("cell-numbers").querySelectorAll("input")) if (document.activeElement !== input) input.value = round(pose[input.dataset.key][input.dataset.i]);
  }

  set(move, key, i, value) {
    const pose = this.poseOf(move);
    pose[key][i] = value;
    this.drag(move, pose);
    this.drop();
  }

  // The body goes where the hand has it; without a pose, where it is.
  drag(move, pose) {
    if (!pose) return this.poseOf(move);
    this.hand = { move, pose };
    if (this.view.works && this.data.reach) this.view.field([], [], 0); // of the place that it had
    if (this.view.works) this.view.carry(move, pose);
    this.write(pose);
    return pose;
  }

  // What was moved becomes the fields' own value, as if it had been typed.
  drop() {
    if (!this.hand) return;
    const { move, pose } = this.hand;
    this.hand = null;
    const was = this.poseOf(move);
    if (same(was, pose)) return;
    const go = pose.xyz_mm.map((v, i) => v - was.xyz_mm[i]);
    const turn = ((pose.rpy_deg[2] - was.rpy_deg[2]) * Math.PI) / 180;
    for (const [k, { field, ...found }] of move.fields.entries()) {
      const path = field.split(".");
      const stated = at(this.state.problem, path);
      const old = { ...found, ...(stated && typeof stated === "object" ? stated : {}) };
      const [x, y] = [old.xyz_mm[0] - was.xyz_mm[0], old.xyz_mm[1] - was.xyz_mm[1]];
      const place = k ? [was.xyz_mm[0] + x * Math.cos(turn) - y * Math.sin(turn) + go[0], was.xyz_mm[1] + x * Math.sin(turn) + y * Math.cos(turn) + go[1], old.xyz_mm[2] + go[2]] : pose.xyz_mm;
      const rpy = k ? [old.rpy_deg[0], old.rpy_deg[1], old.rpy_deg[2] + pose.rpy_deg[2] - was.rpy_deg[2]] : pose.rpy_deg;
      const turned = rpy.some((v) => v) || Boolean(stated?.rpy_deg); // what is not said and stays zero is not said
      put(this.state.problem, path, { xyz_mm: place.map(round), ...(turned ? { rpy_deg: rpy.map(round) } : {}) });
      const auto = [...path.slice(0, -1), "base_auto"];
      if (path.at(-1) === "base" && at(this.state.problem, auto)) put(this.state.problem, auto, false);
    }
    const first = move.fields[0].field.split(".");
    this.changed(first);
  }

  // Fields were changed in the form: bodies go along at once, before the service has read it.
  follow() {
    if (!this.data || !this.view.works || !this.open) return;
    for (const move of this.data.moves) if (this.reachable(move.fields[0].field)) this.view.carry(move, this.poseOf(move));
    if (this.view.chosen && !$("cell-numbers").contains(document.activeElement)) this.choose(this.view.chosen);
  }

  // A value of the map is wanted: where the freedom is a way of the block, it is moved there.
  prefer(value) {
    const axis = ["x", "y", "z"].indexOf(this.data.map.freedom.replace("place ", ""));
    const move = this.data.moves.find((one) => one.kind === "stock");
    if (axis < 0 || !move) return false;
    this.set(move, "xyz_mm", axis, Math.round((this.poseOf(move).xyz_mm[axis] + value) / 5) * 5);
    return true;
  }
}

const nameOf = (move) => (move.kind === "stock" ? "the block" : move.kind === "arm" ? `base of ${move.name}` : move.name);
const titleOf = ({ name, unit }) => `${name.startsWith("place ") ? `block along ${name.slice(6)}` : name.replaceAll("_", " ")}${unit ? ` [${unit === "deg" ? "°" : unit}]` : ""}`;
