"""Several curves of one drawing: read, named and refused by the planner, read again by the proof."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.issues import Issue, TandemError
from planner.processes import registry
from planner.processes.trim.claims import TrimsSheet
from planner.processes.trim.plan.operation import Trim, every_outline
from planner.processes.trim.proof.outlines import cutting_order, expand_drawings, plan_curve, resolve_claims
from planner.proof.context import Context
from planner.proof.part_files import UnreadError
from planner.proof.rule_order import ORDER
from planner.proof.rule_table import built_in
from tests.processes.trim.plan.small_trim import Job, problem
from tests.rhino_files import Model

rhino3dm = pytest.importorskip("rhino3dm")
ezdxf = pytest.importorskip("ezdxf")
CIRCLES = ((0.0, 0.0, 8.0), (20.0, 0.0, 3.0), (-20.0, 0.0, 3.0))
"""Middles and radii of the circles on the layer CUT [mm]."""


def drawing(folder: Path, unit: float = 1.0, extra: Any = None) -> None:
    """Three circles on CUT, a square of four lines on SLOTS, and a line on NOTES, in 1/unit mm."""
    made = ezdxf.new(units=0)
    space = made.modelspace()
    for x, y, r in CIRCLES:
        space.add_circle((x / unit, y / unit), r / unit, dxfattribs={"layer": "CUT"})
    corners = [(-3, 12), (3, 12), (3, 18), (-3, 18), (-3, 12)]
    for a, b in itertools.pairwise(corners):
        ends = [(x / unit, y / unit) for x, y in (a, b)]
        space.add_line(*ends, dxfattribs={"layer": "SLOTS"})
    space.add_line((0, 30), (10, 30), dxfattribs={"layer": "NOTES"})
    if extra is not None:
        extra(space)
    made.saveas(folder / "apertures.dxf")


def outline(**fields: Any) -> dict[str, Any]:
    own = {"file": "apertures.dxf", "unit": "mm", "layers": ["CUT", "SLOTS"], **fields}
    return {"name": "a", "drawing": own}


def job(folder: Path, *outlines: dict[str, Any], **fields: Any) -> Any:
    defaults: dict[str, Any] = {"lead": {"length_mm": 1.5}, "pierce": {"off_mm": 1.0}, "shape_tol_mm": 0.3}
    return registry.job(problem(folder, outlines=list(outlines), **{**defaults, **fields}), 0)


def refused(folder: Path, *outlines: dict[str, Any]) -> list[Issue]:
    with pytest.raises(TandemError) as error:
        job(folder, *outlines).targets()
    return list(error.value.issues)


def claim_of(trim_job: Any) -> TrimsSheet:
    (own,) = [claim for claim in trim_job.claims() if isinstance(claim, TrimsSheet)]
    return own


def test_each_curve_is_cut_under_its_own_number(tmp_path: Path) -> None:
    drawing(tmp_path)
    made = job(tmp_path, outline())
    names = dict.fromkeys(s.name for s in made.targets().segment if s.kind == "trim")
    assert list(names) == ["a_1", "a_2", "a_3", "a_4"]


@pytest.mark.parametrize(("unit", "mm"), [("mm", 1.0), ("cm", 10.0), ("in", 25.4)])
def test_planner_and_proof_read_the_same_curves(tmp_path: Path, unit: str, mm: float) -> None:
    drawing(tmp_path, mm)
    made = job(tmp_path, outline(unit=unit))
    assert isinstance(made.operation, Trim)
    planned = every_outline(made.operation)
    read = expand_drawings(claim_of(made)).outlines
    assert [one.name for one in read] == [one.name for one, _ in planned] == ["a_1", "a_2", "a_3", "a_4"]
    for (x, y, r), one in zip(CIRCLES, read, strict=False):
        assert np.linalg.norm(plan_curve(one) - 1e-3 * np.array([x, y]), axis=1) == pytest.approx(
            1e-3 * r, abs=1e-8
        )
    for (_, points), one in zip(planned, read, strict=True):
        spans = [np.ptp(ring[:, :2], axis=0) for ring in (points, plan_curve(one))]
        assert spans[0] == pytest.approx(spans[1], abs=5e-6)


def test_what_is_left_out_of_a_drawing_and_another_unit_are_told(tmp_path: Path) -> None:
    """Once of all layers of one file, as of outlines of plates (nothing was said)."""

    def more(space: Any) -> None:
        space.add_text("no. 7", dxfattribs={"layer": "CUT"})
        space.add_circle((0, -20), 3, dxfattribs={"layer": "CUT", "invisible": 1})
        space.doc.header["$INSUNITS"] = 1

    drawing(tmp_path, extra=more)
    one = {"name": "b", "curve": {"dxf": {"file": "one.dxf", "unit": "mm"}}}
    single = ezdxf.new(units=1)
    single.modelspace().add_circle((0, -20), 2)
    single.saveas(tmp_path / "one.dxf")
    found = job(tmp_path, outline(), one).targets().issues
    assert sorted((note.code, str(note.severity)) for note in found) == [
        *[("part.dxf_left_out", "note")] * 2,
        *[("part.dxf_unit", "warning")] * 2,
    ]
    (reported, other) = [note for note in found if note.code == "part.dxf_unit"]
    assert "apertures.dxf states lengths in in ($INSUNITS)" in reported.message
    assert other.field == "operations.outlines.b.dxf"


def test_a_drawing_that_was_changed_is_read_anew(tmp_path: Path) -> None:
    """In a notebook, or a service, a process goes on while CAD writes the file again."""
    drawing(tmp_path)
    before = every_outline(job(tmp_path, outline()).operation)
    drawing(tmp_path, extra=lambda space: space.add_circle((0, -20), 3, dxfattribs={"layer": "CUT"}))
    made = job(tmp_path, outline())
    assert (
        len(every_outline(made.operation)) == len(before) + 1 == len(expand_drawings(claim_of(made)).outlines)
    )


def test_inner_curves_come_first_and_layers_choose(tmp_path: Path) -> None:
    def rim(space: Any) -> None:
        space.add_circle((0, 0), 36, dxfattribs={"layer": "RIM"})

    drawing(tmp_path, extra=rim)
    outside = {**outline(layers=["RIM"]), "name": "rim", "drops": "outside", "joints": 3}
    made = job(tmp_path, outside, outline(layers=["CUT"]))
    names = list(dict.fromkeys(s.name for s in made.targets().segment if s.kind == "trim"))
    assert names == ["a_1", "a_2", "a_3", "rim_1_p1", "rim_1_p2", "rim_1_p3"]
    whole = expand_drawings(claim_of(made))
    assert [whole.outlines[k].name for k in cutting_order(whole)] == ["a_1", "a_2", "a_3", "rim_1"]


def test_an_open_curve_is_refused_with_its_ends(tmp_path: Path) -> None:
    drawing(tmp_path)
    (issue,) = refused(tmp_path, outline(layers=None))
    assert issue.code == "trim.open" and issue.value == pytest.approx(10.0)
    assert "a_5" in issue.message and "(0.00, 30.00) to (10.00, 30.00)" in issue.message
    claims = job(tmp_path, outline(layers=None)).claims()
    _, unread = resolve_claims({"cut": tuple(claims)})
    assert "verify.trim_cut" in {one.code for one in unread}


@pytest.mark.parametrize(
    ("circle", "code"),
    [((6, 0, 4), "trim.crosses"), ((0, 0, 8), "trim.crosses"), ((0, 0, 3), "trim.in_waste")],
)
def test_curves_that_cross_or_make_no_sense_are_refused(tmp_path: Path, circle: Any, code: str) -> None:
    x, y, r = circle

    def more(space: Any) -> None:
        space.add_circle((x, y), r, dxfattribs={"layer": "CUT"})

    drawing(tmp_path, extra=more)
    found = refused(tmp_path, outline(layers=["CUT"]))
    assert {issue.code for issue in found} == {code}
    assert any("a_1" in issue.message and "a_4" in issue.message for issue in found)


def test_names_that_cannot_be_told_apart_and_layers_that_are_not_there(tmp_path: Path) -> None:
    drawing(tmp_path)
    other = {"name": "A_1", "circle": {"at_mm": [0, 20], "diameter_mm": 6}}
    found = refused(tmp_path, outline(layers=["CUT"]), other)
    assert [issue.code for issue in found] == ["problem.field"] and "A_1" in found[0].message
    found = refused(tmp_path, outline(layers=["CUTS"]))
    assert [issue.code for issue in found] == ["part.dxf"] and "CUT" in found[0].message
    with pytest.raises(TandemError):
        problem(tmp_path, outlines=[{**outline(), "circle": {"at_mm": [0, 0], "diameter_mm": 6}}])


def test_a_claim_that_names_no_file_is_not_taken_for_no_curves(tmp_path: Path) -> None:
    drawing(tmp_path)
    claim = claim_of(job(tmp_path, outline()))
    bare = dataclasses.replace(
        claim.outlines[0], drawn=dataclasses.replace(claim.outlines[0].drawn, file=None)
    )
    with pytest.raises(UnreadError):
        expand_drawings(dataclasses.replace(claim, outlines=(bare,)))
    nothing = dataclasses.replace(claim.outlines[0].drawn, layers=("NOTHING",))
    none = dataclasses.replace(claim.outlines[0], drawn=nothing)
    with pytest.raises(UnreadError):
        expand_drawings(dataclasses.replace(claim, outlines=(none,)))


def test_curves_of_a_rhino_file_are_cut_alike(tmp_path: Path) -> None:
    """In inches, on a layer in a layer; what is hidden, and what is on others, is not."""
    created_model = Model("Inches")
    created_model.layer("work")
    created_model.layer("cut", parent="work")
    created_model.layer("off", parent="work", visible=False)
    for layer in ("cut", "off"):
        for x, y, r in CIRCLES:
            centre = rhino3dm.Point3d(x / 25.4, y / 25.4, 0.0)
            created_model.add(rhino3dm.NurbsCurve.CreateFromCircle(rhino3dm.Circle(centre, r / 25.4)), layer)
    created_model.write(tmp_path / "apertures.3dm")
    drawing(tmp_path)
    both = []
    one = {"curve": {"rhino": {"file": "apertures.3dm", "layer": "work::cut"}}}
    for own in (outline(layers=["CUT"]), outline(file="apertures.3dm", unit=None, layers=["work::cut"])):
        made_job = job(tmp_path, own)
        whole = expand_drawings(claim_of(made_job))
        assert [row.name for row in whole.outlines] == ["a_1", "a_2", "a_3"]
        both.append([plan_curve(row) for row in whole.outlines])
        for (_, points), (x, y, r) in zip(every_outline(made_job.operation), CIRCLES, strict=True):
            assert np.abs(np.hypot(*(1e3 * points[:, :2] - [x, y]).T) - r).max() < 3e-3
    for ring, (x, y, r) in zip(both[1], CIRCLES, strict=True):
        assert np.abs(np.hypot(*(1e3 * ring - [x, y]).T) - r).max() < 2e-3
    found = refused(tmp_path, {"name": "a", **one})
    assert [issue.code for issue in found] == ["part.rhino"] and "holds 3 curves" in found[0].message


def test_a_file_that_is_changed_meanwhile_is_read_again(tmp_path: Path) -> None:
    """Curves are cached, as a service reads the same problem many times."""
    for radius_mm in (5.0, 7.0):
        model = Model("Millimeters")
        model.layer("cut")
        circle = rhino3dm.Circle(rhino3dm.Point3d(0.0, 0.0, 0.0), radius_mm)
        model.add(rhino3dm.NurbsCurve.CreateFromCircle(circle), "cut")
        model.write(tmp_path / "hole.3dm")
        drawn = {"name": "a", "curve": {"rhino": {"file": "hole.3dm", "layer": "cut"}}}
        ((_, points),) = every_outline(job(tmp_path, drawn).operation)
        assert np.abs(1e3 * np.hypot(*points[:, :2].T) - radius_mm).max() < 3e-3


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"unit": None}, "a DXF file needs its unit"),
        ({"colour": "#ff0000"}, "name and colour are for Rhino files"),
        ({"layers": ["CUT", "cut"]}, "a layer is listed twice"),
    ],
)
def test_what_a_drawing_may_say(tmp_path: Path, fields: dict[str, Any], words: str) -> None:
    drawing(tmp_path)
    with pytest.raises(TandemError, match=words):
        problem(tmp_path, outlines=[outline(**fields)])


@pytest.mark.long
def test_a_drawing_is_planned_and_proven_and_a_curve_that_moves_later_is_told(tmp_path: Path) -> None:
    def cuts(dx: float) -> None:
        made = ezdxf.new()
        made.modelspace().add_circle((dx, 0), 8, dxfattribs={"layer": "CUT"})
        made.modelspace().add_circle((20, 0), 3, dxfattribs={"layer": "NOTES"})
        made.saveas(tmp_path / "apertures.dxf")

    cuts(0.0)
    planned = Job(tmp_path, outlines=[outline(layers=["CUT"])])
    assert any("trim_a_1" in text for text in planned.programs.values())
    assert not any("trim_a_2" in text for text in planned.programs.values())
    proof = planned.prove(planned.programs, None)
    assert proof.issues == () and proof.ok
    cuts(1.0)  # the programs are those of the drawing as it was
    claims, unread = resolve_claims(planned.prover.claims)
    context = Context(planned.problem, claims, planned.programs, unread)
    codes = {issue.code for code in ORDER["slots"] for issue in built_in()[code](context).issues}
    assert "verify.trim_kept" in codes
