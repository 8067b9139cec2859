"""Areas that a round wire cannot reach, against closed forms and shapely's offset curves.

Whole jobs are tested too: a planner that leaves more material is caught.
"""

from __future__ import annotations

import dataclasses
import types
from pathlib import Path

import numpy as np
import pytest
import shapely

import planner
from planner.claims.segments import Segment
from planner.problem import Problem
from planner.processes import registry
from planner.processes.hotwire.claims import FollowsRulings, KerfCurve
from planner.processes.hotwire.plan.straight import cut
from planner.processes.hotwire.plan.straight.offset import WireOffset
from planner.processes.hotwire.proof.cut_surface import unreachable_distance
from planner.processes.hotwire.proof.rules import cut_part
from planner.proof.prove import prove
from planner.proof.verdict import CutFace
from tests.processes.hotwire.plan import foam_blocks as blocks
from tests.processes.hotwire.proof.rules.test_straight_wire_slits import RIM, problem

HALF = 0.001


def claim(points: np.ndarray, left: float = 0.02, ruling_offset: float = 0.0) -> FollowsRulings:
    """A surface over a line (M, 2) of x and z, with rulings along y that may lean."""
    start = np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]])
    end = start + np.array([ruling_offset, 0.2, 0.0])
    return FollowsRulings(Segment("cut", "x"), start, end, KerfCurve.constant(2.0 * HALF), 0.0003, left)


@pytest.mark.parametrize("turn", np.deg2rad([20.0, 60.0, 90.0, 120.0, 150.0]))
@pytest.mark.parametrize("ruling_offset", [0.0, 0.03])
def test_corners_have_their_closed_form(turn: float, ruling_offset: float) -> None:
    """At the vertex h (1 / cos (t/2) - 1), along a side of the corner as far as its arc's tangent."""
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    line = np.array([[-0.1 * c, 0.1 * s], [0.0, 0.0], [0.1 * c, 0.1 * s]])
    along = np.array([0.0, 0.3, 0.9, 1.1]) * HALF * np.tan(0.5 * turn)
    places = np.column_stack([along * c, 0.0 * along, along * s])
    own = claim(line, ruling_offset=ruling_offset)
    found = unreachable_distance(own, places, HALF)
    squeeze = 1.0 / np.cos(np.arctan2(ruling_offset, 0.2)) if ruling_offset else 1.0
    # the middle of the slot, from the vertex: across rulings that lean in x the line is narrower in x
    flat = line / [squeeze, 1.0]
    at = np.column_stack([along * c, along * s]) / [squeeze, 1.0]
    solid = shapely.Polygon([*flat, (0.2, -0.2), (-0.2, -0.2)])
    free = solid.buffer(HALF, quad_segs=512).boundary
    expected = shapely.distance(shapely.points(at), free) - HALF
    assert found == pytest.approx(np.maximum(expected, 0.0), abs=6e-5)
    if not ruling_offset:
        assert found[0] == pytest.approx(HALF / c - HALF, abs=6e-5)


@pytest.mark.parametrize("seed", range(4))
def test_crooked_lines_as_shapely_has_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(-0.03, 0.03, 14))
    line = np.column_stack([x, rng.uniform(0.0, 0.006, len(x))])
    line = np.concatenate([[[-0.06, 0.0]], line, [[0.06, 0.0]]])
    solid = shapely.Polygon([*line, (0.06, -0.1), (-0.06, -0.1)])
    free = solid.buffer(HALF, quad_segs=512).exterior
    t = rng.uniform(0.1, 0.9, 60)
    string = shapely.LineString(line)
    flat = np.array([string.interpolate(v, normalized=True).coords[0] for v in t])
    places = np.column_stack([flat[:, 0], np.full(len(flat), 0.07), flat[:, 1]])
    expected = np.maximum(shapely.distance(shapely.points(flat), free) - HALF, 0.0)
    found = unreachable_distance(claim(line), places, HALF)
    assert expected.max() > 3e-4
    assert found == pytest.approx(expected, abs=1e-4)


def test_a_groove_that_is_narrower_than_the_slot_is_not_reached_at_all() -> None:
    line = np.array(
        [[-0.1, 0.0], [-0.0005, 0.0], [-0.0005, -0.05], [0.0005, -0.05], [0.0005, 0.0], [0.1, 0.0]]
    )
    found = unreachable_distance(
        claim(line, left=0.005), np.array([[-0.0005, 0.0, -0.04], [-0.0005, 0.0, -0.002]]), HALF
    )
    assert np.isinf(found[0])
    above = HALF * np.cos(np.pi / 6.0)  # as far in between its edges as the slot comes
    assert found[1] == pytest.approx(np.hypot(0.0005, 0.002 + above) - HALF, abs=6e-5)


