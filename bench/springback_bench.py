"""Springback of a rounded pyramid from its mesh: control points of its path, their curves as `tandem
springback` solves them, and how far S between them is from S that is solved there."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from planner import pipeline
from planner.forming.process_plan import lay_all, work
from planner.forming.springback import forecast
from planner.forming.springback.curves import Point, forces, solved
from planner.geometry.units import MM
from tests import small_forming
from tests.forming.shapes import pit

GOAL_CONTROL_S, GOAL_POINTS_S, GOAL_SHARE = 2.0, 180.0, 0.03
PLACES = 20
"""Places of the path at which S is solved as well."""


def run() -> list[dict[str, Any]]:
    """Rows of processor time [s] and of the largest difference of S."""
    outline = shapely.box(-0.015, -0.015, 0.015, 0.015).buffer(0.025, quad_segs=24)
    data = small_forming.problem("spif", stepdown_mm=0.2, longest_mm=2.0)
    data["sheet"] |= {"size_mm": [320, 320], "metal": "aa5754_o", "opening_mm": [250, 250]}
    with tempfile.TemporaryDirectory() as folder:
        found = pipeline.load(small_forming.write(Path(folder), data, pit(outline, 45.0, 0.015)))
        made = work(found.operations[0], found.setups[0], found.part)  # type: ignore[arg-type]
        laid = lay_all(made)
    begin = time.process_time()
    control = forecast.points(made, laid)
    chosen = time.process_time() - begin
    points = control[0][1]
    begin = time.process_time()
    curves = list(forecast.curves(made, points))
    spent = time.process_time() - begin
    whole = forecast.forecast(laid, control, curves)[0]
    path = laid[0][1].contact
    radius = made.heads[made.former(laid[0][0])].radius
    deep = np.flatnonzero(path.point[:, 2] < -1.0 * MM)
    rows = np.random.default_rng(2026).choice(deep, PLACES, replace=False)
    off = []
    for row in rows:
        force = float(forces(made, radius, path.angle[row : row + 1])[0])
        alone = float(solved(made, Point(0, path.point[row], force)).at(force))
        off.append((abs(float(whole.at(path.point[row : row + 1])[0]) - alone), alone))
    worst = max(gap / alone for gap, alone in off)
    many = np.median(control[0][0].clusters)
    told = f"{len(path.point)} targets, {len(points)} control points, {many:g} a loop"
    return [
        _row("control points of a pyramid's path", chosen, GOAL_CONTROL_S, told),
        _row(f"{len(points)} curves of five loads", spent, GOAL_POINTS_S, "at most 4,000 triangles each"),
        _row(
            f"S between control points, {PLACES} places",
            worst,
            GOAL_SHARE,
            f"largest share of S off, and {max(gap for gap, _ in off) / MM:.3f} mm",
        ),
    ]


def _row(name: str, value: float, goal: float, note: str) -> dict[str, Any]:
    return {"name": name, "median_s": value, "ratio": value / goal, "note": f"{note}; wanted {goal:g}"}
