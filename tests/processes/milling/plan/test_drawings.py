"""Engraved curves of Rhino files and drawings: planner and proof read, order and count them alike.

The curves are milled too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from planner import pipeline
from planner.issues import TandemError
from planner.processes import registry
from planner.processes.milling.plan import point_cut
from planner.processes.milling.plan.operation import EngraveCut
from planner.proof.part_files.drawn_curves import explode_drawings
from planner.reading import problem as problem_file
from planner.reading import rhino
from tests.processes.milling.plan import small_mill
from tests.rhino_files import Model, curve, sample_curve

rhino3dm = pytest.importorskip("rhino3dm")
WAVE = [(-30, -10, 0), (-10, 12, 5), (10, -12, 0), (30, 10, 0)]


def point(x: float, y: float) -> Any:
    return rhino3dm.Point3d(x, y, 0.0)


def arc(x: float, y: float, r: float, first: float, last: float) -> Any:
    """Part of a circle, from one angle [deg] to another."""
    way = np.deg2rad([first, 0.5 * (first + last), last])
    return rhino3dm.NurbsCurve.CreateFromArc(
        rhino3dm.Arc(*(point(x + r * np.cos(a), y + r * np.sin(a)) for a in way))
    )


def pattern(folder: Path, shift: float = 0.0) -> None:
    """Write a Rhino file with the curves to engrave.

    The layer "lines" has a wave, a hook of three pieces (the middle one first, the last one drawn backwards),
    and a ring of two halves. A circle is on a layer that is off.
    """
    created_model = Model("Millimeters")
    created_model.layer("lines")
    created_model.layer("old", visible=False)
    created_model.add(curve([(x, y + shift, z) for x, y, z in WAVE]), "lines", "wave")
    created_model.add(rhino3dm.LineCurve(point(-20, -20), point(0, -20)), "lines", "hook")
    created_model.add(arc(0, -15, 5, 90, -90), "lines", "hook")
    created_model.add(rhino3dm.LineCurve(point(-20, -20), point(-20, -12)), "lines", "hook")
    created_model.add(arc(30, -15, 6, 180, 360), "lines", "ring")
    created_model.add(arc(30, -15, 6, 180, 0), "lines", "ring")
    created_model.add(rhino3dm.NurbsCurve.CreateFromCircle(rhino3dm.Circle(point(0, 0), 5.0)), "old")
    created_model.write(folder / "pattern.3dm")


def cut(folder: Path, *engrave: dict[str, Any], **fields: Any) -> EngraveCut:
    words = {"engrave": list(engrave), "depth_mm": 0.5, **fields}
    return EngraveCut.model_validate(words, context={"folder": folder})


def test_planner_and_proof_run_the_curves_alike(tmp_path: Path) -> None:
    pattern(tmp_path)
    own = cut(tmp_path, {"drawing": {"file": "pattern.3dm", "layers": ["lines"]}})
    ours = [engraved.points for engraved in point_cut._engraved_curves(own, "engrave")[0]]
    theirs = [
        1e-3 * np.array(one.points_mm)
        for one in explode_drawings(tuple(c.to_drawn_curve() for c in own.engrave))
    ]
    assert len(ours) == len(theirs) == 3
    begins = [(-30, -10), (-20, -12), (24, -15)]
    ends = [(30, 10), (0, -10), (24, -15)]
    for one, other, begin, end in zip(ours, theirs, begins, ends, strict=True):
        for points in (one, other):
            assert 1e3 * points[0, :2] == pytest.approx(begin, abs=1e-6)
            assert 1e3 * points[-1, :2] == pytest.approx(end, abs=1e-6)
        assert cKDTree(one).query(other)[0].max() < 0.2e-3
    assert ours[2][len(ours[2]) // 4, 1] < -15e-3 and theirs[2][len(theirs[2]) // 4, 1] < -15e-3  # first half
    true = 1e-3 * sample_curve(curve(WAVE), 4000)
    assert cKDTree(true).query(ours[0])[0].max() < 0.02e-3


def test_axis_curves_are_counted_with_those_of_drawings(tmp_path: Path) -> None:
    pattern(tmp_path)
    drawing = {"drawing": {"file": "pattern.3dm", "layers": ["lines"]}}
    own = cut(tmp_path, drawing, axis="curves", axis_curves=[{"polyline_mm": [[0, 0, 50], [9, 0, 50]]}])
    problem = small_mill.problem(tmp_path, small_mill.PANEL, small_mill.BALL, cuts=[own.model_dump()])
    with pytest.raises(TandemError, match="axis_curves are 1 for 3 curves"):
        pipeline.plan(problem)


def test_a_layer_of_a_rhino_file_is_engraved_and_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And a planner that reads a curve 0.2 mm beside is not believed."""
    pattern(tmp_path)
    words = {"engrave": [{"rhino": {"file": "pattern.3dm", "name": "wave"}}], "depth_mm": 0.5}
    words["engrave"].append({"drawing": {"file": "pattern.3dm", "name": "ring"}})
    problem = small_mill.problem(tmp_path, small_mill.PANEL, small_mill.BALL, cuts=[words])
    copy = problem_file.bundle(problem)
    assert sum(content == (tmp_path / "pattern.3dm").read_bytes() for content in copy.values()) == 1
    outcome = pipeline.plan(problem)
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    names = {s.name for s in registry.job(problem, 0).targets().segment if s.kind == "mill"}
    assert names == {"pattern_c1", "pattern_c2"}
    read = rhino.read_curves

    def read_shifted(*given: Any) -> Any:
        found, notes = read(*given)
        return [
            rhino.FileCurve(one.points + np.array([0.0, 0.2e-3, 0.0]), one.closed) for one in found
        ], notes

    monkeypatch.setattr(rhino, "read_curves", read_shifted)
    proof = pipeline.plan(pipeline.load(tmp_path / "problem.yaml")).proof
    assert "verify.mill_path" in {issue.code for issue in proof.issues}