def test_what_stands_farther_than_may_be_left_is_off_without_a_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A part that is another one than was cut is refused at once; what counts as good is as it was."""
    line = np.array([[-0.1, 0.1], [0.0, 0.0], [0.1, 0.1]])
    ruled = claim(line, left=0.002)
    x = np.linspace(-0.05, 0.05, 101)
    points = np.column_stack([x, np.full(len(x), 0.1), np.abs(x)])
    deviation = np.where(np.abs(x) < 0.0006, 0.0004, np.where(x > 0.0, 0.02, 0.0))
    area = np.full(len(x), 1e-4)
    fraction = float((np.abs(deviation) <= 0.0003).mean())
    face = CutFace(
        ruled.segment, points, deviation, area, 0.0003, fraction, 0.99, 0.0, 0.02, speed=np.ones(1)
    )
    asked = []
    searched = cut_part.unreachable_distance

    def record(rulings: FollowsRulings, points: np.ndarray, half: float) -> np.ndarray:
        asked.append(len(points))
        return searched(rulings, points, half)

    monkeypatch.setattr(cut_part, "unreachable_distance", record)
    context = types.SimpleNamespace(claims_of=lambda kind: (ruled,))
    found = cut_part._with_unreachable_parts(
        context, types.SimpleNamespace(segment=ruled.segment, kerf=ruled.kerf), face
    )  # type: ignore[arg-type]
    assert asked == [1]  # the corner; the flank that stands 20 mm off is none of it
    assert found.share == pytest.approx(fraction + 1.0 / len(x))


DOVETAIL = [
    (-0.08, 0.02),
    (-0.08, 0.09),
    (-0.012, 0.09),
    (-0.02, 0.06),
    (0.02, 0.06),
    (0.012, 0.09),
    *RIM[2:],
]


def test_what_a_planner_leaves_beside_that_is_caught(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plate with a dovetail slot is proven; one whose wire leaves out some millimetres beside the corner is
    not, nor one of which less may stay than a round wire leaves."""
    made = problem(tmp_path, [blocks.prism("rim", DOVETAIL, closed=True)], kerf_mm=2.0, shape_tol_mm=0.2)
    outcome = planner.plan(made)
    assert outcome.verified, outcome.proof.issues
    assert any(issue.code == "straight.corner" for issue in outcome.plan.issues)

    followed = cut.fit_offset

    def short(*given: object) -> WireOffset:
        on: WireOffset = followed(*given)  # type: ignore[arg-type]
        foot = on.row.foot.start
        near = np.linalg.norm(foot[:, [0, 2]] - [0.02, 0.06], axis=1)
        keep = (near > 0.004) | (near == np.sort(near)[np.searchsorted(np.sort(near), 0.0035)])
        keep[[0, -1]] = True
        return dataclasses.replace(on, row=on.row[keep], half=on.half[keep], speed=on.speed[keep])

    monkeypatch.setattr(cut, "fit_offset", short)
    for name in ("check_cut", "check_inner_corners", "check_path"):
        monkeypatch.setattr("planner.processes.hotwire.plan.straight.job." + name, lambda *_: iter(()))
    assert "verify.rulings" in {issue.code for issue in planner.plan(made).proof.issues}


def test_more_than_may_stay_is_caught(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "planner.processes.hotwire.plan.straight.job.check_inner_corners", lambda *_: iter(())
    )
    rim = blocks.prism("rim", DOVETAIL, closed=True)
    outcome = planner.plan(problem(tmp_path, [rim], kerf_mm=2.0, shape_tol_mm=0.1, left_mm=0.2))
    assert {issue.code for issue in outcome.proof.issues} == {"verify.rulings"}
    assert "round wire leaves" in outcome.proof.issues[0].message


GROOVE = [(0.075, 0.09), (0.075, 0.078), (0.076, 0.078), (0.076, 0.09), *RIM[2:]]
"""A groove of half the slot's width, 12 mm deep, behind a wall of 4 mm."""


@pytest.mark.parametrize("left", [0.005, 0.02])
def test_a_slot_behind_a_wall_reaches_nothing_of_a_groove(left: float) -> None:
    """By hand: as far in between the edges of its mouth as the slot comes, whatever lies behind the wall."""
    line = np.array([*RIM[:2], *GROOVE])
    found = unreachable_distance(
        claim(line, left), np.array([[0.076, 0.0, 0.080], [0.076, 0.0, 0.088]]), HALF
    )
    above = HALF * np.cos(np.pi / 6.0)
    mouth = np.hypot(0.0005, np.array([0.010, 0.002]) + above) - HALF
    assert found[1] == pytest.approx(mouth[1], abs=6e-5)
    assert found[0] == (np.inf if left < 0.01 else pytest.approx(mouth[0], abs=6e-5))


@pytest.mark.long
def test_a_groove_that_is_left_whole_is_caught(tmp_path: Path) -> None:
    """Programs of a plate without a groove, held against the plate with it."""

    def problem_of(line: list[tuple[float, float]]) -> Problem:
        rim = blocks.prism("rim", line, closed=True)
        return problem(tmp_path, [rim], kerf_mm=2.0, shape_tol_mm=0.2, left_mm=5.0)

    plain, grooved = problem_of(RIM), problem_of([*RIM[:2], *GROOVE])
    programs = planner.plan(plain).programs
    assert prove(plain, registry.claims(plain), programs).ok
    issues = prove(grooved, registry.claims(grooved), programs).issues
    assert {issue.code for issue in issues} == {"verify.rulings"}
    assert "round wire leaves" in issues[0].message
