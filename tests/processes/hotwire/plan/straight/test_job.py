"""From ruled surfaces to targets of a bow: leads, slits, order, links, freedoms, claims, steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.materials import foams
from planner.claims.claim import ContactOnlyIn, FeedWindow, HoldsStock
from planner.claims.dialogue import OperatorDialogue
from planner.claims.segments import Segment
from planner.geometry.arrays import RuledSurface, Shape, exp_twist, from_rpy, interpolate, inverse, transform
from planner.issues import Severity
from planner.problem import Part, Stock
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings, KerfWithin, StraightWire
from planner.processes.hotwire.plan.straight import job
from planner.processes.hotwire.plan.straight.job import StraightJob
from planner.processes.hotwire.plan.straight.order import distance_to_polyline
from planner.targets import FEED_FRACTION, ScrewFreedom, Targets
from tests.processes.hotwire.plan import foam_blocks as blocks

HALF = 0.00075
SPAN = 0.4
WAVE_X = np.linspace(-0.16, 0.16, 161)
WAVE = blocks.prism("wave", np.column_stack([WAVE_X, 0.05 + 0.02 * np.cos(15 * WAVE_X)]), corner=False)


def ring(name: str, radius: float, x: float, z: float, hole: bool = False) -> RuledSurface:
    a = np.linspace(0.0, 2.0 * np.pi, 361)[:-1] * (1.0 if hole else -1.0)
    points = np.column_stack([x + radius * np.cos(a), z + radius * np.sin(a)])
    return blocks.prism(name, points, corner=False, closed=True, hole=hole)


def square(name: str, x: float, z: float, side: float) -> RuledSurface:
    h = 0.5 * side
    points = [(x - h, z - h), (x - h, z + h), (x + h, z + h), (x + h, z - h)]
    return blocks.prism(name, points, closed=True)


def make(*ruled: RuledSurface, block: Stock | None = None, **more: object) -> Targets:
    return job.StraightJob(blocks.operation(**more), blocks.setup(block), blocks.part(*ruled)).targets()


def rows(targets: Targets, segment: str) -> np.ndarray:
    return np.flatnonzero(np.array(targets.segment) == Segment.read(segment))


def wires(targets: Targets, pose: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Both clamps' ends of the wire (N, 3)."""
    pose = targets.pose["left"] if pose is None else pose
    return tuple(pose[:, :3, 3] + side * 0.5 * SPAN * pose[:, :3, 0] for side in (-1.0, 1.0))


