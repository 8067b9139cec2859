"""The released part as a plan shows it: its page's heights and deviations against the springback file."""

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
from planner.processes.forming.plan.process_plan import lay_all
from planner.processes.forming.plan.springback import compensation, released
from planner.processes.forming.plan.springback.forecast import Estimate
from planner.report import exhibits, released_sheet
from planner.targets import Targets
from tests.processes.forming.plan.springback import springback_files as files
from tests.processes.forming.plan.springback.test_compensation import given, job

NEAR = 0.08
"""What control points and the nearest places of grid and path may differ by [mm]: half a loop of the path."""


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> FormingJob:
    return job(tmp_path_factory.mktemp("dsif"), "dsif")


@pytest.fixture(scope="module")
def text(together: FormingJob) -> str:
    return files.text_of(together)


def page(targets: Targets) -> list[dict[str, Any]]:
    """What a replay's page has of the sheet; nothing if it has no switch."""
    time, none = np.zeros(len(targets.segment)), np.zeros((len(targets.segment), 0))
    made = OperationPlan("dish", targets, {}, none, time, {}, {}, (), {})
    html = released_sheet.switch(Plan("dish", "", {}, (np.eye(4),), {}, (made,), {}))
    found = re.search(r"id='released'>(.*?)</script>", html)
    return [] if found is None else list(json.loads(found[1]))


def shown(sheet: dict[str, Any], name: str, points: list[dict[str, Any]]) -> np.ndarray:
    """Values [mm] of the page's grid at the control points of a file."""
    value = np.array([np.nan if v is None else v for v in sheet[name]]) / sheet["per_mm"]
    column = [int(np.abs(np.array(sheet["x"]) - one["x_mm"]).argmin()) for one in points]
    row = [int(np.abs(np.array(sheet["y"]) - one["y_mm"]).argmin()) for one in points]
    return value.reshape(len(sheet["y"]), len(sheet["x"]))[row, column]


def test_the_page_shows_what_the_file_foretells(together: FormingJob, text: str, tmp_path: Path) -> None:
    (sheet,) = page(given(together, tmp_path, text).targets())
    points = json.loads(text)["control_points"]
    foretold = np.array([one["springback_mm"] for one in points])
    side = together.planned.passes[0].side
    # what comes back is between both surfaces
    back = side * (shown(sheet, "released", points) - shown(sheet, "formed", points))
    assert back == pytest.approx(foretold, abs=NEAR)
    # behind the slope of its beginning the file leaves nothing
    deviation = shown(sheet, "deviation", points)
    assert deviation[3:] == pytest.approx(0.0, abs=NEAR)
    most = max(point[3] for one in json.loads(text)["passes"] for ring in one["rings"] for point in ring)
    known = np.array([v is not None for v in sheet["deviation"]])
    left = np.array([v or 0 for v in sheet["deviation"]]) / sheet["per_mm"]
    height = {name: np.array(sheet[name]) / sheet["per_mm"] for name in ("formed", "released")}
    wanted = height["released"] - side * left
    assert np.abs(height["formed"] - wanted).max() == pytest.approx(most, abs=0.02)
    # beside the feature nothing is known, and the sheet is as it was
    assert 0.2 < known.mean() < 0.9
    assert height["formed"][~known] == pytest.approx(height["released"][~known])
    assert "back.json" in sheet["note"]
    assert sheet["limit"] == 2.0


def test_without_shifts_the_part_is_too_shallow_by_all_of_it(
    together: FormingJob, text: str, tmp_path: Path
) -> None:
    still = files.edited(text, files.each_point(lambda point: point.__setitem__(3, 0.0)))
    (sheet,) = page(given(together, tmp_path, still).targets())
    points = json.loads(text)["control_points"]
    foretold = np.array([one["springback_mm"] for one in points])
    assert shown(sheet, "deviation", points) == pytest.approx(foretold, abs=NEAR)


def test_an_estimate_goes_by_depth(together: FormingJob) -> None:
    laid = lay_all(together.planned)
    contact = laid[0][1].contact
    rows = tuple(int(np.flatnonzero(contact.loop == k)[0]) for k in (2, int(contact.loop.max())))
    shape = released.estimated(
        together.planned, laid, Estimate(0, rows, (1.0 * MM, 0.4 * MM), (500.0, 500.0), False)
    )
    points = [
        {"x_mm": float(contact.point[row, 0]) / MM, "y_mm": float(contact.point[row, 1]) / MM} for row in rows
    ]
    sheet = released_sheet.shape_data(shape)
    assert shown(sheet, "deviation", points) == pytest.approx([1.0, 0.4], abs=NEAR)
    known = shape["deviation"][np.isfinite(shape["deviation"])]
    assert known.min() == pytest.approx(0.4)
    assert known.max() == pytest.approx(1.0)  # and above it as there
    assert "2 places" in shape["note"]
    (figure,), issues = exhibits.draw({"released": shape}, np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    assert not issues
    assert figure


def test_control_points_that_are_none_are_refused(together: FormingJob, text: str, tmp_path: Path) -> None:
    def cut(data: dict[str, Any]) -> None:
        del data["control_points"][0]["springback_mm"]

    with pytest.raises(TandemError, match="control points"):
        given(together, tmp_path, files.edited(text, cut)).targets()


def test_a_force_that_nobody_stated_is_shown_as_assumed(tmp_path: Path) -> None:
    made = job(tmp_path)
    operation = made.operation.model_copy(update={"force_n": None})
    (sheet,) = page(FormingJob(operation, made.setup, made.part).targets())
    assert re.search(r"under an assumed force of \d+", sheet["note"])


def test_maps_of_a_forecast_are_on_one_scale(together: FormingJob) -> None:
    laid, found = files.foretold(together)
    ways, _ = compensation.ways(together.planned, laid, found, 0.05)
    maps = released.maps(together.planned, laid, found, ways)
    before, after = maps["deviation_before"], maps["deviation_after"]
    assert before["limit"] == after["limit"] == 2.0
    assert before["value"] == pytest.approx(maps["springback"]["value"], nan_ok=True)
    gone = before["value"] - after["value"]
    assert np.nanmax(gone) == pytest.approx(ways[0].shift.max() / MM, abs=0.01)
    assert np.nanmin(gone) >= 0.0
    inside = np.isfinite(before["value"])
    depth = -before["points"][inside, 2] / MM
    assert before["value"][inside] == pytest.approx(1.2 - 0.05 * depth, abs=2.0 * NEAR)
