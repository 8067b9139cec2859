"""The choice of gripper and grip for a block, compared with distances from sampled wires and plates."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.geometry.arrays import inverse, transform
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError
from planner.problem import Problem
from planner.processes import registry
from planner.reading import grip_choice
from planner.report import setup_sheet

PLATE = {"kind": "gripper_plate"}
LIST = [
    {**PLATE, "width_mm": 300, "depth_mm": 200},
    {**PLATE, "width_mm": 220, "depth_mm": 90},
    {**PLATE, "width_mm": 100, "depth_mm": 100},
    {"kind": "vacuum_cup", "radius_mm": 30},
]
WEDGE = [[-140, 90], [-140, -60], [60, -90], [140, -20], [120, 90]]


def data(outline: list[list[float]], grippers: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    """A prism, a little wider at its top, out of a block that the right arm holds."""
    cell: dict[str, Any] = {
        "arms": [
            {
                "name": "left",
                "robot": "irb4600_40",
                "base": {"xyz_mm": [-1800, 0, 0]},
                "tool": {"kind": "bow", "span_mm": 650, "throat_mm": 650, "tilt_deg": 45},
                "home_deg": [0, -20, 20, 0, 90, 0],
            },
            {
                "name": "right",
                "robot": "irb4600_40",
                "base": {"xyz_mm": [1800, 0, 0], "rpy_deg": [0, 0, 180]},
                "tool": {**PLATE, "width_mm": 300, "depth_mm": 200},
                "home_deg": [0, -20, 20, 0, 90, 0],
            },
        ],
        "grippers": grippers,
    }
    wider = (1.05 * np.array(outline)).tolist()
    surface = {
        "name": "sides",
        "closed": True,
        "match": "parameter",
        "start": {"polyline_mm": [[*p, 0] for p in outline], "corner_deg": 5},
        "end": {"polyline_mm": [[*p, 200] for p in wider], "corner_deg": 5},
    }
    return {
        "tandem": 1,
        "name": "prism",
        "cell": cell,
        "stock": {"size_mm": [360, 260, 200], "foam": "eps_a120", "held_by": "right"} | more,
        "part": {"ruled": [surface], "in_stock": {}},
        "operations": [
            {
                "name": "sides",
                "process": "straight_wire",
                "arms": ["left", "right"],
                "kerf_mm": 2,
                "margin_mm": 10,
                "feed_mm_s": 5,
                "shape_tol_mm": 0.5,
                "step_mm": 8,
                "cuts": [{"surface": "sides"}],
            }
        ],
    }


def load(folder: Path, given: dict[str, Any]) -> Problem:
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(given))
    return pipeline.load(path)


def errors(problem: Problem) -> list[Issue]:
    """Collect the issues before any placement search: the grip is chosen or refused with the targets."""
    try:
        result = [issue for job in registry.jobs(problem) for issue in job.targets().issues]
    except TandemError as error:
        result = list(error.issues)
    return [issue for issue in result if issue.severity is Severity.ERROR]


def least_distance(problem: Problem) -> float:
    """From the plate to the wires [m], by samples of both: wires as long as the bow's, ten to a side."""
    setup = problem.setups[0]
    (one,) = problem.part.ruled  # type: ignore[union-attr]
    start, end = (np.concatenate([v, v[:1]]) for v in (one.start, one.end))
    at = np.linspace(0.0, len(start) - 1.0 - 1e-9, 400)
    k, s = at.astype(int), (at % 1.0)[:, None]
    first, last = start[k] + s * (start[k + 1] - start[k]), end[k] + s * (end[k + 1] - end[k])
    along = np.linspace(-1.0, 1.5, 801)[:, None, None]
    wires = (first + along * (last - first)).reshape(-1, 3)
    tool = setup.cell.arm("right").tool
    local = transform(setup.stock.grip, wires)  # in the TCP's frame
    half = np.array([*(0.5 * np.array(tool.footprint)), 0.006])  # type: ignore[union-attr]
    deviation = np.maximum(np.abs(local - [0.0, 0.0, -0.006]) - half, 0.0)
    return float(np.linalg.norm(deviation, axis=1).min())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_wires_stay_away_from_what_is_chosen(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
    outline = (
        np.stack([np.cos(turn), np.sin(turn)], 1) * rng.uniform(0.7, 1.0, (9, 1)) * [165, 118]
    ).tolist()
    problem = load(tmp_path, data(outline, LIST[1:]))
    result = grip_choice.choose_grip(problem.setups[0], problem.part, 10 * MM)
    assert result is not None
    setup = problem.setups[0]
    tool = setup.cell.arm("right").tool
    assert tool.name == result.tool.name
    assert least_distance(problem) >= 10 * MM
    middle = inverse(setup.stock.grip)[:3, 3]
    assert np.abs(np.round(middle[:2] / MM) * MM - middle[:2]).max() < 1e-9
    half = 0.5 * np.array(tool.footprint)  # type: ignore[union-attr]
    half = half if abs(np.sin(result.rotation)) < 0.5 else half[::-1]
    assert (np.abs(middle[:2]) + half <= 0.5 * setup.stock.size[:2] + 1e-9).all()
    assert not [i for i in errors(problem) if i.code.startswith("stock.")]


def test_what_is_mounted_stays_where_it_fits(tmp_path: Path) -> None:
    wide = [[-170, 122], [-170, -122], [170, -122], [170, 122]]
    problem = load(tmp_path, data(wide, LIST))
    assert problem.cell.arm("right").tool.name == "gripper_plate"
    assert np.array_equal(problem.stock.grip, np.eye(4))
    assert problem.notes == ()


def test_the_choice_is_told_everywhere(tmp_path: Path) -> None:
    problem = load(tmp_path, data(WEDGE, LIST))
    tool = problem.cell.arm("right").tool
    assert tool.name == "plate_220x90"
    (note,) = problem.notes
    assert (note.code, note.severity) == ("stock.grip_chosen", Severity.NOTE)
    assert "plate_220x90 of arm right (one of 4 in the cell)" in note.message
    assert note in pipeline.quick_check(problem, 4).issues
    assert problem.setups[0].steps[0] == "Mount the tool plate_220x90 on arm right."
    x, y = inverse(problem.stock.grip)[:2, 3] / MM
    assert f"[{x:g}, {y:g}] mm" in note.message
    (place, _), (_, by) = setup_sheet._grip_rows(problem.stock), ("", "Tandem")
    assert f"{x + 180:.1f} mm from edge" in str(place[1])
    assert setup_sheet._grip_rows(problem.stock)[1][1] == by


def test_a_problem_may_state_gripper_and_grip(tmp_path: Path) -> None:
    problem = load(tmp_path, data(WEDGE, LIST, gripper="plate_100x100"))
    assert problem.cell.arm("right").tool.name == "plate_100x100"
    stated = {"xyz_mm": [-10, 20, 0]}
    problem = load(tmp_path, data(WEDGE, LIST, gripper="cup_60", grip=stated))
    assert problem.cell.arm("right").tool.name == "cup_60"
    assert problem.stock.grip[:3, 3] == pytest.approx([-0.01, 0.02, 0.0])
    assert problem.notes == ()


@pytest.mark.parametrize(
    ("grippers", "more", "code", "field", "word"),
    [
        (LIST, {"gripper": "spoon"}, "problem.field", "stock.gripper", "plate_220x90"),
        (LIST, {"gripper": "cup_60", "held_by": None}, "problem.field", "stock.gripper", "held_by"),
        ([LIST[1], LIST[1]], {}, "problem.duplicate_name", "cell.grippers.1", "plate_220x90"),
        ([{"kind": "spoon"}], {}, "problem.field", "cell.grippers.0", ""),
    ],
)
def test_faults_of_the_list_are_refused_by_field(
    tmp_path: Path, grippers: list[dict[str, Any]], more: dict[str, Any], code: str, field: str, word: str
) -> None:
    with pytest.raises(TandemError) as caught:
        load(tmp_path, data(WEDGE, grippers, **more))
    issues = [i for i in caught.value.issues if i.field == field]
    assert [i.code for i in issues] == [code]
    assert word in issues[0].message


@pytest.mark.parametrize("stated", [False, True])
def test_what_is_advised_where_none_fits_does_fit(tmp_path: Path, stated: bool) -> None:
    thin = [[-150, 56], [-150, -54], [150, -50], [150, 52]]
    more = {"grip": {}} if stated else {}
    (refused,) = errors(load(tmp_path, data(thin, [LIST[0]], **more)))
    assert refused.code == "stock.footprint"
    size = re.search(
        r"width_mm: (\d+), depth_mm: (\d+), with its centre at \[(\S+), (\S+)\] mm", str(refused)
    )
    assert size is not None
    width, depth = float(size[1]), float(size[2])
    advised = data(thin, [LIST[0], {**PLATE, "width_mm": width, "depth_mm": depth}])
    problem = load(tmp_path, advised)
    assert problem.cell.arm("right").tool.name == f"plate_{width:g}x{depth:g}"
    assert not [i for i in errors(problem) if i.code.startswith("stock.")]
    assert least_distance(problem) >= 10 * MM
    for larger in ((width + 30, depth), (width, depth + 30)):  # and nothing much larger does
        given = data(thin, [{**PLATE, "width_mm": larger[0], "depth_mm": larger[1]}])
        assert load(tmp_path, given).notes == ()


def test_a_gripper_that_is_too_weak_is_passed_over(tmp_path: Path) -> None:
    weak = {**LIST[1], "holding_n": 1.0}
    problem = load(tmp_path, data(WEDGE, [weak, LIST[2]]))
    assert problem.cell.arm("right").tool.name == "plate_100x100"
    assert grip_choice.choose_grip(problem.setups[0], problem.part, 10 * MM) is not None
    assert problem.notes[0].message.count("rotated") == int(abs(problem.stock.grip[0, 1]) > np.sin(1 * DEG))


def test_of_later_setups_too(tmp_path: Path) -> None:
    given = data(WEDGE, LIST)
    held = given["stock"].pop("held_by")
    given["stock"]["place"] = {"xyz_mm": [0, 900, 400]}
    given["operations"].insert(0, {**given["operations"][0], "name": "first", "arms": ["left"]})
    given["operations"][1]["setup"] = {"held_by": held}
    problem = load(tmp_path, given)
    first, second = problem.setups
    assert (first.cell.arm("right").tool.name, second.cell.arm("right").tool.name) == (
        "gripper_plate",
        "plate_220x90",
    )
    assert second.steps[0] == "Mount the tool plate_220x90 on arm right."
    assert second.stock.grip[2] == pytest.approx([0.0, 0.0, 1.0, 0.0])
