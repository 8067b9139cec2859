"""Jobs that a straight wire cannot do are reported with a remedy."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import shapely
from pydantic import ValidationError

from planner.catalogue.materials import foams
from planner.geometry.arrays import RuledSurface
from planner.issues import Issue, Severity, TandemError
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire.plan.operation import Straight
from planner.processes.hotwire.plan.straight import job
from tests.processes.hotwire.plan import foam_blocks as blocks
from tests.processes.hotwire.plan.foam_blocks import twisted

SQUARE = blocks.prism("sq", [(-0.02, 0.03), (-0.02, 0.07), (0.02, 0.07), (0.02, 0.03)], closed=True)
XPS = foams()["xps_30"]


def issues(part: Part | None, setup: Setup | None = None, **more: object) -> dict[str, Issue]:
    """Issues by code, of a refusal or of targets."""
    try:
        found = job.StraightJob(blocks.operation(**more), setup or blocks.setup(), part).targets().issues
    except TandemError as error:
        found = error.issues
    assert all(str(issue) for issue in found)
    return {issue.code: issue for issue in found}


def refusal(code: str, part: Part | None, setup: Setup | None = None, **more: object) -> Issue:
    issue = issues(part, setup, **more)[code]
    assert issue.severity is Severity.ERROR
    return issue


def test_a_part_without_the_surface_says_what_it_has() -> None:
    issue = refusal("part.missing_surface", blocks.part(SQUARE), cuts=[{"surface": "wing"}])
    assert "'wing'" in issue.message
    assert "sq" in issue.message
    assert refusal("part.missing_surface", None).field == "part"


def test_trimming_needs_oversize() -> None:
    block = blocks.stock((0.2, 0.2, 0.1), oversize=np.array([[0.01, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    issue = refusal("straight.trim", None, blocks.setup(block), cuts=[{"trim": ["left", "right"]}])
    assert "right" in issue.message
    assert issue.value == 0.0


@pytest.mark.parametrize(
    ("arms", "held", "code"),
    [
        (["spare"], None, "bow.missing"),
        (["left", "right"], None, "bow.arms"),
        (["left"], "right", "bow.arms"),
        (["left", "spare"], "right", "bow.arms"),
        (["left"], "left", "bow.arms"),
    ],
)
def test_arms_are_those_that_hold_the_bow_and_the_block(arms: list[str], held: str | None, code: str) -> None:
    setup = blocks.setup(blocks.stock(held_by=held, foam=XPS))
    assert refusal(code, blocks.part(SQUARE), setup, arms=arms).message


def test_a_block_wider_than_the_wire_says_how_wide_a_bow_must_be() -> None:
    issue = refusal("bow.span", blocks.part(SQUARE), blocks.setup(span=0.23))
    assert issue.value == pytest.approx(240.0)
    assert issue.limit == pytest.approx(230.0)
    assert "bow.span" not in issues(blocks.part(SQUARE), blocks.setup(span=0.25))


def test_a_block_deeper_than_the_throat_says_how_deep_a_bow_must_be() -> None:
    block = blocks.stock((0.4, 0.2, 0.3))
    middle = blocks.prism("sq", [(-0.02, 0.13), (-0.02, 0.17), (0.02, 0.17), (0.02, 0.13)], closed=True)
    issue = refusal("bow.throat", blocks.part(middle), blocks.setup(block, throat=0.15))
    assert 150.0 < issue.value < 180.0
    assert issue.limit == pytest.approx(135.0)  # half the beam less
    assert "bow.throat" not in issues(blocks.part(middle), blocks.setup(block, throat=0.2))


def _valley(half_width: float, depth: float) -> Part:
    points = [(-0.1, 0.06), (-half_width, 0.06), (0.0, 0.06 - depth), (half_width, 0.06), (0.1, 0.06)]
    return blocks.part(blocks.prism("valley", points))


@pytest.mark.parametrize(("half_width", "depth"), [(0.03, 0.03), (0.01, 0.02), (0.006, 0.03)])
def test_what_a_round_wire_leaves_in_an_inner_corner_is_told(half_width: float, depth: float) -> None:
    """By hand: between the sides of a corner that turns by t and an arc of half the slot h stay h (1 / cos
    (t/2) - 1) in depth and h^2 (tan(t/2) - t/2) of area."""
    note = issues(_valley(half_width, depth))["straight.corner"]
    t, h = 2.0 * np.arctan2(depth, half_width), 0.75
    assert note.severity is Severity.NOTE
    assert note.value == pytest.approx(h / np.cos(0.5 * t) - h, rel=1e-3)
    volume = 200.0 * h * h * (np.tan(0.5 * t) - 0.5 * t)
    assert float(note.message.split(" mm3")[0].split()[-1]) == pytest.approx(volume, rel=0.02, abs=0.6)


def test_more_foam_than_may_stay_is_refused_until_more_may() -> None:
    steep = _valley(0.002, 0.03)
    issue = refusal("straight.corner", steep)
    assert issue.value == pytest.approx(10.525, abs=0.01)
    assert issue.limit == 5.0
    assert issues(steep, left_mm=10.6)["straight.corner"].severity is Severity.NOTE


def _groove(width: float) -> Part:
    x = np.linspace(-0.1, 0.1, 2001)
    z = 0.06 - 0.002 * np.exp(-((x / width) ** 2))
    return blocks.part(blocks.prism("tight", np.column_stack([x, z]), corner=False))


@pytest.mark.parametrize("width", [0.0006, 0.0009])
def test_an_inner_curve_tighter_than_half_a_slot_is_left_out(width: float) -> None:
    """shapely's parallel of the surface says where the middle of a slot may be at all."""
    part = _groove(width)
    note = issues(part)["straight.corner"]
    line = part.ruled[0].start[:, [0, 2]]
    solid = shapely.Polygon([*line, (0.1, -0.1), (-0.1, -0.1)])
    free = solid.buffer(0.00075, quad_segs=256).boundary
    left = shapely.distance(shapely.points(line[900:1101]), free).max() - 0.00075
    assert note.severity is Severity.NOTE
    assert note.value == pytest.approx(1e3 * left, abs=0.07)  # the wires' steps, well within the tolerance
    refused = refusal("straight.corner", part, left_mm=0.1)
    assert "round the corner" in refused.message or "radius" in refused.message


