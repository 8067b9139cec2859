"""The plant: it shares no code with the loop, is in balance, and its table agrees with the shells."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from bench import plant_shells
from bench.loop_bench import plant_of_shape, ratio_span, trial_plan
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.loops import plant
from planner.loops.plant import PlantFile, PlantSheets
from planner.loops.simulate import run_loop
from tests.loops.plans import power_plan

RING = 0.04 * np.column_stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)])


def test_it_imports_nothing_of_the_loop_nor_of_forming() -> None:
    tree = ast.parse(Path(plant.__file__).read_text())
    names = {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    house = {name for name in names if name.startswith("planner")}
    allowed = {"planner.geometry.arrays", "planner.issues", "planner.reading", "planner.reading.strict_yaml"}
    assert house <= allowed
    assert "scipy.interpolate" not in names


def formed(file: PlantFile, offset: float, levels: int = 20) -> tuple[PlantSheets, FloatArray]:
    sheets = PlantSheets(file, [3, 4], RING)
    before = sheets.depth
    for k in range(1, levels + 1):
        before = sheets.depth
        depth = 0.5 * MM * k
        sheets.form_level(depth, 0.5 * MM, np.full((2, 8), depth + offset), RING)
    return sheets, before


def test_command_depth_and_force_are_in_balance() -> None:
    file = plant_of_shape("cone", compensated=(0.0, 0.0))
    sheets, before = formed(file, 3.0 * MM)
    s = sheets.true_springback(10.0 * MM, RING, sheets.force)
    give = sheets.force / 500.0 * MM
    assert sheets.depth + s + give == pytest.approx(np.full((2, 8), 13.0 * MM), abs=1e-9)
    grown = (1.0 - np.exp(-10.0 / 2.5)) * ((sheets.depth - before) / (0.5 * MM)) ** 0.18
    steady = sheets.force / grown
    assert steady.min() > 0.9 * 0.92 * 620.0
    assert steady.max() < 1.1 * 1.08 * 620.0


def test_a_tool_that_stays_above_the_part_has_no_contact() -> None:
    sheets, _ = formed(plant_of_shape("cone"), 0.0)
    depth = sheets.depth
    lost = sheets.form_level(10.5 * MM, 0.5 * MM, np.full((2, 8), 1.0 * MM), RING)
    assert lost.all()
    assert np.array_equal(sheets.depth, depth)
    assert not sheets.force.any()


def test_the_same_seed_is_the_same_sheet_and_others_differ() -> None:
    file = plant_of_shape("cone")
    one, two = PlantSheets(file, [1, 2], RING), PlantSheets(file, [2, 1], RING)
    force = np.full((2, 8), 500.0)
    a, b = (some.true_springback(8.0 * MM, RING, force) for some in (one, two))
    assert np.array_equal(a, b[::-1])
    assert abs(a[0] - a[1]).max() > 1e-5


@pytest.mark.parametrize("shape", ["cone", "pyramid"])
def test_sheets_come_back_by_0_95_to_1_15_of_what_the_loop_believes(shape: str) -> None:
    low, high = ratio_span(shape, plant_of_shape(shape), list(range(100)))
    assert 0.95 <= low < 1.0 < high <= 1.15
    low, high = ratio_span(shape, plant_of_shape(shape, springback=(0.72, 1.25)), list(range(100)))
    assert 0.68 <= low < 0.8
    assert 1.3 < high <= 1.42


def test_a_row_of_the_table_is_what_coarse_shells_say_within_two_percent() -> None:
    found = plant.springback_table()
    table = found["shapes"]["cone"]["true_mm"]
    made = plant_shells.displacements("cone", 0.014, 0.0, 0.85, 15.0, 900)
    place = (
        found["depth_mm"].index(14.0),
        0,
        found["thickness"].index(0.85),
        found["spring_n_mm2"].index(15.0),
    )
    row = table[place[0]][place[1]][place[2]][place[3]]
    assert made == pytest.approx(np.array(row), rel=0.02)


def test_curves_of_ones_own_serve_any_part() -> None:
    file = PlantFile.model_validate(
        {
            "tandem_plant": 1,
            "curves": [
                {"depth_mm": z, "forces_n": [100, 300, 600, 900], "springback_mm": [1.7, 3.3, s, 6.4]}
                for z, s in ((1, 5.2), (20, 5.0))
            ],
        }
    )
    one = run_loop(power_plan(), file, None, [0, 1, 2])
    assert 3.0 * MM < one.mean_error().min() < one.mean_error().max() < 7.0 * MM


def test_levels_of_another_part_are_refused_and_curves_of_it_are_a_remedy() -> None:
    plan = power_plan()  # as wide at 20 mm as at the top, which the cone is not
    with pytest.raises(TandemError) as refused:
        run_loop(plan, plant_of_shape("cone"), None, [0])
    (issue,) = refused.value.issues
    assert issue.code == "forming.loop_plant"
    assert "state curves of your part" in str(issue.hint)
    run_loop(trial_plan("cone"), plant_of_shape("cone"), None, [0])
