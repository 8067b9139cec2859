"""Rows of ``test_remedies_of_data`` for motion, on the smallest jobs: one arm and a few poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner import pipeline
from planner.geometry.units import MM
from planner.issues import Issue
from planner.motion import homing
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import PathResult, search_graph
from planner.motion.search.reach import sample_freedoms
from planner.motion.solve import check as check_motion
from planner.motion.solve import solve
from planner.motion.trajectory import move_limits
from planner.problem import Settings
from planner.processes import registry
from tests import small_problem
from tests.motion.scenes import HIGH, arc_wire, box, pair, problem, s_curve, two_arms
from tests.refusals import POSES, change
from tests.remedies.advice import ReportedFigure
from tests.remedies.remedy_rows import Row, Yaml, check, collect_issues, write


def table(poses: Sequence[tuple[float, float, float]], turns: Sequence[float], feed: float = 20.0) -> str:
    """Poses of the small problem at other places [mm], each turned [deg] about the tool's x axis."""
    start = np.array([[float(v) for v in small_problem.ROWS[0].split(",")[3:7]]])
    rows = []
    for (x, y, z), turn in zip(poses, turns, strict=True):
        half = 0.5 * np.deg2rad(turn)
        w, a, b, c = start[0]
        s, t = np.cos(half), np.sin(half)  # the product of quaternions (w, a, b, c) (s, t, 0, 0)
        own = [w * s - a * t, a * s + w * t, b * s + c * t, c * s - b * t]
        rows.append(",".join([f"{x},{y},{z}", *(f"{v:.9f}" for v in own), f"{feed}"]))
    return "\n".join([small_problem.COLUMNS, *rows]) + "\n"


def solve_motion(folder: Path, data: Any) -> list[Issue]:
    """Return the issues of the whole motion, without programs and proof."""

    def work() -> list[Issue]:
        job = pipeline.load(write(folder, data))
        plan = solve(job, pipeline.create_targets(job, registry.jobs(job)))
        return [issue for operation in plan.operations for issue in operation.issues]

    return collect_issues(work)


def enter(folder: Path, data: Any) -> list[Issue]:
    """The ways in of two arms, a crate about where one of them begins."""

    def work() -> list[Issue]:
        scene, targets = pair(20)
        way = search_graph(scene, targets, sample_freedoms(targets))
        assert isinstance(way, PathResult)
        spot = scene.chains["left"].pose(way.q["left"][0])[:3, 3]
        crates = (box("crate", (0.05, 0.05, 0.05), tuple(spot)),) if data["crate"] else ()
        homing.plan_approach_and_retreat(pair(20, crates)[0], targets, way.q)
        return []

    return collect_issues(work)


def fast(folder: Path, data: Any) -> list[Issue]:
    """An S-curve whose least feed is as stated [mm/s]."""
    cell, targets = s_curve(20)
    travel = np.append(0.0, np.linalg.norm(np.diff(targets.pose["arm"][:, :3, 3], axis=0), axis=1))
    feeds = {"feed": np.full(20, 5.0), "feed_min": np.full(20, data["feed_min"] * MM)}
    expected = dataclasses.replace(targets, travel=travel, **feeds)
    scene = Scene.of(cell, expected.arms, HIGH, Settings(tcp_speed=6.0))
    plan = collect_issues(lambda: plan_operation("fast", scene, expected, cell.controller).issues)
    return [issue for issue in plan if issue.code == "motion.feed_min"]


def short(folder: Path, data: Any) -> list[Issue]:
    """Return the issues of the moves of an S-curve at a feed [mm/s]."""
    _, targets = s_curve(data["count"])
    travel = np.append(0.0, np.linalg.norm(np.diff(targets.pose["arm"][:, :3, 3], axis=0), axis=1))
    targets = dataclasses.replace(targets, travel=travel)
    time = np.cumsum(travel) / (data["feed"] * MM)
    return list(move_limits.short_move_warnings(targets, targets.neutral_values(), time))