def test_a_gap_narrower_than_the_slot_is_refused() -> None:
    comb = [(-0.1, 0.08), (-0.0005, 0.08), (-0.0005, 0.03), (0.0005, 0.03), (0.0005, 0.08), (0.1, 0.08)]
    assert (
        "narrower than the slot" in refusal("straight.crossing", blocks.part(blocks.prism("c", comb))).message
    )


def test_a_lead_through_the_part_is_refused() -> None:
    issue = refusal(
        "straight.lead",
        blocks.part(
            SQUARE, blocks.prism("other", [(0.05, 0.0), (0.05, 0.1), (0.07, 0.1), (0.07, 0.0)], closed=True)
        ),
        cuts=[{"surface": "sq", "lead": [1, 0, 0]}],
    )
    assert issue.value == pytest.approx(20.0, abs=0.1)


def test_a_slit_to_a_hole_is_told_with_its_place() -> None:
    a = np.linspace(0.0, 2.0 * np.pi, 181)[:-1]
    ring = np.column_stack([0.01 * np.cos(a), 0.05 + 0.01 * np.sin(a)])
    hole = blocks.prism("hole", ring, corner=False, closed=True, hole=True)
    note = issues(blocks.part(SQUARE, hole))["straight.slit"]
    assert note.severity is Severity.NOTE
    assert note.value == pytest.approx(10.0, abs=0.1)
    assert "along [" in note.message


@pytest.mark.parametrize(
    ("power", "feed", "code"), [(60.0, 2.5, "kerf.too_hot"), (15.0, 9.0, "kerf.too_cold")]
)
def test_too_hot_and_too_cold_are_told_apart(power: float, feed: float, code: str) -> None:
    setup = blocks.setup(blocks.stock(foam=XPS))
    issue = refusal(code, blocks.part(SQUARE), setup, power_w=power, feed_mm_s=feed, feed_min_mm_s=1)
    assert issue.unit == "mm"
    assert (issue.value > 3.0) if code == "kerf.too_hot" else (issue.value < 0.8)


def test_doubts_of_the_kerf_model_are_a_warning() -> None:
    setup = blocks.setup(blocks.stock(foam=XPS))
    found = issues(blocks.part(SQUARE), setup, power_w=40.0, feed_mm_s=5)
    assert found["kerf.doubt"].severity is Severity.WARNING


