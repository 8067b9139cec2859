"""Sag compensation: commanded arms stand where the plan has them, and what is refused."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.catalogue.robots import robot
from planner.cell.compliance import tcp_compliance
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import log_rotation
from planner.geometry.units import GRAVITY
from planner.issues import Issue, TandemError
from planner.motion import sag, solve
from planner.plans import Plan
from planner.problem import Problem
from planner.processes import registry
from planner.proof.replay import arm_deflection
from planner.report import markup
from planner.report.setup_sheet import controller_checks
from tests.proof.planner_jobs import DEEPER, JOBS, SOFT, sagging


def plan_file(path: Path) -> tuple[Problem, Plan]:
    """A job and its plan, without programs."""
    problem = pipeline.load(path)
    return problem, solve.solve(problem, [job.targets() for job in registry.jobs(problem)])


def write_edited(path: Path, **arm: Any) -> Path:
    """The job of a file with other keys of its first arm."""
    data = yaml.safe_load(path.read_text())
    data["cell"]["arms"][0] |= arm
    path.write_text(yaml.safe_dump(data))
    return path


def expect_issues(path: Path) -> Mapping[str, Issue]:
    with pytest.raises(TandemError) as caught:
        pipeline.plan(pipeline.load(path))
    return {issue.code: issue for issue in caught.value.issues}


def expect_messages(path: Path, code: str) -> list[str]:
    """Return all messages with a code."""
    with pytest.raises(TandemError) as caught:
        pipeline.plan(pipeline.load(path))
    return [issue.message for issue in caught.value.issues if issue.code == code]


def test_by_the_compliance_at_the_pose_the_arm_gives_way_to_where_it_is_wanted(tmp_path: Path) -> None:
    """C times the wrench of weight and force, from the Jacobian, is the way from command to plan."""
    problem, plan = plan_file(JOBS["posed_sag"](tmp_path))
    made, told = sag.commanded_plan(problem, plan)
    (before,), (after,) = plan.operations, made.operations
    assert {issue.code for issue in told} == {"motion.sag"}
    assert "under 0.90 kg and 70 N" in told[0].message
    for arm, forces in (("left", [30, -20, 60]), ("right", [0, 15, -50])):
        own = problem.cell.arm(arm)
        data, tool = robot(own.robot), own.tool
        assert own.stiffness is not None
        stand, command = (own.base @ forward_kinematics(data, p.q[arm]) @ tool.tcp for p in (before, after))
        weight = np.array([0.0, 0.0, -tool.mass * GRAVITY])
        centre = (own.base @ forward_kinematics(data, before.q[arm]) @ np.append(tool.cog, 1.0))[:, :3]
        lever = centre - stand[:, :3, 3]
        force = np.tile(np.array(forces, dtype=float), (len(stand), 1))
        force = np.einsum("nij,nj->ni", stand[:, :3, :3], force) if arm == "right" else force
        force[0] = 0.0  # it comes on from the first target to the second
        wrench = np.concatenate([np.cross(lever, weight), force + weight], axis=1)
        compliance = tcp_compliance(data, own.stiffness, before.q[arm], tool.tcp, own.base)
        moved = np.einsum("nij,nj->ni", compliance, wrench)
        assert np.linalg.norm(moved[1:, 3:], axis=1).min() > 1e-4
        np.testing.assert_allclose(stand[:, :3, 3] - command[:, :3, 3], moved[:, 3:], atol=1e-6)
        turned = log_rotation(stand[:, :3, :3] @ command[:, :3, :3].swapaxes(-1, -2))
        np.testing.assert_allclose(turned, moved[:, :3], atol=5e-6)
        # what is written are poses of the same joints
        stock_pose = problem.stock.place if after.targets.frame[arm] == "stock" else np.eye(4)
        written = stock_pose @ after.targets.poses(after.values)[arm]
        np.testing.assert_allclose(written, command, atol=1e-12)


def test_a_plan_without_compensation_is_commanded_as_it_is(tmp_path: Path) -> None:
    problem, plan = plan_file(JOBS["posed_two"](tmp_path))
    made, told = sag.commanded_plan(problem, plan)
    assert made is plan
    assert told == ()
    assert solve.with_margins(problem, ())[0] is problem


def test_where_the_controller_makes_up_for_the_load_only_the_force_is_ours(tmp_path: Path) -> None:
    """The remedy of ``motion.sag``: load: false."""
    path = write_edited(sagging(JOBS["posed"](tmp_path)), compensate_sag={"load": False})
    problem, plan = plan_file(path)
    made, told = sag.commanded_plan(problem, plan)
    np.testing.assert_allclose(made.operations[0].q["left"], plan.operations[0].q["left"], atol=1e-15)
    assert told[0].value == 0.0
    assert pipeline.plan(problem).verified


def test_an_arm_that_holds_the_block_sags_by_its_weight_too(tmp_path: Path) -> None:
    problem = pipeline.load(JOBS["held_sag"](tmp_path))
    setup = problem.setups[0]
    holder = setup.stock.held_by
    assert holder is not None
    assert setup.stock.mass
    (claim,) = (item for item in sag.sag_claims(problem, setup) if item.arm == holder)
    tool = setup.cell.arm(holder).tool
    assert claim.mass == pytest.approx(tool.mass + setup.stock.mass)
    middle = tool.tcp @ setup.stock.grip @ [*(0.5 * (setup.stock.lower + setup.stock.upper)), 1.0]
    np.testing.assert_allclose(claim.mass * claim.cog, tool.mass * tool.cog + setup.stock.mass * middle[:3])


def test_the_tool_stands_where_force_comes_and_goes(tmp_path: Path) -> None:
    problem, plan = plan_file(sagging(JOBS["gcode_krl"](tmp_path), robot=([30, 20, 50], "stock")))
    made = sag.commanded_plan(problem, plan)[0].operations[0]
    before = plan.operations[0]
    changes = np.flatnonzero(np.diff(sag.force_fractions(before.targets)) != 0.0)
    assert len(changes) >= 2
    assert made.targets.stop[changes].all()
    assert made.targets.stop[changes + 1].all()
    assert (np.diff(made.time) >= np.diff(before.time) - 1e-12).all()


def test_a_force_that_turns_with_the_feed_turns_one_soft_axis_by_its_moment(tmp_path: Path) -> None:
    """With axis 1 alone soft an arm turns about it by moment over stiffness. The direction of the feed is
    found here by walking the way in small steps."""
    soft, force = 1e6, np.array([-60.0, 80.0, 30.0])
    path = write_edited(
        JOBS["gcode_feed"](tmp_path),
        stiffness={"joints_nm_rad": [soft, *[1e9] * 5], "source": "made up"},
        compensate_sag={"load": False},
    )
    problem, plan = plan_file(path)
    before, after = plan.operations[0], sag.commanded_plan(problem, plan)[0].operations[0]
    (arm,) = problem.cell.arms
    stand = arm.base @ forward_kinematics(robot(arm.robot), before.q["robot"]) @ arm.tool.tcp
    place, axis = stand[:, :3, 3], stand[:, :3, 2]
    works = sag.force_fractions(before.targets) > 0.0
    expected = np.zeros(len(place))
    for run in np.split(np.flatnonzero(works), np.flatnonzero(np.diff(np.flatnonzero(works)) != 1) + 1):
        steps, ends = [], [0]
        for k in run:
            count = int(np.ceil(np.linalg.norm(place[k] - place[k - 1]) / 2e-5))
            steps += [(place[k] - place[k - 1]) / count] * count
            ends.append(len(steps))
        long = np.linalg.norm(steps, axis=1)
        gone = np.cumsum(long) - 0.5 * long
        for k, end in zip(run, ends[1:], strict=True):
            near = np.abs(gone - long[:end].sum()) < 5e-3
            feed = np.array(steps)[near].sum(axis=0) / long[near].sum()
            ahead = feed - (feed @ axis[k]) * axis[k]
            work = force[0] * ahead + force[1] * np.cross(axis[k], ahead) + force[2] * axis[k]
            lever = place[k] - arm.base[:3, 3]
            expected[k] = np.cross(lever, work) @ arm.base[:3, 2] / soft
    turned = before.q["robot"] - after.q["robot"]
    assert np.ptp(expected[works]) > 1e-4
    np.testing.assert_allclose(turned[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("job", ["gcode_feed", "gcode_feed_krl"])
def test_a_force_that_turns_with_the_feed_is_made_up_for_and_proven(job: str, tmp_path: Path) -> None:
    outcome = pipeline.plan(pipeline.load(JOBS[job](tmp_path)))
    assert outcome.verified
    (told,) = [issue for issue in outcome.issues if issue.code == "motion.sag"]
    (rule,) = [rule for rule in outcome.proof.rules if rule.code == "verify.sag"]
    # what the planner takes off is what the proof finds by the programs' text
    assert rule.worst == pytest.approx(told.value, abs=2e-3)


def test_a_force_that_turns_shifts_no_arm_farther_than_it_can_be_told(tmp_path: Path) -> None:
    path = write_edited(JOBS["gcode_feed"](tmp_path), stiffness=SOFT)
    assert "under a force that turns with the feed over" in str(expect_messages(path, "motion.sag_range"))


def test_nothing_is_proven_where_the_feed_of_the_loaded_arm_does_not_settle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the planner took shifts that are too large for the feed to be told."""
    monkeypatch.setattr(arm_deflection, "FEED_TOLERANCE_M", 0.0)
    issues = expect_messages(JOBS["gcode_feed"](tmp_path), "verify.sag")
    assert "its path is undetermined" in issues[0]


