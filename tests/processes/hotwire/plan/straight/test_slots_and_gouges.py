"""Areas that a straight wire must not cut: neighbours of its slot, the part on its lead-in and lead-out."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from pydantic import ValidationError

from planner.geometry.arrays import RuledSurface
from planner.issues import Issue, Severity, TandemError
from planner.problem import Part
from planner.processes.hotwire.plan.straight import job
from planner.processes.hotwire.plan.straight.order import contour_depths, nominal_surfaces
from tests.processes.hotwire.plan import foam_blocks as blocks

HALF = 0.00075
WALL = [(0.0, 0.1), (0.0, 0.05)]
FLOOR = [(0.0, 0.05), (-0.15, 0.05)]


def issues(part: Part, **more: object) -> list[Issue]:
    try:
        return list(job.StraightJob(blocks.operation(**more), blocks.setup(), part).targets().issues)
    except TandemError as error:
        return list(error.issues)


def errors(part: Part, **more: object) -> set[str]:
    return {issue.code for issue in issues(part, **more) if issue.severity is Severity.ERROR}


def square(
    name: str, x: float, half: float, hole: bool = False, z: float = 0.05, wide: float = 0.0
) -> RuledSurface:
    """A square of half a side about (x, z), with the part inside or, for a hole, around it; ``wide``: how
    much larger it is at the end of its rulings."""
    way = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)])[:: -1 if hole else 1]
    ruled = blocks.prism(name, way * half + [x, z], closed=True, hole=hole)
    end = ruled.end.copy()
    end[:, [0, 2]] += wide * way
    return RuledSurface(name, ruled.start, end, ruled.corner, True, hole)


@pytest.mark.parametrize(("gap", "good"), [(0.0005, False), (0.0012, False), (0.0014, True), (0.004, True)])
def test_a_gap_narrower_than_the_slot_is_refused_with_the_neighbours_name(gap: float, good: bool) -> None:
    """A share of the tolerance, 0.24 mm, may be lost."""
    part = blocks.part(square("one", -0.03, 0.02), square("two", 0.01 + gap, 0.02))
    found = [i for i in issues(part, shape_tol_mm=0.8) if i.code == "straight.crossing"]
    assert bool(found) != good
    if found:
        assert "two" in found[0].message
        assert found[0].value == pytest.approx(1e3 * min(2 * HALF - gap, HALF), abs=0.02)


@pytest.mark.parametrize(("gap", "good"), [(0.0004, False), (0.0012, False), (0.0015, True)])
def test_strips_that_face_one_another_keep_the_slot_between_them(gap: float, good: bool) -> None:
    """The message's remedy: as far apart as the slot is wide."""
    low = blocks.prism("low", [(-0.15, 0.05), (0.15, 0.05)])
    high = blocks.prism("high", [(0.15, 0.05 + gap), (-0.15, 0.05 + gap)])
    found = [i for i in issues(blocks.part(low, high)) if i.code == "straight.crossing"]
    assert bool(found) != good
    if found:
        assert {i.field for i in found} == {"cut/low", "cut/high"}
        assert found[0].value == pytest.approx(1e3 * (2 * HALF - gap), abs=0.01)
        assert f"move them apart by {1e3 * (2 * HALF - gap):.2f} mm" in found[0].message


@pytest.mark.long
def test_surfaces_whose_wires_run_across_one_another_keep_the_slot_too() -> None:
    """A hole along x that comes within 0.4 mm of a strip along y, at its top."""
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    ring = np.column_stack([np.zeros(48), 0.02 * np.cos(angle), 0.0296 + 0.02 * np.sin(angle)])
    over = np.array([0.15, 0.0, 0.0])
    rod = RuledSurface("rod", ring - over, ring + over, np.zeros(48, dtype=bool), True)
    foam = blocks.prism("roof", [(0.15, 0.05), (-0.15, 0.05)])
    assert "straight.crossing" in errors(blocks.part(rod, foam))
    away = blocks.prism("roof", [(0.15, 0.0515), (-0.15, 0.0515)])
    assert "straight.crossing" not in errors(blocks.part(rod, away))


def test_neighbours_that_come_near_at_one_end_of_the_wire_alone_are_found_there() -> None:
    one, two = square("one", -0.03, 0.015, wide=0.0098), square("two", 0.01, 0.015)
    assert errors(blocks.part(one, two)) == {"straight.crossing"}
    assert not errors(blocks.part(square("one", -0.03, 0.015, wide=0.005), two))


