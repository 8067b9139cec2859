"""Springback of a rounded pyramid from its mesh, and bundled jobs with compensation.

Control points of its path, their curves as `tandem springback` solves them, and the difference between the
interpolated S and the S that is solved at the point. Then bundled jobs that are compensated, from file to
proof, and the deviation of their released parts by shells of another mesh.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import yaml

import planner
from planner import pipeline
from planner.cli.forming import SpringbackCommand, run_springback
from planner.geometry.arrays import lengths
from planner.geometry.units import MM
from planner.processes import registry
from planner.processes.forming.claims import FormsPart
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.process_plan import make_tool_paths, prepare_work
from planner.processes.forming.plan.springback import forecast
from planner.processes.forming.plan.springback.curves import SpringbackPoint, sheet_forces, solve_curve
from planner.processes.forming.proof import elastic_sheet, springback_file
from planner.processes.forming.proof.formed_shapes import PartShapes, ordered_passes
from tests import small_forming
from tests.processes.forming.plan.shapes import pit

GOAL_CONTROL_S, GOAL_POINTS_S, GOAL_SHARE = 2.0, 180.0, 0.03
CHECK_POINTS = 20
"""Number of path points at which S is solved as well."""
JOBS = ("cone_spif", "pyramid_steep")
"""Bundled jobs that are compensated from file to proof."""
RELEASED = 8
"""Number of points of each pass at which the remaining error is computed, after the first loop."""


def run() -> list[dict[str, Any]]:
    """Rows of processor time [s] and of the largest difference of S."""
    outline = shapely.box(-0.015, -0.015, 0.015, 0.015).buffer(0.025, quad_segs=24)
    data = small_forming.problem("spif", stepdown_mm=0.2, longest_mm=2.0)
    data["sheet"] |= {"size_mm": [320, 320], "metal": "aa5754_o", "opening_mm": [250, 250]}
    with tempfile.TemporaryDirectory() as folder:
        result = pipeline.load(small_forming.write(Path(folder), data, pit(outline, 45.0, 0.015)))
        made = prepare_work(result.operations[0], result.setups[0], result.part)  # type: ignore[arg-type]
        laid = make_tool_paths(made)
    start_s = time.process_time()
    control = forecast.forecast_points(made, laid)
    chosen = time.process_time() - start_s
    points = control[0][1]
    start_s = time.process_time()
    curves = list(forecast.solve_curves(made, points))
    spent = time.process_time() - start_s
    whole = forecast.make_forecast(laid, control, curves)[0]
    path = laid[0][1].contact
    deep = np.flatnonzero(path.point[:, 2] < -1.0 * MM)
    rows = np.random.default_rng(2026).choice(deep, CHECK_POINTS, replace=False)
    deviations = []
    for row in rows:
        force = float(sheet_forces(made, laid[0][0], path.point[row : row + 1], path.angle[row : row + 1])[0])
        alone = float(solve_curve(made, SpringbackPoint(0, path.point[row], force)).at(force))
        deviations.append(
            (abs(float(whole.at(path.point[row : row + 1], np.array([force]))[0]) - alone), alone)
        )
    worst = max(gap / alone for gap, alone in deviations)
    many = np.median(control[0][0].clusters)
    note = f"{len(path.point)} targets, {len(points)} control points, {many:g} a loop"
    table = [
        _row("control points of a pyramid's path", chosen, GOAL_CONTROL_S, note),
        _row(f"{len(points)} curves of five loads", spent, GOAL_POINTS_S, "at most 4,000 triangles each"),
        _row(
            f"S between control points, {CHECK_POINTS} places",
            worst,
            GOAL_SHARE,
            f"largest share of S off, and {max(gap for gap, _ in deviations) / MM:.3f} mm",
        ),
    ]
    return [*table, *(row for name in JOBS for row in _compensation_rows(name))]


def _compensation_rows(name: str) -> Iterator[dict[str, Any]]:
    """Rows of a job with its springback file: processor time of all processes [s], errors [mm]."""
    bundled = Path(__file__).parent.parent / "problems"
    with tempfile.TemporaryDirectory() as folder:
        for item in (name, "cells"):
            shutil.copytree(bundled / item, Path(folder) / item)
        path = Path(folder) / name / "problem.yaml"
        begin = _spent()
        run_springback(SpringbackCommand(path, write=path.with_name("back.json")), planner.load(path))
        written = _spent() - begin
        data = yaml.safe_load(path.read_text())
        data["operations"][0]["springback"] = {"file": "back.json"}
        # below its first pass pyramid_steep is a degree steeper than its metal is known to stand
        data["accept"] = sorted({*data.get("accept", ()), "forming.wall_angle"})
        path.write_text(yaml.safe_dump(data))
        begin = _spent()
        outcome = planner.plan(planner.load(path))
        planned = _spent() - begin
        before, after = _deviations_with_and_without(outcome.problem, path.with_name("back.json"))
    said = "proven" if outcome.verified else "NOT proven"
    yield {"name": f"{name}: springback --write", "median_s": written, "note": "processor time"}
    yield {"name": f"{name}: plan and proof with the file", "median_s": planned, "note": said}
    yield {
        "name": f"{name}: released part off at most, mm",
        "median_s": float(after.max()),
        "ratio": float(after.max() / before.max()),
        "note": f"{float(before.max()):.3f} mm without the file; mean {float(after.mean()):.3f} of "
        f"{float(before.mean()):.3f} mm, {len(after)} places",
    }


def _spent() -> float:
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(item.ru_utime + item.ru_stime for item in both)


def _deviations_with_and_without(problem: Any, path: Path) -> tuple[Any, Any]:
    """Return deviations [mm] of points of a part without and with the shifts of a file.

    They are computed by the proof's own shells of many points.
    """
    job = next(item for item in registry.jobs(problem) if isinstance(item, FormingJob))
    made, claims, stock = job.planned, job.claims(), job.setup.stock
    shapes = PartShapes(next(item for item in claims if isinstance(item, FormsPart)), ordered_passes(claims))
    metal = made.sheet.metal
    held = elastic_sheet.ClampedSheet(
        float(stock.size[2]), metal.young, metal.poisson, made.sheet.opening, made.sheet.border
    )
    ways, off = springback_file.read_springback_data(path).paths, []
    random = np.random.default_rng(2026)
    for item, laid in make_tool_paths(made):
        feature, number = next(
            (k, n)
            for k, feature in enumerate(shapes.features)
            for n, shape in enumerate(feature.shapes)
            if item.name in [claim.segment.name for claim in shape.claims]
        )
        contact, way = laid.contact, ways[item.name]
        force = sheet_forces(made, item, contact.point, contact.angle)
        for row in random.choice(np.flatnonzero(contact.loop > contact.loop[0]), RELEASED, replace=False):
            formed = elastic_sheet.PartlyFormedSheet(
                shapes, feature, number, abs(float(contact.point[row, 2]) - item.start)
            )
            place = contact.point[row, :2]
            comes, _ = elastic_sheet.springback_at(
                formed, held, place, float(force[row]), elastic_sheet.MAX_POINTS_FINER
            )
            shift = way.shift[lengths(way.point - laid.forming_centre[row]).argmin()]
            off.append((comes / MM, abs(comes - shift) / MM))
    both = np.array([pair for pair in off if np.isfinite(pair).all()])
    return both[:, 0], both[:, 1]


def _row(name: str, value: float, goal: float, note: str) -> dict[str, Any]:
    return {"name": name, "median_s": value, "ratio": value / goal, "note": f"{note}; wanted {goal:g}"}
