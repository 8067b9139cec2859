"""The 60 degree cone, with one controller and with two: the whole command by the wall, with the memory of
both its processes; processor time and peak memory of each stage from mesh to verified programs on one core;
and the proof's clearance beside one that measures every look.
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

from bench.proc import ONE_THREAD, memory, planned
from planner import pipeline
from planner.cell import clearance
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.proof.clearance.samples import clearance_rows
from planner.proof.context import Context
from planner.proof.models import MODELS
from planner.proof.prove import Prover
from planner.proof.rules.clearance import MEASURED_REACH

JOBS = ("cone_dpif_l", "cone_dpif_p")
GOAL_S, GOAL_MB = {"cone_dpif_l": 60.0, "cone_dpif_p": 90.0}, 1000.0
"""Wanted wall time [s] of whole commands on two cores, by the job, and peak memory [MB] of the larger of a
command's processes."""
LOOKS = 4000
"""Looks, spread over the job, at which bounds and measured distances are compared."""
_Made = TypeVar("_Made")


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
        ran = planned(name, f"{folder}/out")
    told = f"{ran.told}; ratio is to the goal of {GOAL_S[name]:g} s, {GOAL_MB:g} MB are wanted"
    return {
        "name": f"{name}: whole command",
        "median_s": ran.wall,
        "ratio": ran.wall / GOAL_S[name],
        "note": told,
    }


def stages(name: str) -> list[dict[str, Any]]:
    """Rows of one job, run in this process."""
    rows: list[dict[str, Any]] = []

    def timed(what: str, work: Callable[[], _Made]) -> _Made:
        _forget_peak()
        start = time.process_time()
        made = work()
        took = time.process_time() - start
        peak = memory("VmHWM")
        note = f"processor time; peak memory {peak:.0f} MB"
        rows.append({"name": f"{name}: {what}", "median_s": took, "peak_mb": peak, "note": note})
        return made

    problem = pipeline.load(name)
    targets = timed("targets", lambda: [registry.job(problem, 0).targets()])
    plan = timed("motion", lambda: solve.solve(problem, targets, lambda stage, share: None))
    programs = timed("programs", lambda: write.programs(plan, problem))
    claims = registry.claims(problem)
    prover = Prover(problem, claims)
    proof = timed("proof", lambda: prover.prove(programs))
    took, most = sum(row["median_s"] for row in rows), max(row["peak_mb"] for row in rows)
    told = f"{targets[0].count} targets, {'proven' if proof.ok else 'NOT proven'}, {most:.0f} MB"
    total = {"name": f"{name}: mesh to programs, one core", "median_s": took, "note": told}
    return [*rows, total, _against_all(name, Context(problem, claims, programs))]


def _against_all(name: str, context: Context) -> dict[str, Any]:
    """Bounds of some looks, with the time of measuring all of them as the peer."""
    rows = clearance_rows(context, 0)
    rows = rows[np.linspace(0, len(rows) - 1, LOOKS).astype(np.int64)]
    model, q = context.get(MODELS)(0), {arm: q[rows] for arm, q in context.motion.q.items()}
    start = time.process_time()
    clearance.at_least(model, q, MEASURED_REACH)
    middle = time.process_time()
    clearance.least(model, q, MEASURED_REACH)
    end = time.process_time()
    took, peer = middle - start, end - middle
    note = f"{LOOKS} looks; all of them measured: {peer:.2f} s"
    return {"name": f"{name}: clearance by bounds", "median_s": took, "ratio": took / peer, "note": note}


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


if __name__ == "__main__":
    print(json.dumps(stages(sys.argv[1])))
