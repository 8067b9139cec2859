"""Impossible milling jobs: each has its code, the place or the largest cutter that fits, and a remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.issues import Issue, Severity, TandemError
from planner.motion import solve
from planner.processes import registry
from planner.processes.milling.plan.operation import Milling
from planner.tooling import Mill
from tests.processes.milling.plan.small_mill import BALL, PANEL, WALL, problem

ENGRAVE = {"engrave": [{"bspline_mm": [[-30, -15, 0], [0, 15, 0], [30, -15, 0]]}], "depth_mm": 0.5}


def issues(
    folder: Path, base: dict[str, Any], tool: dict[str, Any] | None = None, **fields: Any
) -> list[Issue]:
    """Issues of making the targets."""
    try:
        read = problem(folder, base, tool, **fields)
        return list(registry.job(read, 0).targets().issues)
    except TandemError as error:
        return list(error.issues)


def first_with_code(reported: list[Issue], code: str) -> Issue:
    own = [issue for issue in reported if issue.code == code]
    assert own, reported
    return own[0]


def ruled(start: list[list[float]], end: list[list[float]], **more: Any) -> dict[str, Any]:
    surface = {"name": "wall", "start": {"polyline_mm": start}, "end": {"polyline_mm": end}, **more}
    return {"ruled": [surface], "in_stock": {}}


def test_a_good_wall_has_none(tmp_path: Path) -> None:
    assert not issues(tmp_path, WALL)


def test_a_tool_without_a_cutter(tmp_path: Path) -> None:
    read = problem(tmp_path, WALL)
    tool = {"kind": "ball_tool"}
    data = dict(WALL)
    data["cell"] = {**WALL["cell"], "arms": [{**WALL["cell"]["arms"][0], "tool": tool}]}
    assert isinstance(read.cell.arms[0].tool, Mill)
    assert "mill" in first_with_code(issues(tmp_path, data), "milling.tool").message


def test_a_surface_that_the_part_does_not_have(tmp_path: Path) -> None:
    assert (
        "wall"
        in first_with_code(issues(tmp_path, WALL, cuts=[{"flank": "door"}]), "milling.no_surface").message
    )
    lines = [{"lines": "front", "stepover_mm": 3}]
    assert "part.front" in first_with_code(issues(tmp_path, WALL, cuts=lines), "milling.no_surface").message


def test_a_surface_behind_a_file_would_be_milled_at_its_speed(tmp_path: Path) -> None:
    files = [{"name": "marks", "gcode": {"file": "a.nc", "origin": {}}}]
    with pytest.raises(TandemError) as caught:
        problem(tmp_path, WALL, cuts=[*files, {"flank": "wall"}])
    assert "put files last" in first_with_code(list(caught.value.issues), "problem.field").message
    (read,) = problem(tmp_path, WALL, cuts=[{"flank": "wall"}, *files]).operations
    assert isinstance(read, Milling) and not read.by_files


def test_a_wall_higher_than_the_flute(tmp_path: Path) -> None:
    found = first_with_code(issues(tmp_path, WALL, {"flute_mm": 30}), "milling.flute")
    assert found.value == pytest.approx(39.0, abs=2.0)
    assert found.limit == 30


def test_a_holder_below_the_top_of_the_wall(tmp_path: Path) -> None:
    found = issues(tmp_path, WALL, {"flute_mm": 35, "overhang_mm": 36})
    assert first_with_code(found, "milling.holder").limit == pytest.approx(36.0)


def test_a_cutter_too_thick_for_a_round_names_the_largest_that_fits(tmp_path: Path) -> None:
    """A wall along a half circle of radius 10 mm, milled from inside: 10 mm is the largest radius."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 61)
    arc = [[float(10 * np.sin(t)), float(10 * np.cos(t)), 12.0] for t in turn]
    top = [[x, y, 40.0] for x, y, _ in arc]
    part = ruled(arc, top)
    fits = issues(tmp_path, WALL, part=part, cuts=[{"flank": "wall", "lead_mm": 0}])
    assert not [i for i in fits if i.severity is Severity.ERROR]
    found = issues(tmp_path, WALL, {"diameter_mm": 24}, part=part, cuts=[{"flank": "wall", "lead_mm": 0}])
    issue = first_with_code(found, "milling.tool_radius")
    reported = float(issue.message.split("largest radius that fits there is ")[1].split(" mm")[0])
    assert reported == pytest.approx(10.0, rel=0.1)


