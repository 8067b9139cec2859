"""Corners between moves: what zones and their rounding may take of them."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner.bow import bow
from planner.claims import CutsSurface, KerfCurve, StraightWire
from planner.post import corners
from planner.post.write import programs
from tests.post import synthetic
from tests.post.reading import moves, numbers


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
        assert len(used) >= 5
    assert "fine" not in [row[6] for row in rows[:-1]]
    assert {row[6][:6] for row in rows[30:-1]} == {"z_turn"}


def test_a_rounded_corner_passes_its_target_closely():
    """Along an arc any zone is good; at a sharp corner the zone shrinks (Bezier: zone * turn / 4)."""
    count = 81
    angle = np.linspace(0.0, 1.0, count)
    position = np.stack([300.0 * np.sin(angle), 300.0 * np.cos(angle), 0.0 * angle], axis=1)
    # from here in another direction
    position[40:] += np.array([40.0, 0.0, 0.0]) * np.arange(count - 40)[:, None]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    reach, turn = corners.room(position, still, np.full(count - 1, 1.0), np.zeros(count - 1, dtype=bool))
    steps = np.diff(position, axis=0)
    half = 0.5 * np.minimum(*np.linalg.norm([steps[:-1], steps[1:]], axis=2))
    assert np.allclose(reach[:38], half[:38], rtol=1e-12)
    velocity = np.linalg.norm(steps[40] - steps[39])
    shorter = min(np.linalg.norm(steps[39]), np.linalg.norm(steps[40]))
    assert reach[39] == pytest.approx(4 * corners.DEVIATION / velocity * shorter)
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
    duration = np.where(np.arange(20) == 10, 40.0, 0.5)
    reach, reach_turn = corners.room(way, turn, duration, np.arange(20) == 19, corners.lever(bow(span=0.65)))
    assert (reach[:19] > 0.0).all() and reach[19] == 0.0
    step = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert (reach[:19] <= 0.5 * np.minimum(step[:-1], step[1:]) + 1e-12).all()
    assert reach_turn[9] == 0.0  # before the corner nothing turns
    # rounded off over the time h a corner is passed at h |dv| / 4, also by the wire's end, 325 mm away
    speed = np.linalg.norm(np.diff(way, axis=0)[[9, 10]] / duration[[9, 10], None], axis=1)
    change = speed.sum() + 325.0 * 0.5 * np.pi / 40.0
    h = reach[9] / step[9] * duration[9]
    assert (
        0.5 * corners.DEVIATION <= h * change / 4.0 <= 1.03 * corners.DEVIATION
    )  # turning is taken by its chord


def test_turning_counts_at_the_end_of_the_wire():
    assert corners.lever(bow(span=0.65)) == pytest.approx(325.0)
    assert corners.lever(bow(span=0.1)) == corners.LEVER == corners.lever(synthetic.tool())


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
    surface = CutsSurface("cut/a", np.zeros((3, 3)), np.array([[0, 1, 2]]), KerfCurve.constant(1e-3), 3e-4)
    wire = StraightWire("left", np.zeros(3), np.ones(3), 2e-4, 0.02)
    job = synthetic.problem(("left",))
    labels = ["approach", "approach", "approach", "cut/a", "cut/a", "link", "link"]
    made = synthetic.operation(job, {"left": synthetic.sweep(7)}, labels, actions=(), coupled=False).targets
    straight = dataclasses.replace(made, claims=(wire, surface))
    expected = [0.5, 0.045, 0.045, 0.045, 0.5, 0.5]
    np.testing.assert_allclose(corners.deviations(straight, labels[1:]), expected)
    for other in (made, dataclasses.replace(straight, coupled=True)):
        np.testing.assert_allclose(corners.deviations(other, labels[1:]), corners.DEVIATION)
    position = np.stack([np.arange(7.0) * 3.0, np.abs(np.arange(7.0) - 3.0), np.zeros(7)], axis=1)
    still, even = np.tile([1.0, 0, 0, 0], (7, 1)), np.full(6, 0.1)
    reach, _ = corners.room(position, still, even, np.arange(6) == 5, 100.0, np.array(expected))
    step, change = np.hypot(3.0, 1.0), 2.0 / 0.1
    assert reach[2] == pytest.approx(step * 0.045 / (0.1 * change / 4.0))
