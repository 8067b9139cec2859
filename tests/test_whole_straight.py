"""A straight wire end to end: a wing on a stand, and a block that the second arm holds."""

from __future__ import annotations

import re

import numpy as np
import pytest

import planner
from planner import plans
from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import inverse, log_pose
from planner.pipeline import Outcome
from planner.processes.hotwire.claims import CutsSurface


@pytest.fixture(scope="module")
def wing_outcome() -> Outcome:
    return planner.plan(planner.load("wing"))


@pytest.fixture(scope="module")
def held_outcome() -> Outcome:
    return planner.plan(planner.load("shell_piece_held/small.yaml"))


def test_both_jobs_are_proven_by_every_rule(wing_outcome: Outcome, held_outcome: Outcome) -> None:
    for outcome in (wing_outcome, held_outcome):
        assert outcome.verified, outcome.issues
        assert all(rule.ran and rule.passed for rule in outcome.proof.rules)
        assert outcome.plan.operations[0].targets.count >= 400


def test_the_wing_comes_out_right_at_both_ends(wing_outcome: Outcome) -> None:
    """95 % of the skin within 0.3 mm; the tip moves slower than the root and has the wider kerf."""
    (face,) = wing_outcome.proof.surfaces
    near = np.abs(np.nan_to_num(face.deviation, nan=np.inf)) <= 0.3e-3
    assert face.area[near].sum() >= 0.95 * face.area.sum()
    root, tip = face.points[:, 1] < -0.2, face.points[:, 1] > 0.2
    for end in (root, tip):
        assert face.area[near & end].sum() >= 0.95 * face.area[end].sum()
    speed = [float(np.nanmedian(face.speed[end])) for end in (root, tip)]
    assert speed[1] < 0.75 * speed[0]
    claim = next(c for c in wing_outcome.plan.operations[0].targets.claims if isinstance(c, CutsSurface))
    kerf = claim.kerf.at(np.array(speed))
    assert kerf[1] > kerf[0] + 0.4e-3


def test_tool_poses_are_exact_in_the_stock_and_in_the_held_frame(
    wing_outcome: Outcome, held_outcome: Outcome
) -> None:
    for outcome in (wing_outcome, held_outcome):
        (operation,), (place,) = outcome.plan.operations, outcome.plan.stock_poses
        expected = operation.targets.poses(operation.values)
        tcp = {
            arm.name: outcome.plan.bases[arm.name]
            @ forward_kinematics(robot(arm.robot), operation.q[arm.name])
            @ arm.tool.tcp
            for arm in outcome.problem.cell.arms
        }
        for arm, frame in operation.targets.frame.items():
            base = place if frame == "stock" else tcp[frame.removeprefix("held:")]
            assert np.abs(log_pose(inverse(expected[arm]) @ inverse(base) @ tcp[arm])).max() < 1e-9


def test_the_cutters_program_works_on_what_the_holder_carries(held_outcome: Outcome) -> None:
    cutter = "".join(text for name, text in held_outcome.programs.items() if "T_ROB1" in name)
    holder = "".join(text for name, text in held_outcome.programs.items() if "T_ROB2" in name)
    assert re.search(r'wobjdata w_held:=\[FALSE,FALSE,"ROB_2",', cutter)
    assert "GripLoad load_block;" in holder
    assert "Fix the block to the gripper" in cutter + holder
    ids = [re.findall(r"\\ID:=(\d+)", text) for text in (cutter, holder)]
    assert ids[0] == ids[1]
    assert len(ids[0]) >= 400


def test_the_holder_moves_the_block_by_more_than_its_last_axis(held_outcome: Outcome) -> None:
    (operation,) = held_outcome.plan.operations
    swing = np.ptp(operation.q["right"], axis=0)
    assert np.count_nonzero(swing > np.deg2rad(3.0)) >= 3


@pytest.mark.long
def test_the_same_held_job_gives_the_same_bytes(held_outcome: Outcome) -> None:
    again = planner.plan(planner.load("shell_piece_held/small.yaml"))
    assert again.programs == held_outcome.programs
    assert plans.dump(again.plan) == plans.dump(held_outcome.plan)
