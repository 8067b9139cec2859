"""Slits and leads of planned programs: the proof goes by the problem, not by the planner's choice.

Each fault is put into the planner itself, with its own checks switched off.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.issues import TandemError
from planner.pipeline import Outcome
from planner.problem import Problem
from planner.processes import registry
from planner.processes.hotwire.claims import CutsSurface
from planner.processes.hotwire.plan.straight import cut as straight_cut
from planner.processes.hotwire.plan.straight import job
from planner.processes.hotwire.plan.straight.cut import StraightCut
from planner.processes.hotwire.plan.straight.order import WireLines
from planner.processes.hotwire.proof import walls
from planner.proof.prove import Prover
from tests.processes.hotwire.plan import foam_blocks as blocks
from tests.processes.hotwire.plan.straight.test_trimmed_block import PROBLEM

RIM = [(-0.08, 0.02), (-0.08, 0.09), (0.08, 0.09), (0.08, 0.02)]
STRIP = [(-0.08, 0.06), (0.08, 0.06)]
CHECKS = (
    *("check_cut", "check_inner_corners", "check_path", "check_driven"),
    *("check_drops", "check_model", "check_bow", "check_holder"),
)


def problem(folder: Path, ruled: list[Any], **more: Any) -> Problem:
    """A plate to be cut from a fixed block by a wire along y."""
    path = folder / "problem.yaml"
    operation = {**PROBLEM["operations"][0], "cuts": "all", **more}  # type: ignore[index]
    stock = {**PROBLEM["stock"], "oversize_mm": [[0, 0], [0, 0], [0, 0]]}  # type: ignore[dict-item]
    path.write_text(
        yaml.safe_dump({**PROBLEM, "accept": ["stock.support"], "stock": stock, "operations": [operation]})
    )
    return dataclasses.replace(planner.load(path), part=blocks.part(*ruled), source={})


def plate() -> list[Any]:
    """A hole of 30 mm, 20 mm below the top side of its plate and 65 mm from its ends."""
    angle = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    hole = np.column_stack([0.015 * np.cos(angle), 0.055 + 0.015 * np.sin(angle)])
    return [
        blocks.prism("rim", RIM, closed=True),
        blocks.prism("hole", hole, corner=False, closed=True, hole=True),
    ]


def codes(outcome: Outcome) -> set[str]:
    return {issue.code for issue in outcome.proof.issues}


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Switch the planner's own checks off."""
    for name in CHECKS:
        monkeypatch.setattr(job, name, lambda *_: iter(()))
    return monkeypatch


def planned(loaded: Problem) -> Outcome:
    outcome = planner.plan(loaded)
    assert set(codes(outcome)) <= {"verify.slit", "verify.part"}, outcome.proof.issues
    return outcome


def test_a_slit_as_long_as_it_has_to_be_is_proven(tmp_path: Path) -> None:
    """By hand: 20 mm of plate are above the hole; allowed are a quarter more, a fiftieth of the way around
    the hole, and what a 400th of the block's diagonal adds."""
    outcome = planned(problem(tmp_path, plate()))
    assert outcome.verified
    rule = next(rule for rule in outcome.proof.rules if rule.code == "verify.slit")
    diagonal = float(np.linalg.norm([0.2, 0.2, 0.1]))
    allowed = 1.25 * 0.020 + 0.02 * np.pi * 0.03 + 0.0025 * diagonal
    assert rule.where == "cut/hole"
    assert rule.worst == pytest.approx(0.020 / allowed, rel=0.01)


def longer(tries: Any) -> int:
    """The slit to the plate's end instead of its top."""
    return int(np.argmin(np.abs(tries.length_in_part - 0.065)))


def slanted(tries: Any) -> int:
    return int(np.argmin(np.abs(tries.length_in_part - 0.040)))


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("pick", [longer, slanted])
def test_a_slit_that_is_longer_than_it_has_to_be_is_not(
    tmp_path: Path, unchecked: pytest.MonkeyPatch, pick: Callable[[Any], int]
) -> None:
    choose = straight_cut.choose_start

    def other(ruled: Any, contours: Any, cut: Any, box: Any, *sides: Any) -> straight_cut.CutStart:
        found = choose(ruled, contours, cut, box, *sides)
        if not ruled.hole:
            return found
        tries = straight_cut._start_candidates(ruled, contours, cut, box)
        k = pick(tries)
        more = float(tries.length[k]), float(tries.length_in_part[k])
        return straight_cut.CutStart(int(tries.first[k]), found.backward, tries.direction[k], *more)

    unchecked.setattr(straight_cut, "choose_start", other)
    assert codes(planned(problem(tmp_path, plate()))) == {"verify.slit"}