def test_power_needs_a_foam() -> None:
    assert refusal("stock.foam_missing", blocks.part(SQUARE), power_w=40.0).field == "stock.foam"


def held(plate: float) -> tuple[Part, Setup]:
    a = np.deg2rad(np.arange(0, 360, 60))
    low = np.column_stack([0.07 * np.cos(a), 0.07 * np.sin(a), np.zeros(6)])
    part = Part(
        ruled=(RuledSurface("sides", low, low + np.array([0, 0, 0.1]), np.ones(6, dtype=np.bool_), True),)
    )
    block: Stock = blocks.stock((0.2, 0.2, 0.1), held_by="right", foam=XPS)
    return part, blocks.setup(block, plate=plate)


def test_a_gripper_larger_than_the_parts_face_is_in_the_wires_way() -> None:
    part, setup = held(0.10)
    issue = refusal("stock.footprint", part, setup, arms=["left", "right"])
    assert issue.arm == "right"
    part, setup = held(0.03)
    assert "stock.footprint" not in issues(part, setup, arms=["left", "right"], margin_mm=15)


def test_a_gripper_beside_the_part_would_let_it_fall() -> None:
    part, setup = held(0.02)
    grip = np.eye(4)
    grip[0, 3] = -0.085
    beside = dataclasses.replace(
        setup, stock=dataclasses.replace(setup.stock, size=np.array([0.4, 0.2, 0.1]))
    )
    beside = dataclasses.replace(beside, stock=dataclasses.replace(beside.stock, grip=grip * 1.0))
    issue = refusal("stock.footprint", part, beside, arms=["left", "right"], margin_mm=2)
    assert "falls" in issue.message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kerf_mm": None, "power_w": None}, "give either kerf_mm"),
        ({"power_w": 30}, "either kerf_mm"),
        ({"kerf_range_mm": [3, 1]}, "lower < upper"),
        ({"cuts": [{"trim": ["left"]}, {"trim": ["left"]}]}, "cut once"),
        ({"cuts": [{"trim": ["left", "left"]}]}, "each side is cut once"),
        ({"cuts": [{"trim": ["left"], "along": "x"}]}, "normal to the side"),
        ({"feed_mm_s": 2}, "must not exceed"),
        ({"arms": ["left", "left"]}, "two different arms"),
    ],
)
def test_contradictions_in_the_file_are_refused(change: dict[str, object], words: str) -> None:
    base = {"name": "shape", "process": "straight_wire", "arms": ["left"], "kerf_mm": 1.5}
    with pytest.raises(ValidationError, match=words):
        Straight.model_validate_json(json.dumps(base | change), strict=True)


@pytest.mark.parametrize(
    ("order", "spacers", "reported"),
    [
        (["bottom", "left"], False, True),
        (["bottom", "left"], True, False),
        (["left", "bottom"], False, False),
    ],
)
def test_a_block_that_drops_by_a_slot_before_it_is_cut_on_is_told(
    order: list[str], spacers: bool, reported: bool
) -> None:
    block = blocks.stock((0.2, 0.2, 0.1), oversize=np.array([[0.01, 0.0, 0.01], [0.0, 0.0, 0.0]]))
    found = issues(None, blocks.setup(block), cuts=[{"trim": order}], spacers=spacers)
    assert ("straight.drop" in found) == reported
    if reported:
        assert found["straight.drop"].severity is Severity.WARNING
        assert found["straight.drop"].value == pytest.approx(1.5)
        assert "trim_left" in found["straight.drop"].message


def test_a_wire_that_turns_faster_than_its_slot_can_follow_is_refused() -> None:
    """In its middle, about which it turns, it stands nearly still; with more tolerance it may."""
    setup = blocks.setup(blocks.stock(foam=XPS))
    heat = {"feed_mm_s": 6, "feed_min_mm_s": 2, "kerf_range_mm": [0.3, 20]}
    issue = refusal("straight.uneven", twisted(), setup, power_w=30.0, **heat)
    assert issue.value > issue.limit == pytest.approx(0.3)
    assert "straight.uneven" not in issues(twisted(), setup, power_w=30.0, shape_tol_mm=30, **heat)
    # a slot that is too wide anyway is uneven for that, and told with the advice for it alone
    heat["kerf_range_mm"] = [0.3, 0.6]
    found = issues(twisted(), setup, power_w=30.0, **heat)
    assert "kerf.too_hot" in found
    assert "straight.uneven" not in found
