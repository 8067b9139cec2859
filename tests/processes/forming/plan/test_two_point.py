"""Dies of two-point forming against the part."""

from __future__ import annotations

import numpy as np
import pytest

from planner.catalogue.materials import sheet_metal
from planner.geometry.mesh import TriangleMesh
from planner.issues import Severity
from planner.processes.forming.plan.contact import FormingPass
from planner.processes.forming.plan.passes import make_passes
from planner.processes.forming.plan.two_point import die_issues
from tests.processes.forming.plan.shapes import T0, cone, operation, tree_of, upside_down

TOLERANCE = 5e-5


def plan_two_point(kind: str, full: bool = True) -> tuple[list[FormingPass], TriangleMesh, object]:
    part = cone(45.0, 0.02, 0.05, 200)
    part = part if kind == "female" else upside_down(part)
    op = operation("tpif", die={"file": "die.stl", "unit": "mm", "kind": kind, "full": full})
    tree, order = tree_of(part)
    found = make_passes(tree, order, part, T0, op, sheet_metal("aluminium"))
    return list(found), TriangleMesh(part.vertices, part.faces), op.die


@pytest.mark.parametrize("kind", ["male", "female"])
def test_a_die_of_the_parts_own_face_fits(kind: str) -> None:
    found, mesh, die = plan_two_point(kind)
    assert [one.side for one in found] == [1]  # the tool is above, either way
    assert die_issues(found, die, mesh, T0, TOLERANCE) == ()  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["male", "female"])
def test_a_die_that_stands_in_the_part_is_refused_with_how_deep(kind: str) -> None:
    found, mesh, die = plan_two_point(kind)
    raised = TriangleMesh(mesh.vertices + np.array([0.0, 0.0, 0.6e-3]), mesh.faces)
    issues = die_issues(found, die, raised, T0, TOLERANCE)  # type: ignore[arg-type]
    assert [issue.code for issue in issues] == ["forming.die_gouge"]
    assert issues[0].severity is Severity.ERROR
    assert issues[0].value == pytest.approx(0.6, abs=0.02)


def test_only_a_full_die_must_be_at_the_walls() -> None:
    for full in (True, False):
        found, mesh, die = plan_two_point("female", full)
        lowered = TriangleMesh(mesh.vertices - np.array([0.0, 0.0, 2e-3]), mesh.faces)
        issues = die_issues(found, die, lowered, T0, TOLERANCE)  # type: ignore[arg-type]
        assert [issue.code for issue in issues] == (["forming.die_far"] if full else [])
        assert all(issue.severity is Severity.WARNING for issue in issues)