def test_out_by_another_slit_than_in(tmp_path: Path, unchecked: pytest.MonkeyPatch) -> None:
    closed = straight_cut._closed_cut

    def other(*given: Any) -> StraightCut:
        cut = closed(*given)
        if not cut.nominal.ruled.hole or cut.start is None:
            return cut
        c, s = np.cos(0.25), np.sin(0.25)
        turned = cut.start.direction @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        leg = straight_cut._straight_lines(cut.on.lines[[-1]], turned, *given[3:])
        return dataclasses.replace(cut, out=leg)

    unchecked.setattr(straight_cut, "_closed_cut", other)
    assert "verify.slit" in codes(planned(problem(tmp_path, plate())))


def test_a_way_in_that_is_no_plane(tmp_path: Path, unchecked: pytest.MonkeyPatch) -> None:
    """Bent by 4 mm in the middle of the plate: its slot is none of a slit."""
    closed = straight_cut._closed_cut

    def other(*given: Any) -> StraightCut:
        cut = closed(*given)
        if not cut.nominal.ruled.hole:
            return cut
        bend = np.zeros((len(cut.into), 3))
        middle = 0.5 * (cut.into.start + cut.into.end)
        bend[:, 0] = 0.004 * np.exp(-(((middle[:, 2] - 0.08) / 0.006) ** 2))
        return dataclasses.replace(cut, into=WireLines(cut.into.start + bend, cut.into.end + bend))

    unchecked.setattr(straight_cut, "_closed_cut", other)
    assert "verify.part" in codes(planned(problem(tmp_path, plate())))


