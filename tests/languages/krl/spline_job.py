"""A small job of a KUKA arm in one spline block: a bow of poses 1.5 mm apart, at 40 mm/s."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np

from planner import pipeline
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.proof.prove import Prover
from tests import small_problem

MAIN, MOVES, DATA = "left/small.src", "left/small_1.src", "left/small.dat"
HOME = "      home_deg: [0, 0, 0, 0, 45, 0]\n"


def written(folder, points, path="spline", **controller):
    """The problem file of an arm that passes points (N, 3) [mm]."""
    assert HOME in small_problem.PROBLEM
    fields = ", ".join(f"{key}: {value}" for key, value in {"path": path, **controller}.items())
    text = small_problem.PROBLEM.replace("irb140", "kr10_r1100").replace(HOME, "")
    text = text.replace("stock: {size", f"  controller: {{{fields}}}\nstock: {{size", 1)
    rows = [f"{x:.4f},{y:.4f},{z:.4f},0.5,-0.5,0.5,0.5,40" for x, y, z in points]
    return small_problem.write(folder, text, "\n".join([small_problem.COLUMNS, *rows]) + "\n")


def bow(count=81):
    """Points (N, 3) [mm] of the path."""
    turn = np.linspace(-0.5, 0.5, count)
    return np.stack([540 + 120 * (1 - np.cos(turn)), 120 * np.sin(turn), 600 + 10 * np.sin(3 * turn)], axis=1)


@functools.cache
def job():
    """(problem, plan, texts, prover) of the job."""
    folder = Path(tempfile.mkdtemp())
    problem = pipeline.load(written(folder, bow()))
    plan = solve.solve(problem, [registry.job(problem, 0).targets()])
    prover = Prover(problem, registry.claims(problem))
    return problem, plan, dict(write.program_files(plan, problem)), prover


def broken(texts):
    """Codes that the proof has against texts."""
    return {issue.code for issue in job()[3].prove(texts, first_error=True).issues}
