"""The 60 degree cone, with one controller and with two.

Wall time of the whole command, with the memory of both its processes; processor time and peak memory of each
stage from mesh to verified programs on one core; and the proof's clearance compared with one that measures
every sample.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bench.proc import ONE_THREAD, memory, run_plan
from planner import pipeline
from planner.cell import clearance
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.proof.clearance.samples import clearance_samples
from planner.proof.context import Context
from planner.proof.models import MODELS
from planner.proof.prove import Prover
from planner.proof.rules.clearance import MIN_QUERY_RANGE_M

JOBS = ("cone_dpif_l", "cone_dpif_p")
GOAL_S, GOAL_MB = {"cone_dpif_l": 60.0, "cone_dpif_p": 90.0}, 1000.0
"""Target wall time [s] of whole commands on two cores, by the job, and peak memory [MB].

The memory is that of the larger of a command's processes.
"""
MAX_PEER_SAMPLES = 4000
"""Samples, spread over the job, at which bounds and measured distances are compared."""
_Result = TypeVar("_Result")


def run() -> list[dict[str, Any]]:
    """Rows of wall time [s] of whole commands, and of processor time [s] by stage, of fresh processes, with
    their peak memory as a note."""
    rows: list[dict[str, Any]] = []
    for name in JOBS:
        rows.append(whole(name))
        command = [sys.executable, "-m", "bench.cone_bench", name]
        one = {**os.environ, **ONE_THREAD}
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=one)
        rows += json.loads(done.stdout.splitlines()[-1])
    return rows


def whole(name: str) -> dict[str, Any]:
    """A row of ``tandem plan``, cold, with its second process."""
    with tempfile.TemporaryDirectory() as folder:
        ran = run_plan(name, f"{folder}/out")
    note = f"{ran.note}; ratio is to the goal of {GOAL_S[name]:g} s, {GOAL_MB:g} MB are wanted"
    return {
        "name": f"{name}: whole command",
        "median_s": ran.wall,
        "ratio": ran.wall / GOAL_S[name],
        "note": note,
    }


def stages(name: str) -> list[dict[str, Any]]:
    """Rows of one job, run in this process."""
    rows: list[dict[str, Any]] = []

    def time_stage(what: str, work: Callable[[], _Result]) -> _Result:
        _forget_peak()
        start = time.process_time()
        made = work()
        took = time.process_time() - start
        peak = memory("VmHWM")
        note = f"processor time; peak memory {peak:.0f} MB"
        rows.append({"name": f"{name}: {what}", "median_s": took, "peak_mb": peak, "note": note})
        return made

    problem = pipeline.load(name)
    targets = time_stage("targets", lambda: [registry.job(problem, 0).targets()])
    plan = time_stage("motion", lambda: solve.solve(problem, targets, lambda stage, fraction: None))
    programs = time_stage("programs", lambda: write.program_files(plan, problem))
    claims = registry.claims(problem)
    prover = Prover(problem, claims)
    proof = time_stage("proof", lambda: prover.prove(programs))
    took, most = sum(row["median_s"] for row in rows), max(row["peak_mb"] for row in rows)
    told = f"{targets[0].count} targets, {'proven' if proof.ok else 'NOT proven'}, {most:.0f} MB"
    total = {"name": f"{name}: mesh to programs, one core", "median_s": took, "note": told}
    return [*rows, total, _against_all(name, Context(problem, claims, programs))]


def _against_all(name: str, context: Context) -> dict[str, Any]:
    """Bounds of some looks, with the time of measuring all of them as the peer."""
    rows = clearance_samples(context, 0)
    rows = rows[np.linspace(0, len(rows) - 1, MAX_PEER_SAMPLES).astype(np.int64)]
    model, q = context.get(MODELS)(0), {arm: q[rows] for arm, q in context.motion.q.items()}
    start = time.process_time()
    clearance.distance_lower_bound(model, q, MIN_QUERY_RANGE_M)
    middle = time.process_time()
    clearance.min_clearance(model, q, MIN_QUERY_RANGE_M)
    end = time.process_time()
    took, peer = middle - start, end - middle
    note = f"{MAX_PEER_SAMPLES} looks; all of them measured: {peer:.2f} s"
    return {"name": f"{name}: clearance by bounds", "median_s": took, "ratio": took / peer, "note": note}


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


if __name__ == "__main__":
    print(json.dumps(stages(sys.argv[1])))
