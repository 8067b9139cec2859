// Who answers for the programs of a job: released, withdrawn, and what that names.
import { json, job as path, post } from "./api.js";
import { sign, signed, tell } from "./common.js";
import { $, announce, h, icon, show } from "./dom.js";

let now = { job: null, programs: [] };

const moment = (text) => new Date(text).toLocaleString("en-GB", { day: "numeric", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short" });
const short = (digest) => digest.slice(0, 16);

function line(one) {
  const said = h("li", {}, `Released by `, h("bdi", {}, one.by), `, ${moment(one.at)}`, one.note ? [": ", h("bdi", { class: "note" }, one.note)] : null);
  if (one.withdrawn) said.append("; withdrawn by ", h("bdi", {}, one.withdrawn.by), `, ${moment(one.withdrawn.at)}: `, h("bdi", { class: "note" }, one.withdrawn.reason));
  return said;
}

// Shows whether the programs are released, by whom, and what can be done about it.
export async function drawRelease(id, job, programs) {
  now = { job, programs };
  const all = job.release ? (await json(`${path(id)}/releases`)).releases : [];
  const can = job.state === "verified" && programs.length > 0;
  const last = job.release;
  show($("release"), can && !job.released);
  show($("withdraw"), can && Boolean(job.released));
  show($("released"), can);
  show($("sure-released"), Boolean(job.released));
  $("download").replaceChildren(icon("down"), job.released ? "Download released programs" : "Download programs, not released");
  $("released").className = `card release ${job.released ? "ok" : "off"}`;
  const title = job.released ? "Released" : last ? "Withdrawn" : "Not released";
  $("released-title").replaceChildren(icon(job.released ? "check" : "stop"), `${title}: ${job.released ? "these programs may run" : "nobody is responsible for these programs, and downloads state this"}`);
  $("released-list").replaceChildren(...all.map(line));
  show($("released-list"), all.length > 0);
}

function pairs() {
  const rows = [["Problem", now.job.name, ""], ["Digest", short(now.job.digest), now.job.digest], ...now.programs.map((one) => [one.name.replace(/^programs\//, ""), short(one.sha256), one.sha256])];
  return rows.flatMap(([name, value, whole]) => [h("dt", {}, name), h("dd", {}, whole ? h("code", { title: whole }, value) : value)]);
}

// Opens the dialogs, and sends what was decided; then everything is read anew.
export function setUpRelease(id, after, who) {
  $("release").prepend(icon("check"));
  $("withdraw").prepend(icon("cross"));
  const named = who && !who.tokens; // nobody is known by a token
  for (const name of ["release", "withdraw"]) {
    show($(`${name}-who`), Boolean(named));
    $(`${name}-name`).required = Boolean(named);
    $(name).addEventListener("click", () => {
      $("release-what").replaceChildren(...pairs());
      $(`${name}-name`).value = signed();
      $(`${name}-ask`).returnValue = "";
      $(`${name}-ask`).showModal();
      if (named && !$(`${name}-name`).value) $(`${name}-name`).focus(); // where it is asked for, it is what is typed next
    });
    $(`${name}-ask`).addEventListener("close", async () => {
      if ($(`${name}-ask`).returnValue !== "yes") return;
      const text = name === "release" ? { note: $("release-note").value } : { reason: $("withdraw-reason").value };
      const by = named ? { name: $(`${name}-name`).value } : {};
      if (named) sign(by.name);
      try {
        await post(`${path(id)}/${name}`, { body: JSON.stringify({ ...text, ...by }), headers: { "Content-Type": "application/json" } });
        announce(name === "release" ? "The programs are released" : "The release is withdrawn");
        $("withdraw-reason").value = $("release-note").value = "";
        await after();
      } catch (error) {
        await after();
        tell(error);
      }
      $(name === "release" ? "withdraw" : "release").focus();
    });
  }
}