@pytest.mark.long
def test_a_force_by_depth_is_that_of_the_table_at_each_place(tmp_path: Path) -> None:
    """C times the force between the rows of the table, by hand, is the way from command to plan."""
    problem, plan = plan_file(write_edited(JOBS["dsif_deep"](tmp_path), compensate_sag={"load": False}))
    before, after = plan.operations[0], sag.commanded_plan(problem, plan)[0].operations[0]
    own = problem.cell.arm("left")
    assert own.stiffness is not None
    data = robot(own.robot)
    stand, command = (
        own.base @ forward_kinematics(data, p.q["left"]) @ own.tool.tcp for p in (before, after)
    )
    heights = (np.linalg.inv(plan.stock_pose) @ stand)[:, 2, 3] * 1e3
    wrench = np.zeros((len(stand), 6))
    for i in np.flatnonzero(sag.force_fractions(before.targets)):
        (low, *least), (high, *most) = next(
            (b, a) for a, b in itertools.pairwise(DEEPER["left"]) if b[0] <= heights[i] <= a[0]
        )
        part = (heights[i] - low) / (high - low)
        there = [(1.0 - part) * x + part * y for x, y in zip(least, most, strict=True)]
        wrench[i, 3:] = plan.stock_pose[:3, :3] @ there
    assert np.ptp(np.linalg.norm(wrench[1:-1, 3:], axis=1)) > 200.0
    compliance = tcp_compliance(data, own.stiffness, before.q["left"], own.tool.tcp, own.base)
    moved = np.einsum("nij,nj->ni", compliance, wrench)
    np.testing.assert_allclose(stand[:, :3, 3] - command[:, :3, 3], moved[:, 3:], atol=2e-6)


