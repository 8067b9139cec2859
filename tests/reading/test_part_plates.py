"""Plates in problem files: outlines and holes, given as points or taken from drawings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest

from planner.geometry.rulings import outward_normals
from tests.reading.part_specs import SQUARE, circle, expect_refusal, make, outline


def test_outlines_go_through_the_plate_with_holes_first_and_pieces_in_holes_before_them() -> None:
    clockwise = {"polyline_mm": [[20, 20], [20, 40], [40, 40], [40, 20]]}
    part = make(outline(circle(70, 70, 20), clockwise, circle(70, 70, 5)))
    assert [(r.name, r.hole) for r in part.ruled] == [
        ("outline_a", False),
        ("hole_a", True),
        ("hole_b", True),
        ("outline_b", False),
    ]
    for ruled in part.ruled:
        assert ruled.closed
        np.testing.assert_allclose(ruled.start[:, 2], 0.0)
        np.testing.assert_allclose(ruled.end[:, 2], 0.1)
        out = np.sum(outward_normals(ruled)[0] * (ruled.start - ruled.start.mean(axis=0)), axis=1)
        assert ((out < 0) if ruled.hole else (out > 0)).all()
    ring = part.ruled[1].start[:, :2]
    centre = 0.5 * (ring.min(axis=0) + ring.max(axis=0))
    np.testing.assert_allclose(centre, [0.02, 0.02], atol=1e-6)
    # the chord of a step a sags by r (1 - cos(a / 2))
    assert 0.02 - np.linalg.norm(0.5 * (ring + np.roll(ring, 1, 0)) - centre, axis=1).min() < 1e-5
    assert part.ruled[3].corner.sum() == 4


def test_outlines_are_turned_by_a_quarter_where_they_fit_only_so() -> None:
    long = {"polyline_mm": [[0, 0], [500, 0], [500, 50], [0, 50]]}
    (own,) = make({"plate": {"outlines": [long]}}).ruled
    np.testing.assert_allclose(np.ptp(own.start, axis=0), [0.05, 0.5, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ({"polyline_mm": [[10, 10], [60, 60], [60, 10], [10, 60]]}, "part.outline_crossing"),
        (circle(100, 50, 10), "part.outline_overlap"),
        (circle(90, 50, 10), "part.outline_overlap"),
        ({"polyline_mm": SQUARE[2:] + SQUARE[:2]}, "part.outline_duplicate"),
        ({"polyline_mm": [[10, 10], [10, 10], [10, 10]]}, "part.guide"),
    ],
)
def test_faults_of_outlines_are_named(more: dict[str, Any], code: str) -> None:
    issues = expect_refusal(outline(more))
    assert [issue.code for issue in issues] == [code]
    assert issues[0].field == "part.plate.outlines.1"


def drawing(path: Path) -> None:
    document = ezdxf.new("R2010", units=4)
    space = document.modelspace()
    space.add_line((0, 0), (80, 0), dxfattribs={"layer": "cut"})
    space.add_arc((80, 20), 20, 270, 90, dxfattribs={"layer": "cut"})
    space.add_line((0, 40), (80, 40), dxfattribs={"layer": "cut"})
    space.add_lwpolyline([(0, 40), (0, 0)], dxfattribs={"layer": "cut"})
    space.add_circle((70, 20), 8, dxfattribs={"layer": "cut"})
    space.add_text("a note", dxfattribs={"layer": "cut"})
    space.add_spline([(0, 0, 0), (50, 30, 20), (100, 0, 0)], dxfattribs={"layer": "guide"})
    space.add_line((0, 80, 0), (40, 80, 0), dxfattribs={"layer": "open"})
    document.saveas(path)


def test_outlines_from_a_drawing_are_joined_from_their_pieces(tmp_path: Path) -> None:
    drawing(tmp_path / "plate.dxf")
    part = make({"plate": {"dxf": {"file": "plate.dxf", "unit": "mm", "layer": "cut"}}}, tmp_path)
    assert [r.name for r in part.ruled] == ["hole_a", "outline_a"]
    assert [note.code for note in part.notes] == ["part.dxf_left_out"]
    assert "TEXT" in part.notes[0].message
    outer = part.ruled[1].start[:, :2]
    x, y = outer.T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert area == pytest.approx(0.08 * 0.04 + 0.5 * np.pi * 0.02**2, rel=1e-3)
    assert part.ruled[1].corner.sum() == 2  # the arc runs smoothly into the lines


def test_drawings_that_do_not_hold_what_is_wanted_are_refused(tmp_path: Path) -> None:
    drawing(tmp_path / "plate.dxf")
    dxf = {"file": "plate.dxf", "unit": "mm"}
    assert (
        expect_refusal({"plate": {"dxf": dxf | {"layer": "open"}}}, tmp_path)[0].code == "part.outline_open"
    )
    issue = expect_refusal({"plate": {"dxf": dxf | {"layer": "nothing"}}}, tmp_path)[0]
    assert issue.code == "part.dxf"
    assert "cut" in issue.message
    (tmp_path / "junk.dxf").write_text("not a drawing")
    assert expect_refusal({"plate": {"dxf": dxf | {"file": "junk.dxf"}}}, tmp_path)[0].code == "part.dxf"
    assert (
        expect_refusal({"plate": {"dxf": dxf | {"file": "no.dxf"}}}, tmp_path)[0].code
        == "problem.missing_file"
    )


def test_a_guide_comes_from_a_drawing(tmp_path: Path) -> None:
    drawing(tmp_path / "plate.dxf")
    dxf = {"file": "plate.dxf", "unit": "mm", "layer": "guide"}
    own = {"name": "roof", "start": {"dxf": dxf}, "end": {"polyline_mm": [[0, 90, 5], [100, 90, 5]]}}
    (roof,) = make({"ruled": [own]}, tmp_path).ruled
    assert np.ptp(roof.start, axis=0).max() == pytest.approx(0.1, abs=1e-3)
    flat = {**own, "start": {"dxf": dxf | {"z_mm": 5}}}
    assert make({"ruled": [flat]}, tmp_path).ruled
    every = {**own, "start": {"dxf": {"file": "plate.dxf", "unit": "mm"}}}
    assert expect_refusal({"ruled": [every]}, tmp_path)[0].code == "part.dxf"


def test_without_the_extra_a_drawing_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawing(tmp_path / "plate.dxf")
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    (issue,) = expect_refusal({"plate": {"dxf": {"file": "plate.dxf", "unit": "mm"}}}, tmp_path)
    assert issue.code == "part.extra_missing"
    assert "tandem-planner[cad]" in issue.message


def test_outlines_beside_one_another_keep_the_order_in_which_they_are_given() -> None:
    upper, lower = circle(20, 70, 15), circle(20, 20, 15)
    for given, first in (((upper, lower), 0.07), ((lower, upper), 0.02)):
        part = make({"plate": {"outlines": list(given)}, "in_stock": {}})
        assert [r.name for r in part.ruled] == ["outline_a", "outline_b"]
        assert part.ruled[0].start[:, 1].mean() == pytest.approx(first, abs=1e-6)