def test_twisted_rulings_name_a_cutter_that_is_good_enough(tmp_path: Path) -> None:
    part = ruled([[-20, -20, 12], [20, 20, 12]], [[-20, 20, 50], [20, -20, 50]])
    found = first_with_code(
        issues(
            tmp_path,
            WALL,
            {"diameter_mm": 20, "flute_mm": 70, "overhang_mm": 90},
            part=part,
            shape_tol_mm=0.1,
        ),
        "milling.twist",
    )
    assert found.value is not None and found.value > 0.1
    assert "radius of" in found.message


def test_an_inner_corner(tmp_path: Path) -> None:
    low = [[-40, 0, 12], [0, 20, 12], [40, 0, 12]]
    part = ruled(low, [[x, y, 45] for x, y, _ in low])
    found = first_with_code(issues(tmp_path, WALL, part=part), "milling.corner")
    assert "0.0, 20.0" in found.message


def test_an_outer_corner_is_gone_around(tmp_path: Path) -> None:
    low = [[-40, 0, 12], [0, 20, 12], [40, 0, 12]]
    assert not issues(tmp_path, WALL, part=ruled(low, [[x, y, 45] for x, y, _ in low], flip=True))


def test_guides_of_very_different_lengths_are_told(tmp_path: Path) -> None:
    part = ruled([[-50, 0, 12], [50, 0, 12]], [[-10, 0, 45], [10, 0, 45]])
    found = first_with_code(
        issues(tmp_path, WALL, {"overhang_mm": 100, "flute_mm": 70}, part=part), "milling.guide_lengths"
    )
    assert found.value == pytest.approx(5.0, rel=0.02)
    assert found.severity is Severity.WARNING


def test_a_tool_that_never_rises_to_the_safe_plane(tmp_path: Path) -> None:
    part = ruled([[-40, -20, 30], [40, -20, 30]], [[-40, 20, 31], [40, 20, 31]])
    found = first_with_code(issues(tmp_path, WALL, {"flute_mm": 60}, part=part), "milling.safe_plane")
    assert found.hint == "use safe_side: back"


def test_a_face_that_looks_down(tmp_path: Path) -> None:
    flipped = {"front": PANEL["part"]["front"], "in_stock": {"rpy_deg": [180, 0, 0], "xyz_mm": [0, 0, 330]}}
    found = issues(tmp_path, PANEL, BALL, part=flipped, cuts=[ENGRAVE])
    assert {i.code for i in found} & {"milling.front", "part.stock_too_small"}


def test_a_pattern_off_the_panel(tmp_path: Path) -> None:
    far = {**ENGRAVE, "engrave": [{"polyline_mm": [[0, 0, 0], [100, 0, 0]]}]}
    assert (
        "curve 1" in first_with_code(issues(tmp_path, PANEL, BALL, cuts=[far]), "milling.off_surface").message
    )


def test_lines_that_cannot_be(tmp_path: Path) -> None:
    wide = [{"lines": "front", "stepover_mm": 3, "margin_mm": 400}]
    assert first_with_code(issues(tmp_path, PANEL, BALL, cuts=wide), "milling.pattern")
    flat = [{"lines": "front", "scallop_mm": 0.05}]
    assert "stepover_mm" in first_with_code(issues(tmp_path, PANEL, cuts=flat), "milling.pattern").message


@pytest.mark.parametrize(("field", "good", "bad"), [("scallop_mm", 0.205, 0.3), ("stepover_mm", 2.15, 3.0)])
def test_ridges_that_the_proof_would_refuse_are_refused_before(
    tmp_path: Path, field: str, good: float, bad: float
) -> None:
    """The tolerance is 0.2 mm, of 98 % of the face."""
    found = first_with_code(
        issues(tmp_path, PANEL, BALL, cuts=[{"lines": "front", field: bad}]), "milling.pattern"
    )
    assert found.value is not None and found.limit == pytest.approx(0.229, abs=1e-3)
    assert found.limit < found.value < 0.4
    for more in ({field: good}, {field: bad, "shape_tol_mm": 0.5}):
        assert not issues(tmp_path, PANEL, BALL, cuts=[{"lines": "front", **more}])