@pytest.mark.long
def test_a_force_by_depth_is_made_up_for_and_proven_and_tables_that_end_early_or_jump_are_not(
    tmp_path: Path,
) -> None:
    path = JOBS["dsif_deep"](tmp_path)
    outcome = pipeline.plan(pipeline.load(path))
    assert outcome.verified
    worst = max(issue.value for issue in outcome.issues if issue.code == "motion.sag" and issue.value)
    (rule,) = [rule for rule in outcome.proof.rules if rule.code == "verify.sag"]
    assert rule.worst == pytest.approx(worst, abs=2e-3)
    data = yaml.safe_load(path.read_text())
    stated = data["operations"][0]["forces"]["left"]
    for table, said in (
        (DEEPER["left"][:-1], "its table of forces covers 3 to 8 mm; add rows"),
        ([[3.01, 0, 0, 0], [3, 0, 0, 600], [8, 0, 0, 0], [-4, 0, 0, 600]], "is steepest, the sag changes by"),
    ):
        stated["table"] = table
        path.write_text(yaml.safe_dump(data))
        assert said in str(expect_messages(path, "motion.sag_range"))


def test_a_shift_beyond_its_range_is_refused_and_the_range_advised_is_enough(tmp_path: Path) -> None:
    path = write_edited(JOBS["posed_sag"](tmp_path), compensate_sag={"most_mm": 0.1})
    issue = expect_issues(path)["motion.sag_range"]
    assert issue.value is not None
    assert issue.value > 0.1
    assert issue.hint is not None
    maximum = float(issue.hint.split("most_mm: ")[1].rstrip("}"))
    outcome = pipeline.plan(pipeline.load(write_edited(path, compensate_sag={"most_mm": maximum})))
    assert outcome.verified
    (made,) = outcome.plan.operations
    assert set(made.commanded) == {"left", "right"}
    shown = re.sub(r"<[^>]+>", " ", markup.render(controller_checks(outcome.problem, outcome.plan)))
    assert "off (Absolute Accuracy): the program compensates the sag from the load" in shown
    assert SOFT["source"] in shown


