"""Maps of freedoms in the report: the proven path over what the arms can reach."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from planner import pipeline
from planner.cli import results
from planner.report import freedom_map, markup
from planner.report.freedom_map import FreedomMapData
from tests import small_problem


def sample_map() -> FreedomMapData:
    """Two arms over 4 targets and 5 angles, the last one half a turn off the one before."""
    states = np.array([[0, 0, 0, 1, 1], [0, 2, 2, 2, 2], [3, 3, 3, 3, 3], [0, 4, 4, 4, 0]], dtype=np.int8)
    free = np.where(states == 0, 25.0, np.nan)
    return FreedomMapData(
        operation="cut <1>",
        freedom="spin",
        unit="deg",
        names=("a/1", "a/2", "a/3", "a/4"),
        values=np.repeat(np.linspace(-180.0, 180.0, 5)[None], 4, axis=0),
        states={"left": states, "right": np.zeros_like(states)},
        causes=("", "out of reach", "beyond its limit", "too close to a singularity", "too near"),
        distance=free,
        clearance=10.0,
        path=np.array([-180.0, -90.0, -90.0, 180.0]),
    )


def test_every_place_has_the_colour_of_what_is_in_the_way_there() -> None:
    page = markup.render(freedom_map.figure(sample_map()))
    strips = page.split("<text")
    left = next(item for item in strips if ">left<" in item)
    assert left.count("<rect") == 0  # a strip's cells come behind its two figures
    cells = re.findall(
        r'<rect x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="[\d.]+" style="fill:var\((.*?)\)"', page
    )
    across = freedom_map.WIDTH / 4
    result = {}
    for x, y, width, fill in cells[: sum(1 for item in cells if float(item[1]) < freedom_map.TOP + 120)]:
        first = round((float(x) - freedom_map.LEFT) / across)
        for k in range(first, first + round(float(width) / across)):
            result[k, 4 - round((float(y) - freedom_map.TOP) / 24.0)] = fill
    state = sample_map().states["left"]
    assert {place: freedom_map.STATE_COLOURS[state[place]] for place in np.ndindex(4, 5)} == result


def test_the_plan_is_a_line_that_does_not_cross_the_map_where_it_turns_on() -> None:
    page = markup.render(freedom_map.figure(sample_map()))
    lines = re.findall(r'<polyline points="(.*?)"', page)
    assert len(lines) == 3 * 2  # strips times parts
    assert len(lines[0].split()) == 3
    assert "cut &lt;1&gt;" in page
    assert "<1>" not in page
    assert "Smallest range at a/3: 0 % of the values." in page
    for cause in sample_map().causes[1:]:
        assert cause in page


def test_the_report_of_a_plan_has_them_when_they_are_asked_for(tmp_path: Path) -> None:
    free = "free: [{name: roll, arms: [left], axis: x, turn_deg: [-180, 180]}]"
    text = small_problem.PROBLEM.replace("frame: world}", f"frame: world, {free}}}")
    outcome = pipeline.plan(pipeline.load(small_problem.write(tmp_path, text)))
    outcome.save(tmp_path / "out")
    report = tmp_path / "out" / "report.html"
    assert "Maps of freedoms" not in report.read_text()
    assert results.write_pages(tmp_path / "out", maps=True).ok
    page = report.read_text()
    assert "Maps of freedoms" in page
    assert f"poses: roll [deg] over {outcome.plan.operations[0].targets.count} targets" in page
    # where the plan goes, it is free
    (cells,) = results.freedom_maps(outcome.problem, outcome.plan)
    near = np.abs(cells.values - cells.path[:, None]).argmin(axis=1)
    assert (cells.states["left"][np.arange(len(near)), near] == 0).all()