def box_gap(targets: Targets, chosen: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Least distance of the wires to a box, by many points along them."""
    a, b = (end[chosen] for end in wires(targets))
    points = a[:, None] + np.linspace(0, 1, 401)[None, :, None] * (b - a)[:, None]
    gap = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
    return np.linalg.norm(gap, axis=2).min(axis=1)


def test_an_open_strip_is_cut_half_a_kerf_outside_from_air_to_air() -> None:
    targets = make(WAVE)
    labels = list(map(str, dict.fromkeys(targets.segment)))
    assert labels == ["approach", "cut/wave_in", "cut/wave", "cut/wave_out", "retreat"]
    pose = targets.pose["left"][rows(targets, "cut/wave")]
    np.testing.assert_allclose(pose[:, :3, 0], np.tile([0.0, 1.0, 0.0], (len(pose), 1)), atol=1e-12)
    deviation = distance_to_polyline(pose[:, :3, 3] * [1, 0, 1], WAVE.start * [1, 0, 1])
    np.testing.assert_allclose(deviation, HALF, atol=2e-6)
    air = np.flatnonzero([s.kind != "cut" for s in targets.segment])
    assert box_gap(targets, air, blocks.stock().box).min() > 0.0199
    # it stops in the air alone, and keeps to its steps
    stops = np.flatnonzero(targets.stop)
    assert {str(targets.segment[i]) for i in stops} == {"approach", "cut/wave_out", "retreat"}
    assert targets.travel[rows(targets, "cut/wave")].max() < 0.0042
    assert targets.feed_min[rows(targets, "cut/wave")].max() == pytest.approx(0.003)


def test_travel_is_the_way_of_the_fastest_point_in_the_foam() -> None:
    fan = RuledSurface(
        "fan",
        np.column_stack([np.linspace(-0.02, 0.02, 9), np.full(9, -0.1), np.full(9, 0.05)]),
        np.column_stack([np.linspace(-0.06, 0.06, 9), np.full(9, 0.1), np.full(9, 0.05)]),
        np.zeros(9, dtype=np.bool_),
    )
    targets = make(fan, block=blocks.stock((0.3, 0.2, 0.1)))
    pose = targets.pose["left"]
    on = rows(targets, "cut/fan")[3:-3]
    wide = pose[:, :3, 3] + ((0.1 - pose[:, 1, 3]) / pose[:, 1, 0])[:, None] * pose[:, :3, 0]
    path_length = np.linalg.norm(np.diff(wide, axis=0), axis=1)[on - 1]
    np.testing.assert_allclose(targets.travel[on], path_length, rtol=0.06)  # across the wire, which leans
    assert (targets.travel[on] <= path_length * 1.01).all()


def test_the_slide_is_what_the_wire_leaves_beyond_foam_and_margins() -> None:
    targets = make(WAVE)
    spin, slide = targets.freedoms
    assert isinstance(spin, ScrewFreedom)
    assert spin.periodic
    np.testing.assert_allclose(slide.upper, 0.5 * (SPAN - 0.2 - 2 * 0.02), atol=1e-12)
    values = targets.neutral_values()
    values[:, 1] = slide.upper
    ends = wires(targets, targets.poses(values)["left"])
    on = rows(targets, "cut/wave")
    assert ends[0][on, 1].max() == pytest.approx(-0.12)
    values[:, 0] = 1.0
    rotated = wires(targets, targets.poses(values)["left"])
    np.testing.assert_allclose(rotated[1], ends[1], atol=1e-12)


def test_frames_turn_no_more_than_the_wire_does() -> None:
    y = np.linspace(-0.13, 0.13, 60)
    twisted = RuledSurface(
        "hypar",
        np.column_stack([y, np.full(60, -0.1), 0.05 - 0.15 * y]),
        np.column_stack([y, np.full(60, 0.1), 0.05 + 0.15 * y]),
        np.zeros(60, dtype=np.bool_),
    )
    targets = make(twisted)
    turn = np.swapaxes(targets.pose["left"][:-1, :3, :3], 1, 2) @ targets.pose["left"][1:, :3, :3]
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    x = targets.pose["left"][:, :3, 0]
    wire = np.arccos(np.clip(np.sum(x[1:] * x[:-1], axis=1), -1, 1))
    np.testing.assert_allclose(angle, wire, atol=1e-7)


def test_between_targets_the_wire_stays_on_a_hyperbolic_paraboloid() -> None:
    y = np.linspace(-0.13, 0.13, 60)
    hypar = RuledSurface(
        "hypar",
        np.column_stack([y, np.full(60, -0.1), 0.05 - 0.15 * y]),
        np.column_stack([y, np.full(60, 0.1), 0.05 + 0.15 * y]),
        np.zeros(60, dtype=np.bool_),
    )
    targets = make(hypar)
    on = rows(targets, "cut/hypar")[4:-4]
    pose = targets.pose["left"]
    mid = interpolate(pose[on - 1], pose[on], np.full(len(on), 0.5))
    # z = 0.05 + 1.5 x y: the distance of a near point is |z - 1.5 x y| over the gradient's length
    for place in np.linspace(-0.1, 0.1, 9):
        along = (place - mid[:, 1, 3]) / mid[:, 1, 0]
        x, y_, z = (mid[:, :3, 3] + along[:, None] * mid[:, :3, 0]).T
        away = (z - 0.05 - 1.5 * x * y_) / np.sqrt(1 + 2.25 * (x**2 + y_**2))
        np.testing.assert_allclose(np.abs(away), HALF, atol=1e-5)


def test_a_wing_like_outline_begins_at_its_sharp_edge_and_ends_with_its_upper_side() -> None:
    x = np.linspace(0.0, 1.0, 80)
    bow = 0.02 * np.sin(np.pi * x) ** 0.5
    lower = np.column_stack([0.1 - 0.2 * x, 0.05 - bow])
    outline = np.concatenate([lower, (lower * [1, -1] + [0, 0.1])[-2:0:-1]])
    corner = np.zeros(len(outline), dtype=np.bool_)
    corner[0] = True
    targets = make(blocks.prism("wing", outline, corner=corner, closed=True))
    on = targets.pose["left"][rows(targets, "cut/wing"), :3, 3]
    assert np.hypot(on[0, 0] - 0.1, on[0, 2] - 0.05) < 0.005
    assert on[len(on) // 4, 2] < 0.05 < on[3 * len(on) // 4, 2]
    below = make(
        blocks.prism("wing", outline, corner=corner, closed=True),
        cuts=[{"surface": "wing", "last": "bottom"}],
    )
    on = below.pose["left"][rows(below, "cut/wing"), :3, 3]
    assert on[len(on) // 4, 2] > 0.05 > on[3 * len(on) // 4, 2]


def test_a_given_lead_is_taken() -> None:
    targets = make(square("sq", 0.0, 0.05, 0.05), cuts=[{"surface": "sq", "lead": [-1, 0, 0]}])
    into = targets.pose["left"][rows(targets, "cut/sq_in"), :3, 3]
    assert into[0, 0] < -0.15
    assert np.ptp(into[:-2, 2]) < 1e-9


@pytest.mark.parametrize("hole", [False, True])
def test_no_slit_leaves_the_block_where_it_stands(hole: bool) -> None:
    """With a post under the block, its wires keep off it, by points along them; with none the same part is
    come to from below, which is nearest."""
    ell = [(-0.04, 0.02), (-0.04, 0.08), (-0.02, 0.08), (-0.02, 0.04), (0.03, 0.04), (0.03, 0.02)]
    part = [blocks.prism("ell", ell, closed=True)]
    if hole:  # somewhat nearer to the lower side of its square than to the others
        part = [square("ell", 0.0, 0.045, 0.06), ring("bore", 0.01, 0.0, 0.0422, hole=True)]
    post = Shape("box", (0.14, 0.08, 0.4), from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, -0.2]))
    box = np.array([[-0.07, -0.04, -0.4], [0.07, 0.04, 0.0]])
    for support, free in (((post,), True), ((), False)):
        targets = make(*part, block=blocks.stock(support=support))
        assert (box_gap(targets, np.arange(targets.count), box).min() > 0.0) == free


def test_a_hole_is_cut_first_through_the_shortest_slit_which_is_told() -> None:
    outline, hole = square("outer", 0.0, 0.05, 0.08), ring("hole", 0.01, 0.02, 0.05, hole=True)
    targets = make(outline, hole)
    order = [str(s) for s in dict.fromkeys(targets.segment) if not s.phase and s.kind == "cut"]
    assert order == ["cut/hole", "cut/outer"]
    (note,) = [i for i in targets.issues if i.code == "straight.slit"]
    assert note.severity is Severity.NOTE
    # from the hole's edge at x = 30 to the outline at x = 40
    assert note.value == pytest.approx(10.0, abs=0.2)
    inside = targets.pose["left"][rows(targets, "cut/hole"), :3, 3]
    np.testing.assert_allclose(np.hypot(inside[:, 0] - 0.02, inside[:, 2] - 0.05), 0.01 - HALF, atol=1e-5)


def test_outlines_are_cut_from_the_top_down() -> None:
    pieces = [square("low", 0.0, 0.02, 0.02), square("high", 0.0, 0.08, 0.02), square("mid", 0.0, 0.05, 0.02)]
    targets = make(*pieces)
    cuts = [str(s) for s in dict.fromkeys(targets.segment) if not s.phase and s.kind == "cut"]
    assert cuts == ["cut/high", "cut/mid", "cut/low"]


@pytest.mark.parametrize("sides", [["left", "right"], ["left", "front", "top", "back", "right"]])
def test_links_keep_away_from_the_block_and_go_above_rather_than_below(sides: list[str]) -> None:
    block = blocks.stock((0.2, 0.2, 0.1), oversize=np.array([[0.01, 0.01, 0.0], [0.01, 0.01, 0.01]]))
    targets = make(block=block, cuts=[{"trim": sides}])
    link = rows(targets, "link")
    assert box_gap(targets, link, block.box).min() > 0.0199
    low = targets.pose["left"][link, 2, 3]
    assert low.max() > 0.12
    moves = np.stack([np.linalg.norm(np.diff(end, axis=0), axis=1) for end in wires(targets)]).max(axis=0)
    assert moves[link - 1].max() < 0.025
    np.testing.assert_allclose(targets.travel[link[1:]], moves[link[1:] - 1], rtol=0.5)


def test_a_trimmed_side_is_cut_half_a_kerf_outside_the_datum_block_and_loses_its_oversize() -> None:
    block = blocks.stock((0.2, 0.2, 0.1), oversize=np.array([[0.01, 0.0, 0.0], [0.0, 0.0, 0.02]]))
    op = blocks.operation(cuts=[{"trim": ["top", "left"]}])
    targets = job.StraightJob(op, blocks.setup(block), None).targets()
    top, left = (targets.pose["left"][rows(targets, f"cut/trim_{s}")] for s in ("top", "left"))
    np.testing.assert_allclose(top[:, 2, 3], 0.1 + HALF, atol=1e-9)
    np.testing.assert_allclose(left[:, 0, 3], -0.1 - HALF, atol=1e-9)
    assert left[0, 2, 3] > left[-1, 2, 3]
    after = op.leaves(block)
    assert not after.oversize.any()
    assert op.leaves(after) is after


def test_back_through_the_slot_the_wire_turns_just_outside_and_stops_there() -> None:
    block = blocks.stock((0.2, 0.2, 0.1), oversize=np.array([[0.01, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    targets = make(block=block, cuts=[{"trim": ["left"], "leave": "back"}])
    z = targets.pose["left"][:, 2, 3]
    assert -0.004 < z.min() < -0.0005
    turn = int(np.argmin(z))
    assert targets.stop[turn]
    assert str(targets.segment[turn]) == "cut/trim_left_out"
    assert z[-1] > 0.12


def test_spacers_are_asked_for_with_the_power_off_where_the_upper_piece_would_drop() -> None:
    targets = make(WAVE, spacers=True, feed_mm_s=5)
    last = int(rows(targets, "cut/wave_out")[-1])
    at = [action for action in targets.actions if action.target == last]
    assert [a.kind for a in at] == ["off", "wait", "message", "confirm", "on", "wait"]
    assert "1.5 mm" in at[2].text
    upright = make(square("sq", 0.0, 0.05, 0.05), spacers=True)
    assert {a.target for a in upright.actions} == {0, upright.count - 1}


def held(grip: np.ndarray, **more: object) -> Targets:
    block = blocks.stock((0.2, 0.2, 0.1), held_by="right", grip=grip, foam=foams()["xps_30"])
    a = np.deg2rad(np.arange(0, 360, 60))
    low = np.column_stack([0.09 * np.cos(a), 0.09 * np.sin(a), np.zeros(6)])
    high = low * 0.9 + [0.0, 0.0, 0.1]
    part = Part(ruled=(RuledSurface("sides", low, high, np.ones(6, dtype=np.bool_), True),))
    return job.StraightJob(
        blocks.operation(arms=["left", "right"], **more), blocks.setup(block, plate=0.03), part
    ).targets()


def test_a_held_block_is_moved_about_its_middle_and_the_bow_keeps_to_it() -> None:
    grip = from_rpy((0.01, -0.02, 0.0), (0.0, 0.0, 0.5))
    targets = held(grip)
    assert targets.frame == {"left": "held:right", "right": "stock"}
    names = [f.name for f in targets.freedoms]
    assert names == [
        "spin", "slide", "block_x", "block_y", "block_z", "block_tilt_x", "block_tilt_y", "block_turn",
    ]  # fmt: skip
    values = targets.neutral_values()
    at_rest = targets.poses(values)["right"]
    np.testing.assert_allclose(at_rest @ grip, np.tile(np.eye(4), (targets.count, 1, 1)), atol=1e-12)
    values[:, 2:] = [0.1, -0.05, 0.02, 0.3, -0.2, 1.0]
    moved = targets.poses(values)
    block = moved["right"] @ grip  # the stock frame as seen from its place
    centre = transform(block[0], np.array([0.0, 0.0, 0.05]))
    np.testing.assert_allclose(centre, [0.1, -0.05, 0.07], atol=1e-12)
    turns = [
        exp_twist(np.array(t)) for t in ([0.3, 0, 0, 0, 0, 0], [0, -0.2, 0, 0, 0, 0], [0, 0, 1.0, 0, 0, 0])
    ]
    np.testing.assert_allclose(block[0, :3, :3], (turns[0] @ turns[1] @ turns[2])[:3, :3], atol=1e-12)
    np.testing.assert_array_equal(moved["left"], targets.poses(targets.neutral_values())["left"])
    on = rows(targets, "cut/sides")
    in_stock = inverse(grip) @ targets.pose["left"][on]
    # a side's plane is half a kerf nearer to the axis than the wire: 0.9 of the radius at the top
    tilt = np.arctan2(0.1 * 0.09 * np.cos(np.pi / 6), 0.1)
    foot = in_stock[:, :3, 3]
    sector = np.deg2rad(30 + 60 * np.arange(6))
    planes = foot[:, :1] * np.cos(sector) + foot[:, 1:2] * np.sin(sector)
    apothem = 0.09 * np.cos(np.pi / 6) * (1 - foot[:, 2])
    gap = (planes.max(axis=1) - apothem) * np.cos(tilt)
    assert gap.min() > HALF - 1e-6
    assert np.median(gap) == pytest.approx(HALF, abs=1e-6)


def test_a_holder_that_only_turns_does_so_about_its_own_axis() -> None:
    targets = held(from_rpy((0.01, 0.0, 0.0), (0.0, 0.0, 0.0)), holder="turn")
    assert [f.name for f in targets.freedoms] == ["spin", "slide", "block_turn"]
    values = targets.neutral_values()
    values[:, 2] = 1.0
    still, rotated = targets.poses(targets.neutral_values())["right"], targets.poses(values)["right"]
    np.testing.assert_allclose(rotated[:, :3, 3], still[:, :3, 3], atol=1e-12)


def test_claims_come_from_the_problem_alone() -> None:
    op = blocks.operation(power_w=40.0, arms=["left", "right"], feed_mm_s=5, feed_min_mm_s=3)
    block = blocks.stock((0.2, 0.2, 0.1), held_by="right", foam=foams()["xps_30"])
    setup, part = blocks.setup(block), blocks.part(square("sq", 0.0, 0.05, 0.05))
    claims = StraightJob(op, setup, part).claims()
    kinds = [
        StraightWire,
        ContactOnlyIn,
        OperatorDialogue,
        CutsSurface,
        FollowsRulings,
        KerfWithin,
        *[FeedWindow] * 3,
        HoldsStock,
    ]
    assert [type(c) for c in claims] == kinds
    wire, contact, _, surface, rulings, kerf, *feeds, holds = claims
    np.testing.assert_allclose(wire.end - wire.start, [SPAN, 0.0, 0.0])
    assert contact.kinds == ("cut",)
    corners = surface.vertices[surface.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(normal, axis=1).sum() == pytest.approx(4 * 0.05 * 0.2)
    middle = corners.mean(axis=1) - [0.0, 0.0, 0.05]
    assert (np.sum(normal * middle * [1, 0, 1], axis=1) > 0.0).all()
    assert len(rulings.start) == 5
    np.testing.assert_array_equal(rulings.start[0], rulings.start[-1])
    assert (kerf.lower, kerf.upper) == (0.0008, 0.003)
    assert [str(f.segment) for f in feeds] == ["cut/sq", "cut/sq_in", "cut/sq_out"]
    assert holds.mass == pytest.approx(0.004 * 30, rel=0.2)
    np.testing.assert_allclose(holds.cog, [0.0, 0.0, 0.05])
    targets = job.StraightJob(dataclasses.replace(setup, stock=block) and op, setup, part).targets()
    assert len(targets.claims) == len(claims)


def test_the_operator_is_told_of_the_wire_and_its_heat() -> None:
    targets = make(WAVE, wire_material="NiCr")
    first = [a for a in targets.actions if a.target == 0]
    assert [a.kind for a in first] == ["message", "confirm", "on", "wait"]
    assert first[0].text == "Wire 0.4 mm NiCr, heat for a slot of 1.5 mm"
    last = [a for a in targets.actions if a.target == targets.count - 1]
    assert [a.kind for a in last] == ["off", "wait", "confirm"]


def test_the_report_gets_tables_and_curves_of_both_ends() -> None:
    shown = make(WAVE).exhibits
    assert set(shown) == {"setup", "cuts", "kerf_wave", "speed_wave", "twist_wave"}
    assert shown["cuts"]["rows"][0][1:3] == ("wave", "strip")
    assert all(len(s["y"]) == len(shown["kerf_wave"]["x"]) for s in shown["kerf_wave"]["series"])


def test_the_same_problem_gives_the_same_targets() -> None:
    one, two = make(WAVE), make(WAVE)
    np.testing.assert_array_equal(one.pose["left"], two.pose["left"])
    np.testing.assert_array_equal(one.travel, two.travel)


def test_a_cut_may_have_a_feed_of_its_own() -> None:
    """Two squares, the first at 2 mm/s: targets, claims and the kerf on the way follow; the air does not."""
    squares = square("one", -0.07, 0.05, 0.06), square("two", 0.07, 0.05, 0.06)
    cuts = [{"surface": "one", "feed_mm_s": 2.0}, {"surface": "two"}]
    block = blocks.stock(foam=foams()["eps_a120"])
    targets = make(
        *squares, block=block, cuts=cuts, feed_mm_s=6, feed_min_mm_s=1, power_w=30, kerf_range_mm=(0.5, 6)
    )
    for name, feed in (("one", 0.002), ("two", 0.006)):
        for way in ("_in", "", "_out"):
            assert np.all(targets.feed[rows(targets, f"cut/{name}{way}")] == feed)
        windows = [
            c
            for c in targets.claims
            if isinstance(c, FeedWindow) and c.segment == Segment.read(f"cut/{name}")
        ]
        assert [(w.lower, w.upper) for w in windows] == [(0.001, feed)]
    assert np.all(targets.feed[rows(targets, "link")] > 0.02)
    kerf = next(c.kerf for c in targets.claims if isinstance(c, CutsSurface))
    first, second = (wires(targets)[0][rows(targets, f"cut/{n}")] for n in ("one", "two"))
    wide = [np.ptp(side[:, 0]) - 0.06 for side in (first, second)]
    np.testing.assert_allclose(wide, kerf.at(FEED_FRACTION * np.array([0.002, 0.006])), atol=2e-5)
    with pytest.raises(ValueError, match="feed_min"):
        blocks.operation(cuts=cuts, feed_min_mm_s=3)


def test_the_wire_goes_in_the_air_as_fast_as_is_stated_and_no_faster_in_the_foam() -> None:
    slow, fast = make(WAVE), make(WAVE, air_feed_mm_s=250)
    air = np.array([segment.kind != "cut" for segment in slow.segment])
    cut = ~air
    assert air.sum() > 2 and cut.sum() > 2
    assert np.allclose(slow.feed[air], 0.1)
    assert np.allclose(fast.feed[air], 0.25)
    assert np.array_equal(fast.feed[cut], slow.feed[cut]) and fast.feed[cut].max() < 0.1
    assert np.array_equal(fast.pose["left"], slow.pose["left"])


@pytest.mark.parametrize("feed", [0.0, -5.0, 1001.0])
def test_speeds_in_the_air_that_no_arm_has_are_refused(feed: float) -> None:
    with pytest.raises(ValueError, match="air_feed_mm_s"):
        make(WAVE, air_feed_mm_s=feed)
