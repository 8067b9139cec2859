"""Corners between moves: limits of zones and of their rounding."""

from __future__ import annotations

import re

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.geometry import corner_rounding
from planner.languages.krl.writer import syntax
from planner.languages.rapid.writer import syntax as rapid_syntax
from planner.motion.trajectory import joint_path
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.plan import job as forming_job
from planner.processes.hotwire.plan.straight import job as straight_job
from planner.processes.milling.claims import MillsProgram, SparesPart
from planner.processes.milling.plan import job as milling_job
from planner.proof.replay.moves import end_rates, time_law
from planner.targets import CornerRounding, tool_reach
from planner.tooling import bow
from tests.languages.writing import synthetic
from tests.languages.writing.reading import moves, numbers, programs
from tests.processes.hotwire.plan import foam_blocks

FACE = (np.zeros((3, 3)), np.array([[0, 1, 2]]))


def test_zones_take_at_most_half_a_segment():
    job = synthetic.problem()
    steps = np.concatenate([[0.0], np.cumsum(np.geomspace(1e-6, 0.05, 60))])
    q = {
        "left": synthetic.START + 0.3 * steps[:, None] * np.array([1.0, 0.2, -0.3, 0, 0, 0]),
        "right": synthetic.START + 0.1 * steps[:, None] * np.array([1.0, 0.2, -0.3, 0, 0, 0]),
    }
    q["right"][30:] = q["right"][30]
    q["right"][30:, 5] += 0.01 * np.arange(31)  # axis 6 passes through the TCP: it stands and turns
    labels = ["transit"] * 20 + ["cut/a"] * 41
    files = programs(synthetic.plan(synthetic.operation(job, q, labels, actions=())), job)
    # the larger one of position and turning in ABB's zonedata, mm
    known = {"z10": 15, "z5": 8, "z1": 1, "z0": 0.3, "fine": 0}
    for task in ("T_ROB1", "T_ROB2"):
        data = files[f"{task}/TandemData_{task[-1]}.mod"]
        own = dict(re.findall(r"CONST zonedata (\w+):=\[FALSE,([\d.]+),", data))
        sizes = known | {name: float(size) for name, size in own.items()}
        rows = moves(files, task)
        position = numbers(rows, 0)
        distance = np.linalg.norm(np.diff(position, axis=0), axis=1)
        for i in range(1, len(rows) - 1):
            assert sizes[rows[i][6]] <= 0.5 * min(distance[i - 1], distance[i]) + 1e-6
        assert rows[-1][6] == "fine"
        used = {row[6] for row in rows}
        assert set(own) <= used
        assert len(used) >= (5 if task == "T_ROB1" else 3)  # the other arm hardly moves: zones by angle
    assert "fine" not in [row[6] for row in rows[:-1]]
    assert {row[6][:6] for row in rows[30:-1]} == {"z_turn"}


def corner_deviation(incoming, outgoing, zone):
    """Return the distance of a corner from the quadratic Bezier curve that rounds it, by sampled points.

    Args:
        incoming: Step and length of the move before the corner.
        outgoing: Step and length of the move after it.
        zone: Length of the curve on each side of the corner.
    """
    (way0, far0), (way1, far1) = incoming, outgoing
    t = np.linspace(0.0, 1.0, 20_001)[:, None]
    curve = -((1.0 - t) ** 2) * zone * np.asarray(way0) / far0 + t**2 * zone * np.asarray(way1) / far1
    return float(np.linalg.norm(curve, axis=1).min())


def test_corners_stay_within_what_is_allowed_by_the_points_of_their_curves():
    """Random corners: exactly as far off as allowed, if a zone of half the shorter move is not nearer."""
    rng = np.random.default_rng(4)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    exact = 0
    for _ in range(200):
        ways = rng.normal(size=(2, 3)) * rng.uniform(0.01, 10.0, (2, 1))
        far = np.linalg.norm(ways, axis=1)
        position = np.concatenate([np.zeros((1, 3)), np.cumsum(ways, axis=0)])
        zone = corner_rounding.max_zones(position, still, np.array([False, True]))[0][0]
        deviation = corner_deviation((ways[0], far[0]), (ways[1], far[1]), zone)
        if zone < 0.5 * far.min() * (1.0 - 1e-12):
            assert deviation == pytest.approx(corner_rounding.CORNER_DEVIATION_MM, rel=1e-3)
            exact += 1
        else:
            assert deviation <= corner_rounding.CORNER_DEVIATION_MM * (1.0 + 1e-6)
    assert 100 < exact < 200


