// What a job has taken, and what it may still take by like ones; times of the service, counted on by this page's own clock.
import { job as path, json } from "./api.js";
import { $, show } from "./dom.js";
import { duration, isOpen } from "./words.js";

const EVERY_MS = 5000;

export class Estimate {
  constructor(id, job) {
    Object.assign(this, { id, job, found: null, at: 0, timer: 0 });
  }

  // Follows the job for as long as it waits or runs.
  async follow() {
    clearTimeout(this.timer);
    const open = isOpen(this.job()?.state);
    show($("estimate"), open && Boolean(this.found));
    if (!open) return;
    if (!this.found || performance.now() - this.at > EVERY_MS) {
      const found = await json(`${path(this.id)}/estimate`).catch(() => null); // who loses the connection is told elsewhere
      if (found) Object.assign(this, { found, at: performance.now() });
    }
    this.draw();
    this.timer = setTimeout(() => this.follow(), 1000);
  }

  draw() {
    if (!this.found) return;
    const { elapsed_s: elapsed, left_s: left, whole_s: whole, like } = this.found;
    const since = (performance.now() - this.at) / 1000;
    const by = like && `from ${like === 1 ? "one similar job" : `${like} similar jobs`}`;
    const said = [];
    if (elapsed !== undefined) said.push(`${whole_seconds(elapsed + since)} so far`);
    if (left !== undefined) said.push(left - since > 1 ? `about ${whole_seconds(left - since)} left, estimated ${by}` : `longer than the ${like} similar job${like > 1 ? "s" : ""} took, no estimate of the remaining time`);
    else if (whole !== undefined) said.push(`about ${whole_seconds(whole)} after its start, estimated ${by}`);
    else said.push("no estimate, because no similar job was proven yet");
    $("estimate").textContent = `${said.join("; ")}.`;
    show($("estimate"), true);
  }
}

const whole_seconds = (seconds) => duration(seconds < 90 ? Math.round(seconds) : seconds).replace(/\.0 s$/, " s").replace(/^0 ms$/, "0 s");
