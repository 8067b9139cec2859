"""The released part on the plan's page: heights and deviations against the springback file."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.geometry.units import MM
from planner.issues import TandemError
from planner.plans import OperationPlan, Plan
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.process_plan import make_tool_paths
from planner.processes.forming.plan.springback import compensation, released_part
from planner.processes.forming.plan.springback.forecast import SpringbackEstimate
from planner.report import exhibits, released_sheet
from planner.targets import Targets
from tests.processes.forming.plan.springback import springback_files as files
from tests.processes.forming.plan.springback.test_compensation import job, with_springback_file

PLACE_TOLERANCE_MM = 0.08
"""Allowed difference [mm] between control points and the nearest points of grid and path: half a loop."""


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> FormingJob:
    return job(tmp_path_factory.mktemp("dsif"), "dsif")


@pytest.fixture(scope="module")
def text(together: FormingJob) -> str:
    return files.text_of(together)


def page(targets: Targets) -> list[dict[str, Any]]:
    """Return the sheet data of a replay page, nothing if it has no switch."""
    time, none = np.zeros(len(targets.segment)), np.zeros((len(targets.segment), 0))
    operation_plan = OperationPlan("dish", targets, {}, none, time, {}, {}, (), {})
    html = released_sheet.sheet_switch(Plan("dish", "", {}, (np.eye(4),), {}, (operation_plan,), {}))
    found = re.search(r"id='released'>(.*?)</script>", html)
    return [] if found is None else list(json.loads(found[1]))


def shown(sheet: dict[str, Any], name: str, points: list[dict[str, Any]]) -> np.ndarray:
    """Values [mm] of the page's grid at the control points of a file."""
    value = np.array([np.nan if v is None else v for v in sheet[name]]) / sheet["per_mm"]
    column = [int(np.abs(np.array(sheet["x"]) - point["x_mm"]).argmin()) for point in points]
    row = [int(np.abs(np.array(sheet["y"]) - point["y_mm"]).argmin()) for point in points]
    return value.reshape(len(sheet["y"]), len(sheet["x"]))[row, column]


def test_the_page_shows_what_the_file_foretells(together: FormingJob, text: str, tmp_path: Path) -> None:
    (sheet,) = page(with_springback_file(together, tmp_path, text).targets())
    points = json.loads(text)["control_points"]
    foretold = np.array([one["springback_mm"] for one in points])
    side = together.planned.passes[0].side
    # what comes back is between both surfaces
    back = side * (shown(sheet, "released", points) - shown(sheet, "formed", points))
    assert back == pytest.approx(foretold, abs=PLACE_TOLERANCE_MM)
    # behind the slope of its beginning the file leaves nothing
    deviation = shown(sheet, "deviation", points)
    assert deviation[3:] == pytest.approx(0.0, abs=PLACE_TOLERANCE_MM)
    most = max(point[3] for one in json.loads(text)["passes"] for ring in one["rings"] for point in ring)
    known = np.array([v is not None for v in sheet["deviation"]])
    left = np.array([v or 0 for v in sheet["deviation"]]) / sheet["per_mm"]
    height = {name: np.array(sheet[name]) / sheet["per_mm"] for name in ("formed", "released")}
    expected = height["released"] - side * left
    assert np.abs(height["formed"] - expected).max() == pytest.approx(most, abs=0.02)
    # beside the feature nothing is known, and the sheet is as it was
    assert 0.2 < known.mean() < 0.9
    assert height["formed"][~known] == pytest.approx(height["released"][~known])
    assert "back.json" in sheet["note"]
    assert sheet["limit"] == 2.0


def test_without_shifts_the_part_is_too_shallow_by_all_of_it(
    together: FormingJob, text: str, tmp_path: Path
) -> None:
    still = files.edited(text, files.each_point(lambda point: point.__setitem__(3, 0.0)))
    (sheet,) = page(with_springback_file(together, tmp_path, still).targets())
    points = json.loads(text)["control_points"]
    foretold = np.array([one["springback_mm"] for one in points])
    assert shown(sheet, "deviation", points) == pytest.approx(foretold, abs=PLACE_TOLERANCE_MM)


def test_an_estimate_goes_by_depth(together: FormingJob) -> None:
    tool_paths = make_tool_paths(together.planned)
    contact = tool_paths[0][1].contact
    rows = tuple(int(np.flatnonzero(contact.loop == k)[0]) for k in (2, int(contact.loop.max())))
    shape = released_part.estimated_exhibit(
        together.planned, tool_paths, SpringbackEstimate(0, rows, (1.0 * MM, 0.4 * MM), (500.0, 500.0), False)
    )
    points = [
        {"x_mm": float(contact.point[row, 0]) / MM, "y_mm": float(contact.point[row, 1]) / MM} for row in rows
    ]
    sheet = released_sheet.exhibit_data(shape)
    assert shown(sheet, "deviation", points) == pytest.approx([1.0, 0.4], abs=PLACE_TOLERANCE_MM)
    known = shape["deviation"][np.isfinite(shape["deviation"])]
    assert known.min() == pytest.approx(0.4)
    assert known.max() == pytest.approx(1.0)  # and above it as there
    assert "2 points" in shape["note"]
    (figure,), issues = exhibits.draw({"released": shape}, np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    assert not issues
    assert figure


def test_control_points_that_are_none_are_refused(together: FormingJob, text: str, tmp_path: Path) -> None:
    def cut(data: dict[str, Any]) -> None:
        del data["control_points"][0]["springback_mm"]

    with pytest.raises(TandemError, match="control points"):
        with_springback_file(together, tmp_path, files.edited(text, cut)).targets()


def test_a_force_that_nobody_stated_is_shown_as_assumed(tmp_path: Path) -> None:
    made = job(tmp_path)
    operation = made.operation.model_copy(update={"force_n": None})
    (sheet,) = page(FormingJob(operation, made.setup, made.part).targets())
    assert re.search(r"under an assumed force of \d+", sheet["note"])


def test_maps_of_a_forecast_are_on_one_scale(together: FormingJob) -> None:
    laid, found = files.forecast_job(together)
    ways, _ = compensation.compensated_paths(together.planned, laid, found, 0.05)
    maps = released_part.springback_maps(together.planned, laid, found, ways)
    before, after = maps["deviation_before"], maps["deviation_after"]
    assert before["limit"] == after["limit"] == 2.0
    assert before["value"] == pytest.approx(maps["springback"]["value"], nan_ok=True)
    gone = before["value"] - after["value"]
    assert np.nanmax(gone) == pytest.approx(ways[0].shift.max() / MM, abs=0.01)
    assert np.nanmin(gone) >= 0.0
    inside = np.isfinite(before["value"])
    depth = -before["points"][inside, 2] / MM
    assert before["value"][inside] == pytest.approx(1.2 - 0.05 * depth, abs=2.0 * PLACE_TOLERANCE_MM)