def test_corners_are_rounded_over_no_less_time_than_the_clock_counts_with():
    """Random corners and times, by the proof's law of time for the zone that is written: that of a slow move
    behind a fast one is left as fast as that."""
    rng = np.random.default_rng(8)
    sizes = np.sort([15.0, 8.0, 1.0, 0.3, *rapid_syntax.DECLARED_ZONES.values()])
    still = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    counted = 0
    for _ in range(200):
        ways = rng.normal(size=(2, 3)) * rng.uniform(0.1, 3.0, (2, 1))
        times = rng.uniform(0.05, 1.0, 2)
        position = np.concatenate([np.zeros((1, 3)), np.cumsum(ways, axis=0)])
        stop, timing = np.array([False, True]), corner_rounding.MoveTiming(times, np.ones(2), np.ones(2))
        reach = corner_rounding.max_zones(position, still, stop)[0][0]
        fraction = corner_rounding.corner_fractions(
            position, still, timing, np.full(3, 100.0), np.full(2, 0.02)
        )[0][0]
        if reach < sizes[0]:
            assert fraction == 0.0
            continue
        zone = sizes[sizes <= reach][-1]
        far = np.linalg.norm(ways, axis=1)
        part = np.array([[0.5, 0.5], zone / far, [0.5, 0.5]])
        window = time_law(times, far, np.array([True, False, True]), part, np.zeros(3)).window[1]
        assert fraction * times.min() <= window * (1.0 + 1e-9)
        counted += fraction > 0.0
    assert counted > 100


def test_planner_and_proof_match_speeds_beside_stops_alike():
    rng = np.random.default_rng(11)
    for _ in range(50):
        duration, length = np.exp(rng.normal(size=(2, 20)))
        stop = rng.uniform(size=21) < 0.3
        stop[[0, -1]] = True
        got = joint_path.end_speed_ratios(length, duration, stop)
        np.testing.assert_allclose(got, end_rates(duration, length, stop), rtol=1e-12)


def test_a_tool_that_only_gets_faster_has_all_of_its_moves_for_zones():
    """Along one line, and turning about one axis beside it, nothing leaves the way."""
    place = np.cumsum(np.array([0.0, 1.0, 1.5, 4.0, 4.0, 0.5]))
    position = np.stack([place, 2.0 * place, 0.0 * place], axis=1)
    angle = 0.01 * place
    turned = np.stack([np.cos(0.5 * angle), 0.0 * angle, 0.0 * angle, np.sin(0.5 * angle)], axis=1)
    turned[2::2] *= -1.0  # the same orientations
    reach, turn = corner_rounding.max_zones(position, turned, np.arange(5) == 4)
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert reach[:4] == pytest.approx(0.5 * np.minimum(step[:-1], step[1:]))
    assert turn[:4] == pytest.approx(
        0.005 * np.minimum(*np.abs(np.diff(place))[[[0, 1, 2, 3], [1, 2, 3, 4]]])
    )


def test_a_cutter_may_spin_as_its_way_asks():
    """Its spin is worth 4 mm/rad, its lean 100 where a surface is claimed, else what its angle allows."""
    way = MillsProgram("a", "left", None, None, 2e-4, 0.01, True)
    allowed = 0.15 * 0.2  # mm: a share of its tolerance
    tilt = allowed / (0.15 * 0.01)
    spin = 100.0 * allowed / 0.5
    alone = milling_job.rounding((way,))
    assert 1e3 * alone.rotation_lever("left", synthetic.tool()) == pytest.approx([tilt, tilt, spin])
    assert 1e3 * alone.work == pytest.approx(allowed) and alone.air == alone.approach == CornerRounding.air
    spared = SparesPart((Segment.read("mill/a"),), "left", None, *FACE, 0.0, 2e-4)
    both = milling_job.rounding((way, spared))
    assert 1e3 * both.rotation_lever("left", synthetic.tool()) == pytest.approx([100.0, 100.0, spin])
    assert 1e3 * both.rotation_lever("right", synthetic.tool()) == pytest.approx([100.0] * 3)
    assert alone.spline_deviations == {"left": ((0.0, 1e-4),)}
    assert both.spline_deviations == {"left": ((0.0, 1e-4), (0.0, 0.75 * 2e-4))}


def test_a_tight_cutter_takes_half_of_what_is_allowed_and_a_ball_its_share():
    tight = milling_job.rounding((MillsProgram("a", "left", None, None, 2e-5, 0.01, True),))
    assert (tight.work, tight.approach, tight.air) == pytest.approx((1e-5, 1e-5, 1e-5))
    for gouge, fraction in ((3e-5, 0.4), (1e-3, 0.02)):
        face = FormsSheet(Segment.read("form/a"), "left", 1, 0.005, *FACE, 0.0, 0.0, gouge, 1e-3, 0.9)
        made = forming_job.corner_rounding((face,))
        assert (made.work, made.approach, made.air) == pytest.approx((fraction * gouge,) * 3)
    assert forming_job.corner_rounding(()) == CornerRounding()


def test_sizes_of_zones_are_no_farther_apart_than_the_clock_counts_with():
    rapid = sorted([15.0, 8.0, 1.0, 0.3, *rapid_syntax.DECLARED_ZONES.values()])
    for sizes in (
        rapid,
        rapid_syntax.ROTATION_ZONES.values(),
        syntax.APPROXIMATION_DISTANCES,
        syntax.APPROXIMATION_ANGLES,
    ):
        found = np.sort(np.array(list(sizes)))
        coarse = found[1:] > corner_rounding.PATH_ACCURACY_MM
        assert (found[1:] / found[:-1] <= corner_rounding.MAX_ZONE_RATIO + 1e-9)[coarse].all()