def find_placement(folder: Path, data: Any) -> list[Issue]:
    """Search a placement between two arms at the given distance [m]; return the issues."""
    few = arc_wire(16)
    return collect_issues(lambda: check_motion(problem(two_arms(data["apart"]), few, None), [few]))


HAND: Final = {
    "name": "crate",
    "shapes": [{"kind": "box", "size_mm": [100, 100, 100], "pose": {"xyz_mm": [0, 580, 580]}}],
}
MARGINS: Final = {field: change(POSES, f"settings.{field}", 45) for field in
    ("joint_margin_deg", "singularity_margin_deg")}  # fmt: skip
LINE: Final = [(450.0, y, 500.0) for y in np.linspace(-50, 50, 16)]
TURNING: Final = table(LINE, np.linspace(0.0, 900.0, 16))
SPIN: Final = {"name": "spin", "arms": ["left"], "axis": "x", "turn_deg": [-180, 180]}
ZIGZAG: Final = table([(450, 10.0 * i - 70.0, 500 + 20.0 * (i % 2)) for i in range(15)], [0.0] * 15, 200.0)

ASIDE: Final = change(POSES, "cell.arms.0.home_deg", [90, 0, 0, 0, 45, 0])
WAVE: Final = np.linspace(0.0, 14.0, 15 * 12)
ROUND: Final = table(
    [(450, 10.0 * t - 70.0, 510 - 10.0 * np.cos(np.pi * t)) for t in WAVE], 0.0 * WAVE, 200.0
)

SUNK: Final = {
    "name": "table",
    "shapes": [{"kind": "box", "size_mm": [300, 300, 60], "pose": {"xyz_mm": [450, 0, -20]}}],
}
FAST_ROWS: Final = [
    Row("motion.overlap", check, change(POSES, "cell.obstacles", [SUNK]), "move the stock by",
        {"stock.place.xyz_mm.2": ReportedFigure("move the stock by (0, 0, #) mm", more=True)}),
    Row("motion.home", check, change(ASIDE, "cell.obstacles", [HAND]), "set home_deg",
        {"cell.arms.0.home_deg": Yaml("set home_deg (\\[.*?\\])")}),
    Row("motion.joint_limit", check, MARGINS["joint_margin_deg"], "settings.joint_margin_deg",
        {"settings.joint_margin_deg": ReportedFigure("joint_margin_deg: #", 0.1, down=True)}),
    Row("motion.singular", check, MARGINS["singularity_margin_deg"], "move the base of arm left",
        {"cell.arms.0.base": {"xyz_mm": [ReportedFigure("move the base of arm left by # mm in x"), 0, 0]}}),
    Row("motion.no_path", check, POSES, "give the targets more freedom", {"operations.0.free": [SPIN]},
        {"targets.csv": TURNING}),
    Row("motion.stops", solve_motion, POSES, "round these corners over more targets", {"@targets.csv": ROUND},
        {"targets.csv": ZIGZAG}),
    Row("motion.entry", enter, {"crate": True}, "remove the obstacle", {"crate": False}),
    Row("motion.feed_min", fast, {"feed_min": 4000.0}, "lower feed_min",
        {"feed_min": ReportedFigure("runs at # mm/s", down=True)}),
    Row("motion.short_moves", short, {"count": 100, "feed": 500.0}, "lower the feed there",
        {"feed": ReportedFigure("lower the feed there to # mm/s", 0.01)}),
    Row("motion.short_moves", short, {"count": 20_000, "feed": 5.0}, "a coarser tolerance or path",
        {"count": 100}),
]  # fmt: skip
LONG: Final = [
    Row("motion.no_placement", find_placement, {"apart": 6.0}, "move the bases closer", {"apart": 1.8}),
]  # fmt: skip
ROWS: Final = [*FAST_ROWS, *(dataclasses.replace(row, long=True) for row in LONG)]
