"""The cell: clearance of two arms with tools, stock and floor, per configuration, against Drake's checker."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import yaml

from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import FloatArray, from_rpy
from planner.problem import Stock
from planner.reading import cell as cell_file

SEED = 20
COUNT = 2000
BLOCK = Stock(np.array([0.17, 0.70, 0.10]), None, np.eye(3))


def run() -> list[dict[str, Any]]:
    """Rows with name, median_s, spread (p90 - p10), ratio (peer's median over ours), note; times per
    configuration."""
    path = robots.data_dir("problems") / "cells" / "two_irb140_facing.yaml"
    spec = cell_file.CellFile.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    cell = cell_file.build_cell(spec, path.parent)
    stock_pose = from_rpy((0.0, 0.0, 0.55), (0.0, 0.0, 0.0))
    rows = [
        _row(
            "build of a cell", _times(lambda: plant.build_cell_model(cell, BLOCK, stock_pose), 5, 1), None, ""
        )
    ]
    model = plant.build_cell_model(cell, BLOCK, stock_pose)
    robot = model.robots["left"]
    rows.append(
        _row(
            "forward kinematics",
            _times(lambda: forward_kinematics(robot, _wide(model, 1.0)["left"]), 5, COUNT),
            None,
            "",
        )
    )
    for name, width in (("near home", 0.4), ("anywhere", 2.0)):
        q = _wide(model, width)
        fraction = clearance.is_free(model, q, 0.010).mean()
        ours = _times(lambda q=q: clearance.is_free(model, q, 0.010), 5, COUNT)
        peer = _times(lambda q=q: _drake(model, q), 3, COUNT)
        note = f"10 mm, {fraction:.0%} free, peer: Drake's checker alone on the same"
        rows.append(_row(f"free, two arms {name}", ours, peer, note))
    q = {arm: v[:437] for arm, v in _wide(model, 0.4).items()}
    rows.append(
        _row(
            "least distance within 0.1 m",
            _times(lambda: clearance.min_clearance(model, q, 0.1), 5, 437),
            None,
            "",
        )
    )
    rows.append(
        _row(
            "least distance within 20 mm",
            _times(lambda: clearance.min_clearance(model, q, 0.02), 5, 437),
            None,
            "",
        )
    )
    row = model.stack_rows(q)
    each = _times(lambda: [clearance.distance_gradients(model, r, 0.03) for r in row[:50]], 5, 50)
    rows.append(_row("distances and gradients within 30 mm", each, None, ""))
    edge = clearance.FlexibleEdge(_wire(model, q), radius=1e-3, skip_ends=0.03)
    rows.append(
        _row("edge of 40 points", _times(lambda: clearance.edge_clearance(model, q, edge), 5, 437), None, "")
    )
    poses = [from_rpy((0.0, 0.0, 0.5 + 1e-4 * i), (0.0, 0.0, 0.0)) for i in range(50)]
    moved = _times(lambda: [model.with_stock(p).checker for p in poses], 5, 50)
    rows.append(_row("move of the stock", moved, None, "nothing is rebuilt"))
    return rows


def _wide(model: plant.CellModel, width: float) -> dict[str, FloatArray]:
    rng = np.random.default_rng(SEED)
    return {a.name: a.home + rng.uniform(-width, width, (COUNT, 6)) for a in model.cell.arms}


def _drake(model: plant.CellModel, q: Mapping[str, FloatArray]) -> None:
    checker = model.checker
    checker.SetPaddingAllRobotRobotPairs(0.010)
    checker.SetPaddingAllRobotEnvironmentPairs(0.010)
    checker.CheckConfigsCollisionFree(list(model.stack_rows(q)), parallelize=False)
    checker.SetPaddingAllRobotRobotPairs(0.0)
    checker.SetPaddingAllRobotEnvironmentPairs(0.0)


def _wire(model: plant.CellModel, q: Mapping[str, FloatArray]) -> FloatArray:
    tcp = model.tcp(q)
    start, end = tcp["left"][:, None, :3, 3], tcp["right"][:, None, :3, 3]
    return start + np.linspace(0.0, 1.0, 40)[:, None] * (end - start)


def _times(work: Callable[[], object], repeats: int, per: int) -> list[float]:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append((time.perf_counter() - start) / per)
    return times


def _row(name: str, ours: list[float], peer: list[float] | None, note: str) -> dict[str, Any]:
    low, median, high = (float(v) for v in np.percentile(ours, [10, 50, 90]))
    ratio = None if peer is None else float(np.median(peer)) / median
    return {"name": name, "median_s": median, "spread": high - low, "ratio": ratio, "note": note}
