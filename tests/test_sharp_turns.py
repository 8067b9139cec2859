"""Whole jobs whose tools rotate far over a short distance, or stop often.

They are timed as controllers run them, and proven.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import planner
from planner.catalogue import robots
from planner.issues import Severity
from tests import small_problem

CELLS = robots.data_dir("problems") / "cells"
MILLED = """\
tandem: 1
name: turns
cell: CELL
stock: {size_mm: [320, 240, 80], place: PLACE}
settings: {clearance_mm: 8, joint_margin_deg: 5}
accept: [stock.hangs]
operations:
  - name: panel
    process: milling
    arms: [robot]
    shape_tol_mm: TOLERANCE
    cuts: [{gcode: {file: job.nc, origin: {xyz_mm: [0, 0, 80]}, AXIS}}]
"""
ABB = "irb4600_mill", "{xyz_mm: [1300, 0, 800]}"
KUKA = "kr60_engrave", "{xyz_mm: [1350, 0, 700], rpy_deg: [0, 0, 90]}"


def rotated_quaternion(angle: float) -> list[str]:
    """A pose's quaternion, turned about the tool's z by ``angle`` [deg]."""
    h = np.deg2rad(0.5 * angle)
    w, x, y, z = 0.5, -0.5, 0.5, 0.5
    c, s = np.cos(h), np.sin(h)
    return [f"{v:.9f}" for v in (w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s)]


def plan_poses(
    folder: Path, robot: str, rows: list[tuple[float, float, float, float, int]]
) -> planner.Outcome:
    """Rows of y, z [mm], turn [deg], feed [mm/s], stop."""
    scale = {"irb1200_7_70": 1.0, "kr60_ha": 2.4, "irb6640_185": 2.8}[robot]
    lines = [small_problem.COLUMNS + ",stop"]
    for y, z, turn, feed, stop in rows:
        lines.append(
            ",".join(
                [f"{450 * scale}", f"{y}", f"{500 * scale + z}", *rotated_quaternion(turn), f"{feed},{stop}"]
            )
        )
    text = small_problem.PROBLEM.replace("irb140", robot).replace("      home_deg: [0, 0, 0, 0, 45, 0]\n", "")
    return planner.plan(planner.load(small_problem.write(folder, text, "\n".join(lines) + "\n")))


def is_milled(folder: Path, cell: tuple[str, str], tolerance: float, axis: str, lines: list[str]) -> bool:
    text = MILLED.replace("CELL", f"{CELLS / cell[0]}.yaml").replace("PLACE", cell[1])
    (folder / "problem.yaml").write_text(text.replace("TOLERANCE", str(tolerance)).replace("AXIS", axis))
    (folder / "job.nc").write_text("\n".join(["G21 G90 G94 G17", *lines, "G0 Z30", "M5", "M30", ""]))
    return planner.plan(planner.load(folder / "problem.yaml")).verified


def test_a_move_from_stop_to_stop_is_a_cubic(tmp_path: Path) -> None:
    """Its ends ask a wrist for more than a clock that brakes as late as it can."""
    stops = [1, 0, 0, 0, 0, 0, 1, 0, 1, 1]
    rows = [(3.0 * i - 15.0, 0.3 * (i % 2), 10.0 * (i % 2), 20.0, stop) for i, stop in enumerate(stops)]
    assert plan_poses(tmp_path, "irb1200_7_70", rows).verified


def test_corners_count_with_the_speeds_that_moves_get(tmp_path: Path) -> None:
    """Feeds differ by a factor of 40, but turns of 30 degrees set the times: corners have less room then."""
    feeds = np.random.default_rng(1).choice([5.0, 20.0, 80.0, 200.0], 17)
    rows = [(0.3 * i - 2.5, 0.02 * (i % 2), 30.0 * (i % 2), float(f), 0) for i, f in enumerate(feeds)]
    assert plan_poses(tmp_path, "irb6640_185", rows).verified


def test_micrometres_between_targets_are_sized_by_angle_in_krl(tmp_path: Path) -> None:
    rows = [(10.0 * i + d, 0.3 * (i % 2), 0.0, 100.0, 0) for i in range(6) for d in (0.0, 0.006)]
    assert plan_poses(tmp_path, "kr60_ha", rows).verified


def test_turns_in_place_are_slow_enough_for_their_corners(tmp_path: Path) -> None:
    turns = np.random.default_rng(5).uniform(0.0, 25.0, 14)
    lines = ["S12000 M3 F9000", "G0 X0 Y0 Z20 A0", "G1 Z-3", *(f"A{a:.3f}" for a in turns)]
    assert is_milled(tmp_path, ABB, 0.5, "tool_axis: rotary, convention: head_a", lines)


def test_feeds_change_at_sharp_corners(tmp_path: Path) -> None:
    """Where the tool stops anyway no tiny moves are added, whose spin would speed up the next ones."""
    places = np.cumsum(np.random.default_rng(2).normal(0.0, 10.0, (14, 2)), axis=0)
    lines = ["S12000 M3 F1200", "G0 X0 Y0 Z20", "G1 Z-3"]
    for i, (x, y) in enumerate(np.clip(places, -60.0, 60.0)):
        lines.append(f"X{x:.3f} Y{y:.3f}" + f" F{[9000, 300][i // 3 % 2]}" * (i % 3 == 0))
    assert is_milled(tmp_path, KUKA, 0.01, "tool_axis: fixed", lines)


@pytest.mark.parametrize("cell", [ABB, KUKA])
def test_axes_far_apart_are_turned_the_shortest_way(tmp_path: Path, cell: tuple[str, str]) -> None:
    """Axes 20 degrees apart every 2 mm: a tool that spins meanwhile would leave the shortest turn."""
    lines = ["S12000 M3 F3000", "G0 X-30 Y0 Z20 I0 J0 K1", "G1 Z-3"]
    for k in range(30):
        v = np.array([0.4 * np.sin(4.0 * k / 3.0), 0.2 * np.cos(4.0 * k / 3.0), 1.0])
        i, j, s = v / np.linalg.norm(v)
        lines.append(f"X{2 * k - 30}I{i:.6f}J{j:.6f}K{s:.6f}")
    assert is_milled(tmp_path, cell, 0.1, "tool_axis: ijk", lines)


def test_the_arm_stops_at_corners_that_it_would_crawl_past(tmp_path: Path) -> None:
    """Reversals every 22 mm at 200 mm/s: their zones are so small that the whole path would be slow.

    With stops it takes little longer than its feeds require, and one note reports this.
    """
    rows = [(10.0 * i - 70.0, 20.0 * (i % 2), 0.0, 200.0, 0) for i in range(15)]
    outcome = plan_poses(tmp_path, "irb1200_7_70", rows)
    assert outcome.verified
    (operation,) = outcome.plan.operations
    expected = (operation.targets.travel / operation.targets.feed).sum()
    assert expected < operation.time[-1] < 2.0 * expected
    assert operation.targets.stop[2:-1].all()
    (note,) = [issue for issue in outcome.issues if issue.code == "motion.stops"]
    assert note.severity == Severity.NOTE
    assert note.value == 13.0


def test_feeds_beyond_the_fastest_that_tools_may_go_are_kept_back(tmp_path: Path) -> None:
    """Two long ways, each between stops, at a feed of 600 mm/s where tools may go at 250."""
    places = [(450, -150, 500), (450, 150, 500), (450, 150, 420)]
    rows = [",".join(map(str, (*candidate, 0.5, -0.5, 0.5, 0.5, 600))) for candidate in places]
    table = "\n".join([small_problem.COLUMNS, *rows]) + "\n"
    outcome = planner.plan(planner.load(small_problem.write(tmp_path, table=table)))
    assert outcome.verified, [str(issue) for issue in outcome.proof.issues]
    assert outcome.proof.rules
    (rule,) = [rule for rule in outcome.proof.rules if rule.code == "verify.tcp_speed"]
    assert 250.0 < rule.worst < 275.0
