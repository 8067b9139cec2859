"""Springback of a rounded pyramid from its mesh: control points of its path, their curves as `tandem
springback` solves them, and how far S between them is from S that is solved there. Then bundled jobs that are
compensated, from file to proof, and how far their released parts are off by shells of another mesh."""

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
from planner.cli.forming import Springback, run_springback
from planner.geometry.arrays import lengths
from planner.geometry.units import MM
from planner.processes import registry
from planner.processes.forming.claims import FormsPart
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.process_plan import lay_all, work
from planner.processes.forming.plan.springback import forecast
from planner.processes.forming.plan.springback.curves import Point, forces, solved
from planner.processes.forming.proof import elastic, springback_file
from planner.processes.forming.proof.shapes import PartShapes, in_order
from tests import small_forming
from tests.processes.forming.plan.shapes import pit

GOAL_CONTROL_S, GOAL_POINTS_S, GOAL_SHARE = 2.0, 180.0, 0.03
PLACES = 20
"""Places of the path at which S is solved as well."""
JOBS = ("cone_spif", "pyramid_steep")
"""Bundled jobs that are compensated from file to proof."""
RELEASED = 8
"""Places of each pass of these at which what is left is worked out, behind its first loop."""


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
    deep = np.flatnonzero(path.point[:, 2] < -1.0 * MM)
    rows = np.random.default_rng(2026).choice(deep, PLACES, replace=False)
    off = []
    for row in rows:
        force = float(forces(made, laid[0][0], path.point[row : row + 1], path.angle[row : row + 1])[0])
        alone = float(solved(made, Point(0, path.point[row], force)).at(force))
        off.append((abs(float(whole.at(path.point[row : row + 1], np.array([force]))[0]) - alone), alone))
    worst = max(gap / alone for gap, alone in off)
    many = np.median(control[0][0].clusters)
    told = f"{len(path.point)} targets, {len(points)} control points, {many:g} a loop"
    table = [
        _row("control points of a pyramid's path", chosen, GOAL_CONTROL_S, told),
        _row(f"{len(points)} curves of five loads", spent, GOAL_POINTS_S, "at most 4,000 triangles each"),
        _row(
            f"S between control points, {PLACES} places",
            worst,
            GOAL_SHARE,
            f"largest share of S off, and {max(gap for gap, _ in off) / MM:.3f} mm",
        ),
    ]
    return [*table, *(row for name in JOBS for row in _compensated(name))]


def _compensated(name: str) -> Iterator[dict[str, Any]]:
    """Rows of a job with its springback file: processor time of all processes [s], errors [mm]."""
    bundled = Path(__file__).parent.parent / "problems"
    with tempfile.TemporaryDirectory() as folder:
        for one in (name, "cells"):
            shutil.copytree(bundled / one, Path(folder) / one)
        path = Path(folder) / name / "problem.yaml"
        begin = _spent()
        run_springback(Springback(path, write=path.with_name("back.json")), planner.load(path))
        written = _spent() - begin
        data = yaml.safe_load(path.read_text())
        data["operations"][0]["springback"] = {"file": "back.json"}
        # below its first pass pyramid_steep is a degree steeper than its metal is known to stand
        data["accept"] = sorted({*data.get("accept", ()), "forming.wall_angle"})
        path.write_text(yaml.safe_dump(data))
        begin = _spent()
        outcome = planner.plan(planner.load(path))
        planned = _spent() - begin
        before, after = _released(outcome.problem, path.with_name("back.json"))
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
    return sum(one.ru_utime + one.ru_stime for one in both)


def _released(problem: Any, path: Path) -> tuple[Any, Any]:
    """What places of a part are off [mm] without the shifts of a file and with them, by the proof's own
    shells of many points."""
    job = next(one for one in registry.jobs(problem) if isinstance(one, FormingJob))
    made, claims, stock = job.planned, job.claims(), job.setup.stock
    shapes = PartShapes(next(one for one in claims if isinstance(one, FormsPart)), in_order(claims))
    metal = made.sheet.metal
    held = elastic.Clamped(
        float(stock.size[2]), metal.young, metal.poisson, made.sheet.opening, made.sheet.border
    )
    ways, off = springback_file.read(path).ways, []
    random = np.random.default_rng(2026)
    for one, laid in lay_all(made):
        feature, number = next(
            (k, n)
            for k, feature in enumerate(shapes.features)
            for n, shape in enumerate(feature.shapes)
            if one.name in [claim.segment.name for claim in shape.claims]
        )
        contact, way = laid.contact, ways[one.name]
        force = forces(made, one, contact.point, contact.angle)
        for row in random.choice(np.flatnonzero(contact.loop > contact.loop[0]), RELEASED, replace=False):
            formed = elastic.Formed(shapes, feature, number, abs(float(contact.point[row, 2]) - one.start))
            place = contact.point[row, :2]
            comes, _ = elastic.comes_back(formed, held, place, float(force[row]), elastic.MANY_POINTS)
            shift = way.shift[lengths(way.point - laid.former[row]).argmin()]
            off.append((comes / MM, abs(comes - shift) / MM))
    both = np.array([pair for pair in off if np.isfinite(pair).all()])
    return both[:, 0], both[:, 1]


def _row(name: str, value: float, goal: float, note: str) -> dict[str, Any]:
    return {"name": name, "median_s": value, "ratio": value / goal, "note": f"{note}; wanted {goal:g}"}