def test_a_lead_that_is_given_must_not_take_from_another_piece() -> None:
    part = blocks.part(square("one", -0.05, 0.02), square("two", 0.04, 0.02))
    through = {"surface": "one", "lead": [1, 0, 0]}
    assert errors(part, cuts=[through]) == {"straight.lead"}
    assert not errors(part, cuts=[through | {"lead": [-1, 0, 0]}])


@pytest.mark.parametrize("lead", [[0, 1, 0], [0.1, 5, 0]])
def test_a_lead_along_the_wire_is_refused(lead: list[float]) -> None:
    assert errors(blocks.part(square("one", 0.0, 0.02)), cuts=[{"surface": "one", "lead": lead}]) == {
        "straight.lead"
    }


@pytest.mark.parametrize("name", ["lead", "last"])
def test_a_direction_of_no_length_is_refused(name: str) -> None:
    with pytest.raises(ValidationError, match=name):
        blocks.operation(cuts=[{"surface": "one", name: [0, 0, 0]}])


@pytest.mark.parametrize("flip", [False, True])
def test_a_strips_lead_comes_from_its_outer_side(flip: bool) -> None:
    way = [(-0.15, 0.05), (0.15, 0.06)]
    face = blocks.prism("face", way[::-1] if flip else way)
    up = -1.0 if flip else 1.0
    good, bad = ([{"surface": "face", "lead": [-up, 0, s * up * 1.0]}] for s in (1, -1))
    assert not errors(blocks.part(face), cuts=good)
    assert errors(blocks.part(face), cuts=bad) == {"straight.lead"}


def test_two_strips_at_an_inner_corner_would_go_on_through_the_part() -> None:
    """A rebate: a floor facing up and a wall over its end."""
    floor, wall = blocks.prism("floor", FLOOR[::-1]), blocks.prism("wall", WALL[::-1])
    assert errors(blocks.part(floor, wall)) == {"straight.lead"}
    one = blocks.prism("rebate", [FLOOR[1], FLOOR[0], WALL[0]])
    assert not errors(blocks.part(one))


@pytest.mark.long
def test_a_strip_may_cross_what_bounds_the_part_together_with_it() -> None:
    assert not errors(
        blocks.part(blocks.prism("top", [(-0.15, 0.06), (0.15, 0.06)]), square("side", 0.0, 0.03))
    )
    wedge = [
        blocks.prism("top", [(-0.15, 0.06), (0.15, 0.05)]),
        blocks.prism("sole", [(0.15, 0.06), (-0.15, 0.04)]),
    ]
    assert not errors(blocks.part(*wedge), spacers=True)


def test_the_inmost_is_cut_first_and_comes_to_be_told_through_which_slit() -> None:
    ring = [square("rim", 0.0, 0.045), square("gap", 0.0, 0.035, hole=True), square("core", 0.0, 0.02)]
    deep = [*ring, square("bore", 0.0, 0.008, hole=True)]
    assert contour_depths(deep) == [0, 1, 2, 3]
    part = blocks.part(*deep)
    order = [w.name for w in nominal_surfaces(blocks.operation(cuts="all"), blocks.setup(), part)]
    assert order == ["bore", "core", "gap", "rim"]
    found = issues(part)
    assert {i.field for i in found if i.code == "straight.slit"} == {"cut/bore", "cut/core", "cut/gap"}
    assert not [i for i in found if i.severity is Severity.ERROR]
    # the bore's slit passes the core as well as the rim
    length = {str(i.field): i.value or 0.0 for i in found if i.code == "straight.slit"}
    assert length["cut/bore"] == pytest.approx(22.0, abs=0.5)
    assert length["cut/gap"] == pytest.approx(10.0, abs=0.5)


def test_no_wire_of_a_job_takes_from_pieces_beside_one_another() -> None:
    """Against shapely: the slot of every wire, ways in and out and links too, leaves four squares whole."""
    part = blocks.part(
        *(
            square(n, x, 0.015, z=z)
            for n, x, z in (("a", -0.05, 0.02), ("b", -0.01, 0.02), ("c", -0.05, 0.06), ("d", -0.01, 0.06))
        )
    )
    targets = job.StraightJob(blocks.operation(), blocks.setup(), part).targets()
    pose = targets.pose["left"]
    level = (0.02 - pose[:, 1, 3]) / pose[:, 1, 0]
    way = (pose[:, :3, 3] + level[:, None] * pose[:, :3, 0])[:, [0, 2]]
    slot = shapely.LineString(way).buffer(HALF - 1e-5)
    for ruled in part.ruled:
        assert shapely.Polygon(ruled.start[:, [0, 2]]).intersection(slot).area < 1e-12
