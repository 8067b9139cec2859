"""Writing of RAPID programs: 100,000 moves for each of two robots, beside plain formatting of numbers."""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from planner.post.write import programs
from tests.post import synthetic

MOVES = 100_000
REPEATS = 3


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    count = MOVES + 1
    labels = ["mount", *(f"{'link' if i // 2500 % 2 else 'cut/a'}" for i in range(MOVES))]
    problem = synthetic.problem()
    q = {"left": synthetic.sweep(count, 3.0), "right": synthetic.sweep(count, 3.0)}
    stops = range(2500, count, 2500)
    plan = synthetic.plan(synthetic.operation(problem, q, labels, stop=stops, actions=()))
    rows = np.random.default_rng(0).uniform(-999.0, 999.0, (2 * MOVES, 7)).tolist()
    spans, peers = [], []
    for _ in range(REPEATS):
        start = time.perf_counter()
        files = programs(plan, problem)
        spans.append(time.perf_counter() - start)
        start = time.perf_counter()
        for row in rows:
            ",".join(format(value, ".8f") for value in row)
        peers.append(time.perf_counter() - start)
    size = sum(len(text) for text in files.values())
    median = statistics.median(spans)
    note = (
        f"{len(files)} files, {size / 1e6:.0f} MB; goal 10 s a robot; peer: seven numbers a move by format()"
    )
    return [
        {
            "name": f"RAPID, 2 x {MOVES} moves",
            "median_s": median,
            "spread": max(spans) - min(spans),
            "ratio": median / statistics.median(peers),
            "note": note,
        }
    ]