def beside_another(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """A plate whose hole the planner reaches along the lower side of a window, 0.3 mm beneath it."""
    angle = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    hole = np.column_stack([-0.04 + 0.01 * np.cos(angle), 0.055 + 0.01 * np.sin(angle)])
    window = [(0.0, 0.0553), (0.02, 0.0553), (0.02, 0.07), (0.0, 0.07)]

    choose = straight_cut.choose_start

    def other(ruled: Any, contours: Any, cut: Any, box: Any, *sides: Any) -> straight_cut.CutStart:
        found = choose(ruled, contours, cut, box, *sides)
        if ruled.name != "hole":
            return found
        tries = straight_cut._start_candidates(ruled, contours, cut, box)
        height = 0.5 * (ruled.start + ruled.end)[tries.first, 2] - 0.055
        k = int(np.argmin(np.abs(height) + np.abs(tries.direction @ np.array([1.0, 0.0, 0.0]) - 1.0)))
        more = float(tries.length[k]), float(tries.length_in_part[k])
        return straight_cut.CutStart(int(tries.first[k]), found.backward, tries.direction[k], *more)

    monkeypatch.setattr(straight_cut, "choose_start", other)
    return [
        blocks.prism("rim", RIM, closed=True),
        blocks.prism("hole", hole, corner=False, closed=True, hole=True),
        blocks.prism("window", window, closed=True, hole=True),
    ]


ALONG_X: dict[str, Any] = {
    "cuts": [{"surface": "hole", "lead": [1, 0, 0]}, {"surface": "window"}, {"surface": "rim"}]
}


def test_a_slit_along_the_border_of_another_hole(tmp_path: Path, unchecked: pytest.MonkeyPatch) -> None:
    outcome = planned(problem(tmp_path, beside_another(unchecked), **ALONG_X))
    reported = [issue for issue in outcome.proof.issues if "along another contour" in issue.message]
    assert [issue.code for issue in reported] == ["verify.slit"]
    assert reported[0].value == pytest.approx(20.0, abs=1.5)


def test_the_planner_refuses_such_a_slit_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ruled = beside_another(monkeypatch)
    with pytest.raises(TandemError) as caught:
        planner.plan(problem(tmp_path, ruled, **ALONG_X))
    assert "straight.lead" in {issue.code for issue in caught.value.issues}
    assert any("runs along window" in issue.message for issue in caught.value.issues)


LEADS = [
    (plate(), {"cuts": [{"surface": "hole", "lead": [1, 0, 0]}, {"surface": "rim"}]}),
    ([blocks.prism("strip", STRIP)], {"cuts": [{"surface": "strip", "lead": [-1, 0, 0.5]}]}),
]


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(("ruled", "more"), LEADS)
def test_a_stated_lead_is_followed(tmp_path: Path, ruled: list[Any], more: dict[str, Any]) -> None:
    outcome = planned(problem(tmp_path, ruled, **more))
    assert outcome.verified
    rule = next(rule for rule in outcome.proof.rules if rule.code == "verify.slit")
    assert rule.where


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(("ruled", "more"), LEADS)
def test_a_lead_that_the_planner_ignores(
    tmp_path: Path, unchecked: pytest.MonkeyPatch, ruled: list[Any], more: dict[str, Any]
) -> None:
    expected = job.nominal_surfaces
    free = [lambda one: dataclasses.replace(one, cut=one.cut.model_copy(update={"lead": "auto"}))]
    unchecked.setattr(job, "nominal_surfaces", lambda *given: [free[0](one) for one in expected(*given)])
    assert "verify.slit" in codes(planned(problem(tmp_path, ruled, **more)))


def test_a_cut_to_which_nothing_leads(tmp_path: Path) -> None:
    """The way in bears another name."""
    made = problem(tmp_path, LEADS[1][0], **LEADS[1][1])
    outcome = planner.plan(made)
    texts = {
        name: text.replace("cut_strip_in", "cut_strop_in").replace("cut/strip_in", "cut/strop_in")
        for name, text in outcome.programs.items()
    }
    claims = planner.processes.registry.claims(made)
    proof = Prover(made, claims).prove(texts, last="verify.slit")
    assert "verify.slit" in {issue.code for issue in proof.issues}


def facing(gap: float) -> list[Any]:
    """Two strips with foam above the one and below the other, [m] apart."""
    low, high = [(-0.1, 0.05), (0.1, 0.05)], [(0.1, 0.05 + gap), (-0.1, 0.05 + gap)]
    return [blocks.prism("low", low), blocks.prism("high", high)]


@pytest.mark.parametrize("batch", [20_000, 7])
def test_a_slot_that_is_wider_than_the_gap_to_the_next_surface(
    tmp_path: Path, unchecked: pytest.MonkeyPatch, batch: int
) -> None:
    """By hand: half a slot off the one, it reaches beyond the other by the slot less the gap. All of the
    surface is looked at, in however many batches."""
    unchecked.setattr(walls, "PIECE_BATCH_SIZE", batch)
    outcome = planned(problem(tmp_path, facing(0.0004)))
    slot = float(PROBLEM["operations"][0]["kerf_mm"])  # type: ignore[index]
    found = [issue for issue in outcome.proof.issues if issue.code == "verify.part"]
    assert {issue.field for issue in found} == {"cut/low", "cut/high"}
    assert [issue.value for issue in found] == pytest.approx([slot - 0.4] * 2, abs=0.02)


@pytest.mark.long
def test_strips_as_far_apart_as_the_slot_are_proven(tmp_path: Path) -> None:
    slot = 1e-3 * float(PROBLEM["operations"][0]["kerf_mm"])  # type: ignore[index]
    high_first = [{"surface": "high"}, {"surface": "low"}]
    assert planner.plan(problem(tmp_path, facing(slot), cuts=high_first)).verified


@pytest.mark.long
def test_strips_that_cross_bound_the_part_together_and_are_proven(tmp_path: Path) -> None:
    wedge = [
        blocks.prism("top", [(-0.1, 0.06), (0.1, 0.05)]),
        blocks.prism("sole", [(0.1, 0.06), (-0.1, 0.04)]),
    ]
    top_first = [{"surface": "top"}, {"surface": "sole"}]
    assert planner.plan(problem(tmp_path, wedge, cuts=top_first)).verified


def test_what_goes_on_beyond_a_surface_that_it_crosses_is_no_part() -> None:
    """The outline of the bundled wall goes through the whole block; its front is at 75 mm there."""
    problem = planner.load("ruled_wall")
    stated = registry.claims(problem, registry.jobs(problem))
    part = tuple(c for claims in stated.values() for c in claims if isinstance(c, CutsSurface))
    outline = next(claim for claim in part if claim.segment.name == "outline")
    place = np.array([[0.10308477, 0.0337478, z] for z in (0.0735, 0.0755)])
    block = np.array([[-0.145, -0.3, 0.0], [0.145, 0.3, 0.1]])
    assert walls._bounds_the_part(place, outline, walls.PartWalls(part, block)).tolist() == [True, False]