def test_targets_far_apart_are_refused_and_nearer_ones_are_not(tmp_path: Path) -> None:
    """Over a quarter of a metre sag of millimetres is no line."""
    path = sagging(JOBS["posed"](tmp_path), softer=6.0, left=([0, 0, 60], "stock"))
    table = tmp_path / "targets.csv"
    head, *rows = table.read_text().splitlines()
    values = np.array([[float(v) for v in row.split(",")] for row in rows])
    names = head.split(",")
    ends = values[[0, 0]]
    ends[1, names.index("left.x_mm")] -= 120.0
    ends[1, names.index("left.z_mm")] += 200.0

    def write(count: int) -> None:
        between = ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])
        table.write_text("\n".join([head, *(",".join(f"{v:.9f}" for v in row) for row in between)]) + "\n")

    write(3)
    issue = expect_issues(path)["motion.sag_range"]
    assert "place the targets closer together" in issue.message
    write(30)
    assert pipeline.plan(pipeline.load(path)).verified


def test_a_force_and_a_least_feed_do_not_go_together(tmp_path: Path) -> None:
    path = sagging(JOBS["posed"](tmp_path), left=([0, 0, 30], "stock"))
    data = yaml.safe_load(path.read_text())
    data["operations"][0] |= {"feed_min_mm_s": 5}
    path.write_text(yaml.safe_dump(data))
    assert "a minimum feed is set" in expect_issues(path)["motion.sag_range"].message


def test_spline_blocks_are_refused(tmp_path: Path) -> None:
    path = JOBS["posed_sag_krl"](tmp_path)
    data = yaml.safe_load(path.read_text())
    data["cell"]["controller"]["path"] = "spline"
    path.write_text(yaml.safe_dump(data))
    assert (
        "whose sag compensation is proven on straight moves only" in expect_issues(path)["post.path"].message
    )


@pytest.mark.parametrize(
    ("arm", "forces", "expected_text"),
    [
        ({"stiffness": None}, None, "is unknown, so its sag cannot be computed"),
        ({"compensate_sag": {"most_mm": 50}}, None, "most_mm"),
        ({"compensate_sag": None}, {"left": {"force_n": [0, 0, 1]}}, "no effect without sag compensation"),
        ({}, {"right": {"force_n": [0, 0, 1]}}, "takes no part in"),
        ({}, {"left": {"force_n": [0, 1]}}, "is missing"),
        ({}, {"left": {"frame": "tool"}}, "state either force_n, or a table"),
        (
            {},
            {"left": {"force_n": [0, 0, 1], "table": [[0, 0, 0, 1], [1, 0, 0, 2]]}},
            "state either force_n, or a table",
        ),
        ({}, {"left": {"table": [[0, 0, 0, 1], [0, 0, 0, 2]]}}, "have the same z"),
        ({}, {"left": {"table": [[0, 0, 0, 1]]}}, "at least 2"),
        ({}, {"left": {"force_n": [0, 0, 1e6]}}, "less than or equal to 20000"),
        ({}, {"left": {"force_n": [0, 0, 1], "frame": "world"}}, "frame"),
        ({}, {}, "forces"),
    ],
)
def test_sag_and_forces_that_cannot_be_are_refused_by_field(
    arm: dict[str, Any], forces: Any, expected_text: str, tmp_path: Path
) -> None:
    path = write_edited(sagging(JOBS["posed"](tmp_path)), **arm)
    data = yaml.safe_load(path.read_text())
    if forces is not None:
        data["operations"][0]["forces"] = forces
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as caught:
        pipeline.load(path)
    assert {issue.code for issue in caught.value.issues} == {"problem.field"}
    assert any(expected_text in issue.message for issue in caught.value.issues), caught.value.issues


def test_two_operations_of_one_setup_have_one_force(tmp_path: Path) -> None:
    path = sagging(JOBS["posed"](tmp_path), left=([0, 0, 30], "stock"))
    data = yaml.safe_load(path.read_text())
    data["operations"].append({**data["operations"][0], "name": "again", "forces": None})
    del data["operations"][1]["forces"]
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as caught:
        pipeline.load(path)
    assert "belong to one setup but state different forces on left" in caught.value.issues[0].message