def test_a_holder_that_leans_into_the_panel(tmp_path: Path) -> None:
    cut = {**ENGRAVE, "lead_deg": 59}
    found = issues(
        tmp_path,
        PANEL,
        {**BALL, "overhang_mm": 13, "holder": [{"length_mm": 60, "diameter_mm": 60}]},
        cuts=[cut],
    )
    assert "holder" in first_with_code(found, "milling.gouge").message


def test_an_axis_curve_that_runs_the_other_way(tmp_path: Path) -> None:
    cut = {
        "engrave": [{"polyline_mm": [[-30, 0, 0], [30, 0, 0]]}],
        "axis": "curves",
        "axis_curves": [{"polyline_mm": [[30, 0, 80], [-30, 0, 80]]}],
        "depth_mm": 0.5,
    }
    assert (
        "same direction"
        in first_with_code(issues(tmp_path, PANEL, BALL, cuts=[cut]), "milling.guides").message
    )


def test_a_spindle_that_hits_its_own_arm_is_named(tmp_path: Path) -> None:
    """A spindle of 1.5 m that leans by 100 degrees, with axis 5 so far bent that it is in the forearm."""
    arm = {**WALL["cell"]["arms"][0], "home_deg": [0, -20, 20, 0, 110, 0]}
    arm["tool"] = {**arm["tool"], "tilt_deg": 100, "spindle_length_mm": 1500, "mass_kg": 20}
    read = problem(tmp_path, {**WALL, "cell": {**WALL["cell"], "arms": [arm]}})
    with pytest.raises(TandemError) as caught:
        solve.solve(read, [registry.job(read, 0).targets()])
    found = first_with_code(list(caught.value.issues), "motion.home")
    assert "robot/tool" in found.message


def closed(low: float, high: float, sides: int, **more: Any) -> dict[str, Any]:
    """A closed wall about z, of two regular polygons."""
    turn = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    rings = [
        [[float(r * np.cos(t)), float(r * np.sin(t)), z] for t in turn]
        for r, z in ((low, 12.0), (high, 50.0))
    ]
    return ruled(*rings, closed=True, **more)


def test_closed_outlines_are_gone_around_outside_with_corners_and_inside(tmp_path: Path) -> None:
    assert not issues(tmp_path, WALL, part=closed(20, 16, 240))
    assert not issues(tmp_path, WALL, part=closed(22, 18, 4))
    down = [{"flank": "wall", "lead_mm": 0}]
    assert not issues(tmp_path, WALL, part=closed(20, 24, 240, hole=True), cuts=down)


def test_a_way_out_through_the_wall_of_a_hole_is_told_as_such(tmp_path: Path) -> None:
    found = first_with_code(issues(tmp_path, WALL, part=closed(20, 24, 240, hole=True)), "milling.gouge")
    assert "set a lead_mm" in found.message
    assert found.target is not None
    assert found.target.startswith(("mill/wall_in/", "mill/wall_out/"))


def test_every_inner_corner_of_a_closed_hole_is_named(tmp_path: Path) -> None:
    part = closed(20, 24, 4, hole=True)
    found = issues(tmp_path, WALL, part=part, cuts=[{"flank": "wall", "lead_mm": 0}])
    named = {i.message.split(" degrees at ")[1].split(" mm")[0] for i in found if i.code == "milling.corner"}
    assert len(named) == 4


def test_guides_that_run_against_each_other_are_told_and_give_the_same_job(tmp_path: Path) -> None:
    """The note names the surface, its guide and what to do."""
    own = WALL["part"]["ruled"][0]
    back = {"bspline_mm": own["end"]["bspline_mm"][::-1]}
    turned = {"ruled": [{**own, "end": back}], "in_stock": {}}
    notes = pipeline.check(problem(tmp_path, WALL, part=turned))
    (note,) = [one for one in notes if "guide" in one.message]
    assert (note.code, note.severity) == ("part.guide_turned", Severity.NOTE)
    assert note.field == "part.ruled.0.end"
    assert "wall" in note.message and "reverse its points" in note.message
    expected, got = (
        registry.job(problem(tmp_path, WALL, part=p), 0).targets() for p in (WALL["part"], turned)
    )
    np.testing.assert_allclose(got.pose["robot"], expected.pose["robot"], atol=1e-7)
    assert not [one for one in pipeline.check(problem(tmp_path, WALL)) if "guide" in one.message]
