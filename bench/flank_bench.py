"""The flank job of about 1,000 targets: from file to verified programs in a fresh process on one core.

Time by stages, and its gouge check compared with one that checks all places of a face against all places of
the path. The package's byte code exists before the clock starts, as pip leaves it.
"""

from __future__ import annotations

import compileall
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

import planner

GOAL_S = 10.0
STEP_MM = 5.1
"""Distance [mm] of targets at which the four walls of the bundled job need about 1,000 targets."""
PROBLEM = Path(__file__).parent.parent / "problems" / "flank_wall" / "problem.yaml"
LIBRARIES = "pydrake.planning, pydrake.multibody.parsing, scipy.optimize, scipy.ndimage, trimesh, shapely"
"""Third-party libraries that every part of the start loads."""
SAMPLE = 60
"""One in this many places of a face is compared with the whole path."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_Result = TypeVar("_Result")


def run() -> list[dict[str, Any]]:
    """Return rows of processor time [s]: the whole command, and each stage with its peer."""
    compileall.compile_dir(str(Path(planner.__file__).parent), quiet=1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = job(folder)
        peer = _spent([sys.executable, "-c", f"import {LIBRARIES}"])[0]
        command = [sys.executable, "-m", "planner", "plan", str(path), "-o", str(folder / "out")]
        took, wall, done = _spent(command)
        told = [line for line in done.stdout.splitlines() if "targets" in line]
        note = f"{'proven' if done.returncode == 0 else 'NOT proven'}, {told[-1] if told else 'no plan'}; "
        note += f"processor time, {wall:.1f} s by the wall; ratio is to the goal of {GOAL_S:g} s"
        whole = {
            "name": "flank job: tandem plan, cold",
            "median_s": took,
            "ratio": took / GOAL_S,
            "note": note,
        }
        stage = [sys.executable, "-m", "bench.flank_bench", str(path), str(folder / "saved")]
        rows: list[dict[str, Any]] = json.loads(_spent(stage)[2].stdout.splitlines()[-1])
        rows[0] |= {"ratio": rows[0]["median_s"] / peer, "note": f"its libraries alone: {peer:.2f} s"}
        return [whole, *rows]


def job(folder: Path) -> Path:
    """The bundled job with another distance of targets, written to ``folder``."""
    data = yaml.safe_load(PROBLEM.read_text())
    data["cell"] = str((PROBLEM.parent / data["cell"]).resolve())
    data["operations"][0]["step_mm"] = STEP_MM
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def stages(path: str, folder: str) -> list[dict[str, Any]]:
    """Rows of processor time of each stage, run in this process, which has imported nothing of it before."""
    rows: list[dict[str, Any]] = []

    def time_stage(what: str, work: Callable[[], _Result]) -> _Result:
        start = time.process_time()
        made = work()
        rows.append({"name": f"flank job: {what}", "median_s": time.process_time() - start})
        return made

    def load() -> None:
        from planner import pipeline  # noqa: F401

    time_stage("start-up", load)
    from planner import pipeline
    from planner.languages.writing import write
    from planner.motion import solve
    from planner.processes import registry
    from planner.processes.milling.plan.process_plan import plan_milling

    problem = time_stage("problem file", lambda: pipeline.load(path))
    targets = time_stage("targets", lambda: [registry.job(problem, 0).targets()])
    plan = time_stage("motion", lambda: solve.solve(problem, targets, lambda stage, fraction: None))
    programs = time_stage("programs", lambda: write.program_files(plan, problem))
    proof = time_stage("proof", lambda: pipeline.verify(problem, programs))
    took = time.process_time()
    note = f"all of these in one process; ratio is to the goal of {GOAL_S:g} s"
    whole = {"name": "flank job: file to proven programs, cold", "median_s": took, "ratio": took / GOAL_S}
    rows.append({**whole, "note": note})
    outcome = pipeline.Outcome(problem, plan, proof, programs)
    time_stage("report, replay and files", lambda: outcome.save(folder))
    made = plan_milling(problem.operations[0], problem.setup_of(0), problem.part)
    return [*rows, _against_all(made)]


def _against_all(plan: Any) -> dict[str, Any]:
    """The cutter along the last pass of the first wall, against places of the wall."""
    from planner.geometry.mesh import bisect_triangles
    from planner.processes.milling.plan import check as milling_check

    face, path = plan.faces[0].mesh, plan.cuts[0].runs[-1].path
    points = bisect_triangles(face.vertices[face.faces], 2e-3, 200_000)[0].mean(axis=1)
    section = milling_check.sections(plan.cutter)[0]
    start = time.process_time()
    result, _ = milling_check.path_distance(points, path.tip, path.axis, section)
    took = time.process_time() - start
    start = time.process_time()
    tips, axes, _ = milling_check.subdivide_moves(
        path.tip, path.axis, section.end, milling_check.PATH_SPACING_FACTOR * section.radius
    )
    worst = 0.0
    for i in range(0, len(points), SAMPLE):
        rest = points[i] - tips
        back = np.einsum("nd,nd->n", rest, axes)
        beside = np.linalg.norm(rest - back[:, None] * axes, axis=1)
        all_of_them = min(
            float(section.signed_distance(back, beside).min()), milling_check.MAX_QUERY_DISTANCE_M
        )
        worst = max(worst, abs(all_of_them - float(result[i])))
    peer = (time.process_time() - start) * SAMPLE
    note = f"{len(points)} places; against all {len(tips)} places of the path: {peer:.1f} s (one in {SAMPLE} "
    note += f"held), {1e6 * worst:.3f} um apart"
    return {
        "name": "flank job: one pass against its wall",
        "median_s": took,
        "ratio": took / peer,
        "note": note,
    }


def _spent(command: list[str]) -> tuple[float, float, subprocess.CompletedProcess[str]]:
    """Processor time and wall time [s] of a process on one core."""
    one = {**os.environ, **dict.fromkeys(_THREADS, "1")}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, env=one, check=False)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, wall, done


if __name__ == "__main__":
    print(json.dumps(stages(sys.argv[1], sys.argv[2])))
