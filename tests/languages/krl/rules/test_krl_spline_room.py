"""The margin that plans keep, and that the proof subtracts, for the curves of spline blocks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.claims.claim import Allowance, FeedWindow
from planner.claims.segments import Segment
from planner.geometry.arrays import to_quaternion
from planner.languages.krl.reader import spline_curve
from planner.languages.krl.rules import spline
from planner.languages.krl.writer.spline_blocks import bound_curves
from planner.motion import solve
from planner.processes.milling.claims import MillsAlong
from tests.languages.krl import spline_job
from tests.languages.krl.reader.spline_members import block


@pytest.mark.parametrize("kind", ["arc", "kink", "anyhow"])
def test_what_the_writer_counts_is_what_the_proof_counts(kind):
    """Never less, and hardly more: else blocks would be written that are not proven, or none."""
    rng = np.random.default_rng(11)
    for _ in range(4):
        pose, times = block(rng, int(rng.integers(2, 9)), kind)
        proven = spline_curve.bound_curves(pose, times)
        written = bound_curves(1e3 * pose[:, :3, 3], to_quaternion(pose[:, :3, :3]), times)
        for mine, other in ((written.deviation, proven.deviation), (written.translation, proven.translation)):
            assert (mine >= 0.9995e3 * other).all() and (mine <= 1.02e3 * other + 1e-3).all()
        assert (written.rotation >= 0.9995 * proven.rotation - 1e-12).all()
        assert (written.speed >= 0.9995e3 * proven.speed).all()


def test_a_segment_that_turns_far_is_in_no_block():
    pose = np.tile(np.eye(4), (4, 1, 1))
    pose[:, 0, 3] = [0.0, 0.01, 0.02, 0.03]
    pose[:, :3, :3] = Rotation.from_euler("z", [[0.0], [0.05], [0.2], [0.25]]).as_matrix()
    assert np.isinf(spline_curve.bound_curves(pose, np.ones(3)).deviation).tolist() == [False, True, False]


def test_rounding_by_even_steps_on_an_arc_costs_some_four_sagittas():
    """h^2 / 8 R of 2 mm on 50 mm is 0.01 mm."""
    turn = np.arange(9) * 2e-3 / 0.05
    pose = np.tile(np.eye(4), (9, 1, 1))
    pose[:, :3, 3] = 0.05 * np.stack([np.sin(turn), 1.0 - np.cos(turn), 0.0 * turn], axis=1)
    found = spline_curve.bound_curves(pose, np.full(8, 0.05))
    assert 3.0e-5 < found.deviation[3] < 5.0e-5
    assert found.speed[3] < 1.01 * 2e-3 / 0.05


def test_claims_lose_what_curves_may_be_off():
    most = Allowance(np.array([1e-5, 3e-5]), np.array([4e-4, 0.0]), 1e-3, 1e-3, spline.MAX_SPEED_FACTOR)
    segment = Segment("mill", "wall")
    tip = np.zeros((2, 3))
    claim = MillsAlong(segment, "robot", tip, tip, np.array([0.0, 0.02]), 1e-4, 0.01)
    less = claim.tightened(most)
    assert less.tolerance == pytest.approx(7e-5) and less.turn == pytest.approx(0.0096)
    assert less.feed[1] == pytest.approx(0.02 / spline.MAX_SPEED_FACTOR)
    window = FeedWindow(segment, 0.0, 0.03).tightened(most)
    assert window.upper == pytest.approx(0.03 / spline.MAX_SPEED_FACTOR)
    assert most.at(0.1) == pytest.approx(5e-5)


def test_plans_leave_room_where_blocks_are_asked_for():
    problem, plan, _, _ = spline_job.job()
    (operation,) = plan.operations
    slin = dataclasses.replace(
        problem,
        cell=dataclasses.replace(
            problem.cell, controller=dataclasses.replace(problem.cell.controller, path="slin")
        ),
    )
    same, targets = solve.with_margins(slin, [operation.targets])
    assert same is slin and targets == (operation.targets,)
    roomy, targets = solve.with_margins(problem, [operation.targets])
    assert roomy.settings.clearance > problem.settings.clearance
    assert targets == (operation.targets,)  # feeds of poses are kept by their times
    fed = dataclasses.replace(operation.targets, feed_throughout=True)
    _, (slower,) = solve.with_margins(problem, [fed])
    fraction = fed.feed / np.where(slower.feed > 0.0, slower.feed, 1.0)
    assert fraction[10:-10] == pytest.approx(solve.SPLINE_SLOWING_FACTOR)
    assert fraction[1] > 1.2 * solve.SPLINE_SLOWING_FACTOR