def test_a_rounded_corner_passes_its_target_closely():
    """Along an arc any zone is good; at a sharp corner the zone shrinks."""
    count = 81
    angle = np.linspace(0.0, 1.0, count)
    position = np.stack([300.0 * np.sin(angle), 300.0 * np.cos(angle), 0.0 * angle], axis=1)
    # from here in another direction
    position[40:] += np.array([40.0, 0.0, 0.0]) * np.arange(count - 40)[:, None]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    reach, turn = corner_rounding.max_zones(position, still, np.zeros(count - 1, dtype=bool))
    steps = np.diff(position, axis=0)
    half = 0.5 * np.minimum(*np.linalg.norm([steps[:-1], steps[1:]], axis=2))
    assert np.allclose(reach[:38], half[:38], rtol=1e-12)
    far = np.linalg.norm(steps[39:41], axis=1)
    assert 0.0 < reach[39] < 0.1 * far.min()
    deviation = corner_deviation((steps[39], far[0]), (steps[40], far[1]), reach[39])
    assert deviation == pytest.approx(corner_rounding.CORNER_DEVIATION_MM, rel=1e-3)
    assert reach[-1] == 0.0 and not turn.any()


def test_a_wire_turns_a_sharp_corner_in_foam_without_a_stop():
    """Between two cuts at a right angle the bow turns by 90 degrees in one move; only a small zone is left,
    but a zone it is."""
    still, turned = (
        np.tile([1.0, 0.0, 0.0, 0.0], (11, 1)),
        np.tile([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], (10, 1)),
    )
    way = np.concatenate(
        [np.linspace([0.0, 0, 0], [30.0, 0, 0], 11), np.linspace([30.0, 3, 0], [30.0, 30, 0], 10)]
    )
    turn = np.concatenate([still, turned])
    reach, reach_turn = corner_rounding.max_zones(
        way, turn, np.arange(20) == 19, 1e3 * tool_reach(bow(span=0.65))
    )
    assert (reach[:19] > 0.0).all() and reach[19] == 0.0
    step = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert (reach[:19] <= 0.5 * np.minimum(step[:-1], step[1:]) + 1e-12).all()
    assert reach_turn[9] == 0.0  # before the corner nothing turns
    # the wire's end, 325 mm away, is at a corner too: from the way of the TCP into that of the turn
    leave = np.append(way[11] - way[10], 325.0 * np.sqrt(2.0))  # turning is taken by its chord
    come = np.append(way[10] - way[9], 0.0)
    deviation = corner_deviation((come, step[9]), (leave, step[10]), reach[9])
    assert 0.1 * corner_rounding.CORNER_DEVIATION_MM <= deviation <= corner_rounding.CORNER_DEVIATION_MM


def test_turning_counts_at_the_end_of_the_wire():
    assert tool_reach(bow(span=0.65)) == pytest.approx(0.325)
    assert (
        tool_reach(bow(span=0.1)) == 1e-3 * corner_rounding.ROTATION_LEVER_MM == tool_reach(synthetic.tool())
    )


def test_a_corner_without_room_for_a_zone_is_passed_all_the_same():
    job = synthetic.problem(("left",))
    q = np.repeat(synthetic.START[None, :], 7, axis=0)
    q[:4, 0] += 1e-7 * np.arange(4)  # steps of some 0.0001 mm
    q[4:, 0] = q[3, 0]
    q[4:, 4] += 0.2 * np.arange(1, 4)
    files = programs(
        synthetic.plan(synthetic.operation(job, {"left": q}, ["cut/a"] * 7, actions=(), coupled=False)), job
    )
    assert "fine" not in [row[6] for row in moves(files, "T_ROB1")[:-1]]


def test_a_straight_wire_turns_wider_in_the_air_than_in_the_foam():
    """0.5 mm in the air, 15 % of 0.3 mm at and beside cuts; whatever else keeps to 0.02 mm everywhere."""
    labels = ["approach", "approach", "cut/a", "cut/a", "link", "link"]
    segments = [Segment.read(label) for label in labels]
    wire = straight_job.rounding(foam_blocks.operation(shape_tol_mm=0.3))
    expected = [0.5, 0.045, 0.045, 0.045, 0.5, 0.5]
    np.testing.assert_allclose(1e3 * wire.deviations(segments), expected)
    np.testing.assert_allclose(
        1e3 * CornerRounding().deviations(segments), corner_rounding.CORNER_DEVIATION_MM, rtol=1e-12
    )
    position = np.stack([np.arange(7.0) * 3.0, np.abs(np.arange(7.0) - 3.0), np.zeros(7)], axis=1)
    still = np.tile([1.0, 0, 0, 0], (7, 1))
    reach, _ = corner_rounding.max_zones(position, still, np.arange(6) == 5, 100.0, np.array(expected))
    assert reach[2] == pytest.approx(0.045 / (0.25 * 2.0 / np.hypot(3.0, 1.0)))
