"""Writing of programs, compared with plain formatting of numbers.

100,000 moves by RAPID for each of two robots, and for one by RAPID and by KRL.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from planner.languages.writing.write import program_files
from planner.plans import Plan
from planner.problem import Problem
from tests.languages.writing import krl_job, synthetic

MOVES = 100_000
REPEATS = 3


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    count = MOVES + 1
    labels = ["mount", *(f"{'link' if i // 2500 % 2 else 'cut/a'}" for i in range(MOVES))]
    stops = range(2500, count, 2500)
    problem = synthetic.problem()
    q = {"left": synthetic.sweep(count, 3.0), "right": synthetic.sweep(count, 3.0)}
    both = synthetic.plan(synthetic.operation(problem, q, labels, stop=stops, actions=()))
    rows = [_row("RAPID", both, problem, "goal 10 s a robot")]
    for model, language in (("irb140", "RAPID"), ("kr10_r1100", "KRL")):
        start = krl_job.START if language == "KRL" else synthetic.START
        joints = synthetic.sweep(count, 3.0, start)
        plan, job = krl_job.alone(model, q=joints, labels=labels, stop=stops, actions=())
        rows.append(_row(language, plan, job, "goal 5 s"))
    return rows


def _row(language: str, plan: Plan, problem: Problem, goal: str) -> dict[str, Any]:
    robots = len(plan.operations[0].q)
    rows = np.random.default_rng(0).uniform(-999.0, 999.0, (robots * MOVES, 7)).tolist()
    spans, peers = [], []
    for _ in range(REPEATS):
        start = time.perf_counter()
        files = program_files(plan, problem)
        spans.append(time.perf_counter() - start)
        start = time.perf_counter()
        for row in rows:
            ",".join(format(value, ".8f") for value in row)
        peers.append(time.perf_counter() - start)
    size = sum(len(text) for text in files.values())
    median = statistics.median(spans)
    model = problem.cell.arms[0].robot
    note = f"{len(files)} files, {size / 1e6:.0f} MB; {goal}; peer: seven numbers a move by format()"
    return {
        "name": f"{language}, {model}, {robots} x {MOVES} moves",
        "median_s": median,
        "spread": max(spans) - min(spans),
        "ratio": median / statistics.median(peers),
        "note": note,
    }
