"""Every reason for which a bent wire cannot do its job has its code, in bundled and in small problems."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from planner.issues import Issue, Severity, TandemError
from planner.processes.hotwire.plan import wire
from planner.processes.hotwire.plan.elastic import check, job, path
from planner.processes.hotwire.plan.elastic import sweep_screening as elastic_sweep
from planner.processes.hotwire.plan.elastic.check import TargetFigures
from tests.processes.hotwire.plan import panels


def make(wire_of: dict[str, Any] | None = None, **more: Any) -> dict[str, Issue]:
    with pytest.raises(TandemError) as caught:
        job.ElasticJob(panels.operation(wire_of, **more), panels.setup(), panels.part()).targets()
    return {issue.code: issue for issue in caught.value.issues}


@pytest.mark.long
def test_a_wire_too_short_for_its_margins_says_the_length_that_would_do() -> None:
    steel = {"material": "spring_steel", "diameter_mm": 1.5, "length_mm": 215, "temperature_c": 300}
    issue = make(steel)["wire.too_short"]
    assert issue.limit is not None
    assert issue.hint is not None
    assert 215 < issue.limit < 260
    enough = steel | {"length_mm": 5 * np.ceil(issue.limit / 5)}
    assert job.ElasticJob(panels.operation(enough), panels.setup(), panels.part()).targets().count > 50


@pytest.mark.long
def test_a_wire_too_thick_says_the_thickness_that_would_do() -> None:
    issue = make({"material": "spring_steel", "diameter_mm": 3, "length_mm": 520, "temperature_c": 300})
    assert issue["wire.curvature"].unit == "mm"
    assert "1.5" in str(issue["wire.curvature"].hint)


def test_what_the_wire_does_in_the_air_and_between_targets_is_checked() -> None:
    op, block, part = panels.operation(), panels.stock(), panels.part()
    steel = wire.make_wire("spring_steel", diameter_mm=1.5, temperature_c=300)
    mesh = job._triangle_mesh(part.front)
    cut = job._fit_cut(op, "front", mesh, 90.0, steel.load_over_stiffness * block.gravity, block.box)
    route = path.plan_route([cut.face], block.box, 0.02, 0.001, 0.005, False)
    figures = check.measure_targets(route, steel, block.box)
    assert check.check_job(op, steel, route, [cut], figures, block.box) == []
    into = dataclasses.replace(route, wires=route.wires.shifted(np.array([0.0, 0.03, 0.0])))
    codes = {i.code for i in check.check_job(op, steel, into, [cut], figures, block.box)}
    assert codes == {"wire.touches"}
    straight = dataclasses.replace(
        route.wires,
        curvature_and_force=np.zeros_like(route.wires.curvature_and_force),
        gravity=np.zeros_like(route.wires.gravity),
    )
    (taut,) = check._taut_issues(op, dataclasses.replace(route, wires=straight))
    assert taut.code == "wire.end_error"
    off, miss = np.zeros(len(route.wires)), np.zeros(len(route.wires))
    assert list(job._drive_issues(op, route, off, miss)) == []
    miss[30] = np.inf
    assert [i.code for i in job._drive_issues(op, route, off, miss)] == ["wire.between_targets"]


def figures(in_plane: float, out_of_plane: float) -> TargetFigures:
    one = np.ones(3)
    return TargetFigures(one * in_plane, one * out_of_plane, one, one, 0 * one, one, one, np.arange(3))


@pytest.mark.parametrize(
    ("values", "want"),
    [
        ((0.5, 0.5), []),
        ((0.03, 0.5), [Severity.WARNING]),
        ((0.5, -0.1), [Severity.ERROR]),
        ((-1.0, -1.0), [Severity.ERROR, Severity.ERROR]),
    ],
)
def test_a_shape_near_snapping_is_a_warning_and_one_that_snaps_an_error(
    values: tuple[float, float], want: list[Severity]
) -> None:
    op, block, part = panels.operation(), panels.stock(), panels.part()
    steel = wire.make_wire("spring_steel", diameter_mm=1.5, temperature_c=300)
    cut = job._fit_cut(
        op,
        "front",
        job._triangle_mesh(part.front),
        90.0,
        steel.load_over_stiffness * block.gravity,
        block.box,
    )
    route = path.plan_route([cut.face], block.box, 0.02, 0.001, 0.005, False)
    issues = list(check._stability_issues(route, figures(*values)))
    assert [i.code for i in issues] == ["wire.unstable"] * len(want)
    assert [i.severity for i in issues] == want


def test_of_sweeps_that_will_do_the_one_with_short_sections_comes_first() -> None:
    sweep = elastic_sweep.SweepCandidate
    tried = [sweep(90.0, 1e-4, 1e-5, 0.4), sweep(0.0, 1e-4, 1e-4, 0.3), sweep(45.0, 1e-5, 1e-5, 0.2)]
    assert elastic_sweep.rank_candidates(tried, 1e-3)[0].degrees == 0.0
    assert elastic_sweep.rank_candidates(tried, 1e-5)[0].degrees == 45.0
    never = sweep(90.0, 0.0, 0.0, 0.1, reason="it would snap")
    assert elastic_sweep.rank_candidates([never, *tried], 1e-3)[-1] == never


@pytest.mark.parametrize(
    "change",
    [
        {"arms": ("left", "left")},
        {"faces": ("front", "front")},
        {"feed_mm_s": 2, "feed_min_mm_s": 3},
        {"speed": 3},
        {"sweep": "z"},
        {"shape_tol_mm": float("nan")},
        {"wire": {"material": "spring_steel", "length_mm": 500, "temperature_c": 300}},
        {"wire": {"material": "x", "diameter_mm": 1, "width_mm": 2, "length_mm": 500, "temperature_c": 300}},
        {"wire": {"material": "x", "thickness_mm": 3, "width_mm": 2, "length_mm": 500, "temperature_c": 300}},
    ],
)
def test_a_contradictory_operation_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        panels.operation(**change)


def test_a_block_that_an_arm_holds_is_not_for_an_elastic_wire() -> None:
    own = panels.setup()
    held = dataclasses.replace(own, stock=dataclasses.replace(own.stock, held_by="right"))
    with pytest.raises(TandemError) as caught:
        job.ElasticJob(panels.operation(), held, panels.part()).targets()
    (issue,) = caught.value.issues
    assert issue.code == "wire.held"
    assert "nobody" in issue.message
